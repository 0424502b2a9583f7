"""Requests to a renderer, and what comes back, matched by place and heading."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

Headings = NDArray[np.uint8]

Render = Callable[[Viewpoints, Headings], Views]
"""Renders N viewpoints along N headings; the N views may come in any order."""

Place = tuple[float, float, int]
"""Easting, northing and heading."""


def places(viewpoints: Viewpoints | Views, heading: Headings) -> list[Place]:
    """Return the places of N viewpoints along N headings, or of N views."""
    easting, northing = viewpoints.easting_m.tolist(), viewpoints.northing_m.tolist()
    return list(zip(easting, northing, heading.tolist(), strict=True))


def rows_by_place(views: Views) -> dict[Place, int]:
    """Return where in ``views`` each place is."""
    return {place: row for row, place in enumerate(places(views, views.heading))}


def as_asked(views: Views, asked: list[Place]) -> Views:
    """Return views in the order they were asked for, some of them more than once perhaps.

    Raises
    ------
    InputError
        A view that was asked for is not there.
    """
    row = rows_by_place(views)
    missing = [place for place in asked if place not in row]
    if missing:
        easting, northing, heading = missing[0]
        raise InputError(
            f"there is no view at easting {easting:.2f}, northing {northing:.2f}, heading "
            f"{heading}; expected one for each of the {len(asked)} asked for ({len(missing)} such)"
        )
    return views[np.array([row[place] for place in asked], dtype=np.int64)]
