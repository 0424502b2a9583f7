r"""How a place's skyline becomes bytes: rises, distances and phases.

A skyline's tangents y are held as rises from bin to bin, one signed byte k each:

.. math::

    y_b = y_{b-1} + \mathrm{sgn}(k_b)\, a\, (e^{c |k_b|} - 1)

A smooth skyline rises little, and small rises have small steps: 0.012 degrees where it is level,
a thirtieth of the rise where it is steep. Each rise is taken from what the bytes before it have
come to, so errors do not add up. A rise beyond the greatest, 0.5, is made up for in the bins
that follow.

Distances are bytes on a logarithmic scale. Phases are what the first comparison of a search needs
(`skyline.places.phases`).
"""

from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, UInt8Array

_Item = TypeVar("_Item", bound=np.generic)

Int8Array = NDArray[np.int8]

BINS = 360
"""Azimuth bins of a place's skyline: twice as many find no more (docs/accuracy.md)."""
DISTANCE_BINS = 120
"""Azimuth bins of its distance."""
PHASE_BINS = 180
"""Azimuth bins of its phases."""

UNKNOWN_RISE = np.int8(-128)
"""A bin without a skyline; the next rise is taken from the last that has one."""

RISE_SIZE, RISE_GROWTH = 0.006, 0.035
"""a and c."""
_MOST = 127

NEAREST_M = 1.0
DISTANCE_STEP = 0.05
"""Of the natural logarithm of the distance: code 255 is 327 km."""


def _rises() -> Float32Array:
    """Return the rise of each byte (256,), the bytes read as unsigned; 0 for unknown."""
    k = np.arange(256).astype(np.uint8).view(np.int8).astype(np.float64)
    rise = np.sign(k) * RISE_SIZE * np.expm1(RISE_GROWTH * np.abs(k))
    return np.where(k == UNKNOWN_RISE, 0.0, rise).astype(np.float32)


RISES = _rises()


def encode_rises(elevation_tan: Float32Array) -> tuple[Float32Array, Int8Array]:
    """Return the first tangents (N,) float32 and the rises (N, B) int8 of skylines (N, B).

    The first bin's byte is 0; where it has no skyline, the rises begin from 0.
    """
    # A bin a row: what is worked on together lies together.
    y = np.ascontiguousarray(elevation_tan.T)
    known = np.isfinite(y)
    first = np.where(known[0], y[0], np.float32(0.0))
    codes = np.zeros(y.shape, dtype=np.int8)
    held = first.copy()
    for b in range(1, len(y)):
        rise = np.where(known[b], y[b] - held, np.float32(0.0))
        k = np.log1p(np.abs(rise) / np.float32(RISE_SIZE)) / np.float32(RISE_GROWTH)
        codes[b] = np.copysign(np.minimum(np.rint(k), _MOST), rise)
        held += RISES[codes[b].view(np.uint8)]
    codes[~known] = UNKNOWN_RISE
    return first, np.ascontiguousarray(codes.T)


def decode_rises(first: Float32Array, codes: Int8Array) -> Float32Array:
    """Return the tangents (N, B) float32; NaN where a bin has no skyline."""
    if not len(codes):
        return np.zeros(codes.shape, dtype=np.float32)
    rises = looked_up(codes.view(np.uint8), RISES)
    rises[:, 0] += first
    y: Float32Array = np.cumsum(rises, axis=1, dtype=np.float32)
    y[codes == UNKNOWN_RISE] = np.nan
    return y


def encode_distance(distance_m: Float32Array) -> UInt8Array:
    """Return codes (N, D) uint8 of distances (N, B): of the nearest within each of D bins.

    0 stands for no skyline. The nearest moves most as the eye does.
    """
    nearest = np.fmin.reduce(distance_m.reshape(len(distance_m), DISTANCE_BINS, -1), axis=2)
    code = np.rint(np.log(np.maximum(nearest, NEAREST_M)) / np.float32(DISTANCE_STEP)) + 1.0
    return np.where(np.isnan(code), 0.0, np.minimum(code, 255.0)).astype(np.uint8)


def decode_distance(codes: UInt8Array) -> Float32Array:
    """Return the distances (N, D) of codes, metres; NaN for no skyline."""
    return looked_up(codes, _DISTANCES)


def _distances() -> Float32Array:
    metres = NEAREST_M * np.exp(DISTANCE_STEP * (np.arange(256) - 1.0))
    metres[0] = np.nan
    return np.asarray(metres, dtype=np.float32)


_DISTANCES = _distances()


def looked_up(codes: UInt8Array, table: NDArray[_Item]) -> NDArray[_Item]:
    """Return ``table[codes]`` (N, ...) for a table (256,) of items of 4 or 8 bytes.

    OpenCV does this five times as fast as indexing does.
    """
    if not codes.size:
        return np.empty(codes.shape, dtype=table.dtype)
    kind = np.float32 if table.dtype.itemsize == 4 else np.float64
    found: NDArray[Any] = np.asarray(cv2.LUT(np.ascontiguousarray(codes), table.view(kind)))
    return found.view(table.dtype).reshape(codes.shape)
