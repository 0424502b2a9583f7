"""Kill builds, flip bits, mutate files, read beside a writer: python bench/store_durability.py DEM.

Writes bench/results/store_durability.json. --stores names stores of exact rows, on which codings of
compact rows are compared.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from skyline.pipeline import RenderConfig, build_uniform
from skyline.store import RowCoding, create_store, open_store
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.views import Views
from skyline_bench.measuring.record import write_record
from skyline_bench.stores.damage import flip_test, fuzz_test
from skyline_bench.stores.durability import (
    Say,
    kill_test,
    numbered_build,
    numbered_header,
    readers_test,
)

Rows = Iterator[dict[str, object]]

RESULT = Path(__file__).parent / "results" / "store_durability.json"

CODINGS = (
    (0.001, 0.0005),
    (0.0025, 0.001),
    (0.005, 0.001),
    (0.005, 0.005),
    (0.01, 0.005),
    (0.025, 0.01),
)
"""Greatest errors to compare: of skylines in px, of depths relative."""


def rendered_build(terrain: HeightField, spacing_m: float, path: Path, say: Say) -> None:
    """Render a uniform grid into a store, or go on with it."""

    def progress(*_: int) -> None:
        with open_store(path) as store:
            say(len(store))

    build_uniform(terrain, path, spacing_m, config=RenderConfig(width=64), progress=progress)


def coding_rows(path: Path, folder: Path, renderings: int) -> list[dict[str, object]]:
    """Compare codings on some chunks of a store, spread evenly: bytes, errors, reading speed."""
    with open_store(path) as store:
        header = store.header
        starts = np.linspace(0, len(store) - 32, max(renderings // 32, 1)).astype(int)
        rows = np.unique((starts[:, np.newaxis] + np.arange(32)).ravel())
        exact, keypoints = store.views(rows), store.keypoint_columns(rows)
    table = []
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
                "shells": max(len(header.shell_edges_m) - 1, 0),
                "tan_error_px": errors[0] if errors else 0.0,
                "depth_error": errors[1] if errors else 0.0,
                "write_renderings_per_s": len(exact) / wrote_s,
                **measured(sample, exact),
            }
        )
    return table


def measured(path: Path, exact: Views) -> dict[str, object]:
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dem", type=Path)
    parser.add_argument("--only", nargs="*", default=list(TESTS), choices=TESTS)
    parser.add_argument("--spacing", type=float, default=500.0, help="of the builds to kill, m")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--flips", type=int, default=200)
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--renderings", type=int, default=1024, help="to compare codings on")
    parser.add_argument("--stores", type=Path, nargs="*", default=[])
    arguments = parser.parse_args()
    kept = json.loads(RESULT.read_text())["rows"] if RESULT.exists() else []
    table: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as temporary:
        for test in arguments.only:
            folder = Path(temporary) / test
            folder.mkdir()
            for row in TESTS[test](folder, arguments):
                table.append({"test": test, **row})
                print(json.dumps(table[-1]), flush=True)
    kept = [row for row in kept if row["test"] not in arguments.only]
    write_record(RESULT, "store-durability", [*kept, *table])


def coding(folder: Path, arguments: argparse.Namespace) -> Rows:
    for store in arguments.stores:
        yield from coding_rows(store, folder, arguments.renderings)


def damage(test: str, folder: Path, arguments: argparse.Namespace) -> Rows:
    for rows in ("compact", "exact", "places"):
        whole, header = folder / f"{rows}.h5", numbered_header(640, rows)
        numbered_build(1500 if rows == "places" else 320, header)(whole, lambda _: None)
        if test == "flips":
            yield {"rows": rows, **flip_test(whole, folder, arguments.flips)}
        else:
            yield {"rows": rows, **fuzz_test(whole, folder, arguments.cases)}


def kills_of_writer(folder: Path, arguments: argparse.Namespace) -> Rows:
    for rows, count in (("compact", 1000), ("places", 20_000)):
        into = folder / rows
        into.mkdir()
        build = numbered_build(count, numbered_header(rows=rows))
        yield {"rows": rows, **kill_test(build, into, arguments.kills)}


def kills_of_build(folder: Path, arguments: argparse.Namespace) -> Rows:
    # Nothing is rendered in this process: OpenGL does not outlive a fork.
    terrain = read_dem([arguments.dem])
    yield kill_test(partial(rendered_build, terrain, arguments.spacing), folder, arguments.kills)


def readers(folder: Path, arguments: argparse.Namespace) -> Rows:
    for rows in ("compact", "places"):
        into = folder / rows
        into.mkdir()
        yield {"kind": rows, **readers_test(into, 8, arguments.seconds, rows)}


TESTS: dict[str, Callable[[Path, argparse.Namespace], Rows]] = {
    "coding": coding,
    "flips": partial(damage, "flips"),
    "mutated": partial(damage, "mutated"),
    "kills of a writer": kills_of_writer,
    "kills of a build": kills_of_build,
    "readers": readers,
}


if __name__ == "__main__":
    main()
