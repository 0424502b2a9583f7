"""Elevation tiles of a degree, as a server has them, and how they are fetched in tests."""

from dataclasses import replace
from functools import partial

import numpy as np
import rasterio
from rasterio.enums import ColorInterp
from rasterio.transform import from_origin
from scenes import fractal, geotiff_of

from skyline.fetch.dem_tiles import fetch_dem
from skyline.fetch.remote import Patience

SAMPLES = 600
"""Samples of a tile along each side."""
BOUNDS = (9.8, 46.6, 10.1, 46.8)
QUICK = Patience(retries=2, timeout_s=1, first_delay_s=0.01)
ONCE_MORE = replace(QUICK, retries=1)
NAMES = "/{ns}{lat:02d}{ew}{lon:03d}.tif"
EAST = "/N46E010.tif"
IN_THE_EAST = (10.05, 46.6, 10.1, 46.8)
VRT = b"<VRTDataset rasterXSize='5' rasterYSize='5'></VRTDataset>"


def two_degrees():
    """Return heights of two degrees side by side, 46 N, from 9 E."""
    return fractal(SAMPLES, 2 * SAMPLES, 900.0, seed=3)


def two_tiles(heights):
    """Return the files of two degrees side by side by their paths on a server."""
    west, east = geotiff(heights[:, :SAMPLES]), geotiff(heights[:, SAMPLES:], west=10.0)
    return {"/N46E009.tif": west, EAST: east}


def geotiff(heights, west=9.0, north=47.0, crs="EPSG:4326"):
    """Return a tiled GeoTIFF whose first sample stands, as Copernicus', on the corner."""
    step = 1.0 / SAMPLES
    transform = from_origin(west - step / 2, north + step / 2, step, step)
    options = {"compress": "deflate", "tiled": True, "blockxsize": 128, "blockysize": 128}
    return geotiff_of(heights, crs, {"AREA_OR_POINT": "Point"}, transform=transform, **options)


def masked_tile(kind, heights, path):
    """Return the files of a server whose tile from 10 E marks its voids, by a mask or alpha."""
    ground = heights > 0.0
    bands = heights if kind == "mask" else np.dstack([heights, ground]).astype(np.float32)
    path.write_bytes(geotiff(bands, west=10.0))
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as tile:
        if kind == "mask":
            tile.write_mask(ground)
        else:
            tile.colorinterp = ColorInterp.gray, ColorInterp.alpha
    return partial(_files, {EAST: path.read_bytes()})


def _files(files, address):
    """Return files, whatever the address of their server."""
    return files


def fetch(template, folder, bounds=BOUNDS, patience=QUICK, **options):
    return fetch_dem(bounds, template, folder, patience=patience, **options)
