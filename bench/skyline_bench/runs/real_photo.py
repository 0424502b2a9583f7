"""Where the webcam photo of Hintereisferner is put, with and without its field of view.

The store covers all of the Rofental DEM, 725 km2; the station's place is good to 100 to 150 m.
"""

import time
from pathlib import Path

import numpy as np

from skyline import Matcher, read_dem
from skyline.pipeline import build_places
from skyline.terrain.dem import DemOptions

STATION_LON, STATION_LAT = 10.78277, 46.79586
HEADING_DEG, FOV_DEG = 275.96, 78.7
_QUICK_DEG = 0.015
"""What is built about the station when it must be quick."""


def measure(folder: Path, store: Path, quick: bool) -> list[dict[str, object]]:
    """Match the photo of a folder to a store, which is built where it is not there."""
    terrain = read_dem([folder / "dem_rofental_50.asc"], DemOptions(crs="EPSG:32632"))
    around = (
        STATION_LON - _QUICK_DEG, STATION_LAT - _QUICK_DEG,
        STATION_LON + _QUICK_DEG, STATION_LAT + _QUICK_DEG,
    )  # fmt: skip
    built = build_places(terrain, store, bounds_deg=around if quick else None)
    started = time.perf_counter()
    matcher = Matcher(store, terrain)
    open_s = time.perf_counter() - started
    station = terrain.frame.from_lonlat(STATION_LON, STATION_LAT)
    rows = list[dict[str, object]]()
    for fov_deg in (FOV_DEG, None):
        found = matcher.match(folder / "hintereisferner_webcam.jpg", fov_deg)
        best = found.candidates[0]
        place = best.easting_m, best.northing_m
        rows.append(
            {
                "fov_given_deg": fov_deg,
                "error_m": float(np.hypot(*np.subtract(place, station))),
                "heading_error_deg": (best.heading_deg - HEADING_DEG + 180.0) % 360.0 - 180.0,
                "fov_deg": best.fov_deg,
                "pitch_deg": best.pitch_deg,
                "confidence": best.confidence,
                "answered": found.answer is not None,
                "query_s": found.seconds,
                "open_s": open_s,
                "places": built.rows,
                "bytes": store.stat().st_size,
            }
        )
    return rows
