"""Locating photos without a store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skyline.cache import Area, prepare_area
from skyline.errors import InputError
from skyline.geodesy.bounds import Bounds, Circle
from skyline.geodesy.map_frame import Frame
from skyline.match.matcher import Matcher
from skyline.match.narrowing import NOTED_KM, Narrowing
from skyline.match.result import MatchResult
from skyline.photo.image import Picture, name_of
from skyline.photo.photo import read_noted_place
from skyline.terrain.dem import Dem

_NEEDED_KM = 5.0
"""Radius round a photo's own position that a cached store must cover. Photos taken within some
kilometres thus share a store."""

_TOGETHER_KM = 50.0
"""Greatest extent of the positions of photos that are located together."""


def locate(
    photo: Picture,
    near: Circle | Bounds | None = None,
    dem: Dem | None = None,
    *,
    source: str | None = None,
    fov_deg: float | None = None,
) -> MatchResult:
    """Find where a photo was taken, without a store at hand.

    The elevation of the area is fetched and its store is built, into the cache that ``skyline
    cache`` lists; another photo of the area takes both from there. For many photos, make one
    `Matcher` instead.

    Parameters
    ----------
    photo : path, PIL image or (H, W, 3) uint8
        A photo, a sky mask or a trace.
    near : tuple, optional
        Longitude, latitude and a radius in km, or W, S, E, N in degrees; by default 10 km round the
        position in the photo's EXIF.
    dem : path, paths, DataArray or HeightField, optional
        An elevation model, as for `read_dem`; by default tiles are fetched.
    source : str, optional
        Source of tiles, a name or address as for ``skyline dem fetch``; by default
        ``$SKYLINE_DEM_SOURCE``, else Copernicus.
    fov_deg : float, optional
        Horizontal field of view; by default the photo's own.

    Returns
    -------
    MatchResult
        The result of `Matcher.match`: candidates, best first, and an answer or a refusal.

    Raises
    ------
    InputError
        There is no position, the DEM does not cover it, there is only sea, or the cache cannot be
        written.
    FetchError
        The server of tiles fails.
    """
    if near is not None and (not isinstance(near, Sequence) or len(near) not in {3, 4}):
        raise InputError(f"near is {near!r}; expected longitude, latitude and km, or W, S, E, N")
    is_box = near is not None and len(near) == 4
    narrowing = Narrowing(bounds_deg=near) if is_box else Narrowing(near)  # type: ignore[arg-type]
    area, narrowing = area_of([photo], narrowing)
    ready = prepare_area(area, () if dem is None else dem, source)
    with Matcher(ready.store, ready.terrain) as matcher:
        return matcher.match(photo, fov_deg, narrowing=narrowing)


def area_of(photos: Sequence[Picture], narrowing: Narrowing) -> tuple[Area, Narrowing]:
    """Return the area in which photos are searched, and its narrowing.

    Raises `InputError` if neither the narrowing nor a photo has a position, or if the photos were
    taken far apart.
    """
    if narrowing.near is not None:
        lon, lat, km = narrowing.near
        return Area.around([(lon, lat)], km, km), narrowing
    if narrowing.bounds_deg is not None:
        return Area(narrowing.bounds_deg, narrowing.bounds_deg), narrowing
    noted = [read_noted_place(photo) for photo in photos]
    positions = [one.lonlat_deg for one in noted if one.lonlat_deg is not None]
    if not positions:
        why = next((f" ({one.left_aside})" for one in noted if one.left_aside), "")
        which = name_of(photos[0]) if len(photos) == 1 else f"none of {len(photos)} photos"
        notes = "notes no position" if len(photos) == 1 else "notes a position"
        raise InputError(
            f"{which} {notes}{why}; say where to search: --near LON,LAT,KM, e.g. 9.84,46.80,10, "
            "or --bounds W,S,E,N"
        )
    lon, lat = positions[0]
    east, north = Frame.local(lon=lon, lat=lat).from_lonlat(*np.transpose(positions))
    if not np.hypot(np.ptp(east), np.ptp(north)) <= 1000.0 * _TOGETHER_KM:
        raise InputError(
            f"the photos were taken more than {_TOGETHER_KM:g} km apart, by their EXIF; locate "
            "the photos of one area at a time, or give --near LON,LAT,KM"
        )
    area = Area.around(positions, NOTED_KM, _NEEDED_KM)
    if len(positions) == 1:
        return area, replace(narrowing, near=(*positions[0], NOTED_KM))
    return area, replace(narrowing, bounds_deg=area.built)
