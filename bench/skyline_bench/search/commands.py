"""The commands of ``search``: stores x matchers x queries, and what each compares by default."""

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from textwrap import fill
from typing import Annotated

import numpy as np
from typer import Option

from skyline import Narrowing
from skyline.arrays import Progress
from skyline.build.plans import map_bounds
from skyline.cli.console import parse_bounds, progress_bar
from skyline.errors import InputError, entry_named
from skyline.geodesy import Bounds, Rectangle
from skyline.match.matcher import FULL
from skyline.paper.plan import PlanConfig
from skyline.paper.strategies import STRATEGIES
from skyline.store.format import PLACES, RENDERINGS
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline_bench import options
from skyline_bench.measuring import Row, write_record
from skyline_bench.options import Floats, Names
from skyline_bench.queries import kinds
from skyline_bench.queries.synthetic import Truth
from skyline_bench.search import trials
from skyline_bench.search.stores import BuiltStore, StoreSpec, middle_deg

_log = logging.getLogger(__name__)

_GRIDS_M = (1024.0, 512.0, 256.0, 128.0)
_THRESHOLDS_PX = (12.0, 6.0, 3.0)
"""Of the paper's planner: from few renderings to many."""
_FOUND = """n within_200m within_200m_low within_200m_high within_1km median_m mean_m answered
    precision query_s"""
_QUICK_M, _QUICK_KM2 = 3000.0, 2.0
_HELP_COLUMNS = 78
"""Help keeps the lines of later paragraphs, and terminals have 80 columns."""


@dataclass(frozen=True, slots=True)
class Search:
    """A comparison: every matcher searches every store that it can read, for the same queries."""

    about: str  # The help text
    takes: str  # How long the whole comparison takes on 2 cores without a GPU
    columns: str  # Printed; rows of groups are printed where "group" is among them
    stores: tuple[StoreSpec, ...] = (StoreSpec(),)
    matchers: tuple[str, ...] = (FULL,)  # Of `skyline_bench.search.trials.MATCHERS`
    kinds: tuple[str, ...] = ("plain",)  # Names of `skyline_bench.queries.kinds.KINDS`
    queries: int = 100  # Of each kind
    areas_km2: tuple[float, ...] = ()  # Squares that are searched, beside the whole area
    by_thirds: bool = False  # Whether queries are grouped by thirds of their distances
    in_middle: bool = True  # Whether the area is by default 5 x 10 km in the DEM's middle
    # West, south, east, north of the area; by default all of the DEM, or what a given store covers.
    bounds_deg: Bounds | None = None
    seed: int = 0  # Of the queries

    def checked(self, terrain: HeightField) -> "Search":
        """Return the search without stores that no matcher searches.

        Raises `InputError` unless every store can be built or opened, and is searched.
        """
        for name in self.kinds:
            entry_named("kind of queries", name, kinds.KINDS)
        for name in self.matchers:
            entry_named("matcher", name, dict.fromkeys(trials.MATCHERS))
        searched = {trials.searched_by(name) for name in self.matchers}
        stores = [one for one in dict.fromkeys(self.stores) if one.path or one.holds in searched]
        if not stores:
            raise InputError("there is no store to match; give a spacing or a store")
        if len({spec.name for spec in stores}) < len(stores):
            raise InputError("two stores have one name; rename the file of one")
        for spec in stores:
            spec.check(terrain, self.bounds_deg)
            if spec.path and (held := BuiltStore.read(spec, spec.path).holds) not in searched:
                raise InputError(
                    f"{spec.path} holds {held}, which none of {', '.join(self.matchers)} searches; "
                    "name another matcher"
                )
        return replace(self, stores=tuple(stores))

    def quick(self, terrain: HeightField) -> "Search":
        """Return a version of two minutes at most: three queries, a store a planner, 3 x 3 km.

        A store that is given keeps its area.
        """
        areas_km2 = (min(_QUICK_KM2, *self.areas_km2),) if self.areas_km2 else ()
        small = replace(self, queries=min(self.queries, 3), areas_km2=areas_km2)
        if any(spec.path for spec in self.stores):
            return small
        first = {(spec.planner, spec.holds): spec for spec in reversed(self.stores)}
        west, south, east, north = map_bounds(terrain, self.bounds_deg)
        size_m = min(east - west, _QUICK_M), min(north - south, _QUICK_M)
        return replace(
            small,
            stores=tuple(spec for spec in self.stores if spec in first.values()),
            bounds_deg=middle_deg(terrain, size_m, self.bounds_deg),
        )

    def measure(
        self,
        terrain: HeightField,
        folder: Path,
        progress: Progress,
        strange: HeightField | None = None,
    ) -> tuple[list[Row], list[BuiltStore]]:
        """Search every store with every matcher that can search it, for the same queries.

        Return a row for each store, matcher, kind of queries, area searched and group of queries,
        and the stores, which are kept in ``folder``; a store that is there is not built again.
        Position errors are those of the best candidate, whether or not it is an answer; a query
        without any candidate counts as wrong by half of the area's diagonal. Heading errors are
        those of the right answers.
        """
        given = [BuiltStore.read(spec, spec.path) for spec in self.stores if spec.path]
        bounds_deg = self.bounds_deg or next((one.bounds_deg for one in given), None)
        stores = [spec.build(terrain, folder, bounds_deg, progress) for spec in self.stores]
        area_m = map_bounds(terrain, bounds_deg)
        width_m, height_m = area_m[2] - area_m[0], area_m[3] - area_m[1]
        whole_km2, miss_m = width_m * height_m / 1e6, math.hypot(width_m, height_m) / 2.0
        large = [f"{km2:g} km2" for km2 in self.areas_km2 if km2 >= whole_km2]
        if large:
            names = ", ".join(large)
            _log.warning("left out, since the store covers %.0f km2: %s", whole_km2, names)
        areas = {f"{km2:g} km2": km2 for km2 in sorted(self.areas_km2) if km2 < whole_km2}
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
                    query, is_strange = queries[kind][index], kind == kinds.STRANGERS
                    narrowing = None
                    if area != trials.ALL and not is_strange:
                        truth = query[0].truth
                        narrowing = _square(truth, areas[area], area_m, terrain, self.seed)
                    trial = trials.tried(opened, query, narrowing, strange=is_strange)
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
    """Return a square within an area that holds a query's place anywhere."""
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


def _plans(strategies: Names, thresholds_px: Floats, seed: int = 0) -> list[StoreSpec]:
    """Return the paper's plans: of all thresholds where only strategies are named, or none."""
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
        f"""store matcher queries search places build_cpu_s bytes {_FOUND} query_cpu_s
        lost_by_search lost_to_likeness""",
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
        """store renderings bytes build_s matcher queries search group from_m to_m mean_m mean_m_low
        mean_m_high within_200m query_s""",
        (
            *_grids(RENDERINGS),
            *_plans(["lpov"], None),
            *_grids(),
            *_planned(1000, 4000, 16_000, None),
        ),
        (trials.PAPER, FULL),
        by_thirds=True,
    ),
    "placing": Search(
        """Placing: how many queries uniform grids and planned places find.

        The claimed loss is the share of the views that the planner expects to be lost over the
        area; a query is lost that is not found within 1 km.""",
        "an hour",
        f"store places bytes build_cpu_s=cpu_s search group=skyline {_FOUND} claimed_loss lost",
        (*_grids(spacings_m=(80.0, 40.0, 20.0)), *_planned(2_000, 8_000, 32_000, None)),
        queries=150,
        in_middle=False,
    ),
    "same-place": Search(
        """Photos of one place: how often one of them finds it, and how often all together.

        Three photos are taken at each place. Once more, the last photo of each place is
        exchanged for a stranger: one of another place. A photo is named that does not belong to
        the others, as the matcher finds; with a stranger, the column is of the stranger.""",
        "20 minutes",
        f"store queries group {_FOUND} radius_holds named",
        kinds=kinds.SAME_PLACE,
        queries=30,
        by_thirds=True,
    ),
    "strangers": Search(
        """Skylines of other terrain (--strange): how many a store answers, and how surely.""",
        "10 minutes",
        "store group n answered highest_confidence query_s",
        kinds=("strangers",),
    ),
}


def command_of(name: str, search: Search) -> Callable[..., None]:
    """Return the command of a search; all of them have the same options."""

    def command(
        dem: options.Dems,
        bounds: Annotated[
            str | None, Option(metavar="W,S,E,N", help="The area, degrees (WGS 84).")
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
            Option(help=f"Of the paper's plans, of {', '.join(STRATEGIES)}; by default lpov."),
        ] = None,
        store: Annotated[
            list[Path] | None, Option(help="Search an existing store; repeatable.")
        ] = None,
        matcher: Annotated[
            Names, Option(help=f"Repeatable, of {', '.join(trials.MATCHERS)}.")
        ] = None,
        kind: Annotated[Names, Option(help=f"Of queries, of {', '.join(kinds.KINDS)}.")] = None,
        area: Annotated[
            Floats, Option(min=0.01, metavar="KM2", help="Search such squares too; repeatable.")
        ] = None,
        strange: Annotated[
            Names, Option(metavar="DEM", help="Other terrain, for strangers; repeatable.")
        ] = None,
        queries: Annotated[
            int, Option(min=3 if search.by_thirds else 1, help="Of each kind, or places of photos.")
        ] = search.queries,
        folder: options.Folder = None,
        json_file: options.JsonFile = None,
        seed: options.Seed = 0,
        quick: options.Quick = False,
        crs: options.Crs = None,
    ) -> None:
        terrain = read_dem(dem, DemOptions(crs=crs))
        stores = [StoreSpec(path=path) for path in store or ()]
        stores += [*_grids(RENDERINGS, spacing or ()), *_plans(strategy, threshold_px, seed)]
        stores += [*_grids(spacings_m=spacing or ()), *_planned(*(places or ()))]
        bounds_deg = None if bounds is None else parse_bounds(bounds)
        if bounds_deg is None and search.in_middle and not store:
            bounds_deg = middle_deg(terrain)
        asked = replace(
            search,
            stores=tuple(stores) or search.stores,
            matchers=tuple(matcher or search.matchers),
            kinds=tuple(kind or search.kinds),
            queries=queries,
            bounds_deg=bounds_deg,
            areas_km2=tuple(area or ()),
            seed=seed,
        )
        # Before any folder is made.
        asked = (asked.quick(terrain) if quick else asked).checked(terrain)
        other = read_dem(strange) if strange else None
        with (
            options.store_folder(folder) as place,
            progress_bar("building and matching") as progress,
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
        by_group = "group" in search.columns
        options.print_rows(
            [row for row in rows if by_group or row["group"] == trials.ALL], search.columns
        )
        summary = {}
        if name == "uniform-adaptive":
            summary["against_uniform"] = trials.against_uniform(rows)
            options.print_rows(summary["against_uniform"])
        write_record(json_file, name, rows, summary)

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
