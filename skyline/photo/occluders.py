"""What stands in front of the mountains: poles, trees, people.

They are told by what mountains seldom do: they rise and fall steeply, and their sides run
straight down into the picture, with another colour on either side.
"""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from scipy import ndimage

from skyline.arrays import BoolArray, Float32Array, IntArray
from skyline.photo.evidence import Evidence

_SPIRE_WIDTH_SHARE = 0.02
_SPIRE_SLOPE = 4.0
"""Narrower than this and steeper on both sides, it is a pole or a tree, not a mountain."""
_CLIFF_SHARE = 0.05
"""Rise of the path, as a share of the rows, that makes the side of something near..."""
_CLIFF_WIDTH_SHARE = 0.004
"""...where it happens within twice this share of the columns..."""
_CLIFF_SLOPE = 3.5
"""...and is steeper than this."""
_MAX_OCCLUDER_SHARE = 0.4
"""Share of the columns that something near may hide; if more, it is the mountains."""
_MARGIN_PX = 2
_POLE_SHARE = 0.04
"""Length, as a share of the rows, in which a pole is looked for above the path."""
_POLE_GAP_PX = 3
_POLE_FILLED = 0.6
"""Share of that length that is thin where there is a pole."""

_SIDE_SHARE = 0.16
"""Length of a side, as a share of the rows, down from the path."""
_SIDE_SLANTS = (-0.3, -0.15, 0.0, 0.15, 0.3)
"""Columns a row by which a side may lean."""
_SIDE_STRIP_PX = 3
"""Columns on either side of it that are compared, at half the working size."""
_SIDE_CONTRAST = 16.0
"""L*a*b* distance of the mean colours on the two sides."""
_SIDE_STEADINESS = 1.0
"""The same in deviations from row to row."""
_ALIKE = 12.0
"""L*a*b* distance within which two stretches of ground are of one kind."""


@dataclass(frozen=True, slots=True, eq=False)
class _Sides:
    """Colours just below the path, per column at half the working size.

    Attributes
    ----------
    is_side : (W,) bool
        Whether the border between this column and the one before is something's side.
    below : (W, 3) float32
        Mean L*a*b* from the path down.
    """

    is_side: BoolArray
    below: Float32Array


def occluded(evidence: Evidence, row: IntArray) -> BoolArray:
    """Return the columns in which something near hides what the path (w,) should follow."""
    lab = evidence.lab
    height, width = lab.shape[:2]
    narrow = max(3, round(_SPIRE_WIDTH_SHARE * width))
    # Rows count downwards, so closing the rows takes away what stands up narrowly.
    without_spires = ndimage.grey_closing(row, size=(narrow,), mode="nearest")
    spire = without_spires - row > 0.5 * _SPIRE_SLOPE * narrow
    half = _half_size(lab)
    half_row = np.clip(row[: 2 * half.shape[1] : 2] // 2, 0, len(half) - 1)
    foreign = np.repeat(_foreign(_sides(half, half_row)), 2)[:width]
    foreign = np.pad(foreign, (0, width - len(foreign)), mode="edge")
    upright = spire | _between_cliffs(row, height) | foreign | _poles(evidence.thin, row)
    return np.asarray(ndimage.binary_dilation(upright, iterations=_MARGIN_PX), dtype=bool)


def _poles(thin: BoolArray, row: IntArray) -> BoolArray:
    """Return the columns in which something thin stands above the path (w,) in (h, w)."""
    height, width = thin.shape
    counted = np.vstack([np.zeros((1, width), np.intp), np.cumsum(thin, axis=0)])
    stop = np.maximum(row - _POLE_GAP_PX, 0)
    start = np.maximum(stop - max(4, round(_POLE_SHARE * height)), 0)
    columns = np.arange(width)
    count = counted[stop, columns] - counted[start, columns]
    return np.asarray((count > _POLE_FILLED * (stop - start)) & (stop > start))


def _half_size(lab: Float32Array) -> Float32Array:
    h, w = lab.shape[0] // 2, lab.shape[1] // 2
    return np.asarray(cv2.resize(lab, (w, h), interpolation=cv2.INTER_AREA), dtype=np.float32)


def _between_cliffs(row: IntArray, height: int) -> BoolArray:
    """Return the columns of stretches that every cliff of the path leaves downwards."""
    reach = max(1, round(_CLIFF_WIDTH_SHARE * len(row)))
    padded = np.pad(row, reach, mode="edge")
    rise = padded[: len(row) + 1] - padded[2 * reach - 1 :]
    cliff = max(_CLIFF_SHARE * height, _CLIFF_SLOPE * 2 * reach)
    cliffs = _strongest(np.abs(rise), cliff, 2 * reach)
    bounds = np.concatenate([[0], cliffs, [len(row)]])
    rise[[0, -1]] = 0
    high = np.zeros(len(row), dtype=bool)
    for start, stop in pairwise(bounds.tolist()):
        if stop - start <= _MAX_OCCLUDER_SHARE * len(row):
            high[start:stop] = rise[start] >= 0 and rise[stop] <= 0
    return high


def _strongest(values: IntArray | Float32Array, least: float, apart: int) -> IntArray:
    """Return where values exceed the least one and all others within ``apart``."""
    greatest = ndimage.maximum_filter1d(values, 2 * apart + 1, mode="nearest")
    at = np.flatnonzero((values >= greatest) & (values > least))
    # Of a run of equal values the middle one.
    runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
    return np.array([run[len(run) // 2] for run in runs if run.size], dtype=np.intp)


def _sides(lab: Float32Array, row: IntArray) -> _Sides:
    """Find straight sides that run down from the path (W,) in a photo (H, W, 3)."""
    height, width = lab.shape[:2]
    length = max(4, round(_SIDE_SHARE * height))
    strips = cv2.blur(lab, (_SIDE_STRIP_PX, 1))
    reach = (_SIDE_STRIP_PX + 1) // 2
    # Across column c's left border, strips' centres a strip apart.
    left = np.roll(strips, reach, axis=1)
    right = np.roll(strips, -reach + 1, axis=1)
    across = right - left
    start = np.clip(row + 2, 0, height - 1)
    columns = np.arange(width)
    strength = np.zeros(width, dtype=np.float32)
    for slant in _SIDE_SLANTS:
        line = _line_kernel(length, slant)
        anchor = (line.shape[1] // 2, 0)
        mean = _filtered(across, line, anchor)[start, columns]
        square = _filtered((across**2).sum(axis=2), line, anchor)[start, columns]
        contrast = np.linalg.norm(mean, axis=1)
        spread = np.sqrt(np.maximum(square - contrast**2, 0.0))
        steady = contrast > _SIDE_STEADINESS * spread
        strength = np.maximum(strength, np.where(steady, contrast, 0.0))
    strength[:reach] = strength[width - reach :] = 0.0
    is_side = np.zeros(width, dtype=bool)
    is_side[_strongest(strength, _SIDE_CONTRAST, _SIDE_STRIP_PX)] = True
    upright = np.full((length, 1), 1.0 / length, dtype=np.float32)
    return _Sides(is_side, _filtered(lab, upright, (0, 0))[start, columns])


def _filtered(image: Float32Array, kernel: Float32Array, anchor: tuple[int, int]) -> Float32Array:
    filtered = cv2.filter2D(image, cv2.CV_32F, kernel, anchor=anchor, borderType=cv2.BORDER_REFLECT)
    return np.asarray(filtered, dtype=np.float32)


def _line_kernel(length: int, slant: float) -> Float32Array:
    """Return a mean along a line that runs down from the middle of the first row."""
    half = round(abs(slant) * length) + 1
    kernel = np.zeros((length, 2 * half + 1), dtype=np.float32)
    down = np.arange(length)
    kernel[down, half + np.rint(slant * down).astype(int)] = 1.0 / length
    return kernel


def _foreign(sides: _Sides) -> BoolArray:
    """Return the columns between sides whose ground is unlike the longest stretch's."""
    width = len(sides.is_side)
    bounds = np.concatenate([[0], np.flatnonzero(sides.is_side), [width]])
    stretches = [(a, b) for a, b in pairwise(bounds.tolist()) if b > a]
    colours = [np.median(sides.below[a:b], axis=0) for a, b in stretches]
    longest = int(np.argmax([b - a for a, b in stretches]))
    foreign = np.zeros(width, dtype=bool)
    for (start, stop), colour in zip(stretches, colours, strict=True):
        alike = float(np.linalg.norm(colour - colours[longest])) <= _ALIKE
        foreign[start:stop] = not alike and stop - start <= _MAX_OCCLUDER_SHARE * width
    return foreign
