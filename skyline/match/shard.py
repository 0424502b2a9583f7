"""A shard: places of one elevation model that a search asks about.

A search ranks the places of all shards together. It asks each shard for scores, turns and fits of
the shard's own places, and chooses among the answers. A shard keeps nothing about a photo.
"""

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, IntArray, Rows
from skyline.match.fit import CurveFit, FitEffort
from skyline.match.prior import Prior
from skyline.match.rays import Rays, in_runs
from skyline.match.screen import (
    CHOSEN_AT_ONCE,
    Alike,
    AlikePlaces,
    Scores,
    Screen,
    Turns,
    rescored,
    screen_places,
)
from skyline.pose.poses import Poses
from skyline.progress import Step, StepProgress, silent
from skyline.store.mapped_places import PlaceSource
from skyline.store.places import Places
from skyline.terrain.heightfield import Ground, ground_slope

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_FITS_AT_ONCE = 2048
"""Poses fitted together. With 256, two threads spend half their time waiting for the GIL."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Starts(Rows):
    """The starts of N fits."""

    row: IntArray
    """(N,) intp. Row of the place."""
    score: Float32Array
    """(N,) float32. Score of the place, as `Alike` has it."""
    grid_heading_rad: Float64Array
    """(N,) float64. From grid north."""
    log_scale: Float64Array
    """(N,) float64. `Rays.log_scale` of the field of view."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Neighbours(Rows):
    """The C places nearest to each of M points, nearest first."""

    row: IntArray
    """(M, C) intp. Row of the place."""
    distance_m: Float64Array
    """(M, C) float64. Horizontal distance; infinite where there are fewer places."""


class Shard(Protocol):
    """Places of one elevation model, in this process or another."""

    def __len__(self) -> int:
        """Return the number of places."""

    def take(self, rows: IntArray) -> Places:
        """Return some places (M,), in order."""

    def screened(
        self,
        screens: Sequence[Screen],
        priors: Sequence[Prior],
        count: int,
        least: float = -math.inf,
        report: StepProgress = silent,
    ) -> Alike:
        """Return the ``count`` places with the best sums of photos' scores.

        The places lie within the narrowings of all priors, which are in the shard's frame, and have
        sums of ``least`` or more.
        """

    def alike_places(
        self, screens: Sequence[Screen], priors: Sequence[Prior], report: StepProgress = silent
    ) -> AlikePlaces:
        """Return all places within all narrowings, with the sums of photos' scores."""

    def rescored(self, screens: Sequence[Screen], rows: IntArray) -> Float32Array:
        """Return the summed scores of photos at places (M,), in order."""

    def best_turns(self, screen: Screen, rows: IntArray, count: int) -> Turns:
        """Return the best turns of places (M,)."""

    def nearest(self, position_m: Float64Array, count: int) -> Neighbours:
        """Return the ``count`` places nearest to eastings and northings (M, 2)."""

    def fitted(
        self, rays: Rays, starts: Starts, effort: FitEffort, report: StepProgress = silent
    ) -> Poses:
        """Return the poses fitted from starts, in order."""


class LocalShard:
    """A shard in this process.

    Without ``ground`` the ground around each place is taken to be level.
    """

    def __init__(self, places: PlaceSource, ground: Ground | None = None) -> None:
        self._places = places
        self._ground = ground

    def __len__(self) -> int:
        return len(self._places)

    def take(self, rows: IntArray) -> Places:
        """See `Shard.take`."""
        return self._places.take(rows)

    def screened(
        self,
        screens: Sequence[Screen],
        priors: Sequence[Prior],
        count: int,
        least: float = -math.inf,
        report: StepProgress = silent,
    ) -> Alike:
        """See `Shard.screened`."""

        def contains(some: Places) -> BoolArray:
            return np.asarray(np.all([prior.contains(some) for prior in priors], axis=0))

        scores = _sum_of(screens)
        found = screen_places(scores, self._places, count, contains, report)
        return found[found.score >= least]

    def alike_places(
        self, screens: Sequence[Screen], priors: Sequence[Prior], report: StepProgress = silent
    ) -> AlikePlaces:
        """See `Shard.alike_places`."""
        alike = self.screened(screens, priors, len(self), report=report)
        columns = [
            (one.easting_m, one.northing_m, one.tolerance_m) for one in self._places.blocks()
        ]
        easting_m, northing_m, tolerance_m = (
            np.concatenate(column)[alike.row] for column in zip(*columns, strict=True)
        )
        score = alike.score.astype(np.float64)
        return AlikePlaces(easting_m, northing_m, tolerance_m.astype(np.float64), score)

    def rescored(self, screens: Sequence[Screen], rows: IntArray) -> Float32Array:
        """See `Shard.rescored`."""
        return rescored(_sum_of(screens), self._places, rows)

    def best_turns(self, screen: Screen, rows: IntArray, count: int) -> Turns:
        """See `Shard.best_turns`."""
        groups = range(0, len(rows), CHOSEN_AT_ONCE)

        def turns_from(first: int) -> Turns:
            phase = self._places.phases(rows[first : first + CHOSEN_AT_ONCE])
            return screen.best_turns(phase, count)

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            return Turns.concatenate(list(pool.map(turns_from, groups)))

    @cached_property
    def _tree(self) -> "cKDTree":
        """The tree of all places, some 30 bytes a place."""
        from scipy.spatial import cKDTree  # noqa: PLC0415  (slow to load, seldom needed)

        columns = [np.stack([one.easting_m, one.northing_m], 1) for one in self._places.blocks()]
        position_m = np.concatenate([np.zeros((0, 2)), *columns])
        # A tree that is balanced or compact saves less time than it takes to make.
        return cKDTree(position_m, balanced_tree=False, compact_nodes=False)

    def nearest(self, position_m: Float64Array, count: int) -> Neighbours:
        """See `Shard.nearest`."""
        distance_m, row = self._tree.query(position_m, k=range(1, count + 1))
        return Neighbours(row=np.asarray(row), distance_m=np.asarray(distance_m))

    def fitted(
        self, rays: Rays, starts: Starts, effort: FitEffort, report: StepProgress = silent
    ) -> Poses:
        """See `Shard.fitted`."""
        means = in_runs(rays, effort.runs)

        def fitted_from(first: int) -> Poses:
            part = starts[slice(first, first + _FITS_AT_ONCE)]
            places = self._places.take(part.row)
            fit = CurveFit(places, self._slope(places), means, effort)
            poses = fit.fit(part.grid_heading_rad, part.log_scale)
            # Both count: a fit compares more than screening does, but assumes that the photo was
            # taken near its place.
            return replace(poses, cost=poses.cost - part.score)

        parts = range(0, len(starts), _FITS_AT_ONCE)
        found = []
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            try:
                for poses in pool.map(fitted_from, parts):
                    found.append(poses)
                    report(Step.FITTING, len(found) / len(parts))
            except BaseException:
                # The report may end the match: fits that have not begun are dropped.
                pool.shutdown(cancel_futures=True)
                raise
        return Poses.concatenate(found)

    def _slope(self, places: Places) -> Float32Array:
        """Return the ground's rise (M, 2) to the east and north."""
        if self._ground is None:
            return np.zeros((len(places), 2), dtype=np.float32)
        rise = ground_slope(self._ground, places.easting_m, places.northing_m)
        return rise.astype(np.float32)


def _sum_of(screens: Sequence[Screen]) -> Scores:
    """Return a function that adds the scores of several photos."""
    return lambda phase: np.sum([screen.scores(phase) for screen in screens], axis=0)
