"""Options that commands for photos share: what is known of the camera."""

import math
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from skyline.camera.pixels import Pixel
from skyline.camera.projection import Projection
from skyline.cli.options import PEAKS_VARIABLE, bounds_option, panel, parse_bounds
from skyline.errors import InputError, numbers_in
from skyline.geodesy.bounds import Circle
from skyline.match.narrowing import NOTED_KM, Narrowing
from skyline.match.photo_lists import Entry
from skyline.match.photo_spots import SPOT_FILES, read_spots
from skyline.report.exports import EXPORTS
from skyline.report.posterior_files import POSTERIOR_FILES
from skyline.view.peaks import find_place

_known = panel("The photos")

PhotoFile = Annotated[Path, Argument(metavar="PHOTO", help="The photo.")]
FieldOfView = Annotated[
    float | None,
    Option(
        "--fov-deg",
        metavar="DEG",
        help="Horizontal field of view in degrees.",
        show_default="from the photo's EXIF or XMP",
    ),
]
CameraPosition = Annotated[
    str | None,
    Option(
        "--at",
        metavar="LON,LAT",
        help="The camera's position, degrees (WGS 84).",
        show_default="each photo's own GPS position",
    ),
]
CameraElevation = Annotated[
    float | None,
    Option(
        "--elevation",
        metavar="M",
        help="The camera's elevation, metres above the DEM's datum.",
        show_default="on the ground, or at the height that the photo notes",
    ),
]
_errors = panel("Errors")
PixelSd = Annotated[
    float,
    _errors(
        "--pixel-sd",
        min=0.0,
        metavar="PX",
        help="Standard deviation of a drawn column and row.",
    ),
]
HeightSd = Annotated[
    float | None,
    _errors(
        "--height-sd",
        min=0.0,
        metavar="M",
        help="Standard deviation of the DEM's heights, metres.",
        show_default="from the DEM's spacing",
    ),
]

# What is known of a photo that is searched for
Near = Annotated[
    str | None,
    Option(
        "--near",
        metavar="LON,LAT,KM|NAME[,KM]",
        help="Search within KM of a point, or of a place named in the file of --peaks "
        f"({NOTED_KM:g} km unless KM is given).",
    ),
]
SearchBounds = Annotated[str | None, bounds_option("Search in the area")]
Heading = Annotated[
    float | None,
    _known("--heading", metavar="DEG", help="Heading of the camera, degrees from true north."),
]
HeadingSlack = Annotated[
    float | None,
    _known("--heading-slack", metavar="DEG", help="Greatest error of --heading, degrees."),
]
CameraHeight = Annotated[
    float | None,
    _known(
        "--eye-height",
        metavar="M",
        help="Height of the camera, metres above the ground.",
        show_default="found with the pose",
    ),
]
PhotoSpotFile = Annotated[
    Path | None,
    _known(
        "--photo-spots",
        metavar="FILE",
        help="Prefer places near spots that people photograph from, such as summits, viewpoints "
        f"and trails: points and lines ({', '.join(SPOT_FILES)}).",
    ),
]
UseGps = Annotated[
    bool, _known("--use-gps", help="Prefer places near each photo's own GPS position.")
]
SamePlace = Annotated[
    bool, _known("--same-place", help="All photos were taken at one place; find that place.")
]
files_to_write = panel("More files to write")
Export = Annotated[
    list[Path] | None,
    files_to_write(
        "--export",
        metavar="FILE",
        help=f"Write the candidates ({', '.join(EXPORTS)}); may be repeated.",
    ),
]
ProbabilityMap = Annotated[
    list[Path] | None,
    files_to_write(
        "--probability",
        metavar="FILE",
        help="Write the probability of each place in the searched area, with or without an answer "
        f"({', '.join(POSTERIOR_FILES)}): a GeoTIFF, or outlines of 50, 80 and 95 %; may be "
        "repeated.",
    ),
]
Walked = Annotated[
    float | None,
    _known(
        "--walked",
        metavar="KM/H",
        help="With --probability: one person took all photos and went at most at this speed "
        "between them; each map then counts all photos.",
    ),
]
ReportPeaks = Annotated[
    Path | None,
    files_to_write(
        "--peaks",
        metavar="FILE",
        help="Peaks to name in the report, and places for --near: GeoJSON, or CSV: "
        "name,lon,lat[,height_m].",
        envvar=PEAKS_VARIABLE,
    ),
]


def entry_of(
    fov_deg: float | None,
    projection: Projection | None,
    near: str | None,
    bounds: str | None,
    heading_deg: tuple[float, float] | None,
    eye_height_m: float | None,
    photo_spots: Path | None,
    use_gps: bool,
    peaks: Path | None,
) -> Entry:
    """Return an entry with the options that hold for every photo.

    ``heading_deg`` is a heading and its greatest error. Raises `InputError` for a value that is out
    of range, and as `read_spots`.
    """
    narrowing = Narrowing(
        near=None if near is None else parse_near(near, peaks),
        bounds_deg=None if bounds is None else parse_bounds(bounds),
        heading_deg=heading_deg,
        eye_height_m=eye_height_m,
        photo_spots=() if photo_spots is None else read_spots(photo_spots),
        use_gps=use_gps,
    )
    return Entry("", fov_deg, None, projection, narrowing)


def heading_of(heading: float | None, slack: float | None) -> tuple[float, float] | None:
    """Return a heading and its greatest error; None where neither is given.

    Raises `InputError` if one of them is given alone.
    """
    if heading is None and slack is None:
        return None
    if heading is None or slack is None:
        raise InputError(
            "one of --heading DEG and --heading-slack DEG is given; expected both or neither"
        )
    return heading, slack


def parse_near(text: str, gazetteer: Path | None) -> Circle:
    """Return longitude, latitude and radius in km from ``LON,LAT,KM`` or ``NAME[,KM]``.

    Raises `InputError` for anything else, and as `find_place` for a name.
    """
    expected = "expected LON,LAT,KM, or with --peaks FILE a name in that file"
    error = f"--near is `{text}`; {expected}"
    if is_numbers(text):
        if text.count(",") == 3:
            error = f"--near is `{text}`; expected LON,LAT,KM: give W,S,E,N as --bounds"
        lon, lat, km = numbers_in(text, 3, error)
        return lon, lat, km
    name, _, km_text = text.rpartition(",")
    if not name or not km_text.strip().replace(".", "", 1).isdigit():
        name, km_text = text, str(NOTED_KM)
    if gazetteer is None:
        raise InputError(error)
    return *find_place(gazetteer, name.strip()), float(km_text)


def is_numbers(text: str) -> bool:
    """Return whether text is numbers with commas between them.

    ``Nan`` and ``Inf`` are no numbers here: towns have these names.
    """
    with suppress(ValueError):
        return all(math.isfinite(float(part)) for part in text.split(","))
    return False


def pixels_of(given: str, option: str, counts: tuple[int, ...]) -> tuple[Pixel, ...]:
    """Return pixels from ``COLUMN,ROW,...``.

    Raises `InputError` unless as many pixels are given as one of ``counts``.
    """
    error = (
        f"{option} is `{given}`; expected {' or '.join(str(2 * count) for count in counts)} "
        "numbers, COLUMN,ROW of each pixel"
    )
    count = (given.count(",") + 1) // 2
    if count not in counts:
        raise InputError(error)
    numbers = numbers_in(given, 2 * count, error)
    return tuple(zip(numbers[::2], numbers[1::2], strict=True))
