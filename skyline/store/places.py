r"""Places: eyes and their skylines in few bytes, for a search.

A place is an eye, its skyline all the way round, the skyline's distance, and the distance around
the eye within which it represents all other eyes. Places are rendered when a store is built and
mapped when it is opened.

A skyline's tangents y are stored as rises from bin to bin, one signed byte k each:

.. math::

    y_b = y_{b-1} + \mathrm{sgn}(k_b)\, a\, (e^{c |k_b|} - 1)

A smooth skyline rises little, and small rises have small steps: 0.012 degrees where it is level, a
thirtieth of the rise where it is steep. Each rise is taken from the sum of the bytes before it, so
errors do not add up. A rise greater than the greatest that a byte can hold, 0.5, continues in the
bins that follow. Distances are bytes on a logarithmic scale.

The first comparison of a search needs the rises d between the means of neighbouring runs of bins,
as phases. A pitch hardly changes them, and a roll adds nearly the same to each. A bounded kernel
says how alike two rises are,

.. math::

    k(d, d') = \cos(\omega (d - d')) = \mathrm{Re}\, e^{i \omega d} \overline{e^{i \omega d'}}

so that a rise that is far off counts no more than one that is somewhat off, and the sum over many
rises is a matrix product. A phase takes a byte.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import (
    Complex64Array,
    Float32Array,
    Float64Array,
    IntArray,
    Rows,
    UInt8Array,
)
from skyline.skylines import Horizons

_Item = TypeVar("_Item", bound=np.generic)

Int8Array = NDArray[np.int8]

BINS = 360
"""Azimuth bins of a place's skyline."""
DISTANCE_BINS = 120
"""Azimuth bins of a place's distance."""
PHASE_BINS = 180
"""Azimuth bins of a place's phases."""

UNKNOWN_RISE = np.int8(-128)
"""Code of a bin without a skyline; the next rise counts from the last bin that has one."""

RISE_SIZE = 0.006
"""The a of the formula."""
RISE_GROWTH = 0.035
"""The c of the formula."""
_MOST = 127
_SIGNED = np.arange(256).astype(np.uint8).view(np.int8).astype(np.float64)
_RISES = np.sign(_SIGNED) * RISE_SIZE * np.expm1(RISE_GROWTH * np.abs(_SIGNED))
RISES: Float32Array = np.where(_SIGNED == UNKNOWN_RISE, 0.0, _RISES).astype(np.float32)
"""Rise of each byte (256,), the byte read as unsigned; 0 for unknown."""

NEAREST_M = 1.0
DISTANCE_STEP = 0.05
"""Step of the natural logarithm of the distance; code 255 is 327 km."""
_DISTANCES = (NEAREST_M * np.exp(DISTANCE_STEP * (np.arange(256) - 1.0))).astype(np.float32)
_DISTANCES[0] = np.nan

PHASES = 255
"""Number of steps of a phase in a turn; code 0 stands for an unknown rise."""
ALIKE_DEG = 0.75
"""Difference in elevation at which two rises over 2 degrees of azimuth add nothing to a score."""
RISE_TO_TURN = float(np.pi / 2.0 / np.radians(ALIKE_DEG))
"""Omega, radians per unit of tangent: `ALIKE_DEG` is a quarter turn."""

PLACE_CODING = {
    "bins": BINS,
    "distance_bins": DISTANCE_BINS,
    "phase_bins": PHASE_BINS,
    "rise_size": RISE_SIZE,
    "rise_growth": RISE_GROWTH,
    "nearest_m": NEAREST_M,
    "distance_log_step": DISTANCE_STEP,
    "phase_steps": PHASES,
    "phase_alike_deg": ALIKE_DEG,
}
"""The constants by which the bytes of places become tangents and distances."""

_PHASE = (np.arange(PHASES) + 0.5) * (2.0 * np.pi / PHASES)


def encode_rises(elevation_tan: Float32Array) -> tuple[Float32Array, Int8Array]:
    """Return skylines' (N, B) first tangents (N,) and rises (N, B).

    The first bin's byte is 0. Without a skyline there, it is `UNKNOWN_RISE`, and the rises begin
    from a tangent of 0.
    """
    # One bin per row, so that values that are processed together lie together in memory.
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
    """Return tangents (N, B) float32; NaN in bins without a skyline."""
    rises = looked_up(codes.view(np.uint8), RISES)
    rises[:, 0] += first
    y: Float32Array = np.cumsum(rises, axis=1, dtype=np.float32)
    y[codes == UNKNOWN_RISE] = np.nan
    return y


def encode_distance(distance_m: Float32Array) -> UInt8Array:
    """Return codes (N, D) of the nearest distance in each bin.

    Distances are (N, B); code 0 stands for no skyline. The nearest skyline moves most when the eye
    moves.
    """
    count, bins = distance_m.shape
    runs = distance_m.reshape(count, DISTANCE_BINS, bins // DISTANCE_BINS)
    nearest = np.fmin.reduce(runs, axis=2)
    code = np.rint(np.log(np.maximum(nearest, NEAREST_M)) / np.float32(DISTANCE_STEP)) + 1.0
    return np.where(np.isnan(code), 0.0, np.minimum(code, 255.0)).astype(np.uint8)


def looked_up(codes: UInt8Array, table: NDArray[_Item]) -> NDArray[_Item]:
    """Return ``table[codes]`` for a table (256,) of 4- or 8-byte items.

    OpenCV does this five times as fast as indexing.
    """
    if not codes.size:
        return np.empty(codes.shape, dtype=table.dtype)
    kind = np.float32 if table.dtype.itemsize == 4 else np.float64
    found: NDArray[Any] = np.asarray(cv2.LUT(np.ascontiguousarray(codes), table.view(kind)))
    return found.view(table.dtype).reshape(codes.shape)


def encode_phases(elevation_tan: Float32Array) -> UInt8Array:
    """Return the phases' codes (N, 180) of skylines (N, B).

    A code is 1 + floor(255 phase / 2 pi). A rise is from the mean of a run of bins to the mean of
    the next; the first run follows the last. It is unknown, and its code 0, where either run has a
    bin without a skyline.
    """
    count, bins = elevation_tan.shape
    mean = elevation_tan.reshape(count, PHASE_BINS, bins // PHASE_BINS).mean(axis=2)
    turns = (np.roll(mean, -1, axis=1) - mean) * np.float32(RISE_TO_TURN / (2.0 * np.pi))
    turns -= np.floor(turns)
    known = np.isfinite(turns)
    steps = np.minimum(np.where(known, turns, 0.0) * PHASES, PHASES - 1)
    return np.where(known, steps.astype(np.uint8) + 1, 0).astype(np.uint8)


def decode_phases(codes: UInt8Array, gain: int = 1) -> Complex64Array:
    """Return exp(i gain phase) (N, 180) complex64; 0 for unknown rises.

    Omega is as many times `RISE_TO_TURN` as the ``gain`` says.
    """
    return looked_up(codes, _waves(gain))


@cache
def _waves(gain: int) -> Complex64Array:
    """Return the waves (256,) of the codes of phases."""
    return np.concatenate([[0.0], np.exp(1j * gain * _PHASE)]).astype(np.complex64)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Places(Rows):
    """N places; 692 bytes each.

    Attributes
    ----------
    easting_m, northing_m : (N,) float64
        The eye, in the DEM's frame.
    eye_elevation_m : (N,) float32
        Elevation of the eye above the DEM's datum.
    tolerance_m : (N,) float32
        Distance from the eye, east and north, within which the place represents other eyes: half a
        grid's spacing.
    first_tan : (N,) float32
        Tangent of the skyline's elevation angle in the first bin.
    rise : (N, 360) int8
        Rises from bin to bin; see `encode_rises`.
    distance : (N, 120) uint8
        Codes of the skyline's horizontal distance.
    phase : (N, 180) uint8
        Codes that a search compares first; see `encode_phases`.
    """

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float32Array
    tolerance_m: Float32Array
    first_tan: Float32Array
    rise: Int8Array
    distance: UInt8Array
    phase: UInt8Array

    @classmethod
    def of(cls, horizons: Horizons, tolerance_m: float | Float32Array) -> "Places":
        """Return the places of skylines in 360 bins, with their tolerances."""
        first, rise = encode_rises(horizons.elevation_tan)
        return cls(
            horizons.easting_m,
            horizons.northing_m,
            horizons.eye_elevation_m.astype(np.float32),
            np.broadcast_to(np.float32(tolerance_m), first.shape).copy(),
            first,
            rise,
            encode_distance(horizons.distance_m),
            # Phases are made from decoded rises, so that they can be made again from a store.
            encode_phases(decode_rises(first, rise)),
        )

    def elevation_tan(self) -> Float32Array:
        """Return the skylines' elevation tangents (N, 360); NaN where unknown."""
        return decode_rises(self.first_tan, self.rise)

    def distance_m(self) -> Float32Array:
        """Return the skylines' horizontal distances (N, 120); NaN where unknown."""
        return looked_up(self.distance, _DISTANCES)

    def blocks(self) -> Iterator["Places"]:
        """Yield these places; as `skyline.PlaceMap` does."""
        yield self

    def phases(self, rows: IntArray) -> UInt8Array:
        """Return the phases of some places; as `skyline.PlaceMap` does."""
        return self.phase[rows]

    def take(self, rows: IntArray) -> "Places":
        """Return some places, in order; as `skyline.PlaceMap` does."""
        return self[rows]
