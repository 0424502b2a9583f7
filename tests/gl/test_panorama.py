"""A wall before a higher wall as an eye sees it, and the names of peaks in a panorama."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import at_deg, at_m, field_from, field_of, fractal
from scipy.ndimage import maximum_filter

from skyline import PanoramaConfig, Peaks, horizon, save_panorama, stand_on
from skyline.report.panorama import SUMMIT, draw_panorama
from skyline.report.panorama_view import Landscape, panorama_view
from skyline.skylines import FLAG_TRUNCATED

AZIMUTH_DEG = 10.0 + np.arange(2000) * 0.05


@pytest.fixture(scope="module")
def two_walls():
    """The view of a ring 600 m away and of a higher one 3,000 m away, over a plain."""
    field = field_from(
        lambda east, north: (
            50.0 * (np.abs(np.hypot(east, north) - 600.0) < 20.0)
            + 530.0 * (np.hypot(east, north) >= 3000.0)
        ),
        701, 10.0,
    )  # fmt: skip
    return Landscape.of(field, stand_on(field, easting_m=0.0, northing_m=0.0), AZIMUTH_DEG)


def test_the_nearer_wall_hides_the_plain_and_the_farther_one_stands_over_it(two_walls):
    near_deg, far_deg = np.degrees(np.arctan([48.0 / 600.0, 528.0 / 3000.0]))
    np.testing.assert_allclose(two_walls.skyline_deg, far_deg, atol=0.1)
    assert two_walls.reach_m == pytest.approx(3000.0, rel=0.01)
    elevation = [-60.0, -1.0, near_deg - 0.3, near_deg + 0.3, far_deg - 0.1, far_deg + 0.1]
    seen = two_walls.seen(slice(100, 140), np.array(elevation))
    seen_m = np.append(two_walls.distance_m, np.inf)[seen]
    assert seen_m.shape == (6, 40)
    np.testing.assert_allclose(seen_m[0], 2.0 / np.tan(np.radians(60.0)), atol=10.0)
    np.testing.assert_allclose(seen_m[1], 2.0 / np.tan(np.radians(1.0)), atol=10.0)
    np.testing.assert_allclose(seen_m[2], 600.0, atol=35.0)
    np.testing.assert_allclose(seen_m[3:5], 3000.0, atol=25.0)
    assert np.isinf(seen_m[5]).all()


def test_ridges_are_where_the_terrain_drops_out_of_sight(two_walls):
    ridge_m, ridge_deg = two_walls.ridges()
    there = np.isfinite(ridge_deg)
    assert there.any(axis=0).all()
    for low_m, high_m, tan in ((550.0, 650.0, 48.0 / 600.0), (2900.0, 3100.0, 528.0 / 3000.0)):
        lines = ridge_deg[(ridge_m > low_m / 1.08) & (ridge_m < high_m)]
        highest = np.nanmax(lines, axis=0)
        np.testing.assert_allclose(highest, np.degrees(np.arctan(tan)), atol=0.25)
    between = (ridge_m > 700.0) & (ridge_m < 2700.0)
    assert not there[between].any()


@pytest.mark.parametrize("share", [(0.33, 0.6), (0.7, 0.2)])
def test_the_skyline_is_the_exact_horizon_within_half_a_step(mountains, share):
    field, _ = mountains
    place = tuple(float(at) for at in field.to_map(300.0 * share[0], 300.0 * share[1]))
    exact = horizon(field, **at_deg(field.frame.to_lonlat(*place)), eye_height_m=20.0, step_deg=0.1)
    eye = stand_on(field, **at_m(place), eye_height_m=20.0)
    seen = Landscape.of(field, eye, exact.azimuth_deg)
    distance_m, resolved = exact.distance_m, exact.distance_m > 0.35 * field.spacing_m
    # Of the ground past the border nothing is drawn.
    resolved &= exact.flags & FLAG_TRUNCATED == 0
    short_deg = exact.elevation_deg - seen.skyline_deg
    # What stands highest is found to where it crosses an edge, unless it is hidden at both steps
    # beside it: then it rises no more than the steepest ground does in half a step.
    step_m = np.maximum(field.spacing_m, np.radians(0.1) * distance_m)
    slope = np.abs(np.diff(field.heights_m)).max() / field.spacing_m * np.sqrt(2.0)
    bound_deg = np.degrees(0.5 * step_m * slope / distance_m)
    assert short_deg.min() > -1e-3
    assert (short_deg <= bound_deg)[resolved].all()
    assert np.percentile(short_deg[resolved], 95) < 1e-3


@pytest.fixture(scope="module")
def mountains():
    heights = 1500.0 + fractal(300, 300, 1500.0, seed=8)
    field = field_of(heights, 60.0)
    # The highest within 180 m, so that each is the summit that its name stands for.
    row, col = np.nonzero(field.heights_m == maximum_filter(field.heights_m, 7))
    names = tuple(f"{'Great ' * (index % 3)}Peak {index}" for index in range(len(row)))
    heights_m = field.heights_m[row, col].astype(np.float64)
    return field, Peaks(names=names, **at_m(field.to_map(row, col)), height_m=heights_m)


def test_no_name_overlaps_another_or_leaves_the_picture(mountains):
    field, peaks = mountains
    config = PanoramaConfig(eye_height_m=500.0)
    eye = stand_on(field, **at_m(field.to_map(165.0, 240.0)), eye_height_m=500.0)
    figure, _ = draw_panorama(panorama_view(field, eye, peaks, config))
    figure.canvas.draw()
    names = figure.findobj(lambda one: one.get_gid() == SUMMIT)
    assert len(names) > 8
    extents = [name.get_window_extent() for name in names]
    page = figure.bbox
    for index, extent in enumerate(extents):
        assert page.x0 <= extent.x0 <= extent.x1 <= page.x1
        assert page.y0 <= extent.y0 <= extent.y1 <= page.y1
        assert not any(extent.overlaps(other) for other in extents[:index])
    title = figure.texts[0].get_window_extent()
    assert not any(title.overlaps(extent) for extent in extents)


def test_a_surface_is_a_line_over_the_skyline(mountains, tmp_path):
    field, _ = mountains
    lonlat = tuple(float(at) for at in field.frame.to_lonlat(*field.to_map(150.0, 150.0)))
    trees = replace(field, heights_m=field.heights_m + np.float32(25.0))
    config = PanoramaConfig(90.0, 120.0, 100.0)
    place_m = field.to_map(150.0, 150.0)
    eye = stand_on(field, **at_m(place_m), eye_height_m=100.0)
    view = panorama_view(field, eye, None, config, trees)
    landscape = view.landscape
    # Of the line between tenths of a degree, notches of the skyline are cut off.
    assert np.percentile(view.surface_deg - landscape.skyline_deg, [1, 50]).min() > 0.0
    eye = stand_on(trees, **at_m(place_m), eye_height_m=75.0)
    over = Landscape.of(trees, eye, landscape.azimuth_deg)
    assert np.abs(view.surface_deg - over.skyline_deg).mean() < 0.01
    line = draw_panorama(view)[0].axes[0].lines[0]
    np.testing.assert_array_equal(line.get_ydata(), view.surface_deg)
    path = tmp_path / "both.svg"
    save_panorama(field, path, lon=lonlat[0], lat=lonlat[1], config=config, surface=trees)
    assert "how far trees and houses may rise" in path.read_text("utf-8")


def test_the_most_prominent_peak_has_its_name_where_higher_knolls_crowd_it():
    """A mountain that stands alone, before a higher ridge with six knolls in a row on it."""
    row_m = 120.0 * np.array([-3, -2, -1, 1, 2, 3])

    def height(east, north):
        ridge = 1700.0 - 0.6 * np.abs(north - 9000.0)
        knolls = np.max([25.0 - 0.5 * np.hypot(east - at, north - 9000.0) for at in row_m], axis=0)
        alone = 1500.0 - 0.9 * np.hypot(east, north - 5000.0)
        return np.maximum(np.maximum(ridge + np.maximum(knolls, 0.0), alone), 0.0)

    field = field_from(height, 701, 40.0)
    names = (*(f"Knoll {index}" for index in range(6)), "Lonely Mountain")
    place_m = np.append(row_m, 0.0), np.array([9000.0] * 6 + [5000.0])
    peaks = Peaks(names=names, **at_m(place_m), height_m=np.full(7, np.nan))
    config = PanoramaConfig(0.0, 60.0, eye_height_m=1200.0)
    eye = stand_on(field, easting_m=0.0, northing_m=0.0, eye_height_m=1200.0)
    view = panorama_view(field, eye, peaks, config)
    assert len(view.sightings) == 7
    figure, unnamed = draw_panorama(view)
    named = [one.get_text() for one in figure.findobj(lambda one: one.get_gid() == SUMMIT)]
    assert sum(text.startswith("Lonely Mountain") for text in named) == 1
    assert len(named) < 7
    assert len(unnamed.no_room) == 7 - len(named)
    assert all(name.startswith("Knoll") for name in unnamed.no_room)
    assert f"{len(unnamed.no_room)} peaks have no room for a name" in figure.texts[0].get_text()
