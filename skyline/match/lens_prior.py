r"""The prior of a lens: one density for search, fits and verdict.

With the logarithm x of a scale divided by the noted scale (`skyline.match.rays.Rays.log_scale`),
the standard deviation s of x, and the probability w that the photo was cropped,

.. math::

    p(x) = (1 - w) N(x; s) + w \frac{2}{\sqrt{2 \pi} (s + t)} e^{-x^2 / 2 u^2}, \quad
    u = \begin{cases} t & x < 0 \\ s & x \ge 0 \end{cases}

The first part is the core: what cameras write is rounded, and off by the makers' tolerance. The
second part is the tail: a crop can only narrow the field of view. Both parts are centred at 0, so
the cost's slope is x times a precision, which falls in the tail. A parabola with that precision
lies above the cost, which is concave in x squared, so a Gauss-Newton step towards 0 does not raise
the cost.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from skyline.arrays import Float64Array

CROP_SD = 0.365
"""The tail's t: the root mean square of log(k) for shares k of the width that are left, even from a
half to 1 (`skyline.photo.frame.Crop`)."""


@dataclass(frozen=True, slots=True)
class LensPrior:
    """A lens known up to a deviation, and perhaps cropped."""

    sd: float = math.inf
    """Standard deviation of the logarithm of the scale; infinite for an even distribution."""
    crop_share: float = 0.0
    """Probability that the photo shows less than the field of view noted for it."""

    @property
    def rms(self) -> float:
        """Root mean square of the logarithm of the scale."""
        if not self.crop_share or self.sd >= CROP_SD:
            return self.sd
        of_tail = CROP_SD**2 - CROP_SD * self.sd + self.sd**2
        return math.sqrt((1.0 - self.crop_share) * self.sd**2 + self.crop_share * of_tail)

    def cost(self, log_scale: Any) -> Float64Array:
        """Return the negative log density of logarithms of scales, any shape.

        It is 0 at the noted scale.
        """
        core, tail, share = self._parts(log_scale)
        if not share:
            return core
        mixed = -np.logaddexp(math.log1p(-share) - core, math.log(share) - tail)
        return np.asarray(np.where(np.less(log_scale, 0.0), mixed, core))

    def precision(self, log_scale: Any) -> Float64Array:
        """Return the slope of `cost` divided by the logarithm of the scale.

        It is the weight of the pull towards the noted scale, and is above 0.
        """
        core, tail, share = self._parts(log_scale)
        precision = np.full_like(core, self.sd**-2.0)
        if not share:
            return precision
        ratio = (1.0 - share) / share * np.exp(np.clip(tail - core, -700.0, 700.0))
        in_tail = np.where(np.less(log_scale, 0.0), 1.0 / (1.0 + ratio), 0.0)
        return np.asarray(precision + in_tail * (CROP_SD**-2.0 - self.sd**-2.0))

    def deviations(self, log_scale: Any) -> Float64Array:
        """Return how unlikely scales are, as deviations of a normal density."""
        return np.sqrt(2.0 * np.maximum(self.cost(log_scale), 0.0))

    def _parts(self, log_scale: Any) -> tuple[Float64Array, Float64Array, float]:
        """Return costs of core and tail, and the tail's share at 0."""
        square = 0.5 * np.square(np.asarray(log_scale, dtype=np.float64))
        # A core as wide as crops needs no tail.
        if not self.crop_share or self.sd >= CROP_SD:
            return square * self.sd**-2.0, square, 0.0
        core = (1.0 - self.crop_share) / self.sd
        tail = 2.0 * self.crop_share / (self.sd + CROP_SD)
        return square * self.sd**-2.0, square * CROP_SD**-2.0, tail / (core + tail)
