"""Stores x queries: matchers, uniform and adaptive stores, planned places, size, strangers."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.console import progress_bar
from skyline.match.matchers import FULL
from skyline.paper.plan import PlanConfig
from skyline.paper.strategies import STRATEGIES
from skyline.store.format import RENDERINGS
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline_bench.commands import options
from skyline_bench.commands.options import Floats, Names
from skyline_bench.measuring.record import Row, write_record
from skyline_bench.queries.kinds import OF_ONE_AREA, SAME_PLACE
from skyline_bench.search.compare import Comparison, measure
from skyline_bench.search.plots import AGAINST_AREA, AGAINST_COST, save_found
from skyline_bench.search.specs import BuiltStore, StoreSpec, claimed_loss, middle_deg
from skyline_bench.search.summary import ALL, THIRDS, against_uniform
from skyline_bench.search.trials import ABOUT, PAPER

Spacings = Annotated[
    Floats, Option(metavar="M", help="Of uniform stores; may be repeated [1024 512 256 128].")
]
Losses = Annotated[
    Floats,
    Option(metavar="SHARE", help="Views that planned places may lose; may be repeated [0.2]."),
]
Stores = Annotated[
    list[Path] | None, Option(help="A store that exists already, instead; may be repeated.")
]
Matchers = Annotated[Names, Option(help=f"May be repeated, of {', '.join(ABOUT)}.")]
Kinds = Annotated[Names, Option(help=f"Of queries, of {', '.join(OF_ONE_AREA)}.")]

_SPACINGS_M = (1024.0, 512.0, 256.0, 128.0)
_FOUND = """n within_200m within_200m_low within_200m_high within_1km median_m mean_m answered
    precision query_s"""


def matching(
    dem: options.Dems,
    bounds: options.Bounds = None,
    spacing: Spacings = None,
    loss: Losses = None,
    store: Stores = None,
    matcher: Matchers = None,
    kind: Kinds = None,
    queries: Annotated[int, Option(help="Queries of each kind.")] = 300,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Matchers on stores of one area: how often, how far off and how fast queries are found.

    The paper's matcher and correlation search uniform grids of renderings, ours planned places.
    Where a spacing, a loss or a store is given, no others are built. A query without any candidate
    counts as wrong by half of the area's diagonal.
    """
    specs = [StoreSpec(path=path) for path in store or ()]
    chosen = spacing or loss or store
    grids = spacing if chosen else list(_SPACINGS_M)
    specs += [StoreSpec(RENDERINGS, metres) for metres in grids or ()]
    specs += [StoreSpec(spacing_m=metres) for metres in spacing or ()]
    specs += [StoreSpec(loss=share) for share in loss or ([] if chosen else [0.2])]
    terrain = read_dem(dem, DemOptions(crs=crs))
    comparison = Comparison(
        stores=tuple(specs),
        matchers=tuple(matcher or ABOUT),
        kinds=tuple(kind or OF_ONE_AREA),
        queries=queries,
        bounds_deg=_bounds_or_middle(bounds, terrain, bool(store)),
        seed=seed,
    )
    rows, _ = _measured(terrain, comparison, quick, folder)
    columns = "store matcher queries group places build_cpu_s bytes " + _FOUND
    options.print_rows([row for row in rows if row["group"] == ALL], columns)
    write_record(json_file, "matching", rows)
    if plot is not None:
        save_found(rows, AGAINST_COST, plot)


def uniform_adaptive(
    dem: options.Dems,
    bounds: options.Bounds = None,
    spacing: Spacings = None,
    strategy: Annotated[
        Names, Option(help=f"Of the paper's planner, of {', '.join(STRATEGIES)} [lpov].")
    ] = None,
    threshold_px: Annotated[
        Floats, Option(help="Pixels to which the paper's plans cover [12 6 3].")
    ] = None,
    loss: Annotated[
        Floats,
        Option(metavar="SHARE", help="Views that our planned places may lose [0.35 0.27 0.2]."),
    ] = None,
    matcher: Matchers = None,
    kind: Kinds = None,
    queries: Annotated[int, Option(help="Queries, at least 3.")] = 100,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Uniform and adaptive stores: renderings, seconds and bytes against accuracy.

    The paper's matcher searches uniform grids of renderings and the plans of its planner; ours
    searches uniform grids of places and planned places, each of which counts as four renderings.
    Queries are grouped in thirds by the distance of their skyline. A query without any candidate
    counts as wrong by half of the area's diagonal.
    """
    grids = spacing or _SPACINGS_M
    plans = [
        PlanConfig(name, threshold_px=pixels, seed=seed)
        for name in strategy or ("lpov",)
        for pixels in sorted(threshold_px or (12.0, 6.0, 3.0), reverse=True)
    ]
    terrain = read_dem(dem, DemOptions(crs=crs))
    comparison = Comparison(
        stores=(
            *(StoreSpec(RENDERINGS, metres) for metres in grids),
            *(StoreSpec(RENDERINGS, plan=plan) for plan in plans),
            *(StoreSpec(spacing_m=metres) for metres in grids),
            *(StoreSpec(loss=share) for share in loss or (0.35, 0.27, 0.2)),
        ),
        matchers=tuple(matcher or (PAPER, FULL)),
        kinds=tuple(kind or ("plain",)),
        queries=queries,
        bounds_deg=_bounds_or_middle(bounds, terrain),
        by_thirds=True,
        seed=seed,
    )
    rows, _ = _measured(terrain, comparison, quick, folder)
    columns = """store renderings bytes build_s matcher queries close medium far mean_m mean_m_low
        mean_m_high within_200m query_s"""
    options.print_rows(_one_line_a_store(rows), columns)
    for group in rows[: len(THIRDS)]:
        typer.echo(
            f"{group['group']}: {group['n']} queries whose skyline is {group['from_m']:.0f} to "
            f"{group['to_m']:.0f} m off (median over its columns)"
        )
    summary = {"against_uniform": against_uniform(rows)}
    options.print_rows(summary["against_uniform"])
    write_record(json_file, "uniform-adaptive", rows, summary)
    if plot is not None:
        save_found(rows, AGAINST_COST, plot)


def placing(
    dem: options.Dems,
    spacing: Annotated[
        Floats, Option(metavar="M", help="Of a uniform grid; may be repeated [320 160 80].")
    ] = None,
    loss: Annotated[
        Floats,
        Option(
            metavar="SHARE", help="Views that planned places may lose; repeatable [0.35 0.27 0.2]."
        ),
    ] = None,
    bounds: options.BuiltBounds = None,
    queries: options.Queries = 150,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Placing: what uniform grids and planned places find for what they cost.

    The claimed loss is the share of the views that the planner expects to be lost over the area; a
    query is lost that is not found within 1 km.
    """
    comparison = Comparison(
        stores=(
            *(StoreSpec(spacing_m=metres) for metres in spacing or (320.0, 160.0, 80.0)),
            *(StoreSpec(loss=share) for share in loss or (0.35, 0.27, 0.2)),
        ),
        queries=queries,
        bounds_deg=options.bounds_of(bounds),
        seed=seed,
    )
    terrain = read_dem(dem, DemOptions(crs=crs))
    with options.store_folder(folder) as place:
        rows, stores = _measured(terrain, comparison, quick, place)
        claimed = {store.spec.name: claimed_loss(store.read_places()) for store in stores}
    rows = [
        {**row, "claimed_loss": claimed[row["store"]], "lost": 1.0 - row["within_1km"]}
        for row in rows
    ]
    columns = f"store places bytes build_cpu_s=cpu_s group=skyline {_FOUND} claimed_loss lost"
    options.report(json_file, "placing", rows, columns)
    if plot is not None:
        save_found(rows, AGAINST_COST, plot)


def scale(
    dem: options.Dems,
    loss: Annotated[float, Option(help="Share of the views that planned places may lose.")] = 0.2,
    spacing: Annotated[
        float | None, Option(metavar="M", help="Of a uniform grid of places, instead.")
    ] = None,
    store: Annotated[
        Path | None, Option(help="A store of places that exists already, instead.")
    ] = None,
    bounds: options.BuiltBounds = None,
    area: Annotated[
        Floats,
        Option(
            metavar="KM2",
            help="A square that is searched; may be repeated [50 1000 10000]. What is larger than "
            "the store is left out; all of it is searched as well.",
        ),
    ] = None,
    near: Annotated[Floats, Option(metavar="KM", help="A circle's radius, likewise [30].")] = None,
    queries: options.Queries = 200,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Size: a store of places built, and synthetic queries found in squares of it that grow.

    A query's place lies anywhere in its squares. The columns of the screened, retrieved and refined
    are the share of the queries of which a place within one spacing of the truth is left after that
    stage: where it drops, queries are lost.
    """
    spec = StoreSpec(path=store) if store else StoreSpec(spacing_m=spacing, loss=loss)
    comparison = Comparison(
        stores=(spec,),
        queries=queries,
        bounds_deg=options.bounds_of(bounds),
        areas_km2=tuple(area or (50.0, 1000.0, 10_000.0)),
        near_km=tuple(near or (30.0,)),
        seed=seed,
    )
    rows, _ = _measured(read_dem(dem, DemOptions(crs=crs)), comparison, quick, folder)
    columns = f"search group {_FOUND} query_cpu_s screen_s screened retrieved refined"
    options.print_rows(rows[:1], "store places bytes build_s build_cpu_s")
    options.print_rows(rows, columns)
    write_record(json_file, "scale", rows)
    if plot is not None:
        save_found(rows, AGAINST_AREA, plot)


def same_place(
    dem: options.Dems,
    bounds: options.Bounds = None,
    queries: Annotated[int, Option(help="Places at which three photos are taken, 3 or more.")] = 30,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Photos of one place: how often one of them finds it, and how often all together.

    Once more, the last photo of each place is exchanged for a stranger: one of another place. A
    photo is named that does not belong to the others, as the matcher finds; with a stranger, the
    column is of the stranger.
    """
    terrain = read_dem(dem, DemOptions(crs=crs))
    comparison = Comparison(
        stores=(StoreSpec(),),
        kinds=SAME_PLACE,
        queries=queries,
        bounds_deg=_bounds_or_middle(bounds, terrain),
        by_thirds=True,
        seed=seed,
    )
    rows, _ = _measured(terrain, comparison, quick, folder)
    options.report(
        json_file, "same-place", rows, f"store queries group {_FOUND} radius_holds named"
    )


def strangers(
    store: options.StoreFile,
    dem: options.Dems,
    strange: Annotated[list[str], Option(metavar="DEM", help="Of elsewhere; may be repeated.")],
    queries: Annotated[int, Option(help="From the middle of that DEM.")] = 100,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
) -> None:
    """Skylines of elsewhere: how many a store answers, and how sure it is of them."""
    comparison = Comparison(
        (StoreSpec(path=store),), kinds=("strangers",), queries=queries, seed=seed
    )
    elsewhere = read_dem(strange, DemOptions(reproject=True))
    rows, _ = _measured(read_dem(dem), comparison, quick, folder, elsewhere)
    columns = "store strange group n answered highest_confidence query_s"
    rows = [{**row, "strange": [Path(path).name for path in strange]} for row in rows]
    options.report(json_file, "strangers", rows, columns)


def _measured(
    terrain: HeightField,
    comparison: Comparison,
    quick: bool,
    folder: Path | None,
    strange: HeightField | None = None,
) -> tuple[list[Row], list[BuiltStore]]:
    comparison = comparison.quick(terrain) if quick else comparison
    comparison.check(terrain)  # Before any folder is made.
    with options.store_folder(folder) as place, progress_bar("building and matching") as progress:
        return measure(terrain, comparison, place, progress, strange)


def _bounds_or_middle(
    bounds: str | None, terrain: HeightField, given: bool = False
) -> tuple[float, float, float, float] | None:
    """Return the bounds asked for, else 5 x 10 km in the DEM's middle, or a given store's own."""
    if bounds is None and given:
        return None
    return options.bounds_of(bounds) or middle_deg(terrain)


def _one_line_a_store(rows: list[Row]) -> list[Row]:
    """Return a line for each store, matcher and kind: means of every group, the rest over all."""
    lines: dict[tuple[object, ...], dict[str, object]] = {}
    for row in rows:
        line = lines.setdefault((row["store"], row["matcher"], row["queries"]), {})
        line[str(row["group"])] = row["mean_m"]
        if row["group"] == ALL:
            line |= row
    return list(lines.values())
