"""Stores measured: uniform against adaptive (paper 5.2)."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline.paper.planning.strategies import STRATEGIES
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.figures.tables import EQUAL, REACHED, STORES, in_megabytes, store_lines
from skyline_bench.figures.uniform_adaptive import save_costs
from skyline_bench.runs.cost_summary import equal_rows, reached_rows
from skyline_bench.runs.uniform_adaptive import AdaptiveConfig, check, measure
from skyline_bench.trials.distance_groups import DistanceGroup
from skyline_bench.trials.matchers import WHAT

_CONFIG = AdaptiveConfig()


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
            help=f"Of adaptive stores; may be repeated [{' '.join(_CONFIG.strategies)}]: "
            f"{', '.join(STRATEGIES)}."
        ),
    ] = None,
    budget: Annotated[
        list[int] | None,
        typer.Option(
            help="Renderings of an adaptive store; may be repeated "
            f"[{' '.join(map(str, _CONFIG.budgets))}]."
        ),
    ] = None,
    candidate_spacing: Annotated[
        float, typer.Option(help="Between places that a planner chooses from, metres.")
    ] = _CONFIG.spacing.candidate_m,
    matcher: Annotated[
        list[str] | None,
        typer.Option(help=f"May be repeated [{' '.join(_CONFIG.matchers)}]: {', '.join(WHAT)}."),
    ] = None,
    queries: Annotated[int, typer.Option(help="Queries, at least 3.")] = _CONFIG.queries,
    workers: Annotated[
        int, typer.Option(metavar="N", help="Processes at work.", show_default="one a core")
    ] = _CONFIG.workers,
    folder: Annotated[
        Path | None,
        typer.Option(
            help="Where stores and results are kept: a run that was stopped goes on from there."
        ),
    ] = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = _CONFIG.seed,
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
    config = AdaptiveConfig(
        bounds_deg=options.bounds_of(bounds),
        spacings_m=tuple(spacing or _CONFIG.spacings_m),
        strategies=tuple(strategy or _CONFIG.strategies),
        budgets=tuple(budget or _CONFIG.budgets),
        spacing=replace(_CONFIG.spacing, candidate_m=candidate_spacing),
        matchers=tuple(matcher or _CONFIG.matchers),
        queries=queries,
        seed=seed,
        workers=workers,
    )
    options.check_outputs(json_file, plot)
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
