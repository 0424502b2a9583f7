"""Screening: the right place whatever the roll, in blocks and in parts, and what narrows it."""

from dataclasses import replace

import numpy as np
import pytest
from place_scenes import AZIMUTH_DEG, Blocks, curve, photo, places_of, rays
from ray_scenes import equally_trusted

from skyline.angles import angle_between_deg
from skyline.match.prior import NOTHING_KNOWN
from skyline.match.screen import (
    Alike,
    Screen,
    gain_of,
    rescored,
    screen_places,
    turns_within,
    waves_of,
)
from skyline.store.places import decode_phases

FOVS_DEG = np.array([57.0, 60.0, 63.0])
every = NOTHING_KNOWN.contains


@pytest.fixture(scope="module")
def places():
    return places_of(np.stack([curve(seed, AZIMUTH_DEG) for seed in range(64)]))


def wide(seed, heading):
    return replace(rays(seed, heading), fov_range_deg=(55.0, 66.0))


@pytest.mark.parametrize("roll_deg", [-4.0, 0.0, 3.0])
def test_a_smooth_skyline_is_found_whatever_the_roll(roll_deg):
    # Taken to be level, 63 or 22 of the others are more like a camera rolled by -4 or 3 degrees.
    smooth = places_of(np.stack([0.1 * curve(seed, AZIMUTH_DEG) for seed in range(64)]))
    u, v = photo(lambda azimuth: 0.1 * curve(7, azimuth), 100.0, roll_deg=roll_deg)
    seen = equally_trusted(u, v, 60.0)
    screen = Screen(seen, np.array([60.0]), smooth)
    assert screen.scores(smooth.phase).argmax() == 7


@pytest.mark.parametrize(("height", "gain"), [(1.0, 1), (0.1, 2)])
def test_flat_skylines_are_compared_at_a_greater_gain(height, gain):
    """The rises deviate by 0.71 degrees, or by 0.07 where the curve is a tenth as high."""
    u, v = photo(lambda azimuth: height * curve(7, azimuth), 100.0)
    assert gain_of(equally_trusted(u, v, 60.0)) == gain


def test_a_photo_s_phases_grow_with_the_gain():
    seen = wide(7, 100.0)
    once, twice = waves_of(seen), waves_of(seen, 2)
    np.testing.assert_allclose(twice * np.abs(once), once**2)


def test_phases_are_decoded_at_a_gain():
    """Code 1 is half a step of 255 from 0, and code 0 unknown."""
    codes = np.array([[0, 1, 128]], dtype=np.uint8)
    expected = np.array([[0.0, np.exp(2j * np.pi / 255), np.exp(2j * np.pi)]])
    np.testing.assert_allclose(decode_phases(codes, 2), expected, atol=1e-6)


@pytest.mark.parametrize("size", [64, 7])
@pytest.mark.parametrize("count", [5, 200])
def test_blocks_change_nothing(places, size, count):
    screen = Screen(wide(11, 200.0), FOVS_DEG, places)
    score = screen.scores(places.phase)
    order = np.lexsort((np.arange(64), -score))[:count]
    found = screen_places(screen.scores, Blocks(places, size), count, every)
    np.testing.assert_array_equal(found.row, order)
    np.testing.assert_allclose(found.score, score[order], rtol=1e-5)


def test_places_of_equal_score_keep_their_order():
    """Of the four 3s the two in the first rows are left, 2 and 4."""
    row = np.array([8, 4, 6, 2, 0, 9])
    alike = Alike(row, np.array([3.0, 3.0, 3.0, 3.0, 5.0, 1.0], dtype=np.float32))
    assert alike.best(3).row.tolist() == [0, 2, 4]


def test_the_best_turn_has_the_field_of_view_that_fits_there(places):
    seen = wide(3, 100.0)
    alone = [Screen(seen, FOVS_DEG[k : k + 1], places) for k in range(3)]
    each = [screen.best_turns(places.phase, 1) for screen in alone]
    scores = np.hstack([one.score for one in each])
    found = Screen(seen, FOVS_DEG, places).best_turns(places.phase, 1)
    np.testing.assert_array_equal(found.fov_index[:, 0], scores.argmax(axis=1))
    # float32 of scores that reach a hundred.
    np.testing.assert_allclose(found.score[:, 0], scores.max(axis=1), atol=1e-4)
    of_fov = np.hstack([one.grid_heading_deg for one in each])
    expected = np.take_along_axis(of_fov, found.fov_index, axis=1)
    np.testing.assert_array_equal(found.grid_heading_deg, expected)


def test_an_unlikely_field_of_view_loses_its_penalty(places):
    seen, penalty = wide(3, 100.0), np.array([2.0, 0.0, 1.5])
    fovs = (FOVS_DEG[k : k + 1] for k in range(3))
    alone = [Screen(seen, fov, places).scores(places.phase) for fov in fovs]
    expected = (np.array(alone) - penalty[:, np.newaxis]).max(axis=0)
    scores = Screen(seen, FOVS_DEG, places, penalty=penalty).scores(places.phase)
    # float32 of scores that reach a hundred.
    np.testing.assert_allclose(scores, expected, atol=1e-4)


def test_only_places_within_are_looked_at(places):
    screen = Screen(wide(11, 200.0), FOVS_DEG, places)
    source, scores = Blocks(places, 8), screen.scores
    found = screen_places(scores, source, 64, lambda some: some.easting_m < 1000.0)
    assert sorted(found.row) == list(range(10))
    none = screen_places(scores, source, 64, lambda some: some.easting_m < -1.0)
    assert len(none) == 0


def test_shut_turns_are_not_looked_at(places):
    turns = turns_within(20.0, 15.0)
    screen = Screen(wide(11, 200.0), FOVS_DEG, places, turns)
    heading_deg = screen.best_turns(places.phase, 4).grid_heading_deg
    assert (angle_between_deg(heading_deg, 20.0) <= 17.0).all()


def test_a_coarse_screen_compares_a_level_camera_at_even_or_at_odd_turns(places):
    """A place whose phases have an odd sum is compared at the odd turns."""
    seen = wide(11, 200.0)
    coarse = Screen(seen, np.array([60.0]), places, coarse=True)
    waves = waves_of(seen.with_fov(60.0))
    place = decode_phases(places.phase)
    sums = np.stack(
        [(waves * np.roll(place, -turn, axis=1).conj()).sum(axis=1).real for turn in range(180)]
    )
    even = sums[::2]
    is_odd = places.phase.sum(axis=1) % 2 == 1
    assert 0 < is_odd.sum() < len(places)
    best = np.where(is_odd, sums[1::2].max(axis=0), even.max(axis=0))
    expected = (best - even.mean()) / even.std()
    np.testing.assert_allclose(coarse.scores(places.phase), expected, rtol=1e-3)


def test_a_coarse_screen_looks_beside_a_narrow_range_of_headings(places):
    """Of the turns within 1 degree of 21, each 2 degrees wide, some may not be compared."""
    coarse = Screen(wide(11, 200.0), FOVS_DEG, places, turns_within(21.0, 0.5), coarse=True)
    assert np.isfinite(coarse.scores(places.phase)).all()


def test_places_get_other_scores_in_their_order(places):
    screen = Screen(wide(11, 200.0), FOVS_DEG, places)
    rows = np.array([3, 11, 40, 5])
    found = rescored(screen.scores, Blocks(places, 7), rows)
    np.testing.assert_allclose(found, screen.scores(places.phase)[rows], rtol=1e-5)


def test_no_place_gets_no_score(places):
    screen = Screen(wide(11, 200.0), FOVS_DEG, places)
    assert len(rescored(screen.scores, places, np.zeros(0, dtype=np.intp))) == 0
