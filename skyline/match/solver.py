r"""Damped Gauss-Newton on a query's residuals: position, attitude and field of view together.

An eye that moves by (e, n, up) sees a skyline point at azimuth a, elevation tangent y and
horizontal distance d move by

.. math::

    \mathrm{d}a = (n \sin a - e \cos a) / d, \qquad
    \mathrm{d}y = (y\,(e \sin a + n \cos a) - up) / d

and it moves on the ground, whose slope ties up to e and n, at a height above it; so one rendering
with its depth gives the derivatives by all unknowns. The noise starts wide and is narrowed as
the fit improves: far terrain, which moves least, leads, and near terrain follows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array, IntArray, Rows
from skyline.errors import InputError
from skyline.match.claim import Claim, EyeHeight
from skyline.match.hypotheses import Hypotheses
from skyline.match.noise import HeightErrors, Judged, Noise, judge
from skyline.match.profiles import Panoramas
from skyline.match.query_rays import QueryRays, level_with_changes
from skyline.terrain.edge import DataEdge

EAST, NORTH, EYE_HEIGHT, HEADING, PITCH, ROLL, LOG_SCALE, DISTORTION = range(8)
"""Columns of a state: the eye's displacement, metres; its height above the ground, metres; angles,
radians; `QueryRays.log_scale` of the field of view; and, only where a query's lens may have one,
its distortion."""

_NEIGHBOURS = ((-1, 0), (0, -1), (1, 0), (0, 1))
_MOVES = slice(EAST, HEADING)
"""The columns of a state that move the eye."""
_DAMPING_RAD = 0.05
"""Deviation that damps a step of the attitude, and of the field of view's logarithm."""
_UPWARD = 0.25
"""Steps of the eye's height against those of its place."""
_NO_STEP_M = 1e-6
_LOG_HEIGHT_SD = 0.7
"""Of the logarithm of the heights' deviation about that of the one to be expected."""
_MOST_DISTORTION = 0.3
"""A lens that moves the side of its image by more is no lens with a wide field, but a fisheye."""
_HELD = 1e14
"""Precision that holds a parameter."""
_AGREEMENT_RAD = np.radians(np.arange(-4.0, 4.01, 0.25))
_AGREEMENT_RAD_SD = np.radians(0.3)
"""Shifts of the whole curve that are tried, and within what columns agree on one."""


@dataclass(frozen=True, slots=True)
class SolverConfig:
    """How a curve is aligned.

    Costs are as if neighbouring columns told more than they do, so what is known of the terrain
    model counts `terrain_weight` times as much as it would.
    """

    iterations: int = 3
    """Gauss-Newton steps from one rendering."""
    choices: int = 4
    """In how many of them, from the first, the noise is chosen anew."""
    pitch_sd_deg: float = 6.0
    roll_sd_deg: float = 3.0
    """``pitch_sd_deg``, ``roll_sd_deg``: prior deviations about a level camera."""
    position_sd_m: float = 300.0
    """Prior deviation of a place, which only bounds what an uninformative skyline can say."""
    terrain_weight: float = 4.0
    """Of the probabilities of the eye's height and of the terrain model's error."""
    min_columns: int = 16
    """Least columns with a known skyline on both sides for there to be a fit."""
    blur_steps: float = 0.3
    """Deviation of the skyline's azimuth, in steps of the panorama."""
    noise: Noise = field(default_factory=Noise)

    def __post_init__(self) -> None:
        if self.iterations < 1 or self.min_columns < 1:
            raise InputError(
                f"iterations are {self.iterations} and least columns {self.min_columns}; "
                "expected at least 1 of both"
            )
        if min(self.pitch_sd_deg, self.roll_sd_deg, self.position_sd_m) <= 0.0:
            raise InputError(
                f"prior deviations are {self.pitch_sd_deg}, {self.roll_sd_deg} degrees and "
                f"{self.position_sd_m} m; expected all above 0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Curves(Rows):
    """What M eyes see, and how it changes as they move."""

    channels: Float64Array
    """(M, B, 6 or 7) float64. Elevation tangent, its slope by azimuth, its change by a metre east,
    by a metre north and by a metre up, distance, and, where a surface says so, how far above the
    tangent things may rise, at azimuth 360 b / B degrees; NaN where unknown."""
    place_m: NDArray[np.complex128]
    """(M,) complex128. Where they stand: easting, and northing as the imaginary part."""
    ground_m: Float64Array
    """(M,) float64. The ground's height there."""
    eye_height_m: Float64Array
    """(M,) float64. Above the ground."""

    @classmethod
    def of(
        cls,
        panoramas: Panoramas,
        place_m: NDArray[np.complex128],
        ground_m: Float64Array,
        ground_slope: Float64Array,
        eye_height_m: Float64Array,
        surface: Panoramas | None = None,
    ) -> "Curves":
        """Prepare panoramas of eyes above ground of slopes (M, 2): rise a metre east, north.

        ``surface`` is what the same eyes see of what may stand on the ground.
        """
        y, distance = panoramas.y, panoramas.distance_m
        step = 2.0 * np.pi / panoramas.bins
        slope = (np.roll(y, -1, axis=1) - np.roll(y, 1, axis=1)) / (2.0 * step)
        sine, cosine = np.sin(step * np.arange(y.shape[1])), np.cos(step * np.arange(y.shape[1]))
        east = (y * sine + slope * cosine - ground_slope[:, :1]) / distance
        north = (y * cosine - slope * sine - ground_slope[:, 1:]) / distance
        channels = [y, slope, east, north, -1.0 / distance, distance]
        if surface is not None:
            channels.append(np.maximum(surface.y - y, 0.0))
        return cls(np.stack(channels, axis=-1), place_m, ground_m, eye_height_m)

    def at(self, azimuth_rad: Float64Array) -> Float64Array:
        """Return the channels, (M, R, 6 or 7), at azimuths (M, R), linear between bins."""
        count, bins, channels = self.channels.shape
        position = azimuth_rad * (bins / (2.0 * np.pi))
        left = np.floor(position).astype(np.intp)
        share = (position - left)[..., np.newaxis]
        flat = self.channels.reshape(-1, channels)
        row = np.arange(count)[:, np.newaxis] * bins
        here, there = flat[row + left % bins], flat[row + (left + 1) % bins]
        return np.asarray(here + (there - here) * share)


@dataclass(frozen=True, slots=True, eq=False)
class Fit(Rows):
    """How well M states of the camera fit the query."""

    state: Float64Array
    """(M, P) float64, P 7 or 8. See `EAST` to `DISTORTION`; the displacement is from where the
    curve was seen."""
    angle: IntArray
    height: IntArray
    """``angle``, ``height``: (M,) intp. The deviations chosen, indices into `Noise`."""
    cost: Float64Array
    """(M,) float64. Negative logarithm of the likelihood, the priors and what the uncertainty of
    the attitude takes from it included; infinite where there is no fit."""
    odds: Float64Array
    """(M, R) float64. Odds that a column of the query shows terrain."""


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """Residuals of M states and their derivatives; 0 in columns where the terrain is unknown."""

    residual_rad: Float64Array
    """(M, R) float64. Query over terrain; NaN where unknown."""
    jacobian: Float64Array
    """(M, R, P) float64."""
    azimuth_rad: Float64Array
    distance_m: Float64Array
    """``azimuth_rad``, ``distance_m``: (M, R) float64. Of the terrain's skyline under each
    column."""
    rise_rad: Float64Array | None
    """(M, R) float64 or None. How far above it things may rise."""
    place_m: NDArray[np.complex128]
    """(M,) complex128. Where the states' eyes stand; see `Curves`."""
    eye_m: Float64Array
    """(M,) float64. Their elevations, the ground taken to be level about where the curve was
    seen."""
    elevation_tan: Float64Array
    """(M, R) float64. Tangent of the terrain's skyline there; NaN where unknown."""


class Solver:
    """Aligns one query to curves.

    ``height_sd_m`` is the deviation of the terrain model's heights to be expected. Without
    ``edge``, where the terrain's data end, nothing is taken to lie beyond.
    """

    def __init__(
        self,
        query: QueryRays,
        config: SolverConfig,
        eye: EyeHeight,
        height_sd_m: float,
        claim: Claim | None = None,
        edge: DataEdge | None = None,
    ) -> None:
        self.query = query
        self._claim, self._edge = claim, edge
        self.config = config
        self.noise = replace(config.noise, height_sd_m=height_sd_m)
        self._eye = eye
        low, high = query.log_scale_bounds
        self.size = size = DISTORTION + (query.distortion_sd > 0.0)
        """Unknowns P of a state."""
        self._low, self._high = np.full(size, -np.inf), np.full(size, np.inf)
        self._low[[EYE_HEIGHT, LOG_SCALE]] = eye.least_m, low
        self._high[[EYE_HEIGHT, LOG_SCALE]] = eye.most_m, high
        # Within its range a field of view is as likely as any other, but for its own deviation.
        range_sd = max((high - low) / np.sqrt(12.0), 1e-6)
        pitch_sd, roll_sd = np.radians((config.pitch_sd_deg, config.roll_sd_deg))
        self._prior = np.zeros(size)
        self._prior[[PITCH, ROLL]] = pitch_sd**-2, roll_sd**-2
        self._prior[LOG_SCALE] = query.log_scale_sd**-2.0
        place_sd, eye_sd = config.position_sd_m, max(eye.sd_m, _NO_STEP_M)
        free = np.full(size, np.inf)
        free[:PITCH] = place_sd, place_sd, eye_sd, np.pi
        free[LOG_SCALE] = range_sd
        if query.distortion_sd > 0.0:
            self._prior[DISTORTION] = query.distortion_sd**-2.0
            self._low[DISTORTION], self._high[DISTORTION] = -_MOST_DISTORTION, _MOST_DISTORTION
        self._information = self._prior + free**-2.0
        off = np.log(self.noise.height_shares) / _LOG_HEIGHT_SD
        self._noise_cost = config.terrain_weight * 0.5 * off**2

    def start(self, hypotheses: Hypotheses) -> Fit:
        """Return hypotheses as states, the noise as wide as it may be; not yet judged."""
        count = len(hypotheses)
        state = np.zeros((count, self.size))
        state[:, EYE_HEIGHT] = self._eye.usual_m
        state[:, HEADING] = np.radians(hypotheses.heading_deg)
        state[:, PITCH] = np.radians(hypotheses.pitch_deg)
        state[:, ROLL] = np.radians(hypotheses.roll_deg)
        scale = self.query.log_scale(hypotheses.fov_deg)
        state[:, LOG_SCALE] = np.clip(scale, self._low[LOG_SCALE], self._high[LOG_SCALE])
        state[:, DISTORTION:] = hypotheses.distortion[:, np.newaxis]
        angle, height = (np.full(count, index) for index in self.noise.widest)
        odds = np.ones((count, len(self.query.u)))
        return Fit(state, angle, height, np.full(count, np.inf), odds)

    def at_height(self, fit: Fit, height_m: Float64Array) -> Fit:
        """Return fits whose eyes stand so high (M,) above the ground, within what is tried."""
        state = fit.state.copy()
        low, high = self._low[EYE_HEIGHT], self._high[EYE_HEIGHT]
        state[:, EYE_HEIGHT] = np.clip(height_m, low, high)
        return replace(fit, state=state)

    def posed(self, hypotheses: Hypotheses, fit: Fit) -> Hypotheses:
        """Return hypotheses with the attitude, the field of view and the cost of a fit."""
        return replace(
            hypotheses,
            heading_deg=np.degrees(fit.state[:, HEADING]) % 360.0,
            pitch_deg=np.degrees(fit.state[:, PITCH]),
            roll_deg=np.degrees(fit.state[:, ROLL]),
            fov_deg=self.fov_deg(fit.state),
            distortion=fit.state[:, DISTORTION:].sum(axis=1),
            score=fit.cost,
        )

    def fov_deg(self, state: Float64Array) -> Float64Array:
        """Return the field of view of states (M, P), degrees."""
        return self.query.fov_at(state[:, LOG_SCALE])

    def improve(self, curves: Curves, fit: Fit, step_m: Float64Array) -> Fit:
        """Take the configured steps from one rendering, and choose the noise on the way.

        ``step_m`` (M,) is the deviation that damps the eye's displacement; 0 keeps the eye where it
        is.
        """
        errors = None
        for iteration in range(self.config.iterations + 1):
            linear = self.linearize(curves, fit.state)
            errors = self._errors(linear, curves) if errors is None else errors
            choose = iteration < self.config.choices
            fit, judged = self._chosen(fit, linear, errors, _NEIGHBOURS if choose else ())
            if iteration < self.config.iterations:
                fit = self._stepped(fit, linear, judged, step_m)
        return fit

    def settle(self, curves: Curves, fit: Fit) -> Fit:
        """Solve the attitude from afar, where the eye stands.

        A wide noise takes trees for terrain and stays wide; so a second start holds on to where
        most columns agree, and the better of both counts.
        """
        none = np.zeros(len(fit.cost))
        wide = self.improve(curves, fit, none)
        agreed = self.improve(curves, self._agreed(curves, wide), none)
        return wide.replaced(agreed.cost < wide.cost, agreed)

    def _agreed(self, curves: Curves, fit: Fit) -> Fit:
        """Return the fit with the pitch at which most columns agree within a narrow noise."""
        noise = self.noise
        linear = self.linearize(curves, fit.state)
        off = linear.residual_rad[..., np.newaxis] - _AGREEMENT_RAD
        density = np.exp(-0.5 * (off / _AGREEMENT_RAD_SD) ** 2) / _AGREEMENT_RAD_SD
        other = np.where(off >= 0.0, noise.above_share, noise.below_share)
        odds = np.log(density + other / np.radians(noise.range_deg))
        agreement = np.tensordot(np.nan_to_num(odds), self.query.weight, axes=(1, 0))
        state = fit.state.copy()
        state[:, PITCH] -= _AGREEMENT_RAD[np.argmax(agreement, axis=1)]
        angle = np.searchsorted(np.radians(noise.angle_deg), _AGREEMENT_RAD_SD)
        height = len(noise.height_m) // 2
        return replace(
            fit,
            state=state,
            angle=np.full_like(fit.angle, min(int(angle), noise.widest[0])),
            height=np.full_like(fit.height, height),
            odds=np.ones_like(fit.odds),
        )

    def judged(self, curves: Curves, fit: Fit) -> tuple[Linear, Judged]:
        """Return residuals and their noise at a fit."""
        linear = self.linearize(curves, fit.state)
        errors = self._errors(linear, curves)
        return linear, self._judge(fit, linear, errors, (fit.angle, fit.height))

    def covariance(self, linear: Linear, judged: Judged) -> Float64Array:
        """Return the covariance (M, P, P) of states, priors included."""
        normal = judged.product(linear.jacobian, linear.jacobian) + np.diag(self._information)
        self._draw(linear, normal, np.zeros(normal.shape[:2]))
        return np.asarray(np.linalg.inv(normal))

    def linearize(self, curves: Curves, state: Float64Array) -> Linear:
        """Return residuals and their derivatives at states (M, P)."""
        turned, ray_y, turned_change, ray_change = level_with_changes(
            self.query, *state[:, PITCH:].T
        )
        azimuth = turned + state[:, HEADING, np.newaxis]
        there = curves.at(azimuth)
        slope, change = there[..., 1:2], there[..., 2:5]
        move = state[:, _MOVES].copy()
        move[:, EYE_HEIGHT] -= curves.eye_height_m
        y = there[..., 0] + (change @ move[..., np.newaxis])[..., 0]
        # Differences of tangents become angles; how that factor changes is left out.
        to_angle = 1.0 / (1.0 + ray_y**2)
        attitude = ray_change - slope * turned_change
        jacobian = np.concatenate([-change, -slope, attitude], axis=-1) * to_angle[..., np.newaxis]
        residual = (ray_y - y) * to_angle
        # Next to an unknown column the curve may be known but not its slope.
        known = np.isfinite(residual) & np.isfinite(jacobian).all(axis=-1)
        return Linear(
            np.where(known, residual, np.nan),
            np.where(known[..., np.newaxis], jacobian, 0.0),
            azimuth,
            there[..., 5],
            there[..., 6] * to_angle if there.shape[-1] > 6 else None,
            curves.place_m + state[:, EAST] + 1j * state[:, NORTH],
            curves.ground_m + state[:, EYE_HEIGHT],
            y,
        )

    def beyond_rad(self, linear: Linear) -> Float64Array:
        """Return how far above the skyline, (M, R), terrain past the data's edge may rise.

        It is below 0 where none reaches it, and 0 where the skyline or the edge is unknown.
        """
        if self._edge is None:
            return np.zeros_like(linear.residual_rad)
        place_m, eye_m = linear.place_m[:, np.newaxis], linear.eye_m[:, np.newaxis]
        most = self._edge.elevation_tan(place_m.real, place_m.imag, eye_m, linear.azimuth_rad)
        return np.asarray(np.nan_to_num(np.arctan(most) - np.arctan(linear.elevation_tan)))

    def _errors(self, linear: Linear, curves: Curves) -> HeightErrors:
        step_rad = 2.0 * np.pi / curves.channels.shape[1]
        blur_rad = self.config.blur_steps * step_rad * np.abs(linear.jacobian[..., HEADING])
        return HeightErrors.of(
            linear.azimuth_rad,
            linear.distance_m,
            blur_rad,
            self.noise,
            linear.rise_rad,
            self.beyond_rad(linear),
        )

    def _judge(
        self, fit: Fit, linear: Linear, errors: HeightErrors, noise: tuple[IntArray, IntArray]
    ) -> Judged:
        """Judge states under a noise, the attitude's part of the cost included."""
        judged = judge(
            linear.residual_rad,
            self.query.weight,
            errors,
            self.noise,
            noise,
            fit.odds,
            np.exp(fit.state[:, LOG_SCALE]),
        ).scaled()
        # Laplace's approximation to the integral over the attitude: without it a noise that is
        # too small wins, as much of the error hides in pitch, roll and the field of view.
        attitude = slice(HEADING, None)
        normal = judged.product(linear.jacobian[..., attitude], linear.jacobian[..., attitude])
        _, log_det = np.linalg.slogdet(normal + np.diag(self._information[attitude]))
        prior = 0.5 * fit.state**2 @ self._prior
        prior += self.config.terrain_weight * self._eye.cost(fit.state[:, EYE_HEIGHT])
        if self._claim is not None:
            prior += self._claim.cost(linear.place_m, linear.eye_m, fit.state[:, HEADING])
        cost = judged.cost + 0.5 * log_det + prior + self._noise_cost[noise[1]]
        return replace(judged, cost=cost)

    def _chosen(
        self, fit: Fit, linear: Linear, errors: HeightErrors, steps: Sequence[tuple[int, int]]
    ) -> tuple[Fit, Judged]:
        """Move the noise by the best of steps, or none."""
        noise = fit.angle, fit.height
        best = self._judge(fit, linear, errors, noise)
        fit = replace(fit, odds=best.odds)
        for step in steps:
            other = (
                np.clip(fit.angle + step[0], 0, self.noise.widest[0]),
                np.clip(fit.height + step[1], 0, self.noise.widest[1]),
            )
            judged = self._judge(fit, linear, errors, other)
            better = judged.cost < best.cost
            best = best.replaced(better, judged)
            noise = np.where(better, other[0], noise[0]), np.where(better, other[1], noise[1])
        known = np.isfinite(linear.residual_rad).sum(axis=1) >= self.config.min_columns
        cost = np.where(known, best.cost, np.inf)
        return Fit(fit.state, *noise, cost, best.odds), best

    def _stepped(self, fit: Fit, linear: Linear, judged: Judged, step_m: Float64Array) -> Fit:
        """Take one step, within the bounds of the field of view and of the eye's height."""
        miss = np.nan_to_num(linear.residual_rad)[..., np.newaxis]
        # What draws a state back: to where the curve was seen, and to what is usual.
        height_m, step_m = fit.state[:, EYE_HEIGHT], np.maximum(step_m, _NO_STEP_M)
        prior = np.tile(self._prior, (len(step_m), 1))
        prior[:, [EAST, NORTH]] = step_m[:, np.newaxis] ** -2
        prior[:, EYE_HEIGHT] = self.config.terrain_weight * self._eye.precision(height_m)
        off = fit.state.copy()
        off[:, EYE_HEIGHT] -= self._eye.usual_m
        # What makes a step shorter, wherever it leads.
        damping = np.zeros_like(prior)
        damping[:, EYE_HEIGHT] = (_UPWARD * step_m) ** -2
        damping[:, HEADING:] = _DAMPING_RAD**-2
        normal = judged.product(linear.jacobian, linear.jacobian)
        normal += (prior + damping)[:, np.newaxis] * np.eye(self.size)
        gradient = judged.product(linear.jacobian, miss)[..., 0] + prior * off
        gradient[:, LOG_SCALE] -= judged.magnification_pull(miss[..., 0])
        self._draw(linear, normal, gradient)
        state = fit.state - np.linalg.solve(normal, gradient[..., np.newaxis])[..., 0]
        bounded = np.clip(state, self._low, self._high)
        outside = bounded != state
        if outside.any():
            # Where one meets a bound, the others are solved with it held there.
            held = np.where(outside, _HELD, 0.0)
            normal += held[:, np.newaxis] * np.eye(self.size)
            gradient += np.where(outside, _HELD * (fit.state - bounded), 0.0)
            state = fit.state - np.linalg.solve(normal, gradient[..., np.newaxis])[..., 0]
            state = np.clip(state, self._low, self._high)
        return replace(fit, state=state)

    def _draw(self, linear: Linear, normal: Float64Array, gradient: Float64Array) -> None:
        """Add to normal equations what draws eyes (M,) to the claim."""
        if self._claim is None:
            return
        precision = self._claim.precision(linear.place_m)
        gradient[:, :EYE_HEIGHT] += precision[:, np.newaxis] * self._claim.offset_m(linear.place_m)
        for axis in (EAST, NORTH):
            normal[:, axis, axis] += precision
        precision, off_m = self._claim.lift(linear.eye_m)
        gradient[:, EYE_HEIGHT] += precision * off_m
        normal[:, EYE_HEIGHT, EYE_HEIGHT] += precision
