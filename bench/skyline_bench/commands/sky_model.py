"""The network that finds skylines in photos: measured against masks, and trained anew."""

from importlib import import_module
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from skyline.console import progress_bar
from skyline.errors import InputError
from skyline_bench.commands import options
from skyline_bench.runs import sky_masks as masks
from skyline_bench.training.photographs import draw_training_photos


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
