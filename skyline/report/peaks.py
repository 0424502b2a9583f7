"""Summits of a gazetteer that an eye can see.

The places of a gazetteer are accurate to about a hundred metres, and a grid of heights cuts summits
off. A peak therefore stands at the highest sample near its named place, with the terrain's height
there. It is visible if nothing on the straight line to it stands above it, up to 150 m from it:
nearer ground is the peak's own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array
from skyline.geodesy import Curvature
from skyline.report.gazetteer import Peaks
from skyline.terrain.heightfield import HeightField
from skyline.terrain.sightlines import edge_crossings_m
from skyline.terrain.summits import prominence_m
from skyline.terrain.viewpoints import Viewpoints

SUMMIT_RADIUS_M = 150.0
"""Radius around a named place in which its summit is searched, and terrain cannot hide it."""
UNDERFOOT_SAMPLES = 0.35
"""Ground nearer than this many samples hides nothing: the model is too coarse there."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """A visible peak, as seen from one eye."""

    name: str
    easting_m: float
    northing_m: float
    surface_m: float
    """``easting_m``, ``northing_m``, ``surface_m``: position and height of the summit on the
    terrain."""
    azimuth_deg: float
    """Grid azimuth."""
    elevation_tan: float
    """Tangent of the elevation angle: up over horizontal distance."""
    distance_m: float
    """Horizontal."""
    height_m: float = math.nan
    """Height in the gazetteer; NaN if it has none."""

    @property
    def label(self) -> str:
        """The name, with the height if the gazetteer has one."""
        return self.name if math.isnan(self.height_m) else f"{self.name} {self.height_m:.0f} m"


def visible_peaks(
    terrain: HeightField, eye: Viewpoints, peaks: Peaks, curvature: Curvature
) -> list[Sighting]:
    """Return the peaks visible to one eye, in the gazetteer's order.

    Peaks off the terrain are left out, since the terrain that may hide them is unknown.
    """
    seen = []
    for index, name in enumerate(peaks.names):
        summit = _summit(terrain, peaks.easting_m[index], peaks.northing_m[index])
        if summit is None:
            continue
        easting_m, northing_m, surface_m = summit
        east_m = easting_m - float(eye.easting_m[0])
        north_m = northing_m - float(eye.northing_m[0])
        distance_m = math.hypot(east_m, north_m)
        if distance_m <= 2.0 * SUMMIT_RADIUS_M:
            continue  # The eye stands on this peak.
        azimuth_rad = math.atan2(east_m, north_m)
        up_m = surface_m - float(eye.eye_elevation_m[0]) - float(curvature.drop_m(distance_m))
        (highest_deg,) = highest_between_deg(
            terrain,
            eye,
            curvature,
            np.array([azimuth_rad]),
            np.array([UNDERFOOT_SAMPLES * terrain.spacing_m]),
            np.array([distance_m - SUMMIT_RADIUS_M]),
        )
        if highest_deg > math.degrees(math.atan2(up_m, distance_m)):
            continue
        seen.append(
            Sighting(
                name=name,
                easting_m=easting_m,
                northing_m=northing_m,
                surface_m=surface_m,
                azimuth_deg=math.degrees(azimuth_rad) % 360.0,
                elevation_tan=up_m / distance_m,
                distance_m=distance_m,
                height_m=float(peaks.height_m[index]),
            )
        )
    return seen


def most_prominent_first(terrain: HeightField, sightings: Sequence[Sighting]) -> list[Sighting]:
    """Return sightings in order of prominence on the terrain, then of height.

    Prominence is computed, since gazetteers seldom have it. Height alone misleads: a knoll on a
    high ridge is higher than a mountain that stands alone.
    """

    def rank(sighting: Sighting) -> tuple[float, float]:
        row, col = terrain.to_grid(easting_m=sighting.easting_m, northing_m=sighting.northing_m)
        prominent_m = prominence_m(terrain, round(float(row)), round(float(col)))
        return -prominent_m, -sighting.surface_m

    return sorted(sightings, key=rank)


def _summit(
    terrain: HeightField, easting_m: float, northing_m: float
) -> tuple[float, float, float] | None:
    """Return easting, northing and height of the highest sample near a place, if there is one."""
    row, col = (float(at) for at in terrain.to_grid(easting_m=easting_m, northing_m=northing_m))
    if not (0.0 <= row <= terrain.rows - 1 and 0.0 <= col <= terrain.cols - 1):
        return None
    reach_rows = max(1.0, SUMMIT_RADIUS_M / terrain.spacing_north_m)
    reach_cols = max(1.0, SUMMIT_RADIUS_M / terrain.spacing_east_m)
    top, left = max(0, math.ceil(row - reach_rows)), max(0, math.ceil(col - reach_cols))
    near = terrain.heights_m[
        top : math.floor(row + reach_rows) + 1, left : math.floor(col + reach_cols) + 1
    ]
    if np.isnan(near).all():
        return None
    at_row, at_col = np.unravel_index(np.nanargmax(near), near.shape)
    east, north = terrain.to_map(top + at_row, left + at_col)
    return float(east), float(north), float(near[at_row, at_col])


def highest_between_deg(
    terrain: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    grid_rad: Float64Array,
    near_m: Float64Array,
    far_m: Float64Array,
) -> Float64Array:
    """Return the highest elevation angle of the terrain on K rays of one eye, (K,) float64.

    It lies where a ray crosses an edge of the surface, which is a plane between two edges. A ray
    without data has -90.

    Parameters
    ----------
    grid_rad, near_m, far_m : (K,) float64
        Grid azimuth of each ray, and the distances between which it is followed.
    """
    away_m, is_between = edge_crossings_m(terrain, eye, grid_rad, near_m, far_m)
    up_deg = elevation_deg(terrain, eye, curvature, grid_rad, away_m)
    return np.asarray(np.where(is_between, up_deg, -90.0).max(axis=1))


def elevation_deg(
    terrain: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    grid_rad: Float64Array,
    distance_m: Float64Array,
) -> Float64Array:
    """Return elevation angles of the ground on K rays of one eye, (K, D); -90 without data.

    Parameters
    ----------
    grid_rad : (K,) float64
        Grid azimuth of each ray.
    distance_m : (D,) or (K, D) float64
        Horizontal distances.
    """
    ground_m = terrain.height_at(
        easting_m=eye.easting_m[0] + distance_m * np.sin(grid_rad)[:, np.newaxis],
        northing_m=eye.northing_m[0] + distance_m * np.cos(grid_rad)[:, np.newaxis],
    )
    drop_m = eye.eye_elevation_m[0] + curvature.drop_m(distance_m)
    up_deg = np.degrees(np.arctan((ground_m - drop_m) / distance_m))
    return np.asarray(np.nan_to_num(up_deg, nan=-90.0))
