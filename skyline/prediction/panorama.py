"""What eyes around a stored location see all the way round, many eyes at once.

As `predict`, the upper envelope of displaced polylines, but the views of one eye are one ring of
columns, every displaced eye's quadrants are found in one pass, and the envelope and the depth
behind it are one integer maximum. No segment ends at a frame's side, so no view needs its flanks.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.camera import HEADINGS, columns_u
from skyline.prediction.curves import MAX_DEPTH_RATIO, MIN_DEPTH_M, surfacing
from skyline.prediction.displacement import Reach

FloatArray = NDArray[np.floating]
Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
UInt8Array = NDArray[np.uint8]
Int32Array = NDArray[np.int32]
IntArray = NDArray[np.intp]

_POINTS_AT_ONCE = 1 << 15
"""Points projected together: few enough for the cache."""

_TAN_STEPS = 1 << 20
_TAN_LIMIT = 7.99
"""Image ordinates are counted in steps of 1e-6 and cut at 83 degrees."""
_NOTHING = np.int32(np.iinfo(np.int32).min)

_CODES = 256
_MANTISSA_BITS = 23
_CODE_BITS = 4
_EXPONENT_OF_1 = 127


def depth_code(depth_m: FloatArray) -> Int32Array:
    """Return depths from 1 m to 65 km as codes 0 to 255, 16 to the octave.

    The leading bits of the float itself: its exponent and 4 bits of its fraction.
    """
    code = np.asarray(depth_m, dtype=np.float32).view(np.int32) >> (_MANTISSA_BITS - _CODE_BITS)
    code -= _EXPONENT_OF_1 << _CODE_BITS
    return np.asarray(np.minimum(np.maximum(code, 0), _CODES - 1), dtype=np.int32)


def depth_of_code_m(code: NDArray[np.integer]) -> Float32Array:
    """Return the middle of what a depth code stands for, within 3 % of the depth."""
    bits = (code.astype(np.int32) + (_EXPONENT_OF_1 << _CODE_BITS)) << (_MANTISSA_BITS - _CODE_BITS)
    return (bits + (1 << (_MANTISSA_BITS - _CODE_BITS - 1))).astype(np.int32).view(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """The terrain known around one eye: M points of polylines, one after the other.

    Attributes
    ----------
    east_m, up_m, north_m : (M,) float32
        From the eye.
    joined : (M,) bool
        Whether a point is joined to the next one; the last is not.
    columns : int
        Columns Q of a quadrant.
    """

    east_m: Float32Array
    up_m: Float32Array
    north_m: Float32Array
    joined: NDArray[np.bool_]
    columns: int

    @classmethod
    def of(cls, elevation_tan: Float32Array, depth_m: Float32Array, reach: Reach) -> "Ring":
        """Join the four views of an eye and leave out what stays hidden within reach.

        Parameters
        ----------
        elevation_tan, depth_m : (4, K, Q) float32
            By heading; NaN is unknown.
        reach : Reach
            How far eyes may move.
        """
        columns = elevation_tan.shape[2]
        u = columns_u(columns).astype(np.float32)
        east = np.stack([u * depth_m[0], depth_m[1], -u * depth_m[2], -depth_m[3]])
        north = np.stack([depth_m[0], -u * depth_m[1], -depth_m[2], u * depth_m[3]])
        tan, depth, east, north = (_closed(rows) for rows in (elevation_tan, depth_m, east, north))
        known = np.isfinite(tan) & np.isfinite(depth)
        wanted = known & surfacing(np.where(known, tan, np.float32(np.nan)), depth, reach)
        ratio = depth[:, 1:] / depth[:, :-1]
        joined = np.zeros(tan.shape, dtype=bool)
        joined[:, :-1] = (
            (known[:, 1:] & known[:, :-1])
            & (wanted[:, 1:] | wanted[:, :-1])
            & (ratio <= MAX_DEPTH_RATIO)
            & (ratio >= 1.0 / MAX_DEPTH_RATIO)
        )
        kept = joined.copy()
        kept[:, 1:] |= joined[:, :-1]
        return cls(east[kept], (tan * depth)[kept], north[kept], joined[kept], columns)

    def seen_from(self, displacements_m: Float64Array) -> tuple[Float32Array, UInt8Array]:
        """Return what displaced eyes see.

        Parameters
        ----------
        displacements_m : (C, 3) float64
            East, up, north of each eye from the ring's own.

        Returns
        -------
        elevation_tan : (C, 4, Q) float32
            Image-plane ordinate by heading, at the column centres, to 1e-6; NaN where no
            polyline passes.
        depth : (C, 4, Q) uint8
            `depth_code` of the forward distance; 0 where no polyline passes.
        """
        size = len(HEADINGS) * self.columns
        envelope = np.full((len(displacements_m), size), _NOTHING, dtype=np.int32)
        some = max(1, _POINTS_AT_ONCE // max(1, len(self.up_m)))
        if len(self.up_m):
            for begin in range(0, len(displacements_m), some):
                part = slice(begin, begin + some)
                self._raise(envelope[part], displacements_m[part].astype(np.float32))
        shape = (len(displacements_m), len(HEADINGS), self.columns)
        nothing = envelope == _NOTHING
        tan = np.where(nothing, np.float32(np.nan), (envelope >> 8) * np.float32(1 / _TAN_STEPS))
        depth = np.where(nothing, 0, envelope & (_CODES - 1)).astype(np.uint8)
        return tan.reshape(shape), depth.reshape(shape)

    def _raise(self, envelope: Int32Array, displacements_m: Float32Array) -> None:
        """Raise an envelope (C, 4 Q) to what C displaced eyes see."""
        points = _Points.of(self, displacements_m)
        face = points.face
        turned = np.abs(face[1:] - face[:-1])
        joined = np.broadcast_to(self.joined, (len(envelope), len(self.joined))).ravel()[:-1]
        one, other = points.position[:-1], points.position[1:]
        passes = np.ceil(np.minimum(one, other)) <= np.maximum(one, other)
        start = np.flatnonzero(passes & joined & (turned == 0.0))
        row = start // len(self.up_m) * envelope.shape[1]
        _draw(envelope, row, points.ends(start), points.ends(start + 1))

        # A segment across the seam of two quadrants is two; one across more passes underfoot.
        seam = np.flatnonzero(joined & ((turned == 1.0) | (turned == 3.0)))
        row = seam // len(self.up_m) * envelope.shape[1]
        for begin, end in ((seam, seam + 1), (seam + 1, seam)):
            _draw(envelope, row, points.ends(begin), points.cut(begin, end))


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Points of a ring seen from displaced eyes, one eye after the other, (P,) float32.

    Attributes
    ----------
    x, up, z : east, up and north of the eye, metres
    position : columns round the ring; NaN where too near
    nearness : inverse forward depth; NaN where too near
    face : heading of the quadrant; NaN where too near
    columns : of a quadrant
    """

    x: Float32Array
    up: Float32Array
    z: Float32Array
    position: Float32Array
    nearness: Float32Array
    face: Float32Array
    columns: int

    @classmethod
    def of(cls, ring: Ring, displacements_m: Float32Array) -> "_Points":
        x = (ring.east_m - displacements_m[:, :1]).ravel()
        up = (ring.up_m - displacements_m[:, 1:2]).ravel()
        z = (ring.north_m - displacements_m[:, 2:]).ravel()
        position, nearness = _project(x, z, ring.columns)
        face = np.floor((position + np.float32(0.5)) * np.float32(1.0 / ring.columns))
        return cls(x, up, z, position, nearness, face, ring.columns)

    def ends(self, point: IntArray) -> "_Ends":
        """Return points as ends of segments."""
        nearness = self.nearness[point]
        return self.position[point], self.up[point] * nearness, nearness

    def cut(self, begin: IntArray, end: IntArray) -> "_Ends":
        """Return where segments to a neighbouring quadrant leave the one they begin in."""
        # Quadrants meet on diagonals; of the two the one that runs between the ends.
        same = (self.x[begin] + self.x[end]) * (self.z[begin] + self.z[end]) > 0.0
        sign = np.where(same, np.float32(-1.0), np.float32(1.0))
        here = self.x[begin] + sign * self.z[begin]
        there = self.x[end] + sign * self.z[end]
        share = here / np.where(here == there, np.float32(1.0), here - there)
        x = self.x[begin] + share * (self.x[end] - self.x[begin])
        up = self.up[begin] + share * (self.up[end] - self.up[begin])
        nearness = 1.0 / np.maximum(np.abs(x), np.float32(MIN_DEPTH_M))
        onwards = (self.face[end] - self.face[begin]) % len(HEADINGS) == 1.0
        edge = (self.face[begin] + onwards) * np.float32(self.columns) - np.float32(0.5)
        return edge, up * nearness, nearness


_Ends = tuple[FloatArray, FloatArray, FloatArray]
"""Ends of segments: columns round the ring, image ordinates and inverse forward depths."""


def _project(x: Float32Array, z: Float32Array, columns: int) -> tuple[Float32Array, Float32Array]:
    """Return columns round the ring and inverse forward depths (C, M), NaN where too near."""
    ahead = np.abs(z) >= np.abs(x)
    forward = np.where(ahead, z, x)
    nearness = 1.0 / np.where(np.abs(forward) > MIN_DEPTH_M, forward, np.float32(np.nan))
    position = np.where(ahead, x, -z)
    position *= nearness
    half = np.float32(columns / 2.0)
    position *= half
    position += np.where(ahead, half - np.float32(0.5), 3 * half - np.float32(0.5))
    position += np.where(forward < 0.0, 4 * half, np.float32(0.0))
    return position, np.abs(nearness, out=nearness)


def _draw(envelope: Int32Array, row: IntArray, begin: _Ends, end: _Ends) -> None:
    """Raise an envelope to segments, each within a quadrant; ``row`` is where its eye begins."""
    first = np.ceil(np.minimum(begin[0], end[0]))
    last = np.minimum(np.floor(np.maximum(begin[0], end[0])), envelope.shape[1] - 1)
    count = np.maximum(last - first + 1.0, 0.0).astype(np.intp)
    span = end[0] - begin[0]
    # A segment seen end on counts as its beginning.
    rate = np.divide(1.0, span, out=np.zeros_like(span), where=np.abs(span) > 1e-6)
    tan_rate, near_rate = (end[1] - begin[1]) * rate, (end[2] - begin[2]) * rate
    offset = first - begin[0]
    tan_first, near_first = begin[1] + offset * tan_rate, begin[2] + offset * near_rate
    cell = row + first.astype(np.intp)
    flat = envelope.reshape(-1)
    once = count == 1
    np.maximum.at(flat, cell[once], _key(tan_first[once], near_first[once]))
    more = np.flatnonzero(count > 1)
    many = count[more]
    segment = np.repeat(more, many)
    along = np.arange(len(segment)) - np.repeat(np.cumsum(many) - many, many)
    key = _key(
        tan_first[segment] + along.astype(np.float32) * tan_rate[segment],
        near_first[segment] + along.astype(np.float32) * near_rate[segment],
    )
    np.maximum.at(flat, cell[segment] + along, key)


def _key(tan: FloatArray, nearness: FloatArray) -> Int32Array:
    """Return integers that order by ordinate and hold the depth's code in their last 8 bits."""
    limit = np.float32(_TAN_LIMIT)
    steps = np.minimum(np.maximum(tan, -limit), limit) * np.float32(_TAN_STEPS)
    return (steps.astype(np.int32) << 8) | depth_code(1.0 / nearness)


def _closed(rows: Float32Array) -> Float32Array:
    """Return (4, K, Q) as K rings (K, 4 Q + 1) that end with the column they begin with."""
    ring = rows.transpose(1, 0, 2).reshape(rows.shape[1], -1)
    return np.concatenate([ring, ring[:, :1]], axis=1)
