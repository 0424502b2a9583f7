"""Builds and stores measured: shards, what stores withstand, and what damaged input does."""

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline.console import progress_bar
from skyline.errors import InputError
from skyline.terrain.dem import read_dem
from skyline_bench.commands import options
from skyline_bench.commands.options import Names
from skyline_bench.measuring.record import Row, write_record
from skyline_bench.runs import input_fuzz as damaged_input
from skyline_bench.runs import sharded_build as shards
from skyline_bench.runs import store_durability as durability

_DURABILITY = durability.DurabilityConfig(Path())


def sharded_build(
    dem: options.Dems,
    part: Annotated[
        Names, Option(help=f"May be repeated; by default all: {', '.join(shards.PARTS)}.")
    ] = None,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
) -> None:
    """Sharded builds of the High Sierra: two workers against one, one killed, 3,000 km2.

    DEM are 3 arc-second tiles about 119.6 to 119.0 degrees west, 37.4 to 38.0 north. In a record
    that is there already, the parts that are not run keep their rows.
    """
    parts = _known(part or (["killed"] if quick else None), shards.PARTS)
    rows = options.rows_but(json_file, "case", parts)
    terrain = read_dem(dem)
    with progress_bar("parts") as progress:
        for index, name in enumerate(parts):
            progress(index, len(parts))
            with tempfile.TemporaryDirectory() as folder:
                rows += shards.PARTS[name](terrain, Path(folder), quick)
            write_record(json_file, "sharded-build", rows)
    for row in rows:
        options.print_rows([row])


def store_durability(
    dem: Annotated[Path, Argument(metavar="DEM", help="What builds to kill are made from.")],
    test: Annotated[
        Names, Option(help=f"May be repeated; by default all: {', '.join(durability.TESTS)}.")
    ] = None,
    store: Annotated[
        list[Path] | None, Option(help="Of exact rows, to compare codings on; may be repeated.")
    ] = None,
    kills: Annotated[int, Option(help="Of a writer, and of a build.")] = _DURABILITY.kills,
    flips: Annotated[int, Option(help="Bits, one at a time.")] = _DURABILITY.flips,
    cases: Annotated[int, Option(help="Mutated files.")] = _DURABILITY.cases,
    seconds: Annotated[float, Option(help="Of reading.")] = _DURABILITY.seconds,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
) -> None:
    """Builds killed, bits flipped, files mutated, readers beside a writer; codings of rows.

    In a record that is there already, the tests that are not run keep their rows.
    """
    tests = _known(test, durability.TESTS)
    config = durability.DurabilityConfig(dem, tuple(store or ()), kills, flips, cases, seconds)
    if quick:
        config = replace(config, kills=3, flips=5, cases=10, seconds=2.0, renderings=64)
    rows = options.rows_but(json_file, "test", [name.replace("-", " ") for name in tests])
    with tempfile.TemporaryDirectory() as folder:
        for row in durability.measure(config, tests, Path(folder)):
            rows.append(row)
            options.print_rows([row])
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


def _known(asked: list[str] | None, names: Mapping[str, object]) -> list[str]:
    """Return the names asked for, by default all."""
    for name in asked or ():
        if name not in names:
            raise InputError(f"{name!r} is none of {', '.join(names)}")
    return asked or list(names)
