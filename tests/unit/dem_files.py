"""Elevation files for tests."""

import numpy as np
import rasterio
from rasterio.transform import from_origin
from scenes import write_dem

UTM = "EPSG:32632"
CALIFORNIA = [f"N{lat}W{lon}" for lat in (37, 36) for lon in (120, 119)]


def write(path, heights, transform=None, crs=UTM, **profile):
    """Write heights (rows, cols) or (bands, rows, cols) as a GeoTIFF; return its path."""
    transform = from_origin(500_000.0, 5_200_000.0, 30.0, 30.0) if transform is None else transform
    tags = profile.pop("tags", {})
    bands_last = np.moveaxis(heights, 0, -1) if heights.ndim == 3 else heights
    write_dem(path, bands_last, crs, transform=transform, **profile)
    if tags:
        with rasterio.open(path, "r+") as dataset:
            dataset.update_tags(**tags)
    return path


def plane(x, y):
    """A height that names its place: every flip and every shift changes it."""
    return 1000.0 + 0.25 * x - 0.5 * y


def plane_grid(rows, cols, transform):
    """Heights of the plane at pixel centres, relative to the grid's first corner."""
    row, col = np.mgrid[0:rows, 0:cols] + 0.5
    x = transform.a * col + transform.b * row
    y = transform.d * col + transform.e * row
    return plane(x, y).astype(np.float32)
