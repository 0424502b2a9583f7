"""The command line of training: ``python -m skyline_training COMMAND``."""

from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Annotated

from typer import Option

from skyline.cli.app import command_line, run_app
from skyline.cli.terminal import Terminal
from skyline.errors import InputError
from skyline.match.confidence import ORIENTED
from skyline.terrain.dem import read_dem
from skyline.terrain.provenance import DemOptions
from skyline_bench import options
from skyline_bench.repeat import repeat
from skyline_training import confidence as learning
from skyline_training.examples import gather_matches, read_examples, write_examples
from skyline_training.orientation import gather_headings, learn_orientation
from skyline_training.panoramas import write_panoramas
from skyline_training.photos import draw_training_photos

_QUICK_PLACES = 2_000
"""Places of each store of a quick run."""

app = command_line(
    "skyline_training",
    "Train the sky model and the confidence. Times are of 2 cores without a GPU.",
)

Terrains = Annotated[
    Path,
    options.read_argument("DATA", "A folder with sierra, rofental, everest and davos."),
]


def sky_model(
    out: Annotated[Path, options.new_file("The model, ONNX zipped.", "--output", "-o")],
    minutes: Annotated[float, Option(help="Time to train for.")] = 9.0,
    seed: options.Seed = 1,
    quick: Annotated[bool, options.quick_with(minutes=0.01)] = False,
) -> None:
    """The network that finds skylines in photos.

    It learns, on a GPU, from photographs that are drawn meanwhile on all cores. Skyline's own
    network was trained for 8.5 minutes on an H200 beside 16 cores; see docs/accuracy.md.
    """
    try:
        from skyline_training import network  # noqa: PLC0415  (torch is an extra)
    except ModuleNotFoundError as error:
        raise InputError(
            f"training needs {error.name}, which is not installed: pip install -e 'bench[train]'"
        ) from error
    with Terminal().progress("training") as progress, closing(draw_training_photos(seed)) as photos:
        net = network.train(photos, minutes, seed, progress)
    network.write_model(net, out)


def panoramas(
    dem: options.Dems,
    out: Annotated[Path, Option("--output", "-o", help="A folder for them and manifest.csv.")],
    photos: Annotated[int, Option(help="Panoramas to draw.")] = 40,
    seed: options.Seed = 39,
    crs: options.Crs = None,
) -> None:
    """Panoramas of a DEM as phones make them, to measure with.

    They are drawn, and a manifest is written, too.
    """
    with Terminal().progress("panoramas") as progress:
        write_panoramas(read_dem(dem, DemOptions(crs=crs)), out, photos, seed, progress)


def confidence(
    data: Terrains,
    queries: Annotated[int, Option(help="Of each of nine kinds, on each terrain.")] = 48,
    model: Annotated[
        Path | None, options.new_file("Write the models: skyline's confidence.json.", "--model")
    ] = None,
    examples: Annotated[
        Path | None, options.new_file("Kept here, and read where they exist.", "--examples")
    ] = None,
    record: options.Record = None,
    plot: options.PlotFile = None,
    seed: options.Seed = 6000,
    quick: Annotated[bool, options.quick_with(queries=1)] = False,
) -> None:
    """The confidence of matches: how far they can be believed.

    It is learned on Sierra, Rofental and Everest, and its reliability is shown on Davos.
    """
    if examples is not None and examples.exists():
        found = read_examples(examples)
    else:
        with Terminal().progress("terrains") as progress:
            places = _QUICK_PLACES if quick else None
            found = gather_matches(data, queries, seed, progress, places)
        if examples is not None:
            write_examples(found, examples)
    learned = learning.learn_all(found)
    options.report(record, learned.rows)
    if model is not None:
        learning.write_models(model, learned.models, learned.about)
    if plot is not None:
        learning.save_reliability(plot, learned.shown)


def orientation(
    data: Terrains,
    queries: Annotated[int, Option(help="Of each of six kinds, on each terrain.")] = 45,
    model: Annotated[
        Path | None, options.new_file("Write the model: skyline's orientation.json.", "--model")
    ] = None,
    record: options.Record = None,
    seed: options.Seed = 100,
    quick: Annotated[bool, options.quick_with(queries=1)] = False,
) -> None:
    """The confidence of headings at known places.

    It is learned as that of matches, and its reliability is shown on Davos.
    """
    with Terminal().progress("terrains") as progress:
        found = gather_headings(data, queries, seed, progress)
    learned, rows = learn_orientation(found)
    options.report(record, rows)
    if model is not None:
        about = {"examples": {name: len(some) for name, some in found.items()}}
        learning.write_models(model, {ORIENTED: learned}, about)


COMMANDS: Mapping[Callable[..., None], str] = {
    sky_model: "as long as --minutes says",
    panoramas: "5 minutes",
    confidence: "1.5 hours",
    orientation: "half an hour",
    repeat: "as long as its command",
}
"""Commands, and about how long each takes."""

for command, takes in COMMANDS.items():
    options.add_command(app, command, takes)


if __name__ == "__main__":
    run_app(app)
