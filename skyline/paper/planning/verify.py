"""Proof by rendering: whether what a plan says is covered truly is."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Int64Array
from skyline.errors import InputError
from skyline.paper.planning.coverage import Coverage
from skyline.paper.planning.plan import Headings, Plan, Render, as_asked, places
from skyline.views import Views

TrueErrors = Callable[[Views, Views], NDArray[np.floating]]
"""Distances in px between stored and rendered skylines (N pairs) after the best affine warp."""

_Z_95 = 1.959963984540054
_VIEWS_TRIED = 4


@dataclass(frozen=True, slots=True)
class Verification:
    """How much of a sample of covered locations is truly covered."""

    share: float
    """Of the sample, within the threshold of some stored view after the best affine warp."""
    low: float
    high: float
    """``low``, ``high``: 95 % interval of the share (Wilson)."""
    sampled: int
    predicted: float
    """The coverage the plan predicts."""

    @property
    def verified(self) -> float:
        """Coverage as verified: the share of the predicted coverage that is true."""
        return self.predicted * self.share


@dataclass(frozen=True, slots=True)
class Checks:
    """What verification asks others for."""

    render: Render
    stored: Render
    """Returns stored views at viewpoints along headings, in any order."""
    errors: TrueErrors


def verify_coverage(
    plan: Plan, checks: Checks, threshold_px: float, sample: int = 400
) -> Verification:
    """Render a random sample of covered locations and compare them with the views that cover them.

    A location that was rendered itself counts as any other. Of the views whose tolerance areas
    hold a location, up to four, the nearest, are tried.

    Raises `InputError` for a sample below 1, or a plan that covers nothing.
    """
    heading, location = _draw(plan, sample)
    rendered = _views(checks.render, plan, location, heading)
    pair, viewpoint = _pairs(plan, heading, location)
    stored = _views(checks.stored, plan, viewpoint, heading[pair])
    within = checks.errors(stored, rendered[pair]) <= threshold_px
    true = int(np.count_nonzero(np.bincount(pair[within], minlength=len(location))))
    low, high = wilson_interval(true, len(location))
    return Verification(true / len(location), low, high, len(location), plan.coverage)


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a share, after Wilson."""
    share = successes / trials
    middle = share + _Z_95**2 / (2 * trials)
    half = _Z_95 * np.sqrt(share * (1 - share) / trials + _Z_95**2 / (4 * trials**2))
    scale = 1 + _Z_95**2 / trials
    return float((middle - half) / scale), float((middle + half) / scale)


def _draw(plan: Plan, sample: int) -> tuple[Headings, Int64Array]:
    """Draw headings and covered candidates, each as likely as any other."""
    covered = np.flatnonzero(np.stack([one.counts > 0 for one in plan.coverages]))
    if sample < 1 or not len(covered):
        raise InputError(
            f"sample is {sample} of {len(covered)} covered locations; expected at least 1 of each"
        )
    generator = np.random.default_rng(0)
    drawn = np.sort(generator.choice(covered, min(sample, len(covered)), replace=False))
    heading, location = np.divmod(drawn, plan.candidates.grid.valid.size)
    return heading.astype(np.uint8), location


def _pairs(plan: Plan, heading: Headings, location: Int64Array) -> tuple[Int64Array, Int64Array]:
    """Return for each pair to compare the place in the sample and the viewpoint that covers it."""
    pair, viewpoint = [], []
    for place, (one, where) in enumerate(zip(heading.tolist(), location.tolist(), strict=True)):
        found = _covering(plan.coverages[one], where)
        pair += [place] * len(found)
        viewpoint += found.tolist()
    return np.array(pair, dtype=np.int64), np.array(viewpoint, dtype=np.int64)


def _covering(coverage: Coverage, location: int) -> Int64Array:
    """Return the viewpoints whose areas hold a location, nearest first, the first few."""
    grid = coverage.grid
    row, col = grid.row_col(np.array([location]))
    seen_row, seen_col = grid.row_col(coverage.viewpoints)
    down, across = row - seen_row + grid.reach, col - seen_col + grid.reach
    near = (np.abs(down - grid.reach) <= grid.reach) & (np.abs(across - grid.reach) <= grid.reach)
    near = np.flatnonzero(near)
    holds = near[coverage.areas[near, down[near], across[near]]]
    apart = np.hypot(down[holds] - grid.reach, across[holds] - grid.reach)
    nearest = holds[np.argsort(apart, kind="stable")[:_VIEWS_TRIED]]
    return np.asarray(coverage.viewpoints[nearest], dtype=np.int64)


def _views(source: Render, plan: Plan, candidates: Int64Array, heading: Headings) -> Views:
    """Return views at candidates along headings, in that order; each is asked for once."""
    once = np.unique(np.stack([heading, candidates]), axis=1)
    views = source(plan.candidates.viewpoints(once[1]), once[0].astype(np.uint8))
    return as_asked(views, places(plan.candidates.viewpoints(candidates), heading))
