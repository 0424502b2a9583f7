"""Made photos that note heights, from the air and from the ground.

Photos from the air are taken from drones, towers and balloons. A drone notes its height above its
take-off and the altitude of its barometer. Other photos note only an altitude, many above the
ellipsoid as if it were above the sea.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np

from skyline import Orientation, PhotoSkyline
from skyline.angles import angle_between_deg
from skyline.geodesy.map_frame import Rectangle
from skyline.orientation.result import RIGHT_DEG
from skyline.photo.noted_place import NotedPlace
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M
from skyline_bench.queries.synthetic import QueryConfig, Truth, make_queries

MEASURED = "noted heights"
RIGHT_EYE_M = 30.0
"""Largest error of an eye's elevation that is right: three times the model's error."""
HEIGHTS = """measured=queries group km2 n answered wrong lowest_m highest_m median_deg median_eye_m
    worst_eye_m strongest seconds=s"""
"""Columns of the printed table."""
_ALTITUDE_SD_M = 15.0
"""Standard deviation of a phone's altitude; `skyline.match.prior` has the source."""
_GEOID_M = 50.0
"""Height of the geoid above the ellipsoid in the Alps."""

LonLat = tuple[SupportsFloat, SupportsFloat]
"""A longitude and a latitude, degrees."""
Find = Callable[[Path | PhotoSkyline, LonLat], Orientation]
"""Orients a photo or a skyline at a place."""
_Tried = tuple[Truth, Orientation, float]
"""A photo's truth, how it was oriented, and the height of its eye above the ground."""


def height_rows(
    find: Find,
    terrain: HeightField,
    seen: HeightField,
    area: Rectangle,
    count: int,
    seed: int,
) -> list[dict[str, Any]]:
    """Return a row for each kind of photos that note heights.

    There are ``count`` photos of each kind. They see ``seen``, and are oriented at places beside
    the true ones.
    """
    return [
        {"measured": MEASURED, "group": group}
        | _summary([_tried(find, terrain, seen, area, [seed, kind, one]) for one in range(count)])
        for kind, group in enumerate(NOTING)
    ]


def _tried(
    find: Find, terrain: HeightField, seen: HeightField, area: Rectangle, entropy: list[int]
) -> _Tried:
    """Make one photo that notes heights, and orient it."""
    rng = np.random.default_rng(entropy)
    noting = list(NOTING.values())[entropy[1]]
    height_m = DEFAULT_EYE_HEIGHT_M
    if noting is not _grounded:
        height_m = float(np.exp(rng.uniform(*np.log((40.0, 400.0)))))
    config = QueryConfig(eye_height_m=height_m)
    drawn = int(rng.integers(2**31))
    (query,) = make_queries(seen, area, 1, drawn, config)
    lon, lat = map(float, terrain.frame.to_lonlat(*query.truth.beside_m(rng)))
    noted = replace(noting(terrain, query.truth, rng), lonlat_deg=(lon, lat))
    return query.truth, find(replace(query.skyline, noted=noted), (lon, lat)), height_m


def _of_drone(terrain: HeightField, truth: Truth, rng: np.random.Generator) -> NotedPlace:
    ground_m = math.nan
    while math.isnan(ground_m):
        away = rng.uniform(0.0, 200.0) * np.exp(2j * np.pi * rng.uniform())
        at = {"easting_m": truth.easting_m + away.real, "northing_m": truth.northing_m + away.imag}
        ground_m = float(terrain.height_at(**at))
    altitude_m = truth.eye_elevation_m + 90.0 * rng.standard_normal()
    above_m = truth.eye_elevation_m - ground_m
    return NotedPlace(elevation_m=altitude_m, takeoff_height_m=above_m)


def _aloft(_: HeightField, truth: Truth, rng: np.random.Generator) -> NotedPlace:
    off_m = _GEOID_M * rng.integers(2) + _ALTITUDE_SD_M * rng.standard_normal()
    return NotedPlace(elevation_m=truth.eye_elevation_m + off_m)


def _grounded(_: HeightField, truth: Truth, rng: np.random.Generator) -> NotedPlace:
    off_m = _GEOID_M + _ALTITUDE_SD_M * rng.standard_normal()
    return NotedPlace(elevation_m=truth.eye_elevation_m + off_m)


NOTING = {"drones": _of_drone, "aloft": _aloft, "on the ground": _grounded}
"""Kinds of photos, and the heights that they note."""


def _summary(tried: Sequence[_Tried]) -> dict[str, Any]:
    """Return how many photos are answered, and how well.

    The figures say how far off the headings and the eyes of the answers are.
    """
    answers = [(truth, one.answer) for truth, one, _ in tried if one.answer is not None]
    off_deg = np.array(
        [
            angle_between_deg(pose.grid_heading_deg, truth.grid_heading_deg)
            for truth, pose in answers
        ]
    )
    off_m = np.array([abs(pose.eye_elevation_m - truth.eye_elevation_m) for truth, pose in answers])
    heights_m = [height_m for *_, height_m in tried]
    line: dict[str, Any] = {
        "n": len(tried),
        "answered": len(answers),
        "wrong": int(((off_deg > RIGHT_DEG) | (off_m > RIGHT_EYE_M)).sum()),
        "lowest_m": min(heights_m),
        "highest_m": max(heights_m),
        "strongest": max(one.confidence for _, one, _ in tried),
        "seconds": float(np.median([one.seconds for _, one, _ in tried])),
    }
    if answers:
        line |= {
            "median_deg": float(np.median(off_deg)),
            "median_eye_m": float(np.median(off_m)),
            "worst_eye_m": float(off_m.max()),
        }
    return line
