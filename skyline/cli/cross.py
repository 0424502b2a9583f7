"""``skyline cross``: where the same thing stands in two or more photos."""

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Argument, Option

from skyline.cli.options import AsJson, Crs, Dem
from skyline.cli.photo_options import pixels_of
from skyline.cli.terminal import Terminal
from skyline.tasks.cross import Crossed, CrossTask, cross_photos
from skyline.tasks.standing import assumed_lines


def cross(
    context: typer.Context,
    photos: Annotated[list[Path], Argument(metavar="PHOTO...", help="Two photos or more.")],
    pose: Annotated[
        list[Path],
        Option(metavar="FILE.json", help="The pose of each photo, in the photos' order."),
    ],
    pixel: Annotated[
        list[str],
        Option(metavar="COLUMN,ROW", help="The pixel of the same thing in each photo, in order."),
    ],
    dem: Dem,
    as_json: AsJson = False,
    crs: Crs = None,
) -> None:
    """Give the position of something that two or more photos show.

    It may stand above the ground, as smoke does. The answer has its standard
    errors, and says whether the rays meet at all.
    """
    terminal = Terminal.of(context, as_json)
    task = CrossTask(
        photos=photos,
        poses=pose,
        pixels=[pixels_of(text, "--pixel", (1,))[0] for text in pixel],
        dem=dem,
        crs=crs,
    )
    found = cross_photos(task, terminal)
    terminal.result(_record(found), _in_words(found))


def _in_words(found: Crossed) -> str:
    """Return the answer as lines of text."""
    at = found.crossing
    east_m, north_m, up_m = np.sqrt(np.diag(at.covariance_m2)).tolist()
    ground = ""
    if math.isfinite(found.above_ground_m):
        ground = f", {found.above_ground_m:.0f} m above the ground"
    chance = f"probability {at.probability:.2g} of a misfit so great"
    meets = f"the rays meet: {chance}"
    if not at.meets:
        meets = f"the rays miss each other: {chance}; check that all pixels show the same thing"
    lines = [
        f"{found.lon:.6f},{found.lat:.6f}, {at.elevation_m:.0f} m high{ground}; give or take "
        f"{east_m:.0f} m east, {north_m:.0f} m north and {up_m:.0f} m up",
        meets,
    ]
    return "\n".join(lines + assumed_lines(found.assumed))


def _record(found: Crossed) -> dict[str, Any]:
    """Return the answer for JSON."""
    at = found.crossing
    return {
        "lon": found.lon,
        "lat": found.lat,
        "elevation_m": at.elevation_m,
        "above_ground_m": found.above_ground_m if math.isfinite(found.above_ground_m) else None,
        "covariance_m2": at.covariance_m2.tolist(),
        "chi_square": at.chi_square,
        "probability": at.probability,
        "meets": at.meets,
        "assumed": found.assumed,
    }
