"""``skyline locate``: photos in, places out, without a store at hand."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline.cli.dem import TileSource
from skyline.cli.options import DEM_ABOUT, DEM_VARIABLE, AsJson, PhotoProjection
from skyline.cli.photo_options import (
    CameraHeight,
    Export,
    FieldOfView,
    Heading,
    HeadingSlack,
    Near,
    PhotoSpotFile,
    ProbabilityMap,
    ReportPeaks,
    SamePlace,
    SearchBounds,
    UseGps,
    Walked,
    entry_of,
    heading_of,
)
from skyline.cli.terminal import Terminal
from skyline.match.narrowing import NOTED_KM
from skyline.match.photo_lists import entries_of
from skyline.tasks.locate import locate_photos
from skyline.tasks.match import MatchTask


def locate(
    context: typer.Context,
    photo: Annotated[
        list[Path],
        Argument(
            metavar="PHOTO",
            help="Photos of one area, folders of them, sky masks, CSV traces or lists. Without "
            f"--near and --bounds, {NOTED_KM:g} km round the photos' own GPS positions are "
            "searched.",
        ),
    ],
    fov_deg: FieldOfView = None,
    near: Near = None,
    bounds: SearchBounds = None,
    dem: Annotated[
        list[str] | None,
        Option(
            metavar="DEM",
            help=DEM_ABOUT,
            envvar=DEM_VARIABLE,
            show_default="tiles are fetched",
        ),
    ] = None,
    source: TileSource = None,
    report: Annotated[
        Path, Option(metavar="DIR", help="Write a page with pictures and maps.")
    ] = Path("skyline-report"),
    as_json: AsJson = False,
    heading: Heading = None,
    heading_slack: HeadingSlack = None,
    eye_height: CameraHeight = None,
    projection: PhotoProjection = None,
    same_place: SamePlace = False,
    photo_spots: PhotoSpotFile = None,
    use_gps: UseGps = False,
    walked: Walked = None,
    export: Export = None,
    probability: ProbabilityMap = None,
    peaks: ReportPeaks = None,
) -> None:
    """Find where photos were taken, fetching the elevation of the area.

    The store of the area is built, too. Both are kept for the next photo of the
    area; `skyline cache` lists them.
    """
    common = entry_of(
        fov_deg,
        projection,
        near,
        bounds,
        heading_of(heading, heading_slack),
        eye_height,
        photo_spots,
        use_gps,
        peaks,
    )
    search = MatchTask(
        stores=(),
        entries=list(entries_of(photo, common)),
        common=common,
        inputs=[*photo, *filter(None, [photo_spots])],
        dem=dem or (),
        same_place=same_place,
        report=report,
        peaks=peaks,
        exports=export or (),
        probability=probability or (),
        walked_km_h=walked,
    )
    raise typer.Exit(locate_photos(search, source, Terminal.of(context, as_json)))
