"""Horizons round places, every half degree: Skyline against Embree's rays and GRASS' r.horizon.

All answer for the same samples in one run. Times are medians by the clock on the wall after a
warm-up, all cores for everyone, taken in turns; GRASS takes place by place and is timed so. Errors
are of elevation angles against the float64 oracle, at the azimuths, eyes and curvature that each
tool knows: GRASS is compared on a flat Earth, on samples, with angles cut off at zero.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import Float64Array
from skyline.camera import columns_u, elevation_deg
from skyline.geodesy import Curvature
from skyline.pipeline.horizon_at import DEFAULT_STEP_DEG, horizons_of
from skyline.render.panorama import PanoramaRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline.views import Views
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import in_turns
from skyline_bench.peers import embree, grass
from skyline_bench.truth import oracle

_STEPS = round(360.0 / DEFAULT_STEP_DEG)


@dataclass(frozen=True, slots=True)
class HorizonConfig:
    """What is measured."""

    places: int = 1000  # Drawn with ``seed`` from the middle half of the DEM, both ways
    compared: int = 24  # Of them, compared with the oracle
    grass_places: int = 24  # Given to GRASS
    # Of Embree's bisection, started from the neighbouring column.
    depths: tuple[int, ...] = (9, 11, 13, 15)
    repeats: int = 3
    seed: int = 0

    def quick(self) -> "HorizonConfig":
        """Return the same, but small."""
        return replace(self, places=40, compared=3, grass_places=3, depths=(11,), repeats=1)


def measure(terrain: HeightField, config: HorizonConfig) -> list[Row]:
    """Return time and error of each tool; what is not installed is left out."""
    west, south, east, north = terrain.bounds_m
    share = np.random.default_rng(config.seed).uniform(0.25, 0.75, (2, config.places))
    easting, northing = west + share[0] * (east - west), south + share[1] * (north - south)
    there = ~np.isnan(terrain.height_at(easting_m=easting, northing_m=northing))
    eyes = stand_on(terrain, easting_m=easting[there], northing_m=northing[there])
    some = eyes[: config.compared]
    convergence = terrain.frame.convergence_deg(
        easting_m=eyes.easting_m, northing_m=eyes.northing_m
    )
    to_grid = -np.radians(convergence)
    curvature = Curvature()
    begun = time.perf_counter()
    renderer = PanoramaRenderer(terrain, _STEPS, curvature, tolerance_deg=0.0)
    renderer.render(eyes[:1], to_grid[:1])
    set_up = {"Skyline": time.perf_counter() - begun}
    works: dict[tuple[str, str], Callable[[], object]] = {
        ("Skyline", "exact"): lambda: renderer.render(eyes, to_grid)
    }
    found = horizons_of(terrain, some).elevation_deg
    off: dict[tuple[str, str], Float64Array] = {
        ("Skyline", "exact"): found - _true_deg(terrain, some, -convergence, curvature)
    }
    if embree.is_installed():
        begun = time.perf_counter()
        peer = embree.EmbreePeer(terrain, _STEPS // 4, curvature)
        set_up["Embree rays"] = time.perf_counter() - begun
        u = columns_u(_STEPS // 4)
        truth = oracle.skyline_at(terrain, some, u, curvature)
        for depth in config.depths:
            way = embree.Bisection(depth)
            key = "Embree rays", f"bisected to {np.degrees(0.5 * way.bracket_tan):.2g} degrees"
            works[key] = lambda way=way: peer.render(eyes, way)  # type: ignore[misc]
            views = peer.render(some, way)
            off[key] = _angles_deg(views, u) - _angles_deg(truth, u)
    taken = in_turns(list(works.values()), config.repeats)
    rows = [
        _row(key, len(eyes), timing.seconds / len(eyes), timing.cpu_seconds / len(eyes), off[key])
        | {"set_up_s": set_up[key[0]]}
        for key, timing in zip(works, taken, strict=True)
    ]
    renderer.release()
    return rows + (_grass(terrain, eyes[: config.grass_places]) if grass.is_installed() else [])


def _grass(terrain: HeightField, eyes: Viewpoints) -> list[Row]:
    row, col = (
        np.rint(at) for at in terrain.to_grid(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
    )
    easting_m, northing_m = terrain.to_map(row, col)
    stand = stand_on(terrain, easting_m=easting_m, northing_m=northing_m, eye_height_m=0.0)
    found_deg, seconds = grass.horizons(terrain, stand, DEFAULT_STEP_DEG)
    turn_deg = -terrain.frame.convergence_deg(
        easting_m=stand.easting_m, northing_m=stand.northing_m
    )
    true_deg = _true_deg(terrain, stand, turn_deg, Curvature(enabled=False))
    off = found_deg - np.maximum(true_deg, 0.0)
    each = float(np.median(seconds))
    return [_row(("GRASS r.horizon", "point mode"), len(eyes), each, None, off)]


def _true_deg(
    terrain: HeightField, eyes: Viewpoints, turn_deg: Float64Array, curvature: Curvature
) -> Float64Array:
    """Return the oracle's elevation angles (N, A) by azimuths from grid azimuths (N,) on."""
    azimuth_deg = np.arange(_STEPS) * DEFAULT_STEP_DEG
    true_deg = np.empty((len(eyes), _STEPS))
    for index in range(len(eyes)):
        grid_deg = (azimuth_deg + turn_deg[index] + 45.0) % 360.0 - 45.0
        order = np.argsort(grid_deg)
        heading = np.floor((grid_deg[order] + 45.0) / 90.0).astype(int)
        away = np.radians(grid_deg[order] - 90.0 * heading).reshape(4, -1)
        views = oracle.skyline_at(terrain, eyes[index : index + 1], np.tan(away[0]), curvature)
        true_deg[index, order] = _angles_deg(views, np.tan(away[0])).ravel()
    return true_deg


def _angles_deg(views: Views, u: Float64Array) -> Float64Array:
    return elevation_deg(views.elevation_tan.astype(np.float64), u)


def _row(
    key: tuple[str, str],
    places: int,
    seconds: float,
    cpu_seconds: float | None,
    off_deg: Float64Array,
) -> dict[str, object]:
    return {
        "tool": key[0],
        "setting": key[1],
        "places": places,
        "seconds_for_1000": 1000.0 * seconds,
        "cpu_seconds_for_1000": None if cpu_seconds is None else 1000.0 * cpu_seconds,
        "max_error_deg": float(np.nanmax(np.abs(off_deg))),
        "rms_error_deg": float(np.sqrt(np.nanmean(off_deg**2))),
    }
