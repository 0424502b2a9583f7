"""A photo's skyline, corrected by strokes of a brush and found again after each stroke.

The evidence for sky and ground is gathered once. A stroke marks pixels as sky or as ground; the
skyline is then the cheapest path that respects the marks. A drawn line is the skyline itself.
Columns that no stroke changes keep the skyline found first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np

from skyline.arrays import BoolArray, Float64Array, IntArray, UInt8Array
from skyline.errors import InputError
from skyline.photo.extract import (
    FORBIDDEN,
    STEPS,
    TRUST_THRESHOLD,
    Extraction,
    on_photo,
    shortest_path,
    to_work_columns,
)
from skyline.photo.read import Photo
from skyline.photo.sky_model import is_sky_mask, skyline_of_mask
from skyline.photo.skyline import PhotoSkyline, check_of_image

_HULL_PX = 64
"""Columns of the photo beside changed ones, on each side, whose skyline is found anew too."""


class StrokeKind(StrEnum):
    """The meaning of a stroke.

    Attributes
    ----------
    SKY, GROUND
        The pixels under it are sky, or ground.
    LINE
        The skyline runs along it.
    ERASE
        The columns under it show no skyline.
    """

    SKY = "sky"
    GROUND = "ground"
    LINE = "line"
    ERASE = "erase"


@dataclass(frozen=True, slots=True)
class Stroke:
    """One stroke over a photo.

    Attributes
    ----------
    kind : StrokeKind
    points_px : tuple of (float, float)
        Columns and rows of points joined by straight lines; pixel centres are at whole numbers.
    radius_px : float
        Radius of the brush; 0 for a line.

    Raises `InputError` if there are no points, a coordinate is not finite, or the radius is
    negative.
    """

    kind: StrokeKind
    points_px: tuple[tuple[float, float], ...]
    radius_px: float = 0.0

    def __post_init__(self) -> None:
        if not self.points_px or not np.isfinite(self.points_px).all():
            raise InputError(
                f"a stroke has {len(self.points_px)} points; expected at least one, all finite"
            )
        if not 0.0 <= self.radius_px < np.inf:
            raise InputError(f"a brush has a radius of {self.radius_px:g} px; expected 0 or more")


class Correction:
    """A photo whose skyline is found again after each stroke.

    Parameters
    ----------
    photo : Photo

    Raises
    ------
    InputError
        The photo is too small or a sliver.
    """

    def __init__(self, photo: Photo) -> None:
        self._photo = photo
        self._extraction = Extraction.of(photo.rgb)
        self._mask = skyline_of_mask(photo.rgb) if is_sky_mask(photo.rgb) else None

    def solve(
        self, strokes: Sequence[Stroke] = (), start: PhotoSkyline | None = None
    ) -> PhotoSkyline:
        """Return the skyline under all given strokes; later strokes override earlier ones.

        ``start`` is the skyline to which the strokes are applied, for example a trace. By default
        it is extracted from the photo, or is the border of a sky mask. The result may have no
        trusted column. Its field of view and projection are the photo's.

        Raises `InputError` if ``start`` is of an image of another size.
        """
        found = self._mask if start is None else start
        content, (height, width) = self._extraction.content, self._extraction.photo.shape[:2]
        left, top = content.left, content.top
        row_px, trust = self._extraction.row_px.copy(), self._extraction.trust.copy()
        if found is not None:
            check_of_image(found, (content.height, content.width))
            row_px = found.row_px[left : content.right] - top
            trust = found.trust[left : content.right].copy()
        inside = [
            replace(one, points_px=tuple((x - left, y - top) for x, y in one.points_px))
            for one in strokes
        ]
        labels = _labels(inside, self._extraction)
        if labels.any():
            self._solve_again(labels, row_px, trust)
        for stroke in inside:
            columns = _columns(stroke, width)
            if stroke.kind is StrokeKind.LINE:
                row_px[columns] = np.clip(_along(stroke, columns), -0.5, height - 0.5)
                trust[columns] = 1.0
            elif stroke.kind is StrokeKind.ERASE:
                trust[columns] = 0.0
            else:
                touched = columns[np.isfinite(row_px[columns])]
                # A person has looked at them.
                trust[touched] = np.maximum(trust[touched], TRUST_THRESHOLD)
        known = np.isfinite(row_px)
        query = self._extraction.query(row_px, np.where(known, trust, 0.0))
        if found is not None:
            # A mask or a trace may have rows in the borders beside the photo; they are kept.
            beside = np.ones(query.width_px, dtype=bool)
            beside[left : left + width] = False
            query = replace(
                query,
                row_px=np.where(beside, found.row_px, query.row_px),
                trust=np.where(beside, found.trust, query.trust),
            )
        return self._photo.described(query)

    def _solve_again(self, labels: UInt8Array, row_px: Float64Array, trust: Float64Array) -> None:
        """Update the rows and the trust of the columns that painted pixels change."""
        extraction, evidence = self._extraction, self._extraction.evidence
        cost = np.where(_forbidden(labels), evidence.cost + np.float32(FORBIDDEN), evidence.cost)
        path = shortest_path(cost, *STEPS)
        changed = (path != extraction.path) | (labels != 0).any(axis=0)
        near = (
            np.rint(to_work_columns(len(row_px), evidence)).astype(np.intp).clip(0, len(path) - 1)
        )
        columns = np.flatnonzero(changed[near])
        around = slice(max(columns[0] - _HULL_PX, 0), columns[-1] + _HULL_PX + 1)
        rows, trusts = on_photo(extraction.photo, evidence, path, around)
        row_px[columns] = rows[columns - around.start]
        trust[columns] = trusts[columns - around.start]


def _columns(stroke: Stroke, width: int) -> IntArray:
    """Return the photo's columns under a stroke."""
    across = [column for column, _ in stroke.points_px]
    first = max(0, round(min(across) - stroke.radius_px))
    last = min(width - 1, round(max(across) + stroke.radius_px))
    return np.arange(first, last + 1)


def _along(stroke: Stroke, columns: IntArray) -> Float64Array:
    """Return a line's rows at columns; where the line turns back, the later row counts."""
    rows: dict[int, float] = {}
    before = stroke.points_px[0]
    for here in stroke.points_px:
        low, high = sorted((round(before[0]), round(here[0])))
        span = np.arange(low, high + 1)
        share = (span - before[0]) / (here[0] - before[0]) if here[0] != before[0] else span * 0.0
        between = before[1] + np.clip(share, 0.0, 1.0) * (here[1] - before[1])
        rows.update(zip(span.tolist(), between.tolist(), strict=True))
        before = here
    rows[round(before[0])] = before[1]
    known = sorted(rows)
    return np.interp(columns, known, [rows[column] for column in known])


_LABELS = {StrokeKind.SKY: 1, StrokeKind.GROUND: 2}


def _labels(strokes: Sequence[Stroke], extraction: Extraction) -> UInt8Array:
    """Return the painted pixels at working size, (h, w): 0 none, 1 sky, 2 ground."""
    evidence = extraction.evidence
    (work_height, work_width), photo = evidence.cost.shape, extraction.photo
    labels = np.zeros((work_height, work_width), dtype=np.uint8)
    scale = np.array([work_width / photo.shape[1], work_height / photo.shape[0]])
    for stroke in strokes:
        if stroke.kind not in _LABELS:
            continue
        points = (np.array(stroke.points_px) + 0.5) * scale - 0.5
        limit = 4 * max(work_height, work_width)
        whole = np.rint(np.clip(points, -limit, limit)).astype(np.int32)
        thickness = max(1, round(2.0 * min(stroke.radius_px * float(scale[0]), limit)))
        cv2.polylines(labels, [whole], False, _LABELS[stroke.kind], thickness)
    return labels


def _forbidden(labels: UInt8Array) -> BoolArray:
    """Return the pixels (h, w) closed to the skyline: painted sky and above, ground and below."""
    sky, ground = (labels == label for label in _LABELS.values())
    sky_here_or_below = np.logical_or.accumulate(sky[::-1], axis=0)[::-1]
    return np.asarray(sky_here_or_below | np.logical_or.accumulate(ground, axis=0))
