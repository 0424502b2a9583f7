"""Reading a store: its header and its rows.

A file is a store if its header has the digest that was written with it, its datasets have the
layout that the header gives, and no dataset keeps bytes in another file.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Mapping
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Index, Int64Array, IntArray
from skyline.errors import InputError, MissingFileError, StoreError
from skyline.files.disk import STORE_SUFFIXES
from skyline.geodesy.map_frame import Frame
from skyline.notebooks import facts_html
from skyline.skylines import Views
from skyline.store.layout import (
    EYE,
    KEYPOINTS,
    MADE_BY,
    PLACES,
    REBUILD,
    RENDERINGS,
    UNREADABLE,
    Columns,
    KeypointColumns,
    StoreHeader,
    explained,
    read_header,
)
from skyline.store.mapped_places import PlaceMap
from skyline.store.xarray_export import dataset_of_places, dataset_of_views, table_of_places
from skyline.terrain.viewpoints import Viewpoints

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from xarray import Dataset


class Store:
    """The rows of a finished store, which `open_store` opens; a context manager.

    Attributes
    ----------
    path : Path
    header : StoreHeader
        The DEM and the settings of the build.
    """

    def __init__(self, path: Path) -> None:
        """Open and check the store at a resolved path; raises as `open_store`."""
        self.path = path
        with ExitStack() as opened:
            # HDF5 takes no lock on a file that Python opened. A finished store needs none.
            self._raw = opened.enter_context(open_hdf5(path))
            with explained(path, "it cannot be opened"):
                self._file = opened.enter_context(h5py.File(self._raw, "r"))
                self.header = read_header(path, self._file)
                self._datasets = {
                    name: _checked_dataset(path, self._file, name, self.header)
                    for name in self.header.specs
                }
                self._rows = self._counted()
            self._resources = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; closing twice is fine."""
        self._resources.close()

    def __len__(self) -> int:
        return self._rows

    def __repr__(self) -> str:
        return f"Store({self.path.name}: {len(self)} {self.header.holds})"

    def _repr_html_(self) -> str:
        header = self.header
        settings = header.config.items()
        facts = {
            "store": str(self.path),
            header.holds: f"{len(self):,}",
            "frame": Frame(header.frame_wkt).name,
            "DEM": ", ".join(header.dem_files) or "no file",
            **{name: str(value) for name, value in settings if not isinstance(value, Mapping)},
            "made by": f"skyline {header.package_version}",
        }
        return facts_html(facts)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the DEM's digest, the settings and all rows' checksums, hexadecimal.

        It does not depend on the files' paths, the release or the renderer.
        """
        about = {name: self.header.attributes[name] for name in ("dem_digest", "config", "rows")}
        sha = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
        sha.update(self.stored_as(self.header.checksum).tobytes())
        return sha.hexdigest()

    def views(self, index: Index = slice(None)) -> Views:
        """Read views.

        Parameters
        ----------
        index : int, slice, integer or boolean array
            Rows in the wanted order, as for NumPy; an int gives one view.

        Raises
        ------
        InputError
            A row does not exist, or the store holds places.
        StoreError
            Damaged data.
        """
        self.expect(RENDERINGS)
        rows = self._indexed(index)
        fields: Any = {field: self._read(name, rows) for field, name in self.header.fields.items()}
        return Views(**fields)

    def stored(self, index: Index = slice(None)) -> Columns:
        """Read rows as stored, by dataset; raises as `views`."""
        rows = self._indexed(index)
        return {name: self._read(name, rows) for name in self.header.specs}

    def stored_as(self, name: str) -> NDArray[Any]:
        """Read all rows of one dataset; raises as `views`."""
        return self._read(name, self._indexed(slice(None)))

    def keypoint_columns(self, index: Index = slice(None)) -> KeypointColumns:
        """Read keypoints (N, K) uint16, padded with 65535; otherwise as `views`."""
        self.expect(RENDERINGS)
        return self._read(KEYPOINTS, self._indexed(index))

    def eyes(self) -> Viewpoints:
        """Read the eyes of all rows, of either kind; raises as `stored`."""
        names = self.header.fields
        read = {field: self.stored_as(names[field]).astype(np.float64, copy=False) for field in EYE}
        return Viewpoints(**read)

    def places(self) -> PlaceMap:
        """Map the places of a store, which may be closed afterwards.

        Raises
        ------
        InputError
            The store holds renderings.
        StoreError
            Damaged data.
        """
        self.expect(PLACES)
        if not self._file:
            raise self._closed()
        size = self.header.chunk_rows(len(self))
        offsets = {name: self._chunk_offsets(name, size) for name in self.header.specs}
        with explained(self.path, "it cannot be mapped"):
            return PlaceMap(self.path, self._raw.fileno(), self.header, len(self), offsets)

    def to_xarray(self, index: Index = slice(None)) -> Dataset:
        """Return rows as an `xarray.Dataset` (extra ``geo``), in memory.

        Parameters
        ----------
        index : int, slice, integer or boolean array
            Rows in the order wanted, as for `views`.

        Returns
        -------
        xarray.Dataset
            ``elevation_deg`` and ``distance_m`` (horizontal). Places have the dimensions ``place``
            and ``grid_azimuth_deg``; renderings have ``view`` and ``column``, and also ``flags``.
            The coordinate ``azimuth_deg`` has both dimensions and is from true north,
            ``grid_azimuth_deg`` is from grid north, and ``convergence_deg`` is a row's true azimuth
            minus its grid azimuth. The eyes have ``lon``, ``lat``, ``easting_m``, ``northing_m``
            and ``eye_elevation_m``; ``spatial_ref`` (CF) is the frame.

        Raises
        ------
        InputError
            A row does not exist, or xarray is not installed.
        StoreError
            Damaged data.
        """
        rows = self._indexed(index)
        frame = Frame(self.header.frame_wkt)
        if self.header.holds == PLACES:
            data: Dataset = dataset_of_places(self.places().take(rows), rows, frame)
        else:
            data = dataset_of_views(self.views(index), rows, frame)
        return data

    def to_geodataframe(self, index: Index = slice(None)) -> GeoDataFrame:
        """Return places as points (extra ``geo``), in memory.

        Parameters
        ----------
        index : int, slice, integer or boolean array
            Rows in the order wanted, as for `views`.

        Returns
        -------
        geopandas.GeoDataFrame
            Points in the store's frame, with ``place`` (the row), ``lon``, ``lat``,
            ``eye_elevation_m``, ``tolerance_m`` (the distance from the eye, east and north, within
            which the place represents other eyes) and ``spacing_m``, which is twice that.

        Raises
        ------
        InputError
            The store holds renderings, a row does not exist, or GeoPandas is not installed.
        StoreError
            Damaged data.
        """
        rows = self._indexed(index)
        frame = Frame(self.header.frame_wkt)
        return table_of_places(self.places().take(rows), rows, frame)

    def expect(self, holds: str) -> None:
        """Raise `InputError` unless the store has rows of this kind."""
        if self.header.holds != holds:
            raise InputError(
                f"store {self.path} holds {self.header.holds}, not {holds}; name a store of "
                f"{holds}, which {MADE_BY[holds]} makes"
            )

    def _indexed(self, index: Index) -> IntArray:
        try:
            return np.atleast_1d(np.arange(len(self))[index])
        except IndexError as error:
            raise InputError(f"{error}: store {self.path} has {len(self)} rows") from error

    def _read(self, name: str, rows: IntArray) -> NDArray[Any]:
        """Return rows of a dataset in the order wanted; raises `StoreError`."""
        if not self._file:
            raise self._closed()
        with explained(self.path, f"{name} cannot be read"):
            dataset = self._datasets[name]
            if len(rows) == 0:
                return np.zeros((0, *dataset.shape[1:]), dataset.dtype)
            if (np.diff(rows) == 1).all():
                return np.asarray(dataset[rows[0] : rows[-1] + 1])
            # HDF5 requires rows in ascending order and each once.
            ascending, position = np.unique(rows, return_inverse=True)
            return np.asarray(dataset[ascending])[position]

    def _chunk_offsets(self, name: str, size: int) -> Int64Array:
        """Return the file offsets of a dataset's chunks of ``size`` rows."""
        dataset = self._datasets[name]
        at = np.zeros(-(-len(self) // size), dtype=np.int64)

        def visit(info: Any) -> None:
            chunk = info.chunk_offset[0] // size
            if chunk < len(at):
                at[chunk] = info.byte_offset or 0

        with explained(self.path, f"the chunks of {name} cannot be read"):
            dataset.id.chunk_iter(visit)
        # HDF5's own structures come first in a file.
        if not (at > 0).all():
            lost = int(np.flatnonzero(at <= 0)[0]) * size
            raise self._damaged(f"{name} holds no row {lost}")
        return at

    def _counted(self) -> int:
        """Return the number of rows; raises `StoreError` where some are missing."""
        counts = {len(dataset) for dataset in self._datasets.values()}
        rows = max(counts)
        # Chunks are not counted: HDF5 would visit every chunk that a damaged index names.
        if len(counts) > 1 or rows > os.fstat(self._raw.fileno()).st_size:
            raise self._damaged(f"its datasets have {min(counts)} to {rows} rows")
        for name, dataset in self._datasets.items():
            last = (max(rows - 1, 0),) + (0,) * (dataset.ndim - 1)
            if rows and dataset.id.get_chunk_info_by_coord(last).byte_offset is None:
                raise self._damaged(f"{name} holds no row {rows - 1}")
        return rows

    def _damaged(self, problem: str) -> StoreError:
        return StoreError(f"store {self.path} is damaged: {problem}; {REBUILD}")

    def _closed(self) -> StoreError:
        return StoreError(f"store {self.path} is closed; open it again to read it")


def _hard_linked(path: Path, file: h5py.File, name: str) -> Any:
    """Return an object of this file; links to others are refused."""
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


def _checked_dataset(path: Path, file: h5py.File, name: str, header: StoreHeader) -> h5py.Dataset:
    """Return a dataset that has the schema's layout, in this file.

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
    filters = layout.keys() & {"fletcher32", "shuffle", "compression"}
    if dataset.id.get_create_plist().get_nfilters() != len(filters):
        raise StoreError(
            f"store {path}: {name} is packed by a filter that skyline does not use; {REBUILD}"
        )
    return dataset


def open_store(path: str | os.PathLike[str]) -> Store:
    """Open a store to read its rows.

    Raises
    ------
    MissingFileError
        The file does not exist, or its build has not finished.
    StoreError
        The file is not a store, is truncated or damaged, has another schema, or cannot be read.
    """
    return Store(Path(path).resolve())


def is_store(path: str | os.PathLike[str]) -> bool:
    """Return whether a path names a store, even an unfinished one."""
    path = Path(path)
    if path.name and parts_folder(path).is_dir():  # The current folder has no name.
        return True
    try:
        with path.open("rb", buffering=0) as raw, h5py.File(raw, "r") as file:
            return "schema" in file.attrs
    except UNREADABLE:
        return path.suffix in STORE_SUFFIXES and path.is_file()


def parts_folder(path: Path) -> Path:
    """Return the folder of a store's parts; each build has a subfolder.

    The name of a part begins with the kind of its rows.
    """
    return path.with_name(f"{path.name}.parts")


def open_hdf5(path: Path) -> io.FileIO:
    """Open an HDF5 file to read it; raises `MissingFileError` or `StoreError`."""
    try:
        raw = io.FileIO(path)
    except FileNotFoundError as error:
        raise MissingFileError(_absence(path)) from error
    except IsADirectoryError as error:
        raise StoreError(f"{path} is a folder; name the file of a store") from error
    except OSError as error:
        raise StoreError(
            f"store {path} cannot be read: {error.strerror}; name a file that you may read"
        ) from error
    signature = b"\x89HDF\r\n\x1a\n"
    if raw.read(len(signature)) != signature:
        raw.close()
        raise StoreError(f"{path} is not an HDF5 file; name a store that skyline built")
    return raw


def _absence(path: Path) -> str:
    """Return why there is no store at a path, in one line."""
    folder = parts_folder(path)
    if not folder.is_dir():
        return f"store {path} does not exist; check the name, or build it"
    parts = list(folder.glob("*/*-of-*.h5"))
    there = "no part of it is there yet"
    command = MADE_BY[PLACES]
    if parts:
        command = MADE_BY.get(parts[0].name.partition("-")[0], command)
        there = "a part is there" if len(parts) == 1 else f"{len(parts)} parts are there"
    return (
        f"store {path} cannot be read: its build is not finished ({there}); give the same "
        f"{command} command again, which continues from there"
    )
