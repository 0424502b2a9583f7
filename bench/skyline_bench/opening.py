"""Opening: the time of one answer in a new process.

The first answer about a DEM is timed, and the next.
"""

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Option

from skyline import build_places, read_dem
from skyline.cli.terminal import Terminal
from skyline.errors import SkylineError
from skyline.geodesy.map_frame import Rectangle
from skyline.photo.trace import write_trace
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline_bench import options
from skyline_bench.measuring import Timing, middle_of, timed
from skyline_bench.queries.synthetic import make_queries

_SIDE_KM = 26.0
"""A square of this side has the 700 km2 of the largest area that `locate` makes by itself."""
_RUNS = "first", "next"
"""Runs of a command with one cache."""


def opening(
    dem: options.Dems,
    record: options.Record = None,
    side_km: Annotated[float, Option(min=1.0, help="Side of the store's area.")] = _SIDE_KM,
    rounds: Annotated[int, Option(min=1, help="Runs of each command; medians are shown.")] = 3,
    seed: options.Seed = 0,
    quick: Annotated[bool, options.quick_with(side_km=2.0, rounds=1)] = False,
    crs: options.Crs = None,
) -> None:
    """Seconds of an answer in a new process: a DEM's first, and the next.

    Before the first run of `horizon` and `orient` nothing is known of the DEM; `match` searches a
    store of the DEM's middle, whose build has read it. The trace is a synthetic query's. Files stay
    in the system's memory between the runs.
    """
    terrain = read_dem(dem, DemOptions(crs=crs))
    box_m = middle_of(terrain.bounds_m, (1000.0 * side_km, 1000.0 * side_km))
    with ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="skyline-bench-")))
        progress = held.enter_context(Terminal().progress("measuring"))
        commands = _commands(terrain, dem, crs, box_m, seed, folder)
        rows = []
        for number, (name, words) in enumerate(commands.items()):
            timings = [
                [_run(words, cache, folder) for _ in _RUNS]
                for cache in (_cache(name, folder, each) for each in range(rounds))
            ]
            rows += [
                {"command": name, "run": run, **asdict(Timing.median_of(some)), "rounds": rounds}
                for run, some in zip(_RUNS, zip(*timings, strict=True), strict=True)
            ]
            progress(number + 1, len(commands))
    options.report(record, rows, terrain=terrain)


def _commands(
    terrain: HeightField,
    dem: Sequence[str],
    crs: str | None,
    box_m: Rectangle,
    seed: int,
    folder: Path,
) -> Mapping[str, Sequence[str]]:
    """Return the commands to measure.

    Their store and their trace are made here.
    """
    (query,) = make_queries(terrain, box_m, 1, seed)
    trace = folder / "query.csv"
    write_trace(query.skyline, trace)
    fov = f"{query.given_fov_deg:.6g}"
    lon, lat = query.truth.lonlat(terrain.frame)
    at = f"{lon:.6f},{lat:.6f}"
    west, south, east, north = box_m
    bounds = terrain.frame.box_deg(easting_m=[west, east], northing_m=[south, north])
    store = folder / "store.h5"
    build_places(terrain, store, bounds_deg=bounds)
    files = [str(Path(one).absolute()) for one in dem]
    of_crs = [] if crs is None else ["--crs", crs]
    named = [word for one in files for word in ("--dem", one)]
    return {
        "horizon": ["horizon", *files, *of_crs, "--at", at],
        "orient": ["orient", str(trace), *named, *of_crs, "--at", at, "--fov-deg", fov],
        "match": ["match", str(store), str(trace), "--fov-deg", fov],
    }


def _cache(name: str, folder: Path, number: int) -> Path | None:
    """Return the empty cache of a round.

    Returns None for a command that uses the cache left by the build of its store.
    """
    if name == "match":
        return None
    cache = folder / f"cache-{number}"
    shutil.rmtree(cache, ignore_errors=True)
    return cache


def _run(words: Sequence[str], cache: Path | None, folder: Path) -> Timing:
    """Run a command in a new process, and return its time."""
    environment = dict(os.environ)
    if cache is not None:
        environment["SKYLINE_CACHE"] = str(cache)
    run = partial(
        subprocess.run,
        [sys.executable, "-m", "skyline", *words],
        env=environment,
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done, timing = timed(run)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise SkylineError(f"skyline {words[0]} failed: {done.stderr.strip()}")
    cpu_seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Timing(timing.seconds, cpu_seconds)
