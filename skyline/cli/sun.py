"""``skyline sun``: when the sun is above the mountains."""

from typing import Annotated

import typer
from typer import Option

from skyline.cli.options import Crs, Dems, EyeHeight, SummitWithin, parse_position, read_terrain
from skyline.cli.terminal import Terminal
from skyline.horizons import horizons_of
from skyline.sun import day_of
from skyline.tasks.standing import stand_with_notes, warn_of_border
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M


def sun(
    context: typer.Context,
    dem: Dems,
    at: Annotated[
        list[str],
        Option(metavar="LON,LAT", help="A position, degrees (WGS 84); may be repeated."),
    ],
    day: Annotated[str, Option("--date", metavar="YYYY-MM-DD", help="The day at the position.")],
    eye_height: EyeHeight = DEFAULT_EYE_HEIGHT_M,
    summit_within: SummitWithin = None,
    crs: Crs = None,
) -> None:
    """Print when the sun is above the mountains on a day.

    The result is a CSV of times in UTC. The extra `sun` is needed.
    """
    terminal = Terminal.of(context)
    asked = day_of(day)
    positions = [parse_position(text) for text in at]
    terrain = read_terrain(terminal, dem, crs)
    eyes = stand_with_notes(terrain, positions, eye_height, summit_within, terminal)
    with terminal.progress("rendering") as progress:
        found = horizons_of(terrain, eyes, progress=progress)
    terminal.line("lon,lat,from_utc,to_utc")
    for place in range(len(found)):
        for begin, end in found.sun_above(asked, place):
            times = ",".join(f"{time:%Y-%m-%dT%H:%M:%SZ}" for time in (begin, end))
            terminal.line(f"{found.lon[place]:.7f},{found.lat[place]:.7f},{times}")
    warn_of_border(found)
