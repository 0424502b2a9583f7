"""The prior of a position and a heading that a photo notes.

A position from EXIF has a long-tailed error: it is usually near the truth, and now and then it is
the position of another photo or an old fix of the phone. So the true place has a `PlaceDensity`
about the noted one.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyline.angles import wrapped_deg
from skyline.arrays import Complex128Array, Float64Array
from skyline.geodesy.map_frame import Frame
from skyline.match.noted_errors import (
    NOTED_ERRORS,
    noted_altitude_scale_m,
    noted_heading_sd_deg,
    noted_position_scale_m,
)
from skyline.match.place_density import PlaceDensity, PlacePrior
from skyline.photo.noted_place import NotedPlace


@dataclass(frozen=True, slots=True)
class _Wrong:
    """Assumptions about positions and headings that are wrong altogether."""

    share: float = 0.05
    """Share of wrong positions: an assumption."""
    compass_share: float = 0.2
    """Share of photos whose compass was disturbed, as by a car, a railing or a case."""


_WRONG = _Wrong()


@dataclass(frozen=True, slots=True)
class PositionPrior(PlacePrior):
    """Prior density of a camera's position and heading, from a photo's EXIF."""

    easting_m: float
    northing_m: float
    scale_m: float
    """Scale of the position's error."""
    grid_heading_deg: float | None = None
    """Grid azimuth of the optical axis."""
    heading_sd_deg: float = NOTED_ERRORS.compass_sd_deg
    """Standard deviation of the heading, where the compass is not disturbed."""
    elevation_m: float | None = None
    """Elevation of the eye; its error is distributed like a position's error along one axis."""
    elevation_scale_m: float = NOTED_ERRORS.least_altitude_scale_m
    """Scale of that distribution."""

    @classmethod
    def of_noted(cls, noted: NotedPlace, frame: Frame) -> "PositionPrior | None":
        """Return the prior from a photo's EXIF in a frame.

        None if EXIF notes no position.
        """
        if noted.lonlat_deg is None:
            return None
        east, north = (float(value) for value in frame.from_lonlat(*noted.lonlat_deg))
        if not (np.isfinite(east) and np.isfinite(north)):
            return None  # Too far from the frame to have a place in it.
        prior = cls(east, north, noted_position_scale_m(noted))
        if noted.accuracy_m is not None:
            # Other altitudes would pull an eye of unknown place to ground that is too high.
            prior = replace(
                prior,
                elevation_m=noted.elevation_m,
                elevation_scale_m=noted_altitude_scale_m(noted),
            )
        return prior.looking_as(noted, frame)

    def looking_as(self, noted: NotedPlace, frame: Frame) -> "PositionPrior":
        """Return the prior with a photo's compass direction, if it notes one."""
        if noted.heading_deg is None:
            return self
        turn_deg = frame.convergence_deg(easting_m=self.easting_m, northing_m=self.northing_m)
        return replace(
            self,
            grid_heading_deg=noted.heading_deg - float(turn_deg),
            heading_sd_deg=noted_heading_sd_deg(noted),
        )

    def cost(
        self, position_m: Complex128Array, eye_m: Float64Array, heading_rad: Float64Array
    ) -> Float64Array:
        """Return the cost (M,) of poses; see `PlacePrior`."""
        cost = self._density.cost(self._off_m(position_m))
        if self.grid_heading_deg is not None:
            turn = np.degrees(heading_rad) - self.grid_heading_deg
            off = wrapped_deg(turn) / self.heading_sd_deg
            right = 360.0 / (np.sqrt(2.0 * np.pi) * self.heading_sd_deg)
            right *= 1.0 - _WRONG.compass_share
            cost = cost - np.log(_WRONG.compass_share + right * np.exp(-0.5 * off**2))
        if self.elevation_m is not None:
            off = (eye_m - self.elevation_m) / self.elevation_scale_m
            cost = cost + NOTED_ERRORS.altitude_tail * np.log1p(off**2)
        return np.asarray(cost)

    def pull(
        self, position_m: Complex128Array, eye_m: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return the pull (M, 3) to the noted place, and offsets (M, 3); see `PlacePrior`."""
        precision, offset_m = self._density.pull(self._off_m(position_m))
        if self.elevation_m is not None:
            offset_m[:, 2] = eye_m - self.elevation_m
            spread = self.elevation_scale_m**2 + offset_m[:, 2] ** 2
            precision[:, 2] = 2.0 * NOTED_ERRORS.altitude_tail / spread
        return precision, offset_m

    @property
    def _density(self) -> PlaceDensity:
        return PlaceDensity(self.scale_m, _WRONG.share)

    def _off_m(self, position_m: Complex128Array) -> Complex128Array:
        return position_m - complex(self.easting_m, self.northing_m)
