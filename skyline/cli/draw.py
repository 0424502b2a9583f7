"""``skyline draw``: lines of a photo on the map, or the reverse."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.options import POSE, Crs, Dem, PhotoProjection, output_option
from skyline.cli.photo_options import HeightSd, PhotoFile, PixelSd
from skyline.cli.terminal import Terminal
from skyline.files.vectors import VECTORS
from skyline.ground.ground_view import GroundErrors
from skyline.pose.pose_errors import PIXEL_SD_PX
from skyline.report.vector_files import MAP_FILES
from skyline.tasks.draw import PHOTO_FILES, DrawTask, draw_vectors


def draw(
    context: typer.Context,
    photo: PhotoFile,
    pose: Annotated[Path, POSE],
    vectors: Annotated[
        Path,
        Option(
            "--vectors",
            metavar="FILE",
            help="Points, lines and polygons of the photo (GeoJSON in pixels, LabelMe, COCO, SVG) "
            f"or of the map (GeoJSON, GPX, GeoPackage): {', '.join(VECTORS)}.",
        ),
    ],
    dem: Dem,
    output: Annotated[
        Path,
        output_option(
            f"The file to write: {', '.join(MAP_FILES)} for vectors of the photo, "
            f"{', '.join(PHOTO_FILES)} for vectors of the map."
        ),
    ],
    in_pixels: Annotated[
        bool, Option("--pixels", help="The coordinates of GeoJSON are the photo's pixels.")
    ] = False,
    pixel_sd_px: PixelSd = PIXEL_SD_PX,
    height_sd_m: HeightSd = None,
    projection: PhotoProjection = None,
    crs: Crs = None,
) -> None:
    """Draw lines of a photo on the map, or the reverse.

    Shapes drawn in the photo get places, elevations, lengths and areas, with their errors. Shapes
    of the map are drawn into the photo, with hidden parts dashed.
    """
    terminal = Terminal.of(context)
    task = DrawTask(
        photo=photo,
        pose=pose,
        vectors=vectors,
        dem=dem,
        crs=crs,
        output=output,
        in_pixels=in_pixels,
        errors=GroundErrors(pixel_sd_px=pixel_sd_px, height_sd_m=height_sd_m),
        projection=projection,
    )
    for line in draw_vectors(task, terminal):
        terminal.line(line)
