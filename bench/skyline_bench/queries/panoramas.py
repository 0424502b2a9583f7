"""The exact skyline all the way round an eye, and how far of it haze lets one see."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array
from skyline.camera import HEADINGS, columns_u
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.render.horizon import HorizonRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

_VIEWPOINTS_A_BATCH = 64
_HAZE_SHELLS = 12
"""The visibility range is kept to within half of 1 / 12 of its variation over a view, 2 %."""


@dataclass(frozen=True, slots=True, eq=False)
class Panorama:
    """One skyline all the way round.

    Attributes
    ----------
    azimuth_deg : (N,) float64
        Grid azimuths, ascending from -45 degrees over one turn.
    elevation_tan : (N,) float64
        Tangent of the elevation angle, up over *horizontal* distance; NaN where not known.
    distance_m : (N,) float64
        Horizontal distance of the skyline.
    """

    azimuth_deg: Float64Array
    elevation_tan: Float64Array
    distance_m: Float64Array


def panoramas(
    terrain: HeightField,
    eyes: Viewpoints,
    width: int,
    curvature: Curvature,
    visibility_m: float = np.inf,
) -> Iterator[Panorama]:
    """Yield the exact skyline of each eye, from four views of ``width`` columns.

    Parameters
    ----------
    visibility_m : float
        Terrain farther than this is lost in haze, so that nearer ridges are the skyline.

    Raises
    ------
    InputError
        A visibility that is not positive.
    """
    if not visibility_m > 0.0:
        raise InputError(f"visibility is {visibility_m} m; expected a positive number of metres")
    edges = _haze_edges(visibility_m)
    with HorizonRenderer(terrain, width, curvature, 0.0, edges) as renderer:
        for start in range(0, len(eyes), _VIEWPOINTS_A_BATCH):
            part = eyes[start : start + _VIEWPOINTS_A_BATCH]
            views = renderer.render(part)
            for index in range(len(part)):
                first = len(HEADINGS) * index
                yield _joined(views[first : first + len(HEADINGS)], visibility_m)


def _haze_edges(visibility_m: float) -> Float64Array | None:
    """Return edges of forward depth at which terrain begins to be lost, aside first."""
    if visibility_m == np.inf:
        return None
    aside = visibility_m / np.sqrt(2.0)
    return np.concatenate([[0.0], np.linspace(aside, visibility_m, _HAZE_SHELLS)])


def _joined(views: Views, visibility_m: float) -> Panorama:
    """Join the four views of one eye; columns lie within 45 degrees of their heading."""
    u = columns_u(views.width)
    aside = np.hypot(1.0, u)
    v, depth_m = views.elevation_tan.astype(np.float64), views.depth_m.astype(np.float64)
    if views.shells is not None:
        v, depth_m = _within(views, visibility_m / aside)
    heading = views.heading[:, np.newaxis].astype(np.float64)
    azimuth = 90.0 * heading + np.degrees(np.arctan(u))
    return Panorama(azimuth.ravel(), (v / aside).ravel(), (depth_m * aside).ravel())


def _within(views: Views, depth_limit_m: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return v and depth (N, W) of the highest of the shells that end before a column's limit."""
    shells = views.shells
    if shells is None:
        raise InputError("the views hold no distance shells; render them with shell edges")
    # Half a shell beyond, so that the limit is met on average.
    half_shell_m = (shells.edges_m[-1] - shells.edges_m[-2]) / 2.0
    seen = shells.edges_m[1:, np.newaxis] <= depth_limit_m + half_shell_m
    v = np.where(seen & np.isfinite(shells.elevation_tan), shells.elevation_tan, -np.inf)
    highest = np.argmax(v, axis=1)[:, np.newaxis]
    v = np.take_along_axis(v, highest, axis=1)[:, 0].astype(np.float64)
    depth_m = np.take_along_axis(shells.depth_m, highest, axis=1)[:, 0].astype(np.float64)
    return np.where(np.isfinite(v), v, np.nan), depth_m
