"""A store as it is read: its header, and what its committed rows stand for."""

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from skyline.camera import HEADINGS
from skyline.errors import InputError, SkylineError, StoreError
from skyline.features import NO_KEYPOINT
from skyline.geodesy import Frame
from skyline.shown import facts_html
from skyline.store.checks import checked_dataset, read_built, read_committed, read_header
from skyline.store.dataset import dataset_of_places, dataset_of_views, table_of_places
from skyline.store.header import (
    EYE,
    KEYPOINTS,
    PLACES,
    RENDERINGS,
    KeypointColumns,
    check_holds,
)
from skyline.store.lock import REBUILD, UNREADABLE, explained, shards_folder
from skyline.store.place_map import Offsets, PlaceMap
from skyline.store.rows import Columns, row_checksums, stored_places, views_of
from skyline.store.superblock import WholeFile
from skyline.terrain.viewpoints import Viewpoints
from skyline.text import printable
from skyline.views import Views

_T = TypeVar("_T")

_READ_AGAIN = 5
_READ_AGAIN_PAUSE_S = 0.02

RowIndex = int | slice | NDArray[np.integer] | NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Locations(Viewpoints):
    """Where the eyes of N views are, in the store's frame, and which way they look.

    Attributes
    ----------
    heading : (N,) uint8
        0, 1, 2, 3 = grid north, east, south, west.
    """

    heading: NDArray[np.uint8]


class Store:
    """The committed rows of a store; use it as a context manager. Made by `open_store`.

    Rows committed after it was opened are not seen: the rows of one `Store` never change.

    Attributes
    ----------
    path : Path
        Where the store is.
    header : StoreHeader
        What the store was built from and how.
    committed : int
        Number of complete rows when the store was opened.
    built : Built
        How much of its build the store held then, at least.
    """

    def __init__(self, path: Path, raw: WholeFile) -> None:
        """Check and open the store in an open file; raises `StoreError`."""
        self.path = path
        self._raw = raw
        with explained(path, "it cannot be opened"), ExitStack() as resources:
            self._file = resources.enter_context(h5py.File(raw, "r"))
            self.header = read_header(path, self._file)
            # Counted before the datasets are opened: a writer at work may lengthen them.
            self.built = read_built(path, self._file)
            self.committed = read_committed(path, self._file)
            self._datasets = self._open_datasets()
            self._check_committed()
            resources.pop_all()

    @property
    def longest(self) -> int:
        """Rows of the longest dataset: more than are committed while a writer is at work."""
        return max(len(dataset) for dataset in self._datasets.values())

    @property
    def in_use(self) -> bool:
        """Whether a writer had the store open when it was opened, or was killed at work."""
        return self._raw.superblock.in_use

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file; closing twice is fine."""
        self._file.close()
        self._raw.close()

    def __len__(self) -> int:
        return self.committed

    def __repr__(self) -> str:
        note = f"; {self.built.note}" if self.built.note else ""
        name = printable(self.path.name)
        return f"Store({name}: {self.committed} {self.header.holds}{note})"

    def _repr_html_(self) -> str:
        header = self.header
        settings = header.config.items()
        facts = {
            "store": str(self.path),
            header.holds: f"{self.committed:,}",
            "frame": Frame(header.frame_wkt).name,
            "DEM": ", ".join(header.dem_files) or "no file",
            **{name: str(value) for name, value in settings if not isinstance(value, Mapping)},
            "made by": f"skyline {header.package_version}",
            **({"build": self.built.note} if self.built.note else {}),
        }
        return facts_html(facts)

    def views(self, index: RowIndex = slice(None)) -> Views:
        """Read views.

        Parameters
        ----------
        index : int, slice, integer or boolean array
            Rows in the order wanted, as NumPy indexes; an int gives one view.

        Raises
        ------
        InputError
            A row that is not committed, or a store of places.
        StoreError
            Damaged data.
        """
        check_holds(self.path, self.header, RENDERINGS)
        views = views_of(self.header, self.stored(index))
        self._check_headings(views.heading)
        return views

    def stored(self, index: RowIndex = slice(None)) -> Columns:
        """Read rows of every dataset as they are stored, by the datasets' names; as `views`."""
        rows = self._rows(index)
        return {name: self._read(name, rows) for name in self.header.specs}

    def iter_views(self, chunk_rows: int = 1024) -> Iterator[Views]:
        """Yield all views in order, ``chunk_rows`` at a time (the last time fewer)."""
        if chunk_rows < 1:
            raise InputError(f"chunk_rows is {chunk_rows}; expected at least 1")
        for start in range(0, self.committed, chunk_rows):
            yield self.views(slice(start, start + chunk_rows))

    def keypoint_columns(self, index: RowIndex = slice(None)) -> KeypointColumns:
        """Read keypoints, (N, K) uint16, padded with `NO_KEYPOINT`; as `views` otherwise."""
        check_holds(self.path, self.header, RENDERINGS)
        columns = self._read(KEYPOINTS, self._rows(index))
        if ((columns >= self.header.width) & (columns != NO_KEYPOINT)).any():
            raise self._damaged(f"{KEYPOINTS} names columns beyond {self.header.width - 1}")
        return columns

    def locations(self) -> Locations:
        """Read where all views are and look, without their skylines; raises as `views`."""
        check_holds(self.path, self.header, RENDERINGS)
        eyes = self.eyes()
        heading = self._read(self.header.fields["heading"], self._rows(slice(None)))
        self._check_headings(heading)
        return Locations(
            easting_m=eyes.easting_m,
            northing_m=eyes.northing_m,
            eye_elevation_m=eyes.eye_elevation_m,
            heading=heading,
        )

    def eyes(self) -> Viewpoints:
        """Read where the eye of every row is, whatever the store holds; raises as `stored`."""
        rows, names = self._rows(slice(None)), self.header.fields
        read = {field: self._read(names[field], rows) for field in EYE}
        return Viewpoints(**{field: read[field].astype(np.float64, copy=False) for field in EYE})

    def places(self) -> PlaceMap:
        """Map the places of a store of places; they can be read when the store is closed.

        Raises
        ------
        InputError
            A store of renderings.
        StoreError
            Damaged data.
        """
        check_holds(self.path, self.header, PLACES)
        return self._map_places()

    def to_xarray(self, index: RowIndex = slice(None)) -> Any:
        """Return rows as an `xarray.Dataset` (extra ``geo``), in memory.

        Parameters
        ----------
        index : int, slice, integer or boolean array
            Rows in the order wanted, as of `views`.

        Returns
        -------
        xarray.Dataset
            ``elevation_deg`` and ``distance_m`` (horizontal), of a store of places by ``place``
            and ``grid_azimuth_deg``, of one of renderings by ``view`` and ``column``, with their
            ``flags``. The coordinate ``azimuth_deg``, of two dimensions, is from true north;
            ``grid_azimuth_deg`` is from grid north and ``convergence_deg`` what a row's true
            azimuths are more than its grid azimuths. Also ``lon``, ``lat``, ``easting_m``,
            ``northing_m``, ``eye_elevation_m`` of the eyes, and ``spatial_ref`` (CF), the frame.

        Raises
        ------
        InputError
            A row that is not committed, or xarray is not installed.
        StoreError
            Damaged data.
        """
        rows, frame = self._rows(index), Frame(self.header.frame_wkt)
        if self.header.holds == PLACES:
            return dataset_of_places(self.places().take(rows), rows, frame)
        return dataset_of_views(self.views(index), rows, frame)

    def to_geodataframe(self, index: RowIndex = slice(None)) -> Any:
        """Return places as points (extra ``geo``), in memory.

        Parameters
        ----------
        index : int, slice, integer or boolean array
            Rows in the order wanted, as of `views`.

        Returns
        -------
        geopandas.GeoDataFrame
            Points in the store's frame, with ``place`` (the row), ``lon``, ``lat``,
            ``eye_elevation_m``, ``tolerance_m`` (how far from the eye, east and north, the place
            stands for) and ``spacing_m``, twice as much.

        Raises
        ------
        InputError
            A store of renderings, a row that is not committed, or GeoPandas is not installed.
        StoreError
            Damaged data.
        """
        rows, frame = self._rows(index), Frame(self.header.frame_wkt)
        return table_of_places(self.places().take(rows), rows, frame)

    def _rows(self, index: RowIndex) -> NDArray[np.intp]:
        try:
            return np.atleast_1d(np.arange(self.committed)[index])
        except IndexError as error:
            raise InputError(
                f"{error}: store {self.path} has {self.committed} committed rows"
            ) from error

    def _check_headings(self, heading: NDArray[np.uint8]) -> None:
        if (heading > HEADINGS[-1]).any():
            raise self._damaged(f"it has heading {heading.max()}, beyond {HEADINGS[-1]}")

    def _read(self, name: str, rows: NDArray[np.intp]) -> NDArray[Any]:
        """Return rows of a dataset in the order wanted; raises `StoreError`."""
        try:
            return self._reading(lambda: self._read_once(name, rows))
        except StoreError:
            if not (self.header.holds == PLACES and self.in_use):
                raise
        # Places are appended to a last chunk where it lies. A kill that tears this leaves HDF5's
        # checksum of the chunk wrong, but committed rows as they were, which their own show.
        columns = stored_places(self.header, self._map_places().take(rows))
        return columns[name] if name in columns else row_checksums(columns)

    def _map_places(self) -> PlaceMap:
        """Map the rows of a store of places; raises `StoreError`."""
        offsets = self._reading(self._chunk_offsets)
        with explained(self.path, "it cannot be mapped"):
            return PlaceMap(self.path, self._raw.fileno(), self.header, self.committed, offsets)

    def _damaged(self, what: str) -> StoreError:
        """Return the error that says in which way the store is damaged."""
        return StoreError(f"store {self.path} is damaged: {what}; {REBUILD}")

    def _reading(self, read: Callable[[], _T]) -> _T:
        """Return ``read()``, on a file opened anew where a writer has changed it meanwhile."""
        if self._raw.closed:
            raise StoreError(f"store {self.path} is closed; open it again to read it")
        try:
            return read()
        except StoreError:
            if not self._raw.refresh():
                raise

        def read_anew() -> _T:
            with explained(self.path, "it cannot be opened again"):
                self._file.close()
                self._file = h5py.File(self._raw, "r")
                self._datasets = self._open_datasets()
            return read()

        return _patiently(self._raw, read_anew)

    def _read_once(self, name: str, rows: NDArray[np.intp]) -> NDArray[Any]:
        with explained(self.path, f"{name} cannot be read"):
            dataset = self._datasets[name]
            if len(rows) == 0:
                return np.zeros((0, *dataset.shape[1:]), dataset.dtype)
            if (np.diff(rows) == 1).all():
                return np.asarray(dataset[rows[0] : rows[-1] + 1])
            # HDF5 wants rows ascending and once each.
            ascending, position = np.unique(rows, return_inverse=True)
            return np.asarray(dataset[ascending])[position]

    def _chunk_offsets(self) -> Offsets:
        """Return where the chunks of committed rows begin, of every dataset."""
        size = self.header.chunk_rows
        found = {}
        for name, dataset in self._datasets.items():
            with explained(self.path, f"the chunks of {name} cannot be read"):
                at = _offsets(dataset, -(-self.committed // size))
            # HDF5's own structures come first in a file.
            if not (at > 0).all():
                lost = int(np.flatnonzero(at <= 0)[0]) * size
                raise self._damaged(f"{name} holds no row {lost}, which is committed")
            found[name] = at
        return found

    def _open_datasets(self) -> dict[str, h5py.Dataset]:
        return {
            name: checked_dataset(self.path, self._file, name, spec, self.header)
            for name, spec in self.header.specs.items()
        }

    def _check_committed(self) -> None:
        # Not by what HDF5 says the datasets take: it visits every chunk that a damaged index names.
        rows = min(len(dataset) for dataset in self._datasets.values())
        if self.committed > min(rows, self._raw.size):
            raise self._damaged(f"it says {self.committed} rows are committed and holds {rows}")
        for name, dataset in self._datasets.items():
            place = (max(self.committed - 1, 0),) + (0,) * (dataset.ndim - 1)
            if self.committed and dataset.id.get_chunk_info_by_coord(place).byte_offset is None:
                raise self._damaged(f"{name} holds no row {place[0]}, which is committed")


def open_store(path: str | os.PathLike[str]) -> Store:
    """Open a store to read its committed rows, also while another process appends to it.

    Raises
    ------
    MissingFileError
        No such file.
    StoreError
        Not a store, truncated or damaged, of a newer schema, or not readable.
    """
    path = Path(path).resolve()
    raw = WholeFile(path)
    try:
        return _patiently(raw, lambda: Store(path, raw))
    except BaseException:
        raw.close()
        raise


def is_store(path: str | os.PathLike[str]) -> bool:
    """Whether a file is an HDF5 file with a store's schema, however damaged or unfinished."""
    path = Path(path)
    try:
        with WholeFile(path) as raw, h5py.File(raw, "r") as file:
            return "schema" in file.attrs
    except (SkylineError, *UNREADABLE):
        return path.suffix == ".h5" and (path.is_file() or shards_folder(path).is_dir())


def _patiently(raw: WholeFile, read: Callable[[], _T]) -> _T:
    """Return ``read()``, tried again where a writer at work may have changed what it read."""
    for _ in range(_READ_AGAIN):
        try:
            return read()
        except StoreError:
            if not raw.refresh():
                raise
            time.sleep(_READ_AGAIN_PAUSE_S)
    return read()


def _offsets(dataset: h5py.Dataset, count: int) -> NDArray[np.int64]:
    """Return where the first ``count`` chunks of rows begin, 0 for those that are not there."""
    rows, at = dataset.chunks[0], np.zeros(count, dtype=np.int64)

    def visit(info: Any) -> bool | None:
        chunk = info.chunk_offset[0] // rows
        if chunk >= count:
            return True  # and no further: an index may name chunks that were never committed
        at[chunk] = info.byte_offset or 0
        return None

    if count and hasattr(dataset.id, "chunk_iter"):
        dataset.id.chunk_iter(visit)
    else:
        for first in range(0, count * rows, rows):
            visit(dataset.id.get_chunk_info_by_coord((first,) + (0,) * (dataset.ndim - 1)))
    return at
