"""Proof by rendering: whether what a plan says is covered truly is."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Int64Array
from skyline.errors import InputError
from skyline.paper.coverage import Coverage
from skyline.paper.plan import Headings, Plan, Render
from skyline.skylines import Views

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


def verify_coverage(
    plan: Plan, render: Render, errors: TrueErrors, sample: int = 400
) -> Verification:
    """Render a random sample of covered locations and compare them with the views that cover them.

    These are rendered again rather than kept: a rendering costs less than its memory.
    A location that was rendered itself counts as any other. Of the views whose tolerance areas
    hold a location, up to four, the nearest, are tried.

    Raises `InputError` for a sample below 1, or a plan that covers nothing.
    """
    heading, location = _draw(plan, sample)
    rendered = _views(render, plan, location, heading)
    covering = [
        _covering(plan.coverages[one], where)
        for one, where in zip(heading.tolist(), location.tolist(), strict=True)
    ]
    pair = np.repeat(np.arange(len(covering)), [len(found) for found in covering])
    stored = _views(render, plan, np.concatenate(covering), heading[pair])
    within = errors(stored, rendered[pair]) <= plan.threshold_px
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


def _covering(coverage: Coverage, location: int) -> Int64Array:
    """Return the viewpoints whose areas hold a location, nearest first, the first few."""
    grid, reach = coverage.grid, coverage.grid.reach
    row, col = grid.row_col(coverage.viewpoints)
    down, across = location // grid.shape[1] - row, location % grid.shape[1] - col
    near = np.flatnonzero(np.maximum(np.abs(down), np.abs(across)) <= reach)
    holds = near[coverage.areas[near, down[near] + reach, across[near] + reach]]
    apart = np.hypot(down[holds], across[holds])
    return coverage.viewpoints[holds[np.argsort(apart, kind="stable")[:_VIEWS_TRIED]]]


def _views(render: Render, plan: Plan, candidates: Int64Array, heading: Headings) -> Views:
    """Return views at candidates along headings, in that order; each is asked for once."""
    once, row = np.unique(np.stack([heading, candidates]), axis=1, return_inverse=True)
    views = render(plan.candidates.viewpoints(once[1]), once[0].astype(np.uint8))
    return views[row.reshape(-1)]
