"""The uniform grid of viewpoints, and the part of a field inside bounds."""

import numpy as np

from skyline.errors import InputError, swapped_in_words
from skyline.geodesy import Bounds, Rectangle, are_bounds
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, stand_where_possible


def map_bounds(field: HeightField, bounds_deg: Bounds | None) -> Rectangle:
    """Return the part of a field inside bounds (WGS 84), or all of it.

    The box in degrees is a curved quadrangle on the map; its bounding rectangle is returned,
    clipped to the field. Raises `InputError` for bounds that are not numbers in order, or that do
    not meet the field.
    """
    if bounds_deg is None:
        return field.bounds_m
    clipped = _clipped(field, bounds_deg)
    if clipped is None:
        west, south, east, north = bounds_deg
        data = field.bounds_m
        swapped = south, west, north, east
        is_swapped = are_bounds(*swapped) and _clipped(field, swapped) is not None
        raise InputError(
            f"bounds {west},{south},{east},{north} do not meet the DEM, which covers "
            + ",".join(
                f"{side:.4f}"
                for side in field.frame.box_deg(easting_m=data[::2], northing_m=data[1::2])
            )
            + (f"; {swapped_in_words(*bounds_deg)}" if is_swapped else "")
        )
    return clipped


def _clipped(field: HeightField, bounds_deg: Bounds) -> Rectangle | None:
    """Return the rectangle around bounds, clipped to a field; None where they do not meet."""
    box, data = field.frame.rectangle_m(bounds_deg), field.bounds_m
    west, south = max(box[0], data[0]), max(box[1], data[1])
    east, north = min(box[2], data[2]), min(box[3], data[3])
    return (west, south, east, north) if west < east and south < north else None


def uniform_grid(
    field: HeightField, spacing_m: float, bounds_m: Rectangle | None = None
) -> Viewpoints:
    """Place viewpoints at whole multiples of a spacing in the field's frame.

    Locations on holes or off the surface are left out, so that areas that overlap share their
    viewpoints. The order is row by row from the north-west. Raises `InputError` for a spacing that
    is not positive, or so large that no viewpoint falls on the surface.
    """
    if not (np.isfinite(spacing_m) and spacing_m > 0.0):
        raise InputError(f"spacing is {spacing_m} m; expected a positive number of metres")
    west, south, east, north = bounds_m or field.bounds_m
    cols = np.arange(np.ceil(west / spacing_m), np.floor(east / spacing_m) + 1.0)
    rows = np.arange(np.floor(north / spacing_m), np.ceil(south / spacing_m) - 1.0, -1.0)
    if len(cols) * len(rows) > 50_000_000:
        raise InputError(
            f"a spacing of {spacing_m} m asks for {len(cols) * len(rows)} viewpoints; "
            "choose a larger spacing or smaller bounds"
        )
    easting, northing = (grid.ravel() for grid in np.meshgrid(cols * spacing_m, rows * spacing_m))
    eyes, _ = stand_where_possible(field, easting, northing, DEFAULT_EYE_HEIGHT_M)
    if not len(eyes):
        raise InputError(
            f"no viewpoint of a {spacing_m} m grid falls on the surface in easting {west:.0f} to "
            f"{east:.0f}, northing {south:.0f} to {north:.0f}; choose a smaller spacing"
        )
    return eyes
