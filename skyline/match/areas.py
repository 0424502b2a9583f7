"""The areas that a matcher searches, each of one DEM."""

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from skyline.errors import InputError, SkylineError, StoreError
from skyline.files.disk import is_file
from skyline.files.gdal_names import on_disk
from skyline.geodesy.map_frame import Frame
from skyline.store.layout import StoreHeader
from skyline.store.read import Store
from skyline.terrain.heightfield import HeightField

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class MatchedArea:
    """Stores of one DEM that a matcher searches.

    Attributes
    ----------
    header : StoreHeader
        The joint header of the stores.
    frame : Frame
        The frame of the places.
    terrain : HeightField or None
        The DEM; None if it cannot be read.
    rows : int
        Number of places, or of renderings.
    """

    header: StoreHeader
    frame: Frame
    terrain: HeightField | None
    rows: int


def paths_of(store: str | Path | Sequence[str | Path]) -> Sequence[str | Path]:
    """Return the paths of one store or several.

    Raises `InputError` for anything else.
    """
    if isinstance(store, str | Path):
        return [store]
    paths = list(store) if isinstance(store, Iterable) else [store]
    if not paths or not all(isinstance(one, str | Path) for one in paths):
        raise InputError(f"store is {store!r}; expected the path of a store, or several paths")
    return paths


def frame_of(store: Store) -> Frame:
    """Return the frame of a store.

    Raises `StoreError` if angles are wrong on its map: earlier releases built such stores.
    """
    frame = Frame(store.header.frame_wkt)
    if frame.is_local:
        return frame
    eyes = store.eyes()
    east_m, north_m = eyes.easting_m, eyes.northing_m
    box_m = float(east_m.min()), float(north_m.min()), float(east_m.max()), float(north_m.max())
    if wrong := frame.untrue_in_words(box_m):
        raise StoreError(
            f"store {store.path} was built by skyline {store.header.package_version}, and {wrong}; "
            "build it again, and its DEM is warped first"
        )
    return frame


def terrain_at_hand(header: StoreHeader, otherwise: str) -> HeightField | None:
    """Return a store's terrain, read from its DEM files.

    If they cannot be read, a warning names the consequence ``otherwise``, and None is returned.
    Only plain files are read: a store from a stranger must not make the reader open anything else.
    """
    if not header.dem_files:
        why = "the store was built from heights that came from no file; give the DEM (--dem)"
    elif not all(is_file(on_disk(file)) for file in header.dem_files):
        files = ", ".join(header.dem_files)
        why = f"the store's DEM is not at hand (no file here is {files}); name its files with --dem"
    else:
        try:
            return header.read_dem()
        except SkylineError as error:
            why = f"the store's DEM cannot be used: {error}"
    _log.warning("%s: %s", otherwise, why)
    return None
