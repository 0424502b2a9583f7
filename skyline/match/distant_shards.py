"""Shards of a search on the workers of a cluster.

The matcher's process ranks, chooses and refines. Each worker screens its own part of the places and
fits poses to them; no other process reads their bytes. A worker keeps nothing about a photo, so if
it dies, another one is asked. The answers equal those of one process to the bit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from skyline.arrays import Float32Array, Float64Array, IntArray
from skyline.files.disk import version_of
from skyline.match.areas import terrain_at_hand
from skyline.match.blas_threads import one_blas_thread
from skyline.match.fit import FitEffort
from skyline.match.prior import Prior
from skyline.match.rays import Rays
from skyline.match.screen import Alike, AlikePlaces, Screen, Turns
from skyline.match.shard import LocalShard, Neighbours, Starts
from skyline.pose.poses import Poses
from skyline.progress import StepProgress, silent
from skyline.store.layout import PLACES_A_CHUNK
from skyline.store.mapped_places import PartOfPlaces, PlaceMap
from skyline.store.merge import by_model, open_joined
from skyline.store.places import Places
from skyline.survey.cluster import Opening, Runner, Tell
from skyline.terrain.dem import Dem
from skyline.terrain.heightfield import Ground, ground_of

_PARTS_A_WORKER = 2
"""Parts of the places for each worker: the best places lie close together, and each worker should
fit its share of them. More parts need more questions, at 10 ms each."""


@dataclass(frozen=True, slots=True)
class Part:
    """Rows of an area's places, and the worker asked about them."""

    area: int
    first: int
    stop: int
    worker: int


class OpenAreas:
    """The areas of stores, opened on a worker.

    ``stores`` and ``dem`` are as for `Matcher`.
    """

    def __init__(self, stores: Sequence[Path], dem: Dem | None = None) -> None:
        self._areas: list[tuple[PlaceMap, Ground | None]] = []
        for group in by_model(stores):
            with open_joined(group) as file:
                if dem is None:
                    terrain = terrain_at_hand(file.header, "answers unrefined")
                else:
                    terrain = file.header.read_dem(dem)
                ground = None if terrain is None else ground_of(terrain)
                self._areas.append((file.places(), ground))
        self._shards: dict[Part, LocalShard] = {}

    def shard(self, part: Part) -> LocalShard:
        """Return a part of an area, the same shard each time."""
        if part not in self._shards:
            places, ground = self._areas[part.area]
            self._shards[part] = LocalShard(PartOfPlaces(places, part.first, part.stop), ground)
        return self._shards[part]

    def close(self) -> None:
        """Free nothing: the files are mapped."""


class DistantShard:
    """A part of the places of an area that a worker searches."""

    def __init__(self, runner: Runner, opening: Opening[OpenAreas], part: Part) -> None:
        self._runner = runner
        self._opening = opening
        self._part = part

    def __len__(self) -> int:
        return self._part.stop - self._part.first

    def take(self, rows: IntArray) -> Places:
        """See `Shard.take`."""
        places: Places = self._ask("take", rows)
        return places

    def screened(
        self,
        screens: Sequence[Screen],
        priors: Sequence[Prior],
        count: int,
        least: float = -math.inf,
        report: StepProgress = silent,
    ) -> Alike:
        """See `Shard.screened`; nothing is reported."""
        alike: Alike = self._ask("screened", screens, priors, count, least)
        return alike

    def alike_places(
        self, screens: Sequence[Screen], priors: Sequence[Prior], report: StepProgress = silent
    ) -> AlikePlaces:
        """See `Shard.alike_places`; nothing is reported."""
        alike: AlikePlaces = self._ask("alike_places", screens, priors)
        return alike

    def rescored(self, screens: Sequence[Screen], rows: IntArray) -> Float32Array:
        """See `Shard.rescored`."""
        score: Float32Array = self._ask("rescored", screens, rows)
        return score

    def best_turns(self, screen: Screen, rows: IntArray, count: int) -> Turns:
        """See `Shard.best_turns`."""
        turns: Turns = self._ask("best_turns", screen, rows, count)
        return turns

    def nearest(self, position_m: Float64Array, count: int) -> Neighbours:
        """See `Shard.nearest`."""
        found: Neighbours = self._ask("nearest", position_m, count)
        return found

    def fitted(
        self, rays: Rays, starts: Starts, effort: FitEffort, report: StepProgress = silent
    ) -> Poses:
        """See `Shard.fitted`; nothing is reported."""
        poses: Poses = self._ask("fitted", rays, starts, effort)
        return poses

    def _ask(self, what: str, *given: Any) -> Any:
        item = self._part, what, given
        return self._runner.ask(_answer, self._opening, item, self._part.worker)


def _answer(areas: OpenAreas, item: tuple[Part, str, Any], _: Tell) -> Any:
    """Return what a shard answers, on a worker."""
    part, what, given = item
    with one_blas_thread():
        return getattr(areas.shard(part), what)(*given)


def opening_of(stores: Sequence[str | Path], dem: Any = None) -> Opening[OpenAreas]:
    """Return how workers open stores, under the same paths as here.

    ``dem`` holds paths, as for `Matcher`.
    """
    paths = tuple(Path(one).absolute() for one in stores)
    # A worker that outlives this process must not take a file for the one it has replaced.
    versions = tuple(map(version_of, [*paths, *map(Path, dem or ())]))
    return Opening((versions, paths, dem), partial(OpenAreas, paths, dem))


def distant_shards(
    runner: Runner, opening: Opening[OpenAreas], rows: Sequence[int]
) -> list[list[DistantShard]]:
    """Return the shards of each area, given the areas' numbers of places.

    All workers get about equally many places.
    """
    chunks = max(1, -(-sum(rows) // (_PARTS_A_WORKER * max(runner.workers, 1) * PLACES_A_CHUNK)))
    shards = []
    number = 0
    for area, count in enumerate(rows):
        starts = range(0, count, chunks * PLACES_A_CHUNK)
        some = []
        for first in starts:
            part = Part(area, first, min(first + starts.step, count), number)
            some.append(DistantShard(runner, opening, part))
            number += 1
        shards.append(some)
    return shards
