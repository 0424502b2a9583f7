"""Stores and their hazards: builds that are killed, bits that flip, files that are mutated."""

import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from skyline.build import plans
from skyline.build.cluster import local_runner
from skyline.build.parts import build_store
from skyline.build.plans import PlacePlan, Plan, RenderingPlan
from skyline.errors import SkylineError
from skyline.geodesy import Bounds
from skyline.render.horizon import RenderConfig
from skyline.store import open_store
from skyline.store.format import PLACES
from skyline.store.merge import examine
from skyline.store.read import parts_folder
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.workers import ended, fork, outcome_of

_SIDE_M = 5000.0
"""Of the area that is built again and again."""
_PLACES_A_PART, _VIEWPOINTS_A_PART = 256, 16
"""Parts of a fraction of a second, so that builds are killed between many of them."""
_LONGER = 1.3
"""A build is killed at some time within so many times what an unbroken one takes."""
_KILLS_A_BUILD = 3
_LIMIT_S = 30


@dataclass(frozen=True, slots=True)
class DurabilityConfig:
    """How often stores are damaged."""

    dem: Path
    builds: int = 25
    flips: int = 300  # Of each kind of store
    cases: int = 500  # Mutated files of each kind of store


def _plans(terrain: HeightField, bounds_deg: Bounds) -> dict[str, tuple[Plan, int]]:
    """Return plans by name, each with a number of workers; 0 is this process."""
    views = RenderingPlan.uniform(terrain, 400.0, bounds_deg, RenderConfig(width=160))
    return {
        "planned places": (PlacePlan(None, bounds_deg, 0.3), 0),
        "places of a grid": (PlacePlan(80.0, bounds_deg), 0),
        "renderings": (views, 0),
        "places of a grid, 2 workers": (PlacePlan(60.0, bounds_deg), 2),
    }


def _start(terrain: HeightField, path: Path, plan: Plan, workers: int) -> tuple[int, int]:
    """Start a build in a process of its own, which leads a group of processes."""

    def work(_: object) -> None:
        os.setsid()
        with ExitStack() as held:
            runner = held.enter_context(local_runner(workers)) if workers else None
            build_store(terrain, path, plan, runner)

    return fork(work)


def _kills(config: DurabilityConfig, folder: Path) -> Iterator[Row]:
    # Nothing is rendered in this process: OpenGL does not outlive a fork.
    terrain, generator = read_dem([config.dem]), np.random.default_rng(0)
    plans._PLACES_A_PART, plans._VIEWPOINTS_A_PART = _PLACES_A_PART, _VIEWPOINTS_A_PART
    kinds = _plans(terrain, middle_of(terrain, _SIDE_M))
    for number, (name, (plan, workers)) in enumerate(kinds.items()):
        whole = folder / "whole.h5"
        started = time.perf_counter()
        ended(*_start(terrain, whole, plan, workers))
        lasts_s, unbroken = time.perf_counter() - started, whole.read_bytes()
        whole.unlink()
        tally = Counter(builds=0, kills=0, lost=0, equal=0)
        for _ in range(len(range(number, config.builds, len(kinds)))):
            path = folder / "killed.h5"
            for _ in range(_KILLS_A_BUILD):
                before = _parts(path)
                child = _start(terrain, path, plan, workers)
                time.sleep(generator.uniform(0.0, _LONGER * lasts_s))
                _kill_group(child[0])
                code, _ = ended(*child)
                if code == 0 or path.exists():
                    break
                tally["kills"] += 1
                after = _parts(path)
                tally["lost"] += sum(after.get(part) != data for part, data in before.items())
            ended(*_start(terrain, path, plan, workers))
            tally["builds"] += 1
            tally["equal"] += path.read_bytes() == unbroken and not parts_folder(path).exists()
            path.unlink()
        yield {"test": "kills", "rows": name, **tally, "unbroken_s": lasts_s}


def _kill_group(leader: int) -> None:
    for kill in (os.killpg, os.kill):
        try:
            kill(leader, signal.SIGKILL)
        except ProcessLookupError:
            continue


def _parts(path: Path) -> dict[str, bytes]:
    """Return the parts of a store by name."""
    return {part.name: part.read_bytes() for part in parts_folder(path).glob("*-of-*.h5")}


def _damage(config: DurabilityConfig, folder: Path) -> Iterator[Row]:
    terrain = read_dem([config.dem])
    kinds = _plans(terrain, middle_of(terrain, _SIDE_M))
    for name in ("places of a grid", "renderings"):
        whole = folder / f"{name}.h5"
        ended(*_start(terrain, whole, kinds[name][0], 0))
        yield {"test": "flips", "rows": name, **_flips(whole, folder, config.flips)}
        yield {"test": "mutated", "rows": name, **_mutations(whole, folder, config.cases)}


def _flips(whole: Path, folder: Path, flips: int) -> Row:
    """Flip one bit of a store at a time.

    Of the ``flips``, ``harmful`` ones change rows or keep them from being read, and ``found`` ones
    of these are found by `skyline store check`. ``silent`` ones get past readers of renderings, and
    past `take` of places; ``crashes`` are those and hangs of readers and of the check.
    """
    generator = np.random.default_rng(0)
    data, tally = bytearray(whole.read_bytes()), Counter[str]()
    path = folder / "flipped.h5"
    for _ in range(flips):
        place, bit = int(generator.integers(len(data))), 1 << int(generator.integers(8))
        data[place] ^= bit
        path.write_bytes(data)
        data[place] ^= bit
        read = outcome_of(partial(_read_as, path, whole), _LIMIT_S)
        checked = outcome_of(lambda: "whole" if examine(path).whole else "damaged", _LIMIT_S)
        harmful = read != "same"
        tally["harmful"] += harmful
        tally["found"] += harmful and checked == "damaged"
        tally["silent"] += read == "changed"
        ordinary = read in ("same", "changed", "refused") and checked in ("whole", "damaged")
        tally["crashes"] += not ordinary
    return {
        "flips": flips,
        **{key: tally[key] for key in ("harmful", "found", "silent", "crashes")},
    }


def _mutations(whole: Path, folder: Path, cases: int) -> Row:
    """Read mutated copies of a store; each must be read, or refused in one line."""
    generator, tally = np.random.default_rng(0), Counter[str]()
    data, path = whole.read_bytes(), folder / "mutated.h5"
    for _ in range(cases):
        path.write_bytes(mutated(data, generator))
        tally[outcome_of(partial(_read_as, path, whole), _LIMIT_S)] += 1
    read = tally.pop("same", 0) + tally.pop("changed", 0)
    return {"cases": cases, "read": read, "refused": tally.pop("refused", 0), "wrong": dict(tally)}


def _read_as(path: Path, whole: Path) -> str:
    """Read a store and return whether its rows are those of another."""
    try:
        with open_store(path) as store, open_store(whole) as reference:
            if store.header.holds == PLACES:
                store.places().take(np.arange(len(store)))
            wanted, got = reference.stored(), store.stored()
            same = store.header == reference.header and len(store) == len(reference)
            same = same and all(wanted[name].tobytes() == got[name].tobytes() for name in wanted)
        return "same" if same else "changed"
    except SkylineError as error:
        return "refused" if "\n" not in str(error) else "more than one line"


def mutated(data: bytes, generator: np.random.Generator) -> bytes:
    """Return bytes with one kind of random damage, more often than not near their beginning."""
    changed = bytearray(data)

    def place() -> int:
        near = min(len(changed), 16_384) if generator.random() < 0.6 else len(changed)
        return int(generator.integers(near))

    first, length = place(), int(2.0 ** generator.uniform(0.0, 12.0))
    last = min(first + length, len(changed))
    match int(generator.integers(8)):
        case 0:
            for _ in range(int(generator.integers(1, 30))):
                changed[place()] ^= 1 << int(generator.integers(8))
        case 1:
            changed[first:last] = bytes(last - first)
        case 2:
            changed[first:last] = b"\xff" * (last - first)
        case 3:
            changed[first:last] = generator.bytes(last - first)
        case 4:
            other = int(generator.integers(len(changed) - (last - first) + 1))
            changed[first:last] = changed[other : other + last - first]
        case 5:
            changed[first:first] = generator.bytes(length)
        case 6:
            del changed[first:last]
        case _:
            del changed[place() :]
    return bytes(changed)


def middle_of(terrain: HeightField, side_m: float) -> Bounds:
    """Return the middle of a DEM, a square of a side at most, in degrees."""
    west, south, east, north = terrain.bounds_m
    half = min(side_m, east - west, north - south) / 2.0
    east_m, north_m = (west + east) / 2.0, (south + north) / 2.0
    lon, lat = terrain.frame.to_lonlat(
        [east_m - half, east_m + half, east_m, east_m],
        [north_m, north_m, north_m - half, north_m + half],
    )
    return float(lon[0]), float(lat[2]), float(lon[1]), float(lat[3])


TESTS: dict[str, Callable[[DurabilityConfig, Path], Iterator[Row]]] = {
    "kills": _kills,
    "damage": _damage,
}
