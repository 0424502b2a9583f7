"""Checks that an HDF5 file is a store, and neither damaged, foreign nor forged."""

import json
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

_ATTRIBUTES = (
    "frame",
    "dem_digest",
    "dem_files",
    "config",
    "renderer",
    "package_version",
    "rows",
)
"""Attributes beside the schema and the digest."""

_FILTERS = {"fletcher32", "shuffle", "compression"}
"""Settings of a layout that are HDF5 filters."""


def read_header(path: Path, file: h5py.File) -> StoreHeader:
    """Return the header of a store; raises `StoreError` where it is damaged or foreign."""
    if file.userblock_size or not {"schema", "schema_version"} <= set(file.attrs):
        raise _foreign(path)
    _check_version(path, file)
    if _text(path, file, "schema") != SCHEMA:
        raise _foreign(path)
    texts = {name: _text(path, file, name) for name in (*_ATTRIBUTES, "header_digest")}
    rows = json.loads(texts["rows"])
    holds = rows.get("rows") if isinstance(rows, dict) else None
    if holds not in (RENDERINGS, PLACES):
        raise StoreError(f"store {path} has rows {rows!r}, which skyline does not read; {REBUILD}")
    if holds == PLACES and rows != {"rows": PLACES, **PLACE_CODING}:
        raise StoreError(
            f"store {path} has places that another release of skyline built, whose bytes mean "
            "something else; build it again"
        )
    try:
        # A value of another JSON type is converted here, and so fails the comparison of digests.
        header = StoreHeader(
            frame_wkt=texts["frame"],
            dem_digest=texts["dem_digest"],
            dem_files=tuple(map(str, json.loads(texts["dem_files"]))),
            config=dict(json.loads(texts["config"])),
            renderer=texts["renderer"],
            width=int(rows.get("width", 0)),
            holds=holds,
            package_version=texts["package_version"],
        )
    except InputError as error:
        raise StoreError(f"store {path} is damaged: {error}; {REBUILD}") from error
    if texts["header_digest"] != header.digest:
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


def checked_dataset(path: Path, file: h5py.File, name: str, header: StoreHeader) -> h5py.Dataset:
    """Return a dataset if it has the schema's layout and its bytes lie in this file.

    Virtual, external, contiguous and compact storage have no chunks, so they are refused.
    """
    dataset = _hard_linked(path, file, name)
    if not isinstance(dataset, h5py.Dataset) or not dataset.shape:
        raise StoreError(f"store {path}: {name} is not a dataset of rows; {REBUILD}")
    layout = header.layout(name, len(dataset))
    for setting, wanted in layout.items():
        found = getattr(dataset, setting)
        if found != wanted:
            raise StoreError(
                f"store {path}: {name} has {setting} {found}; expected {wanted}; {REBUILD}"
            )
    if dataset.id.get_create_plist().get_nfilters() != len(layout.keys() & _FILTERS):
        raise StoreError(
            f"store {path}: {name} is packed by a filter that skyline does not use; {REBUILD}"
        )
    return dataset
