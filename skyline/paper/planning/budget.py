"""Planning for a number of renderings instead of a threshold.

How large tolerance areas are depends on the threshold, and the errors that were measured once say
it for every threshold. So the threshold is what gives way: it begins where few views would do and
is lowered while there are renderings left. Views that cover at one threshold are not lost at the
next lower one, where they cover less.
"""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float32Array, Int64Array
from skyline.camera import HEADINGS
from skyline.geodesy import Rectangle
from skyline.paper.planning.candidates import Spacing
from skyline.paper.planning.coverage import CandidateGrid

AIMS = (0.6, 0.9, 1.0)
"""Shares of the budget to be planned for, one after the other: a forecast that errs by a half
still leaves renderings for the corrected ones."""

ENOUGH = 0.95
"""Share of the budget that need not be followed by another plan."""

_REACH_RADII = 2.0
"""Reach of tolerance areas, in radii of the disc that each view has to itself."""

_CANDIDATES_A_RADIUS = 3.0
_COARSE_SHARE = 0.25
"""Share of the budget that the coarse grid may take."""

_VIEWS_A_DISC = 2.0
"""Views that real areas take where discs of their size, laid side by side, would be one."""

_BISECTIONS = 40


def spaced_for(spacing: Spacing, budget: int, bounds_m: Rectangle) -> Spacing:
    """Return distances that suit a number of renderings; none is below the given one.

    With few renderings areas have to be large: their reach grows, candidates may lie further
    apart, and the coarse grid must leave most of the renderings to the planner.
    """
    west, south, east, north = bounds_m
    own_m2 = (east - west) * (north - south) * len(HEADINGS) / budget
    radius_m = np.sqrt(own_m2 / np.pi)
    candidate_m = spacing.candidate_m * max(
        1, round(radius_m / _CANDIDATES_A_RADIUS / spacing.candidate_m)
    )
    widest = max(east - west, north - south) // candidate_m
    coarse = np.ceil(max(spacing.coarse_m, np.sqrt(own_m2 / _COARSE_SHARE)) / candidate_m - 1e-9)
    reach = np.ceil(max(spacing.reach_m, _REACH_RADII * radius_m) / candidate_m - 1e-9)
    if spacing.coarse_m <= candidate_m * widest:
        coarse = min(coarse, widest)
    return Spacing(float(coarse * candidate_m), float(candidate_m), float(reach * candidate_m))


@dataclass(slots=True)
class Outlook:
    """Foresees how many views a threshold takes.

    Ground on which areas hold ``a`` locations takes one view for each ``a`` locations, times what
    areas that do not fit together cost. The views looked at are spread evenly, so the mean of
    ``1 / a`` over them is what a location takes; the worst are those that stay uncovered.
    """

    errors: Float32Array
    """(N, K, K) float32. Of views spread evenly over locations and headings, px."""
    locations: int
    """To cover, over all headings."""
    share: float
    """Of them."""
    views_a_disc: float = _VIEWS_A_DISC
    """What areas that do not fit together cost."""

    def views(self, threshold_px: float) -> float:
        """Return how many views a threshold takes."""
        held = np.maximum(np.count_nonzero(self.errors <= threshold_px, axis=(1, 2)), 1)
        best = np.sort(1.0 / held)[: int(np.ceil(self.share * len(held)))]
        return float(self.views_a_disc * self.share * self.locations * best.mean())

    def learn(self, threshold_px: float, views: int) -> None:
        """Take note of how many views a threshold has taken."""
        self.views_a_disc *= views / self.views(threshold_px)

    def threshold_px(self, views: float, lowest_px: float) -> float:
        """Return the lowest threshold that takes no more than some views; never below a given one.

        Where none does, the one at which areas are as large as they get.
        """
        finite = self.errors[np.isfinite(self.errors)]
        low, high = lowest_px, max(lowest_px, float(finite.max(initial=0.0)))
        if self.views(low) <= views:
            return low
        for _ in range(_BISECTIONS):
            middle = float(np.sqrt(low * high))
            low, high = (low, middle) if self.views(middle) <= views else (middle, high)
        return high


def covering_px(
    grid: CandidateGrid, viewpoints: Int64Array, errors: Float32Array, share: float
) -> float:
    """Return the lowest threshold at which views (N) with errors (N, K, K) cover a share; or inf.

    Their errors are those of one heading, their viewpoints candidates.
    """
    least = np.full(np.pad(grid.valid, grid.reach).shape, np.inf, dtype=np.float32)
    windows = grid.windows(least)
    for row, col, one in zip(*grid.row_col(viewpoints), errors, strict=True):
        np.minimum(windows[row, col], one, out=windows[row, col])
    held = np.sort(grid.inner(least)[grid.valid])
    return float(held[max(int(np.ceil(share * len(held) - 1e-9)), 1) - 1])
