"""The command line of benchmarks: ``skyline-bench COMMAND``."""

from collections.abc import Callable, Mapping
from functools import partial

from skyline.cli.app import command_line, run_app
from skyline_bench import (
    drawn,
    durability,
    figures,
    opening,
    options,
    orient,
    page,
    paper,
    photos,
    repeat,
    shards,
    sky_view,
    speed,
    summits,
)
from skyline_bench.search.commands import COMPARISONS, command_of
from skyline_bench.truth.stability import stability

COMMANDS: Mapping[str, Mapping[Callable[..., None], str]] = {
    "Skylines": {
        speed.speed_error: "9 minutes",
        speed.large_dem: "2 minutes",
        sky_view.sky_view: "5 minutes",
        stability: "a minute",
        summits.summits: "a minute",
    },
    "The paper's tables": {paper.table1: "2 minutes", paper.prediction_quality: "a minute"},
    "Builds, stores and files": {
        durability.store_durability: "an hour",
        durability.input_fuzz: "a minute",
    },
    "One answer": {opening.opening: "5 minutes"},
    "Large areas": {shards.shards: "10 minutes"},
    "Search": {command_of(name, one): one.takes for name, one in COMPARISONS.items()},
    "Photographs": {
        orient.orient: "20 minutes",
        drawn.drawn: "5 minutes",
        photos.photos: "30 minutes",
        photos.sky_masks: "a minute",
    },
    "The page": {page.page: "3 minutes"},
    "Records": {repeat.repeat: "as long as its command"},
    "The pages": {figures.figures: "a second", figures.readme_picture: "a minute"},
}
"""Commands by what they measure, and about how long each takes on 2 cores without a GPU."""

app = command_line(
    "skyline-bench",
    "Measure Skyline on this machine. Times are of 2 cores without a GPU; "
    "--quick takes two minutes at most, unless other options ask for more.",
)
for subject, commands in COMMANDS.items():
    for command, takes in commands.items():
        options.add_command(app, command, takes, subject)


main = partial(run_app, app)
