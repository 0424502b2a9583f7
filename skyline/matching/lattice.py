"""Where profiles are predicted: the points of a lattice near stored eyes, and the ground there."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import cKDTree

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
Ground = Callable[[Float64Array, Float64Array], Float64Array]
"""Heights of the ground at eastings and northings, NaN where there is none."""
Area = tuple[float, float, float, float]
"""West, south, east, north, metres."""

_SLOPE_BASE_M = 30.0


def lattice_m(
    stored_m: Float64Array, pitch_m: float, reach_m: float, area_m: Area | None = None
) -> Float64Array:
    """Return the points (M, 2) of a lattice that are near stored eyes and not where one stands.

    Parameters
    ----------
    stored_m : (E, 2) float64
        Where the stored eyes stand: east, north.
    pitch_m : float
        Of the lattice, which is the same for all stores of a frame; infinite for no points.
    reach_m : float
        No point is farther off than this from every stored eye.
    area_m : tuple of float, optional
        What the points fill; by default a little more than the stored eyes span.
    """
    if not np.isfinite(pitch_m):
        return np.zeros((0, 2))
    tree = cKDTree(stored_m)
    west, south, east, north = _within_reach(
        area_m or _spanned_m(stored_m, tree, reach_m), stored_m, reach_m
    )
    easting_m, northing_m = (
        pitch_m * np.arange(np.ceil(low / pitch_m), high // pitch_m + 1.0)
        for low, high in ((west, east), (south, north))
    )
    place = np.stack(np.meshgrid(easting_m, northing_m), axis=-1).reshape(-1, 2)
    distance_m, _ = tree.query(place, distance_upper_bound=reach_m)
    return place[np.isfinite(distance_m) & (distance_m > 0.25 * pitch_m)]


def ground_slope(place_m: Float64Array, ground: Ground) -> Float32Array:
    """Return the ground's rise (L, 2) to the east and to the north at (L, 2); 0 beside a hole."""
    east, north, half = place_m[:, 0], place_m[:, 1], _SLOPE_BASE_M / 2.0
    rise = np.stack(
        [
            ground(east + half, north) - ground(east - half, north),
            ground(east, north + half) - ground(east, north - half),
        ],
        axis=1,
    )
    return np.nan_to_num(rise / _SLOPE_BASE_M).astype(np.float32)


def ground_between(known_m: Float64Array) -> Ground:
    """Return a ground that is linear between known points (N, 3): east, north, height.

    Outside their convex hull, and where they lie on a line, it is that of the nearest.
    """
    place, height = known_m[:, :2], known_m[:, 2]
    nearest = NearestNDInterpolator(place, height)
    spread = np.linalg.matrix_rank(place - place[0], tol=1.0)
    linear = LinearNDInterpolator(place, height) if spread == 2 and len(place) > 3 else None

    def ground(easting_m: Float64Array, northing_m: Float64Array) -> Float64Array:
        beyond = np.asarray(nearest(easting_m, northing_m), dtype=np.float64)
        if linear is None:
            return beyond
        within = linear(easting_m, northing_m)
        return np.where(np.isnan(within), beyond, within)

    return ground


def _within_reach(area_m: Area, stored_m: Float64Array, reach_m: float) -> Area:
    """Return the part of an area that may lie within reach of an eye."""
    west, south, east, north = area_m
    low, high = stored_m.min(axis=0) - reach_m, stored_m.max(axis=0) + reach_m
    return max(west, low[0]), max(south, low[1]), min(east, high[0]), min(north, high[1])


def _spanned_m(stored_m: Float64Array, tree: cKDTree, reach_m: float) -> Area:
    """Return the box that eyes span, and half of how far they are apart."""
    margin_m = reach_m
    if len(stored_m) > 1:
        apart_m = np.asarray(tree.query(stored_m, k=2)[0])[:, 1]
        margin_m = min(margin_m, 0.5 * float(np.median(apart_m)))
    west, south = stored_m.min(axis=0) - margin_m
    east, north = stored_m.max(axis=0) + margin_m
    return float(west), float(south), float(east), float(north)
