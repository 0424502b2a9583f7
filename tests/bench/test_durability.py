"""A small run of what `skyline-bench store-durability` does at length."""

import json
import subprocess
import sys

import pytest
from scenes import fractal, write_dem

pytestmark = pytest.mark.slow


def test_nothing_is_lost_and_all_damage_is_found(tmp_path):
    dem = write_dem(tmp_path / "dem.tif", fractal(220, 220, 700.0, seed=12))
    record = tmp_path / "record.json"
    # In a process of its own: forks of one with threads are fragile.
    command = [
        sys.executable, "-c", "from skyline_bench.cli import main; main()",
        "store-durability", str(dem), "--quick", "--json", str(record),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = json.loads(record.read_text())["rows"]
    kills = [row for row in rows if row["test"] == "kills"]
    assert len(kills) == 4
    for row in kills:
        assert (row["builds"], row["equal"], row["lost"]) == (1, 1, 0)
    for row in rows:
        if row["test"] == "flips":
            assert row["harmful"] == row["found"] >= 1
            assert (row["silent"], row["crashes"]) == (0, 0)
        if row["test"] == "mutated":
            assert (row["read"] + row["refused"], row["wrong"]) == (10, {})
