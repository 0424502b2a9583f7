"""Matchers, layouts and searches measured: on stores of one area, on large ones, on strangers."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline.cli.console import progress_bar
from skyline.paper.planning.candidates import Spacing
from skyline.paper.planning.plan import PlanConfig
from skyline.paper.planning.strategies import STRATEGIES
from skyline.pipeline.matchers import FULL
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.commands.options import Floats, Names
from skyline_bench.figures.plots import (
    draw_costs,
    save_accuracy,
    save_figure,
    save_placing,
    save_reliability,
    save_scale,
)
from skyline_bench.measuring.record import Row, write_record
from skyline_bench.measuring.timing import core_count
from skyline_bench.runs import calibration, crowds
from skyline_bench.runs import placing as layouts
from skyline_bench.runs import same_place as together
from skyline_bench.runs import scale as size
from skyline_bench.runs.cost_summary import equal_rows, reached_rows
from skyline_bench.runs.matching import KINDS, PLAIN, MatchingConfig, check, measure
from skyline_bench.trials.trials import ALL, PAPER, RETRIEVED, WHAT, DistanceGroup

_MATCHING = MatchingConfig()
_THRESHOLDS_PX = (12.0, 6.0, 3.0)
_COMPARED = (PAPER, RETRIEVED, FULL)

Matcher = Annotated[Names, Option(help=f"May be repeated, of {', '.join(WHAT)}.")]


def matching(
    dem: options.Dems,
    bounds: options.Bounds = None,
    spacing: Annotated[
        Floats, Option(help="Of a store of renderings, metres [1024 512 256 128].")
    ] = None,
    place_spacing: Annotated[
        Floats, Option(help="Of a store of places; 0: as planned by default [0 160 120 80 60 40].")
    ] = None,
    store: Annotated[
        list[Path] | None, Option(help="A store that is there already, instead; may be repeated.")
    ] = None,
    folder: options.Folder = None,
    matcher: Matcher = None,
    kind: Annotated[Names, Option(help=f"Of queries, of {', '.join(KINDS)}.")] = None,
    queries: Annotated[int, Option(help="Queries of each kind.")] = _MATCHING.queries,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = _MATCHING.seed,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Matchers on stores of one area: how often, how far off and how fast queries are found.

    The paper's matcher and correlation search renderings, ours searches places; stores are built
    where a matcher searches them. Where a spacing or a store is given, no others are built. A
    query without any candidate counts as wrong by half of the area's diagonal.
    """
    given = spacing or place_spacing or store
    places = tuple(metres or None for metres in place_spacing or ())
    config = MatchingConfig(
        bounds_deg=options.bounds_of(bounds),
        spacings_m=tuple(spacing or ()) if given else _MATCHING.spacings_m,
        place_spacings_m=places if given else _MATCHING.place_spacings_m,
        stores=tuple(store or ()),
        matchers=tuple(matcher or WHAT),
        kinds=tuple(kind or KINDS),
        queries=queries,
        seed=seed,
    )
    rows, _ = _measured(dem, crs, config, quick, folder)
    columns = """store matcher queries places build_cpu_s bytes within_200m within_200m_low
        within_200m_high median_m mean_m p90_m heading_median_deg answered query_ms"""
    options.tell(json_file, "matching", rows, columns)
    if plot is not None:
        save_accuracy(rows, plot)


def uniform_adaptive(
    dem: options.Dems,
    bounds: options.Bounds = None,
    spacing: Annotated[
        Floats, Option(help="Of a uniform store, metres; may be repeated [1024 512 256 128].")
    ] = None,
    strategy: Annotated[
        Names, Option(help=f"Of adaptive stores, of {', '.join(STRATEGIES)} [lpov].")
    ] = None,
    threshold_px: Annotated[
        Floats, Option(help="Pixels to which an adaptive store covers [12 6 3].")
    ] = None,
    candidate_spacing: Annotated[
        float, Option(help="Between places that a planner chooses from, metres.")
    ] = Spacing().candidate_m,
    matcher: Matcher = None,
    kind: Annotated[str, Option(help=f"Of queries, of {', '.join(KINDS)}.")] = PLAIN,
    queries: Annotated[int, Option(help="Queries, at least 3.")] = 100,
    workers: Annotated[
        int, Option(metavar="N", help="Processes at work.", show_default="one a core")
    ] = core_count(),
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Uniform and adaptive stores: renderings, seconds and bytes against accuracy.

    Errors are metres between where a query was taken and the best candidate; their means by how
    far the query's skyline is. The paper's matcher and correlation compare the renderings that
    were planned; ours searches whole places at their viewpoints, each of which counts as four. A
    query without any candidate counts as wrong by half of the area's diagonal.
    """
    grids = tuple(spacing or _MATCHING.spacings_m)
    apart = replace(Spacing(), candidate_m=candidate_spacing)
    config = MatchingConfig(
        bounds_deg=options.bounds_of(bounds),
        spacings_m=grids,
        place_spacings_m=grids,
        plans=tuple(
            PlanConfig(name, apart, pixels, seed=seed)
            for name in strategy or ("lpov",)
            for pixels in sorted(threshold_px or _THRESHOLDS_PX, reverse=True)
        ),
        matchers=tuple(matcher or _COMPARED),
        kinds=(kind,),
        queries=queries,
        grouped=True,
        seed=seed,
        top=1,
        workers=workers,
    )
    rows, groups = _measured(dem, crs, config, quick, folder)
    columns = """store renderings bytes build_s matcher close medium far mean_m mean_m_low
        mean_m_high median_m p90_m within_200m query_ms"""
    options.print_rows(_store_lines(rows), columns)
    for group in groups:
        typer.echo(
            f"{group.name}: {len(group.queries)} queries whose skyline is {group.from_m:.0f} to "
            f"{group.to_m:.0f} m off (median over its columns)"
        )
    summary = {"as_accurate": reached_rows(rows), "as_many_renderings": equal_rows(rows)}
    for table in summary.values():
        options.print_rows(table)
    write_record(json_file, "uniform-adaptive", rows, summary)
    if plot is not None:
        save_figure(draw_costs(rows), plot)


def _measured(
    dem: list[str], crs: str | None, config: MatchingConfig, quick: bool, folder: Path | None
) -> tuple[list[Row], tuple[DistanceGroup, ...]]:
    terrain = read_dem(dem, DemOptions(crs=crs))
    config = config.quick(terrain) if quick else config
    # Before any folder is made.
    check(terrain, config)
    with options.store_folder(folder) as place, progress_bar("matching") as progress:
        return measure(terrain, config, place, progress)


def _store_lines(rows: list[Row]) -> list[Row]:
    """Return a line for each store and matcher: means of every group, the rest over all."""
    lines: dict[tuple[object, object], dict[str, object]] = {}
    for row in rows:
        line = lines.setdefault((row["store"], row["matcher"]), {})
        line[str(row["group"])] = row["mean_m"]
        if row["group"] == ALL:
            line |= row
    return list(lines.values())


_PLACING = layouts.PlacingConfig()
_PLACING_COLUMNS = """layout places bytes=MB build_cpu_s=cpu_s group=skyline n within_200m=in_200_m
    within_1km=in_1_km median_m mean_m answered precision=right_of_these claimed_loss
    expected_loss=expected lost model_precision=model's_precision model_recall=recall"""


def placing(
    dem: options.Dems,
    spacing: Annotated[
        list[float] | None,
        Option(metavar="M", help="Of a uniform grid; may be repeated [320 160 80]."),
    ] = None,
    loss: Annotated[
        list[float] | None,
        Option(metavar="SHARE", help="Of planned places; may be repeated [0.35 0.27 0.2]."),
    ] = None,
    bounds: options.BuiltBounds = None,
    queries: options.Queries = _PLACING.queries,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = _PLACING.seed,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Placing: what uniform grids and planned places find for what they cost.

    A query is lost that is not found within 1 km. The claimed loss is what the planner expects
    over the area, the expected one what it expects of the queries; precision and recall are those
    of foretelling which are found.
    """
    config = layouts.PlacingConfig(
        tuple(spacing or _PLACING.spacings_m),
        tuple(loss or _PLACING.losses),
        options.bounds_of(bounds),
        queries,
        seed,
    )
    terrain = read_dem(dem, DemOptions(crs=crs))
    config = config.quick(terrain) if quick else config
    with options.store_folder(folder) as place, progress_bar("building and matching") as progress:
        rows = layouts.measure(terrain, config, place, progress)
    options.tell(json_file, "placing", rows, _PLACING_COLUMNS)
    if plot is not None:
        save_placing(rows, plot)


_SCALE = size.ScaleConfig()
_SAME_PLACE = together.SamePlaceConfig()


def scale(
    dem: options.Dems,
    spacing: Annotated[
        float | None, Option(help="Of the store that is built, metres; planned by default.")
    ] = _SCALE.spacing_m,
    loss: Annotated[
        float, Option(help="Share of the views that planned places may lose.")
    ] = _SCALE.loss,
    bounds: options.BuiltBounds = None,
    store: Annotated[
        Path | None, Option(help="A store of places that is there already, instead.")
    ] = None,
    area: Annotated[
        Floats,
        Option(
            metavar="KM2",
            help="A square that is searched; may be repeated [50 1000 10000]. What is larger than "
            "the store is left out; all of it is searched as well.",
        ),
    ] = None,
    near: Annotated[Floats, Option(metavar="KM", help="A circle's radius, likewise [30].")] = None,
    queries: options.Queries = _SCALE.queries,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = _SCALE.seed,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Size: a store of places built, and synthetic queries found in squares of it that grow.

    A query's place lies anywhere in its squares. Of screened, fitted, retrieved and refined
    places, the share of queries is told that have one within one spacing of the truth, looking
    within 10 degrees of the right way: where it drops, queries are lost.
    """
    config = size.ScaleConfig(
        spacing_m=spacing,
        loss=loss,
        bounds_deg=options.bounds_of(bounds),
        store=store,
        areas_km2=tuple(area or _SCALE.areas_km2),
        near_km=tuple(near or _SCALE.near_km),
        queries=queries,
        seed=seed,
    )
    terrain = read_dem(dem, DemOptions(crs=crs))
    config = config.quick(terrain) if quick else config
    with options.store_folder(folder) as place, progress_bar("building and matching") as progress:
        cost, rows = size.measure(terrain, config, place, progress)
    columns = """search group n within_200m within_1km median_m answered precision query_s
        query_cpu_s screened fitted retrieved refined"""
    options.print_rows([cost])
    options.print_rows(rows, columns)
    write_record(json_file, "scale", rows, {"store": [cost]})
    if plot is not None:
        save_scale(rows, plot)


def same_place(
    dem: options.Dems,
    bounds: options.Bounds = None,
    spacing: Annotated[
        float, Option(help="Of the store of places, metres.")
    ] = _SAME_PLACE.spacing_m,
    places: Annotated[int, Option(help="Where photos are taken.")] = _SAME_PLACE.places,
    photos: Annotated[int, Option(help="Photos of each place.")] = _SAME_PLACE.photos,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    seed: options.Seed = _SAME_PLACE.seed,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Photos of one place: how often one of them finds it, and how often all together.

    Once more, the last photo of each place is exchanged for a stranger: one of another place.
    """
    config = together.SamePlaceConfig(options.bounds_of(bounds), spacing, places, photos, seed)
    terrain = read_dem(dem, DemOptions(crs=crs))
    with options.store_folder(folder) as place, progress_bar("matching") as progress:
        rows = together.measure(terrain, config.quick() if quick else config, place, progress)
    columns = """group places photos alone_within_200m alone_median_m within_200m median_m answered
        precision radius_holds mixed_within_200m mixed_precision stranger_named"""
    options.tell(json_file, "same-place", rows, columns)


def retrieval_scale(
    store: options.StoreFile,
    dem: options.Dems,
    places: Annotated[int, Option(help="In all.")] = 1_000_000,
    queries: Annotated[int, Option(help="Looked for among them.")] = 30,
    json_file: options.JsonFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
) -> None:
    """Retrieval among very many places: seconds, memory, and whether the right one comes first."""
    if quick:
        places, queries = min(places, 50_000), min(queries, 5)
    with progress_bar("queries") as progress:
        rows = crowds.retrieval_scale(store, dem, places, queries, seed, progress)
    options.tell(json_file, "retrieval-scale", rows)


def strangers(
    store: options.StoreFile,
    dem: options.Dems,
    strange: Annotated[list[str], Option(metavar="DEM", help="Of elsewhere; may be repeated.")],
    queries: Annotated[int, Option(help="From the middle of that DEM.")] = 100,
    json_file: options.JsonFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
) -> None:
    """Skylines of elsewhere: how many a store answers, and how sure it is of them."""
    terrain = read_dem(strange, DemOptions(reproject=True))
    count = min(queries, 5) if quick else queries
    with progress_bar("strangers") as progress:
        found = crowds.strangers(store, dem, terrain, count, seed, progress)
    rows = [{"strange": [Path(path).name for path in strange], **found}]
    options.tell(json_file, "strangers", rows)


def calibrate(
    data: Annotated[
        Path,
        Argument(metavar="DATA", help="A folder with sierra, rofental, everest and davos."),
    ],
    queries: Annotated[int, Option(help="Of each of six kinds, on each terrain.")] = 40,
    model: Annotated[
        Path | None, options.new_file("Write the models: what skyline/matching has learned.")
    ] = None,
    examples: Annotated[
        Path | None, options.new_file("Kept here, and read where they are there.")
    ] = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = 5000,
    quick: options.Quick = False,
) -> None:
    """The confidence learned on Sierra, Rofental and Everest, its reliability shown on Davos."""
    if examples is not None and examples.exists():
        told = calibration.kept(examples)
    else:
        with progress_bar("terrains") as progress:
            told = calibration.matched(data, 1 if quick else queries, seed, progress)
        if examples is not None:
            calibration.keep(told, examples)
    found = calibration.learned(told)
    options.tell(json_file, "confidence", found.rows)
    if model is not None:
        calibration.write_models(model, found.models, found.about)
    if plot is not None:
        save_reliability(plot, found.shown, "Learned on Sierra, Rofental and Everest")
