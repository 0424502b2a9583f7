"""``skyline store``: its output and exit codes."""

import json

import pytest

KINDS = [("store", "places"), ("renderings", "renderings")]


@pytest.fixture(params=KINDS, ids=[holds for _, holds in KINDS])
def kind(request):
    """A store, and its kind of rows."""
    name, holds = request.param
    return request.getfixturevalue(name), holds


def test_check_repair_and_merge(run, kind, tmp_path):
    store, holds = kind
    assert f"{holds}, whole" in run("store", "check", store).out
    assert run("store", "check", tmp_path / "absent.h5").code == 2
    damaged = tmp_path / "damaged.h5"
    data = bytearray(store.read_bytes())
    data[len(data) // 2] ^= 4
    damaged.write_bytes(data)
    done = run("store", "check", damaged)
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert "is damaged" in done.err
    done = run("store", "check", damaged, "--json")
    assert done.code == 2
    report = json.loads(done.out)
    assert report["whole"] is False
    assert report["damage"][0]["rows"] > 0
    done = run("store", "repair", damaged, "-o", tmp_path / "saved.h5")
    assert done.code == 0
    assert "damaged rows left out" in done.out
    assert "left out rows" in done.out
    done = run("store", "merge", tmp_path / "saved.h5", store, "-o", tmp_path / "merged.h5")
    assert done.code == 0, done.err
    assert "duplicates left out" in done.out
    assert (tmp_path / "merged.h5").read_bytes() == store.read_bytes()
    assert run("store", "merge", store, "-o", tmp_path / "merged.h5").code == 2
