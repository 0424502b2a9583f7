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
from skyline.horizons.local_horizons import LocalHorizons
from skyline.sky.alignments import DEFAULT_WITHIN_KM
from skyline.sky.sun import Body, day_of
from skyline.tasks.sun import DayTask, horizons_on_day, standpoints_on_day
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M

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
    task = DayTask(
        dem=dem,
        crs=crs,
        positions=[parse_position(text) for text in at],
        day=day_of(day),
        within_km=within,
        eye_height_m=eye_height,
        summit_within_m=summit_within,
        refraction_k=refraction_k,
    )
    if over is not None:
        aligned = standpoints_on_day(task, parse_position(over, "--over"), terminal)
        terminal.line("time_utc,lon,lat,distance_m,azimuth_deg,elevation_deg,body")
        for body, one in aligned:
            terminal.line(
                f"{one.time:{_SECOND}},{one.lon:.6f},{one.lat:.6f},{one.distance_m:.0f},"
                f"{one.azimuth_deg:.3f},{one.elevation_deg:.3f},{body}"
            )
        return
    found = horizons_on_day(task, terminal)
    terminal.line("lon,lat,from_utc,to_utc,from_azimuth_deg,to_azimuth_deg,body")
    for place in found:
        for body in Body:
            for line in _intervals(place, task.day, body):
                terminal.line(line)


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
