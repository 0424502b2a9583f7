"""Elevation files for tests."""

from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine, from_origin

UTM = "EPSG:32632"
CALIFORNIA = [f"N{lat}W{lon}" for lat in (38, 37, 36) for lon in (120, 119)]

AnyArray = NDArray[Any]


def write(
    path: Path,
    heights: AnyArray,
    transform: Affine | None = None,
    crs: str | None = UTM,
    **profile: Any,
) -> Path:
    transform = from_origin(500_000.0, 5_200_000.0, 30.0, 30.0) if transform is None else transform
    bands = heights if heights.ndim == 3 else heights[np.newaxis]
    with rasterio.open(
        path,
        "w",
        driver=profile.pop("driver", "GTiff"),
        count=bands.shape[0],
        height=bands.shape[1],
        width=bands.shape[2],
        dtype=heights.dtype,
        crs=crs,
        transform=transform,
        **{key: value for key, value in profile.items() if key != "tags"},
    ) as dataset:
        dataset.write(bands)
        dataset.update_tags(**profile.get("tags", {}))
    return path


def plane(x: AnyArray, y: AnyArray) -> AnyArray:
    """A height that names its place: every flip and every shift changes it."""
    return 1000.0 + 0.25 * x - 0.5 * y


def plane_grid(rows: int, cols: int, transform: Affine) -> NDArray[np.float32]:
    """Heights of the plane at pixel centres, relative to the grid's first corner."""
    row, col = np.mgrid[0:rows, 0:cols] + 0.5
    x = transform.a * col + transform.b * row
    y = transform.d * col + transform.e * row
    return plane(x, y).astype(np.float32)
