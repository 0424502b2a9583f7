"""``skyline sun``: when sun and moon are above mountains or a summit."""

from datetime import date
from typing import Annotated

import typer
from typer import Option

from skyline.cli.options import (
    Crs,
    Dems,
    EyeHeight,
    RefractionK,
    SummitWithin,
    parse_position,
)
from skyline.cli.terminal import Terminal
from skyline.errors import InputError
from skyline.geodesy.bounds import Circle
from skyline.geodesy.earth import Curvature
from skyline.horizons.horizon import horizons_of
from skyline.horizons.local_horizons import LocalHorizons
from skyline.sky.alignments import DEFAULT_WITHIN_KM, standpoints
from skyline.sky.sun import Body, check_is_earth, day_of
from skyline.tasks.standing import stand_with_notes, warn_of_border
from skyline.tasks.terrain import curvature_of, read_terrain
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M

_STEP_DEG = 0.125
"""Step of the horizon, which the sun crosses in half a minute."""
_SECOND = "%Y-%m-%dT%H:%M:%SZ"


def sun(
    context: typer.Context,
    dem: Dems,
    at: Annotated[
        list[str],
        Option(metavar="LON,LAT", help="A position, degrees (WGS 84); may be repeated."),
    ],
    day: Annotated[str, Option("--date", metavar="YYYY-MM-DD", help="The day at the position.")],
    over: Annotated[
        str | None,
        Option(
            metavar="LON,LAT",
            help="A summit: print where to stand, around the position, to see the sun or the moon "
            "over it.",
        ),
    ] = None,
    within: Annotated[
        float, Option(metavar="KM", help="With --over: kilometres around the position.")
    ] = DEFAULT_WITHIN_KM,
    eye_height: EyeHeight = DEFAULT_EYE_HEIGHT_M,
    summit_within: SummitWithin = None,
    refraction_k: RefractionK = None,
    crs: Crs = None,
) -> None:
    """Print when sun and moon are above the mountains on a day.

    The result is a CSV of times in UTC and azimuths from true north. With --over,
    it is a CSV of the positions from which sun or moon stand right over a summit,
    minute by minute. The extra `sun` is needed.
    """
    terminal = Terminal.of(context)
    asked = day_of(day)
    positions = [parse_position(text) for text in at]
    summit = None if over is None else parse_position(over, "--over")
    if not within > 0.0:
        raise InputError(f"--within is {within:g}; expected kilometres above 0")
    terrain = read_terrain(terminal, dem, crs)
    check_is_earth(terrain.frame.crs)
    curvature = curvature_of(terrain, refraction_k)
    if summit is not None:
        circles = [(lon, lat, within) for lon, lat in positions]
        lines = [
            line
            for body in Body
            for circle in circles
            for line in _standpoints(terrain, summit, asked, body, circle, eye_height, curvature)
        ]
        terminal.line("time_utc,lon,lat,distance_m,azimuth_deg,elevation_deg,body")
        for line in lines:
            terminal.line(line)
        if not lines:
            terminal.note(
                f"neither the sun nor the moon stands over the summit on {asked}, as seen from "
                f"within {within:g} km; give another day, or a greater --within"
            )
        return
    eyes = stand_with_notes(terrain, positions, eye_height, summit_within, terminal)
    with terminal.progress("rendering") as progress:
        found = horizons_of(terrain, eyes, _STEP_DEG, curvature, progress)
    terminal.line("lon,lat,from_utc,to_utc,from_azimuth_deg,to_azimuth_deg,body")
    for one in found:
        for body in Body:
            for line in _intervals(one, asked, body):
                terminal.line(line)
    warn_of_border(found)


def _intervals(one: LocalHorizons, day: date, body: Body) -> list[str]:
    """Return the lines of a body's times above a place's horizon."""
    above = one.sun_above if body is Body.SUN else one.moon_above
    sky = one.sky()
    return [
        ",".join(
            [
                f"{one.lon:.7f},{one.lat:.7f}",
                *(f"{time:{_SECOND}}" for time in interval),
                *(f"{sky.look(body, time).azimuth_deg:.2f}" for time in interval),
                body,
            ]
        )
        for interval in above(day)
    ]


def _standpoints(
    terrain: HeightField,
    summit: tuple[float, float],
    day: date,
    body: Body,
    within: Circle,
    eye_height_m: float,
    curvature: Curvature,
) -> list[str]:
    """Return lines on places from which a body is over a summit."""
    found = standpoints(
        terrain, summit, day, body, within, eye_height_m=eye_height_m, curvature=curvature
    )
    return [
        f"{one.time:{_SECOND}},{one.lon:.6f},{one.lat:.6f},{one.distance_m:.0f},"
        f"{one.azimuth_deg:.3f},{one.elevation_deg:.3f},{body}"
        for one in found
    ]
