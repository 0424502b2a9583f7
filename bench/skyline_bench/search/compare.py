"""The comparison: every matcher searches every store that it can read, for the same queries."""

import logging
import math
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

from skyline.arrays import Progress
from skyline.build.plans import map_bounds
from skyline.errors import InputError
from skyline.geodesy import Bounds, Rectangle
from skyline.match.matcher import FULL
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import Row
from skyline_bench.queries.kinds import KINDS, STRANGERS, distance_m, make_kind
from skyline_bench.search.specs import BuiltStore, StoreSpec, middle_deg
from skyline_bench.search.summary import groups, summarize
from skyline_bench.search.trials import MATCHERS, Area, Trial, open_searcher, searched_by

_log = logging.getLogger(__name__)

_QUICK_M, _QUICK_KM2 = 3000.0, 2.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """Stores x queries."""

    stores: tuple[StoreSpec, ...]
    matchers: tuple[str, ...] = (FULL,)  # Of `skyline_bench.search.trials.MATCHERS`
    kinds: tuple[str, ...] = ("plain",)  # Names of `skyline_bench.queries.kinds.KINDS`
    queries: int = 100  # Of each kind
    # West, south, east, north of the area; by default all of the DEM, or what a given store covers.
    bounds_deg: Bounds | None = None
    # Squares that are searched, and radii of circles; the whole area is searched as well.
    areas_km2: tuple[float, ...] = ()
    near_km: tuple[float, ...] = ()
    by_thirds: bool = False  # Whether queries are grouped by thirds of their distances
    seed: int = 0  # Of the queries

    def __post_init__(self) -> None:
        for noun, names, known in (
            ("matcher", self.matchers, MATCHERS),
            ("kind of queries", self.kinds, tuple(KINDS)),
        ):
            for name in names:
                if name not in known:
                    raise InputError(f"{noun} is {name!r}; expected one of {', '.join(known)}")
        searched = {searched_by(name) for name in self.matchers}
        # A store that no matcher searches is not built.
        stores = tuple(
            spec
            for spec in dict.fromkeys(self.stores)
            if spec.path is not None or spec.holds in searched
        )
        if not stores:
            raise InputError("there is no store to match; give a spacing or a store")
        object.__setattr__(self, "stores", stores)

    def quick(self, terrain: HeightField) -> "Comparison":
        """Return a version of two minutes at most: three queries, a store a planner, 3 x 3 km.

        A store that is given keeps its area.
        """
        small = replace(
            self,
            queries=min(self.queries, 3),
            areas_km2=(min(_QUICK_KM2, *self.areas_km2),) if self.areas_km2 else (),
            near_km=(),
        )
        if any(spec.path is not None for spec in self.stores):
            return small
        first = {(spec.planner, spec.holds): spec for spec in reversed(self.stores)}
        west, south, east, north = map_bounds(terrain, self.bounds_deg)
        size_m = min(east - west, _QUICK_M), min(north - south, _QUICK_M)
        return replace(
            small,
            stores=tuple(spec for spec in self.stores if spec in first.values()),
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
        """Return the areas that are searched for each query, the whole area last."""
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


def measure(
    terrain: HeightField,
    comparison: Comparison,
    folder: Path,
    progress: Progress,
    strange: HeightField | None = None,
) -> tuple[list[Row], list[BuiltStore]]:
    """Search every store with every matcher that can search it, for the same queries.

    The comparison has been checked. Return a row for each store, matcher, kind of queries, area
    searched and group of queries, and the stores. Stores are kept in ``folder``; a store that is
    there is not built again. Position errors are those of the best candidate, whether or not it is
    an answer; a query without any candidate counts as wrong by half of the area's diagonal. Heading
    errors are those of the right answers.
    """
    stores = [
        spec.build(terrain, folder, comparison.bounds_deg, progress) for spec in comparison.stores
    ]
    given = next((store for store in stores if store.spec.path is not None), None)
    area_m = map_bounds(terrain, comparison.bounds_deg)
    if given is not None and comparison.bounds_deg is None:
        area_m = given.area_m(terrain)
    areas = comparison.areas(area_m)
    miss_m = math.hypot(area_m[2] - area_m[0], area_m[3] - area_m[1]) / 2.0
    queries = {
        kind: make_kind(kind, terrain, area_m, comparison.queries, comparison.seed, strange)
        for kind in comparison.kinds
    }

    keys = [
        (kind, index, area)
        for kind, some in queries.items()
        for index in range(len(some))
        for area in areas
    ]
    rows, seed = list[Row](), comparison.seed
    for store, matcher in product(stores, comparison.matchers):
        if searched_by(matcher) != store.holds:
            continue
        found = dict[tuple[str, int, Area], Trial]()
        with open_searcher(matcher, store.path, terrain) as searcher:
            for kind, index, area in keys:
                query, is_strange = queries[kind][index], kind == STRANGERS
                narrowing = None
                if not is_strange:
                    narrowing = area.about(query[0].truth, area_m, terrain, seed)
                found[kind, index, area] = searcher.trial(query, narrowing, strange=is_strange)
                progress(len(found), len(keys))
        for kind, area in product(queries, areas):
            members = groups([distance_m(one) for one in queries[kind]], comparison.by_thirds)
            for group, numbers in members.items():
                rows.append(
                    {
                        "matcher": matcher,
                        "queries": kind,
                        "search": area.name,
                        "km2": area.km2,
                        "group": group,
                        **summarize([found[kind, index, area] for index in numbers], miss_m, seed),
                        **store.figures(),
                    }
                )
    return rows, stores
