"""How high above the terrain model's ground a photo may have been taken."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array

_LEAST_SD_M = 1e-6
_GREATEST_SD = 20.0


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
