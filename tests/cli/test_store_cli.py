"""``skyline store``: its output and exit codes."""

import json

import pytest
from commands import assert_refused


@pytest.mark.parametrize(("name", "holds"), [("store", "places"), ("renderings", "renderings")])
def test_check_repair_and_merge(run, request, name, holds, tmp_path):
    store = request.getfixturevalue(name)
    assert f"{holds}, whole" in run("store", "check", store).out
    assert run("store", "check", tmp_path / "absent.h5").code == 2
    damaged = tmp_path / "damaged.h5"
    data = bytearray(store.read_bytes())
    data[len(data) // 2] ^= 4
    damaged.write_bytes(data)
    assert_refused(run("store", "check", damaged), "is damaged")
    done = run("store", "check", damaged, "--json")
    assert done.code == 2
    report = json.loads(done.out)
    assert report["whole"] is False
    assert report["damage"][0]["rows"] > 0
    done = run("store", "repair", damaged, "-o", tmp_path / "saved.h5")
    assert done.code == 0
    assert "damaged rows left out" in done.out
    assert "left out rows" in done.out
    done = run("store", "merge", tmp_path / "saved.h5", store, "-o", tmp_path / "merged.h5").ok()
    assert "duplicates left out" in done.out
    assert (tmp_path / "merged.h5").read_bytes() == store.read_bytes()
    assert run("store", "merge", store, "-o", tmp_path / "merged.h5").code == 2
