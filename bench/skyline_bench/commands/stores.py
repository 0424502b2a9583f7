"""Stores and damaged input: what they withstand."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline_bench.commands import options
from skyline_bench.measuring.record import Row, write_record
from skyline_bench.runs import input_fuzz as damaged_input
from skyline_bench.runs import store_durability as durability

_DURABILITY = durability.DurabilityConfig(Path())


def store_durability(
    dem: Annotated[Path, Argument(metavar="DEM", help="What stores are built from.")],
    builds: Annotated[int, Option(help="Builds to kill.")] = _DURABILITY.builds,
    flips: Annotated[int, Option(help="Bits, one at a time.")] = _DURABILITY.flips,
    cases: Annotated[int, Option(help="Mutated files.")] = _DURABILITY.cases,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
) -> None:
    """Builds killed at random instants, with workers too; bits flipped; files mutated."""
    if quick:
        builds, flips, cases = min(builds, 4), min(flips, 5), min(cases, 10)
    config = durability.DurabilityConfig(dem, builds, flips, cases)
    rows: list[Row] = []
    for name, test in durability.TESTS.items():
        with tempfile.TemporaryDirectory() as folder:
            for row in test(config, Path(folder)):
                rows.append(row)
                options.print_rows([row])
        typer.echo(f"{name}: done", err=True)
    # At the end: a record names the renderer, and OpenGL does not outlive the forks of these tests.
    write_record(json_file, "store-durability", rows)


def input_fuzz(
    cases: Annotated[int, Option(help="Of each kind of file.")] = 250,
    json_file: options.JsonFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
) -> None:
    """Damaged DEMs, viewpoint lists, traces and images: one line and exit 2, or an answer."""
    rows: list[Row] = []
    # No bar: what it writes would be taken for a line of the command that is at work.
    for row in damaged_input.measure(min(cases, 10) if quick else cases, seed):
        rows.append(row)
        typer.echo(f"{row['file']}: {row['cases']} files", err=True)
    options.report(json_file, "input-fuzz", rows)
