"""Summits' names and pixels' places in made photos, against the truth.

The truth is the terrain that the photos show. A summit is a sample that is the highest for 500 m
around. It is visible if no terrain hides it; ground within 150 m of it is the summit's own. Lines
of sight to summits are followed in steps of 1 m, and the rays of pixels in steps of 5 m.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter

from skyline import HeightField, Pose, Viewer
from skyline.arrays import BoolArray, Float64Array
from skyline.geodesy.earth import Curvature
from skyline.terrain.summits import SUMMIT_RADIUS_M
from skyline.view.peaks import Peaks
from skyline_bench.measuring import window_of
from skyline_bench.queries.kinds import HEIGHT_SD_M
from skyline_bench.queries.synthetic import SyntheticQuery, Truth

Posed = tuple[SyntheticQuery, Pose | None]
"""A made photo, and the pose that was found for it; None stands for the true one."""

_EXACT = ((0.0,) * 7,) * 7
"""Covariance of a true pose."""
_EACH_PX = 24
"""One pixel in this many rows and columns is compared."""


def label_row(model: HeightField, seen: HeightField, posed: Sequence[Posed]) -> dict[str, Any]:
    """Return how many visible and hidden summits ``model`` names.

    The photos show ``seen``.
    """
    east_m, north_m = _summits(seen)
    off = list[Float64Array]()
    visible = list[BoolArray]()
    photos = 0
    for number, (query, pose) in enumerate(posed):
        east, north, column, row, is_seen = _in_picture(seen, query, east_m, north_m, number)
        photos += bool(len(east))
        names = tuple(map(str, range(len(east))))
        unknown_m = np.full(len(east), np.nan)
        peaks = Peaks(names=names, easting_m=east, northing_m=north, height_m=unknown_m)
        with Viewer(model, peaks) as viewer:
            labels = viewer.summits(pose or true_pose(viewer, query.truth), query.skyline)
        at_px = np.full((2, len(east)), np.nan)
        for one in labels:
            at_px[:, int(one.name)] = one.column_px, one.row_px
        off.append(np.hypot(at_px[0] - column, at_px[1] - row))
        visible.append(is_seen)
    every_px = np.concatenate(off)
    is_visible = np.concatenate(visible)
    is_named = np.isfinite(every_px)
    total = int(is_visible.sum())
    off_px = every_px[is_named & is_visible]
    return {
        "measured": "labels",
        **_about(model, seen, posed),
        "photos": photos,
        "summits": len(every_px),
        "visible": total,
        "named": len(off_px) / total if total else None,
        "within_5_px": float((off_px <= 5.0).sum()) / total if total else None,
        "hidden": len(every_px) - total,
        "hidden_named": int((is_named & ~is_visible).sum()),
        "median_px": float(np.median(off_px)) if off_px.size else None,
        "p95_px": float(np.quantile(off_px, 0.95)) if off_px.size else None,
    }


def pixel_row(model: HeightField, seen: HeightField, posed: Sequence[Posed]) -> dict[str, Any]:
    """Return how far the places of pixels are from the true ones.

    Places are found on ``model``, and the true ones lie on ``seen``. The standard error of a place
    along its ray is the model's height error divided by the angle at which the ray meets the
    ground.
    """
    errors = list[Float64Array]()
    for query, pose in posed:
        with Viewer(model) as viewer:
            held = pose or true_pose(viewer, query.truth)
            places = viewer.places(held, query.skyline, _EACH_PX)
        azimuth_rad, tan = _rays(query)
        true_m = _met_m(seen, query.truth, azimuth_rad, tan)
        found_m = places.distance_m.astype(np.float64).ravel()
        east, north = model.frame.from_lonlat(places.lon.ravel(), places.lat.ravel())
        off_m = np.hypot(
            east - query.truth.easting_m - true_m * np.sin(azimuth_rad),
            north - query.truth.northing_m - true_m * np.cos(azimuth_rad),
        )
        slope_m = 30.0  # The ground's slope is taken over so much.
        ahead = slope_m * np.array([[-0.5], [0.5]])
        before_m, behind_m = model.height_at(
            easting_m=east + ahead * np.sin(azimuth_rad),
            northing_m=north + ahead * np.cos(azimuth_rad),
        )
        sd_m = HEIGHT_SD_M / np.abs((behind_m - before_m) / slope_m - tan)
        errors.append(np.stack([true_m, found_m, off_m, sd_m]))
    true_m, found_m, off_m, sd_m = np.concatenate(errors, axis=1)
    both = np.isfinite(true_m) & np.isfinite(found_m)
    off_m = off_m[both]
    sd_m = sd_m[both]
    return {
        "measured": "pixels",
        **_about(model, seen, posed),
        "photos": len(posed),
        "pixels": len(true_m),
        "sky_right": float((np.isnan(true_m) == np.isnan(found_m)).mean()),
        "median_off_m": float(np.median(off_m)),
        "p99_off_m": float(np.quantile(off_m, 0.99)),
        "within_2_sd": float((off_m <= 2.0 * sd_m).mean()),
    }


def _about(model: HeightField, seen: HeightField, posed: Sequence[Posed]) -> dict[str, str]:
    given = all(pose is None for _, pose in posed)
    return {
        "pose": "given" if given else "found",
        "model": "exact" if model is seen else f"{HEIGHT_SD_M:g} m rms off",
    }


def true_pose(viewer: Viewer, truth: Truth) -> Pose:
    """Return the true pose of a photo.

    Its eye stands on the ground or above.
    """
    lon, lat = truth.lonlat(viewer.frame)
    held = {name: getattr(truth, name) for name in ("pitch_deg", "roll_deg", "fov_deg")}
    pose = viewer.pose(lon=lon, lat=lat, heading_deg=truth.heading_deg(viewer.frame), **held)
    return replace(pose, eye_elevation_m=truth.eye_elevation_m, covariance=_EXACT)


def _summits(terrain: HeightField) -> tuple[Float64Array, Float64Array]:
    """Return easting and northing of the samples that are the highest around."""
    heights = np.nan_to_num(terrain.heights_m, nan=-np.inf)
    window = window_of(500.0, terrain.spacing_north_m, terrain.spacing_east_m)
    return terrain.to_map(*np.nonzero((heights == maximum_filter(heights, window)) & (heights > 0)))


def _in_picture(
    terrain: HeightField,
    query: SyntheticQuery,
    east_m: Float64Array,
    north_m: Float64Array,
    seed: int,
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array, BoolArray]:
    """Return easting, northing, column, row and visibility of summits in a photo.

    If there are more than 30, 30 are drawn at random.
    """
    truth = query.truth
    size = query.skyline
    away_m = truth.off_m(east_m, north_m)
    near = (away_m > 2.0 * SUMMIT_RADIUS_M) & (away_m < 25_000.0)
    east_m = east_m[near]
    north_m = north_m[near]
    away_m = away_m[near]
    azimuth_rad = np.arctan2(east_m - truth.easting_m, north_m - truth.northing_m)
    ground_m = terrain.height_at(easting_m=east_m, northing_m=north_m)
    tan = (ground_m - truth.eye_elevation_m - Curvature().drop_m(away_m)) / away_m
    camera = truth.camera(size.width_px, size.height_px)
    column, row, ahead = camera.project(azimuth_rad - np.radians(truth.grid_heading_deg), tan)
    inside = ahead & (column >= 0.0) & (column < size.width_px)
    inside &= (row >= 0.0) & (row < size.height_px)
    drawn = np.random.default_rng(seed).permutation(np.flatnonzero(inside))[:30]
    farthest_m = float(away_m[drawn].max(initial=0.0))
    step_m = np.arange(0.0, farthest_m, 1.0)
    above_m = _ground_above_m(terrain, truth, azimuth_rad[drawn], step_m)
    is_before = (step_m > 0.0) & (step_m < away_m[drawn, np.newaxis] - SUMMIT_RADIUS_M)
    over_m = np.where(is_before, above_m - tan[drawn, np.newaxis] * step_m, -np.inf)
    visible = over_m.max(axis=1, initial=-np.inf) <= 0.0
    return east_m[drawn], north_m[drawn], column[drawn], row[drawn], visible


def _ground_above_m(
    terrain: HeightField, truth: Truth, azimuth_rad: Float64Array, away_m: Float64Array
) -> Float64Array:
    """Return the height (K, D) of the ground over the eye's level.

    It is given on K rays at D distances. It is -inf without data.
    """
    ground_m = terrain.height_at(
        easting_m=truth.easting_m + away_m * np.sin(azimuth_rad)[:, np.newaxis],
        northing_m=truth.northing_m + away_m * np.cos(azimuth_rad)[:, np.newaxis],
    )
    above_m = ground_m - truth.eye_elevation_m - Curvature().drop_m(away_m)
    return np.asarray(np.nan_to_num(above_m, nan=-np.inf))


def _rays(query: SyntheticQuery) -> tuple[Float64Array, Float64Array]:
    """Return grid azimuths and elevations (N,) of the pixels that are compared."""
    camera = query.truth.camera(query.skyline.width_px, query.skyline.height_px)
    east, up, north = np.moveaxis(camera.rays()[::_EACH_PX, ::_EACH_PX], -1, 0)
    return np.arctan2(east, north).ravel(), (up / np.hypot(east, north)).ravel()


def _met_m(
    terrain: HeightField, truth: Truth, azimuth_rad: Float64Array, tan: Float64Array
) -> Float64Array:
    """Return where rays (N,) first meet the ground; NaN for sky."""
    found_m = np.full(len(tan), np.nan)
    reach_m = terrain.reach_m(easting_m=truth.easting_m, northing_m=truth.northing_m)
    away_m = np.arange(0.0, reach_m, 5.0)
    for index in range(len(tan)):
        above_m = _ground_above_m(terrain, truth, azimuth_rad[index : index + 1], away_m)
        over_m = above_m[0] - tan[index] * away_m
        after = int(np.argmax(over_m >= 0.0))
        if over_m[after] >= 0.0:
            ends = slice(max(after - 1, 0), after + 1)
            found_m[index] = np.interp(0.0, over_m[ends], away_m[ends])
    return found_m
