"""What stores withstand: kills, flipped bits, mutated files, readers beside a writer; codings."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from skyline.pipeline.build import build_uniform
from skyline.pipeline.config import RenderConfig
from skyline.store import RowCoding, create_store, open_store
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.views import Views
from skyline_bench.measuring.record import Row
from skyline_bench.stores.durability import (
    Say,
    flip_test,
    fuzz_test,
    kill_test,
    numbered_build,
    numbered_header,
    readers_test,
)

Rows = Iterator[Row]

_SPACING_M = 500.0
"""Of the builds to kill."""

CODINGS = (
    (0.001, 0.0005),
    (0.0025, 0.001),
    (0.005, 0.001),
    (0.005, 0.005),
    (0.01, 0.005),
    (0.025, 0.01),
)
"""Greatest errors to compare: of skylines in px, of depths relative."""


@dataclass(frozen=True, slots=True)
class DurabilityConfig:
    """How much is done to stores."""

    dem: Path  # What builds to kill are made from
    stores: tuple[Path, ...] = ()  # Of exact rows, on which codings of compact rows are compared
    # Of each kind of store.
    kills: int = 200
    flips: int = 200
    cases: int = 500
    seconds: float = 60.0  # How long readers read
    renderings: int = 1024  # To compare codings on


def _rendered_build(terrain: HeightField, path: Path, say: Say) -> None:
    """Render a uniform grid into a store, or go on with it."""

    def progress(*_: int) -> None:
        with open_store(path) as store:
            say(len(store))

    build_uniform(terrain, path, _SPACING_M, config=RenderConfig(width=64), progress=progress)


def _coding_rows(path: Path, folder: Path, renderings: int) -> list[Row]:
    """Compare codings on some chunks of a store, spread evenly: bytes, errors, reading speed."""
    with open_store(path) as store:
        header = store.header
        starts = np.linspace(0, len(store) - 32, max(renderings // 32, 1)).astype(int)
        rows = np.unique((starts[:, np.newaxis] + np.arange(32)).ravel())
        exact, keypoints = store.views(rows), store.keypoint_columns(rows)
    table: list[Row] = []
    for errors in (None, *CODINGS):
        coding = RowCoding.within(header.width, *errors) if errors else None
        sample = folder / "sample.h5"
        with create_store(sample, replace(header, coding=coding), overwrite=True) as writer:
            started = time.process_time()
            writer.append(exact, keypoints)
            writer.flush()
            wrote_s = time.process_time() - started
        table.append(
            {
                "store": path.stem,
                "tan_error_px": errors[0] if errors else 0.0,
                "depth_error": errors[1] if errors else 0.0,
                "write_renderings_per_s": len(exact) / wrote_s,
                **_measured(sample, exact),
            }
        )
    return table


def _measured(path: Path, exact: Views) -> Row:
    """Return what a store takes on disk and to read, and how far its rows are from exact ones."""
    for _ in range(2):
        # Opened again, since HDF5 keeps unpacked chunks of an open file.
        with open_store(path) as store:
            started = time.process_time()
            views = store.views()
            seconds = time.process_time() - started
    off_px = np.abs(views.elevation_tan.astype(float) - exact.elevation_tan) * exact.width / 2.0
    off_depth = np.abs(views.depth_m.astype(float) / exact.depth_m - 1.0)
    size = path.stat().st_size
    return {
        "measured_px": float(np.nanmax(off_px)),
        "measured_depth": float(np.nanmax(off_depth)),
        "renderings": len(exact),
        "bytes_per_rendering": size / len(exact),
        "read_renderings_per_s": len(exact) / seconds,
        "read_mb_per_s": size / seconds / 1e6,
    }


def _coding(config: DurabilityConfig, folder: Path) -> Rows:
    for store in config.stores:
        yield from _coding_rows(store, folder, config.renderings)


def _damage(test: str, config: DurabilityConfig, folder: Path) -> Rows:
    for rows in ("compact", "exact", "places"):
        whole, header = folder / f"{rows}.h5", numbered_header(640, rows)
        numbered_build(1500 if rows == "places" else 320, header)(whole, lambda _: None)
        if test == "flips":
            yield {"rows": rows, **flip_test(whole, folder, config.flips)}
        else:
            yield {"rows": rows, **fuzz_test(whole, folder, config.cases)}


def _kills_of_writer(config: DurabilityConfig, folder: Path) -> Rows:
    for rows, count in (("compact", 1000), ("places", 20_000)):
        into = folder / rows
        into.mkdir()
        build = numbered_build(count, numbered_header(rows=rows))
        yield {"rows": rows, **kill_test(build, into, config.kills)}


def _kills_of_build(config: DurabilityConfig, folder: Path) -> Rows:
    # Nothing is rendered in this process: OpenGL does not outlive a fork.
    terrain = read_dem([config.dem])
    yield kill_test(partial(_rendered_build, terrain), folder, config.kills)


def _readers(config: DurabilityConfig, folder: Path) -> Rows:
    for rows in ("compact", "places"):
        into = folder / rows
        into.mkdir()
        yield {"kind": rows, **readers_test(into, 8, config.seconds, rows)}


TESTS: dict[str, Callable[[DurabilityConfig, Path], Rows]] = {
    "coding": _coding,
    "flips": partial(_damage, "flips"),
    "mutated": partial(_damage, "mutated"),
    "kills-of-a-writer": _kills_of_writer,
    "kills-of-a-build": _kills_of_build,
    "readers": _readers,
}


def measure(config: DurabilityConfig, tests: Iterable[str], folder: Path) -> Rows:
    """Yield rows of the named `TESTS`, whose files go to a folder."""
    for test in tests:
        (folder / test).mkdir()
        for row in TESTS[test](config, folder / test):
            yield {"test": test.replace("-", " "), **row}
