"""The comparison: every store is searched by every matcher that can, for the same queries."""

import functools
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from skyline.errors import InputError
from skyline.geodesy import Bounds, Rectangle
from skyline.pipeline.jobs import Progress
from skyline.pipeline.matchers import FULL
from skyline.planning.uniform import map_bounds
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import unseen
from skyline_bench.measuring.workers import Crew, crew
from skyline_bench.queries.kinds import KINDS, Query, distance_m, make_kind
from skyline_bench.search.specs import BuiltStore, StoreSpec, middle_deg, quick_specs
from skyline_bench.search.summary import groups, summarize
from skyline_bench.search.trials import ABOUT, PAPER, Area, Searcher, Trial, search, searched_by

_log = logging.getLogger(__name__)

_QUICK_M = 3000.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """Stores x queries."""

    stores: tuple[StoreSpec, ...]
    matchers: tuple[str, ...] = (FULL,)  # Names of `skyline_bench.search.trials.ABOUT`
    kinds: tuple[str, ...] = ("plain",)  # Names of `skyline_bench.queries.kinds.KINDS`
    queries: int = 100  # Of each kind
    # West, south, east, north of the area; by default all of the DEM, or what a given store covers.
    bounds_deg: Bounds | None = None
    # Squares that are searched, and radii of circles; the whole area is searched as well.
    areas_km2: tuple[float, ...] = ()
    near_km: tuple[float, ...] = ()
    by_thirds: bool = False  # Whether queries are grouped by thirds of their distances
    seed: int = 0  # Of the queries
    # Processes at work, each with one thread; by default this process with all of them.
    workers: int | None = None

    def __post_init__(self) -> None:
        for name, value, least in (
            ("the number of queries", self.queries, 3 if self.by_thirds else 1),
            ("seed", self.seed, 0),
            ("workers", 1 if self.workers is None else self.workers, 1),
        ):
            if value < least:
                raise InputError(f"{name} is {value}; expected {least} or more")
        for name, unit, sizes in (
            ("area", "km2", self.areas_km2),
            ("radius", "km", self.near_km),
        ):
            for size in sizes:
                if not 0.0 < size < math.inf:
                    raise InputError(f"{name} is {size} {unit}; expected more than 0")
        known: dict[str, tuple[tuple[str, ...], Mapping[str, object]]] = {
            "matcher": (self.matchers, ABOUT), "kind of queries": (self.kinds, KINDS),
        }  # fmt: skip
        for what, (names, these) in known.items():
            for name in names:
                if name not in these:
                    raise InputError(f"{what} is {name!r}; expected one of {', '.join(these)}")
        searched = {searched_by(name) for name in self.matchers}
        # Two processes must not build one store, and none is built that no matcher searches.
        stores = tuple(
            spec
            for spec in dict.fromkeys(self.stores)
            if spec.path is not None or spec.holds in searched
        )
        if not stores:
            raise InputError("there is no store to match; give a spacing or a store")
        object.__setattr__(self, "stores", stores)

    def quick(self, terrain: HeightField) -> "Comparison":
        """Return a version of two minutes at most: three queries, the cheapest stores, 3 x 3 km.

        A store that is given keeps its area.
        """
        small = replace(
            self,
            queries=min(self.queries, 3),
            areas_km2=tuple(sorted(self.areas_km2)[:1]),
            near_km=(),
        )
        if any(spec.path is not None for spec in self.stores):
            return small
        west, south, east, north = map_bounds(terrain, self.bounds_deg)
        size_m = min(east - west, _QUICK_M), min(north - south, _QUICK_M)
        share = size_m[0] * size_m[1] / ((east - west) * (north - south))
        return replace(
            small,
            stores=quick_specs(self.stores, share),
            bounds_deg=middle_deg(terrain, size_m, self.bounds_deg),
        )

    def check(self, terrain: HeightField) -> None:
        """Raise `InputError` unless every store can be built or opened, and is searched."""
        map_bounds(terrain, self.bounds_deg)
        for spec in self.stores:
            spec.check(terrain, self.bounds_deg)
            if spec.path is not None:
                store = spec.build(terrain, spec.path.parent, None)
                if store.holds not in {searched_by(name) for name in self.matchers}:
                    raise InputError(
                        f"{spec.path} holds {store.holds}, which none of "
                        f"{', '.join(self.matchers)} searches; name another matcher"
                    )

    def areas(self, area_m: Rectangle) -> list[Area]:
        """Return what is searched for each query, the whole area last."""
        west, south, east, north = area_m
        whole = Area("all", (east - west) * (north - south) / 1e6)
        areas = [Area(f"near {km:g} km", math.pi * km**2, None, 1e3 * km) for km in self.near_km]
        areas += [Area(f"{km2:g} km2", km2, 1e3 * math.sqrt(km2)) for km2 in self.areas_km2]
        larger = [area.name for area in areas if area.km2 >= whole.km2]
        if larger:
            _log.warning(
                "left out, since the store covers %.0f km2: %s", whole.km2, ", ".join(larger)
            )
        areas = [area for area in areas if area.km2 < whole.km2]
        return [*sorted(areas, key=lambda area: (area.km2, area.name)), whole]


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """What every worker holds."""

    terrain: HeightField
    comparison: Comparison
    folder: Path
    area_m: Rectangle | None = None
    queries: Mapping[str, Sequence[Query]] = field(default_factory=dict)
    progress: Progress | None = None  # Of this process's own work


_Job = tuple[BuiltStore, str]
"""A store, and a matcher that searches it."""


def measure(
    terrain: HeightField,
    comparison: Comparison,
    folder: Path,
    progress: Progress = unseen,
    strange: HeightField | None = None,
) -> tuple[list[Row], list[BuiltStore]]:
    """Search every store with every matcher that can search it, for the same queries.

    Return a row for each store, matcher, kind of queries, area searched and group of queries, and
    the stores.
    Stores and trials are kept in ``folder``: what is there already is not done again. Position
    errors are those of the best candidate, whether or not the matcher stands by it; a query
    without any counts as wrong by half of the area's diagonal. Heading errors are those of the
    right answers.
    """
    comparison.check(terrain)
    held = _Held(terrain, comparison, folder)
    if comparison.workers is None:
        held = replace(held, progress=progress)
    with _at_work(held, comparison.workers) as run:
        # Plans take longest, and are begun first.
        order = sorted(comparison.stores, key=lambda spec: spec.plan is None)
        built = dict[StoreSpec, BuiltStore]()
        for spec, store in run(_build, order):
            built[spec] = store
            if held.progress is None:
                progress(len(built), len(order))
    stores = [built[spec] for spec in comparison.stores]
    given = next((store for store in stores if store.spec.path is not None), None)
    area_m = map_bounds(terrain, comparison.bounds_deg)
    if given is not None and comparison.bounds_deg is None:
        area_m = given.area_m(terrain)
    queries = {
        kind: make_kind(kind, terrain, area_m, comparison.queries, comparison.seed, strange)
        for kind in comparison.kinds
    }
    pairs = [
        (store, name)
        for store in stores
        for name in comparison.matchers
        if searched_by(name) == store.holds
    ]
    found: dict[_Job, dict[str, Trial]] = {}
    with _at_work(replace(held, area_m=area_m, queries=queries), comparison.workers) as run:
        jobs = sorted(pairs, key=lambda job: (job[1] != PAPER, -job[0].renderings))
        for job, trials in run(_search, jobs):
            found[job] = trials
            if held.progress is None:
                progress(len(found), len(jobs))
    return list(_rows(comparison, area_m, queries, pairs, found)), stores


def _rows(
    comparison: Comparison,
    area_m: Rectangle,
    queries: Mapping[str, Sequence[Query]],
    pairs: Sequence[_Job],
    found: Mapping[_Job, Mapping[str, Trial]],
) -> Iterator[Row]:
    miss_m = math.hypot(area_m[2] - area_m[0], area_m[3] - area_m[1]) / 2.0
    for store, name in pairs:
        for kind, some in queries.items():
            members = groups([distance_m(query) for query in some], comparison.by_thirds)
            for area in comparison.areas(area_m):
                trials = [found[store, name][_key(kind, i, area)] for i in range(len(some))]
                for group, numbers in members.items():
                    yield {
                        "matcher": name,
                        "queries": kind,
                        "search": area.name,
                        "km2": area.km2,
                        "group": group,
                        **summarize([trials[i] for i in numbers], miss_m, comparison.seed),
                        **store.figures(),
                    }


@contextmanager
def _at_work(held: _Held, workers: int | None) -> Iterator[Crew]:
    """Give what does jobs: this process, or so many of its own."""
    if workers is not None:
        with crew(held, workers) as run:
            yield run
        return
    yield lambda work, items: ((item, work(held, item)) for item in items)


def _build(held: _Held, spec: StoreSpec) -> BuiltStore:
    return spec.build(held.terrain, held.folder, held.comparison.bounds_deg, held.progress)


def _search(held: _Held, job: _Job) -> dict[str, Trial]:
    """Return a job's trials by their keys."""
    store, name = job
    comparison, terrain, area_m = held.comparison, held.terrain, held.area_m
    assert area_m is not None

    def trial(searcher: Searcher, query: Query, area: Area, kind: str) -> Trial:
        strange = KINDS[kind].strange
        narrowing = (
            None if strange else area.about(query[0].truth, area_m, terrain, comparison.seed)
        )
        return searcher.trial(query, narrowing, strange=strange)

    asked = {
        _key(kind, index, area): functools.partial(trial, query=query, area=area, kind=kind)
        for kind, queries in held.queries.items()
        for index, query in enumerate(queries)
        for area in comparison.areas(area_m)
    }
    depends = [area_m, comparison.seed]
    return search(store, name, asked, depends, held.folder, terrain, held.progress)


def _key(kind: str, index: int, area: Area) -> str:
    return f"{kind} {index} {area.name}"
