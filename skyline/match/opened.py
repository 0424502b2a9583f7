"""An open store and its terrain, as matchers want them."""

import logging
from collections.abc import Callable, Iterable
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array
from skyline.errors import InputError, SkylineError
from skyline.files import is_file
from skyline.match.match_config import MatchConfig
from skyline.match.profiles import Profiles
from skyline.match.rendered_scene import RenderedScene
from skyline.render.thread import RenderThread
from skyline.skylines import Views
from skyline.store import Store, StoreHeader
from skyline.store.format import PLACES
from skyline.store.places import PlaceSource
from skyline.store.stored_dem import check_dem, curvature_of, read_dem_of
from skyline.terrain.edge import DataEdge
from skyline.terrain.heightfield import Ground, HeightField, ground_of
from skyline.terrain.surface import Dem, read_surface
from skyline.terrain.viewpoints import Viewpoints

_log = logging.getLogger(__name__)


class OpenedSource:
    """An open store and its terrain; see `skyline.match.ranker.Source`."""

    def __init__(
        self,
        path: str | Path,
        store: Store,
        terrain: HeightField | None,
        config: MatchConfig,
        thread: RenderThread | None,
        surface: Dem | None = None,
    ) -> None:
        self._path, self._store, self._thread, self._surface = path, store, thread, surface
        self.terrain, self.config = terrain, config
        self.rendered: RenderedScene | None = None
        self._sought = False

    def places(self) -> PlaceSource:
        """Return the places of the store."""
        if not len(self._places):
            raise InputError(f"store {self._path} holds no places; build it first")
        return self._places

    def eyes(self) -> Callable[[], Viewpoints]:
        """Return what tells where the store's eyes stand, evenly chosen ones of very many.

        Places are read when it is called; the store may be closed by then.
        """
        if self._store.header.holds == PLACES:
            return partial(_spaced, self._places)
        there = self._store.eyes()
        eyes = np.stack([there.easting_m, there.northing_m, there.eye_elevation_m])
        found = _viewpoints(np.ascontiguousarray(np.unique(eyes, axis=1)))
        return lambda: found

    def profiles(self) -> Profiles:
        """Return the renderings of the store, joined."""
        return Profiles.from_views(_chunks(self._store))

    def ground(self) -> Ground | None:
        """Return the heights of the terrain."""
        terrain = self._found_terrain()
        return None if terrain is None else ground_of(terrain)

    def edge(self) -> DataEdge | None:
        """Return where the terrain's data end."""
        terrain = self._found_terrain()
        return None if terrain is None else DataEdge.of(terrain, curvature_of(self._store.header))

    def scene(self) -> RenderedScene | None:
        """Return the terrain to render."""
        terrain = self._found_terrain()
        if terrain is not None and self.config.refine:
            header, surface = self._store.header, self._surface
            over = None if surface is None else read_surface(surface, terrain)
            self.rendered = RenderedScene.of_store(terrain, header, self.config, self._thread, over)
        return self.rendered

    @cached_property
    def _places(self) -> PlaceSource:
        return self._store.places()

    def _found_terrain(self) -> HeightField | None:
        if self.terrain is None and not self._sought:
            self._sought = True
            self.terrain = terrain_at_hand(self._store.header, "answers unrefined")
        return self.terrain


def terrain_at_hand(header: StoreHeader, otherwise: str) -> HeightField | None:
    """Return the terrain a store was rendered from, read from where it lay then.

    Where it is not to be had there is a warning of what is left ``otherwise``. Only plain files
    are read: a store from a stranger must not make the reader go anywhere else.
    """
    if not header.dem_files:
        _log.warning(
            "%s: the store was built from heights that came from no file; give the DEM (--dem)",
            otherwise,
        )
        return None
    if not all(map(is_file, header.dem_files)):
        _log.warning(
            "%s: the store's DEM is not at hand (no file here is %s); say where it lies with --dem",
            otherwise,
            ", ".join(header.dem_files),
        )
        return None
    try:
        return read_dem_of(header)
    except SkylineError as error:
        _log.warning("%s: the store's DEM cannot be used: %s", otherwise, error)
        return None


def given_terrain(header: StoreHeader, dem: Dem | None) -> HeightField | None:
    """Return the terrain that was given, as the store's build read it."""
    if isinstance(dem, HeightField):
        check_dem(header, dem)
        return dem
    if dem is None:
        return None
    return read_dem_of(header, [dem] if isinstance(dem, str | Path) else dem)


_SHOWN_EYES = 20_000


def _spaced(places: PlaceSource) -> Viewpoints:
    """Return the eyes of every n-th place; no skyline is read."""
    step = max(1, len(places) // _SHOWN_EYES)
    some, first = [np.empty((3, 0))], 0
    for block in places.blocks():
        eyes = (block.easting_m, block.northing_m, block.eye_elevation_m)
        some.append(np.stack([column[-first % step :: step] for column in eyes]).astype(np.float64))
        first += len(block)
    return _viewpoints(np.concatenate(some, axis=1))


def _viewpoints(eyes: Float64Array) -> Viewpoints:
    easting_m, northing_m, eye_elevation_m = eyes
    return Viewpoints(easting_m=easting_m, northing_m=northing_m, eye_elevation_m=eye_elevation_m)


def _chunks(store: Store) -> Iterable[tuple[Views, NDArray[np.uint16]]]:
    start = 0
    for views in store.iter_views():
        rows = slice(start, start + len(views))
        yield views, store.keypoint_columns(rows)
        start = rows.stop
