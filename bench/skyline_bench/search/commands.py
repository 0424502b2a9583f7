"""The commands of ``search``: which stores, matchers and queries each compares by default."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import fill
from types import MappingProxyType
from typing import Annotated

from typer import Option

from skyline.cli.console import progress_bar
from skyline.match.matcher import FULL
from skyline.paper.plan import PlanConfig
from skyline.paper.strategies import STRATEGIES
from skyline.store.format import PLACES, RENDERINGS
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench import options
from skyline_bench.measuring.record import write_record
from skyline_bench.options import Floats, Names
from skyline_bench.queries.kinds import KINDS, OF_ONE_AREA, SAME_PLACE
from skyline_bench.search.compare import Comparison, measure
from skyline_bench.search.specs import StoreSpec, claimed_loss, middle_deg
from skyline_bench.search.summary import ALL, against_uniform
from skyline_bench.search.trials import MATCHERS, PAPER

_GRIDS_M = (1024.0, 512.0, 256.0, 128.0)
_FOUND = """n within_200m within_200m_low within_200m_high within_1km median_m mean_m answered
    precision query_s"""


@dataclass(frozen=True, slots=True)
class Search:
    """One command: its defaults, and the columns that it prints."""

    about: str  # The help text
    takes: str  # How long the whole comparison takes on 2 cores without a GPU
    comparison: Comparison
    columns: str  # Rows of groups are printed where "group" is among them
    in_middle: bool = False  # Whether the area is by default 5 x 10 km in the DEM's middle
    claims: bool = False  # Whether each store's claimed loss stands beside its lost queries
    against_uniform: bool = False  # Whether adaptive stores are compared with uniform ones


_THRESHOLDS_PX = (12.0, 6.0, 3.0)
"""Of the paper's planner: from few renderings to many."""
_HELP_COLUMNS = 78
"""Help keeps the lines of later paragraphs, and terminals have 80 columns."""


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


SEARCHES: Mapping[str, Search] = MappingProxyType(
    {
        "matching": Search(
            """Matchers on stores of one area: how often, how near and how fast they find queries.

            The paper's matcher and correlation search uniform grids of renderings, ours planned
            places.""",
            "hours",
            Comparison((*_grids(RENDERINGS), *_planned(None)), MATCHERS, OF_ONE_AREA, 300),
            "store matcher queries places build_cpu_s bytes " + _FOUND,
            in_middle=True,
        ),
        "uniform-adaptive": Search(
            """Uniform and adaptive stores: renderings, seconds and bytes against accuracy.

            The paper's matcher searches uniform grids of renderings and the plans of its planner;
            ours searches uniform grids of places and planned places, each of which counts as four
            renderings. Queries are grouped in thirds by the distance of their skyline.""",
            "an hour",
            Comparison(
                (
                    *_grids(RENDERINGS),
                    *_plans(["lpov"], None),
                    *_grids(),
                    *_planned(1_000, 4_000, 16_000, None),
                ),
                (PAPER, FULL),
                by_thirds=True,
            ),
            """store renderings bytes build_s matcher queries group from_m to_m mean_m mean_m_low
            mean_m_high within_200m query_s""",
            in_middle=True,
            against_uniform=True,
        ),
        "placing": Search(
            """Placing: how many queries uniform grids and planned places find for their cost.

            The claimed loss is the share of the views that the planner expects to be lost over the
            area; a query is lost that is not found within 1 km.""",
            "an hour",
            Comparison(
                (*_grids(spacings_m=(80.0, 40.0, 20.0)), *_planned(2_000, 8_000, 32_000, None)),
                queries=150,
            ),
            f"store places bytes build_cpu_s=cpu_s group=skyline {_FOUND} claimed_loss lost",
            claims=True,
        ),
        "scale": Search(
            """Size: synthetic queries found in squares and circles of one store that grow.

            A query's place lies anywhere in its squares. The columns of the screened, retrieved and
            refined are the share of the queries of which a place within one spacing of the truth is
            left after that stage: where it drops, queries are lost.""",
            "hours",
            Comparison(
                (*_planned(None),), queries=200, areas_km2=(50.0, 1000.0, 10_000.0), near_km=(30.0,)
            ),
            f"store places bytes build_s build_cpu_s search group {_FOUND} query_cpu_s screen_s"
            " screened retrieved refined",
        ),
        "same-place": Search(
            """Photos of one place: how often one of them finds it, and how often all together.

            Three photos are taken at each place. Once more, the last photo of each place is
            exchanged for a stranger: one of another place. A photo is named that does not belong to
            the others, as the matcher finds; with a stranger, the column is of the stranger.""",
            "20 minutes",
            Comparison((StoreSpec(),), kinds=SAME_PLACE, queries=30, by_thirds=True),
            f"store queries group {_FOUND} radius_holds named",
            in_middle=True,
        ),
        "strangers": Search(
            """Skylines of other terrain (--strange): how many a store answers, and how surely.""",
            "10 minutes",
            Comparison((StoreSpec(),), kinds=("strangers",)),
            "store group n answered highest_confidence query_s",
            in_middle=True,
        ),
    }
)


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
            Names, Option(help=f"Of the paper's plans, of {', '.join(STRATEGIES)} [lpov].")
        ] = None,
        store: Annotated[
            list[Path] | None, Option(help="Search an existing store; repeatable.")
        ] = None,
        matcher: Annotated[Names, Option(help=f"Repeatable, of {', '.join(MATCHERS)}.")] = None,
        kind: Annotated[Names, Option(help=f"Of queries, of {', '.join(KINDS)}.")] = None,
        area: Annotated[
            Floats, Option(min=0.01, metavar="KM2", help="Search such squares too; repeatable.")
        ] = None,
        near: Annotated[
            Floats,
            Option(min=0.01, metavar="KM", help="Search circles of this radius too; repeatable."),
        ] = None,
        strange: Annotated[
            Names, Option(metavar="DEM", help="Other terrain, for strangers; repeatable.")
        ] = None,
        queries: Annotated[
            int,
            Option(
                min=3 if search.comparison.by_thirds else 1,
                help="Queries of each kind, or places of several photos.",
            ),
        ] = search.comparison.queries,
        folder: options.Folder = None,
        json_file: options.JsonFile = None,
        seed: options.Seed = 0,
        quick: options.Quick = False,
        crs: options.Crs = None,
    ) -> None:
        terrain = read_dem(dem, DemOptions(crs=crs))
        named = [StoreSpec(path=path) for path in store or ()]
        named += [*_grids(RENDERINGS, spacing or ()), *_plans(strategy, threshold_px, seed)]
        named += [*_grids(spacings_m=spacing or ()), *_planned(*(places or ()))]
        bounds_deg = options.bounds_of(bounds)
        if bounds_deg is None and search.in_middle and not store:
            bounds_deg = middle_deg(terrain)
        usual = search.comparison
        comparison = replace(
            usual,
            stores=tuple(named) or usual.stores,
            matchers=tuple(matcher or usual.matchers),
            kinds=tuple(kind or usual.kinds),
            queries=queries,
            bounds_deg=bounds_deg,
            areas_km2=tuple(area or usual.areas_km2),
            near_km=tuple(near or usual.near_km),
            seed=seed,
        )
        comparison = comparison.quick(terrain) if quick else comparison
        comparison.check(terrain)  # Before any folder is made.
        other = read_dem(strange, DemOptions(reproject=True)) if strange else None
        with (
            options.store_folder(folder) as place,
            progress_bar("building and matching") as progress,
        ):
            rows, stores = measure(terrain, comparison, place, progress, other)
            if search.claims:
                claimed = {one.spec.name: claimed_loss(one.read_places()) for one in stores}
                rows = [
                    {
                        **row,
                        "claimed_loss": claimed[row["store"]],
                        "lost": 1.0 - row["within_1km"],
                    }
                    for row in rows
                ]
        if strange:
            rows = [{**row, "strange": [Path(path).name for path in strange]} for row in rows]
        by_group = "group" in search.columns
        options.print_rows([row for row in rows if by_group or row["group"] == ALL], search.columns)
        summary = {"against_uniform": against_uniform(rows)} if search.against_uniform else {}
        for table in summary.values():
            options.print_rows(table)
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
