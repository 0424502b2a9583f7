"""``skyline match``: photos in, places out."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline.cli.options import (
    AsJson,
    PhotoProjection,
    StoreDem,
    StoreFile,
    SurfaceFiles,
    Workers,
    panel,
)
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
    files_to_write,
    heading_of,
    is_numbers,
)
from skyline.cli.terminal import Terminal
from skyline.errors import InputError
from skyline.files.disk import STANDARD
from skyline.match.matcher import FULL
from skyline.match.photo_lists import entries_of
from skyline.report.results_file import RESULTS
from skyline.tasks.match import (
    UNREFINED,
    MatchTask,
    match_photos,
    matcher_names,
    split_stores,
)

# Groups of options in the help, after the options that are needed most.
_search = panel("The search")


def match(
    context: typer.Context,
    store: StoreFile,
    photo: Annotated[
        list[Path],
        Argument(
            metavar="PHOTO",
            help="Photos, folders of them, sky masks (white = sky), CSV traces or lists, or - for "
            "the names of photos on standard input. A trace "
            "begins with '# width=W height=H' and has the columns column_px,row_px. More stores "
            "may be named before the photos; all are searched as one.",
        ),
    ],
    fov_deg: FieldOfView = None,
    near: Near = None,
    bounds: SearchBounds = None,
    dem: StoreDem = None,
    report: Annotated[
        Path | None, Option(metavar="DIR", help="Write a page with pictures and maps.")
    ] = None,
    as_json: AsJson = False,
    heading: Heading = None,
    heading_slack: HeadingSlack = None,
    eye_height: CameraHeight = None,
    projection: PhotoProjection = None,
    same_place: SamePlace = False,
    photo_spots: PhotoSpotFile = None,
    use_gps: UseGps = False,
    walked: Walked = None,
    matcher: Annotated[
        str,
        _search(
            metavar="NAME",
            help=f"{FULL}, {UNREFINED}, paper, correlation, or another package's; {UNREFINED} is "
            "faster and less exact.",
            autocompletion=matcher_names,
        ),
    ] = FULL,
    surface: SurfaceFiles = None,
    export: Export = None,
    probability: ProbabilityMap = None,
    peaks: ReportPeaks = None,
    results: Annotated[
        Path | None,
        files_to_write(
            metavar="FILE",
            help=f"Write a row for each photo when it is done ({', '.join(RESULTS)}). Photos that "
            "are in the file are not matched again.",
        ),
    ] = None,
    workers: Workers = None,
) -> None:
    """Find where photos were taken and in which direction the camera looked."""
    stores, photos = split_stores(store, photo)
    if peaks and _is_asked(context, "peaks") and not report and (near is None or is_numbers(near)):
        raise InputError(f"--peaks {peaks} names peaks in a report; give --report DIR too")
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
    entries = list(entries_of(photos, common))
    if workers and any(one.path == STANDARD for one in entries):
        raise InputError(
            "a photo on standard input is read in this process; name a file, or leave --workers out"
        )
    task = MatchTask(
        stores=stores,
        entries=entries,
        common=common,
        inputs=[*photos, *filter(None, [photo_spots])],
        matcher=matcher,
        dem=dem or (),
        surface=surface or (),
        same_place=same_place,
        workers=workers,
        report=report,
        peaks=peaks,
        exports=export or (),
        probability=probability or (),
        walked_km_h=walked,
        results=results,
    )
    raise typer.Exit(match_photos(task, Terminal.of(context, as_json)))


def _is_asked(context: typer.Context, name: str) -> bool:
    """Return whether an option is given on the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name != "ENVIRONMENT"
