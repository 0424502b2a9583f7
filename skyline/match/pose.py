"""Refinement: hypotheses move to where a rendering fits the query, by rendering again.

Each round renders every hypothesis that is left in one call. A rendering carries the distance of
every skyline point, so it also tells how the skyline changes as the eye moves
(`skyline.match.solver`), and position, heading, pitch, roll and field of view are solved
together. A step is kept where the rendering from the new place fits better; where it does not, a
shorter one is tried from the old. The worse hypotheses are dropped as the rounds go on.
Occlusion makes local optima, so the best few then start again from places around them.

That much takes the errors of the terrain model as independent from column to column, which is
quick and reaches far. The last rounds take them as they are, correlated: that weighs the near
and the far rightly, and makes costs and covariances mean what they say. Where the list is long,
a rendering of each, compared in wide steps of azimuth, says first which are worth following.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float64Array, IntArray, Rows
from skyline.geodesy import in_turn
from skyline.match.claim import Claim, EyeHeight
from skyline.match.hypotheses import Hypotheses
from skyline.match.match_config import RefineConfig
from skyline.match.profiles import Panoramas
from skyline.match.progress import tell
from skyline.match.query_rays import QueryRays, thinned
from skyline.match.retrieval import ground_slope
from skyline.match.solver import EYE_HEIGHT, HEADING, Curves, Fit, Solver
from skyline.skylines import Views
from skyline.terrain.edge import DataEdge
from skyline.terrain.viewpoints import Viewpoints

_SECTOR_MARGIN_DEG = 3.0
"""A view is rendered where the query comes this near to it."""
_SAME_VIEW_DEG = 30.0
"""Two poses at one place that look within this angle of one another are one."""
_LONGER, _SHORTER = 1.5, 0.4
"""What a step is multiplied by when the last one was kept, and when it was not."""
_SETTLING = 3
_GREATEST_LOG_ODDS = 50.0


class Scene(Protocol):
    """The terrain as refinement needs it."""

    @property
    def edge(self) -> DataEdge | None:
        """Where its data end; None where nothing is taken to lie beyond."""

    @property
    def height_sd_m(self) -> float:
        """Deviation of the terrain model's heights to be expected."""

    def render(self, viewpoints: Viewpoints, headings: NDArray[np.uint8]) -> Views:
        """Render one view an eye, each along its heading, in order."""

    def render_surface(self, viewpoints: Viewpoints, headings: NDArray[np.uint8]) -> Views | None:
        """Render likewise the surface of what may stand on the terrain; None where unknown."""

    def ground_m(self, easting_m: Float64Array, northing_m: Float64Array) -> Float64Array:
        """Return the terrain's height, (N,) for (N,); NaN off the map and over holes."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """M refined poses, best first, with what a confidence can be learned from."""

    hypotheses: Hypotheses
    """The score is the negative logarithm of the likelihood; only differences within one query mean
    anything."""
    covariance_m2: Float64Array
    """(M, 2, 2) float64. Of easting and northing about the pose, other optima of the same answer
    included."""
    residual_deg: Float64Array
    """(M,) float64. Root mean square over the columns that show terrain, in elevation."""
    inlier_share: Float64Array
    """(M,) float64. Part of the query that shows terrain."""
    effective_columns: Float64Array
    """(M,) float64. Independent columns that would say as much as those do."""
    height_sd_m: Float64Array
    """(M,) float64. Deviation of the terrain model's heights that the fit suggests."""
    beyond_share: Float64Array
    """(M,) float64. Part of the query in which terrain past the data's edge may stand above the
    model's."""
    margin: Float64Array
    """(M,) float64. Score of the best pose elsewhere minus this one's: below 0 unless this is the
    best; infinite where there is none elsewhere."""
    far_margin: Float64Array
    """(M,) float64. The same of the best pose far off."""
    renderings: int
    """Views that were rendered on the way."""

    def __len__(self) -> int:
        return len(self.hypotheses)


def refine(
    hypotheses: Hypotheses,
    query: QueryRays,
    scene: Scene,
    config: RefineConfig | None = None,
    claim: Claim | None = None,
) -> Poses:
    """Refine the hypotheses of one query.

    Eyes stand above the ground, as high as fits, and never leave the map: a step off it,
    or onto a hole, is not taken, and a hypothesis that starts there has no pose. A column that
    meets no data is unknown, which is worth no more than one that shows a tree.

    The hypotheses' scores, headings and fields of view are used, their eyes' elevation is not. What
    the photo says of where it was taken is in the scores. Poses are distinct ones that fit, best
    first; there are none where none does.
    """
    return Refinement(query, scene, config or RefineConfig(), claim).run(hypotheses)


@dataclass(frozen=True, slots=True, eq=False)
class Particles(Rows):
    """M hypotheses on their way: where they stand, what they see and how it fits."""

    easting_m: Float64Array
    northing_m: Float64Array
    step_m: Float64Array
    curves: Curves
    fit: Fit

    def best(self, count: int) -> "Particles":
        """Return the best that fit at all, best first."""
        order = np.argsort(self.fit.cost, kind="stable")[:count]
        return self[order[np.isfinite(self.fit.cost[order])]]


class Refinement:
    """The refinement of one query."""

    def __init__(
        self, query: QueryRays, scene: Scene, config: RefineConfig, claim: Claim | None
    ) -> None:
        self._scene = scene
        self._config = config
        if claim is not None:
            claim = replace(claim, weight=config.temperature)
        height_sd_m = scene.height_sd_m
        eye = EyeHeight(config.eye_height_m, 0.0 if config.eye_height_known else height_sd_m)
        scouting, query = thinned(query, config.scout_bins), thinned(query, config.bins)
        of = eye, height_sd_m, claim, scene.edge
        self.scout = Solver(scouting, config.rough, *of)
        self.rough = Solver(query, config.rough, *of)
        self.fine = Solver(query, config.fine, *of)
        self._renderings = self._seen_times = 0
        rounds = config.rounds + config.restart_rounds + config.final_rounds
        self._rounds = rounds + (config.shortlist > config.particles)

    def run(self, hypotheses: Hypotheses) -> Poses:
        """See `refine`."""
        config = self._config
        best = np.argsort(hypotheses.score, kind="stable")[: config.shortlist]
        taken = hypotheses[best]
        if len(taken) > config.particles:
            taken = self._scouted(taken)
        particles = self.started(self.rough, taken)
        for _ in range(config.rounds - 1):
            kept = max(config.keep_least, int(np.ceil(config.keep_share * len(particles))))
            particles = self._moved(self.rough, self._left(particles, kept))
        if config.restarts and config.restart_rounds:
            particles = Particles.concatenate([particles, self._restarted(particles)])
        particles = self._finalists(particles)
        if config.final_rounds:
            particles = self.weighed_anew(particles)
        for _ in range(config.final_rounds):
            particles = self._moved(self.fine, particles)
        return self.poses(self._finalists(particles))

    def _scouted(self, hypotheses: Hypotheses) -> Hypotheses:
        """Return the hypotheses that one rendering each, coarsely compared, speaks for."""
        seen = self.started(self.scout, hypotheses).best(self._config.particles)
        return self.hypotheses(seen, self.scout)

    def started(self, solver: Solver, hypotheses: Hypotheses) -> Particles:
        """Return particles where hypotheses stand, the attitude solved from theirs."""
        return self.arrived(
            solver, hypotheses.easting_m, hypotheses.northing_m, solver.start(hypotheses)
        )

    def weighed_anew(self, particles: Particles) -> Particles:
        """Judge by correlated errors, until the noise has settled: costs must be comparable."""
        fit = particles.fit
        for _ in range(_SETTLING):
            fit = self.fine.improve(particles.curves, fit, np.zeros(len(particles)))
        step_m = np.full(len(particles), self._config.first_step_m)
        return replace(particles, fit=fit, step_m=step_m)

    def _moved(self, solver: Solver, particles: Particles) -> Particles:
        """Take one step; keep it where the rendering from the new place fits better."""
        solved = solver.improve(particles.curves, particles.fit, particles.step_m)
        new = self.stepped(solver, particles, solved.state, solved)
        return self.kept(particles, new, new.fit.cost < particles.fit.cost)

    def stepped(
        self, solver: Solver, particles: Particles, step: Float64Array, fit: Fit
    ) -> Particles:
        """Return particles moved by steps (M, 2 or more), east and north, that are not too long."""
        length_m = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)
        east_m, north_m = step[:, :2].T * np.minimum(1.0, 2.0 * particles.step_m / length_m)
        return self.arrived(
            solver, particles.easting_m + east_m, particles.northing_m + north_m, fit
        )

    def kept(self, old: Particles, new: Particles, better: BoolArray) -> Particles:
        """Return what is new where it is better, the next step longer there and else shorter."""
        step_m = old.step_m * np.where(better, _LONGER, _SHORTER)
        step_m = np.minimum(step_m, self._config.longest_step_m)
        return replace(old.replaced(better, new), step_m=step_m)

    def around(self, particles: Particles) -> Particles:
        """Return particles that start from a ring around each place."""
        ring = self._config.restart_m * np.exp(0.25j * np.pi * np.arange(8))
        offset = np.tile(ring, len(particles))
        near = particles[np.repeat(np.arange(len(particles)), len(ring))]
        easting_m, northing_m = near.easting_m + offset.real, near.northing_m + offset.imag
        return self.arrived(self.rough, easting_m, northing_m, near.fit)

    def _restarted(self, particles: Particles) -> Particles:
        """Return where particles around the best places, that stand apart, have moved to."""
        standing = self.hypotheses(particles, self.rough)
        config = self._config
        around = self.around(
            particles[
                standing.suppress_non_maxima(config.restarts, config.separation_m, _SAME_VIEW_DEG)
            ]
        )
        for _ in range(config.restart_rounds - 1):
            around = self._moved(self.rough, around.best(len(around)))
        return around

    def arrived(
        self, solver: Solver, easting_m: Float64Array, northing_m: Float64Array, fit: Fit
    ) -> Particles:
        """Return particles at places, the attitude solved there; without a fit off the map."""
        state = fit.state.copy()
        state[:, :EYE_HEIGHT] = 0.0
        fit = replace(fit, state=state)
        bins = self._config.scout_bins if solver is self.scout else self._config.bins
        curves = self._seen(easting_m, northing_m, state, solver.fov_deg(state), bins)
        unjudged = bool(np.isinf(fit.cost).all())
        still = np.zeros(len(state))
        fit = solver.settle(curves, fit) if unjudged else solver.improve(curves, fit, still)
        step_m = np.full(len(state), self._config.first_step_m)
        return Particles(easting_m, northing_m, step_m, curves, fit)

    def _seen(
        self,
        easting_m: Float64Array,
        northing_m: Float64Array,
        state: Float64Array,
        fov_deg: Float64Array,
        bins: int,
    ) -> Curves:
        """Render what M eyes, each as high above the ground as its state says, see of the query."""
        tell("refining", min(1.0, self._seen_times / self._rounds))
        self._seen_times += 1
        ground_m, height_m = self._scene.ground_m(easting_m, northing_m), state[:, EYE_HEIGHT]
        turn = np.degrees(state[:, HEADING])[:, np.newaxis] - 90.0 * np.arange(4)
        off = np.abs(in_turn(turn))
        wanted = off < 45.0 + 0.5 * fov_deg[:, np.newaxis] + _SECTOR_MARGIN_DEG
        row, heading = np.nonzero(wanted & np.isfinite(ground_m)[:, np.newaxis])
        eyes = Viewpoints(
            easting_m=easting_m[row],
            northing_m=northing_m[row],
            eye_elevation_m=ground_m[row] + height_m[row],
        )
        self._renderings += len(row)
        along = heading.astype(np.uint8)
        views = self._scene.render(eyes, along)
        panoramas = Panoramas.from_views(views, row, len(easting_m), bins)
        over = self._scene.render_surface(eyes, along)
        surface = over if over is None else Panoramas.from_views(over, row, len(easting_m), bins)
        reach_m = self._config.slope_reach_m
        slope = ground_slope(self._scene.ground_m, easting_m, northing_m, reach_m)
        # Who stands off the map fits nowhere, whatever the ground is.
        ground_m = np.nan_to_num(ground_m)
        place_m = easting_m + 1j * northing_m
        return Curves.of(panoramas, place_m, ground_m, slope, height_m, surface)

    def _left(self, particles: Particles, count: int) -> Particles:
        """Return the best, and the rivals of the very best where they are not among them."""
        ordered = particles.best(len(particles))
        chosen = np.arange(min(count, len(ordered)))
        place = ordered.easting_m + 1j * ordered.northing_m
        for least_m in (self._config.elsewhere_m, self._config.far_m):
            elsewhere = np.flatnonzero(np.abs(place - place[:1]) > least_m)
            chosen = np.union1d(chosen, elsewhere[: self._config.rivals])
        return ordered[chosen]

    def _finalists(self, particles: Particles) -> Particles:
        """Return the best that stand apart or look elsewhere, and rivals that do, best first."""
        standing, config = self.hypotheses(particles, self.rough), self._config
        return particles[best_and_rivals(standing, config.finalists, config, _SAME_VIEW_DEG)]

    def hypotheses(self, particles: Particles, solver: Solver) -> Hypotheses:
        """Return where particles stand and look; the scores are their costs."""
        easting_m, northing_m = particles.easting_m, particles.northing_m
        eye_m = self._scene.ground_m(easting_m, northing_m) + particles.fit.state[:, EYE_HEIGHT]
        none = np.zeros(len(particles))
        places = Hypotheses(easting_m, northing_m, eye_m, *[none] * 6)
        return solver.posed(places, particles.fit)

    def poses(self, particles: Particles) -> Poses:
        """Return particles that are refined to the end, with what is to be said of them."""
        solver = self.fine if self._config.final_rounds else self.rough
        linear, judged = solver.judged(particles.curves, particles.fit)
        covariance = solver.covariance(linear, judged)
        trust = solver.query.weight
        squares = (trust * judged.odds * np.nan_to_num(linear.residual_rad) ** 2).sum(axis=1)
        shown = np.maximum((trust * judged.odds).sum(axis=1), 1e-9)
        hypotheses = self.hypotheses(particles, solver)
        return Poses(
            hypotheses,
            self.spread(hypotheses, covariance[:, :EYE_HEIGHT, :EYE_HEIGHT]),
            np.degrees(np.sqrt(squares / shown)),
            shown / trust.sum(),
            judged.effective_columns,
            np.array(solver.noise.height_m)[particles.fit.height],
            np.asarray((solver.beyond_rad(linear) > 0.0) @ trust / trust.sum()),
            hypotheses.lead(self._config.elsewhere_m),
            hypotheses.lead(self._config.far_m),
            self._renderings,
        )

    def spread(self, hypotheses: Hypotheses, covariance_m2: Float64Array) -> Float64Array:
        """Return (M, 2, 2): mean squares about each pose, of all that are the same answer."""
        place = np.stack([hypotheses.easting_m, hypotheses.northing_m], axis=1)
        apart = place[:, np.newaxis] - place
        near = (apart**2).sum(axis=-1) <= self._config.elsewhere_m**2
        better = hypotheses.score[:, np.newaxis] - hypotheses.score
        odds = near * np.exp(np.minimum(better / self._config.temperature, _GREATEST_LOG_ODDS))
        share = odds / odds.sum(axis=1, keepdims=True)
        squares = covariance_m2 + apart[..., np.newaxis] * apart[..., np.newaxis, :]
        return np.asarray((share[..., np.newaxis, np.newaxis] * squares).sum(axis=1))


def best_and_rivals(
    standing: Hypotheses, count: int, config: RefineConfig, turn_deg: float = 360.0
) -> IntArray:
    """Return the indices of the best that stand apart and of the best's rivals, best first."""
    apart = config.separation_m, turn_deg
    chosen = standing.suppress_non_maxima(count, *apart)
    apart_m = standing.apart_m()[chosen[:1]]
    for least_m in (config.elsewhere_m, config.far_m):
        elsewhere = np.flatnonzero((apart_m > least_m).any(axis=0))
        if config.rivals and len(elsewhere):
            rivals = standing[elsewhere].suppress_non_maxima(config.rivals, *apart)
            chosen = np.union1d(chosen, elsewhere[rivals])
    return chosen[np.argsort(standing.score[chosen], kind="stable")]
