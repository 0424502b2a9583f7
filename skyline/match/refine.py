r"""Refinement: hypotheses move, by repeated rendering, to where the rendering fits the query.

Each round renders all remaining hypotheses in one call. A rendering holds the distance of every
skyline point, from which follows how the skyline changes as the eye moves (`skyline.match.solver`).
So position, heading, pitch, roll and field of view are solved together. A step is kept where the
rendering from the new place fits better; otherwise a shorter one is tried from the old place. The
worst hypotheses are dropped from round to round. Occlusion makes local optima, so the best few then
start again from places around them.

These rounds treat the terrain model's errors as independent from column to column, which is quick
and converges from far away. The last rounds model them as correlated (`skyline.match.noise`), which
gives near and far terrain the right weights, and gives costs and covariances their meaning. Where
the list of hypotheses is long, one coarse rendering of each first selects those worth following.
Where terrain is near, even the right place may look wrong until the eye has moved, so the likeliest
hypotheses by their scores move before they are compared with others.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import BoolArray, Complex128Array, Float64Array, IntArray, Rows
from skyline.geodesy import in_turn
from skyline.match.candidate import (
    DISTANCES_M,
    RIGHT_WITHIN_M,
    ROUGHLY_WITHIN_M,
    SAME_VIEW_DEG,
    Hypotheses,
    RefinedPoses,
)
from skyline.match.prior import NOTHING_KNOWN, EyeHeightPrior, Prior
from skyline.match.query_rays import QueryRays
from skyline.match.scene import RenderedScene, joined_views
from skyline.match.screening import report_progress
from skyline.match.solver import (
    EYE_HEIGHT,
    FINE,
    HEADING,
    LOG_SCALE,
    ROLL,
    ROUGH,
    SCOUT,
    TEMPERATURE,
    Curves,
    Fit,
    Solver,
)
from skyline.terrain.heightfield import ground_slope
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints

_SEPARATION_M = 12.0
"""Poses nearer to each other, that look within `SAME_VIEW_DEG` of each other, are one."""
_RIVALS = 3
"""Best poses of other answers, and best distant poses, that are kept to the end beside the best
pose: their fits show how sure an answer is."""
_LIKELIEST_ROUNDS = 4
"""Moves of the likeliest hypotheses before they are compared with others."""
RESTART_ROUNDS, _RESTARTS_M = 3, (10.0, 30.0)
"""Renderings of each place on the rings from which the search restarts, and the rings' radii: a
near slope is found from 10 to 20 m away, and a far one from farther."""
_FIRST_STEP_M, _LONGEST_STEP_M = 40.0, 120.0
"""Deviations that damp steps."""
_LONGER, _SHORTER = 1.5, 0.4
"""Factors on the next step after a step was kept, and after one was not."""
_SETTLING = 3
"""Fits without a step after which the chosen errors no longer change."""
_SECTOR_MARGIN_DEG = 3.0
"""A view is rendered if the query comes this near to it."""
GREATEST_LOG_ODDS = 50.0
"""Log odds beyond this count as this, so that their exponential exists."""
_LEAST_NEARNESS = 1e-6
"""Least mean inverse distance of a skyline, 1 / m."""


@dataclass(frozen=True, slots=True)
class Effort:
    """The number of hypotheses that a refinement follows, and of the rounds for which it does."""

    shortlist: int
    """Hypotheses taken, the best by their scores."""
    particles: int
    """Hypotheses that are moved, the best by one coarse rendering each."""
    likeliest: int
    """Hypotheses that are moved besides, the best by their scores."""
    rounds: int
    """Renderings of a hypothesis that is kept, before the last rounds."""
    keep_share: float
    keep_least: int
    """``keep_share``, ``keep_least``: share of the hypotheses kept from one round to the next, and
    their least number."""
    restarts: int
    """Best places around which the search restarts."""
    weighed: int
    """Places whose fits are weighed anew with correlated errors, from what has been rendered."""
    finalists: int
    """The best of these, which go through the last rounds."""
    final_rounds: int
    """Most renderings of each in the last rounds."""


QUICK = Effort(
    shortlist=64, particles=16, likeliest=0, rounds=4, keep_share=0.6, keep_least=6,
    restarts=1, weighed=48, finalists=6, final_rounds=3,
)  # fmt: skip
"""Enough for most skylines, which fit one place far better than any other."""
WHOLE = Effort(
    shortlist=1600, particles=128, likeliest=12, rounds=8, keep_share=0.9, keep_least=48,
    restarts=6, weighed=48, finalists=12, final_rounds=5,
)  # fmt: skip
"""For all other skylines."""


@dataclass(frozen=True, slots=True, eq=False)
class Particles(Rows):
    """M moving hypotheses: their skylines, how these fit the query, and the next step."""

    curves: Curves
    fit: Fit
    step_m: Float64Array
    """(M,) float64. Deviation that damps the next step."""

    def best(self, count: int) -> "Particles":
        """Return the best ``count`` of those that fit at all, best first."""
        order = np.argsort(self.fit.cost, kind="stable")[:count]
        return self[order[np.isfinite(self.fit.cost[order])]]

    def kept(self, new: "Particles", better: BoolArray) -> "Particles":
        """Return the new particles where they are better, and these particles elsewhere.

        The next step of the former is longer, that of the latter shorter.
        """
        step_m = self.step_m * np.where(better, _LONGER, _SHORTER)
        return replace(self.replaced(better, new), step_m=np.minimum(step_m, _LONGEST_STEP_M))


class Refinement:
    """The refinement of one query.

    The height of the eye above the ground is solved for unless the prior's narrowing gives it.
    """

    def __init__(
        self,
        query: QueryRays,
        scene: RenderedScene,
        effort: Effort,
        prior: Prior = NOTHING_KNOWN,
    ) -> None:
        self._scene, self.effort = scene, effort
        eye = EyeHeightPrior(DEFAULT_EYE_HEIGHT_M, scene.height_sd_m)
        if prior.narrowing.eye_height_m is not None:
            eye = EyeHeightPrior(prior.narrowing.eye_height_m, 0.0)
        self.scout, self.rough, self.fine = (
            Solver(query, mode, eye, scene.height_sd_m, prior.noted, scene.edge)
            for mode in (SCOUT, ROUGH, FINE)
        )
        self._rendered = 0
        self._expected = effort.rounds + RESTART_ROUNDS + effort.final_rounds
        self._expected += effort.shortlist > effort.particles
        self._expected += (1 + _LIKELIEST_ROUNDS) * (effort.likeliest > 0)

    def run(self, hypotheses: Hypotheses) -> RefinedPoses:
        """Return distinct poses that fit, best first; none where none fits.

        Eyes stand above the ground and never leave the map: a step off the map, or onto a hole, is
        not taken, and a hypothesis that starts there gives no pose. A column without data is
        unknown, and counts no more than one that shows a tree.

        The scores, headings and fields of view of the hypotheses are used, but not their eyes'
        elevations.
        """
        effort = self.effort
        best = np.argsort(hypotheses.score, kind="stable")[: effort.shortlist]
        hypotheses, likeliest = hypotheses[best], None
        if len(hypotheses) > effort.particles:
            if effort.likeliest:
                likeliest = self.started(self.rough, hypotheses[: effort.likeliest])
                for _ in range(_LIKELIEST_ROUNDS):
                    likeliest = self._moved(self.rough, likeliest)
            seen = self.started(self.scout, hypotheses).best(effort.particles)
            hypotheses = self.hypotheses(seen)
        particles = self.started(self.rough, hypotheses)
        if likeliest is not None:
            particles = Particles.concatenate([particles, likeliest])
        for _ in range(effort.rounds - 1):
            kept = max(effort.keep_least, int(np.ceil(effort.keep_share * len(particles))))
            particles = self._moved(self.rough, self.survivors(particles, kept))
        particles = Particles.concatenate([particles, self._restarted(particles)])
        particles = self.reweighted(self.distinct(particles, effort.weighed))
        particles = self.distinct(particles, effort.finalists)
        for _ in range(effort.final_rounds):
            particles = self._moved(self.fine, particles)
        return self.poses(self.distinct(particles, effort.finalists))

    def started(self, solver: Solver, hypotheses: Hypotheses) -> Particles:
        """Return particles at hypotheses, their attitudes solved from there."""
        place_m = hypotheses.easting_m + 1j * hypotheses.northing_m
        return self.arrived(solver, place_m, solver.start(hypotheses))

    def reweighted(self, particles: Particles) -> Particles:
        """Return particles fitted with correlated errors, until the chosen errors have settled."""
        fit = particles.fit
        for _ in range(_SETTLING):
            fit = self.fine.improve(particles.curves, fit, np.zeros(len(particles)))
        return replace(particles, fit=fit, step_m=np.full(len(particles), _FIRST_STEP_M))

    def _moved(self, solver: Solver, particles: Particles) -> Particles:
        """Return particles after one step, where the rendering from the new place fits better."""
        solved = solver.improve(particles.curves, particles.fit, particles.step_m)
        new = self.stepped(solver, particles, solved.state, solved)
        return particles.kept(new, new.fit.cost < particles.fit.cost)

    def stepped(
        self, solver: Solver, particles: Particles, step: Float64Array, fit: Fit
    ) -> Particles:
        """Return particles moved by steps (M, 2 or more), east and north, of bounded length."""
        length_m = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)
        east_m, north_m = step[:, :2].T * np.minimum(1.0, 2.0 * particles.step_m / length_m)
        return self.arrived(solver, particles.curves.place_m + (east_m + 1j * north_m), fit)

    def around(self, particles: Particles) -> Particles:
        """Return particles that start from rings around each place."""
        turns = np.exp(0.25j * np.pi * np.arange(8))
        # The rings are half a step apart in azimuth.
        rings = np.concatenate(
            [
                radius_m * turns * np.exp(0.125j * np.pi * number)
                for number, radius_m in enumerate(_RESTARTS_M)
            ]
        )
        near = particles[np.repeat(np.arange(len(particles)), len(rings))]
        place_m = near.curves.place_m + np.tile(rings, len(particles))
        return self.arrived(self.rough, place_m, near.fit)

    def _restarted(self, particles: Particles) -> Particles:
        """Return the particles that started around the best distinct places."""
        standing = self.hypotheses(particles)
        best = standing.suppress_non_maxima(self.effort.restarts, _SEPARATION_M, SAME_VIEW_DEG)
        around = self.around(particles[best])
        for _ in range(RESTART_ROUNDS - 1):
            around = self._moved(self.rough, around.best(len(around)))
        return around

    def arrived(self, solver: Solver, place_m: Complex128Array, fit: Fit) -> Particles:
        """Return particles at places, their attitudes solved there; without a fit off the map."""
        state = fit.state.copy()
        state[:, :EYE_HEIGHT] = 0.0
        fit = replace(fit, state=state)
        curves = self._seen(solver, place_m, state)
        is_new = bool(np.isinf(fit.cost).all())
        still = np.zeros(len(state))
        fit = solver.settle(curves, fit) if is_new else solver.improve(curves, fit, still)
        return Particles(curves, fit, np.full(len(state), _FIRST_STEP_M))

    def _seen(self, solver: Solver, place_m: Complex128Array, state: Float64Array) -> Curves:
        """Render the directions of the query from M eyes, at the heights of their states."""
        report_progress("refining", min(1.0, self._rendered / self._expected))
        self._rendered += 1
        easting_m, northing_m = place_m.real, place_m.imag
        ground_m, height_m = self._scene.ground_m(easting_m, northing_m), state[:, EYE_HEIGHT]
        turn = np.degrees(state[:, HEADING])[:, np.newaxis] - 90.0 * np.arange(4)
        off = np.abs(in_turn(turn))
        half_deg = 0.5 * solver.query.fov_at(state[:, LOG_SCALE])[:, np.newaxis]
        wanted = off < 45.0 + half_deg + _SECTOR_MARGIN_DEG
        row, heading = np.nonzero(wanted & np.isfinite(ground_m)[:, np.newaxis])
        eyes = Viewpoints(
            easting_m=easting_m[row],
            northing_m=northing_m[row],
            eye_elevation_m=ground_m[row] + height_m[row],
        )
        (y, distance_m), *surface = (
            joined_views(views, row, len(place_m), solver.mode.bins)
            for views in self._scene.render(eyes, heading)
        )
        surface_y = surface[0][0] if surface else None
        slope = ground_slope(self._scene.ground_m, easting_m, northing_m)
        # An eye off the map fits nowhere, whatever its ground is.
        ground_m = np.nan_to_num(ground_m)
        return Curves.of(y, distance_m, place_m, ground_m, slope, height_m, surface_y)

    def survivors(self, particles: Particles, count: int) -> Particles:
        """Return the particles of the next round: the best, and the very best one's rivals."""
        ordered = particles.best(len(particles))
        chosen = np.arange(min(count, len(ordered)))
        place = ordered.curves.place_m
        for least_m in DISTANCES_M:
            rivals = np.flatnonzero(np.abs(place - place[:1]) > least_m)
            chosen = np.union1d(chosen, rivals[:_RIVALS])
        return ordered[chosen]

    def distinct(self, particles: Particles, count: int) -> Particles:
        """Return the best distinct particles, and rivals of the very best, best first."""
        standing = self.hypotheses(particles)
        return particles[best_and_rivals(standing, count, SAME_VIEW_DEG)]

    def hypotheses(self, particles: Particles) -> Hypotheses:
        """Return the poses of particles; the scores are their costs."""
        return self.rough.hypotheses(particles.curves, particles.fit)

    def poses(self, particles: Particles) -> RefinedPoses:
        """Return particles after the last rounds as poses with their figures."""
        solver = self.fine
        linear, found = solver.evaluate(particles.curves, particles.fit)
        # Columns share errors that the likelihood takes for independent: variances are too small by
        # the temperature.
        covariance = TEMPERATURE * solver.covariance(linear, found)
        trust = solver.query.weight
        squares = (found.trusted_odds * np.nan_to_num(linear.residual_rad) ** 2).sum(axis=1)
        shown = np.maximum(found.trusted_odds.sum(axis=1), 1e-9)
        nearness = np.average(np.nan_to_num(1.0 / linear.distance_m), weights=trust, axis=1)
        hypotheses = self.hypotheses(particles)
        return RefinedPoses(
            hypotheses,
            spread(hypotheses, covariance[:, :EYE_HEIGHT, :EYE_HEIGHT]),
            np.degrees(np.sqrt(squares / shown)),
            shown / trust.sum(),
            1.0 / np.maximum(nearness, _LEAST_NEARNESS),
            found.effective_columns,
            solver.heights_m[particles.fit.height],
            np.asarray((solver.beyond_rad(linear) > 0.0) @ trust / trust.sum()),
            hypotheses.rival_margin(RIGHT_WITHIN_M, SAME_VIEW_DEG),
            hypotheses.rival_margin(ROUGHLY_WITHIN_M, SAME_VIEW_DEG),
            self._angle_sd_deg(particles, covariance),
            solver.wander(particles.fit),
        )

    def _angle_sd_deg(self, particles: Particles, covariance: Float64Array) -> Float64Array:
        """Return the standard errors (M, 4) of heading, pitch, roll and field of view."""
        sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        scale, off = particles.fit.state[:, LOG_SCALE], sd[:, LOG_SCALE]
        query = self.fine.query
        fov_deg = np.abs(query.fov_at(scale + off) - query.fov_at(scale - off)) / 2.0
        return np.column_stack([np.degrees(sd[:, HEADING : ROLL + 1]), fov_deg])


def spread(hypotheses: Hypotheses, covariance_m2: Float64Array) -> Float64Array:
    """Return the place's covariance (M, 2, 2) about each pose, over all poses of the same answer.

    ``covariance_m2`` (M, 2, 2) is that of each pose by itself.
    """
    place = np.stack([hypotheses.easting_m, hypotheses.northing_m], axis=1)
    apart = place[:, np.newaxis] - place
    near = (apart**2).sum(axis=-1) <= RIGHT_WITHIN_M**2
    better = hypotheses.score[:, np.newaxis] - hypotheses.score
    odds = near * np.exp(np.minimum(better / TEMPERATURE, GREATEST_LOG_ODDS))
    share = odds / odds.sum(axis=1, keepdims=True)
    squares = covariance_m2 + apart[..., np.newaxis] * apart[..., np.newaxis, :]
    return np.asarray((share[..., np.newaxis, np.newaxis] * squares).sum(axis=1))


def best_and_rivals(standing: Hypotheses, count: int, turn_deg: float = 360.0) -> IntArray:
    """Return the indices of the best distinct poses and of the best one's rivals, best first."""
    chosen = standing.suppress_non_maxima(count, _SEPARATION_M, turn_deg)
    apart_m = standing.distances_m()[chosen[:1]]
    for least_m in DISTANCES_M:
        others = np.flatnonzero((apart_m > least_m).any(axis=0))
        if len(others):
            rivals = standing[others].suppress_non_maxima(_RIVALS, _SEPARATION_M, turn_deg)
            chosen = np.union1d(chosen, others[rivals])
    return chosen[np.argsort(standing.score[chosen], kind="stable")]
