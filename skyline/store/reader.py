"""A store as it is read: its header, and what its committed rows stand for."""

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from skyline.camera import HEADINGS
from skyline.errors import InputError, SkylineError
from skyline.features import NO_KEYPOINT
from skyline.geodesy import Frame
from skyline.shown import facts_html
from skyline.store.committed import CommittedRows, patiently
from skyline.store.dataset import dataset_of_places, dataset_of_views, table_of_places
from skyline.store.explain import UNREADABLE
from skyline.store.header import (
    EYE,
    KEYPOINTS,
    PLACE_SPECS,
    PLACES,
    RENDERINGS,
    VIEW_SPECS,
    KeypointColumns,
    check_holds,
)
from skyline.store.place_map import PlaceMap
from skyline.store.rows import Columns, views_of
from skyline.store.superblock import WholeFile
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

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


class Store(CommittedRows):
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
    """

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self.committed

    def __repr__(self) -> str:
        return f"Store({self.path.name}: {self.committed} {self.header.holds})"

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
        heading = self._read(VIEW_SPECS["heading"][0], self._rows(slice(None)))
        self._check_headings(heading)
        return Locations(eyes.easting_m, eyes.northing_m, eyes.eye_elevation_m, heading)

    def eyes(self) -> Viewpoints:
        """Read where the eye of every row is, whatever the store holds; raises as `stored`."""
        specs = PLACE_SPECS if self.header.holds == PLACES else VIEW_SPECS
        rows = self._rows(slice(None))
        read = (self._read(specs[name][0], rows).astype(np.float64, copy=False) for name in EYE)
        return Viewpoints(*read)

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
    with ExitStack() as resources:
        raw = resources.enter_context(WholeFile(path))
        store = patiently(raw, lambda: Store(path, raw))
        resources.pop_all()
    return store


def is_store(path: str | os.PathLike[str]) -> bool:
    """Whether a file is an HDF5 file with a store's schema, however damaged the rest."""
    path = Path(path)
    try:
        with WholeFile(path) as raw, h5py.File(raw, "r") as file:
            return "schema" in file.attrs
    except (SkylineError, *UNREADABLE):
        return path.suffix == ".h5" and path.is_file()
