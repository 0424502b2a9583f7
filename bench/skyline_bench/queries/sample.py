"""A real elevation model that is always at hand."""

from pathlib import Path

import numpy as np
from matplotlib.cbook import get_sample_data

from skyline_bench.measuring.geotiff import write_geotiff


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
