"""Shards: one process against workers, for up to a million km2.

Each worker has a part of the places. Areas of that size are simulated: one store stands for many
stores of an area, and for many areas with frames of their own. So all processes map the same file;
what they would map of real stores is computed.
"""

import os
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from typer import Option

from skyline import MatchConfig, build_places, open_store, read_dem
from skyline.arrays import IntArray, UInt8Array
from skyline.cli.terminal import Terminal
from skyline.geodesy.map_frame import Frame
from skyline.match.blas_threads import one_blas_thread
from skyline.match.distant_shards import OpenAreas, Part, distant_shards
from skyline.match.joined_shards import JoinedShards
from skyline.match.rays import Rays
from skyline.match.retrieval import Retriever
from skyline.match.shard import LocalShard
from skyline.pose.poses import Poses
from skyline.store.layout import PLACES_A_CHUNK
from skyline.store.mapped_places import PlaceMap
from skyline.store.places import Places
from skyline.store.read import Store
from skyline.survey.cluster import Opening, Runner, local_cluster
from skyline.terrain.heightfield import HeightField, ground_of
from skyline.terrain.provenance import DemOptions
from skyline_bench import options
from skyline_bench.measuring import Row, peak_bytes, square_km, timed
from skyline_bench.queries.synthetic import make_queries

_AREA_KM2 = 1e5
"""Size of an area: that of nine tiles."""
_LISTED = 400
"""Poses of a short list; a search of few places has as many."""


def shards(
    dem: options.Dems,
    record: options.Record = None,
    places: Annotated[int, Option(min=1, help="Places of the store.")] = 20_000,
    km2: Annotated[list[float], Option(min=1.0, help="Areas that are simulated.")] = [1e5, 1e6],  # noqa: B006
    workers: Annotated[int, Option(min=1, help="Workers.")] = 2,
    seed: options.Seed = 0,
    folder: options.Folder = None,
    quick: Annotated[bool, options.quick_with(places=2000, km2=[2e4])] = False,
    crs: options.Crs = None,
) -> None:
    """Seconds and memory of a search by one process, and by workers.

    A photo is screened and fitted.

    Each worker has a part of the places, and one is killed in the last round. Answers are compared
    to the bit. Refinement, which does not grow with the area, is left out. Processor time does not
    depend on what else the machine does: with a core each, workers take as long as the busiest of
    them and the process that asks them.
    """
    terrain = read_dem(dem, DemOptions(crs=crs))
    with options.store_folder(folder) as kept, local_cluster(workers) as cluster:
        path = kept / "shards.h5"
        if not path.exists():
            build_places(terrain, path, places=places)
        with _client(cluster) as client, open_store(path) as store:
            search = _Search(terrain, store, Runner(client), seed)
            with Terminal().progress("measuring") as progress:
                rows: list[Row] = []
                for number, size in enumerate(km2):
                    progress(number, len(km2))
                    rows += search.rows(size)
        options.report(record, rows, terrain=terrain)


@contextmanager
def _client(cluster: Any) -> Iterator[Any]:
    distributed: Any = import_module("distributed")  # It is slow to load.
    with distributed.Client(cluster) as client:
        yield client


class _Again(PlaceMap):
    """Whole blocks of places, repeated as the places of one area."""

    def __init__(self, places: PlaceMap, copies: int) -> None:
        self._source = places
        self._chunks = len(places) // PLACES_A_CHUNK
        self._copies = copies

    @property
    def _whole(self) -> int:
        return self._chunks * PLACES_A_CHUNK

    def __len__(self) -> int:
        return self._copies * self._whole

    def blocks(self, first: int = 0, stop: int | None = None) -> Iterator[Places]:
        stop = len(self) if stop is None else stop
        for start in range(first, stop, PLACES_A_CHUNK):
            row = start % self._whole
            yield from self._source.blocks(row, row + PLACES_A_CHUNK)

    def phases(self, rows: IntArray) -> UInt8Array:
        return self._source.phases(rows % self._whole)

    def take(self, rows: NDArray[np.integer[Any]]) -> Places:
        return self._source.take(rows % self._whole)


class _SameArea(OpenAreas):
    """A store that stands for several stores of every area."""

    def __init__(self, store: Path, files: tuple[str, ...], copies: int) -> None:
        super().__init__([store], files)
        ((places, ground),) = self._areas
        self._areas = [(_Again(places, copies), ground)]

    def shard(self, part: Part) -> LocalShard:
        return super().shard(replace(part, area=0))


class _Search:
    """A photo, and a store that stands for many."""

    def __init__(self, terrain: HeightField, store: Store, runner: Runner, seed: int) -> None:
        self._terrain = terrain
        self._runner = runner
        self._row = store.path.stat().st_size / len(store)
        self._path = store.path
        self._files = store.header.dem_files
        self._places = store.places()
        eyes = store.eyes()
        east_m, north_m = eyes.easting_m, eyes.northing_m
        box_m = float(east_m.min()), float(north_m.min()), float(east_m.max()), float(north_m.max())
        self._km2 = square_km(box_m)
        (query,) = make_queries(terrain, box_m, 1, seed)
        self._rays = Rays.of(query.skyline, MatchConfig().fov_sd_share, finds_fov=True)

    def rows(self, km2: float) -> Sequence[Row]:
        """Return the figures of an area, by process."""
        areas = max(1, round(km2 / _AREA_KM2))
        copies = max(1, round(km2 / areas / self._km2))
        frames = [Frame.local(lon=-170.0 + 340.0 * k / areas, lat=45.0) for k in range(areas)]
        frames = frames if areas > 1 else []
        places = _Again(self._places, copies)
        shard = LocalShard(places, ground_of(self._terrain))
        here = JoinedShards([[shard]] * areas, frames)
        opening: Opening[OpenAreas] = Opening(
            (self._path, copies), partial(_SameArea, self._path, self._files, copies)
        )
        far = distant_shards(self._runner, opening, [len(places)] * areas)
        at_once = 2 * self._runner.workers
        there = Retriever(JoinedShards(far, frames, at_once))
        for warming in (JoinedShards([[shard]]), JoinedShards(far[:1], at_once=at_once)):
            self._found(Retriever(warming))  # Each process opens the store and the DEM.
        km2 = areas * copies * self._km2
        about = {"km2": km2, "areas": areas, "places": len(here), "bytes": len(here) * self._row}
        one, one_s, (alone, *_) = self._measured(Retriever(here))
        whole = about | {"process": "one", **alone, "seconds": one_s}
        spread, spread_s, by_process = self._measured(there)
        busiest = max(figures["cpu_seconds"] for figures in by_process[1:])
        share = about | {"bytes": about["bytes"] / self._runner.workers, "seconds": spread_s}
        rows = [whole | {"equal": True, "times_as_fast": 1.0}]
        for number, figures in enumerate(by_process):
            rows.append(share | {"process": f"worker {number}", **figures})
        took = by_process[0]["cpu_seconds"] + busiest
        rows[1] |= {
            "process": "asking",
            "bytes": 0,
            "equal": _are_equal(one, spread),
            "times_as_fast": alone["cpu_seconds"] / took,
        }
        killed, killed_s = self._killed(there, 0.5 * spread_s)
        again = {"process": "asking, a worker killed", "seconds": killed_s}
        return [*rows, about | again | {"equal": _are_equal(one, killed)}]

    def _measured(self, retriever: Retriever) -> tuple[Poses, float, list[dict[str, float]]]:
        """Search; return the short list, its seconds, and the cost to each process.

        Costs are processor seconds and peaks of memory: this process's first, then the workers'.
        """
        before = self._usage()
        found, timing = timed(partial(self._found, retriever))
        after = self._usage()
        costs = [
            {"cpu_seconds": now[0] - then[0], "peak_bytes": now[1]}
            for then, now in zip(before, after, strict=True)
        ]
        return found, timing.seconds, costs

    def _usage(self) -> list[tuple[float, int]]:
        workers = self._runner.client.run(_usage)
        return [_usage(), *(workers[address] for address in sorted(workers))]

    def _killed(self, retriever: Retriever, after_s: float) -> tuple[Poses, float]:
        """Search while a worker is killed; return the short list and its seconds."""
        pids = self._runner.client.run(os.getpid)
        victim = threading.Timer(after_s, os.kill, (min(pids.values()), signal.SIGKILL))
        victim.start()
        found, timing = timed(partial(self._found, retriever))
        victim.join()
        return found, timing.seconds

    @one_blas_thread()
    def _found(self, retriever: Retriever) -> Poses:
        return retriever.shortlist(self._rays, _LISTED)


def _usage() -> tuple[float, int]:
    """Return a process's processor time and greatest memory so far."""
    return time.process_time(), peak_bytes() or 0


def _are_equal(one: Poses, other: Poses) -> bool:
    """Return whether poses are equal to the bit."""
    names = ("easting_m", "northing_m", "grid_heading_deg", "pitch_deg", "fov_deg", "cost")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)
