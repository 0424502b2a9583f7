"""The stage in which a search lost the true place of a query.

The query is searched once more, by a shard that notes what each stage keeps: which places come out
of the screens, from which starts poses are fitted, and where they end. A query that one stage keeps
may have been dropped by an earlier one, since fits climb from place to place.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skyline import Matcher, Narrowing
from skyline.angles import angle_between_deg
from skyline.arrays import BoolArray, Float64Array, IntArray
from skyline.match.fit import GOOD_FIT, ROUGH_FIT, FitEffort
from skyline.match.prior import Prior
from skyline.match.rays import Rays
from skyline.match.screen import Alike, Screen, Turns
from skyline.match.search import FullMatcher
from skyline.match.shard import LocalShard, Starts
from skyline.pose.pose import RIGHT_WITHIN_M, SAME_VIEW_DEG
from skyline.pose.poses import Poses
from skyline.progress import StepProgress, silent
from skyline.store.mapped_places import PlaceSource
from skyline.store.read import open_store
from skyline.terrain.heightfield import Ground, ground_of
from skyline_bench.queries.synthetic import SyntheticQuery, Truth

STAGES = (
    "coarse screen", "fine screen", "turns", "rough fits", "good fits", "short list", "refinement",
    "ranking",
)  # fmt: skip
"""Stages of a search, in order. The last one ranks what the others have kept."""
_NEAREST = 7
"""The nearest places of a pose, to which fits climb; they count as near however far they are."""


class _Watched(LocalShard):
    """The places of a search, which note the stages that keep a true place."""

    def __init__(self, places: PlaceSource, ground: Ground, truth: Truth) -> None:
        super().__init__(places, ground)
        self._truth = truth
        at_m = np.array([truth.easting_m, truth.northing_m])
        away_m = self.nearest(at_m[np.newaxis], min(_NEAREST, len(self))).distance_m
        self._near_m = max(RIGHT_WITHIN_M, float(away_m.max()))
        self._near = np.array(self._tree.query_ball_point(at_m, self._near_m), dtype=np.intp)
        self._kept_by = -1  # The last stage that kept anything near the truth

    @property
    def lost_in(self) -> str:
        """The stage after the last one that kept the place."""
        return STAGES[min(self._kept_by + 1, len(STAGES) - 1)]

    def note(self, stage: str, is_true: BoolArray) -> None:
        """Note whether a stage keeps anything true."""
        if is_true.any():
            self._kept_by = max(self._kept_by, STAGES.index(stage))

    def is_true(self, poses: Poses, within_m: float | None = None) -> BoolArray:
        """Return which poses are near the truth and look its way."""
        off_m = self._truth.off_m(poses.easting_m, poses.northing_m)
        is_near = off_m <= (self._near_m if within_m is None else within_m)
        return np.asarray(is_near & self._looks_alike(poses.grid_heading_deg))

    def screened(
        self,
        screens: Sequence[Screen],
        priors: Sequence[Prior],
        count: int,
        least: float = -math.inf,
        report: StepProgress = silent,
    ) -> Alike:
        """See `Shard.screened`."""
        alike = super().screened(screens, priors, count, least, report)
        self.note("coarse screen", np.isin(alike.row, self._near))
        return alike

    def best_turns(self, screen: Screen, rows: IntArray, count: int) -> Turns:
        """See `Shard.best_turns`; its places are those that the fine screen keeps."""
        self.note("fine screen", np.isin(rows, self._near))
        return super().best_turns(screen, rows, count)

    def fitted(
        self, rays: Rays, starts: Starts, effort: FitEffort, report: StepProgress = silent
    ) -> Poses:
        """See `Shard.fitted`; good fits start where rough ones were good."""
        alike = self._looks_alike(np.degrees(starts.grid_heading_rad))
        stage = "turns" if effort == ROUGH_FIT else "rough fits"
        self.note(stage, np.isin(starts.row, self._near) & alike)
        poses = super().fitted(rays, starts, effort, report)
        if effort == GOOD_FIT:
            self.note("good fits", self.is_true(poses))
        return poses

    def _looks_alike(self, grid_heading_deg: Float64Array) -> BoolArray:
        off_deg = angle_between_deg(grid_heading_deg, self._truth.grid_heading_deg)
        return np.asarray(off_deg <= SAME_VIEW_DEG)


def stage_of_loss(
    matcher: Matcher, store: Path, query: SyntheticQuery, narrowing: Narrowing | None = None
) -> str:
    """Return which of `STAGES` lost a query; the last one for a query that is found.

    The matcher is the full one, which refines, on one store.
    """
    method = matcher._method
    assert isinstance(method, FullMatcher)
    assert matcher.terrain is not None
    with open_store(store) as file:
        watched = _Watched(file.places(), ground_of(matcher.terrain), query.truth)
    known = matcher._rays_and_prior(query.skyline, narrowing)
    found = method.by_shards([[watched]], 1).found(*known)
    watched.note("short list", watched.is_true(found.retrieved))
    if found.refined is not None:
        watched.note("refinement", watched.is_true(found.refined, RIGHT_WITHIN_M))
    return watched.lost_in
