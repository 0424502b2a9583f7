"""The commands of ``search``, and what each compares by default.

A command compares stores, matchers and queries.
"""

import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from textwrap import fill
from typing import Annotated

import numpy as np
from typer import Option

from skyline import Narrowing
from skyline.cli.options import parse_bounds
from skyline.cli.terminal import Terminal
from skyline.errors import InputError, entry_named
from skyline.geodesy.bounds import Bounds
from skyline.geodesy.map_frame import Rectangle
from skyline.match.matcher import FULL
from skyline.paper.plan import PlanConfig
from skyline.paper.planners import PLANNERS
from skyline.plugins import names_of
from skyline.progress import Progress
from skyline.store.layout import PLACES, RENDERINGS
from skyline.survey.plans import map_bounds
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline_bench import options
from skyline_bench.measuring import Row, square_km
from skyline_bench.options import Floats, Names
from skyline_bench.queries import kinds
from skyline_bench.queries.synthetic import Truth
from skyline_bench.records import write_record
from skyline_bench.search import trials
from skyline_bench.search.stores import UNIFORM, BuiltStore, StoreSpec, equal_grid, middle_deg

_GRIDS_M = (1024.0, 512.0, 256.0, 128.0)
_THRESHOLDS_PX = (12.0, 6.0, 3.0)
"""Thresholds of the paper's planner, from few renderings to many."""
_FOUND = "km2 n within_200m within_1km median_m mean_m answered precision query_s"
_QUICK_M = 3000.0
"""Sides of the square that is searched by default with ``--quick``."""
_QUICK_QUERIES = 3
AGAINST_EQUAL = """store uniform matcher queries km2 n gain_points half_points=95_%:_±_points
    error_ratio"""
_HELP_COLUMNS = 78
"""Help keeps the lines of later paragraphs, and terminals have 80 columns."""


@dataclass(frozen=True, slots=True)
class Search:
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
        bounds_deg = self.area_deg()
        stores = self._built(terrain, folder, progress)
        area_m = map_bounds(terrain, bounds_deg)
        whole_km2 = self.whole_km2(terrain)
        miss_m = math.hypot(area_m[2] - area_m[0], area_m[3] - area_m[1]) / 2.0
        areas = {f"{km2:g} km2": km2 for km2 in sorted(self.areas_km2)}
        areas[trials.ALL] = whole_km2
        queries = {
            kind: kinds.make_kind(kind, terrain, area_m, self.queries, self.seed, strange)
            for kind in self.kinds
        }
        numbers = [(kind, index) for kind, some in queries.items() for index in range(len(some))]
        rows = list[Row]()
        for store, matcher in product(stores, self.matchers):
            if trials.searched_by(matcher) != store.holds:
                continue
            # Only the full matcher can narrow its search.
            searched = areas if store.holds == PLACES else {trials.ALL: whole_km2}
            keys = [(*number, area) for number in numbers for area in searched]
            found = dict[tuple[str, int, str], trials.Trial]()
            with trials.open_matcher(matcher, store.path, terrain) as opened:
                for kind, index, area in keys:
                    query = queries[kind][index]
                    is_strange = kind == kinds.STRANGERS
                    narrowing = None
                    if area != trials.ALL and not is_strange:
                        truth = query[0].truth
                        narrowing = _square(truth, areas[area], area_m, terrain, self.seed)
                    trial = trials.tried(
                        opened,
                        query,
                        narrowing,
                        strange=is_strange,
                        with_posterior=self.with_posteriors,
                    )
                    found[kind, index, area] = trial
                    progress(len(found), len(keys))
            for kind, area in product(queries, searched):
                about = {"matcher": matcher, "queries": kind, "search": area, "km2": areas[area]}
                away_m = [kinds.distance_m(one) for one in queries[kind]]
                for group, members in trials.groups(away_m, self.by_thirds).items():
                    some = [found[kind, index, area] for index in members]
                    figures = trials.summarize(some, miss_m, self.seed)
                    rows.append({**about, "group": group, **figures, **store.figures})
        return rows, stores


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


def _grids(holds: str = PLACES, spacings_m: Sequence[float] = _GRIDS_M) -> list[StoreSpec]:
    return [StoreSpec(holds, metres) for metres in spacings_m]


def _planned(*numbers: int | None) -> list[StoreSpec]:
    return [StoreSpec(places=number) for number in numbers]


def _few(stores: Sequence[StoreSpec]) -> list[StoreSpec]:
    """Return the first store of each planner and kind.

    A plan's own grid is built with it, so no other grid is searched beside a plan.
    """
    first = {(spec.planner, spec.holds): spec for spec in reversed(stores)}
    planned = {holds for planner, holds in first if planner != UNIFORM}
    return [
        spec
        for (planner, holds), spec in reversed(first.items())
        if planner != UNIFORM or holds not in planned
    ]


def _plans(strategies: Names, thresholds_px: Floats, seed: int = 0) -> list[StoreSpec]:
    """Return the paper's plans.

    Where only strategies are named, there is a plan for every threshold.
    """
    usual_px = _THRESHOLDS_PX if strategies else ()
    return [
        StoreSpec(RENDERINGS, plan=PlanConfig(name, threshold_px=pixels, seed=seed))
        for name in strategies or ("lpov",)
        for pixels in sorted(thresholds_px or usual_px, reverse=True)
    ]


SEARCHES: Mapping[str, Search] = {
    "matching": Search(
        """Matchers on stores of one area: how often, how near and how fast they find queries.

        The paper's matcher and correlation search uniform grids of renderings, ours planned
        places.""",
        "hours",
        f"""store places build_cpu_s bytes matcher queries {_FOUND} query_cpu_s lost_by_search
        lost_to_likeness""",
        (*_grids(RENDERINGS), *_planned(None)),
        trials.MATCHERS,
        kinds.OF_ONE_AREA,
        300,
    ),
    "uniform-adaptive": Search(
        """Uniform and adaptive stores: renderings, seconds and bytes against accuracy.

        The paper's matcher searches uniform grids of renderings and the plans of its planner;
        ours searches uniform grids of places and planned places, each of which counts as four
        renderings. Queries are grouped in thirds by the distance of their skyline.""",
        "an hour",
        """store renderings bytes build_s matcher queries km2 group n from_m to_m mean_m
        within_200m query_s""",
        (
            *_grids(RENDERINGS),
            *_plans(["lpov"], None),
            *_grids(),
            *_planned(1000, 4000, 16_000, None),
        ),
        (trials.PAPER, FULL),
        by_thirds=True,
        holds_plans_to_grids=True,
    ),
    "placing": Search(
        """Placing: how many queries uniform grids and planned places find.

        The claimed loss is the share of the views that the planner expects to be lost over the
        area. A query that is not found within 1 km is lost.""",
        "an hour",
        f"""store places bytes build_cpu_s=cpu_s queries group=skyline {_FOUND} claimed_loss
        lost""",
        (*_grids(spacings_m=(80.0, 40.0, 20.0)), *_planned(2_000, 8_000, 32_000, None)),
        queries=150,
        holds_plans_to_grids=True,
        in_middle=False,
    ),
    "same-place": Search(
        """Photos of one place: how often one of them finds it, and how often all together.

        Three photos are taken at each place. In a second round, a stranger, a photo of another
        place, replaces the last one. The column named is the share of places where the matcher
        names a photo as not belonging to the others, or the stranger where there is one.""",
        "20 minutes",
        f"store queries group {_FOUND} radius_holds named",
        kinds=kinds.SAME_PLACE,
        queries=30,
        by_thirds=True,
    ),
    "probability": Search(
        """Posteriors: how often the true place lies in the areas of 50, 80 and 95 %.

        The gain is the mean binary logarithm of how much more probable the true cell is than if
        all cells were alike. Queries without any skyline have no posterior.""",
        "20 minutes",
        "store queries km2 n posteriors in_50 in_80 in_95 gain_bits within_200m answered",
        kinds=("plain", kinds.OTHER_DEM, "occluded", "bent"),
        queries=75,
        with_posteriors=True,
    ),
    "strangers": Search(
        """Skylines of other terrain (--strange): how many a store answers, and how surely.""",
        "10 minutes",
        "store queries km2 group n answered highest_confidence query_s",
        kinds=("strangers",),
    ),
}


def command_of(name: str, search: Search) -> Callable[..., None]:
    """Return the command of a search.

    All searches have the same options.
    """

    def command(
        dem: options.Dems,
        bounds: Annotated[
            str | None,
            Option(
                metavar="W,S,E,N",
                help=f"The area, degrees (WGS 84); with --quick by default {_QUICK_M / 1e3:g} x "
                f"{_QUICK_M / 1e3:g} km in the DEM's middle.",
            ),
        ] = None,
        spacing: Annotated[
            Floats, Option(metavar="M", help="Build uniform grids, these alone; repeatable.")
        ] = None,
        places: Annotated[
            list[int] | None, Option(min=1, help="Plan about so many places; repeatable.")
        ] = None,
        threshold_px: Annotated[
            Floats, Option(help="Plan as the paper does, to so many pixels; repeatable.")
        ] = None,
        strategy: Annotated[
            Names,
            Option(help=f"Planners of the paper's plans: {', '.join(names_of(PLANNERS))} [lpov]."),
        ] = None,
        store: Annotated[
            list[Path] | None,
            Option(
                metavar="STORE.h5",
                help="Search an existing store; repeatable.",
                callback=options.read_here,
            ),
        ] = None,
        matcher: Annotated[
            Names, Option(help=f"Repeatable, of {', '.join(trials.MATCHERS)}.")
        ] = None,
        kind: Annotated[Names, Option(help=f"Of queries, of {', '.join(kinds.KINDS)}.")] = None,
        area: Annotated[
            Floats, Option(min=0.01, metavar="KM2", help="Search such squares too; repeatable.")
        ] = None,
        strange: Annotated[
            Names,
            Option(
                metavar="DEM",
                help="Other terrain, for strangers; repeatable.",
                callback=options.read_here,
            ),
        ] = None,
        queries: Annotated[
            int, Option(min=3 if search.by_thirds else 1, help="Of each kind, or places of photos.")
        ] = search.queries,
        folder: options.Folder = None,
        record: options.Record = None,
        seed: options.Seed = 0,
        quick: Annotated[bool, options.quick_with(queries=_QUICK_QUERIES)] = False,
        crs: options.Crs = None,
    ) -> None:
        terrain = read_dem(dem, DemOptions(crs=crs))
        for one in matcher or ():
            entry_named("matcher", one, dict.fromkeys(trials.MATCHERS))
        searched = {trials.searched_by(one) for one in matcher or search.matchers}
        stores = [StoreSpec(path=path) for path in store or ()]
        for holds in (RENDERINGS, PLACES):
            stores += _grids(holds, (spacing or ()) if holds in searched else ())
            stores += _plans(strategy, threshold_px, seed) if holds == RENDERINGS else ()
        stores += _planned(*(places or ()))
        if not stores:
            usual = [one for one in search.stores if one.holds in searched]
            stores = _few(usual) if quick else usual
        held = {one.held for one in stores}
        bounds_deg = None if bounds is None else parse_bounds(bounds)
        if bounds_deg is None and not store:
            if quick:
                bounds_deg = middle_deg(terrain, (_QUICK_M, _QUICK_M))
            elif search.in_middle:
                bounds_deg = middle_deg(terrain)
        asked = replace(
            search,
            stores=tuple(dict.fromkeys(stores)),
            matchers=tuple(
                matcher or (one for one in search.matchers if trials.searched_by(one) in held)
            ),
            kinds=tuple(kind or search.kinds),
            queries=queries,
            bounds_deg=bounds_deg,
            areas_km2=tuple(area or ()),
            seed=seed,
        )
        asked.check(terrain)  # Before any folder is made
        if strange and kinds.STRANGERS not in asked.kinds:
            raise InputError(f"--strange is of --kind {kinds.STRANGERS}, which is not asked for")
        other = read_dem(strange, DemOptions(crs=crs)) if strange else None
        with (
            options.store_folder(folder) as place,
            Terminal().progress("building and matching") as progress,
        ):
            rows, built = asked.measure(terrain, place, progress, other)
            if name == "placing":
                claimed = {one.spec.name: one.claimed_loss() for one in built}
                rows = [
                    {"claimed_loss": claimed[row["store"]], "lost": 1 - row["within_1km"], **row}
                    for row in rows
                ]
        if strange:
            rows = [{**row, "strange": [Path(path).name for path in strange]} for row in rows]
        options.print_rows(search.shown(rows), search.columns)
        summary = {}
        if search.holds_plans_to_grids:
            summary["against_equal"] = trials.against_equal(rows)
            options.print_rows(summary["against_equal"], AGAINST_EQUAL)
        write_record(
            record,
            rows,
            summary,
            terrain=terrain,
            bounds_deg=asked.area_deg(),
            stores={one.spec.name: one.digest for one in built},
        )

    command.__name__ = name
    about = (
        f"{search.about}\n\nStores that are named (--spacing, --places, --threshold-px, --store) "
        "are searched instead of the usual ones. A query without any candidate counts as wrong by "
        "half of the area's diagonal."
    )
    command.__doc__ = "\n\n".join(
        fill(" ".join(one.split()), _HELP_COLUMNS) for one in about.split("\n\n")
    )
    return command
