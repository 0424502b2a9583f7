"""``skyline build`` and ``store``: stores are built, checked, repaired, merged and exported."""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline.build.cluster import runner_of
from skyline.build.parts import BuildResult, build_store
from skyline.build.plans import PlacePlan
from skyline.build.spacing import expected_finds
from skyline.cli.console import (
    AsJson,
    Crs,
    Dems,
    RefractionK,
    Reproject,
    StoreFile,
    Workers,
    on_interrupt,
    output_option,
    parse_bounds,
    print_line,
    progress_bar,
    read_terrain,
)
from skyline.errors import InputError, printable
from skyline.geodesy import DEFAULT_REFRACTION_K, Curvature
from skyline.store import StoreReport, check_store, merge_stores, open_store, repair_store
from skyline.store.read import parts_folder

Output = Annotated[Path, output_option("The store to write.", "STORE.h5")]
Bounds = Annotated[
    str | None,
    Option(
        metavar="W,S,E,N",
        help="The area of the eyes: west, south, east, north in degrees (WGS 84).",
        show_default="all of the DEM",
    ),
]
NewStore = Annotated[Path, output_option("The new store; must not exist.", "STORE.h5")]


def build(
    dem: Dems,
    output: Output,
    spacing: Annotated[
        float | None,
        Option(
            metavar="M",
            help="Metres between places of a uniform grid.",
            show_default="places are planned",
        ),
    ] = None,
    places: Annotated[
        int | None,
        Option(
            metavar="N",
            help="About this many places: dense where skylines are near, else sparse. "
            "A thousand take a quarter of a second on two cores without a GPU, and 0.7 MB.",
            show_default="100,000; fewer for small areas, more for large ones",
        ),
    ] = None,
    bounds: Bounds = None,
    workers: Workers = None,
    k: RefractionK = DEFAULT_REFRACTION_K,
    crs: Crs = None,
    reproject: Reproject = False,
) -> None:
    """Build the store that `match` searches. After Ctrl-C, the same command continues."""
    advise_to_continue(output)
    if spacing is not None and places is not None:
        raise InputError("give one of --spacing (a uniform grid) and --places (planned places)")
    plan = PlacePlan(
        spacing,
        None if bounds is None else parse_bounds(bounds),
        places,
        Curvature(refraction_k=k),
    )
    terrain = read_terrain(dem, crs, reproject)
    with runner_of(workers) as runner, progress_bar("rendering") as bar:
        result = build_store(terrain, output, plan, runner, bar)
    print_built(result, output, "places")
    with open_store(output) as opened:
        _print_finds(expected_finds(opened.places()))


store = typer.Typer(
    name="store", help="Check, repair, merge and export stores.", no_args_is_help=True
)


@store.command()
def check(store: StoreFile, as_json: AsJson = False) -> None:
    """Read a whole store and compare it with its checksums; exit code 2 if it is damaged."""
    report = check_store(store)
    if as_json:
        # The exit code must hold also where the output is not read.
        with suppress(BrokenPipeError):
            facts = {key: value for key, value in asdict(report).items() if key != "duplicates"}
            print_line(json.dumps({"store": printable(store), "whole": report.whole, **facts}))
        raise typer.Exit(0 if report.whole else InputError.exit_code)
    if not report.whole:
        first = "; ".join(damage.what for damage in report.damage[:3])
        more = f"; and {len(report.damage) - 3} more" if len(report.damage) > 3 else ""
        raise InputError(f"{store} is damaged: {first}{more}")
    print_line(f"{store}: {report.rows:,} {report.holds}, whole")


@store.command()
def repair(store: StoreFile, output: NewStore) -> None:
    """Save the undamaged rows of a store in a new store, in their order."""
    report = repair_store(store, output)
    _print_copied(report, output)
    for damage in report.damage:
        rows = f"rows {damage.first_row} to {damage.first_row + damage.rows - 1}"
        print_line(f"  left out {rows}: {damage.what}")


@store.command()
def merge(stores: Annotated[list[Path], Argument(metavar="STORE...")], output: NewStore) -> None:
    """Join stores of one DEM into one; a place that several have is kept once."""
    _print_copied(merge_stores(stores, output), output)


@store.command()
def export(
    store: StoreFile,
    output: Annotated[Path, output_option("The GeoPackage to write.", "FILE.gpkg")],
) -> None:
    """Write the locations of the places as a GeoPackage, for QGIS and others (extra `geo`)."""
    from skyline.report.exports import write_geopackage  # noqa: PLC0415  (slow to load)

    with open_store(store) as opened:
        count = write_geopackage(opened, output)
    print_line(f"{output}: {count:,} places, {output.stat().st_size / 1e6:.1f} MB")


def _print_copied(report: StoreReport, path: Path) -> None:
    size = path.stat().st_size
    each = f", {size / report.rows:.0f} bytes each" if report.rows else ""
    again = f", {report.duplicates} duplicates left out" if report.duplicates else ""
    lost = sum(damage.rows for damage in report.damage)
    damaged = f", {lost} damaged rows left out" if lost else ""
    print_line(f"{path}: {report.rows:,} {report.holds}{each}{again}{damaged}")


def _print_finds(classes: Sequence[tuple[float, float, float]]) -> None:
    """Print how many photos 60 degrees wide are expected to be found, by distance."""
    shares = [
        f"{100.0 * found:.0f} % of those with skylines "
        f"{f'over {least_m:.0f} m' if least_m else 'less'} away ({100.0 * share:.0f} % of all)"
        for least_m, share, found in reversed(classes)
    ]
    print_line(f"photos expected to be found: {', '.join(shares)}")


def advise_to_continue(store: Path) -> None:
    """Have the error after Ctrl-C say that a build continues, if parts of its store are there."""
    on_interrupt(
        "what was built is kept, and the same command continues from there",
        lambda: any(parts_folder(store.resolve()).glob("*.h5")),
    )


def print_built(result: BuildResult, path: Path, rows: str) -> None:
    """Print the number of rows of a store, and of those that were rendered now."""
    size = f"{path.stat().st_size / 1e6:.1f} MB"
    if not result.rendered:
        print_line(f"{path}: {result.rows} {rows}, complete: nothing was left to render, {size}")
        return
    rate = result.rendered / max(result.seconds, 1e-9)
    print_line(
        f"{path}: {result.rows} {rows}, {result.rendered} of them new in "
        f"{result.seconds:.1f} s ({rate:.0f}/s), {size}"
    )
