"""Photographs measured, the network that finds their skylines trained, and the README's own."""

from collections.abc import Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from skyline import InputError, Viewer
from skyline.build.cluster import Progress
from skyline.cli.console import progress_bar
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.figures.photo_pages import PhotographsPage, save_match
from skyline_bench.measuring.record import write_record
from skyline_bench.queries.manifest import EXTRACT, KINDS, Photograph, read_manifest
from skyline_bench.runs import sky_masks as masks
from skyline_bench.runs.photographs import Measured, PhotosConfig, Shown, measure, summarize
from skyline_bench.training.training_photos import draw_training_photos

_PHOTOS = PhotosConfig()
_PHOTO_COLUMNS = """photo kind trusted right_columns=right error_m rank
    heading_error_deg=heading_off confidence answered gps_off_m=GPS_off_m lost=lost_by seconds=s"""


def photos(
    manifest: Annotated[
        Path, Argument(metavar="MANIFEST.csv", help="Photographs and what is true of them.")
    ],
    dem: Annotated[
        list[str] | None,
        Argument(metavar="DEM...", help="Their elevation model; none to extract alone."),
    ] = None,
    folder: options.Folder = None,
    side_km: Annotated[
        float, Option(help="Side of the square about a photograph that is searched.")
    ] = _PHOTOS.side_m / 1000.0,
    spacing: Annotated[
        float | None, Option(metavar="M", help="Between places; planned by default.")
    ] = None,
    use_gps: Annotated[
        bool, Option("--use-gps", help="Let the photographs' own positions draw the search.")
    ] = False,
    page: Annotated[
        Path | None,
        Option(
            metavar="FILE.html",
            help="Draw each photograph's skylines.",
            callback=options.in_a_folder,
        ),
    ] = None,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Real photographs: their skylines, their places, and which stage lost a place.

    docs/howto/comparing-grids.md has the columns of a manifest.

    An area of 22 km takes minutes to build, a photograph 10 s, one that is lost a minute.

    --quick searches areas of 4 km, and three photographs of each kind.
    """
    wanted = read_manifest(manifest)
    config = PhotosConfig(1000.0 * side_km, spacing, use_gps)
    if quick:
        config, wanted = config.quick(), _some(wanted)
    located = any(one.kind != EXTRACT for one in wanted)
    if located and not dem:
        raise InputError(f"{manifest} has photographs to locate; give their elevation model too")
    terrain = read_dem(dem, DemOptions(crs=crs)) if located and dem else None
    drawn = PhotographsPage() if page is not None else None
    with options.store_folder(folder) as place, progress_bar("photographs") as progress:
        rows = measure(wanted, terrain, config, place, _told(drawn, progress, len(wanted)))
    summary = summarize(rows)
    options.print_rows(rows, _PHOTO_COLUMNS)
    options.print_rows(summary)
    name = manifest.stem
    how = {"manifest": name, **asdict(config)}
    rows = [{**how, **row} for row in rows]
    summary = [{**how, **row} for row in summary]
    write_record(json_file, "photos", rows, {"photos": summary})
    if drawn is not None and page is not None:
        drawn.write(page, f"{len(rows)} photographs of {manifest.name}.")


def _some(wanted: Sequence[Photograph]) -> list[Photograph]:
    return [one for kind in KINDS for one in [o for o in wanted if o.kind == kind][:3]]


def _told(page: PhotographsPage | None, progress: Progress, count: int) -> Shown:
    done = iter(range(1, count + 1))

    def shown(measured: Measured, viewer: Viewer | None) -> None:
        if page is not None:
            page.add(measured, viewer)
        progress(next(done), count)

    return shown


def readme_picture(
    out: Annotated[Path, options.new_file("The JPEG to write.", "--out", "-o")],
    quick: options.Quick = False,
) -> None:
    """The README's picture: a photo made of the sample terrain, and where it was put."""
    options.print_rows([save_match(out, width=512 if quick else 2048)])


def sky_masks(
    folder: Annotated[
        Path, Argument(metavar="FOLDER", help="NAME.jpg and NAME.mask.png, white = mountain.")
    ],
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
) -> None:
    """Skylines extracted from real photographs, against masks drawn by people."""
    with progress_bar("photographs") as progress:
        rows = masks.measure(folder, quick, progress)
    options.tell(json_file, "sky-masks", rows)


def train_sky_model(
    out: Annotated[Path, options.new_file("The model, ONNX zipped.", "--out", "-o")],
    photos: Annotated[int, Option(help="Photographs to draw.")] = 6000,
    steps: Annotated[int, Option(help="Batches of 16 to train on.")] = 4500,
    seed: options.Seed = 1,
    quick: options.Quick = False,
) -> None:
    """The network that finds skylines in photos, trained anew on drawn photographs."""
    try:
        training = import_module("skyline_bench.training.training")
    except ModuleNotFoundError as error:
        raise InputError(
            f"training needs {error.name}, which is not installed: pip install -e 'bench[train]'"
        ) from error
    with progress_bar("photographs") as progress:
        drawn = draw_training_photos(16 if quick else photos, seed, progress)
    with progress_bar("steps") as progress:
        net = training.train(drawn, 2 if quick else steps, seed, progress)
    training.write_model(net, out)
