"""Photographs measured: skylines found in them, and where a real one is put."""

from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline.errors import InputError
from skyline.terrain.dem import read_dem
from skyline_bench.commands.options import (
    Dems,
    JsonFile,
    Quick,
    Seed,
    StoreFile,
    check_folder,
    check_outputs,
    keep_record,
    print_rows,
)
from skyline_bench.figures.readme import save_match
from skyline_bench.runs import photo_quality as drawn
from skyline_bench.runs import real_photo
from skyline_bench.runs import sky_masks as masks
from skyline_bench.training.photographs import draw_training_photos


def photo_quality(
    photos: Annotated[int, typer.Option(help="Of each of 20 conditions.")] = 10,
    json_file: JsonFile = None,
    seed: Seed = 0,
    quick: Quick = False,
) -> None:
    """Skylines extracted from drawn photos, condition by condition."""
    check_outputs(json_file, None)
    with progress_bar("conditions") as progress:
        found = drawn.measure(range(seed, seed + (1 if quick else photos)), progress)
    rows = [asdict(row) for row in found]
    print_rows(rows)
    keep_record(json_file, "photo-quality", rows)


def sky_masks(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="NAME.jpg and NAME.mask.png, white = mountain."),
    ],
    json_file: JsonFile = None,
    quick: Quick = False,
) -> None:
    """Skylines extracted from real photographs, against masks drawn by people."""
    check_outputs(json_file, None)
    with progress_bar("photographs") as progress:
        rows = masks.measure(folder, quick, progress)
    print_rows(rows)
    keep_record(json_file, "sky-masks", rows)


def train_sky_model(
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="The model, ONNX zipped.")
    ],
    photos: Annotated[int, typer.Option(help="Photographs to draw.")] = 4000,
    steps: Annotated[int, typer.Option(help="Batches of 16 to train on.")] = 3000,
    seed: Seed = 1,
    quick: Quick = False,
) -> None:
    """The network that finds skylines in photos, trained anew on drawn photographs."""
    check_folder("--out", out)
    with progress_bar("photographs") as progress:
        drawn_photos = draw_training_photos(16 if quick else photos, seed, progress)
    try:
        training = import_module("skyline_bench.training.training")
    except ModuleNotFoundError as error:
        raise InputError(
            f"training needs {error.name}, which is not installed: pip install -e 'bench[train]'"
        ) from error
    with progress_bar("steps") as progress:
        net = training.train(drawn_photos, 2 if quick else steps, seed, progress)
    training.write_model(net, out)


def photo(
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="The folder of the Rofental DEM and the photo.")
    ],
    store: Annotated[
        Path, typer.Argument(metavar="STORE", help="Its places; built where it is not there.")
    ],
    json_file: JsonFile = None,
    quick: Quick = False,
) -> None:
    """A webcam's photo against 725 km2, with and without its field of view."""
    check_outputs(json_file, None)
    rows = real_photo.measure(data, store, quick)
    print_rows(rows)
    keep_record(json_file, "real-photo", rows)


def readme_picture(
    store: StoreFile,
    dem: Dems,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The JPEG to write.")],
    quick: Quick = False,
) -> None:
    """The README's picture: a photo made beside Davos, and where it was put."""
    check_folder("--out", out)
    print_rows([save_match(store, read_dem(dem), out, width=512 if quick else 2048)])
