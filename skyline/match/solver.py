"""Damped Gauss-Newton on a photo's residuals, for all of its pose.

The derivatives are those of `skyline.match.curves`. The assumed errors start large and shrink as
the fit improves: far terrain, which moves least, is fitted first, and near terrain follows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import Float64Array, IntArray, Rows
from skyline.camera.warps import MOST_DISTORTION
from skyline.match.curves import EYE_HEIGHT, MOVE, Curves, Linearization
from skyline.match.eye_prior import EyeHeightPrior
from skyline.match.likelihood import (
    HeightErrors,
    Likelihood,
    cost_of_share,
    density_without_terrain,
    likelihood,
)
from skyline.match.place_density import PlacePrior
from skyline.match.rays import Rays, thinned
from skyline.pose.pose_errors import ASSUMED, EAST, HEADING, LOG_SCALE, NORTH, PITCH, ROLL, WARP
from skyline.pose.poses import Poses
from skyline.terrain.data_edge import DataEdge

_ANGLE_SDS_DEG = np.array([0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.5, 0.8])
"""Standard deviations of the photo's error from which the likeliest is chosen."""
_HEIGHT_SHARES = np.array([1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0])
"""Standard deviations of the terrain model's heights, as multiples of the expected one, from which
the likeliest is chosen."""
TEMPERATURE = 8.0
"""Differences of costs, divided by this, are log odds. Neighbouring columns share errors that are
not modelled."""
_WIDEST_ANGLE = len(_ANGLE_SDS_DEG) - 1
_WIDEST_HEIGHT = len(_HEIGHT_SHARES) - 1
_NEIGHBOURS = ((-1, 0), (0, -1), (1, 0), (0, 1))
"""Steps of the indices into `_ANGLE_SDS_DEG` and `_HEIGHT_SHARES` that are tried."""
_SHIFTS_RAD = np.radians(np.arange(-4.0, 4.01, 0.25))
"""Shifts of the whole curve that are tried."""
_AGREEMENT_SD_RAD = np.radians(0.3)
"""Standard deviation of columns about a shift on which they agree."""
_LEAST_SD_M = 1e-6
"""Replaces a standard deviation of 0 m, by which nothing can be divided."""
_HELD = 1e14
"""Precision that holds an unknown: at a bound, or a distortion at 0."""


@dataclass(frozen=True, slots=True)
class SolverPriors:
    """Priors of cameras and terrain, and the damping of a step."""

    pitch_sd_rad: float = np.radians(ASSUMED.level_pitch_sd_deg)
    """Standard deviation from a level camera."""
    roll_sd_rad: float = np.radians(ASSUMED.level_roll_sd_deg)
    """Standard deviation from a level camera."""
    position_sd_m: float = 300.0
    """Standard deviation of a place: it bounds the covariance for a skyline without information."""
    log_height_sd: float = 0.7
    """Standard deviation of the logarithm of `_HEIGHT_SHARES`."""
    terrain_weight: float = 4.0
    """Factor on the log priors of the eye's height and of the height errors. Neighbouring columns
    share errors that the likelihood takes for independent, so costs are too large, and priors
    without a factor would hardly count."""
    lens_weight: float = TEMPERATURE
    """Factor on the log prior of the lens. Costs are too large by about `TEMPERATURE`, and the
    lens is known as well as its file says."""
    blur_steps: float = 0.3
    """Standard deviation of the skyline's azimuth, in steps of the panorama."""
    least_columns: int = 16
    """A fit needs this many columns with a known skyline on both sides."""
    least_rough_distortion: float = 0.03
    """Rough rounds fit no distortion if less than this is expected: it moves rays by less than the
    largest errors that these rounds assume, and it would bend the skylines of wrong slopes to
    fit."""
    damping_rad: float = 0.05
    """Standard deviation with which a step of the attitude, and of the field of view's logarithm,
    is damped."""
    upward_share: float = 0.25
    """Standard deviation with which a step of the eye's height is damped, as a share of the one for
    its place."""


_PRIORS = SolverPriors()


@dataclass(frozen=True, slots=True)
class SolverMode:
    """How a fit models errors, and how far it goes."""

    steps: int
    """Gauss-Newton steps from one rendering."""
    choices: int
    """How often the errors' standard deviations are chosen again: before each of so many steps, and
    after the last step if this is one more than `steps`."""
    nodes: int
    """Height errors along a skyline; see `HeightErrors.of`."""
    bins: int = 1440
    """Steps of azimuth of rays and curves; by default about as fine as renderings."""


SCOUT = SolverMode(steps=3, choices=4, nodes=0, bins=480)
"""For a first look at many poses."""
ROUGH = SolverMode(steps=3, choices=4, nodes=0)
"""For the search: quick, and converges from farther away."""
FOLLOW = SolverMode(steps=3, choices=2, nodes=0)
"""For poses that move on after a rough fit. The chosen deviations change little from one rendering
to the next, and choosing them is most of a fit's work."""
FINE = SolverMode(steps=2, choices=1, nodes=32)
"""For the last rounds: near and far terrain have the right weights, and costs and covariances have
their statistical meaning."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit(Rows):
    """M states of the camera, and how well they fit a photo."""

    state: Float64Array
    """(M, P) float64. See `EAST` to `WARP`; displacements are from the eye of the curve."""
    angle_index: IntArray
    """(M,) intp. Index into `_ANGLE_SDS_DEG`: the chosen deviation of the photo's error."""
    height_index: IntArray
    """(M,) intp. Index into `_HEIGHT_SHARES`: the chosen deviation of the heights."""
    cost: Float64Array
    """(M,) float64. Negative log of the likelihood and the priors, integrated over the attitude;
    infinite for a state that does not fit."""
    terrain_probability: Float64Array
    """(M, R) float64. Probability that a ray shows terrain."""


class Solver:
    """Fits the pose of one photo to curves.

    The rays are averaged within the mode's steps of azimuth. ``height_sd_m`` is the expected
    standard deviation of the terrain model's heights. Without ``edge`` no terrain is taken to lie
    past the data.
    """

    def __init__(
        self,
        rays: Rays,
        mode: SolverMode,
        eye: EyeHeightPrior,
        height_sd_m: float,
        place_priors: Sequence[PlacePrior] = (),
        edge: DataEdge | None = None,
    ) -> None:
        self.rays = thinned(rays, mode.bins)
        self.mode = mode
        self._eye = eye
        self._place_priors = place_priors
        self._edge = edge
        self.height_sds_m = _HEIGHT_SHARES * height_sd_m
        """Standard deviations of the terrain model's heights that are tried."""
        self.size = WARP + len(rays.warp_sd)
        """Unknowns P of a state."""
        self._low, self._high = self._bounds()
        self._precision = self._prior_precision()
        self._information = self._precision + self._widest_sd() ** -2.0
        off = np.log(_HEIGHT_SHARES) / _PRIORS.log_height_sd
        self._height_cost = _PRIORS.terrain_weight * 0.5 * off**2

    def _bounds(self) -> tuple[Float64Array, Float64Array]:
        """Return the least and the greatest values (P,) of a state."""
        low = np.full(self.size, -np.inf)
        high = np.full(self.size, np.inf)
        low[LOG_SCALE], high[LOG_SCALE] = self.rays.log_scale_bounds
        low[EYE_HEIGHT], high[EYE_HEIGHT] = self._eye.range_m
        if not self.rays.is_panorama:
            low[WARP:] = -MOST_DISTORTION
            high[WARP:] = MOST_DISTORTION
        return low, high

    def _prior_precision(self) -> Float64Array:
        """Return the precision (P,) of the normal priors about 0.

        The lens and the eye's height have other priors, so theirs is 0 here.
        """
        precision = np.zeros(self.size)
        precision[PITCH] = _PRIORS.pitch_sd_rad**-2
        precision[ROLL] = _PRIORS.roll_sd_rad**-2
        precision[WARP:] = self.rays.warp_sd**-2.0
        is_straight = self.rays.distortion_sd < _PRIORS.least_rough_distortion
        if is_straight and not (self.mode.nodes or self.rays.is_panorama):
            precision[WARP:] = _HELD
        return precision

    def _widest_sd(self) -> Float64Array:
        """Return the deviations (P,) of unknowns before the skyline says anything."""
        sd = np.full(self.size, np.inf)
        sd[[EAST, NORTH]] = _PRIORS.position_sd_m
        sd[EYE_HEIGHT] = max(self._eye.scale_m, _LEAST_SD_M)
        sd[HEADING] = np.pi
        # The uniform distribution over the range of fields of view has this deviation; a field of
        # view that is known exactly has no range.
        sd[LOG_SCALE] = max((self._high[LOG_SCALE] - self._low[LOG_SCALE]) / np.sqrt(12.0), 1e-6)
        return sd

    def start(self, poses: Poses) -> Fit:
        """Return poses as states without a cost, with the largest errors."""
        count = len(poses)
        state = np.zeros((count, self.size))
        state[:, EYE_HEIGHT] = self._eye.usual_m
        state[:, HEADING] = np.radians(poses.grid_heading_deg)
        state[:, PITCH] = np.radians(poses.pitch_deg)
        state[:, ROLL] = np.radians(poses.roll_deg)
        log_scale = self.rays.log_scale(poses.fov_deg)
        state[:, LOG_SCALE] = np.clip(log_scale, self._low[LOG_SCALE], self._high[LOG_SCALE])
        if not self.rays.is_panorama and poses.distortion is not None:
            state[:, WARP:] = poses.distortion[:, np.newaxis]
        angle_index = np.full(count, _WIDEST_ANGLE)
        height_index = np.full(count, _WIDEST_HEIGHT)
        terrain_probability = np.ones((count, len(self.rays.u)))
        return Fit(state, angle_index, height_index, np.full(count, np.inf), terrain_probability)

    def at_height(self, fit: Fit, height_m: Float64Array) -> Fit:
        """Return fits with eyes at heights (M,) above the ground.

        The heights are clipped to those that are tried.
        """
        state = fit.state.copy()
        low, high = self._low[EYE_HEIGHT], self._high[EYE_HEIGHT]
        state[:, EYE_HEIGHT] = np.clip(height_m, low, high)
        return replace(fit, state=state)

    def poses(self, curves: Curves, fit: Fit) -> Poses:
        """Return fits as poses of the eyes (M,) of curves."""
        distortion = wander = None
        if self.rays.is_panorama:
            # The rows of an image wander with its scale.
            wander = fit.state[:, WARP:] * np.exp(fit.state[:, LOG_SCALE, np.newaxis])
        else:
            distortion = fit.state[:, WARP:].sum(axis=1)
        return Poses(
            easting_m=curves.position_m.real,
            northing_m=curves.position_m.imag,
            eye_elevation_m=curves.ground_m + fit.state[:, EYE_HEIGHT],
            grid_heading_deg=np.degrees(fit.state[:, HEADING]) % 360.0,
            pitch_deg=np.degrees(fit.state[:, PITCH]),
            roll_deg=np.degrees(fit.state[:, ROLL]),
            fov_deg=self.rays.fov_at(fit.state[:, LOG_SCALE]),
            cost=fit.cost,
            distortion=distortion,
            wander=wander,
        )

    def improve(self, curves: Curves, fit: Fit, step_m: Float64Array) -> Fit:
        """Return fits after the mode's steps from one rendering.

        The standard deviations of their errors are chosen again. ``step_m`` (M,) is the standard
        deviation with which the eye's displacement is damped; with 0 the eye stays.
        """
        errors = None
        for step in range(self.mode.steps + 1):
            linear = curves.linearized(self.rays, fit.state)
            # The errors at the first state serve all steps.
            errors = self._errors(linear, curves) if errors is None else errors
            neighbours = _NEIGHBOURS if step < self.mode.choices else ()
            fit, found = self._with_deviations(fit, linear, errors, neighbours)
            if step < self.mode.steps:
                fit = self._stepped(fit, linear, found, step_m)
        return fit

    def settle(self, curves: Curves, fit: Fit) -> Fit:
        """Return fits whose attitude is solved from a distant start.

        The eye stays where it is. With large assumed errors, trees are taken for terrain, and the
        errors stay large. A second start therefore begins at the pitch on which most columns agree,
        and the better of the two counts.
        """
        none = np.zeros(len(fit.cost))
        wide = self.improve(curves, fit, none)
        agreed = self.improve(curves, self._agreed(curves, wide), none)
        return wide.replaced(agreed.cost < wide.cost, agreed)

    def _agreed(self, curves: Curves, fit: Fit) -> Fit:
        """Return the fit with the pitch on which most columns agree."""
        linear = curves.linearized(self.rays, fit.state)
        off = linear.residual_rad[..., np.newaxis] - _SHIFTS_RAD
        density = np.exp(-0.5 * (off / _AGREEMENT_SD_RAD) ** 2) / _AGREEMENT_SD_RAD
        log_density = np.log(density + density_without_terrain(off))
        agreement = np.tensordot(np.nan_to_num(log_density), self.rays.weight, axes=(1, 0))
        state = fit.state.copy()
        state[:, PITCH] -= _SHIFTS_RAD[np.argmax(agreement, axis=1)]
        angle_index = int(np.searchsorted(np.radians(_ANGLE_SDS_DEG), _AGREEMENT_SD_RAD))
        return replace(
            fit,
            state=state,
            angle_index=np.full_like(fit.angle_index, min(angle_index, _WIDEST_ANGLE)),
            height_index=np.full_like(fit.height_index, len(_HEIGHT_SHARES) // 2),
            terrain_probability=np.ones_like(fit.terrain_probability),
        )

    def evaluate(self, curves: Curves, fit: Fit) -> tuple[Linearization, Likelihood]:
        """Return the residuals and their likelihood at a fit."""
        linear = curves.linearized(self.rays, fit.state)
        errors = self._errors(linear, curves)
        return linear, self._likelihood(fit, linear, errors)

    def covariance(self, fit: Fit, linear: Linearization, found: Likelihood) -> Float64Array:
        """Return the covariance (M, P, P) of states, including the priors."""
        normal = found.product(linear.jacobian, linear.jacobian)
        normal += self._information_at(fit.state)
        self._pull_to_likely_places(linear, normal, np.zeros(normal.shape[:2]))
        return np.asarray(np.linalg.inv(normal))

    def _information_at(self, state: Float64Array) -> Float64Array:
        """Return the information (M, P, P) of the priors at states."""
        each = np.tile(self._information, (len(state), 1))
        each[:, LOG_SCALE] += self._lens_precision(state)
        return np.asarray(each[:, np.newaxis] * np.eye(self.size))

    def _lens_precision(self, state: Float64Array) -> Float64Array:
        """Return the precision (M,) with which the lens's prior pulls states."""
        return _PRIORS.lens_weight * self.rays.lens.precision(state[:, LOG_SCALE])

    def _beyond_rad(self, linear: Linearization) -> Float64Array:
        """Return how far terrain past the data's edge may rise.

        The angle (M, R) is measured from the skyline. It is below 0 where no such terrain reaches
        the skyline, and 0 where the skyline or the edge is unknown.
        """
        if self._edge is None:
            return np.zeros_like(linear.residual_rad)
        position_m, eye_m = linear.position_m[:, np.newaxis], linear.eye_m[:, np.newaxis]
        most = self._edge.elevation_tan(position_m.real, position_m.imag, eye_m, linear.azimuth_rad)
        return np.asarray(np.nan_to_num(np.arctan(most) - np.arctan(linear.elevation_tan)))

    def _errors(self, linear: Linearization, curves: Curves) -> HeightErrors:
        step_rad = 2.0 * np.pi / curves.channels.shape[1]
        blur_rad = _PRIORS.blur_steps * step_rad * np.abs(linear.jacobian[:, HEADING])
        return HeightErrors.of(
            linear.azimuth_rad,
            linear.distance_m,
            blur_rad,
            self.mode.nodes,
            linear.rise_rad,
            self._beyond_rad(linear),
        )

    def _likelihood(self, fit: Fit, linear: Linearization, errors: HeightErrors) -> Likelihood:
        """Return the likelihood of states for their chosen errors.

        Its cost includes the priors.
        """
        found = likelihood(
            linear.residual_rad,
            self.rays.weight,
            errors,
            _ANGLE_SDS_DEG[fit.angle_index],
            self.height_sds_m[fit.height_index],
            fit.terrain_probability,
            np.exp(fit.state[:, LOG_SCALE]),
        ).scaled()
        # Laplace's approximation to the integral over the attitude. Without it errors that are too
        # small win, as much of the error hides in pitch, roll and the field of view.
        attitude = slice(HEADING, None)
        change = linear.jacobian[:, attitude]
        normal = found.product(change, change)
        information = self._information_at(fit.state)[:, attitude, attitude]
        _, log_det = np.linalg.slogdet(normal + information)
        may_rise = found.may_rise & np.isfinite(linear.residual_rad)
        prior_cost = self._prior_cost(fit.state, linear, may_rise @ self.rays.weight)
        cost = found.cost + 0.5 * log_det + prior_cost + self._height_cost[fit.height_index]
        return replace(found, cost=cost)

    def _prior_cost(
        self, state: Float64Array, linear: Linearization, open_columns: Float64Array
    ) -> Float64Array:
        """Return what the priors add to the cost (M,) of states.

        The priors of the height errors are not among them. For ``open_columns`` (M,) see
        `cost_of_share`.
        """
        cost = 0.5 * state**2 @ self._precision
        cost += _PRIORS.lens_weight * self.rays.lens.cost(state[:, LOG_SCALE])
        cost += _PRIORS.terrain_weight * self._eye.cost(state[:, EYE_HEIGHT])
        cost += cost_of_share(open_columns, TEMPERATURE)
        for prior in self._place_priors:
            cost += TEMPERATURE * prior.cost(linear.position_m, linear.eye_m, state[:, HEADING])
        return np.asarray(cost)

    def _with_deviations(
        self,
        fit: Fit,
        linear: Linearization,
        errors: HeightErrors,
        neighbours: Sequence[tuple[int, int]],
    ) -> tuple[Fit, Likelihood]:
        """Return the fit with the likeliest errors: its own or neighbouring ones."""
        angle_index = fit.angle_index
        height_index = fit.height_index
        best = self._likelihood(fit, linear, errors)
        fit = replace(fit, terrain_probability=best.terrain_probability)
        for by_angle, by_height in neighbours:
            other = replace(
                fit,
                angle_index=np.clip(fit.angle_index + by_angle, 0, _WIDEST_ANGLE),
                height_index=np.clip(fit.height_index + by_height, 0, _WIDEST_HEIGHT),
            )
            found = self._likelihood(other, linear, errors)
            better = found.cost < best.cost
            best = best.replaced(better, found)
            angle_index = np.where(better, other.angle_index, angle_index)
            height_index = np.where(better, other.height_index, height_index)
        known = np.isfinite(linear.residual_rad).sum(axis=1) >= _PRIORS.least_columns
        cost = np.where(known, best.cost, np.inf)
        return Fit(fit.state, angle_index, height_index, cost, best.terrain_probability), best

    def _stepped(
        self, fit: Fit, linear: Linearization, found: Likelihood, step_m: Float64Array
    ) -> Fit:
        """Return the fit after one step within the bounds of the state."""
        normal, gradient = self._normal_equations(fit.state, linear, found, step_m)
        state = _solved(fit.state, normal, gradient)
        bounded = np.clip(state, self._low, self._high)
        outside = bounded != state
        if outside.any():
            # An unknown that meets a bound is held there, and the others are solved again.
            hold = np.where(outside, _HELD, 0.0)
            normal += hold[:, np.newaxis] * np.eye(self.size)
            gradient += np.where(outside, _HELD * (fit.state - bounded), 0.0)
            bounded = np.clip(_solved(fit.state, normal, gradient), self._low, self._high)
        return replace(fit, state=bounded)

    def _normal_equations(
        self,
        state: Float64Array,
        linear: Linearization,
        found: Likelihood,
        step_m: Float64Array,
    ) -> tuple[Float64Array, Float64Array]:
        """Return matrices (M, P, P) and gradients (M, P) of damped steps."""
        miss = np.nan_to_num(linear.residual_rad)[:, np.newaxis]
        # The prior pulls the eye to the curve's eye, and the other unknowns to usual values.
        step_m = np.maximum(step_m, _LEAST_SD_M)
        precision = np.tile(self._precision, (len(step_m), 1))
        precision[:, LOG_SCALE] = self._lens_precision(state)
        precision[:, [EAST, NORTH]] = step_m[:, np.newaxis] ** -2
        eye_precision = self._eye.precision(state[:, EYE_HEIGHT])
        precision[:, EYE_HEIGHT] = _PRIORS.terrain_weight * eye_precision
        off = state.copy()
        off[:, EYE_HEIGHT] -= self._eye.usual_m
        # Damping shortens a step, whichever way it leads.
        damping = np.zeros_like(precision)
        damping[:, EYE_HEIGHT] = (_PRIORS.upward_share * step_m) ** -2
        damping[:, HEADING:] = _PRIORS.damping_rad**-2
        normal = found.product(linear.jacobian, linear.jacobian)
        normal += (precision + damping)[:, np.newaxis] * np.eye(self.size)
        gradient = found.product(linear.jacobian, miss)[..., 0] + precision * off
        gradient[:, LOG_SCALE] -= found.log_scale_pull(miss[:, 0])
        self._pull_to_likely_places(linear, normal, gradient)
        return normal, gradient

    def _pull_to_likely_places(
        self, linear: Linearization, normal: Float64Array, gradient: Float64Array
    ) -> None:
        """Add the pulls to likely places to normal equations, in place."""
        for prior in self._place_priors:
            precision, offset_m = prior.pull(linear.position_m, linear.eye_m)
            precision *= TEMPERATURE
            gradient[:, MOVE] += precision * offset_m
            for axis in (EAST, NORTH, EYE_HEIGHT):
                normal[:, axis, axis] += precision[:, axis]


def _solved(state: Float64Array, normal: Float64Array, gradient: Float64Array) -> Float64Array:
    """Return states (M, P) after the Gauss-Newton step of normal equations."""
    return np.asarray(state - np.linalg.solve(normal, gradient[..., np.newaxis])[..., 0])
