"""Horizons of named places: elevation angles and distances by azimuth.

Azimuths are degrees from true north.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.angles import angle_between_deg
from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.horizons.local_horizons import LocalHorizons, azimuths_deg
from skyline.progress import Progress
from skyline.render.horizon import PanoramaRenderer
from skyline.skylines import MAX_WIDTH, Horizons
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.surface_model import read_surface
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, broadcast, stand_at

DEFAULT_STEP_DEG = 0.5
_AT_ONCE = 2048
"""Eyes rendered between two reports of progress."""
_LEAST_STEPS = 8
"""Fewest azimuths of a horizon; the renderer draws a multiple of them."""
_MISSING = ("None", "nan", "<NA>")
"""Ids that are missing, as Python, NumPy and pandas print them."""


def with_photo(
    horizons: LocalHorizons, azimuth_deg: Float64Array, elevation_deg: Float64Array
) -> tuple[LocalHorizons, float]:
    """Return a horizon with a photo's skyline in it, and its share.

    Parameters
    ----------
    horizons : LocalHorizons
        One place.
    azimuth_deg, elevation_deg : (N,) float64
        The photo's skyline, from true north. Azimuths within half a step of one of its points, or
        between two of its columns, take its elevation and lose their distance; the others keep
        their horizon.
    """
    order = np.argsort(azimuth_deg % 360.0)
    known_deg, up_deg = azimuth_deg[order] % 360.0, elevation_deg[order]
    at_deg = horizons.azimuth_deg[0]
    after = np.searchsorted(known_deg, at_deg) % len(known_deg)
    nearest_deg = np.minimum(
        angle_between_deg(known_deg[after], at_deg), angle_between_deg(known_deg[after - 1], at_deg)
    )
    reach_deg = max(180.0 / len(at_deg), 2.0 * float(np.median(np.diff(known_deg, append=360.0))))
    is_seen = nearest_deg <= reach_deg
    seen_deg = np.interp(at_deg, known_deg, up_deg, period=360.0)
    joined = replace(
        horizons,
        elevation_deg=np.where(is_seen, seen_deg, horizons.elevation_deg).astype(np.float32),
        distance_m=np.where(is_seen, np.float32(np.nan), horizons.distance_m),
        flags=np.where(is_seen, np.uint8(0), horizons.flags),
    )
    return joined, float(is_seen.mean())


def horizon(  # noqa: PLR0913  (independent conditions)
    terrain: Dem,
    *,
    lon: ArrayLike,
    lat: ArrayLike,
    eye_height_m: ArrayLike = DEFAULT_EYE_HEIGHT_M,
    step_deg: float = DEFAULT_STEP_DEG,
    curvature: Curvature | None = None,
    surface: Dem | None = None,
    summit_within_m: float | None = None,
    ids: ArrayLike | None = None,
) -> LocalHorizons:
    """Return the horizons around places, exact on the DEM's surface to float32.

    Parameters
    ----------
    terrain : path, paths, DataArray or HeightField
        The elevation model; read it once with `read_dem` for several calls.
    lon, lat : array_like, degrees (WGS 84), broadcast to the shape of the result
        DataArrays are broadcast by the names of their dimensions, the latitude's first.
    eye_height_m : array_like, metres above ground
    step_deg : float
        Step between azimuths; the first azimuth is true north.
    curvature : Curvature, optional
        Defaults to `Frame.curvature`: the Earth's with k = 0.13, or another world's.
    surface : path, paths, DataArray or HeightField, optional
        A surface or canopy model: the height to which trees and houses may rise above the horizon.
    summit_within_m : float, optional
        Move each eye to the highest point within this distance. By default eyes stay in place, but
        an eye within one sample's spacing of a summit of the model is raised to the summit's
        height; 0 leaves it on the slope.
    ids : array_like of str, optional
        Names of the places, in the same shape.

    Raises
    ------
    OffMapError
        A place is off the map or on a hole, or an eye height is below 0.
    InputError
        No place is given, coordinates are not numbers or have shapes that do not fit together,
        there are more or fewer ids than places, the step does not divide a full turn, or the
        surface does not cover the DEM.
    ContextError
        No OpenGL context can be created.
    """
    steps_a_turn(step_deg)
    terrain = read_dem(terrain)
    places = broadcast(lon=lon, lat=lat, eye_height_m=eye_height_m)
    shape = places[0].shape
    east, north, up = (one.ravel() for one in places)
    eyes = stand_at(terrain, lon=east, lat=north, eye_height_m=up, summit_within_m=summit_within_m)
    texts = np.full(shape, "") if ids is None else _texts_of(ids)
    if texts.shape != shape:
        raise InputError(
            f"the places have the shape {shape}, and the ids {texts.shape}; give an id for each"
        )
    over = None if surface is None else read_surface(surface, terrain)
    found = horizons_of(
        terrain, eyes, step_deg, curvature, surface=over, ids=texts.ravel().tolist()
    )
    return found.reshape(*shape)


def _texts_of(ids: ArrayLike) -> NDArray[np.str_]:
    """Return ids as texts; missing ones, as in pandas, are empty."""
    given = np.asarray(ids, dtype=object)
    texts = [
        "" if not isinstance(one, str) and str(one) in _MISSING else str(one)
        for one in given.ravel().tolist()
    ]
    return np.array(texts, dtype=np.str_).reshape(given.shape)


def horizons_of(
    terrain: HeightField,
    eyes: Viewpoints,
    step_deg: float = DEFAULT_STEP_DEG,
    curvature: Curvature | None = None,
    progress: Progress | None = None,
    surface: HeightField | None = None,
    ids: Sequence[str] = (),
) -> LocalHorizons:
    """Return the horizons (N,) of eyes; see `horizon` for the arguments."""
    steps = steps_a_turn(step_deg)
    if not len(eyes):
        raise InputError("no place was given; give the longitude and latitude of one or more")
    lon, lat = terrain.frame.to_lonlat(eyes.easting_m, eyes.northing_m)

    def in_parts(field: HeightField) -> Horizons:
        """Render a field in parts, with a report of progress after each."""
        parts: list[Horizons] = []
        with PanoramaRenderer(field, rendered_steps(steps), curvature) as renderer:
            for start in range(0, len(eyes), _AT_ONCE):
                part = slice(start, start + _AT_ONCE)
                parts.append(renderer.render_from_north(eyes[part], steps))
                if progress is not None:
                    progress(min(part.stop, len(eyes)), len(eyes))
        return Horizons.concatenate(parts)

    rendered = in_parts(terrain)
    elevation_deg = rendered.elevation_deg()
    surface_deg = np.full_like(elevation_deg, np.nan)
    if surface is not None:
        # Rounding in the surface model must not put it below the terrain.
        surface_deg = np.maximum(in_parts(surface).elevation_deg(), elevation_deg)
    return LocalHorizons(
        lon,
        lat,
        eyes.eye_elevation_m,
        np.broadcast_to(azimuths_deg(steps), (len(eyes), steps)),
        elevation_deg,
        rendered.distance_m,
        rendered.flags,
        surface_deg,
        np.array(ids or [""] * len(eyes), dtype=np.str_),
        terrain.frame.lonlat_crs,
    )


def steps_a_turn(step_deg: float) -> int:
    """Return the number of steps in a turn, or raise `InputError`."""
    most = MAX_WIDTH // 2
    is_number = isinstance(step_deg, Real)
    steps = round(360.0 / step_deg) if is_number and 0.0 < step_deg <= 360.0 else 0
    if not (_LEAST_STEPS <= steps <= most and math.isclose(steps * step_deg, 360.0, rel_tol=1e-6)):
        raise InputError(
            f"step is {step_deg!r} degrees; expected a divisor of 360, a number from "
            f"{360.0 / most:.3g} to {360.0 / _LEAST_STEPS:g}: 0.5, 1 or 7.5"
        )
    return steps


def rendered_steps(steps: int) -> int:
    """Return the steps to render: the fewest that include all ``steps`` of a turn."""
    return math.lcm(steps, _LEAST_STEPS)
