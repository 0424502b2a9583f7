"""A real elevation model that is always at hand."""

from pathlib import Path

import numpy as np
import rasterio
from matplotlib.cbook import get_sample_data
from rasterio.transform import from_bounds


def write_sample_dem(path: Path) -> Path:
    """Write matplotlib's sample DEM (Jacksboro fault, Tennessee; SRTM) as a GeoTIFF."""
    name = str(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))
    with np.load(name) as sample:
        heights = sample["elevation"]
        # The sample's ymin is its northern edge.
        west, east = float(sample["xmin"]), float(sample["xmax"])
        north, south = float(sample["ymin"]), float(sample["ymax"])
    rows, cols = heights.shape
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=cols,
        height=rows,
        count=1,
        dtype=heights.dtype,
        crs="EPSG:4326",
        transform=from_bounds(west, south, east, north, cols, rows),
    ) as raster:
        raster.write(heights, 1)
    return path
