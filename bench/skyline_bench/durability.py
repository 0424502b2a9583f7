"""Durability of builds, stores and commands.

Builds are killed, bits of stores flip, and files of every kind are damaged.
"""

import contextlib
import io
import math
import multiprocessing
import os
import re
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from typer import Option

from skyline import cli
from skyline.errors import SkylineError
from skyline.geodesy.bounds import Bounds
from skyline.render.horizon import RenderConfig
from skyline.store.check import examine, is_whole
from skyline.store.layout import PLACES
from skyline.store.read import open_store, parts_folder
from skyline.survey.build import build_store
from skyline.survey.cluster import runner_of
from skyline.survey.part_files import PartSize
from skyline.survey.plans import JobSize, PlacePlan, Plan, RenderingPlan, map_bounds
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline_bench import options
from skyline_bench.geotiff import write_geotiff
from skyline_bench.measuring import Row, square_km, timed
from skyline_bench.records import write_record
from skyline_bench.search.stores import middle_deg

_SIDE_M, _QUICK_SIDE_M = 5000.0, 2000.0
"""Sides of the area that is built again and again, by default and with ``--quick``."""
_JOB_OF_PLACES = JobSize(256, 64)
_JOB_OF_VIEWS = JobSize(16, 4)
_PART = PartSize(seconds=0.05)
"""Jobs and parts take a fraction of a second, so that builds are killed between many of them."""
_LONGER = 1.3
"""A build is killed within the time of an unbroken build, times this."""
_KILLS_A_BUILD = 3
_READ_S, _COMMAND_S = 30, 60
"""A reader, or a command, that takes longer on such small files hangs."""
_WEST_M, _NORTH_M, _SPACING_M = 600_000.0, 5_180_000.0, 30.0

_COLUMNS = {
    "kills": "test rows km2 builds=n kills lost equal unbroken_s",
    "flips": "test rows km2 flips=n harmful found silent crashes",
    "mutated": "test rows km2 cases=n read refused wrong",
}
"""Columns of the printed tables, by test."""

_Plans = dict[str, tuple[Plan, int]]
"""Plans by name, each with a number of workers; 0 is this process."""


def _plans(terrain: HeightField, bounds_deg: Bounds) -> _Plans:
    """Return the plans of the stores that are built."""
    places = PlacePlan(None, bounds_deg, job_size=_JOB_OF_PLACES)
    views = RenderingPlan.uniform(terrain, 400.0, bounds_deg, RenderConfig(width=160))
    return {
        "planned places": (replace(places, places=400), 0),
        "places of a grid": (replace(places, spacing_m=80.0), 0),
        "renderings": (replace(views, job_size=_JOB_OF_VIEWS), 0),
        "places of a grid, 2 workers": (replace(places, spacing_m=60.0), 2),
    }


def _start(terrain: HeightField, path: Path, plan: Plan, workers: int) -> ForkProcess:
    """Start a build in a process that leads a group."""

    def work() -> None:
        os.setsid()
        with runner_of(str(workers) if workers else None) as runner:
            build_store(terrain, path, plan, runner, part_size=_PART)

    process = _FORK.Process(target=work)
    process.start()
    return process


def _kills(terrain: HeightField, kinds: _Plans, builds: int, folder: Path) -> Iterator[Row]:
    """Kill builds at random instants, and let the same command finish them."""
    # Nothing is rendered in this process: OpenGL does not outlive a fork.
    generator = np.random.default_rng(0)
    for number, (name, (plan, workers)) in enumerate(kinds.items()):
        whole = folder / "whole.h5"
        _, timing = timed(_start(terrain, whole, plan, workers).join)
        lasts_s = timing.seconds
        unbroken = whole.read_bytes()
        whole.unlink()
        tally = Counter(builds=0, kills=0, lost=0, equal=0)
        for _ in range(number, builds, len(kinds)):
            path = folder / "killed.h5"
            for _ in range(_KILLS_A_BUILD):
                before = _kept(path)
                build = _start(terrain, path, plan, workers)
                build.join(generator.uniform(0.0, _LONGER * lasts_s))
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(build.pid or 0, signal.SIGKILL)  # Its workers too
                build.kill()
                build.join()
                if build.exitcode == 0 or path.exists():
                    break
                tally["kills"] += 1
                after = _kept(path)
                tally["lost"] += sum(after.get(job, 0) < rows for job, rows in before.items())
            _start(terrain, path, plan, workers).join()
            tally["builds"] += 1
            tally["equal"] += path.read_bytes() == unbroken and not parts_folder(path).exists()
            path.unlink()
        yield {"test": "kills", "rows": name, **tally, "unbroken_s": lasts_s}


def _kept(path: Path) -> dict[int, float]:
    """Return how many rows of each job are in whole parts.

    The number is infinite for a finished job.
    """
    kept: dict[int, float] = {}
    for part in parts_folder(path).rglob("*-of-*.h5"):
        first, last = map(int, re.findall("[0-9]+", part.name)[:2])
        with open_store(part) as store:
            if is_whole(store) and "-from-" in part.name:
                kept[first] = max(kept.get(first, 0), last + len(store))
            elif is_whole(store):
                kept |= dict.fromkeys(range(first, last + 1), math.inf)
    return kept


def _damage(
    terrain: HeightField, kinds: _Plans, flips: int, cases: int, folder: Path
) -> Iterator[Row]:
    """Flip bits of stores, and mutate their files."""
    for name in ("places of a grid", "renderings"):
        whole = folder / f"{name}.h5"
        _start(terrain, whole, kinds[name][0], 0).join()
        yield {"test": "flips", "rows": name, **_flips(whole, folder, flips)}
        yield {"test": "mutated", "rows": name, **_mutations(whole, folder, cases)}


def _flips(whole: Path, folder: Path, flips: int) -> Row:
    """Flip one bit of a store at a time.

    Of the ``flips``, ``harmful`` ones change rows or keep them from being read, and ``found`` ones
    of these are found by `skyline store check`. ``silent`` ones get past readers of renderings, and
    past `take` of places; ``crashes`` are crashes and hangs of readers and of the check.
    """
    generator = np.random.default_rng(0)
    data = bytearray(whole.read_bytes())
    tally = Counter[str]()
    path = folder / "flipped.h5"
    for _ in range(flips):
        place = int(generator.integers(len(data)))
        bit = 1 << int(generator.integers(8))
        data[place] ^= bit
        path.write_bytes(data)
        data[place] ^= bit
        read = outcome_of(partial(_read_as, path, whole), _READ_S)
        checked = outcome_of(lambda: "whole" if examine(path).whole else "damaged", _READ_S)
        harmful = read != "same"
        tally["harmful"] += harmful
        tally["found"] += harmful and checked == "damaged"
        tally["silent"] += read == "changed"
        ordinary = read in ("same", "changed", "refused") and checked in ("whole", "damaged")
        tally["crashes"] += not ordinary
    return {"flips": flips} | {key: tally[key] for key in ("harmful", "found", "silent", "crashes")}


def _mutations(whole: Path, folder: Path, cases: int) -> Row:
    """Read mutated copies of a store.

    Each must be read, or refused in one line.
    """
    generator = np.random.default_rng(0)
    tally = Counter[str]()
    data = whole.read_bytes()
    path = folder / "mutated.h5"
    for _ in range(cases):
        path.write_bytes(mutated(data, generator))
        tally[outcome_of(partial(_read_as, path, whole), _READ_S)] += 1
    read = tally.pop("same", 0) + tally.pop("changed", 0)
    return {"cases": cases, "read": read, "refused": tally.pop("refused", 0), "wrong": dict(tally)}


def _read_as(path: Path, whole: Path) -> str:
    """Read a store and return whether it has the rows of another."""
    try:
        with open_store(path) as store, open_store(whole) as reference:
            if store.header.holds == PLACES:
                store.places().take(np.arange(len(store)))
            wanted = reference.stored()
            got = store.stored()
            same = store.header == reference.header and len(store) == len(reference)
            same = same and all(wanted[name].tobytes() == got[name].tobytes() for name in wanted)
        return "same" if same else "changed"
    except SkylineError as error:
        return "refused" if "\n" not in str(error) else "more than one line"


def mutated(data: bytes, generator: np.random.Generator) -> bytes:
    """Return bytes with one kind of random damage.

    More often than not the damage is near their beginning.
    """
    changed = bytearray(data)

    def place() -> int:
        near = min(len(changed), 16_384) if generator.random() < 0.6 else len(changed)
        return int(generator.integers(near))

    first = place()
    length = int(2.0 ** generator.uniform(0.0, 12.0))
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


def _command(arguments: list[object]) -> str:
    """Run a command, and return how it ended.

    The end is "answered", "refused", or a description of any other end.
    """
    errors = io.StringIO()
    sys.argv = ["skyline", *map(str, arguments)]
    code: object = 0
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
            cli.main()
    except SystemExit as stop:
        code = stop.code or 0
    text = errors.getvalue()
    if code == 0:
        return "answered"
    if code == 2 and text.count("\n") == 1 and text.startswith("error: "):
        return "refused"
    return f"code {code}: {text!r}"


_Command = Callable[[Path], list[object]]
"""Gives the arguments of the command that reads a file."""


def _good_files(folder: Path) -> dict[str, tuple[bytes, _Command]]:
    """Return good files and the commands that read them, by suffix."""
    generator = np.random.default_rng(0)
    heights = generator.normal(0.0, 9.0, (40, 40)).cumsum(0).cumsum(1).astype(np.float32)
    corner = (_WEST_M, _NORTH_M)
    step = (_SPACING_M, _SPACING_M)
    dem = write_geotiff(folder / "good.tif", heights, "EPSG:32632", corner, step)
    store = folder / "store.h5"
    outcome_of(partial(_command, ["build", dem, "-o", store, "--spacing", 300]), _COMMAND_S)
    ascii_dem = "ncols 40\nnrows 40\nxllcorner 600000\nyllcorner 5178800\ncellsize 30\n"
    ascii_dem += "\n".join(" ".join(f"{height:.1f}" for height in row) for row in heights)
    viewpoints = "easting,northing\n" + "".join(
        f"{_WEST_M + 300 + 20 * k},{_NORTH_M - 400 - 10 * k}\n" for k in range(6)
    )
    trace = "# width=200 height=100\ncolumn_px,row_px\n" + "".join(
        f"{k},{40 + 10 * np.sin(k / 9):.2f}\n" for k in range(200)
    )
    rows = np.arange(120)[:, np.newaxis]
    ridge = 60 + 20 * np.sin(np.arange(200) / 15)
    photo = np.where((rows < ridge)[..., np.newaxis], (230, 180, 120), (40, 60, 50))
    jpeg, png = (cv2.imencode(kind, photo.astype(np.uint8))[1] for kind in (".jpg", ".png"))
    matching = "--fov-deg", 60, "--matcher", "unrefined"
    rendering = "-o", folder / "o.h5", "--viewpoints"
    return {
        "tif": (dem.read_bytes(), lambda path: ["info", path]),
        "asc": (ascii_dem.encode(), lambda path: ["info", path, "--crs", "EPSG:32632"]),
        "csv": (viewpoints.encode(), lambda path: ["render", dem, *rendering, path]),
        "trace.csv": (trace.encode(), lambda path: ["match", store, path, *matching]),
        "jpg": (jpeg.tobytes(), lambda path: ["extract", path, "-o", folder / "jpg-out.csv"]),
        "png": (png.tobytes(), lambda path: ["extract", path, "-o", folder / "png-out.csv"]),
    }


def _damaged_files(cases: int, seed: int) -> Iterator[Row]:
    """Yield how commands ended on damaged files, by kind of file.

    These are the numbers answered, refused and wrong, of ``cases`` files of each kind.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for suffix, (data, command) in _good_files(folder).items():

            def end(path: Path, content: bytes, command: _Command = command) -> str:
                path.write_bytes(content)
                (folder / "o.h5").unlink(missing_ok=True)
                found = outcome_of(lambda: _command(command(path)), _COMMAND_S)
                path.unlink()
                return found

            if end(folder / f"whole.{suffix}", data) != "answered":
                raise SkylineError(f"the whole {suffix} is not answered; damage would show nothing")
            generator = np.random.default_rng(seed)
            ends = Counter(
                end(folder / f"case-{case}.{suffix}", mutated(data, generator))
                for case in range(cases)
            )
            counts = {name: ends.pop(name, 0) for name in ("answered", "refused")}
            yield {"file": suffix, "cases": cases, **counts, "wrong": dict(ends)}


_FORK = multiprocessing.get_context("fork")


def outcome_of(work: Callable[[], str], limit_s: int) -> str:
    """Return the text of work that runs in another process.

    If the work fails, the text is "raised", "hang" or "crash". This process must not render, since
    OpenGL does not outlive a fork.
    """
    receiving, sending = _FORK.Pipe(duplex=False)
    with receiving, sending:
        process = _FORK.Process(target=lambda: sending.send(work()))
        process.start()
        process.join(limit_s)
        if process.exitcode is None:
            process.kill()
            process.join()
            return "hang"
        if process.exitcode == 0:
            return str(receiving.recv())
        return "raised" if process.exitcode == 1 else "crash"


def store_durability(
    dem: Annotated[
        str,
        options.read_argument("DEM", "The DEM from which stores are built."),
    ],
    builds: Annotated[int, Option(min=0, help="Builds to kill.")] = 25,
    flips: Annotated[int, Option(min=0, help="Bits to flip in each store, one at a time.")] = 300,
    cases: Annotated[int, Option(min=0, help="Mutated files of each store.")] = 500,
    record: options.Record = None,
    quick: Annotated[bool, options.quick_with(builds=4, flips=5, cases=10)] = False,
) -> None:
    """Killed builds, flipped bits, mutated files of stores: what is lost.

    Builds are killed at random instants, those by workers too. A flipped bit must be found, and a
    mutated file must be read, or refused in one line.
    """
    terrain = read_dem([dem])
    side_m = _QUICK_SIDE_M if quick else _SIDE_M
    area_deg = middle_deg(terrain, (side_m, side_m))
    kinds = _plans(terrain, area_deg)
    km2 = square_km(map_bounds(terrain, area_deg))
    rows: list[Row] = []
    for test in (
        partial(_kills, terrain, kinds, builds),
        partial(_damage, terrain, kinds, flips, cases),
    ):
        with tempfile.TemporaryDirectory() as folder:
            for row in test(Path(folder)):
                rows.append({**row, "km2": km2})
                options.print_rows(rows[-1:], _COLUMNS[row["test"]])
    # At the end: a record names the renderer, and OpenGL does not outlive the forks of these tests.
    write_record(record, rows, terrain=terrain, bounds_deg=area_deg)


def input_fuzz(
    cases: Annotated[int, Option(min=1, help="Damaged files of each kind.")] = 250,
    record: options.Record = None,
    seed: options.Seed = 0,
    quick: Annotated[bool, options.quick_with(cases=10)] = False,
) -> None:
    """Damaged input files: how commands end on them.

    The files are DEMs, viewpoint lists, traces and images. Each command must end with one line and
    exit code 2, or with an answer.
    """
    rows: list[Row] = []
    for row in _damaged_files(cases, seed):
        rows.append(row)
        typer.echo(f"{row['file']}: {row['cases']} files", err=True)
    options.report(record, rows, "file cases=n answered refused wrong")
