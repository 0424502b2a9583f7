"""The area that a store was built for."""

import logging
from typing import cast

from skyline.geodesy import Rectangle
from skyline.planning.uniform import map_bounds
from skyline.store import StoreHeader
from skyline.terrain.heightfield import HeightField

_log = logging.getLogger(__name__)


def mapped_area_m(header: StoreHeader, terrain: HeightField) -> Rectangle | None:
    """Return the part of a terrain that a store was built for; None where it does not say.

    Bounds that are no box on the terrain count as unsaid, with a warning.
    """
    if "bounds_deg" not in header.config:
        return None
    bounds_deg = header.config["bounds_deg"]
    if bounds_deg is None:
        return map_bounds(terrain, None)
    try:
        west, south, east, north = (float(degrees) for degrees in cast(list[float], bounds_deg))
        return map_bounds(terrain, (west, south, east, north))
    except (TypeError, ValueError) as error:
        _log.warning("the store's own bounds_deg, %r, are of no use: %s", bounds_deg, error)
        return None
