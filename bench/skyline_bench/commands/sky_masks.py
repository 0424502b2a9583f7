"""Skylines extracted from real photographs, compared with masks that people drew of the mountains.

A folder holds ``NAME.jpg`` and ``NAME.mask.png``, white = mountain, of one size. Only the white's
upper edge counts, and only columns that have one: below it lakes and forests are black in many.
Names are split in two by their hash: one half to develop on, one that is only ever measured.
"""

import hashlib
import tempfile
import time
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from PIL import Image
from typer import Argument

from skyline.arrays import Float64Array, UInt8Array
from skyline.console import progress_bar
from skyline.errors import InputError
from skyline.photo.read import extract_photo
from skyline.photo.sky_model import topmost_border
from skyline.pipeline.jobs import Progress
from skyline_bench.commands import options
from skyline_bench.measuring.record import Row

_NEAR_SHARE = 0.01
"""Share of the image's height within which a row is right."""
_LARGE_PX = (4000, 3000)
_LARGE_PHOTOS = 3
_JPEG_QUALITY = 92


def sky_masks(
    folder: Annotated[
        Path, Argument(metavar="FOLDER", help="NAME.jpg and NAME.mask.png, white = mountain.")
    ],
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
) -> None:
    """Skylines extracted from real photographs, against masks drawn by people."""
    with progress_bar("photographs") as progress:
        rows = measure(folder, quick, progress)
    options.report(json_file, "sky-masks", rows)


def measure(folder: Path, quick: bool, progress: Progress) -> list[Row]:
    """Measure both halves of a folder, or two photographs of each, one core.

    ``within`` is the share of the trusted columns that lie within 1 % of the image's height, and
    ``trusted`` that of the columns whose mask has an edge, refused photographs' too, that are
    trusted. ``mostly_wrong`` are photographs with most of their trusted columns farther off.
    ``seconds`` and ``seconds_12mp`` are processor time a photograph, from the file to the skyline,
    as it is, and the first three enlarged to 12 megapixels.
    """
    cv2.setNumThreads(1)
    names = sorted(
        (path.name.removesuffix(".mask.png") for path in folder.glob("*.mask.png")),
        key=lambda name: hashlib.sha256(name.encode()).hexdigest(),
    )
    if len(names) < 2:
        raise InputError(f"{folder} has {len(names)} masks NAME.mask.png; expected two or more")
    middle = len(names) // 2
    halves = {"development": names[:middle], "held out": names[middle:]}
    rows, done = list[Row](), 0
    for half, members in halves.items():
        found = []
        for name in members[: 2 if quick else None]:
            found.append(_counted(folder, name))
            done += 1
            progress(done, 4 if quick else len(names))
        trusted, right, columns, seconds = np.array(found).T
        large = [_large_seconds(folder / f"{name}.jpg") for name in members[:_LARGE_PHOTOS]]
        rows.append(
            {
                "half": half,
                "photos": len(found),
                "refused": int((trusted == 0).sum()),
                "within": float(right.sum() / max(trusted.sum(), 1)),
                "trusted": float(trusted.sum() / max(columns.sum(), 1)),
                "mostly_wrong": int((2 * right < trusted).sum()),
                "seconds": float(seconds.mean()),
                "seconds_12mp": float(np.median(large)),
            }
        )
    return rows


def _large_seconds(path: Path) -> float:
    """Return the processor time of a photograph's skyline at 12 megapixels."""
    with Image.open(path) as photo, tempfile.TemporaryDirectory() as folder:
        enlarged = Path(folder) / path.name
        photo.convert("RGB").resize(_LARGE_PX).save(enlarged, quality=_JPEG_QUALITY)
        return _timed(enlarged)[1]


def _timed(path: Path) -> tuple[Float64Array | None, float]:
    """Return a photograph's skyline, None where it is refused, and the processor time."""
    started = time.process_time()
    try:
        row_px = extract_photo(path)[1].row_px
    except InputError:
        row_px = None
    return row_px, time.process_time() - started


def _counted(folder: Path, name: str) -> tuple[float, ...]:
    """Return trusted, right and true columns of a photograph, and the processor time."""
    mask = cv2.imread(str(folder / f"{name}.mask.png"), cv2.IMREAD_GRAYSCALE)
    if mask is None:
        raise InputError(f"{name}.mask.png cannot be read; expected a mask, white = mountain")
    truth = mask_rows(np.asarray(mask, dtype=np.uint8))
    row_px, seconds = _timed(folder / f"{name}.jpg")
    if row_px is None:
        row_px = np.full_like(truth, np.nan)
    if len(row_px) != len(truth):
        raise InputError(
            f"{name}: the mask has {len(truth)} columns, the photograph {len(row_px)}; expected "
            "one size"
        )
    trusted = np.isfinite(truth) & np.isfinite(row_px)
    right = np.abs(row_px - truth)[trusted] <= _NEAR_SHARE * len(mask)
    return trusted.sum(), right.sum(), np.isfinite(truth).sum(), seconds


def mask_rows(mask: UInt8Array) -> Float64Array:
    """Return the upper edge of a mask's white in each column, (W,); NaN where there is none."""
    return topmost_border((mask <= 127).astype(np.float64), 0.5)[0]
