"""``skyline explain``: what a skyline depends on."""

from typing import Annotated

import typer
from typer import Option

from skyline.cli.facts import table_of
from skyline.cli.options import AsJson, Crs, Dems, parse_position
from skyline.cli.terminal import Terminal
from skyline.tasks.explain import MEANINGS, explain_skyline
from skyline.tasks.terrain import read_terrain
from skyline.terrain.viewpoints import position_on, stand_on


def explain(
    context: typer.Context,
    dem: Dems,
    at: Annotated[str, Option(metavar="LON,LAT", help="The position, degrees (WGS 84).")],
    crs: Crs = None,
    as_json: AsJson = False,
) -> None:
    """Show which terrain a skyline depends on.

    It also shows the terrain that is left out, and the resulting error.
    """
    terminal = Terminal.of(context, as_json)
    position = parse_position(at)
    terrain = read_terrain(terminal, dem, crs)
    easting_m, northing_m = position_on(terrain, *position)
    facts = explain_skyline(terrain, stand_on(terrain, easting_m=easting_m, northing_m=northing_m))
    terminal.result(facts, table_of(facts, MEANINGS))
