"""Rows of a store as an `xarray.Dataset` or a table.

Skylines are rendered by grid azimuth, and the angle from true north to grid north differs from
place to place. So the grid azimuths of places are a dimension, which all places share, and the
azimuths from true north are a coordinate of two dimensions.
"""

from typing import Any

import numpy as np

from skyline.arrays import Float64Array, IntArray
from skyline.errors import library
from skyline.files.cf import DEGREES, GRID_NORTH, LAT, LON, METRES, TRUE_NORTH
from skyline.geodesy.map_frame import Frame
from skyline.skylines import Views, bin_azimuths_rad, columns_u
from skyline.store.places import BINS, DISTANCE_BINS, Places

_ELEVATION = {"long_name": "elevation angle of the skyline", **DEGREES}


def dataset_of_places(places: Places, rows: IntArray, frame: Frame) -> Any:
    """Return places as a dataset; see `Store.to_xarray`."""
    angle = "grid_azimuth_deg"
    # Rounded to exact halves of a degree, so that they can be looked up.
    grid_deg = np.degrees(bin_azimuths_rad(BINS)).round(9)
    coords = _coordinates("place", places, rows, frame)
    coords[angle] = angle, grid_deg, GRID_NORTH
    coords["azimuth_deg"] = ("place", angle), _from_true_north(coords, grid_deg), TRUE_NORTH
    distance_m = np.repeat(places.distance_m(), BINS // DISTANCE_BINS, axis=1)
    nearest = f"horizontal distance of the skyline, its nearest in {360 // DISTANCE_BINS} degrees"
    dims = ("place", angle)
    elevation_deg = np.degrees(np.arctan(places.elevation_tan()))
    held = {
        "elevation_deg": (dims, elevation_deg, _ELEVATION),
        "distance_m": (dims, distance_m, {"long_name": nearest, **METRES}),
    }
    return library("xarray", "a Dataset").Dataset(held, coords)


def table_of_places(places: Places, rows: IntArray, frame: Frame) -> Any:
    """Return places as a table of points; see `Store.to_geodataframe`."""
    geopandas = library("geopandas", "a GeoDataFrame")
    lon, lat = frame.to_lonlat(places.easting_m, places.northing_m)
    columns = {
        "place": rows,
        "lon": lon,
        "lat": lat,
        "eye_elevation_m": places.eye_elevation_m,
        "tolerance_m": places.tolerance_m,
        "spacing_m": 2.0 * places.tolerance_m,
    }
    points = geopandas.points_from_xy(places.easting_m, places.northing_m)
    return geopandas.GeoDataFrame(columns, geometry=points, crs=frame.crs)


def dataset_of_views(views: Views, rows: IntArray, frame: Frame) -> Any:
    """Return views as a dataset; see `Store.to_xarray`."""
    columns = ("view", "column")
    grid_deg = views.grid_azimuth_deg()
    coords = _coordinates("view", views, rows, frame)
    coords["grid_azimuth_deg"] = columns, grid_deg, GRID_NORTH
    coords["azimuth_deg"] = columns, _from_true_north(coords, grid_deg), TRUE_NORTH
    distance_m = views.depth_m * np.hypot(1.0, columns_u(views.width)).astype(np.float32)
    distance = {"long_name": "horizontal distance of the skyline", **METRES}
    held = {
        "elevation_deg": (columns, views.elevation_deg().astype(np.float32), _ELEVATION),
        "distance_m": (columns, distance_m, distance),
        "flags": (columns, views.flags, {"long_name": "bits of skyline.skylines"}),
    }
    return library("xarray", "a Dataset").Dataset(held, coords)


def _coordinates(dim: str, eyes: Places | Views, rows: IntArray, frame: Frame) -> dict[str, Any]:
    """Return the coordinates of eyes: their rows, positions, convergence and frame."""
    position = {"easting_m": eyes.easting_m, "northing_m": eyes.northing_m}
    lon, lat = frame.to_lonlat(**position)
    turn = {"long_name": "grid convergence: true azimuth minus grid azimuth", **DEGREES}
    return {
        dim: (dim, rows, {"long_name": "row of the store"}),
        "lon": (dim, lon, LON),
        "lat": (dim, lat, LAT),
        **{name: (dim, values, METRES) for name, values in position.items()},
        "eye_elevation_m": (dim, eyes.eye_elevation_m, METRES),
        "convergence_deg": (dim, frame.convergence_deg(**position), turn),
        "spatial_ref": ((), 0, {"long_name": "frame of the eastings", **frame.crs.to_cf()}),
    }


def _from_true_north(coords: dict[str, Any], grid_deg: Float64Array) -> Float64Array:
    convergence_deg: Float64Array = coords["convergence_deg"][1]
    return (grid_deg + convergence_deg[:, np.newaxis]) % 360.0
