"""``skyline store check repair merge compact export``: looking after stores."""

import json
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline.cli.console import AsJson, say
from skyline.errors import InputError
from skyline.report.geopackage import write_geopackage
from skyline.store import (
    CopyReport,
    RowCoding,
    check_store,
    compact_store,
    merge_stores,
    open_store,
    repair_store,
)
from skyline.store.header import RENDERINGS, check_holds
from skyline.text import printable

_DAMAGED = 2

store = typer.Typer(
    name="store", help="Check, repair, merge, compact and export stores.", no_args_is_help=True
)

StoreFile = Annotated[Path, Argument(metavar="STORE")]
NewStore = Annotated[Path, Option("--output", "-o", help="The new store; must not exist.")]


@store.command()
def check(store: StoreFile, as_json: AsJson = False) -> None:
    """Read a whole store and compare it with its checksums; exit code 2 if it is damaged."""
    report = check_store(store)
    built = report.built
    if as_json:
        facts = {"whole": report.whole, "finished": built.finished, "built_share": built.share}
        with suppress(BrokenPipeError):  # The exit code is true also where nobody reads this.
            say(json.dumps({"store": printable(store), **facts, **asdict(report)}))
        raise typer.Exit(0 if report.whole else _DAMAGED)
    if not report.whole:
        said = "; ".join(damage.what for damage in report.damage[:3])
        more = f"; and {len(report.damage) - 3} more" if len(report.damage) > 3 else ""
        raise InputError(f"{store} is damaged: {said}{more}")
    in_use = "a writer has it open, or was killed" if report.in_use else ""
    said = f"{store}: {report.committed:,} {report.holds}, whole"
    say("; ".join(filter(None, [said, in_use, built.note])))


@store.command()
def repair(store: StoreFile, output: NewStore) -> None:
    """Save the undamaged rows of a store in a new store, in their order."""
    report = repair_store(store, output)
    _say_copied(report, output)
    for damage in report.damage:
        rows = f"rows {damage.first_row} to {damage.first_row + damage.rows - 1}"
        say(f"  left out {rows}: {damage.what}")


@store.command()
def merge(stores: Annotated[list[Path], Argument(metavar="STORE...")], output: NewStore) -> None:
    """Join several stores into one, sorted by location; equal rows are kept once."""
    _say_copied(merge_stores(stores, output), output)


@store.command()
def compact(
    store: StoreFile,
    output: NewStore,
    quantize: Annotated[
        bool, Option("--quantize", help="Round exact rows; they then take a fifth of the bytes.")
    ] = False,
    tan_error_px: Annotated[
        float, Option("--tan-error-px", help="With --quantize: greatest error of skylines, px.")
    ] = 0.005,
    depth_error: Annotated[
        float, Option("--depth-error", help="With --quantize: greatest relative error of depths.")
    ] = 0.001,
) -> None:
    """Write a sorted copy without dead bytes; the same rows give the same bytes."""
    coding = None
    if quantize:
        with open_store(store) as opened:
            check_holds(store, opened.header, RENDERINGS)
            coding = RowCoding.within(opened.header.width, tan_error_px, depth_error)
    _say_copied(compact_store(store, output, coding), output)


@store.command()
def export(
    store: StoreFile,
    output: Annotated[
        Path, Option("--output", "-o", metavar="FILE.gpkg", help="The GeoPackage to write.")
    ],
) -> None:
    """Write where the places are as a GeoPackage, for QGIS, with its style (extra `geo`)."""
    with open_store(store) as opened:
        count = write_geopackage(opened, output)
    note = f"; {opened.built.note}" if opened.built.note else ""
    say(f"{output}: {count:,} places, {output.stat().st_size / 1e6:.1f} MB{note}")


def _say_copied(report: CopyReport, path: Path) -> None:
    size = path.stat().st_size
    each = f", {size / report.rows:.0f} bytes each" if report.rows else ""
    again = f", {report.duplicates} duplicates left out" if report.duplicates else ""
    lost = sum(damage.rows for damage in report.damage)
    damaged = f", {lost} damaged rows left out" if lost else ""
    note = f"; {report.built.note}" if report.built.note else ""
    say(f"{path}: {report.rows:,} {report.holds}{each}{again}{damaged}{note}")
