"""The command line of benchmarks: ``skyline-bench COMMAND``."""

import inspect
from collections.abc import Callable, Mapping

from skyline.console import command_line, run_app
from skyline_bench.commands.matching import matching, uniform_adaptive
from skyline_bench.commands.photos import photos, readme_picture
from skyline_bench.commands.placing import placing
from skyline_bench.commands.planning import prediction_quality, table1
from skyline_bench.commands.search import (
    calibrate,
    retrieval_scale,
    same_place,
    scale,
    strangers,
)  # fmt: skip
from skyline_bench.commands.sky_model import sky_masks, train_sky_model
from skyline_bench.commands.skylines import (
    horizon,
    large_dem,
    page,
    pipeline_speed,
    place_speed,
    speed_error,
    stability,
    summits,
)  # fmt: skip
from skyline_bench.commands.stores import input_fuzz, sharded_build, store_durability

COMMANDS: Mapping[str, Mapping[Callable[..., None], str]] = {
    "Skylines": {
        speed_error: "10 minutes",
        stability: "5 minutes",
        place_speed: "a minute",
        horizon: "3 minutes",
        summits: "a minute",
        large_dem: "2 minutes",
        pipeline_speed: "a minute",
    },
    "Planning": {table1: "a minute", prediction_quality: "a minute"},
    "Builds, stores and files": {
        sharded_build: "an hour",
        store_durability: "an hour",
        input_fuzz: "2 minutes",
    },
    "Search": {
        matching: "hours",
        uniform_adaptive: "hours",
        scale: "hours",
        placing: "an hour",
        retrieval_scale: "5 minutes",
        strangers: "10 minutes",
        same_place: "20 minutes",
        calibrate: "20 minutes",
    },
    "Photographs": {
        photos: "30 minutes",
        sky_masks: "a minute",
        train_sky_model: "an hour",
        readme_picture: "a minute",
    },
    "The page": {page: "3 minutes"},
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
    run_app(app, "stopped; nothing was written")
