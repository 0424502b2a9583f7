"""The Earth's radius, curvature less refraction, and range of ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array, FloatArray, refuse_text
from skyline.errors import InputError

EARTH_RADIUS_M = 6371008.8
"""The mean radius of the Earth."""

EQUATOR_RADIUS_M = 6378137.0
"""The radius of the equator, the semi-major axis of WGS 84."""

DEFAULT_REFRACTION_K = 0.13
"""The share of the Earth's curvature that refraction usually compensates by day."""

_LEAST_AWAY_M = 1e-3
"""The least distance of a point from an eye: a point right over an eye has a direction, too."""

GROUND_M = (-500.0, 9000.0)
"""Lowest and highest ground on Earth, with a margin: Dead Sea -430 m, Everest 8849 m."""


@dataclass(frozen=True)
class Curvature:
    """Drop of the surface below the eye's tangent plane, refraction included."""

    radius_m: float = EARTH_RADIUS_M
    """Radius of the planet."""
    refraction_k: float = DEFAULT_REFRACTION_K
    """Share of the curvature that refraction compensates."""
    enabled: bool = True
    """False leaves the plane flat."""

    def __post_init__(self) -> None:
        refuse_text(radius_m=self.radius_m, refraction_k=self.refraction_k)
        if not (np.isfinite(self.radius_m) and self.radius_m > 0.0):
            raise InputError(
                f"planet radius is {self.radius_m} m; expected a positive number of metres"
            )
        if not (np.isfinite(self.refraction_k) and -1.0 <= self.refraction_k < 1.0):
            raise InputError(
                f"refraction k is {self.refraction_k}; expected -1 <= k < 1 (0.13 is usual)"
            )

    @property
    def drop_per_m2(self) -> float:
        """The drop per squared distance, (1 - k) / (2 R)."""
        return (1.0 - self.refraction_k) / (2.0 * self.radius_m) if self.enabled else 0.0

    def drop_m(self, distance_m: ArrayLike) -> Float64Array:
        """Return the drop in metres at horizontal distances in metres."""
        refuse_text(distance_m=distance_m)
        return self.drop_per_m2 * np.square(np.asarray(distance_m, dtype=np.float64))

    def horizon_m(self, below_m: FloatArray | float) -> Any:
        """Return the distance of the horizon of level ground, metres.

        The ground lies ``below_m`` metres below the eye. If it lies above, the distance is 0; on a
        flat plane it is infinite. The dtype is the argument's.
        """
        return np.sqrt(np.maximum(below_m, 0.0) / self.drop_per_m2)

    def seen(
        self, east_m: Float64Array, north_m: Float64Array, up_m: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return how an eye sees points: azimuths, tangents and distances.

        The points (N,) lie so many metres east, north and up from the eye. Azimuths are radians
        from the map's north. The tangent of elevation is the height less the drop, over the
        horizontal distance, which is at least `_LEAST_AWAY_M`.
        """
        away_m = np.maximum(np.hypot(east_m, north_m), _LEAST_AWAY_M)
        return np.arctan2(east_m, north_m), (up_m - self.drop_m(away_m)) / away_m, away_m

    def seen_changes(
        self, azimuth_rad: Float64Array, elevation_tan: Float64Array, distance_m: Float64Array
    ) -> Float64Array:
        """Return the derivatives (N, 2, 3) of what `seen` returns.

        They are of azimuth, radians, and tangent, by a metre east, north and up of the point.
        """
        sine, cosine, none = np.sin(azimuth_rad), np.cos(azimuth_rad), np.zeros_like(distance_m)
        outward = -elevation_tan / distance_m - 2.0 * self.drop_per_m2
        by_azimuth = np.stack([cosine / distance_m, -sine / distance_m, none], axis=-1)
        by_tangent = np.stack([outward * sine, outward * cosine, 1.0 / distance_m], axis=-1)
        return np.stack([by_azimuth, by_tangent], axis=-2)
