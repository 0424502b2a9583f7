"""Rows as a store holds them, by dataset, and as the `Views` or `Places` they stand for.

A checksum per row is taken over the bytes of the row as they are stored. HDF5 guards its own
structures (object headers, chunk indexes, the superblock) with checksums, and each chunk of rows
here with another (Fletcher-32), which readers verify as they read. Those see a chunk that changed,
but not one that was never written: a hole in a file reads as zeros, and the Fletcher-32 of zeros
is zero. The checksum of a row sees that, says which rows are whole when others are not, and goes
with the row from store to store.
"""

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyline.camera import HEADINGS
from skyline.errors import InputError
from skyline.features import NO_KEYPOINT
from skyline.places import Places
from skyline.store.header import (
    CHECKSUM,
    CODED,
    KEYPOINTS,
    PLACE_CHECKSUM,
    KeypointColumns,
    StoreHeader,
)
from skyline.views import Views

Columns = Mapping[str, NDArray[Any]]
"""N rows of several datasets, by the datasets' names, in the types they are stored in."""

_AT_ONCE_BYTES = 1 << 22
"""Rows are laid out anew for one call each; this many bytes of them at a time."""


def stored_rows(header: StoreHeader, views: Views, keypoint_columns: KeypointColumns) -> Columns:
    """Return views as a store with ``header`` holds them.

    Raises `InputError` for shapes or values that do not fit the store.
    """
    specs = header.specs
    given = {name: getattr(views, field) for field, name in header.fields.items()}
    given[KEYPOINTS] = keypoint_columns
    for name, values in given.items():
        expected = (len(views), *specs[name].shape)
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
        tan, depth = CODED
        given[tan] = header.coding.tan_codes(given[tan])
        given[depth] = header.coding.depth_codes(given[depth])
    # A copy in any case, so that the caller may use the arrays again.
    return {name: np.array(given[name], dtype=specs[name].base) for name in given}


def stored_places(header: StoreHeader, places: Places) -> Columns:
    """Return places as a store with ``header`` holds them.

    Raises `InputError` for shapes that do not fit, or eyes and tolerances that are not numbers.
    """
    columns, specs = {}, header.specs
    for field, name in header.fields.items():
        values, expected = getattr(places, field), (len(places), *specs[name].shape)
        if np.shape(values) != expected:
            raise InputError(
                f"{name} to append has shape {np.shape(values)}; the store expects {expected}"
            )
        if not specs[name].shape and not np.isfinite(values).all():
            raise InputError(f"{name} to append has values that are not numbers")
        # A copy in any case, so that the caller may use the arrays again.
        columns[name] = np.array(values, dtype=specs[name].base)
    return columns


def views_of(header: StoreHeader, columns: Columns) -> Views:
    """Return the views that stored rows stand for."""
    fields: dict[str, Any] = {field: columns[name] for field, name in header.fields.items()}
    if header.coding:
        fields["elevation_tan"] = header.coding.elevation_tan(fields["elevation_tan"])
        fields["depth_m"] = header.coding.depth_m(fields["depth_m"])
    return Views(**fields)


def as_stored(header: StoreHeader, views: Views) -> Views:
    """Return views as they will be read back from a store with ``header``.

    What goes on from rendered views and what goes on from stored ones must see the same.
    """
    nothing = np.full((len(views), header.max_keypoints), NO_KEYPOINT, dtype=np.uint16)
    return views_of(header, stored_rows(header, views, nothing))


def row_checksums(columns: Columns) -> NDArray[np.uint32]:
    """Return CRC-32s, (N,), over each row's little-endian bytes, datasets in order of name.

    Columns are (N, ...) stored rows by dataset; their checksums among them are passed over.
    """
    names = [name for name in sorted(columns) if name not in (CHECKSUM, PLACE_CHECKSUM)]
    count = len(columns[names[0]])
    sums = np.zeros(count, dtype=np.uint32)
    if not count:
        return sums
    plain = [np.ascontiguousarray(columns[name]).reshape(count, -1) for name in names]
    held = [values.view(np.uint8) for values in plain]
    step = max(_AT_ONCE_BYTES // sum(values.shape[1] for values in held), 1)
    for first in range(0, count, step):
        together = np.concatenate([values[first : first + step] for values in held], axis=1)
        sums[first : first + step] = checksums_of_bytes(together)
    return sums


def checksums_of_bytes(rows: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return the CRC-32 of each row (N, B) of bytes."""
    width, flat = rows.shape[1], rows.tobytes()
    sums = (zlib.crc32(flat[start : start + width]) for start in range(0, len(flat), width))
    return np.fromiter(sums, dtype=np.uint32, count=len(rows))
