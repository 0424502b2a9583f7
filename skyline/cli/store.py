"""``skyline store``: checking, repairing, merging and exporting stores."""

import json
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument

from skyline.cli.options import AsJson, StoreFile, output_option
from skyline.cli.terminal import Terminal, size_in_words
from skyline.errors import InputError, printable
from skyline.store.check import StoreReport, check_store
from skyline.store.merge import merge_stores, repair_store
from skyline.store.read import open_store

NewStore = Annotated[Path, output_option("The new store; must not exist.", "STORE.h5")]

store = typer.Typer(
    name="store", help="Check, repair, merge and export stores.", no_args_is_help=True
)


@store.command()
def check(context: typer.Context, store: StoreFile, as_json: AsJson = False) -> None:
    """Read a whole store and compare it with its checksums.

    The exit code is 2 if the store is damaged.
    """
    terminal = Terminal.of(context, as_json)
    report = check_store(store)
    if as_json:
        # The exit code must hold also where the output is not read.
        with suppress(BrokenPipeError):
            facts = {key: value for key, value in asdict(report).items() if key != "duplicates"}
            terminal.line(json.dumps({"store": printable(store), "whole": report.whole, **facts}))
        raise typer.Exit(0 if report.whole else InputError.exit_code)
    if report.damage and not report.rows:
        raise InputError(report.damage[0].what)  # The error of opening the store names it.
    if not report.whole:
        first = "; ".join(damage.what for damage in report.damage[:3])
        more = f"; and {len(report.damage) - 3} more" if len(report.damage) > 3 else ""
        raise InputError(f"{store} is damaged: {first}{more}")
    terminal.line(f"{store}: {report.rows:,} {report.holds}, whole")


@store.command()
def repair(context: typer.Context, store: StoreFile, output: NewStore) -> None:
    """Save the undamaged rows of a store in a new store.

    The rows keep their order.
    """
    terminal = Terminal.of(context)
    report = repair_store(store, output)
    terminal.line(_copied_in_words(report, output))
    for damage in report.damage:
        rows = f"rows {damage.first_row} to {damage.first_row + damage.rows - 1}"
        terminal.line(f"  left out {rows}: {damage.what}")


@store.command()
def merge(
    context: typer.Context,
    stores: Annotated[list[Path], Argument(metavar="STORE.h5", help="Stores of one DEM.")],
    output: NewStore,
) -> None:
    """Join stores of one DEM into one.

    A place that several stores have is kept once.
    """
    report = merge_stores(stores, output)
    Terminal.of(context).line(_copied_in_words(report, output))


@store.command()
def export(
    context: typer.Context,
    store: StoreFile,
    output: Annotated[Path, output_option("The GeoPackage to write.", "FILE.gpkg")],
) -> None:
    """Write the locations of a store's places as a GeoPackage.

    QGIS and other programs read it. The extra `geo` is needed.
    """
    from skyline.report.place_files import write_geopackage  # noqa: PLC0415  (slow to load)

    with open_store(store) as opened:
        count = write_geopackage(opened, output)
    Terminal.of(context).line(f"{output}: {count:,} places, {size_in_words(output.stat().st_size)}")


def _copied_in_words(report: StoreReport, path: Path) -> str:
    size = path.stat().st_size
    each = f", {size / report.rows:.0f} bytes each" if report.rows else ""
    again = f", {report.duplicates} duplicates left out" if report.duplicates else ""
    lost = sum(damage.rows for damage in report.damage)
    damaged = f", {lost} damaged rows left out" if lost else ""
    return f"{path}: {report.rows:,} {report.holds}{each}{again}{damaged}"
