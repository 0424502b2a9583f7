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
from skyline.errors import InputError
from skyline.files.disk import STANDARD, check_outputs
from skyline.horizons.horizon import DEFAULT_STEP_DEG, horizons_of, steps_a_turn
from skyline.report.horizon_files import check_fit, horizon_csv, kind_of_horizons, write_horizons
from skyline.tasks.standing import stand_with_notes, warn_of_border
from skyline.tasks.terrain import curvature_of, read_terrain
from skyline.terrain.surface_model import read_surface
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, read_viewpoints


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
    terminal = Terminal.of(context)
    _check_places(at, viewpoints, photo, pose)
    if photo is not None and surface:
        raise InputError("--photo shows trees and houses itself; leave --surface out")
    check_outputs([output], filter(None, [viewpoints, photo, pose]))
    file = None if output == Path(STANDARD) else output
    if file is not None:
        kind_of_horizons(file)
    steps_a_turn(step_deg)  # Refused before the DEM is read
    positions = [parse_position(text) for text in at or ()]
    terrain = read_terrain(terminal, dem, crs)
    curvature = curvature_of(terrain, refraction_k)
    if photo is not None and pose is not None:
        from skyline.tasks.photo_horizon import (  # noqa: PLC0415  (slow to load)
            PhotoHorizonTask,
            photo_horizon,
        )

        task = PhotoHorizonTask(
            photo=photo, pose=pose, step_deg=step_deg, curvature=curvature, projection=projection
        )
        found = photo_horizon(task, terrain, terminal)
    else:
        ids: tuple[str, ...] = ()
        if viewpoints is not None:
            eyes, ids = read_viewpoints(viewpoints, terrain, eye_height, summit_within)
        else:
            eyes = stand_with_notes(terrain, positions, eye_height, summit_within, terminal)
        if file is not None:
            check_fit(file, len(eyes), bool(surface), terrain.frame.lonlat_crs)
        over = read_surface(surface, terrain) if surface else None
        with terminal.progress("rendering") as progress:
            found = horizons_of(terrain, eyes, step_deg, curvature, progress, over, ids)
    if file is None:
        typer.echo(horizon_csv(found), nl=False)
    else:
        write_horizons(found, file)
    warn_of_border(found)


def _check_places(
    at: list[str] | None, viewpoints: Path | None, photo: Path | None, pose: Path | None
) -> None:
    """Raise `InputError` unless one place is named, a photo with pose."""
    if bool(at) + (viewpoints is not None) + (photo is not None) != 1:
        raise InputError(
            "give positions as --at LON,LAT or as --viewpoints FILE.csv, or a --photo with its "
            "--pose"
        )
    if (photo is None) != (pose is None):
        raise InputError("one of --photo and --pose is given; expected both or neither")
