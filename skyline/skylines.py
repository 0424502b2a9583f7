"""Skylines of many eyes, in views or all the way round.

A view is taken by an ideal pin-hole camera with a field of view of 90 degrees, as in the paper's
section 4.1. World axes are X = east, Y = up, Z = north; camera axes are x = right, y = up, z =
forward. Both are left-handed, so every rotation here has determinant +1.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import (
    Float32Array,
    Float64Array,
    FloatArray,
    IntArray,
    Rows,
    UInt8Array,
    refuse_text,
)
from skyline.errors import InputError
from skyline.geodesy.earth import Curvature

Float = TypeVar("Float", np.float32, np.float64)

HEADINGS = (0, 1, 2, 3)
"""Grid north, east, south, west: grid azimuths ``90 * heading``, degrees."""

DEFAULT_WIDTH = 640
MAX_WIDTH = 16384

FLAG_TRUNCATED = 1
"""The skyline lies on the border of the data, or past it; see `raised_to_dip`."""
FLAG_HOLE = 2
"""The column passes over a hole with data behind it.

A terrain that is rendered in several windows is not searched for holes where it is too low to be
seen.
"""
FLAG_NO_DATA = 4
"""The column meets no data; its values are NaN."""
FLAG_OUT_OF_IMAGE = 8
"""Depth images only: the skyline lies above the image's top or below its bottom."""

NO_KEYPOINT = 65535
"""The value that pads the rows of keypoint tables."""

DEFAULT_MAX_KEYPOINTS = 128

_NEARER = 0.9
"""Only a skyline nearer than this share of a horizon's distance is raised to it. Ground that ends
there lies below the horizon by 0.6 % of the dip."""


def check_width(width: int) -> int:
    """Return ``width``, or raise `InputError` if it is not usable."""
    refuse_text(width=width)
    if not 2 <= width <= MAX_WIDTH:
        raise InputError(
            f"width is {width} columns; expected 2 to {MAX_WIDTH} (the paper uses {DEFAULT_WIDTH})"
        )
    return width


def columns_u(width: int) -> Float64Array:
    """Return the abscissa u, -1 to 1, of each column's centre, (width,)."""
    return (2.0 * np.arange(width) + 1.0) / width - 1.0


def pixel_size(width: int) -> float:
    """Return the size of a pixel in u or v."""
    return 2.0 / width


def rotation(heading: int) -> Float64Array:
    """Return the rotation R_heading (3, 3) from world to camera.

    World axes are (east, up, north), and camera axes (right, up, forward).
    """
    # Quarter turns have exact sines; np.sin(pi) would leave 1e-16 behind.
    sine = (0.0, 1.0, 0.0, -1.0)[heading]
    cosine = (1.0, 0.0, -1.0, 0.0)[heading]
    return np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])


def elevation_deg(v: Float64Array, u: Float64Array) -> Float64Array:
    """Return the elevation angles, degrees, of ordinates v at abscissas u."""
    return np.degrees(np.arctan(v * np.cos(np.arctan(u))))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Views(Rows):
    """N views of W columns each.

    Attributes
    ----------
    easting_m, northing_m, eye_elevation_m : (N,) float64
        The eye, in the DEM's frame and above its datum.
    heading : (N,) uint8
        0, 1, 2, 3 = grid north, east, south, west.
    v : (N, W) float32 (float64 from the oracle)
        Image-plane ordinate v of the skyline; NaN where a column meets no data.
    depth_m : (N, W) float32 (float64 from the oracle)
        Forward distance of the skyline; NaN where a column meets no data.
    flags : (N, W) uint8
        Bits `FLAG_TRUNCATED`, `FLAG_HOLE`, `FLAG_NO_DATA`, `FLAG_OUT_OF_IMAGE`.
    """

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array
    heading: UInt8Array
    v: FloatArray
    depth_m: FloatArray
    flags: UInt8Array

    @property
    def width(self) -> int:
        """Number of columns W."""
        return int(self.v.shape[1])

    def grid_azimuth_deg(self) -> Float64Array:
        """Return grid azimuths (N, W) of the columns, degrees in [0, 360).

        `skyline.Frame.convergence_deg` plus these are the azimuths from true north.
        """
        u = columns_u(self.width)
        turn_deg = 90.0 * self.heading[:, np.newaxis].astype(np.float64)
        return np.asarray((turn_deg + np.degrees(np.arctan(u))) % 360.0, dtype=np.float64)

    def elevation_deg(self) -> Float64Array:
        """Return elevation angles of the skyline, shape (N, W), degrees."""
        return elevation_deg(self.v.astype(np.float64), columns_u(self.width))

    def skyline_points_m(self) -> Float64Array:
        """Return the skyline's points X_i from the eye, (N, W, 3).

        The coordinates are east, up and north, metres.
        """
        depth = self.depth_m.astype(np.float64)
        camera = np.stack([columns_u(self.width) * depth, self.v * depth, depth], axis=-1)
        turns = np.stack([rotation(heading) for heading in range(4)])[self.heading]
        return np.asarray(np.einsum("nwc,nck->nwk", camera, turns), dtype=np.float64)


def raised_to_dip(
    views: Views, abscissa: Float64Array, lowest_m: float, curvature: Curvature
) -> Views:
    """Return views with skylines raised to the horizon of the lowest ground.

    Past the border of a DEM the Earth goes on. Its ground is taken to lie no lower than
    ``lowest_m``, the lowest sample; this is true at sea. Ground at h below the eye has its horizon
    at the distance sqrt(h / c), at a tangent of -2 sqrt(h c), where c is the drop over the square
    of the distance. A skyline that ends lower and nearer, at the border or at a hole, is raised to
    that horizon, and flagged as truncated. A flat Earth has no such horizon. ``abscissa`` (W,) or
    (N, W) has u of each column.
    """
    if curvature.drop_per_m2 <= 0.0:
        return views
    kind = views.v.dtype
    away_m = curvature.horizon_m(views.eye_elevation_m - lowest_m)[:, np.newaxis]
    stretch = np.hypot(1.0, abscissa)
    dip_v = (-2.0 * curvature.drop_per_m2 * away_m * stretch).astype(kind)
    depth_m = (away_m / stretch).astype(kind)
    # Samples of a sea that reaches the horizon lie up to a spacing nearer, and a little lower.
    is_lower = (views.v < dip_v) & (views.depth_m < _NEARER * depth_m)
    if not is_lower.any():
        return views
    return replace(
        views,
        v=np.where(is_lower, dip_v, views.v),
        depth_m=np.where(is_lower, depth_m, views.depth_m),
        flags=views.flags | np.where(is_lower, np.uint8(FLAG_TRUNCATED), np.uint8(0)),
    )


def joined_views(
    views: Views, row: IntArray, count: int, bins: int
) -> tuple[Float64Array, Float64Array]:
    """Return the skylines (M, B) of views that are joined by eye.

    The skylines are elevation tangents and horizontal distances.
    ``row`` (N,) is the index of each view's eye; there are ``count`` eyes (M). Directions without a
    view, or without data, are NaN. On the border of the data and behind a hole the skyline is a
    lower bound. It is used as it is: farther terrain may rise above it in the photo, as a tree may
    anywhere.
    """
    y, nearest, cosine = quadrants(views, bins, FLAG_NO_DATA, np.float64)
    distance = views.depth_m[:, nearest].astype(np.float64) / cosine
    bin_ = quadrant_bins(views.heading, bins)
    joined = np.full((2, count, bins), np.nan)
    joined[0, row[:, np.newaxis], bin_] = y
    joined[1, row[:, np.newaxis], bin_] = np.where(np.isfinite(y), distance, np.nan)
    return joined[0], joined[1]


def quadrants(
    views: Views, bins: int, unusable: int, dtype: type[Float]
) -> tuple[NDArray[Float], IntArray, NDArray[Float]]:
    """Return elevation tangents (N, B / 4) at the bins of views.

    Tangents are NaN in columns with ``unusable`` flags. Each bin's nearest column and the cosine of
    its azimuth, (B / 4,) each, are returned too. Azimuths count from the heading and begin 45
    degrees left of it. The first bin lies half a column left of the first column's centre and is
    extrapolated; the bin 45 degrees to the right belongs to the next heading.
    """
    steps = np.arange(bins // 4) - bins // 8
    azimuth = 2.0 * np.pi / bins * steps
    position = (np.tan(azimuth) + 1.0) * views.width / 2.0 - 0.5
    left = np.clip(np.floor(position).astype(np.intp), 0, views.width - 2)
    share = (position - left).astype(dtype)
    cosine = np.cos(azimuth).astype(dtype)
    v = np.where(views.flags & unusable, np.nan, views.v).astype(dtype)
    # v is linear between columns (exactly so along a straight edge); depth may jump.
    y = (v[:, left] * (1 - share) + v[:, left + 1] * share) * cosine
    return y, left + (share > 0.5), cosine


def quadrant_bins(heading: NDArray[np.integer], bins: int) -> IntArray:
    """Return the full turn's bins that views cover, (N, B / 4).

    The views look along headings (N,).
    """
    quarter = bins // 4
    first = heading[:, np.newaxis].astype(np.intp) * quarter - quarter // 2
    return (first + np.arange(quarter)) % bins


def bin_azimuths_rad(bins: int) -> Float64Array:
    """Return the grid azimuths (B,) of the bins' centres.

    They are in radians, clockwise from north. Bin b is centred at 360 (b + 1/2) / B degrees, so
    that a quarter of the bins lies wholly in each of the four 90 degree views.
    """
    return np.asarray((np.arange(bins) + 0.5) * (2.0 * np.pi / bins), dtype=np.float64)


def quadrant_azimuths_rad(bins: int) -> Float64Array:
    """Return the azimuths (B/4,) of a quadrant's bins from its axis.

    They are in radians, and increase. The quadrant of heading h has the bins h B/4 - B/8 to h B/4 +
    B/8 - 1, modulo B.
    """
    steps = np.arange(bins // 4) + 0.5 - bins / 8
    return np.asarray(steps * (2.0 * np.pi / bins), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Horizons(Rows):
    """The skylines of N eyes in B bins of azimuth.

    The bins lie at `bin_azimuths_rad`, unless others are named.

    Attributes
    ----------
    easting_m, northing_m, eye_elevation_m : (N,) float64
        The eye, in the DEM's frame and above its datum.
    elevation_tan : (N, B) float32
        Tangent of the skyline's elevation angle: up over horizontal distance. NaN where an azimuth
        meets no data.
    distance_m : (N, B) float32
        Horizontal distance of the skyline; NaN where an azimuth meets no data.
    flags : (N, B) uint8
        The bits of `skyline.skylines`: truncated, hole, no data.
    """

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array
    elevation_tan: Float32Array
    distance_m: Float32Array
    flags: UInt8Array

    def elevation_deg(self) -> Float32Array:
        """Return elevation angles of the skyline, shape (N, B), degrees."""
        return np.degrees(np.arctan(self.elevation_tan))


def polyline_vertices(
    curves: FloatArray, tolerance: float, max_vertices: int = DEFAULT_MAX_KEYPOINTS
) -> NDArray[np.uint16]:
    """Approximate curves sampled at equal steps by polylines; return the vertices' columns.

    The vertices are the keypoints of the paper's section 3. Douglas-Peucker with the vertical
    distance, all curves at once: each round splits every segment that misses its curve by more than
    the tolerance at the column it misses most. The first and last column of every run of finite
    samples are vertices, so a gap splits the polyline and the tolerance holds in each run on its
    own.

    Where a curve has more than ``max_vertices``, the most significant stay. A vertex is as
    significant as the miss that made it is large, but never more than the vertex whose segment it
    splits; so the vertices that stay are the polyline of a coarser tolerance. The ends of runs come
    first, and the ends of longer runs before the ends of shorter ones.

    Curves are (N, W), W below 65535; NaN marks a gap. The tolerance is in their unit; 0 keeps every
    bend. Columns (N, max_vertices) ascend and are padded with `NO_KEYPOINT`.
    """
    count, width = curves.shape
    flat = curves.astype(np.float64).reshape(-1)
    first, last = _runs(curves)
    inner, significance = _split(flat, first, last, tolerance)
    bent = last > first
    position = np.concatenate([first, last[bent], inner])
    length = (last - first).astype(np.float64)
    rank = np.concatenate([np.full(len(first) + bent.sum(), np.inf), significance])
    run_length = np.concatenate([length, length[bent], np.zeros(len(inner))])
    order = np.lexsort((-run_length, -rank, position // width))
    return _most_significant(position[order], (count, width), max_vertices)


def _runs(curves: FloatArray) -> tuple[IntArray, IntArray]:
    """Return flat indices of the ends of runs of finite samples."""
    width = curves.shape[1]
    finite = np.pad(np.isfinite(curves), ((0, 0), (1, 1))).astype(np.int8)
    change = np.diff(finite, axis=1)
    row, column = np.nonzero(change == 1)
    first = row * width + column
    row, column = np.nonzero(change == -1)
    return first, row * width + column - 1


def _split(
    flat: Float64Array, left: IntArray, right: IntArray, tolerance: float
) -> tuple[IntArray, Float64Array]:
    """Return indices and significances of the vertices inside segments."""
    positions = [np.zeros(0, dtype=np.intp)]
    significances = [np.zeros(0)]
    bound = np.full(len(left), np.inf)
    while (long := right - left > 1).any():
        left = left[long]
        right = right[long]
        bound = bound[long]
        worst, middle = _worst_miss(flat, left, right)
        missed = worst > tolerance
        left = left[missed]
        right = right[missed]
        middle = middle[missed]
        bound = np.minimum(bound, worst)[missed]
        positions.append(middle)
        significances.append(bound)
        left, right = np.concatenate([[left, middle], [middle, right]], axis=1)
        bound = np.concatenate([bound, bound])
    return np.concatenate(positions), np.concatenate(significances)


def _worst_miss(
    flat: Float64Array, left: IntArray, right: IntArray
) -> tuple[Float64Array, IntArray]:
    """Return each segment's greatest vertical distance to its chord, and where."""
    count = right - left - 1
    start = np.cumsum(count) - count
    segment = np.repeat(np.arange(len(left)), count)
    step = np.arange(len(segment)) - start[segment] + 1
    slope = (flat[right] - flat[left]) / (right - left)
    at = left[segment] + step
    miss = np.abs(flat[at] - flat[left][segment] - slope[segment] * step)
    worst = np.maximum.reduceat(miss, start)
    hit = np.flatnonzero(miss == worst[segment])
    # Of equal misses the leftmost counts.
    hit = hit[np.diff(segment[hit], prepend=-1) > 0]
    return worst, at[hit]


def _most_significant(
    position: IntArray, shape: tuple[int, int], max_vertices: int
) -> NDArray[np.uint16]:
    """Return the most significant columns of each row as a padded table.

    ``position`` has flat indices in order of row and significance.
    """
    count, width = shape
    row = position // width
    per_row = np.bincount(row, minlength=count)
    place = np.arange(len(row)) - (np.cumsum(per_row) - per_row)[row]
    kept = place < max_vertices
    table = np.full((count, max_vertices), NO_KEYPOINT, dtype=np.uint16)
    table[row[kept], place[kept]] = position[kept] % width
    return np.sort(table, axis=1)
