"""Our search measured: large areas, very many places, one place, strangers, its confidence."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from skyline.console import progress_bar
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.commands.options import Floats
from skyline_bench.figures.plots import save_reliability, save_scale
from skyline_bench.runs import learning
from skyline_bench.runs import retrieval_scale as retrieval
from skyline_bench.runs import same_place as together
from skyline_bench.runs import scale as size
from skyline_bench.runs import strangers as elsewhere
from skyline_bench.runs.calibration import write_models

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
    options.keep_record(json_file, "scale", rows, {"store": [cost]})
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
        rows = retrieval.measure(store, dem, places, queries, seed, progress)
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
        found = elsewhere.measure(store, dem, terrain, count, seed, progress)
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
        save_reliability(plot, found.shown, "Learned on Sierra, Rofental and Everest")
