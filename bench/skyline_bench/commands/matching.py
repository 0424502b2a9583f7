"""Matching measured: matchers on stores of one kind."""

from pathlib import Path
from typing import Annotated

import typer

from skyline.console import parse_bounds, progress_bar
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands.options import (
    Bounds,
    Crs,
    Dems,
    JsonFile,
    PlotFile,
    Quick,
    Seed,
    check_folder,
    check_outputs,
    keep_record,
    print_rows,
    store_folder,
)
from skyline_bench.figures.matching import save_accuracy
from skyline_bench.runs.matching import KINDS, MatchingConfig, measure
from skyline_bench.trials.matchers import WHAT
from skyline_bench.trials.trials import candidate_rows, write_rows

_MATCHING = MatchingConfig()


def matching(
    dem: Dems,
    bounds: Bounds = None,
    spacing: Annotated[
        list[float] | None,
        typer.Option(
            help="Of a uniform store of renderings, metres; may be repeated [1024 512 256 128]."
        ),
    ] = None,
    place_spacing: Annotated[
        list[float] | None,
        typer.Option(
            help="Of a uniform store of places, metres; may be repeated [160 120 80 60 40]."
        ),
    ] = None,
    store: Annotated[
        list[Path] | None,
        typer.Option(help="A store that is there already, instead; may be repeated."),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(help="Where uniform stores are kept and found again; else thrown away."),
    ] = None,
    matcher: Annotated[
        list[str] | None,
        typer.Option(help=f"May be repeated; by default all: {', '.join(WHAT)}."),
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(help=f"Of queries; may be repeated; by default all: {', '.join(KINDS)}."),
    ] = None,
    queries: Annotated[int, typer.Option(help="Queries of each kind.")] = _MATCHING.queries,
    json_file: JsonFile = None,
    per_query: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write every candidate of every query: CSV or JSON."),
    ] = None,
    plot: PlotFile = None,
    seed: Seed = _MATCHING.seed,
    quick: Quick = False,
    crs: Crs = None,
) -> None:
    """Matchers on uniform stores: how often, how far off and how fast synthetic queries are found.

    The paper's matcher and correlation search renderings, ours searches places; stores are built
    where a matcher searches them. Where a spacing or a store is given, no others are built. A
    query without any candidate counts as wrong by half of the area's diagonal.
    """
    given = spacing or place_spacing or store
    config = MatchingConfig(
        bounds_deg=parse_bounds(bounds) if bounds is not None else None,
        spacings_m=tuple(spacing or ()) if given else _MATCHING.spacings_m,
        place_spacings_m=tuple(place_spacing or ()) if given else _MATCHING.place_spacings_m,
        stores=tuple(store or ()),
        matchers=tuple(matcher or WHAT),
        kinds=tuple(kind or KINDS),
        queries=queries,
        seed=seed,
    )
    check_outputs(json_file, plot)
    check_folder("--per-query", per_query)
    terrain = read_dem(dem, DemOptions(crs=crs))
    with store_folder(folder) as place, progress_bar("matching") as progress:
        compared = measure(terrain, config.quick() if quick else config, place, progress)
    rows = [comparison.row(seed) for comparison in compared]
    columns = {
        "store": "store",
        "matcher": "matcher",
        "queries": "queries",
        "places": "places",
        "build_cpu_s": "cpu s",
        "megabytes": "MB",
        "within_200m": "in 200 m",
        "within_200m_low": "from",
        "within_200m_high": "to",
        "median_m": "median m",
        "mean_m": "mean m",
        "p90_m": "90 % m",
        "heading_median_deg": "heading",
        "answered": "answered",
        "query_ms": "ms",
    }
    print_rows([{**row, "megabytes": float(str(row["bytes"])) / 1e6} for row in rows], columns)
    keep_record(json_file, "matching", rows)
    if per_query is not None:
        candidates = [
            {"store": each.store.name, "matcher": each.matcher, "queries": each.kind, **row}
            for each in compared
            for trial in each.trials
            for row in candidate_rows(trial)
        ]
        write_rows(per_query, "matching-candidates", candidates)
    if plot is not None:
        save_accuracy(rows, plot)
