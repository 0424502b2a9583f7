"""Checks that an HDF5 file is a store, and neither damaged, foreign nor forged."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from skyline.errors import InputError, StoreError
from skyline.store.format import (
    PLACE_CODING,
    PLACES,
    RENDERINGS,
    SCHEMA,
    SCHEMA_VERSION,
    StoreHeader,
    package_version,
)
from skyline.store.write import REBUILD

_MAX_CHUNK_BYTES = 1 << 26

_CHECKSUMMED = frozenset({h5py.h5z.FILTER_FLETCHER32})
_PACKED = _CHECKSUMMED | {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}


def read_header(path: Path, file: h5py.File) -> StoreHeader:
    """Return the header of a store; raises `StoreError` where it is damaged or foreign."""
    if file.userblock_size or not {"schema", "schema_version"} <= set(file.attrs):
        raise _foreign(path)
    _check_version(path, file)
    if _text(path, file, "schema") != SCHEMA:
        raise _foreign(path)
    config = json.loads(_text(path, file, "config"))
    files = json.loads(_text(path, file, "dem_files"))
    if not isinstance(config, dict):
        raise StoreError(f"store {path} has a config that is not a JSON object; {REBUILD}")
    if not isinstance(files, list) or not all(isinstance(name, str) for name in files):
        raise StoreError(f"store {path} has dem_files that are not a JSON list; {REBUILD}")
    try:
        header = StoreHeader(
            frame_wkt=_text(path, file, "frame"),
            dem_digest=_text(path, file, "dem_digest"),
            dem_files=tuple(files),
            config=config,
            renderer=_text(path, file, "renderer"),
            package_version=_text(path, file, "package_version"),
            **_layout(path, file),
        )
    except InputError as error:
        raise StoreError(f"store {path} is damaged: {error}; {REBUILD}") from error
    if _text(path, file, "header_digest") != header.digest:
        raise StoreError(
            f"store {path} is damaged: its header (frame, DEM, config, renderer, rows) does not "
            f"have the digest that was written with it; {REBUILD}"
        )
    return header


def _foreign(path: Path) -> StoreError:
    return StoreError(
        f"{path} is an HDF5 file but not a skyline store; "
        "name one made by `skyline build` or `skyline render`"
    )


def _layout(path: Path, file: h5py.File) -> dict[str, Any]:
    """Return the kind of rows that a file holds, and their width; raises `StoreError`."""
    rows = json.loads(_text(path, file, "rows"))
    kind = rows.get("rows") if isinstance(rows, dict) else None
    if kind == PLACES and rows != {"rows": PLACES, **PLACE_CODING}:
        raise StoreError(
            f"store {path} has places that another release of skyline built, whose bytes mean "
            "something else; build it again"
        )
    if kind == RENDERINGS and rows.keys() == {"rows", "width"} and type(rows["width"]) is int:
        return {"holds": RENDERINGS, "width": rows["width"]}
    if kind != PLACES:
        raise StoreError(f"store {path} has rows {rows!r}, which skyline does not read; {REBUILD}")
    return {"holds": PLACES}


def _check_version(path: Path, file: h5py.File) -> None:
    version = _attribute(path, file, "schema_version")
    if not isinstance(version, np.integer) or version < SCHEMA_VERSION:
        raise StoreError(
            f"store {path} has schema version {version}, of an older skyline; this one "
            f"({package_version()}) reads version {SCHEMA_VERSION}: build the store again"
        )
    if version > SCHEMA_VERSION:
        raise StoreError(
            f"store {path} has schema version {version}; this skyline ({package_version()}) reads "
            f"version {SCHEMA_VERSION}: upgrade skyline"
        )


def _attribute(path: Path, file: h5py.File, name: str) -> object:
    """Return an attribute of one value; one of a variable length is not read.

    HDF5 keeps values of variable lengths in a heap without a checksum, and may loop in a damaged
    one.
    """
    if name not in file.attrs or file.attrs.get_id(name).shape != ():
        raise StoreError(f"store {path} has no single attribute {name!r}; {REBUILD}")
    kind = file.attrs.get_id(name).get_type()
    plain = isinstance(kind, h5py.h5t.TypeIntegerID) or (
        isinstance(kind, h5py.h5t.TypeStringID) and not kind.is_variable_str()
    )
    value: object = file.attrs[name] if plain else None
    return value


def _text(path: Path, file: h5py.File, name: str) -> str:
    value = _attribute(path, file, name)
    if not isinstance(value, bytes):
        raise StoreError(f"store {path} has an attribute {name!r} that is not text; {REBUILD}")
    return value.decode().removesuffix(" " if value == b" " else "")


def _hard_linked(path: Path, file: h5py.File, name: str) -> Any:
    """Return an object that lies in this very file, following no other kind of link."""
    node = file
    for part in name.split("/"):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
        if link is None:
            raise StoreError(f"store {path} lacks {name}; {REBUILD}")
        if not isinstance(link, h5py.HardLink):
            raise StoreError(
                f"store {path}: {name} is a link to another place, which is not followed; {REBUILD}"
            )
        node = node[part]
    return node


def checked_dataset(
    path: Path, file: h5py.File, name: str, row: np.dtype[Any], header: StoreHeader
) -> h5py.Dataset:
    """Return a dataset if it has the schema's layout and its bytes lie in this file."""
    dataset = _hard_linked(path, file, name)
    for fault in _faults(dataset, row, header):
        raise StoreError(f"store {path}: {name} {fault}; {REBUILD}")
    return dataset


def _faults(dataset: Any, row: np.dtype[Any], header: StoreHeader) -> Iterator[str]:
    """Yield the faults of a dataset; each check assumes that those before it found none."""
    if not isinstance(dataset, h5py.Dataset) or dataset.shape[1:] != row.shape or not dataset.shape:
        yield f"is not rows of shape {row.shape}"
    if dataset.dtype != row.base:
        yield f"is of type {dataset.dtype}, not {row.base.str.lstrip('|')}"
    # Rules out virtual, external, contiguous and compact storage: none of them is chunked.
    if dataset.chunks is None:
        yield "is not chunked in this file"
    if np.prod(dataset.chunks, dtype=float) * dataset.dtype.itemsize > _MAX_CHUNK_BYTES:
        yield f"has chunks of {dataset.chunks}, too large"
    created = dataset.id.get_create_plist()
    filters = {created.get_filter(n)[0] for n in range(created.get_nfilters())}
    mapped = header.holds == PLACES
    if mapped and dataset.chunks != (header.chunk_rows(len(dataset)), *row.shape):
        yield f"has chunks of {dataset.chunks}"
    if filters - (_PACKED if row.shape and not mapped else _CHECKSUMMED):
        yield "is packed by a filter that skyline does not use"
