r"""Likelihood of a photo's residuals under errors of photo and terrain.

The residual of a column is the elevation of the photo's skyline above the rendered one, radians.
It is the sum of

* the photo's error, independent from column to column, with standard deviation sigma_a, and
* the error of the terrain model's heights divided by the skyline's distance. Height errors within
  some hundred metres are correlated, and the eye stands on ground with such an error too. With the
  skyline's points p_i, their distances d_i, the eye o and a Matern 3/2 correlation rho,

  .. math::

     K_{ij} = \frac{\sigma_h^2}{d_i d_j}
     \left(\rho(p_i, p_j) - \rho(p_i, o) - \rho(p_j, o) + 1\right)

Not every column shows terrain. Trees and houses raise the skyline; only errors of the extraction
lower it. The residual of a column without terrain is uniform over a range, with unequal shares
above and below. Where a surface model bounds how far things may rise, a column above the terrain
lies anywhere up to that bound, blurred by the errors, and columns beyond it are as unlikely as
those below. Past the edge of the data, terrain that the model lacks may rise above the model's
skyline, up to another bound; then a column may also lie anywhere between the two.

The probability that a column shows terrain is variational: the bound on the likelihood is exact
where K is 0. Height errors are represented at a few nodes along the skyline, so that all matrices
have the size of the number of nodes.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import BoolArray, Float64Array, Rows
from skyline.terrain.height_errors import HEIGHT_REACH_M, height_correlation

GREATEST_LOG_ODDS = 50.0
"""Greater log odds count as this, so that their exponential is finite."""


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """Assumptions about height errors and about columns without terrain."""

    rough_share: float = 0.4
    """Share of the heights' standard deviation that is independent from column to column."""
    above_share: float = 0.15
    """Prior probability that a column shows a tree or a house above the terrain's skyline."""
    below_share: float = 0.02
    """Prior probability that a column lies below the terrain's skyline. Only errors of the
    extraction put it there, so it is far smaller than `above_share`."""
    range_rad: float = np.radians(15.0)
    """Largest residual of a column that does not show terrain."""
    beyond_share: float = 0.3
    """Greatest share of the columns where terrain past the data's edge may rise in which it does.
    Neighbouring columns share that terrain, so each pose has a share of its own."""
    share_rounds: int = 4
    """Rounds in which this share is found: each moves it most of the way."""
    least_rise_sds: float = 0.1
    """Smallest rise that is distinguished from none, in standard deviations of the errors."""
    least_factor: float = 0.1
    """Least common factor of all errors; a skyline without noise needs it."""
    greatest_factor: float = 1.3
    """Greatest common factor of all errors: half a step between two of the solver's deviations."""


_MODEL = ErrorModel()
_DENSITY_ABOVE = _MODEL.above_share / _MODEL.range_rad
_DENSITY_BELOW = _MODEL.below_share / _MODEL.range_rad


@dataclass(frozen=True, slots=True, eq=False)
class HeightErrors(Rows):
    """Effect of height errors of 1 m rms on M curves."""

    factor: Float64Array
    """(M, R, K) float64. Correlated residuals are ``factor @ z`` with K standard normal z."""
    rough: Float64Array
    """(M, R) float64. Standard deviation of the independent residuals, radians."""
    blur_rad: Float64Array
    """(M, R) float64. Standard deviation due to the steps of azimuth: large where the skyline is
    steep."""
    rise_rad: Float64Array
    """(M, R) float64. How far things may rise above the terrain's skyline; NaN where unknown."""
    beyond_rad: Float64Array
    """(M, R) float64. How far terrain past the data's edge may rise above the skyline; 0 or less
    where it cannot."""

    @classmethod
    def of(
        cls,
        azimuth_rad: Float64Array,
        distance_m: Float64Array,
        blur_rad: Float64Array,
        nodes: int,
        rise_rad: Float64Array | None = None,
        beyond_rad: Float64Array | None = None,
    ) -> "HeightErrors":
        """Return the errors of skylines at azimuths and horizontal distances (M, R).

        Distances are NaN where unknown. ``nodes`` is the number of height errors along a skyline.
        With 0 nodes the columns share only the eye's height error, and the skyline's own errors are
        independent: that is quicker, and converges from farther away.
        """
        rise_rad = np.full_like(blur_rad, np.nan) if rise_rad is None else rise_rad
        beyond_rad = np.zeros_like(blur_rad) if beyond_rad is None else beyond_rad
        # An unknown skyline is taken to be so far away that height errors hardly move it.
        distance = np.where(np.isfinite(distance_m), distance_m, 1e9)
        if nodes:
            factor = _factor_at_nodes(azimuth_rad, distance, nodes)
            rough = _MODEL.rough_share / np.hypot(distance, HEIGHT_REACH_M / 3.0)
        else:
            reach_m = 2.0 / 3.0 * HEIGHT_REACH_M
            factor = (distance / (distance**2 + reach_m**2))[..., np.newaxis]
            rough = 1.0 / np.hypot(distance, reach_m)
        return cls(factor, rough, blur_rad, rise_rad, beyond_rad)

    @property
    def may_rise(self) -> BoolArray:
        """Whether terrain past the data's edge may hide the skyline (M, R)."""
        return self.beyond_rad > 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Likelihood(Rows):
    """Likelihood of the residuals of M curves under given errors."""

    cost: Float64Array
    """(M,) float64. Negative log-likelihood."""
    half_chi2: Float64Array
    """(M,) float64. The part of the cost that is half the squared residuals over their
    covariance."""
    terrain_probability: Float64Array
    """(M, R) float64. Probability that a column shows terrain; 0 where the terrain is unknown."""
    trusted_probability: Float64Array
    """(M, R) float64. `terrain_probability` times the trust in the column."""
    photo_share: Float64Array
    """(M, R) float64. The photo's share of each column's variance."""
    weight: Float64Array
    """(M, R) float64. Precision of each column by itself, per square radian."""
    factor: Float64Array
    """(M, R, K) float64. `HeightErrors.factor` times the standard deviation of heights."""
    inner: Float64Array
    """(M, K, K) float64. Inverse of I + factor^T weight factor."""
    may_rise: BoolArray
    """(M, R) bool. `HeightErrors.may_rise`."""

    def product(self, left: Float64Array, right: Float64Array) -> Float64Array:
        """Return left C^-1 right^T (M, P, Q), with the covariance C.

        ``left`` is (M, P, R), ``right`` (M, Q, R).
        """
        weighted = self.weight[:, np.newaxis] * right
        left_weighted = weighted if left is right else self.weight[:, np.newaxis] * left
        left_nodes = left_weighted @ self.factor
        right_nodes = self.inner @ (weighted @ self.factor).swapaxes(1, 2)
        return np.asarray(left @ weighted.swapaxes(1, 2) - left_nodes @ right_nodes)

    def scaled(self) -> "Likelihood":
        """Return the likelihood with all errors times their likeliest factor.

        The solver chooses from deviations that are steps apart, and some residuals are smaller than
        any of them expects. If the expected errors were larger than the residuals, a wider lens,
        whose pixels are larger angles, would seem more likely.
        """
        count = np.maximum(self.trusted_probability.sum(axis=1), 1e-12)
        common = np.sqrt(2.0 * self.half_chi2 / count)
        common = np.clip(common, _MODEL.least_factor, _MODEL.greatest_factor)
        return replace(
            self,
            cost=self.cost + count * np.log(common) + self.half_chi2 * (common**-2.0 - 1.0),
            half_chi2=self.half_chi2 / common**2,
            weight=self.weight / common[:, np.newaxis] ** 2,
            factor=self.factor * common[:, np.newaxis, np.newaxis],
        )

    def log_scale_pull(self, residual_rad: Float64Array) -> Float64Array:
        """Return how fast the cost (M,) falls as `Rays.log_scale` rises.

        The residuals ``residual_rad`` (M, R), 0 where the terrain is unknown, are held fixed.
        """
        weighted = (self.weight * residual_rad)[..., np.newaxis]
        spread_factor = self.factor @ self.inner
        explained = (spread_factor @ (self.factor.swapaxes(1, 2) @ weighted))[..., 0]
        spread = (spread_factor * self.factor).sum(axis=-1)
        off = self.weight * ((residual_rad - explained) ** 2 + spread)
        shown = self.trusted_probability
        return np.asarray((shown - self.photo_share * (shown - off)).sum(axis=1))

    @property
    def effective_columns(self) -> Float64Array:
        """Number (M,) of independent columns that would hold as much information."""
        taken = self.inner.shape[1] - np.trace(self.inner, axis1=1, axis2=2)
        return np.asarray(self.terrain_probability.sum(axis=1) - taken)


def likelihood(
    residual_rad: Float64Array,
    trust: Float64Array,
    errors: HeightErrors,
    angle_sd_deg: Float64Array,
    height_sd_m: Float64Array,
    terrain_probability: Float64Array,
    scale: Float64Array | float = 1.0,
) -> Likelihood:
    """Return the likelihood of residuals.

    The probability that each column shows terrain is improved once.

    Parameters
    ----------
    residual_rad : (M, R) float64
        Photo minus terrain, NaN where the terrain is unknown; such a column is as likely as one
        that does not show terrain.
    trust : (R,) float64
        Trust in the photo's columns.
    errors : HeightErrors
    angle_sd_deg, height_sd_m : (M,) float64
        Standard deviations of the photo's error and of the model's heights.
    terrain_probability : (M, R) float64
        Probabilities that columns show terrain, which are improved.
    scale : (M,) float64
        The angle of a pixel, as a multiple of its angle in the photo's assumed lens: the photo's
        error is a number of pixels, and the likelihood is a density over pixels.
    """
    scale = np.broadcast_to(scale, len(residual_rad))[:, np.newaxis]
    known = np.isfinite(residual_rad)
    residual = np.where(known, residual_rad, 0.0)
    photo_variance = (scale * np.radians(angle_sd_deg)[:, np.newaxis]) ** 2
    height_sd_m = height_sd_m[:, np.newaxis]
    variance = photo_variance + (height_sd_m * errors.rough) ** 2 + errors.blur_rad**2
    factor = height_sd_m[..., np.newaxis] * errors.factor
    explained, inner, _ = _explained(
        residual, trust * terrain_probability * known / variance, factor
    )
    spread = ((factor @ inner) * factor).sum(axis=-1)
    rest = _Remainder(residual - explained, spread, variance, scale)
    mixture = _Mixture.of(residual).under_surface(rest, errors)
    mixture = mixture.past_edge(rest, errors, trust * known)
    half_squares = rest.half_squares
    log_peak = np.log(mixture.bare) - 0.5 * np.log(2.0 * np.pi * variance / scale**2)
    log_terrain = log_peak - half_squares
    odds = np.exp(np.clip(log_terrain - mixture.log_other, -GREATEST_LOG_ODDS, GREATEST_LOG_ODDS))
    terrain_probability = known * odds / (1.0 + odds)
    weight = trust * terrain_probability / variance
    explained, inner, half_log_det = _explained(residual, weight, factor)
    # The entropy of these probabilities, and the log densities that they weigh, add up to one
    # logarithm. This needs odds below their upper bound: with the solver's least deviation they are
    # at most e^10.
    each = -mixture.log_other - known * np.log1p(odds)
    each += terrain_probability * (log_terrain - log_peak)
    half_chi2 = 0.5 * (weight * residual * (residual - explained)).sum(axis=1)
    return Likelihood(
        cost=each @ trust + half_log_det + half_chi2,
        half_chi2=half_chi2,
        terrain_probability=terrain_probability,
        trusted_probability=trust * terrain_probability,
        photo_share=photo_variance / variance,
        weight=weight,
        factor=factor,
        inner=inner,
        may_rise=errors.may_rise,
    )


def _factor_at_nodes(
    azimuth_rad: Float64Array, distance_m: Float64Array, nodes: int
) -> Float64Array:
    """Return `HeightErrors.factor` (M, R, K), linear between nodes along skylines."""
    column = np.arange(distance_m.shape[1])
    node = np.unique(np.rint(np.linspace(0, column[-1], nodes)).astype(np.intp))
    # Weights (R, K) of linear interpolation.
    between = np.stack([np.interp(column, node, unit) for unit in np.eye(len(node))], axis=1)
    point_m = (distance_m * np.exp(1j * azimuth_rad))[:, node]
    to_eye = 0.5 - height_correlation(np.abs(point_m))
    apart_m = np.abs(point_m[:, :, np.newaxis] - point_m[:, np.newaxis, :])
    covariance = height_correlation(apart_m)
    covariance += to_eye[:, :, np.newaxis] + to_eye[:, np.newaxis, :]
    root = np.linalg.cholesky(covariance + 1e-6 * np.eye(len(node)))
    return np.asarray(between @ root / distance_m[..., np.newaxis])


@dataclass(frozen=True, slots=True, eq=False)
class _Remainder:
    """Residuals once height errors have explained their part, with variances."""

    off_rad: Float64Array
    """(M, R) float64. Residuals less the part that height errors explain."""
    spread: Float64Array
    """(M, R) float64. Variance of that part."""
    variance: Float64Array
    """(M, R) float64. Variance of the errors of each column by itself."""
    scale: Float64Array
    """(M, 1) float64. See `likelihood`."""

    @property
    def half_squares(self) -> Float64Array:
        """Expected squares (M, R) over twice the columns' own variances."""
        return np.asarray(0.5 * (self.off_rad**2 + self.spread) / self.variance)

    def raised(self, rise_rad: Float64Array, share: float) -> tuple[Float64Array, Float64Array]:
        """Return the probability (M, R) that something stands above the terrain.

        The second result is this probability times the density of the residual, by angle. The
        thing's height is uniform up to ``rise_rad``, blurred by the errors. The probability is
        ``share`` for a rise far above the errors, and falls as the rise shrinks.
        """
        from scipy.special import ndtr  # noqa: PLC0415  (slow to load, seldom needed)

        sd_rad = np.sqrt(self.variance + self.spread)
        rise_rad = np.clip(rise_rad, _MODEL.least_rise_sds * sd_rad, _MODEL.range_rad)
        within = ndtr(self.off_rad / sd_rad) - ndtr((self.off_rad - rise_rad) / sd_rad)
        raised = share * rise_rad / (rise_rad + 2.0 * sd_rad)
        return raised, raised * np.asarray(within / rise_rad)


@dataclass(frozen=True, slots=True, eq=False)
class _Mixture:
    """Each column shows the bare terrain's skyline, or something else."""

    bare: Float64Array | float
    """(M, R) float64. Prior probability of the bare terrain's skyline."""
    log_other: Float64Array
    """(M, R) float64. Log density of a residual together with all else that its column may show."""

    @classmethod
    def of(cls, residual: Float64Array) -> "_Mixture":
        """Return the mixture without a surface model and a data edge."""
        bare = 1.0 - _MODEL.above_share - _MODEL.below_share
        return cls(bare, _log_density_without_terrain(residual))

    def under_surface(self, rest: _Remainder, errors: HeightErrors) -> "_Mixture":
        """Return the mixture where a surface model bounds trees and houses."""
        has_surface = np.isfinite(errors.rise_rad)
        if not has_surface.any():
            return self
        uncovered = 1.0 - 2.0 * _MODEL.below_share
        covered, density = rest.raised(errors.rise_rad, uncovered)
        density = rest.scale * density + _DENSITY_BELOW
        return _Mixture(
            np.where(has_surface, uncovered - covered, self.bare),
            np.where(has_surface, np.log(density), self.log_other),
        )

    def past_edge(self, rest: _Remainder, errors: HeightErrors, trust: Float64Array) -> "_Mixture":
        """Return the mixture where terrain past the data's edge may rise, too.

        It hides what the model shows in a share of the columns where it may rise. ``trust`` (M, R)
        is 0 in unknown columns.
        """
        may_rise = errors.may_rise
        if not may_rise.any():
            return self
        hidden, density = rest.raised(errors.beyond_rad, 1.0)
        density = rest.scale * density
        peak = self.bare * rest.scale / np.sqrt(2.0 * np.pi * rest.variance)
        other = np.exp(self.log_other)
        seen = peak * np.exp(-rest.half_squares) + other
        share = _beyond_share(trust * may_rise, hidden, density, seen)
        either = other * (1.0 - share * hidden) + share * density
        return _Mixture(
            np.where(may_rise, self.bare * (1.0 - share * hidden), self.bare),
            np.where(may_rise, np.log(either), self.log_other),
        )


def _beyond_share(
    trust: Float64Array, hidden: Float64Array, density: Float64Array, seen: Float64Array
) -> Float64Array:
    """Return the share (M, 1) of columns with terrain past the edge.

    Only the columns where it may rise count; in all others ``trust`` (M, R) is 0. The share is the
    likeliest one of at most `ErrorModel.beyond_share`. If each column had that prior by itself, a
    right pose that looks across the edge at nothing higher would seem unlikely. The terrain hides
    the model's skyline in a column with the share times the probability ``hidden``. The residual
    then has the share times ``density``, and the density ``seen`` otherwise.
    """
    count = np.maximum(trust.sum(axis=1, keepdims=True), 1e-12)
    share = np.full_like(count, _MODEL.beyond_share)
    for _ in range(_MODEL.share_rounds):
        risen = share * density
        probability = risen / (risen + (1.0 - share * hidden) * seen)
        share = (trust * probability).sum(axis=1, keepdims=True) / count
        share = np.minimum(share, _MODEL.beyond_share)
    return np.asarray(share)


def cost_of_share(columns: Float64Array, temperature: float) -> Float64Array:
    """Return the price (M,) that each pose pays for a share of its own.

    A share s says in how much of a pose's open ``columns`` (M,), weighed by trust, terrain past
    the data's edge rises. Where it rises in none, each share has the likelihood (1 - s)^columns.
    With all shares up to the greatest equally likely, the mean of this likelihood to the power of
    1 / temperature is about 1 / (1 + columns s / temperature); the chosen share, 0, has 1.
    """
    return np.asarray(temperature * np.log1p(_MODEL.beyond_share * columns / temperature))


def density_without_terrain(residual_rad: Float64Array) -> Float64Array:
    """Return the density of residuals of columns without terrain.

    It includes the prior probability of such a column, and is larger above the terrain's skyline.
    """
    return np.asarray(np.where(residual_rad >= 0.0, _DENSITY_ABOVE, _DENSITY_BELOW))


def _log_density_without_terrain(residual_rad: Float64Array) -> Float64Array:
    """Return the logarithm of `density_without_terrain`."""
    above = np.log(_DENSITY_ABOVE)
    return np.asarray(np.where(residual_rad >= 0.0, above, np.log(_DENSITY_BELOW)))


def _explained(
    residual: Float64Array, weight: Float64Array, factor: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return the part of residuals (M, R) due to height errors.

    The other results are `Likelihood.inner`, and half the log determinant of its inverse.
    """
    across = factor.swapaxes(1, 2)
    core = across @ (weight[..., np.newaxis] * factor) + np.eye(factor.shape[2])
    root = np.linalg.cholesky(core)
    inner = np.asarray(np.linalg.inv(core))
    error = inner @ (across @ (weight * residual)[..., np.newaxis])
    half_log_det = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    return (factor @ error)[..., 0], inner, half_log_det
