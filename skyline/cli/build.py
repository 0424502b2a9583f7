"""``skyline build``: the store of places that ``match`` searches."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from typer import Option

from skyline.build.cluster import runner_of
from skyline.build.parts import BuildResult, build_store
from skyline.build.plans import PlacePlan
from skyline.build.spacing import expected_finds
from skyline.cli.console import (
    Crs,
    Dems,
    RefractionK,
    Reproject,
    Workers,
    on_interrupt,
    output_option,
    parse_bounds,
    print_line,
    progress_bar,
    read_terrain,
)
from skyline.errors import InputError
from skyline.geodesy import DEFAULT_REFRACTION_K, Curvature
from skyline.store import open_store
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
    keeps_parts(output)
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
        print_finds(expected_finds(opened.places()))


def print_finds(classes: Sequence[tuple[float, float, float]]) -> None:
    """Print how many photos 60 degrees wide are expected to be found, by distance."""
    shares = [
        f"{100.0 * found:.0f} % of those with skylines "
        f"{f'over {least_m:.0f} m' if least_m else 'less'} away ({100.0 * share:.0f} % of all)"
        for least_m, share, found in reversed(classes)
    ]
    print_line(f"photos expected to be found: {', '.join(shares)}")


def keeps_parts(store: Path) -> None:
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
