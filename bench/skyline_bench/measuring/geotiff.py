"""Elevation models written as files."""

from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine


def write_geotiff(
    path: Path, heights: NDArray[np.generic], crs: str, west_north: tuple[float, float],
    step: tuple[float, float],
) -> Path:  # fmt: skip
    """Write heights (rows, cols), row 0 north, as a GeoTIFF; return its path.

    ``west_north`` is the outer corner of the first cell, ``step`` a cell's size east and south.
    """
    shape = {"width": heights.shape[1], "height": heights.shape[0], "count": 1}
    transform = Affine(step[0], 0.0, west_north[0], 0.0, -step[1], west_north[1])
    with rasterio.open(
        path, "w", driver="GTiff", crs=crs, transform=transform, dtype=heights.dtype, **shape
    ) as raster:
        raster.write(heights, 1)
    return path
