"""The command line: ``skyline COMMAND``."""

from functools import partial
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

from skyline.cli.console import command_line, run_app, with_quiet

COMMANDS = {
    "Photos": {
        "locate.locate": "Find where photos were taken, fetching the elevation of the area and "
        "building its store.",
        "match.match": "Find where photos were taken and in which direction the camera looked.",
        "orient.orient": "Find how cameras were held at a known place: heading, pitch, roll and "
        "field of view.",
        "orient.label": "Write the names and distances of the summits in a photo on a copy of it.",
        "orient.pixels": "Give the place on the terrain that each pixel of a photo shows.",
        "photo.extract": "Find the skyline in a photo and write it as a trace that a person "
        "can correct.",
        "photo.serve": "Serve a page for the browser: drop photos, mend skylines, find places, "
        "fit by hand.",
    },
    "Stores": {
        "build.build": "Build the store that `match` searches. After Ctrl-C, the same command "
        "continues.",
        "build.render": "Render views to grid north, east, south and west into a store, for the "
        "paper's matcher.",
        "store.store": "Check, repair, merge and export stores.",
    },
    "Views from a place": {
        "views.horizon": "Give the horizon around places: elevation angle and distance by "
        "azimuth from true north.",
        "views.sun": "Print when the sun is above the mountains on a day: CSV of times in UTC "
        "(extra `sun`).",
        "views.panorama": "Draw the view from a place, with the names of the peaks in sight.",
    },
    "Data": {
        "fetch.peaks": "Fetch the named peaks of a box from OpenStreetMap, for `--peaks`.",
        "info.info": "Describe a DEM, a store, or the OpenGL in use.",
        "info.explain": "Show which terrain a skyline depends on, which is left out, and the "
        "resulting error.",
        "fetch.dem": "Fetch the elevation of an area: `dem fetch`.",
        "fetch.cache": "List what `locate` keeps: elevation tiles and stores of areas.",
    },
}
"""Commands by subject: module and name of each, and the first line of its own help."""

_MODULES = {
    name: module
    for commands in COMMANDS.values()
    for module, name in (path.split(".") for path in commands)
}


class _Commands(TyperGroup):
    """Commands that are loaded when they are called: some need a second to import."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name of a command, the command, which is loaded here, and its arguments."""
        name, known, rest = super().resolve_command(ctx, args)
        return name, known and loaded(str(known.name)), rest


def loaded(name: str) -> Any:
    """Load a command, or a group of them."""
    found = getattr(import_module(f"skyline.cli.{_MODULES[name]}"), name)
    if isinstance(found, typer.Typer):
        return with_quiet(typer.main.get_group(found))
    alone = typer.Typer(add_completion=False)
    alone.command(name)(found)
    return with_quiet(typer.main.get_command(alone))


app = command_line("skyline", "A photo of mountains in, a place on the map out.", _Commands)

for subject, commands in COMMANDS.items():
    for path, about in commands.items():
        app.command(path.partition(".")[2], help=about, rich_help_panel=subject)(lambda: None)


main = partial(run_app, app)
"""Run the command line; see `run_app`."""
