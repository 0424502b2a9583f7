"""The command line of benchmarks: ``skyline-bench COMMAND``."""

from typing import Annotated

import typer

from skyline import __version__
from skyline.console import run_app
from skyline_bench.commands.adaptive import uniform_adaptive
from skyline_bench.commands.matching import matching
from skyline_bench.commands.rendering import speed_error, stability
from skyline_bench.commands.scale import scale
from skyline_bench.commands.simulation import table1

app = typer.Typer(
    name="skyline-bench",
    help="Measure Skyline: speeds with their errors, on this machine.",
    pretty_exceptions_enable=False,
    add_completion=False,
)
app.command("speed-error")(speed_error)
app.command()(stability)
app.command()(table1)
app.command()(matching)
app.command("uniform-adaptive")(uniform_adaptive)
app.command()(scale)


@app.callback(invoke_without_command=True)
def options(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Measure Skyline: speeds with their errors, on this machine."""
    if version:
        typer.echo(f"skyline {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


def main() -> None:
    """Run the command line; every error is one line, exit code 2 for bad input, 1 for failure."""
    run_app(app, "stopped; nothing was written")
