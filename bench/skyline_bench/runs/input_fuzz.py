"""Damaged DEMs, viewpoint lists, traces and images: exit 2 and one line, or an answer.

Each case is a small good file, mutated, and given to the command that reads it, in this process.
"""

import contextlib
import io
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from skyline import cli
from skyline.errors import SkylineError
from skyline_bench.measuring.geotiff import write_geotiff
from skyline_bench.measuring.record import Row
from skyline_bench.runs.store_durability import mutated

LIMIT_S = 60
WEST, NORTH, SPACING_M = 600_000.0, 5_180_000.0, 30.0


class Hang(BaseException):
    """A command took longer than any of these files may."""


def ended(arguments: list[object]) -> str:
    """Run a command; say how it ended: answered, refused, or what is wrong with its end."""
    out, err = io.StringIO(), io.StringIO()
    sys.argv = ["skyline", *map(str, arguments)]
    signal.alarm(LIMIT_S)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            cli.main()
        code: object = 0
    except SystemExit as stop:
        code = stop.code or 0
    except Hang:
        return "hang"
    except BaseException as error:
        return f"raised {type(error).__name__}"
    finally:
        signal.alarm(0)
    told = err.getvalue()
    if code == 0:
        return "answered"
    if code == 2 and told.count("\n") == 1 and told.startswith("error: "):
        return "refused"
    return f"code {code}: {told!r}"


def good_files(folder: Path) -> dict[str, tuple[bytes, Callable[[Path], list[object]]]]:
    """Return good files and the commands that read them, by suffix."""
    generator = np.random.default_rng(0)
    heights = generator.normal(0.0, 9.0, (40, 40)).cumsum(0).cumsum(1).astype(np.float32)
    corner, step = (WEST, NORTH), (SPACING_M, SPACING_M)
    dem = write_geotiff(folder / "good.tif", heights, "EPSG:32632", corner, step)
    store = folder / "store.h5"
    ended(["build", dem, "-o", store, "--spacing", 300])
    ascii_dem = (
        "ncols 40\nnrows 40\nxllcorner 600000\nyllcorner 5178800\ncellsize 30\n"
        + "\n".join(" ".join(f"{height:.1f}" for height in row) for row in heights)
    )
    viewpoints = "easting,northing\n" + "".join(
        f"{WEST + 300 + 20 * k},{NORTH - 400 - 10 * k}\n" for k in range(6)
    )
    trace = "# width=200 height=100\ncolumn_px,row_px\n" + "".join(
        f"{k},{40 + 10 * np.sin(k / 9):.2f}\n" for k in range(200)
    )
    rows = np.arange(120)[:, np.newaxis]
    ridge = 60 + 20 * np.sin(np.arange(200) / 15)
    photo = np.where((rows < ridge)[..., np.newaxis], (230, 180, 120), (40, 60, 50)).astype(
        np.uint8
    )
    jpeg = cv2.imencode(".jpg", photo)[1].tobytes()
    png = cv2.imencode(".png", photo)[1].tobytes()
    return {
        "tif": (dem.read_bytes(), lambda path: ["info", path]),
        "asc": (ascii_dem.encode(), lambda path: ["info", path, "--crs", "EPSG:32632"]),
        "csv": (
            viewpoints.encode(),
            lambda path: ["render", dem, "--viewpoints", path, "-o", folder / "o.h5"],
        ),
        "trace.csv": (
            trace.encode(),
            lambda path: ["match", store, path, "--fov-deg", 60, "--matcher", "unrefined"],
        ),
        "jpg": (jpeg, lambda path: ["extract", path, "-o", folder / "jpg-out.csv"]),
        "png": (png, lambda path: ["extract", path, "-o", folder / "png-out.csv"]),
    }


def _too_long(_signal: int, _frame: object) -> None:
    raise Hang


def measure(cases: int, seed: int) -> Iterator[Row]:
    """Yield how many of so many damaged files of each kind were answered, and how many refused."""
    signal.signal(signal.SIGALRM, _too_long)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for suffix, (data, command) in good_files(folder).items():
            whole = folder / f"whole.{suffix}"
            whole.write_bytes(data)
            if ended(command(whole)) != "answered":
                raise SkylineError(f"the whole {suffix} is not answered; damage would show nothing")
            (folder / "o.h5").unlink(missing_ok=True)
            generator = np.random.default_rng(seed)
            ends: Counter[str] = Counter()
            for case in range(cases):
                path = folder / f"case-{case}.{suffix}"
                path.write_bytes(mutated(data, generator))
                ends[ended(command(path))] += 1
                path.unlink()
                (folder / "o.h5").unlink(missing_ok=True)
            counts = {end: ends.pop(end, 0) for end in ("answered", "refused")}
            yield {"file": suffix, "cases": cases, **counts, "wrong": dict(ends)}
