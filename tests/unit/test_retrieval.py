"""Retrieval: poses found back among places."""

import os
import threading
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from place_scenes import AZIMUTH_DEG, curve, photo, places_of, rays
from ray_scenes import equally_trusted, swept

from skyline.match.joined_shards import JoinedShards
from skyline.match.lens_prior import LensPrior
from skyline.match.narrowing import Narrowing
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.retrieval import NoPlaceError, RetrievalEffort, Retriever
from skyline.match.shard import LocalShard

TWO_PLACES = RetrievalEffort(
    first_places=2, last_least=2, last_most=2, good_least=2, screened_again=20
)
"""Short lists of two places."""


@pytest.fixture(scope="module")
def places():
    return places_of(np.stack([curve(seed, AZIMUTH_DEG) for seed in range(40)]))


def retriever_of(places, ground=None, effort=None):
    return Retriever(JoinedShards([[LocalShard(places, ground)]]), effort)


def turned(heading_deg, other_deg):
    return abs((heading_deg - other_deg + 180.0) % 360.0 - 180.0)


@given(
    seed=st.integers(0, 39),
    heading=st.floats(0.0, 360.0),
    pitch=st.floats(-5.0, 5.0),
    roll=st.floats(-5.0, 5.0),
)
@settings(max_examples=25)
def test_a_pose_is_found_back_whatever_the_heading(places, seed, heading, pitch, roll):
    found = retriever_of(places).shortlist(rays(seed, heading, pitch_deg=pitch, roll_deg=roll), 3)
    assert abs(found.easting_m[0] - 100.0 * seed) < 50.0
    assert turned(found.grid_heading_deg[0], heading) < 0.3
    assert found.pitch_deg[0] == pytest.approx(pitch, abs=0.3)
    assert found.roll_deg[0] == pytest.approx(roll, abs=0.3)
    assert found.fov_deg[0] == 60.0
    assert (np.diff(found.cost) >= 0.0).all()


def test_the_field_of_view_is_found_within_its_range_and_never_outside(places):
    true = rays(5, 30.0)
    wrong = true.with_fov(63.0)
    seen = replace(wrong, fov_deg=63.0, fov_range_deg=(57.0, 66.0))
    found = retriever_of(places).shortlist(seen, 5)
    assert found.easting_m[0] == pytest.approx(500.0, abs=50.0)
    assert found.fov_deg[0] == pytest.approx(60.0, abs=0.5)
    narrow = replace(wrong, fov_deg=63.0, fov_range_deg=(61.0, 66.0))
    found = retriever_of(places).shortlist(narrow, 5)
    assert ((found.fov_deg >= 61.0) & (found.fov_deg <= 66.0)).all()


def test_the_eye_follows_the_ground():
    y = np.stack([curve(3, AZIMUTH_DEG)])
    retriever = retriever_of(places_of(y, 500.0), lambda east, north: 0.3 * east - 0.2 * north)
    found = retriever.shortlist(rays(3, 77.0), 1)
    expected = 1000.0 + 0.3 * found.easting_m - 0.2 * found.northing_m
    np.testing.assert_allclose(found.eye_elevation_m, expected, atol=1e-3)


def test_a_place_between_entries_is_found():
    # Walls around a square 800 m wide, with battlements; the eye stands off its middle.
    def wall(east, north, azimuth_deg):
        azimuth = np.radians(azimuth_deg)
        gaps = np.array([[400.0 - north], [400.0 - east], [400.0 + north], [400.0 + east]])
        ahead = np.cos(azimuth - np.arange(4)[:, np.newaxis] * np.pi / 2)
        distance = (gaps / np.where(ahead > 1e-6, ahead, 1e-30)).min(axis=0)
        x, z = east + distance * np.sin(azimuth), north + distance * np.cos(azimuth)
        height = 120.0 + 8.0 * np.sin(x / 23.0) + 8.0 * np.cos(z / 31.0)
        return height / distance, distance

    heading_deg = 300.0
    y, distance_m = wall(0.0, 0.0, AZIMUTH_DEG)
    # Its tolerance makes a move of 20 m one standard deviation.
    entry = places_of(y[np.newaxis], distance_m, tolerance_m=20.0 * np.sqrt(3.0))
    # A view this wide holds walls at several distances, which separate a move from a turn.
    u, v = photo(lambda azimuth: wall(12.0, -9.0, azimuth)[0], heading_deg, fov_deg=100.0)
    found = retriever_of(entry).shortlist(equally_trusted(u, v, 100.0), 1)
    # The eye is 15 m from the place. What is left of that is the first order's error, and that
    # of corners cut by steps of a degree.
    assert np.hypot(found.easting_m[0] - 12.0, found.northing_m[0] + 9.0) < 6.0
    assert turned(found.grid_heading_deg[0], heading_deg) < 0.7


def test_a_near_place_that_fits_comes_before_far_ones_that_fit_worse():
    # How far the fit may be wrong about near terrain weighs its columns, not the place.
    noise = np.random.default_rng(1).normal(0.0, np.radians(0.2), len(AZIMUTH_DEG))
    right = curve(3, AZIMUTH_DEG)
    distance_m = np.array([[20.0], [20_000.0]])
    entries = places_of(np.stack([right, right + noise]), distance_m, spacing_m=1000.0)
    found = retriever_of(entries).shortlist(rays(3, 77.0), 2)
    assert found.easting_m[0] == pytest.approx(0.0, abs=25.0)


def test_missing_headings_do_not_stop_the_others():
    y = np.stack([curve(seed, AZIMUTH_DEG) for seed in range(20)])
    y[:, 225:] = np.nan
    found = retriever_of(places_of(y)).shortlist(rays(4, 100.0), 1)
    assert found.easting_m[0] == pytest.approx(400.0, abs=50.0)
    assert turned(found.grid_heading_deg[0], 100.0) < 0.3


def many(count):
    """Return places with 40 different skylines in turn."""
    return places_of(
        np.stack([curve(seed, AZIMUTH_DEG) for seed in range(40)])[np.arange(count) % 40]
    )


def numbers(poses):
    """Return the numbers of the places that poses are nearest to."""
    return set(np.rint(poses.easting_m / 100.0))


def within_m(radius_m):
    """Return a search that is narrowed to places near the first one."""
    return Prior(circles_m=((0.0, 0.0, radius_m),))


@pytest.mark.parametrize(("kept", "in_last"), [(100, {3, 43, 83}), (2, {3, 43})])
def test_the_poses_of_earlier_lists_compete_again_in_later_ones(kept, in_last):
    """Three of 120 places are like the photo alike: the first list is of two, the last of three.

    Places of equal scores come in their order.
    """
    effort = replace(TWO_PLACES, last_least=3, last_most=3, beside=1)
    first, last = retriever_of(many(120), effort=effort).shortlists(rays(3, 78.0), kept)
    assert numbers(first) == {3, 43}
    assert numbers(last) == in_last


@pytest.mark.parametrize(("places", "lists"), [(1, 1), (2048, 1), (2049, 2), (2200, 2)])
def test_places_beyond_the_first_list_make_another(places, lists):
    """Places are 100 m apart, so 204,750 m reach the 2048th one."""
    prior = within_m(100.0 * places - 50.0)
    found = list(retriever_of(many(2300)).shortlists(rays(3, 77.0), 5, prior))
    assert len(found) == lists
    assert all(prior.contains(poses).all() for poses in found)


def test_every_place_of_a_narrow_search_is_fitted(places):
    found = retriever_of(places).shortlist(rays(1, 77.0), 100, within_m(250.0))
    assert numbers(found) == {0, 1, 2}
    assert numbers(found[:1]) == {1}


def test_a_narrow_range_of_headings_repeats_no_fit():
    """Of the 1024 good fits of the first list, 552 had places of their own when some repeated."""
    prior = Prior(Narrowing(heading_deg=(257.0, 1e-3)))
    first = next(retriever_of(many(2300)).shortlists(rays(3, 77.0), 5000, prior))
    assert len(np.unique(np.rint(first.easting_m / 100.0))) > 800


def test_a_known_place_is_fitted_from_every_heading(places):
    """Headings are 3 degrees apart: 120 of each of 2 places."""
    assert len(retriever_of(places[:2]).fitted_all_round(rays(1, 77.0))) == 240


def test_a_search_of_no_place_is_refused(places):
    far_off = Prior(circles_m=((-900.0, 0.0, 99.0),))
    with pytest.raises(NoPlaceError, match="no place of the store"):
        next(retriever_of(places).shortlists(rays(3, 77.0), 5, far_off))


def test_a_panorama_all_the_way_round_is_found(places):
    """Its field of view is exact, so its deviation is not known: it is infinite."""
    seen = swept(lambda azimuth: curve(7, np.degrees(azimuth)), 130.0, 0.0, 360.0)
    found = retriever_of(places).shortlist(seen, 3)
    assert found.easting_m[0] == pytest.approx(700.0, abs=50.0)
    assert turned(found.grid_heading_deg[0], 130.0) < 0.3
    assert found.fov_deg[0] == 360.0


def test_photos_of_one_eye_share_their_places(places):
    west = Prior(Narrowing(heading_deg=(250.0, 1.0)))
    photos = [(rays(7, 30.0), NOTHING_KNOWN), (rays(7, 250.0), west)]
    one, other = retriever_of(places).shortlist_together(photos, 5)
    assert len(one) == len(other) == 5
    np.testing.assert_array_equal(one.easting_m, other.easting_m)
    np.testing.assert_array_equal(one.cost, other.cost)
    assert one.easting_m[0] == pytest.approx(700.0, abs=50.0)
    assert turned(one.grid_heading_deg[0], 30.0) < 0.3
    assert turned(other.grid_heading_deg[0], 250.0) < 0.3


def test_threads_change_nothing(monkeypatch):
    seen = replace(rays(3, 77.0), fov_range_deg=(50.0, 70.0), lens=LensPrior(0.08))
    places = many(2300)

    def costs(threads):
        monkeypatch.setattr(os, "cpu_count", lambda: threads)
        return [poses.cost for poses in retriever_of(places).shortlists(seen, 20)]

    for one, several in zip(costs(1), costs(5), strict=True):
        np.testing.assert_array_equal(one, several)


def test_fits_climb_to_places_beside_that_screening_passed_over(places):
    """Screening passes two places on. Beside the better one are three to the west and three to the
    east."""
    effort = replace(TWO_PLACES, first_places=1)
    # The coarse screen compares this place at odd turns, and the heading is one.
    first, last = retriever_of(places, effort=effort).shortlists(rays(10, 79.0), 100)
    assert numbers(first) == {10}
    assert numbers(last) >= {7, 8, 9, 10, 11, 12, 13}


@pytest.mark.parametrize("reports", [1, 2, 5])
def test_a_search_ends_where_its_report_raises(reports):
    """The 1st report is of screening, the 2nd and 3rd of the first list, the 5th of the second."""
    before = threading.active_count()
    said = []

    def report(step, share):
        said.append(step)
        if len(said) == reports:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(retriever_of(many(2300)).shortlists(rays(3, 77.0), 5, report=report))
    assert len(said) == reports
    assert threading.active_count() == before


def test_places_in_several_shards_are_found_as_in_one():
    """Each shard of 2300 places has a part of every list; all numbers are equal to the bit."""
    places = many(2300)
    whole = list(retriever_of(places).shortlists(rays(3, 77.0), 50))
    cuts = [slice(0, 7), slice(7, 1500), slice(1500, 2300)]
    shards = [LocalShard(places[cut]) for cut in cuts]
    parts = list(Retriever(JoinedShards([shards])).shortlists(rays(3, 77.0), 50))
    assert len(parts) == len(whole) == 2
    for one, other in zip(parts, whole, strict=True):
        for name, column in one.columns().items():
            np.testing.assert_array_equal(column, getattr(other, name))
