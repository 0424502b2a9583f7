"""Small runs of `skyline-bench store-durability` and `input-fuzz`."""

import json
import subprocess
import sys

import pytest
from scenes import fractal, write_dem


@pytest.fixture
def rows(tmp_path):
    """Return a function that runs a command and gives the rows of its record.

    It runs in a process of its own: OpenGL does not outlive the forks of these commands.
    """

    def run(*arguments):
        record = tmp_path / "record.json"
        program = [sys.executable, "-c", "from skyline_bench.cli import main; main()"]
        command = [*program, *map(str, arguments), "--json", record]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(record.read_text())["rows"]

    return run


@pytest.mark.slow
def test_nothing_is_lost_and_all_damage_is_found(rows, tmp_path):
    dem = write_dem(tmp_path / "dem.tif", fractal(220, 220, 700.0, seed=12))
    found = rows("store-durability", dem, "--quick", "--flips", 6)
    kills = [row for row in found if row["test"] == "kills"]
    assert len(kills) == 4
    assert sum(row["kills"] for row in kills) >= 1
    for row in kills:
        assert (row["builds"], row["equal"], row["lost"]) == (1, 1, 0)
    for row in found:
        assert row["km2"] == pytest.approx(4.0, rel=0.1)
        if row["test"] == "flips":
            assert row["flips"] == 6
            assert row["harmful"] == row["found"] >= 1
            assert (row["silent"], row["crashes"]) == (0, 0)
        if row["test"] == "mutated":
            assert (row["read"] + row["refused"], row["wrong"]) == (10, {})


def test_damaged_files_are_answered_or_refused(rows):
    found = rows("input-fuzz", "--cases", 12, "--quick")
    assert len(found) == 6
    for row in found:
        assert row["cases"] == row["answered"] + row["refused"] == 12
        assert not row["wrong"]
