"""``skyline explain``: what a skyline depends on."""

from typing import Annotated

import typer
from typer import Option

from skyline.cli.facts import table_of
from skyline.cli.options import AsJson, Crs, Dems, parse_position
from skyline.cli.terminal import Terminal
from skyline.tasks.explain import MEANINGS, explain_skyline


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
    facts = explain_skyline(dem, crs, parse_position(at), terminal)
    terminal.result(facts, table_of(facts, MEANINGS))
