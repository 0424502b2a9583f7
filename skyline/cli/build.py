"""``skyline build``: stores of places."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.options import (
    BoundsOrAll,
    Crs,
    Dems,
    RefractionK,
    Spacing,
    Workers,
    output_option,
    parse_bounds,
)
from skyline.cli.terminal import Terminal, size_in_words
from skyline.survey.build import BuildResult
from skyline.tasks.build import BuildTask, build_area


def build(
    context: typer.Context,
    dem: Dems,
    output: Annotated[
        Path,
        output_option(
            "The store to write. If it exists, the places of other --bounds are added to it; all "
            "other settings must be the same.",
            "STORE.h5",
        ),
    ],
    spacing: Spacing = None,
    places: Annotated[
        int | None,
        Option(
            metavar="N",
            help="About this many places: dense where skylines are near, else sparse. "
            "A thousand take a quarter of a second on two cores without a GPU, and 0.7 MB.",
            show_default="100,000; fewer for small areas, more for large ones",
        ),
    ] = None,
    bounds: BoundsOrAll = None,
    workers: Workers = None,
    refraction_k: RefractionK = None,
    crs: Crs = None,
) -> None:
    """Build the store that `match` searches. After Ctrl-C, the same command continues."""
    task = BuildTask(
        dem=dem,
        crs=crs,
        output=output,
        spacing_m=spacing,
        places=places,
        bounds_deg=None if bounds is None else parse_bounds(bounds),
        workers=workers,
        refraction_k=refraction_k,
    )
    terminal = Terminal.of(context)
    result, finds = build_area(task, terminal)
    terminal.line(built_in_words(result, output, "places"))
    terminal.line(_finds_in_words(finds))


def _finds_in_words(classes: Sequence[tuple[float, float, float]]) -> str:
    """Return the share of photos that will be found, in words.

    The photos are 60 degrees wide, and the share is given by the distance of the skyline.
    """
    shares: list[str] = []
    below_m = 0.0
    for least_m, share, found in reversed(classes):
        away = f"{least_m:.0f} to {below_m:.0f} m" if below_m else f"over {least_m:.0f} m"
        shares.append(f"{100.0 * found:.0f} % at {away} ({100.0 * share:.0f} % of all)")
        below_m = least_m
    return f"photos expected to be found, by the distance of the skyline: {', '.join(shares)}"


def built_in_words(result: BuildResult, path: Path, rows: str) -> str:
    """Return a sentence on a store's rows, its size and its time."""
    size = size_in_words(path.stat().st_size)
    if not result.rendered:
        return f"{path}: {result.rows} {rows}, complete: nothing was left to render, {size}"
    rate = result.rendered / max(result.seconds, 1e-9)
    return (
        f"{path}: {result.rows} {rows}, {result.rendered} of them new in "
        f"{result.seconds:.1f} s ({rate:.{0 if rate >= 10.0 else 1}f}/s), {size}"
    )
