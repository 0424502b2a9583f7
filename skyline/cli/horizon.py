"""``skyline horizon``: the horizon around positions."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.options import (
    POSE,
    Crs,
    Dems,
    EyeHeight,
    PhotoProjection,
    RefractionK,
    SummitWithin,
    SurfaceFiles,
    output_option,
    parse_position,
)
from skyline.cli.terminal import Terminal
from skyline.files.disk import STANDARD
from skyline.horizons.horizon import DEFAULT_STEP_DEG
from skyline.report.horizon_files import horizon_csv
from skyline.tasks.horizon import HorizonTask, find_horizons
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M


def horizon(
    context: typer.Context,
    dem: Dems,
    at: Annotated[
        list[str] | None,
        Option(metavar="LON,LAT", help="A position, degrees (WGS 84); may be repeated."),
    ] = None,
    viewpoints: Annotated[
        Path | None,
        Option(
            metavar="FILE.csv",
            help="Positions as CSV: lon,lat or easting,northing[,id][,eye_height_m].",
        ),
    ] = None,
    eye_height: EyeHeight = DEFAULT_EYE_HEIGHT_M,
    summit_within: SummitWithin = None,
    step_deg: Annotated[
        float, Option(metavar="DEG", help="Degrees between azimuths.")
    ] = DEFAULT_STEP_DEG,
    output: Annotated[
        Path | None,
        output_option(
            "The file to write: .csv, .json, .txt (PVGIS), .hor (PVsyst, Meteonorm, PV*SOL), "
            ".sam.csv (SAM), .hrz (N.I.N.A.) or .zip (Stellarium).",
            show_default="CSV is printed",
        ),
    ] = None,
    surface: SurfaceFiles = None,
    photo: Annotated[
        Path | None,
        Option(
            metavar="PHOTO",
            help="Use the horizon of this photo, trees and houses included, where it shows one; "
            "with --pose, in place of a position.",
        ),
    ] = None,
    pose: Annotated[Path | None, POSE] = None,
    projection: PhotoProjection = None,
    refraction_k: RefractionK = None,
    crs: Crs = None,
) -> None:
    """Give the horizon at positions, by azimuth from true north.

    It has an elevation angle and a distance for each azimuth. With --photo, it follows the photo's
    skyline where the photo shows one.
    """
    task = HorizonTask(
        dem=dem,
        crs=crs,
        positions=[parse_position(text) for text in at or ()],
        viewpoints=viewpoints,
        photo=photo,
        pose=pose,
        projection=projection,
        eye_height_m=eye_height,
        summit_within_m=summit_within,
        step_deg=step_deg,
        surface=surface or (),
        refraction_k=refraction_k,
        output=None if output == Path(STANDARD) else output,
    )
    found = find_horizons(task, Terminal.of(context))
    if task.output is None:
        typer.echo(horizon_csv(found), nl=False)
