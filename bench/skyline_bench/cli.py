"""The command line of benchmarks: ``skyline-bench COMMAND``."""

import inspect
from collections.abc import Callable, Mapping

from skyline.cli.console import command_line, run_app
from skyline_bench.commands import matching, photos, skylines, stores

COMMANDS: Mapping[str, Mapping[Callable[..., None], str]] = {
    "Skylines": {
        skylines.speed_error: "9 minutes",
        skylines.stability: "a minute",
        skylines.place_speed: "a minute",
        skylines.horizon: "3 minutes",
        skylines.summits: "a minute",
        skylines.large_dem: "2 minutes",
        skylines.pipeline_speed: "a minute",
    },
    "Planning": {skylines.table1: "a minute", skylines.prediction_quality: "a minute"},
    "Builds, stores and files": {
        stores.store_durability: "an hour",
        stores.input_fuzz: "a minute",
    },
    "Search": {
        matching.matching: "hours",
        matching.uniform_adaptive: "25 minutes",
        matching.scale: "hours",
        matching.placing: "an hour",
        matching.retrieval_scale: "5 minutes",
        matching.strangers: "10 minutes",
        matching.same_place: "20 minutes",
        matching.calibrate: "an hour",
    },
    "Photographs": {
        photos.photos: "30 minutes",
        photos.sky_masks: "a minute",
        photos.train_sky_model: "an hour",
        photos.readme_picture: "a minute",
    },
    "The page": {skylines.page: "3 minutes"},
}
"""Commands by what they measure, and about how long each takes on 2 cores without a GPU."""

app = command_line(
    "skyline-bench",
    "Measure Skyline on this machine. Times are of 2 cores without a GPU; see --quick.",
)
for subject, commands in COMMANDS.items():
    for command, takes in commands.items():
        told = (inspect.getdoc(command) or "").splitlines()[0].rstrip(".")
        app.command(
            command.__name__.replace("_", "-"),
            short_help=f"{told} ({takes}).",
            rich_help_panel=subject,
        )(command)


def main() -> None:
    """Run the command line; every error is one line, exit code 2 for bad input, 1 for failure."""
    run_app(app)
