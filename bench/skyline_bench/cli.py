"""The command line of benchmarks: ``skyline-bench COMMAND``."""

import inspect
from collections.abc import Callable, Mapping

from skyline.cli.console import command_line, run_app
from skyline_bench.commands import (
    matching,
    page,
    paper,
    photos,
    skylines,
    speed,
    stores,
)

COMMANDS: Mapping[str, Mapping[Callable[..., None], str]] = {
    "Skylines": {
        speed.speed_error: "9 minutes",
        speed.large_dem: "2 minutes",
        skylines.stability: "a minute",
        skylines.summits: "a minute",
    },
    "The paper's tables": {paper.table1: "2 minutes", paper.prediction_quality: "a minute"},
    "Builds, stores and files": {
        stores.store_durability: "an hour",
        stores.input_fuzz: "a minute",
    },
    "Search": {
        matching.matching: "hours",
        matching.uniform_adaptive: "an hour",
        matching.placing: "an hour",
        matching.scale: "hours",
        matching.same_place: "20 minutes",
        matching.strangers: "10 minutes",
    },
    "Photographs": {
        photos.photos: "30 minutes",
        photos.sky_masks: "a minute",
    },
    "The page": {page.page: "3 minutes", page.readme_picture: "a minute"},
}
"""Commands by what they measure, and about how long each takes on 2 cores without a GPU."""

app = command_line(
    "skyline-bench",
    "Measure Skyline on this machine. Times are of 2 cores without a GPU; see --quick.",
)
for subject, commands in COMMANDS.items():
    for command, takes in commands.items():
        summary = (inspect.getdoc(command) or "").splitlines()[0].rstrip(".")
        app.command(
            command.__name__.replace("_", "-"),
            short_help=f"{summary} ({takes}).",
            rich_help_panel=subject,
        )(command)


def main() -> None:
    """Run the command line; every error is one line, exit code 2 for bad input, 1 for failure."""
    run_app(app)
