"""``skyline store``: its output and exit codes."""

import json

import pytest
from commands import assert_refused


@pytest.fixture(params=["store", "renderings"])
def whole(request):
    """A store of either kind."""
    return request.getfixturevalue(request.param)


@pytest.fixture
def damaged(whole, tmp_path):
    """A copy of the store with another bit in its middle."""
    data = bytearray(whole.read_bytes())
    data[len(data) // 2] ^= 4
    path = tmp_path / "damaged.h5"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("kind", ["store", "renderings"])
def test_a_whole_store_is_said_to_be_whole(run, request, kind):
    holds = {"store": "places", "renderings": "renderings"}[kind]
    assert f"{holds}, whole" in run("store", "check", request.getfixturevalue(kind)).ok().out


def test_a_store_that_is_absent_fails_its_check(run, tmp_path):
    assert_refused(run("store", "check", tmp_path / "absent.h5"))


def test_a_damaged_store_fails_its_check(run, damaged):
    assert_refused(run("store", "check", damaged))


def test_a_check_in_json_counts_the_damaged_rows(run, damaged):
    done = run("store", "check", damaged, "--json")
    report = json.loads(done.out)
    assert done.code == 2
    assert report["whole"] is False
    assert report["damage"][0]["rows"] > 0


def test_a_repaired_store_has_the_damaged_rows_left_out(run, damaged, tmp_path):
    done = run("store", "repair", damaged, "-o", tmp_path / "saved.h5").ok()
    assert "damaged rows left out" in done.out
    assert "left out rows" in done.out
    run("store", "check", tmp_path / "saved.h5").ok()


def test_a_repaired_store_and_the_whole_one_merge_to_the_whole_one(run, whole, damaged, tmp_path):
    saved, merged = tmp_path / "saved.h5", tmp_path / "merged.h5"
    run("store", "repair", damaged, "-o", saved).ok()
    done = run("store", "merge", saved, whole, "-o", merged).ok()
    assert "duplicates left out" in done.out
    assert merged.read_bytes() == whole.read_bytes()


def test_a_merge_does_not_replace_a_store(run, whole, tmp_path):
    existing = tmp_path / "merged.h5"
    existing.write_bytes(whole.read_bytes())
    assert_refused(run("store", "merge", whole, "-o", existing))
    assert existing.read_bytes() == whole.read_bytes()
