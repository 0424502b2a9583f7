r"""How likely a query's residuals are, when the photo errs and so does the terrain model.

A column's residual, query over terrain in radians of elevation, is the sum of

* the photo's error, independent from column to column, of deviation sigma_a, and
* the terrain model's error in height over the skyline's distance. Heights err together within
  some hundred metres, and the eye stands on the same wrong ground; so with p_i the skyline's
  points, d_i their distances, o the eye and rho a Matern 3/2 correlation

  .. math::

     K_{ij} = \frac{\sigma_h^2}{d_i d_j}
     \left(\rho(p_i, p_j) - \rho(p_i, o) - \rho(p_j, o) + 1\right)

Not every column shows the terrain: trees and houses raise the skyline, and only errors lower it.
Such a residual may be anything within a range, with unequal odds for above and below. Where a
surface model says how far things may rise, what is above lies anywhere up to there, but for the
errors, and beyond is as unlikely as below. Where the data end, terrain that the model lacks may
stand above its skyline, up to a bound: there a column may also lie anywhere between the two.
The odds of each column are variational; the bound on
the likelihood is exact where K is 0. Height errors are kept at a few nodes along the skyline, so
that everything costs matrices of that size.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import Float64Array, IntArray, Rows
from skyline.errors import InputError

_X_AT_ONE_OVER_E = 2.1461932206205825
"""Where (1 + x) exp(-x) is 1 / e."""
_JITTER = 1e-6
_UNKNOWN_M = 1e9
_LEAST = 1e-12
_GREATEST_LOGIT = 50.0
_LEAST_RISE = 0.1
"""In deviations of the errors: a smaller rise is none."""
_SCALE = (0.1, 1.3)
"""Of all errors together: half a step of the deviations up, and down to a skyline without noise."""


@dataclass(frozen=True, slots=True)
class Noise:
    """What residuals may be like; see the module."""

    angle_deg: tuple[float, ...] = (0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.5, 0.8)
    """Deviations of the photo's error to choose from by likelihood, increasing."""
    height_shares: tuple[float, ...] = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0)
    """Deviations of heights to choose from likewise, as shares of the one to be expected."""
    height_sd_m: float = 5.0
    """That one."""
    reach_m: float = 300.0
    """Distance at which the correlation of height errors has fallen to 1 / e."""
    rough_share: float = 0.4
    """Part of the heights' deviation that is independent from column to column."""
    above_share: float = 0.15
    below_share: float = 0.02
    """``above_share``, ``below_share``: odds that a column shows something higher than the
    terrain's skyline, or lower."""
    range_deg: float = 15.0
    """How far off such a column may be."""
    beyond_share: float = 0.3
    """Part of the columns, of those that terrain past the data's edge may rise in, that it does."""
    nodes: int = 32
    """Height errors along the skyline; with 0 only the eye's is shared by the columns, and the
    skyline's own are independent: quicker, and drawn to a place from farther off."""

    def __post_init__(self) -> None:
        for name, values in (
            ("angle_deg", self.angle_deg),
            ("height_shares", self.height_shares),
        ):
            if not values or not (np.diff((0.0, *values)) > 0.0).all():
                raise InputError(f"{name} is {values}; expected deviations above 0, increasing")
        if min(self.below_share, self.above_share) <= 0.0 or (
            self.above_share + self.below_share >= 1.0
        ):
            raise InputError(
                f"shares of outliers are {self.above_share} and {self.below_share}; expected two "
                "above 0 with a sum below 1"
            )
        if not self.height_sd_m > 0.0:
            raise InputError(
                f"the deviation of heights is {self.height_sd_m} m; expected more than 0"
            )
        if not (self.reach_m > 0.0 and self.range_deg > 0.0 and self.nodes >= 0):
            raise InputError(
                f"reach is {self.reach_m} m, range {self.range_deg} degrees and nodes "
                f"{self.nodes}; expected two above 0 and a number of nodes"
            )

    @property
    def height_m(self) -> tuple[float, ...]:
        """Deviations of heights to choose from, increasing."""
        return tuple(share * self.height_sd_m for share in self.height_shares)

    @property
    def widest(self) -> tuple[int, int]:
        """Indices of the greatest deviations."""
        return len(self.angle_deg) - 1, len(self.height_shares) - 1


@dataclass(frozen=True, slots=True, eq=False)
class HeightErrors(Rows):
    """What height errors of 1 m do to the R columns of M curves."""

    factor: Float64Array
    """(M, R, K) float64. Correlated residuals are ``factor @ z`` with K standard normal z."""
    rough: Float64Array
    """(M, R) float64. Deviation of the independent ones, radians."""
    blur_rad: Float64Array
    """(M, R) float64. Deviation that the steps of azimuth leave, whatever the heights: great where
    the skyline is steep."""
    rise_rad: Float64Array
    """(M, R) float64. How far above the terrain's skyline something else may rise; NaN where that
    is not known."""
    beyond_rad: Float64Array
    """(M, R) float64. How far above it terrain past the data's edge may rise; 0 or less where it
    cannot."""

    @classmethod
    def of(
        cls,
        azimuth_rad: Float64Array,
        distance_m: Float64Array,
        blur_rad: Float64Array,
        noise: Noise,
        rise_rad: Float64Array | None = None,
        beyond_rad: Float64Array | None = None,
    ) -> "HeightErrors":
        """Prepare for skylines at azimuths and horizontal distances (NaN: unknown), (M, R)."""
        rise_rad = np.full_like(blur_rad, np.nan) if rise_rad is None else rise_rad
        beyond_rad = np.zeros_like(blur_rad) if beyond_rad is None else beyond_rad
        distance = np.where(np.isfinite(distance_m), distance_m, _UNKNOWN_M)
        if not noise.nodes:
            reach_m = 2.0 / 3.0 * noise.reach_m
            shared = distance / (distance**2 + reach_m**2)
            rough = 1.0 / np.hypot(distance, reach_m)
            return cls(shared[..., np.newaxis], rough, blur_rad, rise_rad, beyond_rad)
        column = np.arange(distance.shape[1])
        node = np.unique(np.rint(np.linspace(0, column[-1], noise.nodes)).astype(np.intp))
        # Weights (R, K) of linear interpolation.
        between = np.stack([np.interp(column, node, unit) for unit in np.eye(len(node))], axis=1)
        place = (distance * np.exp(1j * azimuth_rad))[:, node]
        to_eye = 0.5 - _correlation(np.abs(place), noise.reach_m)
        apart = np.abs(place[:, :, np.newaxis] - place[:, np.newaxis, :])
        covariance = _correlation(apart, noise.reach_m) + (
            to_eye[:, :, np.newaxis] + to_eye[:, np.newaxis, :]
        )
        root = np.linalg.cholesky(covariance + _JITTER * np.eye(len(node)))
        return cls(
            between @ root / distance[..., np.newaxis],
            noise.rough_share / np.hypot(distance, noise.reach_m / 3.0),
            blur_rad,
            rise_rad,
            beyond_rad,
        )


def _correlation(distance_m: Float64Array, reach_m: float) -> Float64Array:
    x = distance_m * (_X_AT_ONE_OVER_E / reach_m)
    return np.asarray((1.0 + x) * np.exp(-x))


@dataclass(frozen=True, slots=True, eq=False)
class Judged(Rows):
    """Residuals of M curves under a noise."""

    cost: Float64Array
    """(M,) float64. Negative logarithm of the likelihood."""
    fit: Float64Array
    """(M,) float64. Its part that is half the squared residuals over their covariance."""
    odds: Float64Array
    """(M, R) float64. Odds that a column shows terrain; 0 where the terrain is unknown."""
    shown: Float64Array
    """(M, R) float64. The same, times the trust in the column."""
    photo: Float64Array
    """(M, R) float64. The photo's part of each column's variance."""
    weight: Float64Array
    """(M, R) float64. Precision of each column by itself, per square radian."""
    factor: Float64Array
    """(M, R, K) float64. `HeightErrors.factor` times the deviation of heights."""
    inner: Float64Array
    """(M, K, K) float64. Inverse of I + factor^T weight factor."""

    def product(self, left: Float64Array, right: Float64Array) -> Float64Array:
        """Return left^T C^-1 right, (M, P, Q), of (M, R, P) and (M, R, Q), C the covariance."""
        weighted = self.weight[..., np.newaxis] * right
        held = (self.weight[..., np.newaxis] * left).swapaxes(1, 2) @ self.factor
        answer = self.inner @ (self.factor.swapaxes(1, 2) @ weighted)
        return np.asarray(left.swapaxes(1, 2) @ weighted - held @ answer)

    def scaled(self) -> "Judged":
        """Return the same with all errors larger or smaller by one factor, the likeliest.

        The deviations to choose from are steps apart, and some residuals are smaller than any of
        them expects. Where errors are expected that are not there, a wider lens, whose pixels are
        larger angles, would seem the likelier.
        """
        count = np.maximum(self.shown.sum(axis=1), _LEAST)
        scale = np.clip(np.sqrt(2.0 * self.fit / count), *_SCALE)
        return replace(
            self,
            cost=self.cost + count * np.log(scale) + self.fit * (scale**-2.0 - 1.0),
            fit=self.fit / scale**2,
            weight=self.weight / scale[:, np.newaxis] ** 2,
            factor=self.factor * scale[:, np.newaxis, np.newaxis],
        )

    def magnification_pull(self, residual_rad: Float64Array) -> Float64Array:
        """Return (M,): how fast the cost falls as log magnification rises and residuals stay.

        ``residual_rad`` (M, R) is 0 where the terrain is unknown.
        """
        held = (self.weight * residual_rad)[..., np.newaxis]
        reached = self.factor @ self.inner
        explained = (reached @ (self.factor.swapaxes(1, 2) @ held))[..., 0]
        spread = (reached * self.factor).sum(axis=-1)
        off = self.weight * ((residual_rad - explained) ** 2 + spread)
        return np.asarray((self.shown - self.photo * (self.shown - off)).sum(axis=1))

    @property
    def effective_columns(self) -> Float64Array:
        """(M,): how many independent columns say as much about the residuals."""
        taken = self.inner.shape[1] - np.trace(self.inner, axis1=1, axis2=2)
        return np.asarray(self.odds.sum(axis=1) - taken)


def judge(
    residual_rad: Float64Array,
    trust: Float64Array,
    errors: HeightErrors,
    noise: Noise,
    deviations: tuple[IntArray, IntArray],
    odds: Float64Array,
    magnified: Float64Array | float = 1.0,
) -> Judged:
    """Judge residuals, the odds of each column improved once.

    Parameters
    ----------
    residual_rad : (M, R) float64
        Query over terrain; where NaN, the terrain is unknown and the column as likely as one
        that shows something else.
    trust : (R,) float64
        How far each column of the query is trusted.
    errors, noise
    deviations : ((M,) intp, (M,) intp)
        Which of ``noise.angle_deg`` and of ``noise.height_m`` each curve has.
    odds : (M, R) float64
        To start from.
    magnified : (M,) float64, optional
        How much larger an angle each curve makes of a pixel than the query's own lens: the photo's
        error is of pixels, and so is what the likelihood is a density of.
    """
    magnified = np.broadcast_to(magnified, len(residual_rad))[:, np.newaxis]
    known = np.isfinite(residual_rad)
    residual = np.where(known, residual_rad, 0.0)
    angle_rad = magnified * np.radians(noise.angle_deg)[deviations[0]][:, np.newaxis]
    height_m = np.array(noise.height_m)[deviations[1]][:, np.newaxis]
    variance = angle_rad**2 + (height_m * errors.rough) ** 2 + errors.blur_rad**2
    factor = height_m[..., np.newaxis] * errors.factor
    explained, inner, _ = _explained(residual, trust * odds * known / variance, factor)
    spread = ((factor @ inner) * factor).sum(axis=-1)
    off = residual - explained
    bare: Float64Array | float = 1.0 - noise.above_share - noise.below_share
    other = np.where(residual >= 0.0, noise.above_share, noise.below_share)
    other = other / np.radians(noise.range_deg)
    limited, open_ = np.isfinite(errors.rise_rad), errors.beyond_rad > 0.0
    if limited.any():
        share, risen = _risen(off, errors.rise_rad, np.sqrt(variance + spread), noise)
        bare = np.where(limited, share, bare)
        other = np.where(limited, magnified * risen, other)
    if open_.any():
        hidden, density = _hidden(off, errors.beyond_rad, np.sqrt(variance + spread), noise)
        bare = np.where(open_, bare * (1.0 - hidden), bare)
        other = np.where(open_, other * (1.0 - hidden) + magnified * density, other)
    terrain = np.log(bare) - 0.5 * np.log(2.0 * np.pi * variance / magnified**2)
    other = np.log(other)
    logit = terrain - 0.5 * (off**2 + spread) / variance - other
    odds = known / (1.0 + np.exp(-np.clip(logit, -_GREATEST_LOGIT, _GREATEST_LOGIT)))
    weight = trust * odds / variance
    explained, inner, half_log_det = _explained(residual, weight, factor)
    each = _entropy(odds) - odds * terrain - (1.0 - odds) * other
    fit = 0.5 * (weight * residual * (residual - explained)).sum(axis=1)
    cost = each @ trust + half_log_det + fit
    shown, photo = trust * odds, angle_rad**2 / variance
    return Judged(cost, fit, odds, shown, photo, weight, factor, inner)


def _risen(
    off_rad: Float64Array, rise_rad: Float64Array, sd_rad: Float64Array, noise: Noise
) -> tuple[Float64Array, Float64Array]:
    """Return the share of terrain, and the density of all else, (M, R), where a rise is known.

    What covers the terrain is as likely anywhere up to the rise, blurred by the errors; the higher
    it may rise, beside the errors, the likelier it is to be there.
    """
    range_rad = np.radians(noise.range_deg)
    rise_rad = np.clip(rise_rad, _LEAST_RISE * sd_rad, range_rad)
    within = _within(off_rad, rise_rad, sd_rad)
    shown = 1.0 - 2.0 * noise.below_share
    covered = shown * rise_rad / (rise_rad + 2.0 * sd_rad)
    return shown - covered, covered * within + noise.below_share / range_rad


def _hidden(
    off_rad: Float64Array, beyond_rad: Float64Array, sd_rad: Float64Array, noise: Noise
) -> tuple[Float64Array, Float64Array]:
    """Return the share of columns, and their density, (M, R), that terrain past the edge rises in.

    It is as likely anywhere up to its bound, blurred by the errors, and the less likely to be there
    the less it could rise beside them.
    """
    rise_rad = np.clip(beyond_rad, _LEAST_RISE * sd_rad, np.radians(noise.range_deg))
    hidden = noise.beyond_share * rise_rad / (rise_rad + 2.0 * sd_rad)
    return hidden, hidden * _within(off_rad, rise_rad, sd_rad)


def _within(off_rad: Float64Array, rise_rad: Float64Array, sd_rad: Float64Array) -> Float64Array:
    """Return the density of what is as likely anywhere from 0 to a rise, blurred by errors."""
    from scipy.special import ndtr  # noqa: PLC0415  (slow to load, seldom needed)

    below = ndtr(off_rad / sd_rad) - ndtr((off_rad - rise_rad) / sd_rad)
    return np.asarray(below / rise_rad)


def _explained(
    residual: Float64Array, weight: Float64Array, factor: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return what height errors explain of residuals (M, R), the inner inverse and log det."""
    across = factor.swapaxes(1, 2)
    core = across @ (weight[..., np.newaxis] * factor) + np.eye(factor.shape[2])
    root = np.linalg.cholesky(core)
    inner = np.asarray(np.linalg.inv(core))
    error = inner @ (across @ (weight * residual)[..., np.newaxis])
    half_log_det = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    return (factor @ error)[..., 0], inner, half_log_det


def _entropy(odds: Float64Array) -> Float64Array:
    """Return p log p + (1 - p) log(1 - p)."""
    rest = 1.0 - odds
    return odds * np.log(np.maximum(odds, _LEAST)) + rest * np.log(np.maximum(rest, _LEAST))
