"""What an HDF5 file must hold to be read as a store: damaged and foreign files are told apart."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from skyline.errors import InputError, StoreError
from skyline.store.built import Built
from skyline.store.coding import RowCoding
from skyline.store.header import (
    BUILT,
    COMMITTED,
    KEYPOINTS,
    PLACE_CODING,
    PLACES,
    SCHEMA,
    SCHEMA_VERSION,
    VIEW_SPECS,
    StoreHeader,
    package_version,
)
from skyline.store.lock import REBUILD

_MAX_CHUNK_BYTES = 1 << 26

_CHECKSUMMED = frozenset({h5py.h5z.FILTER_FLETCHER32})
_PACKED = _CHECKSUMMED | {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}


def read_header(path: Path, file: h5py.File) -> StoreHeader:
    """Return the header of a store; raises `StoreError` where any of it is not as it must be."""
    if "schema" not in file.attrs or _text(path, file, "schema") != SCHEMA:
        raise StoreError(
            f"{path} is an HDF5 file but not a skyline store; "
            "name one made by `skyline build` or `skyline render`"
        )
    _check_version(path, file)
    config = json.loads(_text(path, file, "config"))
    files = json.loads(_text(path, file, "dem_files"))
    if not isinstance(config, dict):
        raise StoreError(f"store {path} has a config that is not a JSON object; {REBUILD}")
    if not isinstance(files, list) or not all(isinstance(name, str) for name in files):
        raise StoreError(f"store {path} has dem_files that are not a JSON list; {REBUILD}")
    try:
        rows = _rows(path, file)
        layout: dict[str, Any] = {"holds": PLACES}
        if rows.pop("rows") != PLACES:
            layout = {
                "width": _row_length(path, file, VIEW_SPECS["elevation_tan"][0]),
                "max_keypoints": _row_length(path, file, KEYPOINTS),
                "coding": RowCoding(**rows) if rows else None,
            }
        header = StoreHeader(
            frame_wkt=_text(path, file, "frame"),
            dem_digest=_text(path, file, "dem_digest"),
            dem_files=tuple(files),
            config=config,
            renderer=_text(path, file, "renderer"),
            package_version=_text(path, file, "package_version"),
            **layout,
        )
    except InputError as error:
        raise StoreError(f"store {path} is damaged: {error}; {REBUILD}") from error
    if _text(path, file, "header_digest") != header.digest:
        raise StoreError(
            f"store {path} is damaged: its header (frame, DEM, config, renderer, rows) does not "
            f"have the digest that was written with it; {REBUILD}"
        )
    return header


def _rows(path: Path, file: h5py.File) -> dict[str, Any]:
    """Return what the file says of how its rows are held; raises `StoreError` if unreadable."""
    said = json.loads(_text(path, file, "rows"))
    kind = said.get("rows") if isinstance(said, dict) else None
    if kind == PLACES and said != {"rows": PLACES, **PLACE_CODING}:
        raise StoreError(
            f"store {path} has places that another release of skyline built, whose bytes mean "
            "something else; build it again"
        )
    steps = RowCoding.__slots__ if kind == "compact" else ()
    whole = kind == PLACES or (isinstance(said, dict) and said.keys() == {"rows", *steps})
    if kind not in ("exact", "compact", PLACES) or not whole:
        raise StoreError(f"store {path} has rows {said!r}, which skyline does not read; {REBUILD}")
    return dict(said)


def _check_version(path: Path, file: h5py.File) -> None:
    version = _attribute(path, file, "schema_version")
    if not isinstance(version, np.integer) or version < SCHEMA_VERSION:
        raise StoreError(
            f"store {path} has schema version {version!r}; expected {SCHEMA_VERSION}; build it "
            "again"
        )
    if version > SCHEMA_VERSION:
        raise StoreError(
            f"store {path} has schema version {version}; this skyline ({package_version()}) reads "
            f"version {SCHEMA_VERSION}: upgrade skyline"
        )


def read_committed(path: Path, file: h5py.File) -> int:
    """Return the number of complete rows; raises `StoreError` where there is no such number."""
    return int(_counts(path, file, COMMITTED, ()))


def read_built(path: Path, file: h5py.File) -> Built:
    """Return how much of its build a store holds; raises `StoreError` where that is nonsense."""
    if BUILT not in file:
        return Built()
    done, total = (int(count) for count in _counts(path, file, BUILT, (2,)))
    if done > total:
        raise StoreError(f"store {path}: {done} of {total} parts of it are built; {REBUILD}")
    return Built(done, total)


def _counts(path: Path, file: h5py.File, name: str, shape: tuple[int, ...]) -> Any:
    """Return the unsigned numbers of a dataset of a shape."""
    node = _hard_linked(path, file, name)
    plain = isinstance(node, h5py.Dataset) and node.shape == shape and node.dtype.kind == "u"
    if not plain or node.external or node.is_virtual:
        said = "one unsigned number" if shape == () else "two unsigned numbers"
        raise StoreError(f"store {path}: `{name}` is not {said}; {REBUILD}")
    return node[()]


def _attribute(path: Path, file: h5py.File, name: str) -> object:
    """Return a single-valued attribute."""
    if name not in file.attrs or file.attrs.get_id(name).shape != ():
        raise StoreError(f"store {path} has no single attribute {name!r}; {REBUILD}")
    value: object = file.attrs[name]
    return value


def _text(path: Path, file: h5py.File, name: str) -> str:
    value = _attribute(path, file, name)
    if not isinstance(value, str):
        raise StoreError(f"store {path} has an attribute {name!r} that is not text; {REBUILD}")
    return value


def _row_length(path: Path, file: h5py.File, name: str) -> int:
    dataset = _hard_linked(path, file, name)
    if not isinstance(dataset, h5py.Dataset) or dataset.ndim != 2:
        raise StoreError(f"store {path}: {name} is not a table of rows; {REBUILD}")
    return int(dataset.shape[1])


def _hard_linked(path: Path, file: h5py.File, name: str) -> Any:
    """Return an object that lies in this very file, following no other kind of link."""
    node = file
    for part in name.split("/"):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
        if link is None:
            raise StoreError(f"store {path} lacks {name}; {REBUILD}")
        if not isinstance(link, h5py.HardLink):
            raise StoreError(
                f"store {path}: {name} is a link to elsewhere, which is not followed; {REBUILD}"
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
    """Yield what is wrong with a dataset; what follows a fault assumes that it is not there."""
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
    if mapped and dataset.chunks != (header.chunk_rows, *row.shape):
        yield f"has chunks of {dataset.chunks}"
    if filters - (_PACKED if row.shape and not mapped else _CHECKSUMMED):
        yield "is packed by a filter that skyline does not use"
