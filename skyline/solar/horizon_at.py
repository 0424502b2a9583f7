"""Renders the horizons round places that a person names."""

import math

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array, Progress
from skyline.camera import MAX_WIDTH
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.render.panorama import PanoramaRenderer
from skyline.skylines import Horizons
from skyline.solar.local_horizons import LocalHorizons
from skyline.terrain.heightfield import HeightField
from skyline.terrain.surface import Dem, read_surface
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, stand_at

DEFAULT_STEP_DEG = 0.5
_AT_ONCE = 2048
_LEAST_STEPS = 8


def horizon(  # noqa: PLR0913  (each is a condition of its own)
    terrain: HeightField,
    *,
    lon: ArrayLike,
    lat: ArrayLike,
    eye_height_m: ArrayLike = DEFAULT_EYE_HEIGHT_M,
    step_deg: float = DEFAULT_STEP_DEG,
    curvature: Curvature | None = None,
    surface: Dem | None = None,
    summit_within_m: float | None = None,
) -> LocalHorizons:
    """Return the horizons round places: exact on the surface of the DEM, but for float32.

    Parameters
    ----------
    lon, lat : array_like, degrees (WGS 84), broadcast to N places
    eye_height_m : array_like, metres above ground
    step_deg : float
        Between azimuths, the first of which is true north.
    curvature : Curvature, optional
        Defaults to the Earth's with k = 0.13.
    surface : path, paths or HeightField, optional
        A surface or canopy model: how far trees and houses may rise above the horizon.
    summit_within_m : float, optional
        Eyes go to the highest point within so many metres. By default they stay, and those within a
        sample's spacing of a summit of the model stand as high as it; 0 leaves these on the slope.

    Raises
    ------
    OffMapError
        A place off the map or on a hole, or an eye height below 0.
    InputError
        Steps that are no whole share of a turn, or a surface that is not over the DEM.
    ContextError
        No OpenGL context can be made.
    """
    eyes = stand_at(
        terrain, lon=lon, lat=lat, eye_height_m=eye_height_m, summit_within_m=summit_within_m
    )
    over = None if surface is None else read_surface(surface, terrain)
    return horizons_of(terrain, eyes, step_deg, curvature, surface=over)


def horizons_of(
    terrain: HeightField,
    eyes: Viewpoints,
    step_deg: float = DEFAULT_STEP_DEG,
    curvature: Curvature | None = None,
    progress: Progress | None = None,
    surface: HeightField | None = None,
) -> LocalHorizons:
    """Return the horizons of eyes; as `horizon` otherwise, with a surface that is read."""
    steps = _check_step(step_deg)
    # The renderer's steps to a turn are a multiple of 8: some are left out.
    every = 8 // math.gcd(steps, 8)
    lon, lat = terrain.frame.to_lonlat(eyes.easting_m, eyes.northing_m)
    to_grid_rad = -np.radians(
        terrain.frame.convergence_deg(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
    )
    bins = steps * every
    rendered = _rendered(terrain, eyes, to_grid_rad, bins, curvature, progress)
    elevation_deg = np.degrees(np.arctan(rendered.elevation_tan[:, ::every]))
    surface_deg = np.full_like(elevation_deg, np.nan)
    if surface is not None:
        over = _rendered(surface, eyes, to_grid_rad, bins, curvature, progress)
        # A model's last digits must not put what may rise below what is there.
        surface_deg = np.degrees(np.arctan(over.elevation_tan[:, ::every]))
        surface_deg = np.maximum(surface_deg, elevation_deg)
    azimuth_deg = np.arange(steps) * (360.0 / steps)
    return LocalHorizons(
        lon,
        lat,
        eyes.eye_elevation_m,
        np.broadcast_to(azimuth_deg, (len(eyes), steps)),
        elevation_deg,
        rendered.distance_m[:, ::every],
        rendered.flags[:, ::every],
        surface_deg,
    )


def _rendered(
    field: HeightField,
    eyes: Viewpoints,
    to_grid_rad: Float64Array,
    bins: int,
    curvature: Curvature | None,
    progress: Progress | None,
) -> Horizons:
    parts: list[Horizons] = []
    with PanoramaRenderer(field, bins, curvature, tolerance_deg=0.0) as renderer:
        for start in range(0, len(eyes), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            parts.append(renderer.render(eyes[part], to_grid_rad[part]))
            if progress is not None:
                progress(min(part.stop, len(eyes)), len(eyes))
    return Horizons.concatenate(parts)


def _check_step(step_deg: float) -> int:
    """Return the number of steps to a turn."""
    most = MAX_WIDTH // 2
    steps = round(360.0 / step_deg) if 0.0 < step_deg <= 360.0 else 0
    if not (_LEAST_STEPS <= steps <= most and math.isclose(steps * step_deg, 360.0, rel_tol=1e-6)):
        raise InputError(
            f"step is {step_deg:g} degrees; expected a whole share of 360, from {360.0 / most:.3g} "
            f"to {360.0 / _LEAST_STEPS:g}: 0.5, 1 or 7.5"
        )
    return steps
