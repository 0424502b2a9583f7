"""Options that several commands have, and readers of their values.

An option has one name and one meaning in all commands. Options that a script would repeat are also
read from the environment, but not what is known of a photo, since it would hold for other photos.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from skyline.cache import store_of
from skyline.camera.projection import Projection
from skyline.errors import InputError, numbers_in, swapped_in_words
from skyline.geodesy.bounds import are_degrees
from skyline.geodesy.earth import DEFAULT_REFRACTION_K

if TYPE_CHECKING:
    from skyline.geodesy.bounds import Bounds


def panel(title: str) -> Callable[..., Any]:
    """Return a function that makes options under a title.

    The title is shown in the help.
    """
    return partial(Option, rich_help_panel=title)


def output_option(about: str, metavar: str = "FILE", **shown: Any) -> Any:
    """Return the option that names a command's output.

    The output is a file or a folder.
    """
    return Option("--output", "-o", metavar=metavar, help=about, **shown)


def bounds_option(about: str, **shown: Any) -> Any:
    """Return the option for a box, whose help begins with ``about``."""
    sides = f"{about}: west, south, east, north in degrees (WGS 84)."
    return Option("--bounds", metavar="W,S,E,N", help=sides, **shown)


of_terrain = panel("Terrain and rendering")

DEM_ABOUT = "An elevation file, or a folder or zip of files; may be repeated."

StoreFile = Annotated[
    Path,
    Argument(
        metavar="STORE.h5",
        help="A store, as `build` writes it, or the folder of an area that `cache` lists.",
        callback=store_of,
    ),
]
AsJson = Annotated[bool, Option("--json", help="Print JSON.")]
StoreDem = Annotated[
    list[str] | None,
    Option(
        "--dem",
        metavar="DEM",
        help="The store's DEM, if it has moved: a file, or a folder or zip of files; may be "
        "repeated.",
        show_default="the files from which the store was built",
    ),
]
DEM_VARIABLE = "SKYLINE_DEM"
"""The environment variable for options that name elevation files."""
Dem = Annotated[
    list[str],
    Option("--dem", metavar="DEM", help=DEM_ABOUT, envvar=DEM_VARIABLE),
]
Dems = Annotated[
    list[str],
    Argument(metavar="DEM", help="Elevation files of one grid, or folders or zips of files."),
]
Workers = Annotated[
    str | None,
    panel("Many processors")(
        "--workers",
        metavar="N|ADDRESS",
        envvar="SKYLINE_WORKERS",
        help="Spread the work over N processes of this machine, or over the dask cluster whose "
        "scheduler has this address, e.g. tcp://host:8786.",
        show_default="this process",
    ),
]
SurfaceFiles = Annotated[
    list[str] | None,
    of_terrain(
        "--surface",
        metavar="FILE",
        envvar="SKYLINE_SURFACE",
        help="A surface or canopy model, which gives the heights of trees and houses: a file, or a "
        "folder or zip of files; may be repeated.",
    ),
]
RefractionK = Annotated[
    float | None,
    of_terrain(
        "--refraction-k",
        metavar="K",
        help="Refraction coefficient: the share of the Earth's curvature that refraction undoes.",
        show_default=f"{DEFAULT_REFRACTION_K:g}, and 0 on other worlds",
    ),
]
Crs = Annotated[
    str | None,
    of_terrain(
        "--crs",
        metavar="CRS",
        help="CRS of a DEM whose files name none, e.g. EPSG:32632.",
        envvar="SKYLINE_CRS",
    ),
]
BoundsText = Annotated[str, bounds_option("The area")]
BoundsOrAll = Annotated[str | None, bounds_option("The area", show_default="all of the DEM")]
Spacing = Annotated[
    float | None,
    Option("--spacing", metavar="M", help="Metres between the viewpoints of a uniform grid."),
]
PEAKS_VARIABLE = "SKYLINE_PEAKS"
PEAKS = Option(
    "--peaks",
    metavar="FILE",
    help="Peaks to name: GeoJSON, or CSV: name,lon,lat[,height_m].",
    envvar=PEAKS_VARIABLE,
)

EyeHeight = Annotated[
    float, Option("--eye-height", metavar="M", help="Height of the eye, metres above the ground.")
]
SummitWithin = Annotated[
    float | None,
    Option(
        "--summit-within",
        metavar="M",
        help="Stand on the highest point within M metres; 0 stays where --at is. By default an eye "
        "keeps its position and, beside a summit of the model, is lifted to the summit's height.",
    ),
]


PhotoProjection = Annotated[
    Projection | None,
    panel("The photos")(
        "--projection",
        help="Projection of a panorama, usually cylindrical, or fisheye.",
        show_default="from the photo's XMP, else perspective",
    ),
]
POSE = Option(
    "--pose",
    metavar="FILE.json",
    help="The camera's position and direction, as `match --json` and `orient --json` print them.",
)


def parse_bounds(text: str) -> "Bounds":
    """Return west, south, east and north, degrees, from ``W,S,E,N``.

    Raises `InputError` for anything else.
    """
    error = f"--bounds is `{text}`; expected W,S,E,N in degrees, e.g. 9.8,46.7,9.9,46.8"
    west, south, east, north = numbers_in(text, 4, error)
    return west, south, east, north


def parse_position(text: str, option: str = "--at") -> tuple[float, float]:
    """Return longitude and latitude from ``LON,LAT``, or raise `InputError`."""
    error = f"{option} is `{text}`; expected LON,LAT in degrees (WGS 84), e.g. 9.84,46.80"
    lon, lat = numbers_in(text, 2, error)
    if not are_degrees(lon, lat):
        swapped = f"; {swapped_in_words(lon, lat)}" if are_degrees(lat, lon) else ""
        raise InputError(error + swapped)
    return lon, lat
