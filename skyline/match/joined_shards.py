"""The shards of a search, asked together as one."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from skyline.arrays import Float32Array, IntArray
from skyline.geodesy.map_frame import Frame
from skyline.match.fit import FitEffort
from skyline.match.prior import Prior
from skyline.match.rays import Rays
from skyline.match.screen import Alike, AlikePlaces, Screen, Turns
from skyline.match.shard import Neighbours, Shard, Starts
from skyline.pose.poses import Poses
from skyline.progress import StepProgress, silent
from skyline.store.places import Places

T = TypeVar("T")


class JoinedShards:
    """The places of all shards, which answer as one shard would.

    Rows are counted through all shards, one after another.

    Parameters
    ----------
    areas : sequence of sequence of Shard
        The shards of each elevation model, which share its frame.
    frames : sequence of Frame
        The frames, by area. One area alone needs none.
    at_once : int
        Shards that are asked at a time; shards of this process take all of its cores.
    """

    def __init__(
        self, areas: Sequence[Sequence[Shard]], frames: Sequence[Frame] = (), at_once: int = 1
    ) -> None:
        self.frames = frames
        self._at_once = at_once
        self._shards = [shard for shards in areas for shard in shards]
        self._area_of_shard = np.repeat(np.arange(len(areas)), [len(shards) for shards in areas])
        self._first_row = np.cumsum([0, *map(len, self._shards)])

    def __len__(self) -> int:
        return int(self._first_row[-1])

    def sample(self, count: int) -> Places:
        """Return about ``count`` places, the same ones in every process."""
        step = max(1, len(self) // count)
        rows = np.arange(0, len(self), step, dtype=np.intp)
        return self._of_each(rows, lambda shard, _, own: shard.take(own), Places.concatenate)

    def screened(
        self,
        screens: Sequence[Screen],
        priors: Sequence[Prior],
        count: int,
        report: StepProgress = silent,
    ) -> Alike:
        """Return the ``count`` best places by summed scores, best first.

        The scores are of several photos, and the places lie within the narrowings of all priors.
        """
        by_photo_and_area = [prior.in_frames(self.frames) for prior in priors]
        kept = Alike.joined([])
        least = -math.inf

        def screened(number: int) -> Alike:
            shard = self._shards[number]
            own_priors = [of_photo[self._area_of_shard[number]] for of_photo in by_photo_and_area]
            first = self._first_row[number]
            report_own = partial(_report_part, report, first / len(self), len(shard) / len(self))
            alike = shard.screened(screens, own_priors, count, least, report_own)
            return replace(alike, row=first + alike.row)

        for alike in self._asked(partial(screened, number) for number in range(len(self._shards))):
            kept = Alike.joined([kept, alike])
            if len(kept) > count:
                # Shards that are asked later need not answer with places that are worse.
                kept = kept.best(count)
                least = float(kept.score[-1])
        return kept.best()

    def alike_places(
        self, screens: Sequence[Screen], priors: Sequence[Prior], report: StepProgress = silent
    ) -> AlikePlaces:
        """See `Shard.alike_places`; the places are of one area."""
        asks = (partial(shard.alike_places, screens, priors, report) for shard in self._shards)
        return AlikePlaces.concatenate(list(self._asked(asks)))

    def rescored(self, screens: Sequence[Screen], rows: IntArray) -> Float32Array:
        """See `Shard.rescored`."""
        return self._of_each(
            rows, lambda shard, _, own: shard.rescored(screens, own), np.concatenate
        )

    def best_turns(self, screen: Screen, rows: IntArray, count: int) -> Turns:
        """See `Shard.best_turns`."""
        return self._of_each(
            rows, lambda shard, _, own: shard.best_turns(screen, own, count), Turns.concatenate
        )

    def nearest(self, poses: Poses, count: int) -> Neighbours:
        """Return the ``count`` places of each pose's area nearest to it."""
        position_m = np.stack([poses.easting_m, poses.northing_m], axis=1)
        row = np.zeros((len(poses), count), dtype=np.intp)
        distance_m = np.full(row.shape, np.inf)

        def nearest(number: int, mine: IntArray) -> Neighbours:
            found = self._shards[number].nearest(position_m[mine], count)
            return replace(found, row=found.row + self._first_row[number])

        areas = poses.areas()
        for area in np.unique(areas):
            mine = np.flatnonzero(areas == area)
            shards = np.flatnonzero(self._area_of_shard == area).tolist()
            parts = list(self._asked(partial(nearest, number, mine) for number in shards))
            rows = np.concatenate([part.row for part in parts], axis=1)
            distances_m = np.concatenate([part.distance_m for part in parts], axis=1)
            order = np.argsort(distances_m, axis=1, kind="stable")[:, :count]
            row[mine] = np.take_along_axis(rows, order, axis=1)
            distance_m[mine] = np.take_along_axis(distances_m, order, axis=1)
        return Neighbours(row=row, distance_m=distance_m)

    def fitted(
        self, rays: Rays, starts: Starts, effort: FitEffort, report: StepProgress = silent
    ) -> Poses:
        """See `Shard.fitted`; poses of several areas have `Poses.in_areas`."""

        def fitted(shard: Shard, mine: IntArray, rows: IntArray) -> Poses:
            return shard.fitted(rays, replace(starts[mine], row=rows), effort, report)

        poses = self._of_each(starts.row, fitted, Poses.concatenate)
        if len(self.frames) < 2:
            return poses
        return poses.found_in(self._area_of_shard[self._shard_of(starts.row)], self.frames)

    def _shard_of(self, rows: IntArray) -> IntArray:
        """Return the numbers (M,) of the shards that hold places."""
        return np.searchsorted(self._first_row, rows, side="right") - 1

    def _asked(self, asks: Iterable[Callable[[], T]]) -> Iterator[T]:
        """Yield shards' answers, in order."""
        if self._at_once == 1:
            yield from (ask() for ask in asks)
            return
        with ThreadPoolExecutor(self._at_once) as pool:
            yield from pool.map(lambda ask: ask(), asks)

    def _of_each(
        self,
        rows: IntArray,
        ask: Callable[[Shard, IntArray, IntArray], T],
        concatenate: Callable[[list[T]], T],
    ) -> T:
        """Return shards' answers about places (M,), in the places' order.

        ``ask`` takes a shard, the indices of its places in ``rows``, and their rows in the shard.
        """
        number = self._shard_of(rows)
        # About no places the first shard is asked: its answer is empty, and of the right kind.
        asked = np.unique(number).tolist() if len(rows) else [0]
        at = [np.flatnonzero(number == one) for one in asked]
        asks = (
            partial(ask, self._shards[one], mine, rows[mine] - self._first_row[one])
            for one, mine in zip(asked, at, strict=True)
        )
        parts = list(self._asked(asks))
        if len(parts) == 1:
            return parts[0]
        back: Any = np.argsort(np.concatenate(at), kind="stable")
        together: Any = concatenate(parts)
        answer: T = together[back]
        return answer


def _report_part(report: StepProgress, done: float, share: float, step: str, part: float) -> None:
    """Report part of a shard's work as a share of all work."""
    report(step, done + share * part)
