"""``skyline locate``: photos in, places out, without a store at hand."""

import math
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from skyline.batch import Query, listed, without_folders
from skyline.cache import cached_files, prepare_area
from skyline.cli.console import AsJson, on_interrupt, output_option, print_note, progress_bar
from skyline.cli.match import match, narrowing_of
from skyline.cli.photo import FieldOfView, usable_queries
from skyline.errors import InputError, MissingFileError
from skyline.fetch.dem_tiles import SOURCES
from skyline.location import NOTED_KM, area_of
from skyline.peaks import find_place
from skyline.report.folder import check_report_folder


def locate(
    photos: Annotated[
        list[Path], Argument(metavar="PHOTO...", help="Photos of one area, or folders of them.")
    ],
    near: Annotated[
        str | None,
        Option(
            metavar="LON,LAT,KM|W,S,E,N|NAME[,KM]",
            help="Search within KM of a point, in a box in degrees, or round a place named in the "
            "file of --peaks.",
            show_default="10 km round the photo's own GPS position",
        ),
    ] = None,
    dem: Annotated[
        list[str] | None,
        Option(
            metavar="FILE|DIR",
            help="Elevation files, or a folder of them; may be repeated.",
            show_default="tiles are fetched",
        ),
    ] = None,
    output: Annotated[Path, output_option("The folder for the report.", "DIR")] = Path(
        "skyline-report"
    ),
    fov_deg: FieldOfView = None,
    source: Annotated[
        str | None,
        Option(
            metavar="NAME|URL",
            help=f"Source of tiles, as for `dem fetch`: {', '.join(SOURCES)}, or an address.",
            show_default="$SKYLINE_DEM_SOURCE, else copernicus",
        ),
    ] = None,
    peaks: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="Peaks to name in the report, and places for --near: GeoJSON, or CSV with "
            "name,lon,lat[,height_m].",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find where photos were taken, fetching the elevation of the area and building its store.

    Both are kept for the next photo of the area; `skyline cache` lists them.
    """
    narrowing = narrowing_of(_in_numbers(near, peaks), None, use_gps=False)
    if dem and source:
        raise InputError("give one of --dem (files at hand) and --source (tiles to fetch)")
    # These checks come before minutes of work.
    photos = [*without_folders(photos)]
    queries = list(listed(photos, Query("", fov_deg)))
    usable = usable_queries(queries)
    if peaks is not None and not peaks.is_file():
        raise MissingFileError(f"{peaks} does not exist; expected peaks to name")
    check_report_folder(output)
    area, narrowing = area_of([one.path for one in usable], narrowing)
    before = cached_files()
    on_interrupt(
        "what was fetched and built is kept, and the same command continues from there",
        lambda: bool(cached_files() - before),
    )
    ready = prepare_area(area, dem or (), source, print_note, progress_bar)
    on_interrupt(f"the area is kept in {ready.folder}")
    within = narrowing.near or narrowing.bounds_deg or ()
    match(
        ready.store,
        photos,
        fov_deg,
        ",".join(map(str, within)),
        [str(ready.terrain)],
        output,
        as_json,
        peaks=peaks,
    )


def _in_numbers(near: str | None, gazetteer: Path | None) -> str | None:
    """Return ``--near`` with the place of its name, if it has one, as numbers."""
    if near is None:
        return None
    with suppress(ValueError):  # Nan is a town.
        if all(math.isfinite(float(part)) for part in near.split(",")):
            return near
    name, _, km = near.rpartition(",")
    if not name or not km.strip().replace(".", "", 1).isdigit():
        name, km = near, f"{NOTED_KM:g}"
    if gazetteer is None:
        raise InputError(
            f"--near is `{near}`; expected LON,LAT,KM or W,S,E,N, or with --peaks FILE a name in "
            "that file"
        )
    lon, lat = find_place(gazetteer, name.strip())
    return f"{lon},{lat},{km}"
