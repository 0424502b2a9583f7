r"""The density of a camera's true place about a likely one.

A likely place is often near the truth, with an error like a two-dimensional Cauchy distribution of
scale s, and otherwise it has nothing to do with it. At distance d, the density over an even one is

.. math::

    w + (1 - w) \frac{A}{2 \pi s^2} \left(1 + \frac{d^2}{s^2}\right)^{-3/2}

where A is the area over which the true place is spread without a likely one. A distant place keeps
the share w of its density.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from skyline.arrays import Complex128Array, Float64Array

ANYWHERE_KM2 = 1000.0
"""The area of a search without a likely place: a circle of 18 km."""
OFF_MAP_M = 1e9
"""Easting and northing that stand for a place off the map."""


class PlacePrior(Protocol):
    """Prior knowledge of a camera's place."""

    def cost(
        self, position_m: Complex128Array, eye_m: Float64Array, heading_rad: Float64Array
    ) -> Float64Array:
        """Return the negative log (M,) of poses' density over an even one's.

        ``position_m`` holds eastings, and northings as the imaginary part; headings are grid
        azimuths of the optical axis.
        """
        ...

    def pull(
        self, position_m: Complex128Array, eye_m: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return the normal distribution that pulls eyes like this density.

        The results are its precisions (M, 3) along easting, northing and elevation, and the offsets
        (M, 3) of the eyes from the likely place, metres; precision times offset is the gradient of
        `cost`.
        """
        ...


@dataclass(frozen=True, slots=True)
class PlaceDensity:
    """The density of the true place about a likely one, over an even density."""

    scale_m: float
    """s."""
    elsewhere_share: float
    """w, the share of true places that have nothing to do with the likely one."""
    anywhere_m2: float = 1e6 * ANYWHERE_KM2
    """A, the area over which the even density is spread."""

    def cost(self, off_m: Complex128Array) -> Float64Array:
        """Return the negative log of the density.

        ``off_m`` (M,) are offsets from the likely place: to the east, and to the north as the
        imaginary part.
        """
        return -np.log(self.elsewhere_share + self._peak * self._tail(off_m) ** -1.5)

    def pull(self, off_m: Complex128Array) -> tuple[Float64Array, Float64Array]:
        """Return the pull (M, 3) to the likely place, and offsets (M, 3); see `PlacePrior`.

        Nothing pulls upwards.
        """
        tail = self._tail(off_m)
        pull = 3.0 * self._peak * tail**-2.5 / self.scale_m**2
        across = pull / (self.elsewhere_share + self._peak * tail**-1.5)
        none = np.zeros(len(off_m))
        offset_m = np.column_stack([off_m.real, off_m.imag, none])
        return np.column_stack([across, across, none]), offset_m

    @property
    def _peak(self) -> float:
        return (1.0 - self.elsewhere_share) * self.anywhere_m2 / (2.0 * np.pi * self.scale_m**2)

    def _tail(self, off_m: Complex128Array) -> Float64Array:
        return np.asarray(1.0 + (off_m.real**2 + off_m.imag**2) / self.scale_m**2)
