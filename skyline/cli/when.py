"""``skyline when``: a photo's time or heading, by sun or shadow."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from skyline.cli.options import POSE, AsJson, Crs, Dem, PhotoProjection
from skyline.cli.photo_options import PhotoFile, pixels_of
from skyline.cli.terminal import Terminal
from skyline.errors import InputError
from skyline.sky.sun import Body, day_of, time_of
from skyline.tasks.standing import assumed_lines
from skyline.tasks.when import Told, WhenTask, tell_when

_PIXEL = "COLUMN,ROW"


def when(
    context: typer.Context,
    photo: PhotoFile,
    pose: Annotated[Path, POSE],
    dem: Dem,
    day: Annotated[
        str | None,
        Option("--date", metavar="YYYY-MM-DD", help="The day: the time of day is found."),
    ] = None,
    time: Annotated[
        str | None,
        Option(metavar="TIME", help="The time, as 2026-12-21T15:04Z: the heading is found."),
    ] = None,
    sun: Annotated[
        str | None, Option(metavar=_PIXEL, help="The pixel in the middle of the sun.")
    ] = None,
    moon: Annotated[
        str | None, Option(metavar=_PIXEL, help="The pixel in the middle of the moon's disc.")
    ] = None,
    shadow: Annotated[
        str | None,
        Option(
            metavar="TIP,FOOT[,TOP]",
            help="A shadow of something upright: column and row of the shadow's tip, of the foot "
            "of what casts it, and, if known, of its top.",
        ),
    ] = None,
    as_json: AsJson = False,
    projection: PhotoProjection = None,
    crs: Crs = None,
) -> None:
    """Tell when a photo was taken, by sun, moon or shadow.

    Given the time in place of the day, tell the camera's heading. Each answer has its standard
    error. The extra `sun` is needed.
    """
    terminal = Terminal.of(context, as_json)
    given = {"--sun": sun, "--moon": moon, "--shadow": shadow}
    marks = {name: text for name, text in given.items() if text is not None}
    if len(marks) != 1:
        raise InputError("give one of --sun COLUMN,ROW, --moon COLUMN,ROW and --shadow TIP,FOOT")
    if (day is None) == (time is None):
        raise InputError("give --date YYYY-MM-DD for the time of day, or --time for the heading")
    ((name, text),) = marks.items()
    task = WhenTask(
        photo=photo,
        pose=pose,
        dem=dem,
        crs=crs,
        marked=pixels_of(text, name, (2, 3) if name == "--shadow" else (1,)),
        body=Body.MOON if name == "--moon" else Body.SUN,
        known=time_of(time) if time is not None else day_of(str(day)),
        projection=projection,
    )
    told = tell_when(task, terminal)
    terminal.result(_record(told), "\n".join(_lines(told)))


def _lines(told: Told) -> list[str]:
    """Return the answer in words, with the assumed errors."""
    assumed = assumed_lines(told.assumed)
    if told.heading is None:
        return [
            f"{one.time:%Y-%m-%d %H:%M:%S} UTC, give or take {one.sd_s / 60.0:.1f} minutes: "
            f"azimuth {one.azimuth_deg:.2f}, elevation {one.elevation_deg:.2f} degrees, "
            f"{one.off_sds:.1f} standard errors aside"
            for one in told.times
        ] + assumed
    found = told.heading
    higher = (
        ""
        if math.isnan(found.above_deg)
        else f"; it stands {found.above_deg:.2f} degrees above its pixel"
    )
    return [
        f"heading {found.heading_deg:.2f} +- {found.sd_deg:.2f} from true north; the pose's is "
        f"{told.pose.heading_deg:.2f}, {found.off_sds:.1f} standard errors away{higher}",
        *assumed,
    ]


def _record(told: Told) -> dict[str, Any]:
    """Return the answer for JSON."""
    if told.heading is None:
        times = [asdict(one) | {"time": f"{one.time:%Y-%m-%dT%H:%M:%SZ}"} for one in told.times]
        return {"times": times, "assumed": told.assumed}
    found = told.heading
    above = None if math.isnan(found.above_deg) else found.above_deg
    return {
        "heading_deg": found.heading_deg,
        "heading_sd_deg": found.sd_deg,
        "off_sds": found.off_sds,
        "above_deg": above,
        "assumed": told.assumed,
    }
