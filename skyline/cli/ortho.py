"""``skyline ortho``: photos laid on the ground."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline.cli.options import Crs, Dem, PhotoProjection, output_option
from skyline.cli.terminal import Terminal
from skyline.tasks.ortho import OrthoTask, lay_photos


def ortho(
    context: typer.Context,
    photo: Annotated[list[Path], Argument(metavar="PHOTO", help="Photos.")],
    pose: Annotated[
        list[Path],
        Option(
            "--pose",
            metavar="FILE.json",
            help="The cameras' poses, as `match --json` and `orient --json` print them: one file, "
            "or one for each photo.",
        ),
    ],
    dem: Dem,
    output: Annotated[Path, output_option("The GeoTIFF to write.", "FILE.tif")],
    resolution_m: Annotated[
        float | None,
        Option(
            "--resolution",
            metavar="M",
            help="Size of a cell, metres.",
            show_default="as the photos show the ground",
        ),
    ] = None,
    pixel_lengths: Annotated[
        Path | None,
        Option(
            "--pixel-lengths",
            metavar="FILE.tif",
            help="Write how many metres of ground a pixel shows, too.",
        ),
    ] = None,
    projection: PhotoProjection = None,
    crs: Crs = None,
) -> None:
    """Lay photos on the ground, as a Cloud-Optimized GeoTIFF.

    What is hidden or seen too flatly is transparent.
    """
    terminal = Terminal.of(context)
    task = OrthoTask(
        photos=photo,
        poses=pose,
        dem=dem,
        crs=crs,
        output=output,
        pixel_lengths=pixel_lengths,
        resolution_m=resolution_m,
        projection=projection,
    )
    for line in lay_photos(task, terminal):
        terminal.line(line)
