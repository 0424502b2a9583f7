"""How high an eye stands above the terrain model's ground.

`EyeHeightPrior` is the prior of this height. At a known place, a photo may note a height that tells
whether its eye was on the ground or aloft: each way is a `Standing`.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import Float64Array
from skyline.match.noted_errors import NOTED_ERRORS, noted_altitude_scale_m
from skyline.photo.noted_place import NotedPlace
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, LEAST_EYE_HEIGHT_M


@dataclass(frozen=True, slots=True)
class _Aloft:
    """Assumptions about eyes in flight."""

    share: float = 0.05
    """Share of photos from drones, towers, cable cars and balloons: a guess."""
    drone_share: float = 0.99
    """Share of the photos of drones that are taken in flight: a guess."""
    median_m: float = 100.0
    """Median height. Drones may fly up to 120 m; cable cars and balloons are higher."""
    least_sds: float = 3.0
    """An eye at most this many standard deviations of the terrain model above the usual height may
    stand on the ground."""


_ALOFT = _Aloft()
_LEAST_SCALE_M = 1e-6
"""Replaces the scale 0 of a known height, by which nothing can be divided."""
_GREATEST_SCALES = 20.0
"""Greatest height of an eye that is tried, in scales of its prior above the usual height."""


@dataclass(frozen=True, slots=True)
class EyeHeightPrior:
    r"""Prior of the height of an eye above the terrain model's ground.

    Most eyes are about as high as a person. Where the model cuts off a summit or a cliff, eyes are
    far above its ground, so the height has a Cauchy distribution about the usual one:
    :math:`-\log p(h) = \log(1 + ((h - usual) / scale)^2)`.
    """

    usual_m: float
    scale_m: float
    """Scale of the distribution; 0 for a known height."""

    @property
    def range_m(self) -> tuple[float, float]:
        """The smallest and the greatest height that are tried."""
        least_m = self.usual_m if self.scale_m == 0.0 else LEAST_EYE_HEIGHT_M
        return least_m, self.usual_m + _GREATEST_SCALES * self.scale_m

    def cost(self, height_m: Float64Array) -> Float64Array:
        """Return the negative log density of heights (M,), up to a constant."""
        return np.asarray(np.log1p(self._in_scales(height_m) ** 2))

    def precision(self, height_m: Float64Array) -> Float64Array:
        """Return the precision (M,) of a normal distribution with the same pull."""
        scale_m = max(self.scale_m, _LEAST_SCALE_M)
        return np.asarray(2.0 / (scale_m**2 * (1.0 + self._in_scales(height_m) ** 2)))

    def _in_scales(self, height_m: Float64Array) -> Float64Array:
        return (height_m - self.usual_m) / max(self.scale_m, _LEAST_SCALE_M)


@dataclass(frozen=True, slots=True)
class KnownGround:
    """The ground at a known place."""

    elevation_m: float
    relief_m: float
    """Standard deviation of the ground's height as far around as the place may be off."""
    takeoff_relief_m: float
    """Standard deviation of the ground's height as far around as a drone may have taken off."""
    height_sd_m: float
    """Standard deviation of the terrain model's heights."""


@dataclass(frozen=True, slots=True)
class Standing:
    """How an eye stands at a known place: grounded or aloft."""

    eye: EyeHeightPrior
    elevation_m: float | None = None
    """Elevation of an eye aloft, as the photo notes it."""
    elevation_scale_m: float = NOTED_ERRORS.least_altitude_scale_m
    """Scale of its error."""
    cost: float = 0.0
    """Negative log of the density of the usual height, given all heights that the photo notes."""

    @classmethod
    def of_noted(cls, noted: NotedPlace, ground: KnownGround) -> "list[Standing]":
        """Return the ways that a photo's noted heights leave open.

        The ground comes first. A noted height may be far off, so many photos that note one were
        taken on the ground below it.
        """
        on_ground = cls(EyeHeightPrior(DEFAULT_EYE_HEIGHT_M, ground.height_sd_m))
        heights = _noted_heights(noted, ground)
        if not heights:
            return [on_ground]

        def cost(above_m: float, density: float) -> float:
            return sum(one.cost(above_m) for one in heights) - math.log(density)

        aloft = _ALOFT.share if noted.takeoff_height_m is None else _ALOFT.drone_share
        peak = (1.0 - aloft) / (math.pi * ground.height_sd_m)
        found = [replace(on_ground, cost=cost(DEFAULT_EYE_HEIGHT_M, peak))]
        for height in sorted(heights, key=lambda one: one.scale_m):
            above_m = height.above_m
            if above_m - DEFAULT_EYE_HEIGHT_M <= _ALOFT.least_sds * ground.height_sd_m:
                continue
            if any(abs(above_m - other.eye.usual_m) <= height.scale_m for other in found[1:]):
                continue
            eye = EyeHeightPrior(above_m, max(height.scale_m, ground.height_sd_m))
            found.append(
                cls(
                    eye,
                    elevation_m=ground.elevation_m + above_m,
                    elevation_scale_m=height.elevation_scale_m,
                    cost=cost(above_m, _density_aloft(aloft, above_m)),
                )
            )
        return found


@dataclass(frozen=True, slots=True)
class _NotedHeight:
    """A height above the known ground that a photo notes.

    Its error is distributed as in `skyline.match.position_prior.PositionPrior`.
    """

    above_m: float
    scale_m: float
    """Scale of the error above the ground, whose elevation is not quite known."""
    elevation_scale_m: float
    """Scale of the error of the elevation."""

    def cost(self, above_m: float) -> float:
        """Return the negative log density of noting this height at others."""
        off = (above_m - self.above_m) / self.scale_m
        return NOTED_ERRORS.altitude_tail * math.log1p(off**2) + math.log(2.0 * self.scale_m)


def _density_aloft(share: float, above_m: float) -> float:
    """Return the density of a height above the ground of eyes aloft."""
    return share * 2.0 / (math.pi * _ALOFT.median_m) / (1.0 + (above_m / _ALOFT.median_m) ** 2)


def _noted_heights(noted: NotedPlace, ground: KnownGround) -> list[_NotedHeight]:
    """Return the heights above the known ground that a photo notes."""
    found = []
    if noted.takeoff_height_m is not None:
        drift_m = NOTED_ERRORS.takeoff_share * abs(noted.takeoff_height_m)
        scale_m = math.hypot(ground.takeoff_relief_m, NOTED_ERRORS.takeoff_scale_m, drift_m)
        found.append(_NotedHeight(noted.takeoff_height_m, scale_m, scale_m))
    if noted.elevation_m is not None:
        above_m = noted.elevation_m - ground.elevation_m
        scale_m = noted_altitude_scale_m(noted)
        found.append(_NotedHeight(above_m, math.hypot(scale_m, ground.relief_m), scale_m))
    return found
