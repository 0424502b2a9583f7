"""Small runs of what `skyline-bench store-durability` does at length."""

import json
import subprocess
import sys
import textwrap

import pytest

pytestmark = pytest.mark.slow

Said = dict[str, dict[str, int]]


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> Said:
    """What the tests say, run in a process of its own: forks of one with threads are fragile."""
    script = f"""
        import json
        from pathlib import Path
        from skyline_bench.stores.durability import flip_test, fuzz_test
        from skyline_bench.stores.durability import (
            kill_test, numbered_build, numbered_header, readers_test
        )
        folder = Path({str(tmp_path_factory.mktemp("durability"))!r})
        whole, header = folder / "finished.h5", numbered_header()
        numbered_build(150, header)(whole, lambda _: None)
        exact = folder / "exact.h5"
        numbered_build(150, numbered_header(rows="exact"))(exact, lambda _: None)
        places, places_header = folder / "places.h5", numbered_header(rows="places")
        numbered_build(1100, places_header)(places, lambda _: None)
        for name in ("kills", "readers"):
            (folder / name).mkdir()
        print(json.dumps({{
            "kills of places": kill_test(numbered_build(8000, places_header), folder / "kills", 6),
            "readers of places": readers_test(folder / "readers", 3, 1.5, "places"),
            "flips of places": flip_test(places, folder, 20),
            "mutated places": fuzz_test(places, folder, 50),
            "kills": kill_test(numbered_build(500, header), folder, 6),
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


@pytest.mark.parametrize("name", ["kills", "kills of places"])
def test_killed_builds_resume(said: Said, name: str) -> None:
    kills = said[name]
    assert (kills["kills"], kills["opened"], kills["lost"]) == (6, 6, 0)
    assert kills["builds"] == kills["equal"] >= 1


@pytest.mark.parametrize("name", ["readers", "readers of places"])
def test_readers_beside_a_writer(said: Said, name: str) -> None:
    readers = said[name]
    assert readers["opened"] >= 3
    assert readers["rows"] > 0
    assert (readers["wrong"], readers["failed_readers"], readers["writer_failed"]) == (0, 0, False)


@pytest.mark.parametrize("name", ["flips", "flips of exact rows", "flips of places"])
def test_flipped_bits(said: Said, name: str) -> None:
    flips = said[name]
    assert flips["harmful"] == flips["found"] >= 1
    # Hardly a byte of a store of places is not a place's.
    assert flips["harmless"] >= (name != "flips of places")
    assert flips["harmless"] + flips["harmful"] == 20
    assert (flips["silent"], flips["crashes"]) == (0, 0)


@pytest.mark.parametrize("name", ["mutated", "mutated places"])
def test_mutated_stores(said: Said, name: str) -> None:
    assert said[name]["read"] + said[name]["refused"] == 50
    assert said[name]["refused"] >= 10
