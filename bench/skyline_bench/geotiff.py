"""Elevation models written as GeoTIFF files.

One of them is real and always at hand.
"""

from pathlib import Path

import numpy as np
import rasterio
from matplotlib.cbook import get_sample_data
from numpy.typing import NDArray
from rasterio.transform import Affine


def write_geotiff(
    path: Path,
    heights: NDArray[np.generic],
    crs: str,
    west_north: tuple[float, float],
    step: tuple[float, float],
) -> Path:
    """Write heights (rows, cols) as a GeoTIFF, and return its path.

    Row 0 is the northernmost. ``west_north`` is the outer corner of the first cell, ``step`` a
    cell's size east and south.
    """
    shape = {"width": heights.shape[1], "height": heights.shape[0], "count": 1}
    transform = Affine(step[0], 0.0, west_north[0], 0.0, -step[1], west_north[1])
    with rasterio.open(
        path, "w", driver="GTiff", crs=crs, transform=transform, dtype=heights.dtype, **shape
    ) as raster:
        raster.write(heights, 1)
    return path


def write_sample_dem(path: Path) -> Path:
    """Write matplotlib's sample DEM (Jacksboro fault, Tennessee; SRTM) as a GeoTIFF."""
    name = str(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))
    with np.load(name) as sample:
        heights = sample["elevation"]
        # The sample's ymin is its northern edge.
        west, east, south, north = (float(sample[key]) for key in ("xmin", "xmax", "ymax", "ymin"))
    rows, cols = heights.shape
    step = (east - west) / cols, (north - south) / rows
    return write_geotiff(path, heights, "EPSG:4326", (west, north), step)
