"""``skyline store``: what it prints and what it ends with."""

import json

import pytest

from skyline.store import check_store

KINDS = [("store", "places"), ("renderings", "renderings")]


@pytest.fixture(params=KINDS, ids=[holds for _, holds in KINDS])
def kind(request):
    """A store of either kind, and what it holds."""
    name, holds = request.param
    return request.getfixturevalue(name), holds


def test_check(run, kind, tmp_path):
    store, holds = kind
    done = run("store", "check", store)
    assert done.code == 0
    assert f"{holds}, whole" in done.out
    data = bytearray(store.read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "damaged.h5").write_bytes(data)
    done = run("store", "check", tmp_path / "damaged.h5")
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert "is damaged" in done.err
    done = run("store", "check", tmp_path / "damaged.h5", "--json")
    assert done.code == 2
    report = json.loads(done.out)
    assert report["whole"] is False
    assert report["damage"][0]["rows"] > 0
    assert run("store", "check", tmp_path / "absent.h5").code == 2


def test_repair_merge_compact(run, kind, tmp_path):
    store, _ = kind
    data = bytearray(store.read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "damaged.h5").write_bytes(data)
    done = run("store", "repair", tmp_path / "damaged.h5", "-o", tmp_path / "saved.h5")
    assert done.code == 0
    assert "damaged rows left out" in done.out
    assert "left out rows" in done.out
    done = run("store", "merge", tmp_path / "saved.h5", store, "-o", tmp_path / "merged.h5")
    assert done.code == 0, done.err
    assert "duplicates left out" in done.out
    assert run("store", "compact", store, "-o", tmp_path / "compact.h5").code == 0
    assert (tmp_path / "merged.h5").read_bytes() == (tmp_path / "compact.h5").read_bytes()
    assert run("store", "compact", store, "-o", tmp_path / "compact.h5").code == 2
    assert run("store", "compact", store, "--quantize", "-o", tmp_path / "no.h5").code == 2
    assert not (tmp_path / "no.h5").exists()


def test_exact_rows_are_quantized(run, dem, tmp_path):
    uniform = "--planner", "uniform", "--spacing", 900
    built = run("build", dem, "-o", tmp_path / "s.h5", *uniform, "--rows", "exact")
    assert built.code == 0, built.err
    done = run(
        "store", "compact", tmp_path / "s.h5", "--quantize", "--depth-error", 0.01,
        "-o", tmp_path / "q.h5",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert (tmp_path / "q.h5").stat().st_size < 0.6 * (tmp_path / "s.h5").stat().st_size
    assert check_store(tmp_path / "q.h5").whole
    facts = json.loads(run("info", tmp_path / "q.h5", "--json").out)
    assert facts["rows"] == "compact"
    assert abs(facts["depth_error"] - 0.01) < 1e-9
    assert run("build", dem, "-o", tmp_path / "t.h5", *uniform, "--rows", "packed").code == 2
