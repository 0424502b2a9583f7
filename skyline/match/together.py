"""Joint refinement of several photos of one eye."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import BoolArray, Complex128Array, Float64Array
from skyline.match.curves import EYE_HEIGHT
from skyline.match.likelihood import GREATEST_LOG_ODDS
from skyline.match.refine import MOVES, Particles, Refinement, best_and_rivals, spread_m2
from skyline.match.solver import TEMPERATURE
from skyline.pose.pose import RIGHT_WITHIN_M
from skyline.pose.poses import Poses

_EYE = slice(EYE_HEIGHT + 1)
"""Columns of a state that all photos of one eye share."""


@dataclass(frozen=True, slots=True)
class JointSearch:
    """Assumptions of a joint refinement, and the places that it follows."""

    stranger: float = 10.0
    """L, the log odds that a photo was taken at the place where it fits best: one photo in twenty
    was taken somewhere else, at one of a thousand places, and log(20 * 1000) is about 10."""
    kept_share: float = 0.5
    """Share of places kept from one round to the next: several photos separate right places from
    wrong ones at once."""
    kept_least: int = 8
    """Least number of places kept."""
    heading_step_deg: float = 6.0
    """Step of the headings that are tried for a photo of unknown heading."""
    least_share: float = 1e-6
    """Least weight of a photo at a place. It is far below the weight of a photo that fits, and so
    large that the weighted mean of matrices is exact."""


_SEARCH = JointSearch()


class JointRefinement:
    r"""The joint refinement of N photos that were taken from one eye.

    Each photo has its own attitude and field of view, and all share the eye. A round renders the
    view of each photo from each place, lets each photo solve its own step, and moves the eye by the
    mean of these steps, weighted by their precisions. This is the Gauss-Newton step of all unknowns
    together. The cost of a place is

    .. math::

        -T \sum_q \log(e^{-(c_q - b_q) / T} + e^{-L})

    with c_q the cost of photo q there, b_q its least cost anywhere, and T the factor between costs
    and log odds. The second term allows for q having been taken somewhere else: a photo that does
    not belong to the others costs at most T L at any place.
    """

    def __init__(self, refinements: Sequence[Refinement]) -> None:
        self._solos = refinements
        self._effort = refinements[0].effort
        self._solvers = [solo.follow for solo in refinements]
        self._least = np.full(len(refinements), np.inf)

    def run(
        self, found: Sequence[Poses], alone: Sequence[Poses]
    ) -> tuple[tuple[Poses, ...], BoolArray]:
        """Return the M places where the N photos fit together, best first.

        The second value, (N, M) bool, says which photos agree with which places: a photo agrees
        with a place if it was more likely taken there than elsewhere.

        ``found`` holds each photo's poses; all photos have the same places in the same order, best
        first. ``alone`` holds the best pose from each photo's own refinement, if there is one. The
        returned poses of each photo are at the same places; their costs are the costs of the
        places. Margins and covariances are joint ones, with the information of one average photo,
        not the sum: photos of one place share the terrain model's errors.
        """
        effort = self._effort
        particles = [
            solo.started(solo.rough, places[: effort.particles])
            for solo, places in zip(self._solos, found, strict=True)
        ]
        for _ in range(effort.rounds - 1):
            kept = max(_SEARCH.kept_least, int(_SEARCH.kept_share * len(particles[0])))
            particles = self._moved(self._kept(particles, kept))
        particles = self._kept(_joined(particles, self._restarted(particles)), effort.finalists)
        own_m = [poses.position_m for poses in alone]
        best_m = np.concatenate([particles[0].curves.position_m[:1], *own_m])
        particles = _joined(particles, [_at_best_headings(solo, best_m) for solo in self._solos])
        # The last rounds fit as the photos' own refinements did, so costs compare with theirs.
        self._solvers = [solo.fine for solo in self._solos]
        self._least = np.array([poses.cost.min(initial=np.inf) for poses in alone])
        particles = [solo.reweighted(own) for solo, own in zip(self._solos, particles, strict=True)]
        for _ in range(effort.final_rounds):
            particles = self._moved(particles)
        return self._poses(self._kept(particles, effort.finalists))

    def _restarted(self, particles: Sequence[Particles]) -> list[Particles]:
        """Return the particles that started around the best distinct places."""
        best = self._kept(particles, self._effort.restarts)
        around = [solo.around(own) for solo, own in zip(self._solos, best, strict=True)]
        for _ in range(MOVES.restart_rounds - 1):
            around = self._moved(around)
        return around

    def _moved(self, particles: Sequence[Particles]) -> list[Particles]:
        """Return particles after one common step, where new renderings fit better."""
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
        """Return the best distinct places, best first.

        The rivals of the best one are among them.
        """
        places = replace(self._solos[0].poses(particles[0]), cost=_cost(self._off(particles)))
        chosen = best_and_rivals(places, count)
        return [own[chosen] for own in particles]

    def _off(self, particles: Sequence[Particles]) -> Float64Array:
        """Return the costs (N, M) above each photo's least cost anywhere."""
        cost = np.stack([own.fit.cost for own in particles])
        least = np.minimum(self._least, cost.min(axis=1, initial=np.inf))
        return cost - np.where(np.isfinite(least), least, 0.0)[:, np.newaxis]

    def _precision(self, particles: Sequence[Particles], share: Float64Array) -> Float64Array:
        """Return each photo's precision of the eye, (N, M, 3, 3).

        Each counts with its ``share``.
        """
        covariance = np.stack(
            [
                solver.covariance(own.fit, *solver.evaluate(own.curves, own.fit))[:, _EYE, _EYE]
                for solver, own in zip(self._solvers, particles, strict=True)
            ]
        )
        return np.asarray(np.linalg.inv(covariance) * share[..., np.newaxis, np.newaxis])

    def _poses(self, particles: Sequence[Particles]) -> tuple[tuple[Poses, ...], BoolArray]:
        """Return each photo's poses at the places; see `run`.

        The second value says which photos agree.
        """
        off = self._off(particles)
        cost = _cost(off)
        share = _share(off)
        agrees = share >= 0.5
        whole = share.sum(axis=0)[:, np.newaxis, np.newaxis]
        mean = self._precision(particles, share).sum(axis=0) / whole
        covariance_m2 = TEMPERATURE * np.linalg.inv(mean)[:, :EYE_HEIGHT, :EYE_HEIGHT]
        covariance_m2 = 0.5 * (covariance_m2 + covariance_m2.swapaxes(1, 2))
        poses = [solo.with_figures(own) for solo, own in zip(self._solos, particles, strict=True)]
        places = replace(poses[0], cost=cost)
        # Margins and covariances are of one average photo, and so are these odds.
        covariance_m2 = spread_m2(replace(places, cost=cost / len(poses)), covariance_m2)
        margin = places.rival_margin(RIGHT_WITHIN_M) / np.maximum(agrees.sum(axis=0), 1)
        joint = {"covariance_m2": covariance_m2, "margin": margin}
        together = tuple(
            replace(own, cost=cost, fits=replace(own.figures(), **joint)) for own in poses
        )
        return together, agrees


def _at_best_headings(solo: Refinement, position_m: Complex128Array) -> Particles:
    """Return a photo's best particle over all headings, by place."""
    tried_deg = np.arange(0.0, 360.0, _SEARCH.heading_step_deg)
    at_m = np.repeat(position_m, len(tried_deg))
    none = np.zeros(len(at_m))
    every = Poses(
        easting_m=at_m.real,
        northing_m=at_m.imag,
        eye_elevation_m=none,
        grid_heading_deg=np.tile(tried_deg, len(position_m)),
        pitch_deg=none,
        roll_deg=none,
        fov_deg=none + solo.scout.rays.fov_deg,
        cost=none,
    )
    seen = solo.started(solo.scout, every)
    cost = seen.fit.cost.reshape(len(position_m), len(tried_deg))
    best = seen[np.arange(len(position_m)) * len(tried_deg) + cost.argmin(axis=1)]
    return solo.started(solo.rough, solo.poses(best))


def _joined(*parts: Sequence[Particles]) -> list[Particles]:
    """Return the particles of each photo in all parts."""
    return [Particles.concatenate(list(own)) for own in zip(*parts, strict=True)]


def _cost(off: Float64Array) -> Float64Array:
    """Return the costs of places (M,) by `JointRefinement._off`.

    They are infinite where no photo fits.
    """
    cost = -TEMPERATURE * np.logaddexp(-off / TEMPERATURE, -_SEARCH.stranger).sum(axis=0)
    return np.where(np.isinf(off).all(axis=0), np.inf, cost)


def _share(off: Float64Array) -> Float64Array:
    """Return the probabilities (N, M) that photos were taken at places.

    None is 0: means weighted by them exist even where no photo fits.
    """
    odds = _SEARCH.stranger - off / TEMPERATURE
    share = 1.0 / (1.0 + np.exp(-np.clip(odds, -GREATEST_LOG_ODDS, GREATEST_LOG_ODDS)))
    return np.maximum(share, _SEARCH.least_share)
