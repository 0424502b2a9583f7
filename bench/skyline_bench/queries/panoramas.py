"""The exact skyline all the way round an eye."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array
from skyline.camera import HEADINGS, columns_u
from skyline.geodesy import Curvature
from skyline.render.horizon import HorizonRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

_VIEWPOINTS_A_BATCH = 64


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
    terrain: HeightField, eyes: Viewpoints, width: int, curvature: Curvature
) -> Iterator[Panorama]:
    """Yield the exact skyline of each eye, from four views of ``width`` columns."""
    with HorizonRenderer(terrain, width, curvature) as renderer:
        for start in range(0, len(eyes), _VIEWPOINTS_A_BATCH):
            part = eyes[start : start + _VIEWPOINTS_A_BATCH]
            views = renderer.render(part)
            for index in range(len(part)):
                first = len(HEADINGS) * index
                yield _joined(views[first : first + len(HEADINGS)])


def _joined(views: Views) -> Panorama:
    """Join the four views of one eye; columns lie within 45 degrees of their heading."""
    u = columns_u(views.width)
    aside = np.hypot(1.0, u)
    v, depth_m = views.elevation_tan.astype(np.float64), views.depth_m.astype(np.float64)
    heading = views.heading[:, np.newaxis].astype(np.float64)
    azimuth = 90.0 * heading + np.degrees(np.arctan(u))
    return Panorama(azimuth.ravel(), (v / aside).ravel(), (depth_m * aside).ravel())
