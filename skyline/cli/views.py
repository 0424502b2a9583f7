"""``skyline horizon``, ``sun`` and ``panorama``: the view from a place."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from typer import Option

from skyline.cli.console import (
    PEAKS,
    Crs,
    Dems,
    RefractionK,
    Surfaces,
    check_outputs,
    note_if_slow,
    output_option,
    parse_place,
    print_line,
    print_note,
    progress_bar,
    read_terrain,
)
from skyline.errors import InputError, suffix_of
from skyline.files import STANDARD
from skyline.geodesy import DEFAULT_REFRACTION_K, Curvature
from skyline.horizons import DEFAULT_STEP_DEG, LocalHorizons, horizons_of, steps_a_turn
from skyline.peaks import read_peaks
from skyline.report.horizon_files import KINDS, horizon_csv, write_horizons
from skyline.report.landscape import PanoramaConfig, panorama_view
from skyline.skylines import FLAG_HOLE, FLAG_TRUNCATED
from skyline.sun import day_of
from skyline.terrain.heightfield import HeightField
from skyline.terrain.surface_model import read_surface
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, read_viewpoints, stand_at

_PANORAMA = PanoramaConfig()
_log = logging.getLogger(__name__)

At = Annotated[
    list[str] | None,
    Option("--at", metavar="LON,LAT", help="A place, degrees (WGS 84); may be repeated."),
]
SummitWithin = Annotated[
    float | None,
    Option(
        "--summit-within",
        metavar="M",
        help="Stand on the highest point within M metres. By default an eye keeps its place and, "
        "beside a summit of the model, stands as high as the summit; 0 leaves it on the slope.",
    ),
]
EyeHeight = Annotated[
    float, Option("--eye-height", metavar="M", help="Height of the eye, metres above ground.")
]


def horizon(
    dem: Dems,
    at: At = None,
    points: Annotated[
        Path | None, Option(metavar="FILE.csv", help="Places as CSV: lon,lat[,id][,eye_height_m].")
    ] = None,
    eye_height: EyeHeight = DEFAULT_EYE_HEIGHT_M,
    summit_within: SummitWithin = None,
    step_deg: Annotated[
        float, Option("--step-deg", metavar="DEG", help="Degrees between azimuths.")
    ] = DEFAULT_STEP_DEG,
    output: Annotated[
        Path | None,
        output_option(
            f"The file to write: {', '.join(KINDS)} (PVGIS' horizon file). "
            "By default CSV is printed."
        ),
    ] = None,
    surface: Surfaces = None,
    k: RefractionK = DEFAULT_REFRACTION_K,
    crs: Crs = None,
) -> None:
    """Give the horizon around places: elevation angle and distance by azimuth from true north."""
    if bool(at) == (points is not None):
        raise InputError("give places as --at LON,LAT or as --points FILE.csv")
    check_outputs([output], filter(None, [points]))
    if output not in {None, Path(STANDARD)}:
        suffix_of(output, KINDS)
    steps_a_turn(step_deg)  # Refused before the DEM is read
    curvature = Curvature(refraction_k=k)
    places = [parse_place(text) for text in at or ()]
    terrain = read_terrain(dem, crs)
    ids: tuple[str, ...] = ()
    if points is not None:
        eyes, ids = read_viewpoints(points, terrain, eye_height, summit_within)
    else:
        eyes = _eyes(terrain, places, eye_height, summit_within)
    over = read_surface(surface, terrain) if surface else None
    with progress_bar("rendering") as progress:
        found = horizons_of(terrain, eyes, step_deg, curvature, progress, over, ids)
    if output is None or str(output) == STANDARD:
        typer.echo(horizon_csv(found), nl=False)
    else:
        write_horizons(found, output)
    _warn(found)


def sun(
    dem: Dems,
    at: At,
    day: Annotated[str, Option("--date", metavar="YYYY-MM-DD", help="The day at the place.")],
    eye_height: EyeHeight = DEFAULT_EYE_HEIGHT_M,
    summit_within: SummitWithin = None,
    crs: Crs = None,
) -> None:
    """Print when the sun is above the mountains on a day: CSV of times in UTC (extra `sun`)."""
    asked = day_of(day)
    places = [parse_place(text) for text in at or ()]
    terrain = read_terrain(dem, crs)
    eyes = _eyes(terrain, places, eye_height, summit_within)
    with progress_bar("rendering") as progress:
        found = horizons_of(terrain, eyes, progress=progress)
    print_line("lon,lat,from_utc,to_utc")
    for place in range(len(found)):
        for begin, end in found.sun_above(asked, place):
            times = ",".join(f"{time:%Y-%m-%dT%H:%M:%SZ}" for time in (begin, end))
            print_line(f"{found.lon[place]:.7f},{found.lat[place]:.7f},{times}")
    _warn(found)


def panorama(
    dem: Dems,
    at: Annotated[str, Option(metavar="LON,LAT", help="The place, degrees (WGS 84).")],
    output: Annotated[Path, output_option("The file to write: .png, .svg or .pdf.")],
    peaks: Annotated[Path | None, PEAKS] = None,
    heading: Annotated[
        float, Option(metavar="DEG", help="Azimuth of the picture's middle, from true north.")
    ] = _PANORAMA.heading_deg,
    fov_deg: Annotated[
        float, Option("--fov-deg", metavar="DEG", help="The picture's width in degrees, 5 to 360.")
    ] = _PANORAMA.fov_deg,
    eye_height: EyeHeight = _PANORAMA.eye_height_m,
    summit_within: SummitWithin = None,
    surface: Surfaces = None,
    crs: Crs = None,
) -> None:
    """Draw the view from a place, with the names of the peaks in sight."""
    from skyline.report import panorama as pictures  # noqa: PLC0415  (slow to load)

    place = parse_place(at)
    suffix_of(output, pictures.PANORAMA_SUFFIXES)
    config = PanoramaConfig(heading, fov_deg, eye_height, summit_within)
    terrain = read_terrain(dem, crs)
    eye = _eyes(terrain, [place], eye_height, summit_within)
    with note_if_slow(f"drawing {output}"):
        over = read_surface(surface, terrain) if surface else None
        gazetteer = None if peaks is None else read_peaks(peaks, terrain.frame)
        view = panorama_view(terrain, eye, gazetteer, config, over)
        unnamed = pictures.save_view(view, output)
    seen = len(view.sightings)
    named = "" if gazetteer is None else f", {seen} of {len(gazetteer)} peaks are seen"
    print_line(f"{output}: {output.stat().st_size / 1e6:.1f} MB{named}{unnamed.named}")


def _eyes(
    terrain: HeightField,
    places: Sequence[tuple[float, float]],
    eye_height_m: float,
    summit_within_m: float | None,
) -> Viewpoints:
    """Place eyes at longitudes and latitudes, and print a note for each that stands on a summit."""
    lon, lat = np.transpose(places)
    eyes = stand_at(
        terrain, lon=lon, lat=lat, eye_height_m=eye_height_m, summit_within_m=summit_within_m
    )
    easting_m, northing_m = terrain.frame.from_lonlat(lon, lat)
    away_m = np.hypot(eyes.easting_m - easting_m, eyes.northing_m - northing_m)
    stands_m = eyes.eye_elevation_m - eye_height_m
    surface_m = terrain.height_at(lon=lon, lat=lat)
    eye_lon, eye_lat = terrain.frame.to_lonlat(eyes.easting_m, eyes.northing_m)
    for k, place in enumerate(f"{place[0]:.5f},{place[1]:.5f}" for place in places):
        if summit_within_m:
            print_note(
                f"{place}: the highest point within {summit_within_m:g} m is {eye_lon[k]:.5f},"
                f"{eye_lat[k]:.5f}, {stands_m[k]:.0f} m high and {away_m[k]:.0f} m away"
            )
        elif summit_within_m is None and stands_m[k] - surface_m[k] > 0.01:
            print_note(
                f"{place} is beside a summit of the model: the eye stands as high as it, "
                f"{stands_m[k]:.0f} m, and not on its slope, {surface_m[k]:.0f} m (as "
                "--summit-within 0 would have it)"
            )
    return eyes


def _warn(found: LocalHorizons) -> None:
    """Log a warning where terrain beyond the data may be higher."""
    unsure = (found.flags & (FLAG_TRUNCATED | FLAG_HOLE)) != 0
    if unsure.any():
        _log.warning(
            "%.0f %% of the azimuths look over the DEM's border or over a hole, where higher "
            "terrain may be hidden; give a DEM of a wider area",
            100.0 * unsure.mean(),
        )
