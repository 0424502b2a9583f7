r"""Several queries of one eye, matched together.

Each query has its own attitude and field of view, and all share the eye. A round of refinement
renders the view of each query from each place, lets each query solve its own step, and moves the
eye by the mean of these steps, weighted by their precisions. That is the Gauss-Newton step of all
unknowns together. The cost of a place is

.. math::

    -T \sum_q \log(e^{-(c_q - b_q) / T} + e^{-L})

with c_q the cost of query q there, b_q the least cost of q anywhere, and T the factor between costs
and log odds. The second term is the possibility that q was taken somewhere else: a query that does
not belong to the others costs at most T L at any place.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skyline.arrays import BoolArray, Complex128Array, Float64Array
from skyline.match import confidence
from skyline.match.candidate import DISTANCES_M, Candidate, Hypotheses, RefinedPoses, candidates_of
from skyline.match.full import SEPARATION_M, FullMatcher, one_blas_thread
from skyline.match.prior import Prior
from skyline.match.query_rays import QueryRays
from skyline.match.refine import (
    GREATEST_LOG_ODDS,
    RESTART_ROUNDS,
    WHOLE,
    Particles,
    Refinement,
    best_and_rivals,
    spread,
)
from skyline.match.solver import EYE_HEIGHT, TEMPERATURE

_STRANGER = 10.0
"""L: one photo in twenty was taken somewhere else, at one of a thousand places: log(20 * 1000) is
about 10."""
_JOINT_SHARE, _JOINT_LEAST = 0.5, 8
"""Share of places kept from one joint round to the next, and their least number: several queries
separate right places from wrong ones at once."""
_HEADING_STEP_DEG = 6.0
"""Step of the headings that are tried for a query of unknown heading."""
_EYE = slice(EYE_HEIGHT + 1)
"""Columns of a state that all queries of one eye share."""
_LEAST_SHARE = 1e-6
"""Least weight of a query, so that the mean of the steps exists where no query fits."""


@one_blas_thread()
def rank_together(
    matcher: FullMatcher, queries: Sequence[tuple[QueryRays, Prior]], top: int
) -> list[tuple[Candidate, ...]]:
    """Return up to ``top`` places of queries of one eye, as each query's candidates there.

    A query that was likely taken at another place has none. A place lies within the narrowings of
    all queries that agree. Raises as `FullMatcher.rank`, and `InputError` without a scene.

    Each query is first matched by itself: its least cost shows whether it was taken there.
    """
    scene = matcher.needed_scene()
    queries = _with_one_noted_place(queries)
    found = [matcher.found(query, prior) for query, prior in queries]
    alone = [places[:0] if poses is None else poses.hypotheses[:1] for places, poses in found]
    refinements = [Refinement(query, scene, WHOLE, prior) for query, prior in queries]
    places = matcher.retriever.shortlist_together(queries, WHOLE.particles)
    joint, agreeing = JointRefinement(refinements).run(places, alone)
    cost = joint[0].hypotheses.score
    for poses, (_, prior), agrees in zip(joint, queries, agreeing, strict=True):
        cost = np.where(prior.allows(poses.hypotheses) | ~agrees, cost, np.inf)
    standing = replace(joint[0].hypotheses, score=cost)
    chosen = standing.suppress_non_maxima(top, SEPARATION_M)
    agrees = np.asarray(agreeing[:, chosen[:1]].any(axis=1))
    # As margins, odds are those of one query in the mean.
    cost_of_one = cost / max(agrees.sum(), 1)
    figures = [
        confidence.refined_figures(
            replace(poses, hypotheses=replace(poses.hypotheses, score=cost_of_one)),
            retrieved,
            query,
        )
        for poses, (query, _), (retrieved, _), belongs in zip(
            joint, queries, found, agrees, strict=True
        )
        if belongs and len(retrieved)
    ]
    near = roughly = np.zeros(len(cost))
    if figures:
        # Queries of one place share the errors of the terrain model there, to an unknown degree:
        # together they count as one query with the mean figures.
        mean = {name: np.mean([one[name] for one in figures], axis=0) for name in figures[0]}
        near, roughly = confidence.shared_probabilities(matcher.models, standing, mean)
    return [
        candidates_of(matcher.frame, poses[chosen], near[chosen], roughly[chosen])
        if belongs
        else ()
        for poses, belongs in zip(joint, agrees.tolist(), strict=True)
    ]


def _with_one_noted_place(
    queries: Sequence[tuple[QueryRays, Prior]],
) -> list[tuple[QueryRays, Prior]]:
    """Return queries with the most precise noted place alone.

    The positions of photos from one phone share their error, so they are not independent.
    """
    noted = [prior.noted for _, prior in queries if prior.noted is not None]
    best = min(noted, key=lambda place: place.sd_m, default=None)
    return [
        (query, prior if prior.noted is best else replace(prior, noted=None))
        for query, prior in queries
    ]


class JointRefinement:
    """The joint refinement of N queries of one eye, each with its own `Refinement`."""

    def __init__(self, refinements: Sequence[Refinement]) -> None:
        self._solos, self._effort = refinements, refinements[0].effort
        self._solvers = [solo.rough for solo in refinements]
        self._least = np.full(len(refinements), np.inf)

    def run(
        self, found: Sequence[Hypotheses], alone: Sequence[Hypotheses]
    ) -> tuple[tuple[RefinedPoses, ...], BoolArray]:
        """Return the M places where the N queries fit together, best first, and which agree there.

        ``found`` holds each query's poses; all queries have the same places in the same order, best
        first. ``alone`` holds the best pose from each query's own refinement, if there is one. The
        returned poses of each query are at the same places; their scores are the costs of the
        places. Margins and covariances are joint ones, with the information of one average query,
        not the sum: queries of one place share the terrain model's errors. A query agrees, (N, M)
        bool, where it was more likely taken than somewhere else.
        """
        effort = self._effort
        particles = [
            solo.started(solo.rough, places[: effort.particles])
            for solo, places in zip(self._solos, found, strict=True)
        ]
        for _ in range(effort.rounds - 1):
            kept = max(_JOINT_LEAST, int(_JOINT_SHARE * len(particles[0])))
            particles = self._moved(self._kept(particles, kept))
        around = self._kept(particles, effort.restarts)
        around = [solo.around(own) for solo, own in zip(self._solos, around, strict=True)]
        for _ in range(RESTART_ROUNDS - 1):
            around = self._moved(around)
        particles = self._kept(_joined(particles, around), effort.finalists)
        own_m = [poses.easting_m + 1j * poses.northing_m for poses in alone]
        best_m = np.concatenate([particles[0].curves.place_m[:1], *own_m])
        particles = _joined(particles, [_at_best_headings(solo, best_m) for solo in self._solos])
        self._solvers = [solo.fine for solo in self._solos]
        self._least = np.array([poses.score.min(initial=np.inf) for poses in alone])
        particles = [solo.reweighted(own) for solo, own in zip(self._solos, particles, strict=True)]
        for _ in range(effort.final_rounds):
            particles = self._moved(particles)
        return self._poses(self._kept(particles, effort.finalists))

    def _moved(self, particles: Sequence[Particles]) -> list[Particles]:
        """Return particles after one common step, where the renderings from there fit better."""
        solved = [
            replace(own, fit=solver.improve(own.curves, own.fit, own.step_m))
            for solver, own in zip(self._solvers, particles, strict=True)
        ]
        precision = self._precision(solved, _share(self._off(particles)))
        steps = np.stack([own.fit.state[:, _EYE] for own in solved])[..., np.newaxis]
        step = np.linalg.solve(precision.sum(axis=0), (precision @ steps).sum(axis=0))[..., 0]
        new = [
            solo.stepped(solver, own, step, solver.at_height(own.fit, step[:, EYE_HEIGHT]))
            for solo, solver, own in zip(self._solos, self._solvers, solved, strict=True)
        ]
        before, after = np.split(_cost(self._off(_joined(particles, new))), 2)
        return [old.kept(own, after < before) for old, own in zip(particles, new, strict=True)]

    def _kept(self, particles: Sequence[Particles], count: int) -> list[Particles]:
        """Return the best distinct places, and rivals of the very best, best first."""
        standing = self._solos[0].hypotheses(particles[0])
        standing = replace(standing, score=_cost(self._off(particles)))
        chosen = best_and_rivals(standing, count)
        return [own[chosen] for own in particles]

    def _off(self, particles: Sequence[Particles]) -> Float64Array:
        """Return the costs of queries (N, M) above the least cost of each anywhere."""
        cost = np.stack([own.fit.cost for own in particles])
        least = np.minimum(self._least, cost.min(axis=1, initial=np.inf))
        return cost - np.where(np.isfinite(least), least, 0.0)[:, np.newaxis]

    def _precision(self, particles: Sequence[Particles], share: Float64Array) -> Float64Array:
        """Return the precisions (N, M, 3, 3) of the eye by each query, times its ``share``."""
        covariance = np.stack(
            [
                solver.covariance(*solver.evaluate(own.curves, own.fit))[:, _EYE, _EYE]
                for solver, own in zip(self._solvers, particles, strict=True)
            ]
        )
        share = np.maximum(share, _LEAST_SHARE)[..., np.newaxis, np.newaxis]
        return np.asarray(np.linalg.inv(covariance) * share)

    def _poses(self, particles: Sequence[Particles]) -> tuple[tuple[RefinedPoses, ...], BoolArray]:
        """Return the poses of each query at the places, and which queries agree; see `run`."""
        off = self._off(particles)
        cost, share = _cost(off), _share(off)
        agrees = share >= 0.5
        mean = self._precision(particles, share).sum(axis=0) / share.sum(axis=0)[:, None, None]
        covariance_m2 = TEMPERATURE * np.linalg.inv(mean)[:, :EYE_HEIGHT, :EYE_HEIGHT]
        covariance_m2 = 0.5 * (covariance_m2 + covariance_m2.swapaxes(1, 2))
        poses = [solo.poses(own) for solo, own in zip(self._solos, particles, strict=True)]
        standing = replace(poses[0].hypotheses, score=cost)
        # Margins and covariances are those of one query in the mean, and so are these odds.
        covariance_m2 = spread(replace(standing, score=cost / len(poses)), covariance_m2)
        margin, far_margin = (
            standing.rival_margin(least_m) / np.maximum(agrees.sum(axis=0), 1)
            for least_m in DISTANCES_M
        )
        joint = {"covariance_m2": covariance_m2, "margin": margin, "far_margin": far_margin}
        each = (replace(own, hypotheses=replace(own.hypotheses, score=cost)) for own in poses)
        return tuple(replace(own, **joint) for own in each), agrees


def _at_best_headings(solo: Refinement, place_m: Complex128Array) -> Particles:
    """Return the best particle of a query at each place, of all headings."""
    turn_deg = np.arange(0.0, 360.0, _HEADING_STEP_DEG)
    at_m = place_m[np.repeat(np.arange(len(place_m)), len(turn_deg))]
    none, heading_deg = np.zeros(len(at_m)), np.tile(turn_deg, len(place_m))
    fov_deg = none + solo.scout.query.fov_deg
    every = Hypotheses(at_m.real, at_m.imag, none, heading_deg, none, none, fov_deg, none, none)
    seen = solo.started(solo.scout, every)
    cost = seen.fit.cost.reshape(len(place_m), len(turn_deg))
    best = seen[np.arange(len(place_m)) * len(turn_deg) + cost.argmin(axis=1)]
    return solo.started(solo.rough, solo.hypotheses(best))


def _joined(*parts: Sequence[Particles]) -> list[Particles]:
    """Return the particles of each query in all parts."""
    return [Particles.concatenate(list(own)) for own in zip(*parts, strict=True)]


def _cost(off: Float64Array) -> Float64Array:
    """Return the costs of places (M,) by `JointRefinement._off`; infinite where no query fits."""
    cost = -TEMPERATURE * np.logaddexp(-off / TEMPERATURE, -_STRANGER).sum(axis=0)
    return np.where(np.isinf(off).all(axis=0), np.inf, cost)


def _share(off: Float64Array) -> Float64Array:
    """Return the probability (N, M) that each query was taken at each place."""
    odds = _STRANGER - off / TEMPERATURE
    return 1.0 / (1.0 + np.exp(-np.clip(odds, -GREATEST_LOG_ODDS, GREATEST_LOG_ODDS)))
