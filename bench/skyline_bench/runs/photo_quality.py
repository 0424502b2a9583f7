"""How well skylines are extracted from drawn photos, condition by condition.

A trusted column that is wrong misleads the matcher, a masked one only leaves it with less; so
each condition's row says how much is trusted and how much of that is wrong.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.photo import extract_skyline
from skyline.pipeline import Progress
from skyline_bench.measuring.timing import core_count
from skyline_bench.measuring.workers import crew
from skyline_bench.queries.drawn_photos import CONDITIONS, DrawnPhoto, draw_photo

VIEW_COLUMNS = 640
"""Errors are given in px of a photo this wide."""
_WIDEST_PINHOLE_DEG = 120.0


@dataclass(frozen=True, slots=True)
class ConditionQuality:
    """Extraction over the photos of one condition.

    Attributes
    ----------
    condition : str
    photos : int
    refused : int
        Photos in which no skyline was found; all of their columns count as masked.
    trusted : float
        Share of the columns with a visible skyline that are trusted.
    median_px, p95_px : float
        Error of the trusted columns, in px of a photo 640 columns wide.
    wrong : float
        Share of the trusted columns that are off by more than a degree, hidden ones included.
    """

    condition: str
    photos: int
    refused: int
    trusted: float
    median_px: float
    p95_px: float
    wrong: float


@dataclass(frozen=True, slots=True, eq=False)
class _Outcome:
    """Of one photo: errors of its trusted columns, in px of 640 and in degrees, and its counts."""

    error_px: Float64Array
    error_deg: Float64Array
    visible: int
    trusted_visible: int


def measure_extraction(condition: str, seeds: Iterable[int]) -> ConditionQuality:
    """Draw one photo of the condition for each seed and compare what is extracted with the truth.

    Raises
    ------
    InputError
        There is no such condition, or no seed.
    """
    outcomes = [_outcome(draw_photo(condition, seed)) for seed in seeds]
    if not outcomes:
        raise InputError("no seed to draw photos from; expected at least one")
    error_px = np.concatenate([outcome.error_px for outcome in outcomes])
    error_deg = np.concatenate([outcome.error_deg for outcome in outcomes])
    median, p95 = np.percentile(error_px, [50, 95]) if error_px.size else (np.nan, np.nan)
    return ConditionQuality(
        condition,
        len(outcomes),
        sum(outcome.error_px.size == 0 for outcome in outcomes),
        sum(o.trusted_visible for o in outcomes) / sum(o.visible for o in outcomes),
        float(median),
        float(p95),
        float(np.mean(error_deg > 1.0)) if error_deg.size else 0.0,
    )


def _outcome(photo: DrawnPhoto) -> _Outcome:
    try:
        query = extract_skyline(photo.image)
        row_px, trusted = query.row_px, query.trusted
    except InputError:
        row_px, trusted = np.full_like(photo.row_px, np.nan), np.zeros_like(photo.visible)
    # Columns in a border have no skyline at all: whatever is found there is wrong.
    error = np.nan_to_num(np.abs(row_px - photo.row_px)[trusted], nan=np.inf)
    width = len(row_px)
    return _Outcome(
        error * VIEW_COLUMNS / width,
        error / _px_per_deg(width, photo.fov_deg),
        int(photo.visible.sum()),
        int((trusted & photo.visible).sum()),
    )


def _px_per_deg(width: int, fov_deg: float) -> float:
    """Return pixels a degree at the photo's centre; wider than a lens, it is cylindrical."""
    if fov_deg > _WIDEST_PINHOLE_DEG:
        return width / fov_deg
    return float(width / 2.0 / np.tan(np.radians(fov_deg) / 2.0) * np.tan(np.radians(1.0)))


def measure(seeds: Sequence[int], progress: Progress) -> list[ConditionQuality]:
    """Measure every condition, in as many processes as there are cores."""
    rows: dict[str, ConditionQuality] = {}
    with crew(seeds, core_count()) as run:
        for condition, row in run(_of_condition, list(CONDITIONS)):
            rows[condition] = row
            progress(len(rows), len(CONDITIONS))
    return [rows[condition] for condition in CONDITIONS]


def _of_condition(seeds: Sequence[int], condition: str) -> ConditionQuality:
    return measure_extraction(condition, seeds)
