"""Summits are as high on the surface as in a file of degrees, and eyes stand on them."""

from dataclasses import replace

import numpy as np
import pytest
from rasterio.transform import from_origin
from scenes import FRAME, at_m, field_from, write_dem
from scipy.ndimage import gaussian_filter

from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.resampling import local_maxima
from skyline.terrain.summits import highest_within, prominence_m, summit_heights_m
from skyline.terrain.viewpoints import stand_on

STEP_DEG = 1.0 / 1200.0


def peaks(seed, shape=(150, 180)):
    """Cones of 30 degrees at random places of a rough plateau, sharp to the sample."""
    rng = np.random.default_rng(seed)
    rough = gaussian_filter(rng.normal(size=shape), 2.0)
    heights = 800.0 + 40.0 * rough / rough.std()
    row, col = np.mgrid[: shape[0], : shape[1]]
    tops = (rng.integers(8, size - 8, 60) for size in shape)
    for top_row, top_col, height in zip(*tops, rng.uniform(900.0, 1500.0, 60), strict=True):
        away_m = np.hypot(92.7 * (row - top_row), 63.0 * (col - top_col))
        heights = np.maximum(heights, height - np.tan(np.radians(30.0)) * away_m)
    return np.rint(heights).astype(np.float32)


@pytest.mark.parametrize("north", [0.05, 47.0, 69.0, -45.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_every_local_maximum_is_as_high_within_a_cell(tmp_path, north, seed):
    heights, transform = peaks(seed), from_origin(9.0, north, STEP_DEG, STEP_DEG)
    field = read_dem(write_dem(tmp_path / "dem.tif", heights, "EPSG:4326", transform=transform))
    row, col = local_maxima(heights)
    assert row.size > 100
    lon, lat = 9.0 + (col + 0.5) * STEP_DEG, north - (row + 0.5) * STEP_DEG
    at_row, at_col = field.to_grid(**at_m(field.frame.from_lonlat(lon, lat)))
    top, left = np.floor(at_row).astype(int), np.floor(at_col).astype(int)
    corners = np.stack([field.heights_m[top + i, left + j] for i in (0, 1) for j in (0, 1)])
    off = corners.max(axis=0) - heights[row, col]
    assert off.min() >= 0.0
    # Higher only where the cell reaches towards another, higher maximum.
    assert np.quantile(off, 0.9) == 0.0
    cones = heights[row, col] > 950.0
    assert np.abs(off[cones]).max() <= 1.0


def test_maxima_are_those_of_a_plain_search():
    rng = np.random.default_rng(3)
    heights = rng.integers(0, 12, (60, 50)).astype(np.float32)
    heights[rng.uniform(size=heights.shape) < 0.02] = np.nan
    heights[20:26, 30:36] = 5.0
    expected = []
    for row, col in np.ndindex(58, 48):
        around, own = heights[row : row + 3, col : col + 3], heights[row + 1, col + 1]
        if np.isfinite(around).all() and own == around.max() and own > around.min():
            expected.append((row + 1, col + 1))
    assert list(zip(*local_maxima(heights), strict=True)) == expected
    assert list(zip(*local_maxima(heights, strip_samples=100), strict=True)) == expected


def surface_of(seed):
    """Rough ground, on every third seed with holes."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(0.0, 30.0, (9, 11))
    heights[rng.random(heights.shape) < 0.1 * (seed % 3 == 0)] = np.nan
    return HeightField(heights, 0.0, 0.0, *rng.uniform(10.0, 100.0, 2), FRAME)


@pytest.mark.parametrize("seed", range(9))
def test_the_highest_point_of_a_disc_is_higher_than_all_others_of_it(seed):
    surface, rng = surface_of(seed), np.random.default_rng(1000 + seed)
    easting, northing = (float(at) for at in surface.to_map(*rng.uniform(-1.0, 10.0, 2)))
    within_m = rng.uniform(0.0, 5.0) * surface.spacing_m
    highest = highest_within(surface, easting, northing, within_m)
    assert np.hypot(highest[0] - easting, highest[1] - northing) <= within_m + 1e-5
    # Everywhere in the disc, and on its edge.
    away_m = within_m * np.append(np.sqrt(rng.uniform(0.0, 1.0, 3000)), np.ones(3000))
    turn = rng.uniform(0.0, 2.0 * np.pi, away_m.size)
    others_m = surface.height_at(
        easting_m=easting + away_m * np.sin(turn), northing_m=northing + away_m * np.cos(turn)
    )
    if np.isnan(others_m).all():
        assert np.hypot(highest[0] - easting, highest[1] - northing) < 1e-5
    else:
        assert surface.height_at(**at_m(highest)) >= np.nanmax(others_m) - 2e-3


def cone():
    """Return a mountain that stands alone: a cone of 45 degrees, 61 x 61 samples 90 m apart."""
    return field_from(lambda east, north: np.maximum(600.0 - np.hypot(east, north), 0.0), 61, 90.0)


def test_a_place_within_a_sample_of_a_summit_is_on_it():
    east_m = np.array([0.0, 40.0, 0.0, 70.0, 0.0, 2000.0])
    north_m = np.array([0.0, -35.0, 89.0, 70.0, 95.0, 2000.0])
    found = summit_heights_m(cone(), east_m, north_m)
    np.testing.assert_array_equal(found, [600.0, 600.0, 600.0, np.nan, np.nan, np.nan])


def knoll(rise_m):
    """Return a slope that rises to the north, with a knoll on it at its middle."""
    slope = field_from(lambda east, north: 1000.0 + 0.3 * north + 0.0 * east, 61, 90.0)
    heights = slope.heights_m.copy()
    heights[30, 30] += rise_m
    return replace(slope, heights_m=heights)


@pytest.mark.parametrize(("rise_m", "is_summit"), [(0.0, False), (30.0, False), (60.0, True)])
def test_a_knoll_on_a_slope_is_a_summit_if_it_rises_more_than_a_model_errs(rise_m, is_summit):
    # Beside it, the slope rises by 27 m a sample; twice the deviation of heights is 23 m.
    found = summit_heights_m(knoll(rise_m), np.array([30.0]), np.array([20.0]))
    assert np.isfinite(found[0]) == is_summit


def test_a_prominence_is_how_far_one_must_descend():
    two = field_from(
        lambda east, north: np.maximum(
            1500.0 - np.hypot(east, north), 1200.0 - np.hypot(east - 900.0, north)
        ), 101, 50.0,
    )  # fmt: skip
    # Between the two, 900 m apart, the pass is at 900 m.
    assert prominence_m(two, 50, 68) == pytest.approx(300.0, abs=1.0)
    assert prominence_m(two, 50, 50) > 1000.0
    assert prominence_m(two, 50, 59) == pytest.approx(0.0, abs=1.0)


def test_eyes_stay_or_rise_or_move_to_a_summit():
    mountain = cone()
    beside = 40.0, -35.0
    as_is, lifted, moved = (
        stand_on(mountain, **at_m(beside), eye_height_m=2.0, summit_within_m=within_m)
        for within_m in (0.0, None, 100.0)
    )
    assert as_is.eye_elevation_m[0] == mountain.height_at(**at_m(beside)) + 2.0 < 565.0
    assert (lifted.easting_m[0], lifted.northing_m[0]) == beside
    assert lifted.eye_elevation_m[0] == 602.0
    assert (moved.easting_m[0], moved.northing_m[0]) == pytest.approx((0.0, 0.0), abs=1e-5)
    assert moved.eye_elevation_m[0] == pytest.approx(602.0, abs=1e-5)
    slope = stand_on(mountain, easting_m=450.0, northing_m=0.0, summit_within_m=100.0)
    assert slope.easting_m[0] == pytest.approx(350.0, abs=1e-5)
