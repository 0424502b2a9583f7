"""The command line: ``skyline COMMAND``."""

import gc
from functools import partial
from importlib import import_module
from typing import Any

from typer.core import TyperGroup

from skyline.cli.app import command_line, command_of, run_app

COMMANDS = {
    "Photos": {
        "locate": "Find where photos were taken, fetching the elevation of the area.",
        "match": "Find where photos were taken and in which direction the camera looked.",
        "orient": "Find how cameras were held at a known position.",
        "label": "Write the names of summits on a copy of a photo.",
        "pixels": "Give the position on the terrain of each pixel of a photo.",
        "cross": "Give the position of something that two or more photos show.",
        "when": "Tell when a photo was taken, by sun, moon or shadow.",
        "draw": "Draw lines of a photo on the map, or the reverse.",
        "ortho": "Lay photos on the ground, as a Cloud-Optimized GeoTIFF.",
        "extract": "Find the skyline in a photo and write it as a trace.",
        "serve": "Serve a page that finds the places of photos in a browser.",
    },
    "Stores": {
        "build": "Build the store that `match` searches. After Ctrl-C, the same command continues.",
        "render": "Render views into a store, for the paper's matcher.",
        "store": "Check, repair, merge and export stores.",
    },
    "Views from a position": {
        "horizon": "Give the horizon at positions, by azimuth from true north.",
        "sun": "Print when sun and moon are above the mountains on a day.",
        "panorama": "Draw the view from a position, with the peaks' names.",
    },
    "Data": {
        "peaks": "Fetch the named peaks of an area from OpenStreetMap, for `--peaks`.",
        "info": "Describe a DEM, a store, or the OpenGL in use.",
        "explain": "Show which terrain a skyline depends on.",
        "dem": "Fetch the elevation of an area: `dem fetch`.",
        "cache": "List what is kept: areas, and elevation models that were read.",
    },
}
"""Commands by subject, each with the first line of its own help; each has a module of its name."""


class _Commands(TyperGroup):
    """Commands that are loaded when they are called.

    Some need a second to import.
    """

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return a command's name, the command, and its arguments.

        The command is loaded here.
        """
        name, known, rest = super().resolve_command(ctx, args)
        return name, known and loaded(str(known.name)), rest


def loaded(name: str) -> Any:
    """Load a command, or a group of them.

    Imports make no garbage; collecting it between them takes 7 % of their time.
    """
    gc.disable()
    try:
        module = import_module(f"skyline.cli.{name}")
    finally:
        gc.enable()
    return command_of(getattr(module, name), name)


app = command_line("skyline", "A photo of mountains in, a place on the map out.", _Commands)

for subject, commands in COMMANDS.items():
    for name, about in commands.items():
        app.command(name, help=about, rich_help_panel=subject)(lambda: None)


main = partial(run_app, app)
"""Run the command line; see `run_app`."""
