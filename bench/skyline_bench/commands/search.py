"""Our search measured: very many places, skylines of elsewhere, its confidence."""

from pathlib import Path
from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.figures.reliability import save_reliability
from skyline_bench.runs import learning
from skyline_bench.runs import retrieval_scale as retrieval
from skyline_bench.runs import strangers as elsewhere
from skyline_bench.runs.calibration import write_models


def retrieval_scale(
    store: options.StoreFile,
    dem: options.Dems,
    places: Annotated[int, typer.Option(help="In all.")] = 1_000_000,
    queries: Annotated[int, typer.Option(help="Looked for among them.")] = 30,
    json_file: options.JsonFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
) -> None:
    """Retrieval among very many places: seconds, memory, and whether the right one comes first."""
    if quick:
        places, queries = min(places, 50_000), min(queries, 5)
    with progress_bar("queries") as progress:
        rows = retrieval.measure(store, dem, places, queries, seed, progress)
    options.tell(json_file, "retrieval-scale", rows)


def strangers(
    store: options.StoreFile,
    dem: options.Dems,
    strange: Annotated[
        list[str], typer.Option(metavar="DEM", help="Of elsewhere; may be repeated.")
    ],
    queries: Annotated[int, typer.Option(help="From the middle of that DEM.")] = 100,
    json_file: options.JsonFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
) -> None:
    """Skylines of elsewhere: how many a store answers, and how sure it is of them."""
    terrain = read_dem(strange, DemOptions(reproject=True))
    count = min(queries, 5) if quick else queries
    with progress_bar("strangers") as progress:
        found = elsewhere.measure(store, dem, terrain, count, seed, progress)
    rows = [{"strange": [Path(path).name for path in strange], **found}]
    options.tell(json_file, "strangers", rows)


def calibrate(
    data: Annotated[
        Path,
        typer.Argument(metavar="DATA", help="A folder with sierra, rofental, everest and davos."),
    ],
    queries: Annotated[int, typer.Option(help="Of each of six kinds, on each terrain.")] = 40,
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the models: what skyline/matching has learned.",
            callback=options.in_a_folder,
        ),
    ] = None,
    examples: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Kept here, and read where they are there.",
            callback=options.in_a_folder,
        ),
    ] = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = 1000,
    quick: options.Quick = False,
) -> None:
    """The confidence learned on Sierra, Rofental and Everest, its reliability shown on Davos."""
    if examples is not None and examples.exists():
        told = learning.kept(examples)
    else:
        with progress_bar("terrains") as progress:
            told = learning.matched(data, 1 if quick else queries, seed, progress)
        if examples is not None:
            learning.keep(told, examples)
    found = learning.learned(told)
    options.tell(json_file, "confidence", found.rows)
    if model is not None:
        write_models(model, found.models, found.about)
    if plot is not None:
        save_reliability(plot, found.shown, "Learned on Sierra and Rofental, shown on Davos")
