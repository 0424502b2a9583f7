"""Stores made dense: the lattice, where its predictions come from, and that they are right."""

from dataclasses import replace

import numpy as np
import pytest
from prediction_scenes import views_of
from scenes import field_of, fractal

from skyline import oracle
from skyline.camera import columns_u
from skyline.errors import InputError
from skyline.features import NO_KEYPOINT
from skyline.matching import Profiles
from skyline.matching.dense import (
    UNKNOWN_Y,
    Y_STEP,
    DenseProfiles,
    DensifyConfig,
    densify,
)
from skyline.terrain.viewpoints import stand_on

WIDTH = 160
U = columns_u(WIDTH)
CONFIG = DensifyConfig(pitch_m=50.0, bins=360, columns=WIDTH)
STORED_ONLY = DensifyConfig(pitch_m=np.inf, bins=360, columns=WIDTH)


def flat_ground(easting_m, northing_m):
    return np.zeros(np.broadcast(easting_m, northing_m).shape)


def panorama(east=0.0, north=0.0, tan=0.1, depth_m=3000.0, headings=(0, 1, 2, 3)):
    """Make the views of one eye 2 m above flat ground."""
    rows = np.full((len(headings), WIDTH), tan)
    return views_of(rows, depth_m, list(headings), east, north, 2.0)


def plain(views, bins):
    return Profiles.from_views([(views, np.full((len(views), 1), NO_KEYPOINT, np.uint16))], bins)


@pytest.fixture(scope="module")
def rough():
    """Rough terrain and the views of nine eyes 150 m apart."""
    field = field_of(fractal(96, 96, 400.0, seed=5))
    east, north = np.meshgrid([1300.0, 1450.0, 1600.0], [-1300.0, -1450.0, -1600.0])
    eyes = stand_on(field, east.ravel(), north.ravel())
    return field, oracle.skyline(field, eyes, WIDTH)


def test_stored_eyes_come_first_and_keep_their_skylines(rough):
    field, views = rough
    dense = densify([views], field.height_at, CONFIG)
    expected = plain(views, CONFIG.bins)
    np.testing.assert_array_equal(dense.easting_m[:9], expected.easting_m)
    np.testing.assert_array_equal(dense.eye_elevation_m[:9], expected.eye_elevation_m)
    difference = np.abs(dense.y(slice(9)) - expected.y)
    # Skylines right at the feet, nearer than predictions go, are the exception.
    assert (difference < 2.0 * Y_STEP).mean() > 0.97


def test_the_lattice_is_shared_and_stands_on_the_ground(rough):
    field, views = rough
    dense = densify([views], field.height_at, CONFIG)
    east, north = dense.easting_m[9:], dense.northing_m[9:]
    np.testing.assert_array_equal(np.stack([east, north]) % 50.0, 0.0)
    np.testing.assert_allclose(dense.eye_elevation_m[9:], field.height_at(east, north) + 2.0)
    # Half a spacing beyond the outermost eyes, less the points where eyes stand.
    assert {east.min(), east.max()} == {1250.0, 1650.0}
    assert len(dense) == 9 * 9


def test_progress_ends_where_it_said_it_would(rough):
    field, views = rough
    told = []
    densify([views], field.height_at, CONFIG, progress=lambda *step: told.append(step))
    assert [done for done, _ in told] == sorted({done for done, _ in told})
    assert told[-1][0] == told[-1][1] == 9 * CONFIG.sources


def test_the_lattice_fills_the_area_it_is_given(rough):
    field, views = rough
    dense = densify([views], field.height_at, CONFIG, area_m=(1020.0, -1900.0, 1700.0, -1300.0))
    east, north = dense.easting_m[9:], dense.northing_m[9:]
    assert (east.min(), east.max()) == (1050.0, 1700.0)
    assert (north.min(), north.max()) == (-1900.0, -1300.0)
    assert len(dense) == 14 * 13


def test_the_area_reaches_no_farther_than_predictions(rough):
    field, views = rough
    near = replace(CONFIG, reach_m=80.0)
    dense = densify([views], field.height_at, near, area_m=(0.0, -2000.0, 2000.0, 0.0))
    lattice, eyes = (
        np.stack([dense.easting_m[part], dense.northing_m[part]], axis=1)
        for part in (slice(9, None), slice(9))
    )
    apart_m = np.linalg.norm(lattice[:, np.newaxis] - eyes, axis=2).min(axis=1)
    assert 60.0 < apart_m.max() <= 80.0


def test_predictions_are_nearer_to_the_truth_than_the_nearest_stored_skyline(rough):
    field, views = rough
    dense = densify([views], field.height_at, CONFIG)
    inner = np.arange(9, len(dense))[::7]
    eyes = stand_on(field, dense.easting_m[inner], dense.northing_m[inner])
    truth_views = oracle.skyline(field, eyes, WIDTH)
    truth = plain(truth_views, CONFIG.bins)
    order = np.lexsort((dense.northing_m[inner], dense.easting_m[inner]))
    nearest = np.hypot(
        truth.easting_m[:, np.newaxis] - dense.easting_m[:9],
        truth.northing_m[:, np.newaxis] - dense.northing_m[:9],
    ).argmin(axis=1)
    predicted = np.nanmedian(np.abs(dense.y(inner[order]) - truth.y))
    stored = np.nanmedian(np.abs(dense.y(nearest) - truth.y))
    assert predicted < 0.5 * stored


def test_chunks_and_their_order_do_not_matter(rough):
    field, views = rough
    order = np.random.default_rng(0).permutation(len(views))
    one = densify([views], field.height_at, CONFIG)
    many = densify((views[order[k : k + 5]] for k in range(0, 36, 5)), field.height_at, CONFIG)
    np.testing.assert_array_equal(one.easting_m, many.easting_m)
    np.testing.assert_array_equal(one.y_steps, many.y_steps)
    np.testing.assert_array_equal(one.distance, many.distance)


def test_each_heading_comes_from_the_nearest_view_of_that_heading():
    views = type(panorama()).concatenate(
        [panorama(0.0, tan=0.1, headings=(0, 1)), panorama(100.0, tan=0.3, headings=(1, 2, 3))]
    )
    dense = densify([views], flat_ground, STORED_ONLY)
    bins = STORED_ONLY.bins
    middle = dense.y()[:, np.arange(4) * bins // 4]
    far = 3000.0
    # East of the western eye is its own; its south and west come from the eastern eye.
    assert middle[0, 0] == pytest.approx(0.1, abs=1e-3)
    assert middle[0, 1] == pytest.approx(0.1, abs=1e-3)
    assert middle[0, 2] == pytest.approx(0.3, abs=1e-3)
    assert middle[0, 3] == pytest.approx(0.3 * far / (far - 100.0), abs=1e-3)
    assert middle[1, 0] == pytest.approx(0.1, abs=1e-3)
    assert middle[1, 1] == pytest.approx(0.3, abs=1e-3)


def test_what_several_views_predict_is_joined_by_its_upper_envelope(rough):
    field, views = rough
    near, joined = (
        densify([views], field.height_at, replace(CONFIG, sources=count)) for count in (1, 3)
    )
    stored = len(np.unique(np.stack([views.easting_m, views.northing_m]), axis=1).T)
    np.testing.assert_array_equal(joined.y_steps[:stored], near.y_steps[:stored])
    assert (joined.y_steps >= near.y_steps).all()
    assert (joined.y_steps[stored:] > near.y_steps[stored:]).any()
    same = joined.y_steps == near.y_steps
    np.testing.assert_array_equal(joined.distance[same], near.distance[same])


def test_headings_out_of_reach_are_unknown():
    config = DensifyConfig(pitch_m=np.inf, bins=360, columns=WIDTH, reach_m=300.0)
    views = type(panorama()).concatenate(
        [panorama(0.0, headings=(0, 1, 2)), panorama(1000.0, headings=(0, 1, 2, 3))]
    )
    dense = densify([views], flat_ground, config)
    west = np.arange(230, 310)
    assert (dense.y_steps[0, west] == UNKNOWN_Y).all()
    assert np.isnan(dense.y()[0, west]).all()
    assert np.isfinite(dense.y()[1]).all()
    assert np.isfinite(dense.y()[0, :130]).all()


def test_distances_are_horizontal():
    dense = densify([panorama(depth_m=1000.0)], flat_ground, STORED_ONLY)
    azimuth = np.radians((np.arange(360) + 45) % 90 - 45)
    np.testing.assert_allclose(dense.distance_m()[0], 1000.0 / np.cos(azimuth), rtol=0.07)


def test_holes_are_left_out_and_have_no_slope():
    def ground(easting_m, northing_m):
        return np.where(np.asarray(easting_m) > 20.0, np.nan, 0.5 * np.asarray(northing_m))

    config = DensifyConfig(pitch_m=50.0, bins=360, columns=WIDTH, reach_m=120.0)
    dense = densify([panorama()], ground, config)
    assert len(dense) > 1
    assert dense.easting_m.max() <= 20.0
    np.testing.assert_allclose(dense.ground_slope[:, 1], 0.5)
    assert (dense.ground_slope[:, 0] == 0.0).all()


def test_without_a_ground_eyes_stand_as_high_as_the_stored_ones():
    dense = densify([panorama()], None, DensifyConfig(bins=360, columns=WIDTH, reach_m=120.0))
    assert len(dense) > 9
    np.testing.assert_allclose(dense.eye_elevation_m, 2.0)


def test_dense_profiles_are_taken_apart():
    dense = densify([panorama()], flat_ground, DensifyConfig(bins=360, reach_m=120.0))
    part = dense[np.array([3, 1])]
    assert isinstance(part, DenseProfiles)
    np.testing.assert_array_equal(part.y(), dense.y()[[3, 1]])


@pytest.mark.parametrize(
    "options", [{"pitch_m": 0.0}, {"reach_m": -1.0}, {"bins": 12}, {"columns": 2}, {"sources": 0}]
)
def test_senseless_configurations_are_refused(options):
    with pytest.raises(InputError, match="expected"):
        DensifyConfig(**options)


def test_an_empty_store_is_refused():
    with pytest.raises(InputError, match="no views"):
        densify([], flat_ground)
