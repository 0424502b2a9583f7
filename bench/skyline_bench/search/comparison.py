"""A comparison of matchers and stores by the same queries."""

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, product
from pathlib import Path

import numpy as np

from skyline import Narrowing
from skyline.errors import InputError, entry_named
from skyline.geodesy.bounds import Bounds
from skyline.geodesy.map_frame import Rectangle
from skyline.match.matcher import FULL
from skyline.progress import Progress
from skyline.store.layout import PLACES
from skyline.survey.plans import map_bounds
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring import Row, square_km
from skyline_bench.queries import kinds
from skyline_bench.queries.kinds import Query
from skyline_bench.queries.synthetic import Truth
from skyline_bench.search import trials
from skyline_bench.search.stores import BuiltStore, StoreSpec, equal_grid


@dataclass(frozen=True, slots=True)
class Comparison:
    """A comparison of matchers and stores by the same queries.

    Every matcher searches every store that it can read.
    """

    about: str  # The help text
    takes: str  # How long the whole comparison takes on 2 cores without a GPU
    columns: str  # Printed; rows of groups are printed where "group" is among them
    stores: tuple[StoreSpec, ...] = (StoreSpec(),)
    matchers: tuple[str, ...] = (FULL,)  # Names in `skyline_bench.search.trials.MATCHERS`
    kinds: tuple[str, ...] = ("plain",)  # Names in `skyline_bench.queries.kinds.KINDS`
    queries: int = 100  # Number of queries of each kind
    areas_km2: tuple[float, ...] = ()  # Squares that are searched, beside the whole area
    by_thirds: bool = False  # Whether queries are grouped by thirds of their distances
    holds_plans_to_grids: bool = False  # Whether each plan is compared with an equally large grid
    with_posteriors: bool = False  # Whether posteriors are held to the true places
    in_middle: bool = True  # Whether the area is by default 5 x 10 km in the DEM's middle
    # West, south, east, north of the area; by default all of the DEM, or what a given store covers.
    bounds_deg: Bounds | None = None
    seed: int = 0  # Seed of the queries

    def shown(self, rows: Sequence[Row]) -> list[Row]:
        """Return the printed rows, with groups only where `columns` name them."""
        by_group = "group" in self.columns
        return [row for row in rows if by_group or row["group"] == trials.ALL]

    def area_deg(self) -> Bounds | None:
        """Return the bounds of the area; None for all of the DEM."""
        given = (BuiltStore.read(spec, spec.path) for spec in self.stores if spec.path)
        return self.bounds_deg or next((one.bounds_deg for one in given), None)

    def check(self, terrain: HeightField) -> None:
        """Raise `InputError` unless all stores, matchers, kinds and areas take part.

        Every store must exist or be buildable, and have a matcher that searches it. Every matcher
        must have a store, and each area must be a part of the whole.
        """
        for name in self.kinds:
            entry_named("kind of queries", name, kinds.KINDS)
        if len({spec.name for spec in self.stores}) < len(self.stores):
            raise InputError("two stores have one name; rename the file of one")
        searched = {name: trials.searched_by(name) for name in self.matchers}
        for spec in self.stores:
            spec.check(terrain, self.bounds_deg)
            if spec.held not in searched.values():
                raise InputError(
                    f"{spec.path or spec.name} holds {spec.held}, which none of "
                    f"{', '.join(searched)} searches; name another matcher"
                )
        held = {spec.held for spec in self.stores}
        for name, holds in searched.items():
            if holds not in held:
                raise InputError(
                    f"matcher {name} searches {holds}, and no store holds them; name another "
                    "matcher, or a store for this one"
                )
        if self.areas_km2:
            self._check_areas(terrain, held)

    def _check_areas(self, terrain: HeightField, held: Container[str]) -> None:
        """Check that a store can be searched in part.

        Raises `InputError` unless it can, for all kinds of queries.
        """
        if PLACES not in held:
            raise InputError("--area needs a store of places: renderings are searched whole")
        whole = [kind for kind in self.kinds if kind in kinds.SEARCHED_WHOLE]
        if whole:
            raise InputError(
                f"--area is of queries of one photo each; {', '.join(whole)} are searched whole"
            )
        whole_km2 = self.whole_km2(terrain)
        largest_km2 = max(self.areas_km2)
        if largest_km2 >= whole_km2:
            raise InputError(
                f"--area {largest_km2:g} is not less than the {whole_km2:.3g} km2 searched in all; "
                "give a smaller one, or larger --bounds"
            )

    def _built(self, terrain: HeightField, folder: Path, progress: Progress) -> list[BuiltStore]:
        """Return the stores, each plan with the grid that it is held to."""
        bounds_deg = self.area_deg()
        stores = [spec.build(terrain, folder, bounds_deg, progress) for spec in self.stores]
        if not self.holds_plans_to_grids:
            return stores
        with_grids = list[BuiltStore]()
        for store in stores:
            with_grids.append(store)
            known = (*stores, *with_grids)
            if store.is_plan and not any(store.is_held_to(one) for one in known):
                grid = equal_grid(store, terrain, bounds_deg)
                with_grids.append(grid.build(terrain, folder, bounds_deg, progress))
        return with_grids

    def whole_km2(self, terrain: HeightField) -> float:
        """Return the size of the area."""
        return square_km(map_bounds(terrain, self.area_deg()))

    def measure(
        self,
        terrain: HeightField,
        folder: Path,
        progress: Progress,
        strange: HeightField | None = None,
    ) -> tuple[list[Row], list[BuiltStore]]:
        """Search every store with every matcher for the same queries.

        A matcher searches the stores that it can read. Returns a row for each store, matcher, kind
        of queries, area searched and group of queries, and the stores. Stores are kept in
        ``folder``, and not built again. The best candidate's error of position counts, whether or
        not it is an answer. A query without any candidate counts as wrong by half of the area's
        diagonal. Only right candidates have heading errors.
        """
        stores = self._built(terrain, folder, progress)
        area_m = map_bounds(terrain, self.area_deg())
        miss_m = math.hypot(area_m[2] - area_m[0], area_m[3] - area_m[1]) / 2.0
        queries = {
            kind: kinds.make_kind(kind, terrain, area_m, self.queries, self.seed, strange)
            for kind in self.kinds
        }
        rows = list[Row]()
        for store, matcher in product(stores, self.matchers):
            if trials.searched_by(matcher) != store.holds:
                continue
            km2 = self._searched_km2(store, square_km(area_m))
            found = self._trials(store, matcher, queries, km2, terrain, progress)
            for (kind, area), some in found.items():
                about = {"matcher": matcher, "queries": kind, "search": area, "km2": km2[area]}
                away_m = [kinds.distance_m(one) for one in queries[kind]]
                for group, members in trials.groups(away_m, self.by_thirds).items():
                    figures = trials.summarize([some[k] for k in members], miss_m, self.seed)
                    rows.append({**about, "group": group, **figures, **store.figures})
        return rows, stores

    def _searched_km2(self, store: BuiltStore, whole_km2: float) -> dict[str, float]:
        """Return the sizes of the areas that are searched in a store, by name.

        Only the full matcher can narrow its search.
        """
        parts_km2 = sorted(self.areas_km2) if store.holds == PLACES else ()
        return {f"{km2:g} km2": km2 for km2 in parts_km2} | {trials.ALL: whole_km2}

    def _trials(
        self,
        store: BuiltStore,
        matcher: str,
        queries: Mapping[str, Sequence[Query]],
        searched_km2: Mapping[str, float],
        terrain: HeightField,
        progress: Progress,
    ) -> dict[tuple[str, str], list[trials.Trial]]:
        """Search a store for all queries; return trials by kind and area."""
        area_m = map_bounds(terrain, self.area_deg())
        found = {key: list[trials.Trial]() for key in product(queries, searched_km2)}
        asked = [(kind, query) for kind, some in queries.items() for query in some]
        steps = count(1)
        with trials.open_matcher(matcher, store.path, terrain) as opened:
            for (kind, query), (area, km2) in product(asked, searched_km2.items()):
                is_strange = kind == kinds.STRANGERS
                narrowing = None
                if area != trials.ALL and not is_strange:
                    narrowing = _square(query[0].truth, km2, area_m, terrain, self.seed)
                trial = trials.tried(
                    opened,
                    store.path,
                    query,
                    narrowing,
                    strange=is_strange,
                    with_posterior=self.with_posteriors,
                )
                found[kind, area].append(trial)
                progress(next(steps), len(asked) * len(searched_km2))
        return found


def _square(
    truth: Truth, km2: float, area_m: Rectangle, terrain: HeightField, seed: int
) -> Narrowing:
    """Return a random square of an area around a query's place."""
    place = np.array([truth.easting_m, truth.northing_m])
    entropy = [seed, round(1e6 * km2), *np.abs(place).astype(int).tolist()]
    low, high = np.array(area_m).reshape(2, 2)
    side_m = np.minimum(1e3 * math.sqrt(km2), high - low)
    within = np.maximum(low, place - side_m), np.minimum(high - side_m, place)
    corner = np.random.default_rng(entropy).uniform(*within)
    lon, lat = terrain.frame.to_lonlat(*np.stack([corner, corner + side_m], axis=1))
    return Narrowing(bounds_deg=(float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])))
