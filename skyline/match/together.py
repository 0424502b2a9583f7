r"""Joint refinement: several queries of one eye move together to where all renderings fit.

Each query has its own attitude and field of view; the eye is one. A round renders what each query
sees from each place, lets each solve its own step (`skyline.match.solver`) and moves the eye by
the mean of the steps, each weighed by how precisely its query knows it. That is the Gauss-Newton
step of all unknowns together. A place costs

.. math::

    -T \sum_q \log(e^{-(c_q - b_q) / T} + e^{-L})

with c_q what query q costs there, b_q the least it costs anywhere and T what makes differences of
costs log odds. The second term is that the query was taken elsewhere: one that does not belong to
the others costs at most T L wherever they are put.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skyline.arrays import BoolArray, Float64Array
from skyline.match.hypotheses import Hypotheses
from skyline.match.match_config import RefineConfig
from skyline.match.pose import Particles, Poses, Refinement, best_and_rivals
from skyline.match.solver import EYE_HEIGHT

_ELSEWHERE = 10.0
"""L: one photo in twenty was taken elsewhere, and there are a thousand places to choose from."""
_KEPT_SHARE, _KEPT_LEAST = 0.5, 8
"""What part is kept from one round to the next: several queries tell right from wrong at once."""
_LOOK_STEP_DEG = 6.0
"""Headings that are tried where nothing says which way a query looks."""
_MOVES = slice(EYE_HEIGHT + 1)
_LEAST_SHARE = 1e-6
"""Of a query where it does not fit, so that there is a mean where none does."""
_GREATEST_LOG_ODDS = 50.0


class JointRefinement:
    """The refinement of several queries of one eye.

    There is one refinement for each query; the config is theirs, but for the eye's height.
    """

    def __init__(self, refinements: Sequence[Refinement], config: RefineConfig) -> None:
        self._each = refinements
        self._config = config
        self._solvers = [one.rough for one in refinements]
        self._least = np.full(len(refinements), np.inf)

    def run(
        self, found: Sequence[Hypotheses], alone: Sequence[Hypotheses]
    ) -> tuple[tuple[Poses, ...], BoolArray]:
        """Return where the queries fit together: M places, best first, and N queries there.

        ``found`` is of each query, of the same places in the same order, best first; ``alone`` is
        the best pose that each was refined to by itself, if any.

        Returns
        -------
        poses : tuple of Poses
            Of each query, M; they differ in the camera alone, and their scores are what the places
            cost. Margins and covariances are the joint ones for one query in the mean: queries of
            one place share the terrain model's errors, and those that look the same way share all,
            so that they are not summed.
        agrees : (N, M) bool
            Whether each query is likelier to be of the place than of anywhere else.
        """
        config = self._config
        now = [
            one.started(one.rough, places[: config.particles])
            for one, places in zip(self._each, found, strict=True)
        ]
        for _ in range(config.rounds - 1):
            kept = max(_KEPT_LEAST, int(_KEPT_SHARE * len(now[0])))
            now = self._moved(self._kept(now, kept))
        if config.restarts and config.restart_rounds:
            now = self._joined(now, self._restarted(now))
        now = self._kept(now, config.finalists)
        now = self._joined(now, self._looked_round([now[0][:1], *alone]))
        self._solvers = [one.fine for one in self._each]
        self._least = np.array([one.score.min(initial=np.inf) for one in alone])
        now = [one.weighed_anew(some) for one, some in zip(self._each, now, strict=True)]
        for _ in range(config.final_rounds):
            now = self._moved(now)
        return self._poses(self._kept(now, config.finalists))

    def _moved(self, now: Sequence[Particles]) -> list[Particles]:
        """Take one step together; keep it where the renderings from there fit better."""
        solved = [
            replace(some, fit=solver.improve(some.curves, some.fit, some.step_m))
            for solver, some in zip(self._solvers, now, strict=True)
        ]
        precision = self._precision(solved, self._share(self._off(now)))
        steps = np.stack([some.fit.state[:, _MOVES] for some in solved])[..., np.newaxis]
        step = np.linalg.solve(precision.sum(axis=0), (precision @ steps).sum(axis=0))[..., 0]
        new = [
            one.stepped(solver, some, step, solver.at_height(some.fit, step[:, EYE_HEIGHT]))
            for one, solver, some in zip(self._each, self._solvers, solved, strict=True)
        ]
        before, after = np.split(self._cost(self._off(self._joined(now, new))), 2)
        return [
            one.kept(old, some, after < before)
            for one, old, some in zip(self._each, now, new, strict=True)
        ]

    def _restarted(self, now: Sequence[Particles]) -> list[Particles]:
        """Return what becomes of a ring around each of the best places."""
        best = self._kept(now, self._config.restarts)
        around = [one.around(some) for one, some in zip(self._each, best, strict=True)]
        for _ in range(self._config.restart_rounds - 1):
            around = self._moved(around)
        return around

    def _looked_round(self, places: Sequence[Particles | Hypotheses]) -> list[Particles]:
        """Return how queries fit best at places when all headings are tried."""
        east_m = np.concatenate([some.easting_m for some in places])
        north_m = np.concatenate([some.northing_m for some in places])
        turn_deg = np.arange(0.0, 360.0, _LOOK_STEP_DEG)
        row = np.repeat(np.arange(len(east_m)), len(turn_deg))
        none, heading_deg = np.zeros(len(row)), np.tile(turn_deg, len(east_m))
        looked = []
        for one in self._each:
            fov_deg = none + one.scout.query.fov_deg
            every = Hypotheses(
                east_m[row], north_m[row], none, heading_deg, none, none, fov_deg, none, none
            )
            seen = one.started(one.scout, every)
            cost = seen.fit.cost.reshape(len(east_m), len(turn_deg))
            best = seen[np.arange(len(east_m)) * len(turn_deg) + cost.argmin(axis=1)]
            looked.append(one.started(one.rough, one.hypotheses(best, one.scout)))
        return looked

    def _joined(self, *parts: Sequence[Particles]) -> list[Particles]:
        return [Particles.concatenate(list(some)) for some in zip(*parts, strict=True)]

    def _kept(self, now: Sequence[Particles], count: int) -> list[Particles]:
        """Return the best places that stand apart, and rivals of the best, best first."""
        standing = self._each[0].hypotheses(now[0], self._solvers[0])
        standing = replace(standing, score=self._cost(self._off(now)))
        chosen = best_and_rivals(standing, count, self._config)
        return [some[chosen] for some in now]

    def _off(self, now: Sequence[Particles]) -> Float64Array:
        """Return what queries cost (N, M) above the least they cost anywhere."""
        cost = np.stack([some.fit.cost for some in now])
        least = np.minimum(self._least, cost.min(axis=1, initial=np.inf))
        return cost - np.where(np.isfinite(least), least, 0.0)[:, np.newaxis]

    def _cost(self, off: Float64Array) -> Float64Array:
        """Return what places cost (M,); infinite where no query fits."""
        scale = self._config.temperature
        cost = -scale * np.logaddexp(-off / scale, -_ELSEWHERE).sum(axis=0)
        return np.where(np.isinf(off).all(axis=0), np.inf, cost)

    def _share(self, off: Float64Array) -> Float64Array:
        """Return how likely queries are of places (N, M) rather than of elsewhere."""
        odds = _ELSEWHERE - off / self._config.temperature
        return 1.0 / (1.0 + np.exp(-np.clip(odds, -_GREATEST_LOG_ODDS, _GREATEST_LOG_ODDS)))

    def _precision(self, now: Sequence[Particles], share: Float64Array) -> Float64Array:
        """Return how precisely queries know the eye (N, M, 3, 3), by how likely they are of it."""
        covariance = np.stack(
            [
                solver.covariance(*solver.judged(some.curves, some.fit))[:, _MOVES, _MOVES]
                for solver, some in zip(self._solvers, now, strict=True)
            ]
        )
        share = np.maximum(share, _LEAST_SHARE)[..., np.newaxis, np.newaxis]
        return np.asarray(np.linalg.inv(covariance) * share)

    def _poses(self, now: Sequence[Particles]) -> tuple[tuple[Poses, ...], BoolArray]:
        off = self._off(now)
        cost, share = self._cost(off), self._share(off)
        agrees = share >= 0.5
        mean = self._precision(now, share).sum(axis=0) / share.sum(axis=0)[:, None, None]
        covariance_m2 = np.linalg.inv(mean)[:, :EYE_HEIGHT, :EYE_HEIGHT]
        covariance_m2 = 0.5 * (covariance_m2 + covariance_m2.swapaxes(1, 2))
        poses = [one.poses(some) for one, some in zip(self._each, now, strict=True)]
        standing = replace(poses[0].hypotheses, score=cost)
        # Margins and covariances are those of one query in the mean, and so are these odds.
        in_mean = replace(standing, score=cost / len(poses))
        covariance_m2 = self._each[0].spread(in_mean, covariance_m2)
        margin, far_margin = (
            standing.lead(least_m) / np.maximum(agrees.sum(axis=0), 1)
            for least_m in (self._config.elsewhere_m, self._config.far_m)
        )
        joint = {"covariance_m2": covariance_m2, "margin": margin, "far_margin": far_margin}
        scored = (replace(one, hypotheses=replace(one.hypotheses, score=cost)) for one in poses)
        return tuple(replace(one, **joint) for one in scored), agrees
