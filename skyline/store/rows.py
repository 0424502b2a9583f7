"""Rows as a store holds them, by dataset, and as the `Views` or `Places` they stand for."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyline.camera import HEADINGS
from skyline.errors import InputError
from skyline.features import NO_KEYPOINT
from skyline.places import Places
from skyline.store.header import (
    CODED,
    KEYPOINTS,
    PLACE_SPECS,
    VIEW_SPECS,
    KeypointColumns,
    StoreHeader,
)
from skyline.views import Views

Columns = Mapping[str, NDArray[Any]]
"""N rows of several datasets, by the datasets' names, in the types they are stored in."""


def stored_rows(header: StoreHeader, views: Views, keypoint_columns: KeypointColumns) -> Columns:
    """Return views as a store with ``header`` holds them.

    Raises `InputError` for shapes or values that do not fit the store.
    """
    given = {name: getattr(views, field) for field, (name, _) in VIEW_SPECS.items()}
    given[KEYPOINTS] = keypoint_columns
    for name, values in given.items():
        expected = (len(views), *header.row_shape(header.specs[name].per_row))
        if np.shape(values) != expected:
            raise InputError(
                f"{name} to append has shape {np.shape(values)}; the store expects {expected}: "
                f"use its width, {header.width}, and its number of keypoints, "
                f"{header.max_keypoints}"
            )
    columns = np.asarray(keypoint_columns)
    if ((columns < 0) | (columns >= header.width) & (columns != NO_KEYPOINT)).any():
        raise InputError(
            f"keypoint columns to append lie outside 0 to {header.width - 1}; "
            f"pad rows with {NO_KEYPOINT}"
        )
    if not np.isin(views.heading, HEADINGS).all():
        raise InputError(f"a heading to append is not one of {HEADINGS}")
    if header.coding:
        encode = {"elevation_tan": header.coding.tan_codes, "depth_m": header.coding.depth_codes}
        given |= {name: encode[field](given[name]) for name, field in CODED.items()}
    # A copy in any case, so that the caller may use the arrays again.
    return {name: np.array(given[name], dtype=header.specs[name].dtype) for name in given}


def stored_places(header: StoreHeader, places: Places) -> Columns:
    """Return places as a store with ``header`` holds them.

    Raises `InputError` for shapes that do not fit, or eyes and tolerances that are not numbers.
    """
    columns = {}
    for field, (name, spec) in PLACE_SPECS.items():
        values, expected = getattr(places, field), (len(places), *header.row_shape(spec.per_row))
        if np.shape(values) != expected:
            raise InputError(
                f"{name} to append has shape {np.shape(values)}; the store expects {expected}"
            )
        if spec.per_row == "one" and not np.isfinite(values).all():
            raise InputError(f"{name} to append has values that are not numbers")
        # A copy in any case, so that the caller may use the arrays again.
        columns[name] = np.array(values, dtype=spec.dtype)
    return columns


def views_of(header: StoreHeader, columns: Columns) -> Views:
    """Return the views that stored rows stand for."""
    fields: dict[str, Any] = {
        field: _decoded(header, name, columns[name]) for field, (name, _) in VIEW_SPECS.items()
    }
    return Views(**fields)


def as_stored(header: StoreHeader, views: Views) -> Views:
    """Return views as they will be read back from a store with ``header``.

    What goes on from rendered views and what goes on from stored ones must see the same.
    """
    nothing = np.full((len(views), header.max_keypoints), NO_KEYPOINT, dtype=np.uint16)
    return views_of(header, stored_rows(header, views, nothing))


def _decoded(header: StoreHeader, name: str, values: NDArray[Any]) -> NDArray[Any]:
    if not header.coding or name not in CODED:
        return values
    decode = {"elevation_tan": header.coding.elevation_tan, "depth_m": header.coding.depth_m}
    return decode[CODED[name]](values)
