"""Which named summits an eye sees, and where.

The places of a gazetteer are accurate to about a hundred metres, and a grid of heights cuts summits
off. A peak therefore stands at the highest sample near its named place, with the terrain's height
there. It is visible if no ground rises above the straight line to it. Ground within 150 m of a peak
is the peak's own, and does not hide it.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar
from unicodedata import bidirectional

import numpy as np

from skyline.geodesy.earth import Curvature
from skyline.terrain.heightfield import HeightField
from skyline.terrain.ray_casting import highest_between_deg
from skyline.terrain.summits import SUMMIT_RADIUS_M, prominence_m, summit_near
from skyline.terrain.viewpoints import Viewpoints
from skyline.view.peaks import Peaks

UNDERFOOT_SAMPLES = 0.35
"""Ground nearer than this many samples hides nothing: the model is too coarse there."""
_OTHER_HEIGHT_M = 200.0
"""A gazetteer's height that differs by more from the terrain's at the summit is not its height in
metres: vertical datums differ by up to 100 m, and coarse models cut off as much."""
S = TypeVar("S", bound="Sighting")
_FROM_LEFT = "\N{LEFT-TO-RIGHT MARK}"
_FROM_RIGHT = ("R", "AL")
"""Bidirectional classes of letters that are written from right to left."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """A peak as an eye would see it without other terrain."""

    name: str
    easting_m: float
    northing_m: float
    surface_m: float
    """Height of the summit on the terrain."""
    grid_azimuth_deg: float
    elevation_tan: float
    """Tangent of the elevation angle: up over horizontal distance."""
    distance_m: float
    """Horizontal."""
    height_m: float = math.nan
    """Height in the gazetteer; NaN if it has none."""

    @property
    def label(self) -> str:
        """The name, with the height if the gazetteer has one.

        Marks enclose a name that is written from right to left, so that the height stays after it.
        """
        is_turned = any(bidirectional(letter) in _FROM_RIGHT for letter in self.name)
        name = f"{_FROM_LEFT}{self.name}{_FROM_LEFT}" if is_turned else self.name
        return name if math.isnan(self.height_m) else f"{name} {self.height_m:.0f} m"

    @property
    def elevation_m(self) -> float:
        """Height in the gazetteer, or else the summit's height on the terrain."""
        return self.surface_m if math.isnan(self.height_m) else self.height_m


def visible_peaks(
    terrain: HeightField, eye: Viewpoints, peaks: Peaks, curvature: Curvature
) -> list[Sighting]:
    """Return the peaks visible to one eye, in the gazetteer's order.

    Peaks off the terrain are left out, since the terrain that may hide them is unknown. A warning
    counts the heights that `aimed_at` leaves out.
    """
    aimed = aimed_at(terrain, eye, peaks, curvature)
    _warn_of_heights(aimed, peaks)
    return [one for one in aimed if one is not None and _is_seen(terrain, eye, one, curvature)]


def _warn_of_heights(aimed: Sequence[Sighting | None], peaks: Peaks) -> None:
    """Log a warning that counts the heights that `aimed_at` has left out."""
    left_out = [
        (one, height_m)
        for one, height_m in zip(aimed, peaks.height_m.tolist(), strict=True)
        if one is not None and math.isnan(one.height_m) and not math.isnan(height_m)
    ]
    if left_out:
        first, height_m = left_out[0]
        _log.warning(
            "%d of %d peaks have heights that differ by more than %g m from the terrain (the first "
            "is %s, %.0f m high, on ground of %.0f m), so they are shown without one; expected "
            "metres, or a unit, such as 14505 ft",
            *(len(left_out), len(peaks), _OTHER_HEIGHT_M, first.name, height_m, first.surface_m),
        )


def aimed_at(
    terrain: HeightField, eye: Viewpoints, peaks: Peaks, curvature: Curvature
) -> list[Sighting | None]:
    """Return where one eye would see each peak if nothing hid it.

    None stands for a peak off the terrain. A height that contradicts the terrain, such as one in
    feet, is left out.
    """
    aimed: list[Sighting | None] = []
    for index, name in enumerate(peaks.names):
        summit = summit_near(terrain, peaks.easting_m[index], peaks.northing_m[index])
        if summit is None:
            aimed.append(None)
            continue
        easting_m, northing_m, surface_m = summit
        azimuth_rad, elevation_tan, distance_m = curvature.seen(
            easting_m - eye.easting_m[0],
            northing_m - eye.northing_m[0],
            surface_m - eye.eye_elevation_m[0],
        )
        height_m = float(peaks.height_m[index])
        if abs(height_m - surface_m) > _OTHER_HEIGHT_M:
            height_m = math.nan
        aimed.append(
            Sighting(
                name=name,
                easting_m=easting_m,
                northing_m=northing_m,
                surface_m=surface_m,
                grid_azimuth_deg=math.degrees(azimuth_rad) % 360.0,
                elevation_tan=float(elevation_tan),
                distance_m=float(distance_m),
                height_m=height_m,
            )
        )
    return aimed


def _is_seen(
    terrain: HeightField, eye: Viewpoints, sighting: Sighting, curvature: Curvature
) -> bool:
    """Return whether no terrain in front of a peak stands higher.

    A peak on which the eye stands is not seen.
    """
    if sighting.distance_m <= 2.0 * SUMMIT_RADIUS_M:
        return False
    (highest_deg,) = highest_between_deg(
        terrain,
        eye,
        curvature,
        np.radians([sighting.grid_azimuth_deg]),
        np.array([UNDERFOOT_SAMPLES * terrain.spacing_m]),
        np.array([sighting.distance_m - SUMMIT_RADIUS_M]),
    )
    return bool(highest_deg <= math.degrees(math.atan(sighting.elevation_tan)))


def most_prominent_first(terrain: HeightField, sightings: Sequence[S]) -> list[S]:
    """Return sightings in order of prominence on the terrain, then of height.

    Prominence is computed, since gazetteers seldom have it. Height alone misleads: a knoll on a
    high ridge is higher than a mountain that stands alone.
    """

    def rank(sighting: Sighting) -> tuple[float, float]:
        row, col = terrain.to_grid(easting_m=sighting.easting_m, northing_m=sighting.northing_m)
        prominent_m = prominence_m(terrain, round(float(row)), round(float(col)))
        return -prominent_m, -sighting.surface_m

    return sorted(sightings, key=rank)
