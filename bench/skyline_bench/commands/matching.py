"""Matchers measured: on stores of one area, and on uniform against adaptive ones (paper 5.2)."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.console import progress_bar
from skyline.paper.planning.candidates import Spacing
from skyline.paper.planning.plan import PlanConfig
from skyline.paper.planning.strategies import STRATEGIES
from skyline.pipeline.matchers import FULL
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.commands.options import Floats, Names
from skyline_bench.figures.plots import draw_costs, save_accuracy, save_figure
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import core_count
from skyline_bench.runs.cost_summary import equal_rows, reached_rows
from skyline_bench.runs.matching import KINDS, PLAIN, MatchingConfig, check, measure
from skyline_bench.trials.distance_groups import ALL, DistanceGroup
from skyline_bench.trials.matchers import PAPER, RETRIEVED, WHAT

_MATCHING = MatchingConfig()
_SPACINGS_M = (1024.0, 512.0, 256.0, 128.0)
_BUDGETS = (800, 1600, 2800)
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
    budget: Annotated[
        list[int] | None, Option(help="Renderings of an adaptive store [800 1600 2800].")
    ] = None,
    candidate_spacing: Annotated[
        float, Option(help="Between places that a planner chooses from, metres.")
    ] = Spacing().candidate_m,
    matcher: Matcher = None,
    kind: Annotated[str, Option(help=f"Of queries, of {', '.join(KINDS)}.")] = PLAIN,
    queries: Annotated[int, Option(help="Queries, at least 3.")] = 300,
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
    query without any candidate counts as wrong by half of the
    area's diagonal.
    """
    grids = tuple(spacing or _SPACINGS_M)
    apart = replace(Spacing(), candidate_m=candidate_spacing)
    config = MatchingConfig(
        bounds_deg=options.bounds_of(bounds),
        spacings_m=grids,
        place_spacings_m=grids,
        plans=tuple(
            PlanConfig(name, apart, seed=seed, budget=renderings)
            for name in strategy or ("lpov",)
            for renderings in sorted(budget or _BUDGETS)
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
    options.keep_record(json_file, "uniform-adaptive", rows, summary)
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
