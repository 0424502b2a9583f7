"""Refinement of poses by rendering, until the renderings fit the photo.

Each round renders all remaining poses in one call. A rendering holds the distance of every
skyline point, from which follows how the skyline changes as the eye moves (`skyline.match.solver`).
So position, heading, pitch, roll and field of view are solved together. A step is kept where the
rendering from the new place fits better; otherwise a shorter one is tried from the old place. The
worst poses are dropped from round to round. Occlusion makes local optima, so the best few then
start again from places around them.

These rounds treat the terrain model's errors as independent from column to column, which is quick
and converges from far away. The last rounds model them as correlated (`skyline.match.likelihood`),
which gives near and far terrain the right weights, and gives costs and covariances their meaning.
Where the list of poses is long, one coarse rendering of each first selects those worth
following. Where terrain is near, even the right place may look wrong until the eye has moved, so
the likeliest poses by their costs move before they are compared with others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skyline.angles import angle_between_deg
from skyline.arrays import BoolArray, Complex128Array, Float64Array, IntArray, Rows
from skyline.match.curves import EYE_HEIGHT, Curves
from skyline.match.eye_prior import EyeHeightPrior
from skyline.match.likelihood import GREATEST_LOG_ODDS
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.rays import Rays
from skyline.match.solver import (
    FINE,
    FOLLOW,
    ROUGH,
    SCOUT,
    TEMPERATURE,
    Fit,
    Solver,
)
from skyline.pose.pose import DISTANCES_M, RIGHT_WITHIN_M, SAME_VIEW_DEG
from skyline.pose.pose_errors import HEADING, LOG_SCALE, ROLL
from skyline.pose.poses import FitFigures, Poses
from skyline.progress import Step, StepProgress, silent
from skyline.render.horizon import RenderedScene
from skyline.skylines import joined_views
from skyline.terrain.heightfield import ground_slope
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints

VIEW_WIDTH = 360
"""Columns of the views that refinement renders."""


@dataclass(frozen=True, slots=True)
class Moves:
    """How poses move from one rendering to the next."""

    separation_m: float = 12.0
    """Poses that are nearer to each other count as one, if they look within `SAME_VIEW_DEG` of each
    other."""
    rivals: int = 3
    """How many of the best other answers, and of the best distant poses, are kept to the end: their
    fits show how sure the best pose is."""
    likeliest_rounds: int = 4
    """Moves of the likeliest poses before they are compared with others."""
    restart_rounds: int = 3
    """Renderings of each place on the rings where the search restarts."""
    restarts_m: tuple[float, ...] = (10.0, 30.0, 90.0)
    """Radii of these rings: a near slope is found from 10 to 20 m away, a far one from farther."""
    first_step_m: float = 40.0
    """Standard deviation with which the first step is damped."""
    longest_step_m: float = 120.0
    """Greatest standard deviation with which a step is damped."""
    longer: float = 1.5
    """Factor on the next step after a step was kept."""
    shorter: float = 0.4
    """Factor on the next step after a step was not kept."""
    settling: int = 3
    """Number of fits without a step after which the chosen errors no longer change."""
    sector_margin_deg: float = 3.0
    """A view is rendered if the photo comes this near to it."""


MOVES = Moves()


@dataclass(frozen=True, slots=True)
class RefinementEffort:
    """How many poses a refinement follows, and for how many rounds."""

    shortlist: int
    """Poses that are taken: the best by cost."""
    particles: int
    """Poses that are moved: the best by one coarse rendering each."""
    likeliest: int
    """Further poses that are moved: the best by cost."""
    rounds: int
    """Renderings of each kept pose before the last rounds."""
    keep_share: float
    """Share of the poses kept from one round to the next."""
    keep_least: int
    """Least number of poses kept."""
    restarts: int
    """Best places around which the search restarts."""
    weighed: int
    """Places whose fits are weighed again with correlated errors, without another rendering."""
    finalists: int
    """The best of these, which enter the last rounds."""
    final_rounds: int
    """Most renderings of each in the last rounds."""


QUICK = RefinementEffort(
    shortlist=64, particles=16, likeliest=0, rounds=4, keep_share=0.6, keep_least=6,
    restarts=1, weighed=48, finalists=6, final_rounds=3,
)  # fmt: skip
"""The effort for most skylines, which fit one place far better than any other."""
WHOLE = RefinementEffort(
    shortlist=800, particles=128, likeliest=12, rounds=8, keep_share=0.8, keep_least=32,
    restarts=6, weighed=48, finalists=12, final_rounds=5,
)  # fmt: skip
"""The effort for all other skylines."""


@dataclass(frozen=True, slots=True, eq=False)
class Particles(Rows):
    """M moving poses, their fits and their next steps."""

    curves: Curves
    fit: Fit
    step_m: Float64Array
    """(M,) float64. Standard deviation with which the next step is damped."""

    def best(self, count: int) -> "Particles":
        """Return the best ``count`` of those that fit at all, best first."""
        order = np.argsort(self.fit.cost, kind="stable")[:count]
        return self[order[np.isfinite(self.fit.cost[order])]]

    def kept(self, new: "Particles", better: BoolArray) -> "Particles":
        """Return each new particle that is better, and otherwise the old one.

        The next step of a new particle is longer, and that of an old one shorter.
        """
        step_m = self.step_m * np.where(better, MOVES.longer, MOVES.shorter)
        return replace(self.replaced(better, new), step_m=np.minimum(step_m, MOVES.longest_step_m))


class Refinement:
    """The refinement of one photo's poses.

    The height of the eye above the ground is solved for, unless the prior's narrowing gives it. Its
    prior is ``eye``, by default the height of a person, and it starts at ``first_eye_height_m``, by
    default the usual height.
    """

    def __init__(
        self,
        rays: Rays,
        scene: RenderedScene,
        effort: RefinementEffort,
        prior: Prior = NOTHING_KNOWN,
        eye: EyeHeightPrior | None = None,
        first_eye_height_m: float | None = None,
        report: StepProgress = silent,
    ) -> None:
        self._scene = scene
        self.effort = effort
        self._report = report
        self._first_eye_height_m = first_eye_height_m
        eye = eye or EyeHeightPrior(DEFAULT_EYE_HEIGHT_M, scene.height_sd_m)
        if prior.narrowing.eye_height_m is not None:
            eye = EyeHeightPrior(prior.narrowing.eye_height_m, 0.0)
        self.scout, self.rough, self.follow, self.fine = (
            Solver(rays, mode, eye, scene.height_sd_m, prior.place_priors, scene.edge)
            for mode in (SCOUT, ROUGH, FOLLOW, FINE)
        )
        self._rendered = 0
        self._to_render = effort.rounds + MOVES.restart_rounds + effort.final_rounds
        if effort.shortlist > effort.particles:
            self._to_render += 1
        if effort.likeliest:
            self._to_render += 1 + MOVES.likeliest_rounds

    def run(self, poses: Poses) -> Poses:
        """Return distinct poses that fit, best first; none where none fits.

        Eyes stand above the ground and never leave the map: a step off the map, or onto a hole, is
        not taken, and a pose that starts there gives no pose. A column without data is
        unknown, and counts no more than one that shows a tree.

        The poses' costs, headings and fields of view are used, but not the elevations of their
        eyes.
        """
        effort = self.effort
        best = np.argsort(poses.cost, kind="stable")[: effort.shortlist]
        particles = self._first(poses[best])
        for _ in range(effort.rounds - 1):
            kept = max(effort.keep_least, int(np.ceil(effort.keep_share * len(particles))))
            particles = self.moved(self.follow, self.survivors(particles, kept))
        particles = Particles.concatenate([particles, self._restarted(particles)])
        particles = self.reweighted(self.distinct(particles, effort.weighed))
        particles = self.distinct(particles, effort.finalists)
        for _ in range(effort.final_rounds):
            particles = self.moved(self.fine, particles)
        return self.with_figures(self.distinct(particles, effort.finalists))

    def _first(self, poses: Poses) -> Particles:
        """Return the particles of the first round, from poses best first.

        Of more poses than can be followed, the best by a coarse rendering are, and the likeliest by
        their costs after some moves.
        """
        effort = self.effort
        if len(poses) <= effort.particles:
            return self.started(self.rough, poses)
        seen = self.started(self.scout, poses).best(effort.particles)
        particles = self.started(self.rough, self.poses(seen))
        if not effort.likeliest:
            return particles
        likeliest = self.started(self.rough, poses[: effort.likeliest])
        for _ in range(MOVES.likeliest_rounds):
            likeliest = self.moved(self.follow, likeliest)
        return Particles.concatenate([particles, likeliest])

    def started(self, solver: Solver, poses: Poses) -> Particles:
        """Return particles at poses, with attitudes solved from the poses' own."""
        fit = solver.start(poses)
        if self._first_eye_height_m is not None:
            fit = solver.at_height(fit, np.full(len(poses), self._first_eye_height_m))
        return self.arrived(solver, poses.position_m, fit)

    def reweighted(self, particles: Particles) -> Particles:
        """Return particles fitted with correlated errors, until the chosen errors have settled."""
        fit = particles.fit
        for _ in range(MOVES.settling):
            fit = self.fine.improve(particles.curves, fit, np.zeros(len(particles)))
        return replace(particles, fit=fit, step_m=np.full(len(particles), MOVES.first_step_m))

    def moved(self, solver: Solver, particles: Particles) -> Particles:
        """Return particles after one step, where the new rendering fits better."""
        solved = solver.improve(particles.curves, particles.fit, particles.step_m)
        new = self.stepped(solver, particles, solved.state, solved)
        return particles.kept(new, new.fit.cost < particles.fit.cost)

    def stepped(
        self, solver: Solver, particles: Particles, step: Float64Array, fit: Fit
    ) -> Particles:
        """Return particles moved by steps of bounded length.

        The steps (M, 2 or more) begin with metres east and north.
        """
        length_m = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)
        east_m, north_m = step[:, :2].T * np.minimum(1.0, 2.0 * particles.step_m / length_m)
        return self.arrived(solver, particles.curves.position_m + (east_m + 1j * north_m), fit)

    def around(self, particles: Particles) -> Particles:
        """Return particles that start from rings around each place."""
        turns = np.exp(0.25j * np.pi * np.arange(8))
        # The rings are half a step apart in azimuth.
        rings = np.concatenate(
            [
                radius_m * turns * np.exp(0.125j * np.pi * number)
                for number, radius_m in enumerate(MOVES.restarts_m)
            ]
        )
        near = particles[np.repeat(np.arange(len(particles)), len(rings))]
        position_m = near.curves.position_m + np.tile(rings, len(particles))
        return self.arrived(self.rough, position_m, near.fit)

    def _restarted(self, particles: Particles) -> Particles:
        """Return the particles that started around the best distinct places."""
        poses = self.poses(particles)
        best = poses.suppress_non_maxima(self.effort.restarts, MOVES.separation_m, SAME_VIEW_DEG)
        around = self.around(particles[best])
        for _ in range(MOVES.restart_rounds - 1):
            around = self.moved(self.follow, around.best(len(around)))
        return around

    def arrived(self, solver: Solver, position_m: Complex128Array, fit: Fit) -> Particles:
        """Return particles at places, with attitudes solved there.

        Particles off the map have no fit.
        """
        state = fit.state.copy()
        state[:, :EYE_HEIGHT] = 0.0
        fit = replace(fit, state=state)
        curves = self._seen(solver, position_m, state)
        is_new = bool(np.isinf(fit.cost).all())
        still = np.zeros(len(state))
        fit = solver.settle(curves, fit) if is_new else solver.improve(curves, fit, still)
        return Particles(curves, fit, np.full(len(state), MOVES.first_step_m))

    def _seen(self, solver: Solver, position_m: Complex128Array, state: Float64Array) -> Curves:
        """Render the photo's directions from M eyes at their states' heights."""
        self._report(Step.REFINING, min(1.0, self._rendered / self._to_render))
        self._rendered += 1
        easting_m, northing_m = position_m.real, position_m.imag
        ground_m = self._scene.ground_m(easting_m, northing_m)
        height_m = state[:, EYE_HEIGHT]
        heading_deg = np.degrees(state[:, HEADING])[:, np.newaxis]
        off_deg = angle_between_deg(heading_deg, 90.0 * np.arange(4))
        half_deg = 0.5 * solver.rays.fov_at(state[:, LOG_SCALE])[:, np.newaxis]
        wanted = off_deg < 45.0 + half_deg + MOVES.sector_margin_deg
        row, heading = np.nonzero(wanted & np.isfinite(ground_m)[:, np.newaxis])
        eyes = Viewpoints(
            easting_m=easting_m[row],
            northing_m=northing_m[row],
            eye_elevation_m=ground_m[row] + height_m[row],
        )
        (y, distance_m), *surface = (
            joined_views(views, row, len(position_m), solver.mode.bins)
            for views in self._scene.render(eyes, heading)
        )
        surface_y = surface[0][0] if surface else None
        slope = ground_slope(self._scene.ground_m, easting_m, northing_m)
        # An eye off the map fits nowhere, whatever its ground is.
        ground_m = np.nan_to_num(ground_m)
        return Curves.of(y, distance_m, position_m, ground_m, slope, height_m, surface_y)

    def survivors(self, particles: Particles, count: int) -> Particles:
        """Return the best particles, and the rivals of the best one."""
        ordered = particles.best(len(particles))
        chosen = np.arange(min(count, len(ordered)))
        place = ordered.curves.position_m
        for least_m in DISTANCES_M:
            rivals = np.flatnonzero(np.abs(place - place[:1]) > least_m)
            chosen = np.union1d(chosen, rivals[: MOVES.rivals])
        return ordered[chosen]

    def distinct(self, particles: Particles, count: int) -> Particles:
        """Return the best distinct particles, best first.

        The rivals of the best one are among them.
        """
        return particles[best_and_rivals(self.poses(particles), count, SAME_VIEW_DEG)]

    def poses(self, particles: Particles) -> Poses:
        """Return the poses of particles."""
        return self.rough.poses(particles.curves, particles.fit)

    def with_figures(self, particles: Particles) -> Poses:
        """Return the poses of particles, with figures of their fits."""
        solver = self.fine
        linear, found = solver.evaluate(particles.curves, particles.fit)
        # Columns share errors that the likelihood takes for independent: variances are too small by
        # the temperature.
        covariance = TEMPERATURE * solver.covariance(particles.fit, linear, found)
        trust = solver.rays.weight
        squares = (found.trusted_probability * np.nan_to_num(linear.residual_rad) ** 2).sum(axis=1)
        shown = np.maximum(found.trusted_probability.sum(axis=1), 1e-9)
        nearness = np.average(np.nan_to_num(1.0 / linear.distance_m), weights=trust, axis=1)
        poses = self.poses(particles)
        fits = FitFigures(
            covariance_m2=spread_m2(poses, covariance[:, :EYE_HEIGHT, :EYE_HEIGHT]),
            covariance=self._of_elevation(poses, covariance),
            residual_deg=np.degrees(np.sqrt(squares / shown)),
            terrain_share=shown / trust.sum(),
            skyline_m=1.0 / np.maximum(nearness, 1e-6),
            effective_columns=found.effective_columns,
            height_sd_m=solver.height_sds_m[particles.fit.height_index],
            beyond_share=np.asarray(found.may_rise @ trust / trust.sum()),
            margin=poses.rival_margin(RIGHT_WITHIN_M, SAME_VIEW_DEG),
            angle_sd_deg=self._angle_sd_deg(particles, covariance),
        )
        return replace(poses, fits=fits)

    def _of_elevation(self, poses: Poses, covariance: Float64Array) -> Float64Array:
        """Return covariances (M, P, P) with the eye's elevation for its height.

        An eye that moves over sloping ground keeps its height above it.
        """
        easting_m, northing_m = poses.easting_m, poses.northing_m
        to_elevation = np.tile(np.eye(covariance.shape[-1]), (len(poses), 1, 1))
        to_elevation[:, EYE_HEIGHT, :EYE_HEIGHT] = ground_slope(
            self._scene.ground_m, easting_m, northing_m
        )
        turned = to_elevation @ covariance @ to_elevation.swapaxes(1, 2)
        return np.asarray(0.5 * (turned + turned.swapaxes(1, 2)))

    def _angle_sd_deg(self, particles: Particles, covariance: Float64Array) -> Float64Array:
        """Return standard errors (M, 4) of heading, pitch, roll, field of view."""
        sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        scale = particles.fit.state[:, LOG_SCALE]
        off = sd[:, LOG_SCALE]
        rays = self.fine.rays
        fov_deg = np.abs(rays.fov_at(scale + off) - rays.fov_at(scale - off)) / 2.0
        return np.column_stack([np.degrees(sd[:, HEADING : ROLL + 1]), fov_deg])


def best_of_several(parts: Sequence[Poses], count: int) -> Poses:
    """Return the best distinct poses of several refinements, best first.

    The refinements are of one photo. Margins are over the poses of all of them.
    """
    if len(parts) == 1:
        return parts[0]
    some = [part for part in parts if len(part)] or parts[:1]
    poses = Poses.concatenate(some)
    poses = poses[best_and_rivals(poses, count, SAME_VIEW_DEG)]
    margin = poses.rival_margin(RIGHT_WITHIN_M, SAME_VIEW_DEG)
    return replace(poses, fits=replace(poses.figures(), margin=margin))


def spread_m2(poses: Poses, covariance_m2: Float64Array) -> Float64Array:
    """Return each place's covariance (M, 2, 2) over its answer's poses.

    ``covariance_m2`` (M, 2, 2) is the covariance of each pose by itself.
    """
    place = np.stack([poses.easting_m, poses.northing_m], axis=1)
    apart = place[:, np.newaxis] - place
    near = (apart**2).sum(axis=-1) <= RIGHT_WITHIN_M**2
    better = poses.cost[:, np.newaxis] - poses.cost
    odds = near * np.exp(np.minimum(better / TEMPERATURE, GREATEST_LOG_ODDS))
    share = odds / odds.sum(axis=1, keepdims=True)
    squares = covariance_m2 + apart[..., np.newaxis] * apart[..., np.newaxis, :]
    return np.asarray((share[..., np.newaxis, np.newaxis] * squares).sum(axis=1))


def best_and_rivals(poses: Poses, count: int, turn_deg: float = 360.0) -> IntArray:
    """Return the indices of the best distinct poses, best first.

    The rivals of the best pose are among them.
    """
    chosen = poses.suppress_non_maxima(count, MOVES.separation_m, turn_deg)
    apart_m = poses.distances_m()[chosen[:1]]
    for least_m in DISTANCES_M:
        others = np.flatnonzero((apart_m > least_m).any(axis=0))
        if len(others):
            rivals = poses[others].suppress_non_maxima(MOVES.rivals, MOVES.separation_m, turn_deg)
            chosen = np.union1d(chosen, others[rivals])
    return chosen[np.argsort(poses.cost[chosen], kind="stable")]
