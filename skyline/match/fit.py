r"""Fits of a pose to the stored skylines of places, without rendering.

With the distance D, tangent y and slope y' of a place's skyline at azimuth a, and the ground rising
by g, an eye moved by t (east, north) sees to first order

.. math::

    y(a; t) \approx y(a) + \frac{y' t_\perp + y t_\parallel - g \cdot t}{D}, \quad
    t_\parallel = t_e \sin a + t_n \cos a, \quad t_\perp = t_e \cos a - t_n \sin a

so heading, pitch, roll, field of view and a small move are fitted together, by damped Gauss-Newton
with Cauchy weights whose scale shrinks from round to round. The first order neglects an error that
grows with (t / D)^2, so near terrain is trusted less.
"""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, FloatArray
from skyline.camera.levelling import near_level_changes
from skyline.match.rays import REFERENCE_FOV_DEG, Rays
from skyline.pose.poses import Poses
from skyline.store.places import BINS, Places

_HEADING, _PITCH, _ROLL, _LOG_SCALE, _EAST, _NORTH, _WANDER = range(7)
"""Columns of a fitted state: heading from grid north, pitch and roll, radians; `Rays.log_scale`;
metres east and north of the stored place. From `_WANDER` on, a panorama has the factors of its
`Rays.wander_ways`; a lens has no such columns."""
_MOVE = slice(_EAST, _WANDER)
_LONGEST_STEP = np.array([*np.radians([3.0, 4.0, 3.0]), 0.04, 1.25, 1.25], dtype=np.float32)
"""Longest step of a round; moves in standard deviations of the place. The wander of a panorama's
rows steps at most as far as the pitch."""
_DAMPING = np.float32(1e-3)
"""Damping of a step: this share of the normal matrix's diagonal, and this much besides, since a
level skyline says nothing of its heading."""


@dataclass(frozen=True, slots=True)
class FitErrors:
    """Errors and priors that a fit to a stored skyline assumes."""

    photo_deg: float = 0.06
    """Error of the mean of a run of rays, at a field of view of 60 degrees."""
    second_order: float = 0.05
    """Error of the tangent over (t / D)^2, for an eye at t from its place and terrain at D."""
    pitch_sd_deg: float = 5.0
    roll_sd_deg: float = 4.0
    """Standard deviations from a level camera. Refinement takes other ones
    (`skyline.pose.pose_errors.AssumedErrors`), with which fits do worse."""
    greatest_miss: float = 8.0
    """Greater misses of a ray count as this, in expected errors: in coarse elevation models, rays
    of the right pose miss by several."""
    unknown_miss: float = 4.0
    """Miss of a ray where no skyline is stored, in expected errors."""


_ERRORS = FitErrors()


@dataclass(frozen=True, slots=True)
class FitEffort:
    """How finely and how often a pose is fitted."""

    runs: int
    """Runs of the photo's columns within 60 degrees; their means are fitted."""
    scales_deg: tuple[float, ...]
    """Scales of the Cauchy weights in each round, in addition to the expected error."""


ROUGH_FIT = FitEffort(40, (0.5, 0.35, 0.25))
"""For a first look at many starts."""
GOOD_FIT = FitEffort(100, (0.5, 0.35, 0.25, 0.2, 0.2))
"""For the starts that the rough fits leave."""


@dataclass(frozen=True, slots=True, eq=False)
class _Misses:
    """How far the R rays of M states miss skylines."""

    tangent: Float32Array
    """(M, R) float32. Tangents of rays minus tangents of the skyline; 0 where it is unknown."""
    change: Float32Array
    """(M, P, R) float32. Derivatives of the misses by the columns of a state."""
    nearness: Float32Array
    """(M, R) float32. Inverse distance of the skyline, 1 / m."""
    known: BoolArray
    """(M, R) bool. Whether a skyline is stored there."""


class CurveFit:
    """Fits one pose of a photo to each of M places.

    Eyes lie evenly within a place's tolerance, so their standard deviation from the place is the
    tolerance over the root of 3; no fit moves farther than twice that.

    Parameters
    ----------
    places : Places
    ground_slope : (M, 2) float32
        Rise of the ground to the east and to the north.
    rays : Rays
        R means of runs of the photo's rays; see `skyline.match.rays.in_runs`.
    effort : FitEffort
    """

    def __init__(
        self, places: Places, ground_slope: Float32Array, rays: Rays, effort: FitEffort
    ) -> None:
        self._places = places
        self._ground_slope = ground_slope
        self._rays = rays
        self._effort = effort
        self._y = _closed(places.elevation_tan())
        nearness = 1.0 / places.distance_m()
        self._nearness = _closed(np.where(np.isfinite(nearness), nearness, np.float32(0.0)))
        self._deviation_m = (places.tolerance_m / np.float32(np.sqrt(3.0)))[:, np.newaxis]
        self._wander_ways = rays.wander_ways.astype(np.float32)
        self._prior = self._inverse_variances()

    def fit(self, grid_heading_rad: Float64Array, log_scale: Float64Array) -> Poses:
        """Return the poses fitted from grid headings and logarithms of scales (M,).

        A cost is the mean of the rays' misses, in expected errors, plus what the priors add.
        """
        state = np.zeros(self._prior.shape, dtype=np.float32)
        state[:, _HEADING] = grid_heading_rad
        state[:, _LOG_SCALE] = log_scale
        state[:, _PITCH] = -np.median(self._misses(state).tangent, axis=1)
        for scale_deg in self._effort.scales_deg:
            misses = self._misses(state)
            weight = self._weight(state, misses, scale_deg)
            state = self._bounded(state, self._step(state, misses, weight))
        cost = self._cost(state, self._misses(state))
        return self._poses(state.astype(np.float64), cost.astype(np.float64))

    def _poses(self, state: Float64Array, cost: Float64Array) -> Poses:
        """Return states as poses."""
        move = state[:, _MOVE]
        return Poses(
            easting_m=self._places.easting_m + move[:, 0],
            northing_m=self._places.northing_m + move[:, 1],
            eye_elevation_m=self._places.eye_elevation_m + (self._ground_slope * move).sum(axis=1),
            grid_heading_deg=np.degrees(state[:, _HEADING]) % 360.0,
            pitch_deg=np.degrees(state[:, _PITCH]),
            roll_deg=np.degrees(state[:, _ROLL]),
            fov_deg=self._rays.searched_fov_deg(state[:, _LOG_SCALE]),
            cost=cost,
        )

    def _misses(self, state: Float32Array) -> _Misses:
        """Return how far the rays of states miss the places' skylines."""
        lift: Float32Array | np.float32 = np.float32(0.0)
        if self._rays.is_panorama:
            lift = state[:, _WANDER:] @ self._wander_ways.T
        pitch, roll, log_scale = (state[:, k, np.newaxis] for k in (_PITCH, _ROLL, _LOG_SCALE))
        azimuth, tangent = self._rays.levelled(pitch, roll, log_scale, lift)
        toward = azimuth + state[:, :1]
        profile, slope, nearness = self._skyline_at(toward)
        known = np.isfinite(slope)
        slope = np.where(known, slope, np.float32(0.0))
        sine, cosine = np.sin(toward), np.cos(toward)
        ground = self._ground_slope[:, :, np.newaxis]
        east = (slope * cosine + profile * sine - ground[:, 0]) * nearness
        north = (profile * cosine - slope * sine - ground[:, 1]) * nearness
        miss = tangent - profile - east * state[:, _EAST, np.newaxis]
        miss -= north * state[:, _NORTH, np.newaxis]
        turned = near_level_changes(azimuth, tangent, slope, self._rays.projection)
        change = np.stack([-slope, *turned, -east, -north], axis=1)
        if self._rays.is_panorama:
            by_wander = np.tile(self._wander_ways.T, (len(state), 1, 1))
            change = np.concatenate([change, by_wander], axis=1)
        return _Misses(np.where(known, miss, np.float32(0.0)), change, nearness, known)

    def _skyline_at(self, azimuth: Float32Array) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Return the places' skylines at azimuths (M, R).

        The skylines are tangents, slopes and inverse distances. Tangents are linear between bins,
        and slopes NaN where no skyline is stored.
        """
        count, bins = len(self._y), BINS
        position = azimuth * np.float32(bins / (2.0 * np.pi)) - np.float32(0.5)
        # Remainders of integers would take as long as all that follows.
        position -= np.float32(bins) * np.floor(position / np.float32(bins))
        # The azimuths of a fit that failed are not numbers; they index, too.
        position = np.fmin(position, np.float32(bins))
        left = np.minimum(np.floor(position), np.float32(bins - 1))
        share = position - left
        begin = left.astype(np.intp) + (np.arange(count) * (bins + 1))[:, np.newaxis]
        profile = self._y.ravel()[begin]
        rise = self._y.ravel()[begin + 1] - profile
        slope = rise * np.float32(bins / (2.0 * np.pi))
        known = np.isfinite(rise)
        rise = np.where(known, rise, np.float32(0.0))
        profile = np.where(known, profile, np.float32(0.0)) + share * rise
        runs = self._nearness.shape[1]
        run = ((position + np.float32(0.5)) * np.float32((runs - 1) / bins)).astype(np.intp)
        nearness = self._nearness.ravel()[run + (np.arange(count) * runs)[:, np.newaxis]]
        return profile, slope, nearness

    def _weight(self, state: Float32Array, misses: _Misses, scale_deg: float) -> Float32Array:
        """Return the weights (M, R) of rays in a round."""
        bent = _ERRORS.second_order * np.square(self._deviation_m * misses.nearness)
        variance = np.square(self._photo_error(state))[:, np.newaxis] + np.square(bent)
        weight = self._rays.weight.astype(np.float32) * misses.known
        variance = variance.astype(np.float32)
        weight = weight / (variance + np.square(misses.tangent) + np.radians(scale_deg) ** 2)
        return np.asarray(weight, dtype=np.float32)

    def _photo_error(self, state: Float32Array) -> FloatArray:
        """Return the expected error (M,) of a photo's tangents.

        The error is a number of pixels, since a camera measures in pixels, so it grows with the
        field of view. If it did not, a small enough field of view would make every miss small.
        """
        projection = self._rays.projection
        usual = float(projection.half_width(REFERENCE_FOV_DEG))
        size = 1.0 if projection.spreads_angles else self._rays.half_width / usual
        scale = np.asarray(np.exp(state[:, _LOG_SCALE]) * size, dtype=np.float32)
        return np.asarray(np.radians(_ERRORS.photo_deg) * scale)

    def _inverse_variances(self) -> Float32Array:
        """Return the prior inverse variances (M, P) of states.

        The lens's is 0 here, since it depends on the state.
        """
        columns = _WANDER + self._wander_ways.shape[1]
        prior = np.zeros((len(self._places), columns), dtype=np.float32)
        prior[:, _PITCH] = np.radians(_ERRORS.pitch_sd_deg) ** -2.0
        prior[:, _ROLL] = np.radians(_ERRORS.roll_sd_deg) ** -2.0
        prior[:, _MOVE] = self._deviation_m**-2.0
        if self._rays.is_panorama:
            prior[:, _WANDER:] = self._rays.warp_sd**-2.0
        return prior

    def _step(self, state: Float32Array, misses: _Misses, weight: Float32Array) -> Float32Array:
        """Return the damped Gauss-Newton step (M, P) that is subtracted from states."""
        weighted = misses.change * weight[:, np.newaxis]
        normal = weighted @ misses.change.transpose(0, 2, 1)
        prior = self._prior.copy()
        prior[:, _LOG_SCALE] = self._rays.lens.precision(state[:, _LOG_SCALE])
        gradient = (weighted @ misses.tangent[:, :, np.newaxis])[:, :, 0] + prior * state
        diagonal = np.einsum("mkk->mk", normal)
        diagonal += prior
        diagonal += _DAMPING * (diagonal + 1.0)
        return np.asarray(np.linalg.solve(normal, gradient[:, :, np.newaxis])[:, :, 0])

    def _bounded(self, state: Float32Array, step: Float32Array) -> Float32Array:
        """Return states less a bounded step, within the bounds of states."""
        limit = np.tile(_LONGEST_STEP, (len(state), 1))
        limit[:, _MOVE] *= self._deviation_m
        wander = np.repeat(limit[:, _PITCH, np.newaxis], self._wander_ways.shape[1], axis=1)
        limit = np.concatenate([limit, wander], axis=1)
        state = state - np.clip(step, -limit, limit)
        state[:, _LOG_SCALE] = np.clip(state[:, _LOG_SCALE], *self._rays.log_scale_bounds)
        farthest = 2.0 * self._deviation_m
        state[:, _MOVE] = np.clip(state[:, _MOVE], -farthest, farthest)
        return state

    def _cost(self, state: Float32Array, misses: _Misses) -> Float32Array:
        """Return the costs (M,) of states; see `fit`."""
        error = self._photo_error(state)
        off = np.minimum(
            np.abs(misses.tangent) / error[:, np.newaxis], np.float32(_ERRORS.greatest_miss)
        )
        off = np.where(misses.known, off, np.float32(_ERRORS.unknown_miss))
        unlikely = 0.5 * (np.square(state) * self._prior).sum(axis=1)
        unlikely = (unlikely + self._rays.lens.cost(state[:, _LOG_SCALE])) / self._effort.runs
        mean = (off * self._rays.weight.astype(np.float32)).mean(axis=1)
        return np.asarray(mean + unlikely, dtype=np.float32)


def _closed(curve: FloatArray) -> FloatArray:
    """Return curves (M, B) with their first values repeated at the end."""
    return np.concatenate([curve, curve[:, :1]], axis=1)
