"""Matching measured: matchers on stores of one kind."""

from pathlib import Path
from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.figures.matching import save_accuracy
from skyline_bench.runs.matching import KINDS, MatchingConfig
from skyline_bench.runs.matching_trials import check, measure
from skyline_bench.trials.matchers import WHAT

_MATCHING = MatchingConfig()


def matching(
    dem: options.Dems,
    bounds: options.Bounds = None,
    spacing: Annotated[
        list[float] | None,
        typer.Option(
            help="Of a uniform store of renderings, metres; may be repeated [1024 512 256 128]."
        ),
    ] = None,
    place_spacing: Annotated[
        list[float] | None,
        typer.Option(
            help="Of a uniform store of places, metres, or 0 for places as they are planned by "
            "default; may be repeated [0 160 120 80 60 40]."
        ),
    ] = None,
    store: Annotated[
        list[Path] | None,
        typer.Option(help="A store that is there already, instead; may be repeated."),
    ] = None,
    folder: options.Folder = None,
    matcher: Annotated[
        list[str] | None,
        typer.Option(help=f"May be repeated; by default all: {', '.join(WHAT)}."),
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(help=f"Of queries; may be repeated; by default all: {', '.join(KINDS)}."),
    ] = None,
    queries: Annotated[int, typer.Option(help="Queries of each kind.")] = _MATCHING.queries,
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
    terrain = read_dem(dem, DemOptions(crs=crs))
    config = config.quick(terrain) if quick else config
    check(terrain, config)
    with options.store_folder(folder) as place, progress_bar("matching") as progress:
        rows = measure(terrain, config, place, progress).rows()
    columns = {
        "store": "store",
        "matcher": "matcher",
        "queries": "queries",
        "places": "places",
        "build_cpu_s": "cpu s",
        "bytes": "MB",
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
    options.tell(json_file, "matching", rows, columns)
    if plot is not None:
        save_accuracy(rows, plot)
