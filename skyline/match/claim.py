r"""What is likely of a pose before a skyline is compared: where its photo says, and how high.

A compass is hardly more than a hint, and a position has a long tail: it is near the truth most of
the time, with an error like a Cauchy distribution's of two dimensions, and now and then it is
another photo's, or the phone's last one before it was carried elsewhere. So the density of the
truth about a claim is

.. math::

    p(d) = \frac{1 - w}{2 \pi s^2} \left(1 + \frac{d^2}{s^2}\right)^{-3/2} + \frac{w}{A}

and a place far off is never less likely than one of a search of the area A without a claim.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.geodesy import Frame, in_turn
from skyline.photo.exif import NotedPlace

_WRONG_SHARE = 0.05
"""Of photos with a position: of 20 looked at, one lay 6 km off."""
_ANYWHERE_M2 = 1e9
"""Where the truth lies then: within 18 km, as a search without a claim would have it."""
_COMPASS_WRONG_SHARE = 0.2
"""Compasses are disturbed by cars, railings and cases: what they say is hardly more than a hint."""
_REACH_SD = 3.0
_REACH_M = 1000.0
_LEAST_SD_M = 1e-6
_GREATEST_SD = 20.0


@dataclass(frozen=True, slots=True)
class Claim:
    """Where a photo says that it was taken, in the frame of a search."""

    easting_m: float
    northing_m: float
    sd_m: float
    """Scale of the position's error."""
    heading_deg: float | None = None
    """Grid azimuth of the optical axis."""
    heading_sd_deg: float = 20.0
    """Its deviation, where the compass is right."""
    elevation_m: float | None = None
    """Of the eye; its error is spread like a Cauchy distribution."""
    elevation_sd_m: float = 30.0
    """How it is spread."""
    weight: float = 1.0
    """What its probabilities count among scores, which may be worth less than log odds."""

    def __post_init__(self) -> None:
        if not (np.isfinite([self.easting_m, self.northing_m]).all() and self.sd_m > 0.0):
            raise InputError(
                f"a claim is {self.easting_m:g}, {self.northing_m:g} within {self.sd_m:g} m; "
                "expected a place and a scale above 0"
            )

    @property
    def reach_m(self) -> float:
        """How far about the claim places are always looked at."""
        return _REACH_M + _REACH_SD * self.sd_m

    def cost(
        self, place_m: NDArray[np.complex128], eye_m: Float64Array, heading_rad: Float64Array
    ) -> Float64Array:
        """Return -log of how much likelier poses (M,) are than without the claim, times the weight.

        ``place_m`` is the easting, and the northing as the imaginary part; headings are grid
        azimuths of the optical axis.
        """
        cost = -np.log(_WRONG_SHARE + self._peak * self._tail(place_m) ** -1.5)
        if self.heading_deg is not None:
            turn = np.degrees(heading_rad) - self.heading_deg
            off = in_turn(turn) / self.heading_sd_deg
            right = 360.0 / (np.sqrt(2.0 * np.pi) * self.heading_sd_deg)
            right *= 1.0 - _COMPASS_WRONG_SHARE
            cost = cost - np.log(_COMPASS_WRONG_SHARE + right * np.exp(-0.5 * off**2))
        if self.elevation_m is not None:
            cost = cost + np.log1p(((eye_m - self.elevation_m) / self.elevation_sd_m) ** 2)
        return np.asarray(self.weight * cost)

    def precision(self, place_m: NDArray[np.complex128]) -> Float64Array:
        """Return the precision (M,) of the normal distribution that draws places as much."""
        tail = self._tail(place_m)
        pull = 3.0 * self._peak * tail**-2.5 / self.sd_m**2
        return np.asarray(self.weight * pull / (_WRONG_SHARE + self._peak * tail**-1.5))

    def lift(self, eye_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return what draws elevations of eyes (M,), as `precision`, and their offsets from it."""
        if self.elevation_m is None:
            return np.zeros_like(eye_m), np.zeros_like(eye_m)
        off_m = eye_m - self.elevation_m
        return 2.0 * self.weight / (self.elevation_sd_m**2 + off_m**2), off_m

    def offset_m(self, place_m: NDArray[np.complex128]) -> Float64Array:
        """Return how far places (M,) lie east and north of the claim, (M, 2)."""
        off = place_m - complex(self.easting_m, self.northing_m)
        return np.stack([off.real, off.imag], axis=-1)

    @property
    def _peak(self) -> float:
        return (1.0 - _WRONG_SHARE) * _ANYWHERE_M2 / (2.0 * np.pi * self.sd_m**2)

    def _tail(self, place_m: NDArray[np.complex128]) -> Float64Array:
        return np.asarray(1.0 + (self.offset_m(place_m) ** 2).sum(axis=-1) / self.sd_m**2)


@dataclass(frozen=True, slots=True)
class EyeHeight:
    r"""How high an eye may stand above the terrain model's ground.

    Most stand about as high as a person. Where the model cuts a summit or a cliff off they stand
    far above its ground, so what is added is spread like a Cauchy distribution:
    :math:`-\log p(h) = \log(1 + ((h - usual) / sd)^2)`.
    """

    usual_m: float
    sd_m: float
    """How the rest is spread; 0 where the height is known."""

    @property
    def least_m(self) -> float:
        """The least height that is tried."""
        return self.usual_m if self.sd_m == 0.0 else 0.0

    @property
    def most_m(self) -> float:
        """The greatest height that is tried."""
        return self.usual_m + _GREATEST_SD * self.sd_m

    def cost(self, height_m: Float64Array) -> Float64Array:
        """Return the negative logarithm of the probability of heights (M,), but for a constant."""
        return np.asarray(np.log1p(self._deviations(height_m) ** 2))

    def precision(self, height_m: Float64Array) -> Float64Array:
        """Return the precision (M,) of the normal distribution that draws heights as much."""
        sd_m = max(self.sd_m, _LEAST_SD_M)
        return np.asarray(2.0 / (sd_m**2 * (1.0 + self._deviations(height_m) ** 2)))

    def _deviations(self, height_m: Float64Array) -> Float64Array:
        return (height_m - self.usual_m) / max(self.sd_m, _LEAST_SD_M)


_GPS_SD_M, _LEAST_GPS_SD_M = 30.0, 15.0
"""Scales of positions without an accuracy, and of those with a good one: the model is off too."""
_LEAST_ALTITUDE_SD_M, _ALTITUDE_ACCURACIES = 15.0, 3.0
"""Heights are two to three times as uncertain as places, and the model's datum may be another."""
_COMPASS_SD_DEG, _MAGNETIC_SD_DEG = 20.0, 30.0
"""The declination, which nothing here knows, is up to 20 degrees where people live. A compass that
does not say which north it points to may point to the magnetic one."""


def claim_of(noted: NotedPlace, frame: Frame) -> Claim | None:
    """Return what a photo notes of its place as a prior in a frame; None where it notes none."""
    if noted.lonlat_deg is None:
        return None
    east, north = (float(value) for value in frame.from_lonlat(*noted.lonlat_deg))
    if not (np.isfinite(east) and np.isfinite(north)):
        return None  # Too far from the frame to have a place in it.
    heading_deg = noted.heading_deg
    if heading_deg is not None:
        heading_deg -= float(frame.convergence_deg(easting_m=east, northing_m=north))
    sd_m = max(_LEAST_GPS_SD_M, noted.accuracy_m or _GPS_SD_M)
    compass_sd_deg = _COMPASS_SD_DEG if noted.is_magnetic is False else _MAGNETIC_SD_DEG
    elevation_m, elevation_sd_m = None, _LEAST_ALTITUDE_SD_M
    if noted.accuracy_m is not None:
        # Who says how good a position is has satellites in view, and corrects for the geoid.
        elevation_m = noted.elevation_m
        elevation_sd_m = max(_LEAST_ALTITUDE_SD_M, _ALTITUDE_ACCURACIES * noted.accuracy_m)
    return Claim(east, north, sd_m, heading_deg, compass_sd_deg, elevation_m, elevation_sd_m)
