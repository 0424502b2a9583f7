"""Strokes over a photo, by which a person corrects its skyline."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self

import cv2
import numpy as np

from skyline.arrays import BoolArray, Float64Array, IntArray, UInt8Array, refuse_text
from skyline.errors import InputError


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


_LABELS = {StrokeKind.SKY: 1, StrokeKind.GROUND: 2}
"""Values of painted pixels, see `painted`."""


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
        refuse_text(points_px=self.points_px, radius_px=self.radius_px)
        if not self.points_px or not np.isfinite(self.points_px).all():
            raise InputError(
                f"a stroke has {len(self.points_px)} points; expected at least one, all finite"
            )
        if not 0.0 <= self.radius_px < np.inf:
            raise InputError(f"a brush has a radius of {self.radius_px:g} px; expected 0 or more")

    def in_crop(self, column: int, row: int) -> Self:
        """Return the stroke in a crop's pixels."""
        return replace(self, points_px=tuple((x - column, y - row) for x, y in self.points_px))

    def columns(self, width: int) -> IntArray:
        """Return which of ``width`` columns lie under the stroke."""
        across = [column for column, _ in self.points_px]
        first = max(0, round(min(across) - self.radius_px))
        last = min(width - 1, round(max(across) + self.radius_px))
        return np.arange(first, last + 1)

    def rows_at(self, columns: IntArray) -> Float64Array:
        """Return the rows of a line at columns.

        Where the line turns back, the later row counts.
        """
        rows: dict[int, float] = {}
        before = self.points_px[0]
        for here in self.points_px:
            low, high = sorted((round(before[0]), round(here[0])))
            span = np.arange(low, high + 1)
            across = here[0] - before[0]
            share = (span - before[0]) / across if across != 0.0 else span * 0.0
            between = before[1] + np.clip(share, 0.0, 1.0) * (here[1] - before[1])
            rows.update(zip(span.tolist(), between.tolist(), strict=True))
            before = here
        rows[round(before[0])] = before[1]
        known = sorted(rows)
        return np.interp(columns, known, [rows[column] for column in known])


def painted(
    strokes: Sequence[Stroke], photo_shape: tuple[int, ...], shape: tuple[int, ...]
) -> UInt8Array:
    """Return the painted pixels of a reduced photo, (h, w) uint8.

    Their values are 0 for none, 1 for sky and 2 for ground.

    Parameters
    ----------
    strokes : sequence of Stroke
        In the photo's pixels.
    photo_shape, shape : (int, int)
        Height and width of the photo, and of the reduced photo.
    """
    labels = np.zeros(shape, dtype=np.uint8)
    scale = np.array([shape[1] / photo_shape[1], shape[0] / photo_shape[0]])
    for stroke in strokes:
        if stroke.kind not in _LABELS:
            continue
        points = (np.array(stroke.points_px) + 0.5) * scale - 0.5
        limit = 4 * max(shape)
        whole = np.rint(np.clip(points, -limit, limit)).astype(np.int32)
        thickness = max(1, round(2.0 * min(stroke.radius_px * float(scale[0]), limit)))
        cv2.polylines(labels, [whole], False, _LABELS[stroke.kind], thickness)
    return labels


def forbidden(labels: UInt8Array) -> BoolArray:
    """Return the pixels (h, w) that are closed to the skyline.

    They are painted sky and all above it, painted ground and all below it.
    """
    sky = labels == _LABELS[StrokeKind.SKY]
    ground = labels == _LABELS[StrokeKind.GROUND]
    sky_here_or_below = np.logical_or.accumulate(sky[::-1], axis=0)[::-1]
    return np.asarray(sky_here_or_below | np.logical_or.accumulate(ground, axis=0))
