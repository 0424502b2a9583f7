"""Pixels of a picture, and their places from its middle."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import BoolArray, Float64Array

Pixel = tuple[float, float]
"""Column and row; pixel centres are at whole numbers."""


def from_middle(
    column_px: ArrayLike, row_px: ArrayLike, width_px: int, height_px: int
) -> tuple[Float64Array, Float64Array]:
    """Return across and above of a picture's pixels."""
    across = (2.0 * np.asarray(column_px, dtype=np.float64) + 1.0) / width_px - 1.0
    above = (height_px - 1.0 - 2.0 * np.asarray(row_px, dtype=np.float64)) / width_px
    return across, above


def in_picture(
    column_px: ArrayLike,
    row_px: ArrayLike,
    width_px: int,
    height_px: int,
    margin_px: float = 0.0,
) -> BoolArray:
    """Return which pixels lie in a picture or a margin around it.

    NaN is outside.
    """
    column, row = np.asarray(column_px), np.asarray(row_px)
    edge_px = 0.5 + margin_px
    with np.errstate(invalid="ignore"):
        inside = (column >= -edge_px) & (column <= width_px - 1.0 + edge_px)
        return np.asarray(inside & (row >= -edge_px) & (row <= height_px - 1.0 + edge_px))
