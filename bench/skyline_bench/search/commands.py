"""The commands that compare stores, matchers and queries, and what each compares by default."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Option

from skyline.cli.options import parse_bounds
from skyline.cli.terminal import Terminal
from skyline.errors import InputError, entry_named
from skyline.geodesy.bounds import Bounds
from skyline.match.matcher import FULL
from skyline.paper.plan import PlanConfig
from skyline.paper.planners import PLANNERS
from skyline.plugins import names_of
from skyline.store.layout import PLACES, RENDERINGS
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline_bench import options
from skyline_bench.measuring import Row
from skyline_bench.options import Floats, Names
from skyline_bench.queries import kinds
from skyline_bench.records import Run, write_record
from skyline_bench.search import trials
from skyline_bench.search.comparison import Comparison
from skyline_bench.search.stores import UNIFORM, BuiltStore, StoreSpec, middle_deg

_GRIDS_M = (1024.0, 512.0, 256.0, 128.0)
_THRESHOLDS_PX = (12.0, 6.0, 3.0)
"""Thresholds of the paper's planner, from few renderings to many."""
_FOUND = "km2 n within_200m within_1km median_m mean_m answered precision query_s"
_QUICK_M = 3000.0
"""Sides of the square that is searched by default with ``--quick``."""
_QUICK_QUERIES = 3
AGAINST_EQUAL = """store uniform matcher queries km2 n gain_points half_points=95_%:_±_points
    error_ratio"""


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


def _named(
    searched: Collection[str],
    paths: Sequence[Path],
    spacings_m: Sequence[float],
    plans: Sequence[StoreSpec],
    places: Sequence[int],
) -> list[StoreSpec]:
    """Return the stores that options name; grids only of what is searched."""
    stores = [StoreSpec(path=path) for path in paths]
    if RENDERINGS in searched:
        stores += _grids(RENDERINGS, spacings_m)
    stores += plans
    if PLACES in searched:
        stores += _grids(PLACES, spacings_m)
    return stores + _planned(*places)


def _usual_bounds(
    comparison: Comparison, terrain: HeightField, *, has_store: bool, quick: bool
) -> Bounds | None:
    """Return the area that is searched by default; None for all there is."""
    if has_store:
        return None
    if quick:
        return middle_deg(terrain, (_QUICK_M, _QUICK_M))
    return middle_deg(terrain) if comparison.in_middle else None


def _with_losses(rows: Sequence[Row], built: Sequence[BuiltStore]) -> list[Row]:
    """Return rows with the loss that each plan claims, and the measured one."""
    claimed = {one.spec.name: one.claimed_loss() for one in built}
    return [
        {"claimed_loss": claimed[row["store"]], "lost": 1 - row["within_1km"], **row}
        for row in rows
    ]


COMPARISONS: Mapping[str, Comparison] = {
    "matching": Comparison(
        """Matchers on stores of one area: how often, how near and how fast they find queries.

        The paper's matcher and correlation search uniform grids of renderings, ours planned
        places. Queries that our search loses are searched once more, and counted by the stage that
        loses them.""",
        "hours",
        f"""store places build_cpu_s bytes matcher queries {_FOUND} query_cpu_s lost_by_search
        lost_in lost_to_likeness""",
        (*_grids(RENDERINGS), *_planned(None)),
        trials.MATCHERS,
        kinds.OF_ONE_AREA,
        300,
    ),
    "uniform-adaptive": Comparison(
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
    "placing": Comparison(
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
    "same-place": Comparison(
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
    "probability": Comparison(
        """Posteriors: how often the true place lies in the areas of 50, 80 and 95 %.

        The gain is the mean binary logarithm of how much more probable the true cell is than if
        all cells were alike. Queries without any skyline have no posterior.""",
        "20 minutes",
        "store queries km2 n posteriors in_50 in_80 in_95 gain_bits within_200m answered",
        kinds=("plain", kinds.OTHER_DEM, "occluded", "bent"),
        queries=75,
        with_posteriors=True,
    ),
    "strangers": Comparison(
        """Skylines of other terrain (--strange): how many a store answers, and how surely.""",
        "10 minutes",
        "store queries km2 group n answered highest_confidence query_s",
        kinds=("strangers",),
    ),
}


def _report(
    record: Run | None,
    comparison: Comparison,
    rows: Sequence[Row],
    built: Sequence[BuiltStore],
    terrain: HeightField,
) -> None:
    """Print the tables of a comparison, and write its record."""
    options.print_rows(comparison.shown(rows), comparison.columns)
    summary = {}
    if comparison.holds_plans_to_grids:
        summary["against_equal"] = trials.against_equal(rows)
        options.print_rows(summary["against_equal"], AGAINST_EQUAL)
    write_record(
        record,
        rows,
        summary,
        terrain=terrain,
        bounds_deg=comparison.area_deg(),
        stores={one.spec.name: one.digest for one in built},
    )


def command_of(name: str, comparison: Comparison) -> Callable[..., None]:
    """Return the command of a comparison.

    All comparisons have the same options.
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
            int,
            Option(min=3 if comparison.by_thirds else 1, help="Of each kind, or places of photos."),
        ] = comparison.queries,
        folder: options.Folder = None,
        record: options.Record = None,
        seed: options.Seed = 0,
        quick: Annotated[bool, options.quick_with(queries=_QUICK_QUERIES)] = False,
        crs: options.Crs = None,
    ) -> None:
        terrain = read_dem(dem, DemOptions(crs=crs))
        for one in matcher or ():
            entry_named("matcher", one, dict.fromkeys(trials.MATCHERS))
        searched = {trials.searched_by(one) for one in matcher or comparison.matchers}
        plans = _plans(strategy, threshold_px, seed)
        stores = _named(searched, store or (), spacing or (), plans, places or ())
        if not stores:
            usual = [one for one in comparison.stores if one.holds in searched]
            stores = _few(usual) if quick else usual
        held = {one.held for one in stores}
        asked = replace(
            comparison,
            stores=tuple(dict.fromkeys(stores)),
            matchers=tuple(
                matcher or (one for one in comparison.matchers if trials.searched_by(one) in held)
            ),
            kinds=tuple(kind or comparison.kinds),
            queries=queries,
            bounds_deg=parse_bounds(bounds)
            if bounds is not None
            else _usual_bounds(comparison, terrain, has_store=bool(store), quick=quick),
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
            if "claimed_loss" in comparison.columns:
                rows = _with_losses(rows, built)
        if strange:
            rows = [{**row, "strange": [Path(path).name for path in strange]} for row in rows]
        _report(record, asked, rows, built, terrain)

    command.__name__ = name
    command.__doc__ = (
        f"{comparison.about}\n\nStores that are named (--spacing, --places, --threshold-px, "
        "--store) are searched instead of the usual ones. A query without any candidate counts as "
        "wrong by half of the area's diagonal."
    )
    return command
