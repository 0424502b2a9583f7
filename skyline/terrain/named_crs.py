"""The CRS that a user names, checked against the one that elevation files name."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.transform import Affine

from skyline.errors import InputError
from skyline.geodesy.bounds import degrees_in_words, distance_in_words
from skyline.geodesy.crs import WGS84, off_area_deg, parse_crs, to_wgs84, without_vertical
from skyline.terrain.field_files import SUFFIX
from skyline.terrain.metric_dem import FAR_DEG, FINEST_M
from skyline.terrain.raster_files import opened_raster

SAME_PLACE_M = 10.0
"""Two systems whose datums are modern, such as ETRS89 and WGS 84, place a raster less than this
apart. Datums of older surveys lie 100 m aside."""


def check_named_crs(names: Sequence[str], crs: str) -> None:
    """Raise `InputError` if a CRS places rasters elsewhere than their own does.

    The first raster that names a CRS speaks for all. A CRS in which its coordinates are no place,
    such as degrees of a raster in metres, is meant for other files. ``names`` are those of
    `skyline.terrain.dem_files.dem_names`.
    """
    other = without_vertical(parse_crs(crs))
    for name in names:
        if Path(name).suffix == SUFFIX:
            continue
        with opened_raster(name, header_only=True) as dataset:
            wkt = None if dataset.crs is None else dataset.crs.to_wkt()
            transform = dataset.transform
            size = dataset.width, dataset.height
        if wkt is not None:
            # What is wrong with the raster's own CRS is said when its heights are read.
            with suppress(CRSError):
                _check(name, without_vertical(CRS.from_wkt(wkt)), other, crs, transform, size)
            return


def _check(
    name: str, own: CRS, other: CRS, given: str, transform: Affine, size: tuple[int, int]
) -> None:
    own_place = _middle(own, transform, size)
    other_place = _middle(other, transform, size)
    if own_place is None or other_place is None:
        return
    geod = WGS84.get_geod()
    assert geod is not None
    away_m = geod.inv(*own_place, *other_place)[2]
    if away_m > SAME_PLACE_M:
        lon, lat = own_place
        raise InputError(
            f"{name} is in {own.name}, with its middle at {degrees_in_words(lat, 'NS', 2)}, "
            f"{degrees_in_words(lon, 'EW', 2)}, and --crs {given} would put it "
            f"{distance_in_words(away_m)} away; leave --crs (also $SKYLINE_CRS) out, or "
            f"correct the file if it is wrong (gdal_edit.py -a_srs {given})"
        )


def _middle(crs: CRS, transform: Affine, size: tuple[int, int]) -> tuple[float, float] | None:
    """Return a raster's middle in degrees; None if it cannot lie there."""
    x, y = (
        np.array([start, start + 0.5 * count * step, start + count * step])
        for start, step, count in zip(
            (transform.c, transform.f), (transform.a, transform.e), size, strict=True
        )
    )
    if not crs.is_projected and (np.abs(y).max() > 90.01 or np.abs(x).max() > 540.0):
        return None
    step_m = abs(transform.a) * crs.axis_info[0].unit_conversion_factor
    if crs.is_projected and step_m < FINEST_M:
        return None
    try:
        lon, lat, _ = to_wgs84(crs, float(x[1]), float(y[1]))
    except InputError:
        return None
    if not (abs(lat) <= 90.0 and abs(lon) <= 540.0):
        return None
    if crs.is_projected and off_area_deg(crs, lon, lat) > FAR_DEG:
        return None
    return lon, lat
