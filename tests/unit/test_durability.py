"""Small runs of what bench/store_durability.py does at length."""

import json
import subprocess
import sys
import textwrap

import pytest

Said = dict[str, dict[str, int]]


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> Said:
    """What the tests say, run in a process of its own: forks of one with threads are fragile."""
    script = f"""
        import json
        from pathlib import Path
        from skyline.experiments.damage import flip_test, fuzz_test
        from skyline.experiments.durability import (
            kill_test, numbered_build, numbered_header, readers_test
        )
        folder = Path({str(tmp_path_factory.mktemp("durability"))!r})
        whole, header = folder / "finished.h5", numbered_header()
        numbered_build(150, header)(whole, lambda _: None)
        exact = folder / "exact.h5"
        numbered_build(150, numbered_header(rows="exact"))(exact, lambda _: None)
        print(json.dumps({{
            "kills": kill_test(numbered_build(500, header), folder, 10),
            "readers": readers_test(folder, 3, 1.5),
            "flips": flip_test(whole, folder, 20),
            "flips of exact rows": flip_test(exact, folder, 20),
            "mutated": fuzz_test(whole, folder, 50),
        }}))
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    tables: Said = json.loads(done.stdout)
    return tables


def test_killed_builds_resume(said: Said) -> None:
    kills = said["kills"]
    assert (kills["kills"], kills["opened"], kills["lost"]) == (10, 10, 0)
    assert kills["builds"] == kills["equal"] >= 1


def test_readers_beside_a_writer(said: Said) -> None:
    readers = said["readers"]
    assert readers["opened"] >= 3
    assert readers["rows"] > 0
    assert (readers["wrong"], readers["failed_readers"], readers["writer_failed"]) == (0, 0, False)


@pytest.mark.parametrize("name", ["flips", "flips of exact rows"])
def test_flipped_bits(said: Said, name: str) -> None:
    flips = said[name]
    assert flips["harmful"] == flips["found"] >= 1
    assert flips["harmless"] >= 1
    assert flips["harmless"] + flips["harmful"] == 20
    assert (flips["silent"], flips["crashes"]) == (0, 0)


def test_mutated_stores(said: Said) -> None:
    assert said["mutated"]["read"] + said["mutated"]["refused"] == 50
    assert said["mutated"]["refused"] >= 10
