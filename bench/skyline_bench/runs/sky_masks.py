"""Skylines extracted from real photographs, compared with masks that people drew of the mountains.

A folder holds ``NAME.jpg`` and ``NAME.mask.png``, white = mountain, of one size. Only the white's
upper edge counts, and only columns that have one: below it lakes and forests are black in many.
Names are split in two by their hash: one half to develop on, one that is only ever measured.
"""

import hashlib
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from skyline.arrays import Float64Array, UInt8Array
from skyline.errors import InputError
from skyline.photo import extract_photo
from skyline.pipeline.jobs import Progress

_NEAR_SHARE = 0.01
"""Share of the image's height within which a row is right."""
_LARGE_PX = (4000, 3000)
_LARGE_PHOTOS = 3
_JPEG_QUALITY = 92


@dataclass(frozen=True, slots=True)
class MaskRow:
    """One half of the photographs.

    Attributes
    ----------
    half : str
    photos, refused : int
    within : float
        Share of the trusted columns that lie within 1 % of the image's height.
    trusted : float
        Share of the columns whose mask has an edge, refused photographs' too, that are trusted.
    mostly_wrong : int
        Photographs with most of their trusted columns farther off.
    seconds, seconds_12mp : float
        Processor time a photograph, from the file to the skyline: as it is, and the first three
        enlarged to 12 megapixels.
    """

    half: str
    photos: int
    refused: int
    within: float
    trusted: float
    mostly_wrong: int
    seconds: float
    seconds_12mp: float


@dataclass(frozen=True, slots=True)
class _Outcome:
    trusted: int
    right: int
    columns: int
    seconds: float


def measure(folder: Path, quick: bool, progress: Progress) -> list[dict[str, object]]:
    """Measure both halves of a folder, or two photographs of each, one core.

    Raises
    ------
    InputError
        The folder has fewer than two photographs with masks.
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
    rows, done = list[dict[str, object]](), 0
    for half, members in halves.items():
        outcomes = []
        for name in members[: 2 if quick else None]:
            outcomes.append(_outcome(folder, name))
            done += 1
            progress(done, 4 if quick else len(names))
        large = [_large_seconds(folder / f"{name}.jpg") for name in members[:_LARGE_PHOTOS]]
        rows.append(asdict(_row(half, outcomes, float(np.median(large)))))
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


def _outcome(folder: Path, name: str) -> _Outcome:
    mask = _grey(folder / f"{name}.mask.png")
    truth = mask_rows(mask)
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
    known = np.isfinite(truth)
    return _Outcome(int(trusted.sum()), int(right.sum()), int(known.sum()), seconds)


def _grey(path: Path) -> UInt8Array:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError(f"{path} cannot be read; expected a mask, white = mountain")
    return np.asarray(image, dtype=np.uint8)


def mask_rows(mask: UInt8Array) -> Float64Array:
    """Return the upper edge of a mask's white in each column, (W,); NaN where there is none."""
    white = mask > 127
    first = white.argmax(axis=0)
    return np.where(white.any(axis=0) & (first > 0), first - 0.5, np.nan)


def _row(half: str, outcomes: list[_Outcome], seconds_12mp: float) -> MaskRow:
    trusted = sum(outcome.trusted for outcome in outcomes)
    return MaskRow(
        half,
        len(outcomes),
        sum(outcome.trusted == 0 for outcome in outcomes),
        sum(outcome.right for outcome in outcomes) / max(trusted, 1),
        trusted / max(sum(outcome.columns for outcome in outcomes), 1),
        sum(2 * outcome.right < outcome.trusted for outcome in outcomes),
        float(np.mean([outcome.seconds for outcome in outcomes])),
        seconds_12mp,
    )
