"""Refinement: hypotheses move to where a rendering fits the query, by rendering again.

Each round renders every hypothesis that is left in one call. A rendering carries the distance of
every skyline point, so it also tells how the skyline changes as the eye moves
(`skyline.matching.solver`), and position, heading, pitch, roll and field of view are solved
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

from skyline.arrays import Float64Array, IntArray
from skyline.matching.claim import Claim, EyeHeight
from skyline.matching.hypotheses import Hypotheses
from skyline.matching.match_config import RefineConfig
from skyline.matching.profiles import Panoramas
from skyline.matching.progress import tell
from skyline.matching.query import QueryRays, thinned
from skyline.matching.solver import EYE_HEIGHT, HEADING, Curves, Fit, Solver
from skyline.rows import Rows
from skyline.terrain.edge import DataEdge
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

_SECTOR_MARGIN_DEG = 3.0
"""A view is rendered where the query comes this near to it."""
_SAME_VIEW_DEG = 30.0
"""Two poses at one place that look within this angle of one another are one."""
LONGER, SHORTER = 1.5, 0.4
"""What a step is multiplied by when the last one was kept, and when it was not."""
_SETTLING = 3
_GREATEST_LOG_ODDS = 50.0


class Scene(Protocol):
    """The terrain as refinement needs it."""

    @property
    def edge(self) -> DataEdge | None:
        """Where its data end; None where nothing is taken to lie beyond."""
        ...

    @property
    def height_sd_m(self) -> float:
        """Deviation of the terrain model's heights to be expected."""
        ...

    def render(self, viewpoints: Viewpoints, headings: NDArray[np.uint8]) -> Views:
        """Render one view an eye, each along its heading, in order."""
        ...

    def render_surface(self, viewpoints: Viewpoints, headings: NDArray[np.uint8]) -> Views | None:
        """Render likewise the surface of what may stand on the terrain; None where unknown."""
        ...

    def ground_m(self, easting_m: Float64Array, northing_m: Float64Array) -> Float64Array:
        """Return the terrain's height, (N,) for (N,); NaN off the map and over holes."""
        ...


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

    def __len__(self) -> int:
        return len(self.easting_m)

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
            particles = self._moved(self.rough, self._kept(particles, kept))
        if config.restarts and config.restart_rounds:
            restarted = self._restarted(self._apart(particles, config.restarts))
            particles = Particles.concatenate([particles, restarted])
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
        return replace(particles, fit=fit, step_m=self._first_steps(len(particles)))

    def _moved(self, solver: Solver, particles: Particles) -> Particles:
        """Take one step; keep it where the rendering from the new place fits better."""
        solved = solver.improve(particles.curves, particles.fit, particles.step_m)
        step = solved.state[:, :EYE_HEIGHT]
        length = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)
        step = step * np.minimum(1.0, 2.0 * particles.step_m / length)[:, np.newaxis]
        new = self.arrived(
            solver, particles.easting_m + step[:, 0], particles.northing_m + step[:, 1], solved
        )
        better = new.fit.cost < particles.fit.cost
        step_m = particles.step_m * np.where(better, LONGER, SHORTER)
        return replace(
            particles.replaced(better, new), step_m=np.minimum(step_m, self._config.longest_step_m)
        )

    def _restarted(self, particles: Particles) -> Particles:
        """Return particles that start from a ring around each place."""
        ring = self._config.restart_m * np.exp(0.25j * np.pi * np.arange(8))
        around = particles[np.repeat(np.arange(len(particles)), len(ring))]
        offset = np.tile(ring, len(particles))
        around = self.arrived(
            self.rough,
            around.easting_m + offset.real,
            around.northing_m + offset.imag,
            around.fit,
        )
        for _ in range(self._config.restart_rounds - 1):
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
        return Particles(easting_m, northing_m, self._first_steps(len(state)), curves, fit)

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
        off = np.abs((turn + 180.0) % 360.0 - 180.0)
        wanted = off < 45.0 + 0.5 * fov_deg[:, np.newaxis] + _SECTOR_MARGIN_DEG
        row, heading = np.nonzero(wanted & np.isfinite(ground_m)[:, np.newaxis])
        eyes = Viewpoints(easting_m[row], northing_m[row], ground_m[row] + height_m[row])
        self._renderings += len(row)
        along = heading.astype(np.uint8)
        views = self._scene.render(eyes, along)
        panoramas = Panoramas.from_views(views, row, len(easting_m), bins)
        over = self._scene.render_surface(eyes, along)
        surface = over if over is None else Panoramas.from_views(over, row, len(easting_m), bins)
        slope = self._slope(easting_m, northing_m, ground_m)
        # Who stands off the map fits nowhere, whatever the ground is.
        ground_m = np.nan_to_num(ground_m)
        place_m = easting_m + 1j * northing_m
        return Curves.of(panoramas, place_m, ground_m, slope, height_m, surface)

    def _slope(
        self, easting_m: Float64Array, northing_m: Float64Array, ground_m: Float64Array
    ) -> Float64Array:
        """Return the rise of the ground (M, 2) a metre east and north; 0 beside the unknown."""
        reach_m = self._config.slope_reach_m
        place = easting_m + 1j * northing_m
        around = np.concatenate([place + reach_m * turn for turn in (1.0, -1.0, 1.0j, -1.0j)])
        east, west, north, south = self._scene.ground_m(around.real, around.imag).reshape(4, -1)
        slope = np.stack([east - west, north - south], axis=1) / (2.0 * reach_m)
        return np.nan_to_num(slope)

    def _first_steps(self, count: int) -> Float64Array:
        return np.full(count, self._config.first_step_m)

    def _apart(self, particles: Particles, count: int) -> Particles:
        """Return the best that stand apart or look elsewhere, best first."""
        standing = self.hypotheses(particles, self.rough)
        return particles[
            standing.suppress_non_maxima(count, self._config.separation_m, _SAME_VIEW_DEG)
        ]

    def _kept(self, particles: Particles, count: int) -> Particles:
        """Return the best, and the rivals of the very best where they are not among them."""
        ordered = particles.best(len(particles))
        chosen = np.arange(min(count, len(ordered)))
        for elsewhere in self._elsewhere(ordered):
            chosen = np.union1d(chosen, elsewhere[: self._config.rivals])
        return ordered[chosen]

    def _finalists(self, particles: Particles) -> Particles:
        """Return the best that stand apart, and rivals that do, best first."""
        ordered = particles.best(len(particles))
        standing = self.hypotheses(ordered, self.rough)
        apart = self._config.separation_m, _SAME_VIEW_DEG
        chosen = standing.suppress_non_maxima(self._config.finalists, *apart)
        for elsewhere in self._elsewhere(ordered):
            if self._config.rivals and len(elsewhere):
                some = standing[elsewhere].suppress_non_maxima(self._config.rivals, *apart)
                chosen = np.union1d(chosen, elsewhere[some])
        return ordered[chosen]

    def _elsewhere(self, ordered: Particles) -> tuple[IntArray, IntArray]:
        """Return the indices of those elsewhere than the first one, and of those far off."""
        place = ordered.easting_m + 1j * ordered.northing_m
        apart_m = np.abs(place - place[:1])
        config = self._config
        return np.flatnonzero(apart_m > config.elsewhere_m), np.flatnonzero(apart_m > config.far_m)

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
            _beyond_share(solver.beyond_rad(linear), trust, len(hypotheses)),
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


def _beyond_share(beyond_rad: Float64Array | None, trust: Float64Array, count: int) -> Float64Array:
    """Return the share (M,) of the trust in columns that what lies past the edge may rise in."""
    if beyond_rad is None:
        return np.zeros(count)
    return np.asarray((beyond_rad > 0.0) @ trust / trust.sum())
