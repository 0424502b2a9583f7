"""Rows that say which row they are; imported by the processes that the store's tests kill."""

import numpy as np

from skyline.features import NO_KEYPOINT
from skyline.geodesy import Frame
from skyline.store import StoreHeader
from skyline.views import Views

WIDTH = 24
KEYPOINTS = 6
HEADER = StoreHeader(
    frame_wkt=Frame.from_crs("EPSG:32632").wkt,
    dem_digest="a1" * 32,
    dem_files=("/dem/davos.tif", "/dem/näfels.tif"),
    config={"planner": "uniform", "spacing_m": 500.0, "bounds": [1, 2, 3, 4]},
    renderer="depth 640 on Mesa",
    width=WIDTH,
    max_keypoints=KEYPOINTS,
)


def rows(start: int, stop: int) -> tuple[Views, np.ndarray]:
    """Return rows ``start`` to ``stop``; some columns are NaN."""
    number = np.arange(start, stop)
    skyline = np.sin(0.1 * np.arange(WIDTH) + number[:, np.newaxis]).astype(np.float32)
    skyline[number % 5 == 0, 3:7] = np.nan
    keypoints = np.full((len(number), KEYPOINTS), NO_KEYPOINT, dtype=np.uint16)
    keypoints[:, 0] = number % WIDTH
    views = Views(
        easting_m=7.5e5 + number,
        northing_m=5.2e6 - number / 3.0,
        eye_elevation_m=1500.0 + number / 7.0,
        heading=(number % 4).astype(np.uint8),
        elevation_tan=skyline,
        depth_m=1000.0 * np.abs(skyline) + number[:, np.newaxis].astype(np.float32),
        flags=((number[:, np.newaxis] + np.arange(WIDTH)) % 8).astype(np.uint8),
    )
    return views, keypoints
