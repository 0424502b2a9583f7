"""Stores measured: uniform against adaptive (paper 5.2)."""

from dataclasses import replace
from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline.paper.planning.candidates import Spacing
from skyline.paper.planning.plan import PlanConfig
from skyline.paper.planning.strategies import STRATEGIES
from skyline.pipeline.matchers import FULL
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.figures.tables import EQUAL, REACHED, STORES, in_megabytes, store_lines
from skyline_bench.figures.uniform_adaptive import save_costs
from skyline_bench.measuring.timing import core_count
from skyline_bench.runs.cost_summary import equal_rows, reached_rows
from skyline_bench.runs.matching import PLAIN, MatchingConfig
from skyline_bench.runs.matching_trials import check, measure
from skyline_bench.trials.distance_groups import DistanceGroup
from skyline_bench.trials.matchers import PAPER, RETRIEVED, WHAT

_SPACINGS_M = (1024.0, 512.0, 256.0, 128.0)
_STRATEGIES = ("lpov",)
_BUDGETS = (800, 1600, 2800)
_MATCHERS = (PAPER, RETRIEVED, FULL)


def uniform_adaptive(
    dem: options.Dems,
    bounds: options.Bounds = None,
    spacing: Annotated[
        list[float] | None,
        typer.Option(help="Of a uniform store, metres; may be repeated [1024 512 256 128]."),
    ] = None,
    strategy: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Of adaptive stores; may be repeated [{' '.join(_STRATEGIES)}]: "
            f"{', '.join(STRATEGIES)}."
        ),
    ] = None,
    budget: Annotated[
        list[int] | None,
        typer.Option(
            help="Renderings of an adaptive store; may be repeated "
            f"[{' '.join(map(str, _BUDGETS))}]."
        ),
    ] = None,
    candidate_spacing: Annotated[
        float, typer.Option(help="Between places that a planner chooses from, metres.")
    ] = Spacing().candidate_m,
    matcher: Annotated[
        list[str] | None,
        typer.Option(help=f"May be repeated [{' '.join(_MATCHERS)}]: {', '.join(WHAT)}."),
    ] = None,
    queries: Annotated[int, typer.Option(help="Queries, at least 3.")] = 300,
    workers: Annotated[
        int, typer.Option(metavar="N", help="Processes at work.", show_default="one a core")
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
            for name in strategy or _STRATEGIES
            for renderings in sorted(budget or _BUDGETS)
        ),
        matchers=tuple(matcher or _MATCHERS),
        kinds=(PLAIN,),
        queries=queries,
        grouped=True,
        seed=seed,
        top=1,
        workers=workers,
    )
    terrain = read_dem(dem, DemOptions(crs=crs))
    config = config.quick(terrain) if quick else config
    check(terrain, config)
    with options.store_folder(folder) as place:
        with progress_bar("comparing") as progress:
            compared = measure(terrain, config, place, progress)
        rows = compared.rows()
        options.print_rows(store_lines(rows), STORES)
        for group in compared.groups:
            typer.echo(_about(group))
        summary = {"as_accurate": reached_rows(rows), "as_many_renderings": equal_rows(rows)}
        options.print_rows([in_megabytes(row) for row in summary["as_accurate"]], REACHED)
        options.print_rows(summary["as_many_renderings"], EQUAL)
        options.keep_record(json_file, "uniform-adaptive", rows, summary)
        if plot is not None:
            save_costs(rows, plot)


def _about(group: DistanceGroup) -> str:
    return (
        f"{group.name}: {len(group.queries)} queries whose skyline is {group.from_m:.0f} to "
        f"{group.to_m:.0f} m off (median over its columns)"
    )
