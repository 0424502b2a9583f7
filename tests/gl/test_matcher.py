"""The full matcher, from a store to an answer or a refusal."""

import math
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from photo_scenes import in_haze
from place_scenes import AZIMUTH_DEG, curve, places_of, rays
from scenes import NORTH_M, WEST_M, at_deg

from skyline import MatchConfig, Matcher, Narrowing, build_places, horizon
from skyline.angles import angle_between_deg
from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.match.prior import NOTHING_KNOWN
from skyline.match.refine import QUICK, WHOLE
from skyline.match.search import FullMatcher, SearchedArea, SearchEffort
from skyline.match.shard import LocalShard
from skyline.match.solver import TEMPERATURE
from skyline.photo.noted_place import NotedPlace
from skyline.photo.read import read_skyline
from skyline.photo.skyline import Lens, PhotoSkyline
from skyline.progress import Step
from skyline.render.horizon import RenderConfig, RenderedScene
from skyline_bench.queries.synthetic import QueryConfig, make_queries, make_queries_together

MIDDLE = (WEST_M + 3600.0, NORTH_M - 4800.0, WEST_M + 4800.0, NORTH_M - 3600.0)
SHARP = QueryConfig(max_tilt_deg=3.0, noise_deg=(0.03, 0.03), smooth_share=0.0)
BOLD = MatchConfig(min_confidence=0.0)
PLACES_M = 40.0


@pytest.fixture(scope="module")
def bounds_deg(terrain):
    lon, lat = terrain.frame.to_lonlat(MIDDLE[::2], MIDDLE[1::2])
    return float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])


@pytest.fixture(scope="module")
def store(tmp_path_factory, terrain, bounds_deg):
    path = tmp_path_factory.mktemp("store") / "store.h5"
    build_places(terrain, path, PLACES_M, bounds_deg)
    return path


@pytest.fixture(scope="module")
def queries(terrain):
    return make_queries(terrain, MIDDLE, 6, seed=3, config=SHARP)


def error_m(candidate, truth):
    return np.hypot(candidate.easting_m - truth.easting_m, candidate.northing_m - truth.northing_m)


def test_queries_are_found_where_they_were_taken(store, terrain, queries):
    with Matcher(store, terrain, config=BOLD) as matcher:
        found = [matcher.match(query.skyline) for query in queries]
    off_m = [error_m(one.answer, query.truth) for one, query in zip(found, queries, strict=True)]
    assert np.median(off_m) < 10.0
    for one, query, off in zip(found, queries, off_m, strict=True):
        best = one.answer
        assert best.refined
        assert 0.0 < best.confidence < 1.0
        if off < 10.0:
            assert np.linalg.eigvalsh(best.covariance_m2).min() > 0.0
            assert angle_between_deg(best.grid_heading_deg, query.truth.grid_heading_deg) < 1.0


def test_too_little_skyline_is_refused(store, terrain, queries):
    skyline = queries[0].skyline
    row_px = np.where(np.arange(640) < 150, np.nan_to_num(skyline.row_px, nan=300.0), np.nan)
    little = replace(skyline, row_px=row_px, trust=np.isfinite(row_px) * 1.0, fov_deg=60.0)
    result = Matcher(store, terrain).match(little)
    assert result.answer is None
    assert result.candidates == ()
    assert "degrees of skyline" in result.refusal


def test_nothing_fits_a_skyline_of_almost_no_width(store, terrain, queries):
    lens = Lens(1.0, 104.0, 360.0)
    strip = replace(queries[0].skyline, fov_deg=1.0, lens=lens, projection=Projection.CYLINDRICAL)
    with Matcher(store, terrain) as matcher:
        result = matcher.match(strip)
    assert (result.candidates, result.refusal) == ((), "no place fits")


def test_a_direction_in_which_nothing_was_seen_has_no_place(store, terrain, queries):
    away_deg = (queries[0].truth.grid_heading_deg + 180.0) % 360.0
    away = Narrowing(heading_deg=(away_deg, 1e-6))
    with Matcher(store, terrain) as matcher:
        result = matcher.match(queries[0].skyline, narrowing=away)
    assert (result.candidates, result.refusal) == ((), "no place fits")


def test_a_photo_that_notes_a_place_far_from_the_store_is_searched(store, terrain, queries):
    lon, lat = terrain.frame.to_lonlat(WEST_M + 60_000.0, NORTH_M)
    noted = NotedPlace(lonlat_deg=(float(lon), float(lat)))
    with Matcher(store, terrain, config=BOLD) as matcher:
        best = matcher.match(replace(queries[0].skyline, noted=noted)).answer
    assert error_m(best, queries[0].truth) < 10.0


def test_an_unknown_field_of_view_is_searched(store, terrain, queries):
    skyline = replace(queries[1].skyline, fov_deg=None)
    best = Matcher(store, terrain, config=BOLD).match(skyline).answer
    assert error_m(best, queries[1].truth) < 50.0
    assert best.fov_deg == pytest.approx(60.0, abs=2.0)


def test_a_panorama_of_unknown_field_of_view_is_refused(store, terrain, queries):
    skyline = replace(queries[1].skyline, fov_deg=None, projection=Projection.CYLINDRICAL)
    with pytest.raises(InputError, match="--fov-deg"):
        Matcher(store, terrain, config=BOLD).match(skyline)


def panorama_of(seen, heading_deg, projection, fov_deg, said_deg, sag_deg, raised_deg):
    """Return a panorama of a horizon, and the turns and elevation angles of its columns."""
    width = 1800
    turn_deg = fov_deg * ((np.arange(width) + 0.5) / width - 0.5)
    elevation_deg = np.interp(
        heading_deg + turn_deg, seen.azimuth_deg, seen.elevation_deg, period=360.0
    )
    up = np.radians(elevation_deg - raised_deg)
    if projection == "cylindrical":
        up = np.tan(np.radians(elevation_deg)) - np.tan(np.radians(raised_deg))
    # The rows wander as no turn of the camera explains, and not by polynomials.
    across = np.linspace(-1.0, 1.0, width)
    up -= np.radians(sag_deg) * (across**2 + 0.5 * np.sin(4.0 * across + 1.0))
    row_px = 400.0 - width / np.radians(fov_deg) * up
    query = PhotoSkyline(row_px, np.ones(width), width, 801, said_deg, Projection(projection))
    return query, turn_deg, elevation_deg


@pytest.mark.slow
@pytest.mark.parametrize(
    ("projection", "fov_deg", "said_deg", "sag_deg", "raised_deg"),
    [
        ("cylindrical", 200.0, 203.0, 2.0, 3.0),
        ("cylindrical", 360.0, 360.0, 0.0, 3.0),
        ("equirectangular", 230.0, 228.0, 0.0, 20.0),
    ],
)
def test_a_panorama_that_sees_behind_is_found(
    store, terrain, projection, fov_deg, said_deg, sag_deg, raised_deg
):
    east, north = 0.5 * (MIDDLE[0] + MIDDLE[2]) + 137.0, 0.5 * (MIDDLE[1] + MIDDLE[3]) - 211.0
    seen = horizon(terrain, **at_deg(terrain.frame.to_lonlat(east, north)))
    heading_deg = 250.0
    query, turn_deg, elevation_deg = panorama_of(
        seen, heading_deg, projection, fov_deg, said_deg, sag_deg, raised_deg
    )
    best = Matcher(store, terrain, config=BOLD).match(query).answer
    assert np.hypot(best.easting_m - east, best.northing_m - north) < 10.0
    assert best.heading_deg == pytest.approx(heading_deg, abs=0.2)
    assert best.fov_deg == pytest.approx(fov_deg, abs=0.5)
    assert best.pitch_deg == pytest.approx(raised_deg, abs=0.1 + sag_deg)
    elevation_tan = np.tan(np.radians(elevation_deg))
    _, drawn_px = best.camera(query).pixels(best.grid_heading_deg + turn_deg, elevation_tan)
    off_deg = np.abs(drawn_px - query.row_px) * fov_deg / query.width_px
    assert np.median(off_deg) < 0.1
    assert off_deg.max() < 0.4


BARE = PhotoSkyline(np.full(8, np.nan), np.zeros(8), 8, 8, 60.0)
"""A photo without a skyline."""


@pytest.fixture(scope="module")
def photos_of_two_places(terrain):
    """Two photos of each of two places."""
    return make_queries_together(terrain, MIDDLE, 2, 2, 5, SHARP)


def test_photos_of_one_place_have_one_answer_and_a_stranger_is_named(
    store, terrain, photos_of_two_places
):
    (first, second), (stranger, _) = photos_of_two_places
    photos = [first.skyline, stranger.skyline, second.skyline, BARE]
    with Matcher(store, terrain, config=BOLD) as matcher:
        found = matcher.match_together(photos, top=3)
    assert found.agrees == (True, False, True, False)
    assert found.answer is found.candidates[0]
    # Also a place where no photo fits is known no better than its skyline tells.
    assert min(place.radius_m for place in found.candidates) > 0.5
    within_m = 3.0 * np.sqrt(np.trace(found.answer.covariance_m2))
    # Costs, and so precisions, count less by the temperature.
    assert error_m(found.answer, first.truth) < within_m < 60.0 * np.sqrt(TEMPERATURE)
    one, other, another, nothing = found.results
    assert [len(some.candidates) for some in (other, nothing)] == [0, 0]
    assert "does not fit where the others" in other.refusal
    assert "degrees of skyline are visible" in nothing.refusal
    for mine, query in ((one, first), (another, second)):
        assert angle_between_deg(mine.answer.grid_heading_deg, query.truth.grid_heading_deg) < 1.0
    for name in ("lon", "lat", "radius_m", "confidence", "eye_elevation_m"):
        assert getattr(one.answer, name) == pytest.approx(getattr(another.answer, name))


def test_one_photo_is_no_photos_of_one_place(store, terrain, photos_of_two_places):
    first = photos_of_two_places[0][0].skyline
    with (
        Matcher(store, terrain, config=BOLD) as matcher,
        pytest.raises(InputError, match="expected two photos"),
    ):
        matcher.match_together([first])


def test_one_photo_with_a_skyline_among_two_has_no_answer(store, terrain, photos_of_two_places):
    first = photos_of_two_places[0][0].skyline
    with Matcher(store, terrain, config=BOLD) as matcher:
        little = matcher.match_together([first, BARE])
    assert (little.answer, little.candidates) == (None, ())
    assert "fewer than two photos" in little.refusal
    assert "no other photo shows enough skyline" in little.results[0].refusal


def test_a_narrowing_of_one_photo_holds_for_the_place(store, terrain):
    ((first, second),) = make_queries_together(terrain, MIDDLE, 1, 2, 5, SHARP)
    lon, lat = terrain.frame.to_lonlat(first.truth.easting_m + 500.0, first.truth.northing_m)
    near = Narrowing(near=(float(lon), float(lat), 0.3))
    skylines = [first.skyline, second.skyline]
    with Matcher(store, terrain, config=BOLD) as matcher:
        found = matcher.match_together(skylines, narrowings=[None, near])
    there = replace(first.truth, easting_m=first.truth.easting_m + 500.0)
    assert all(error_m(place, there) < 301.0 for place in found.candidates)


def test_photos_of_one_place_are_not_matched_without_rendering(
    store, terrain, photos_of_two_places
):
    skylines = [query.skyline for query in photos_of_two_places[0]]
    with (
        Matcher(store, terrain, config=replace(BOLD, refine=False)) as matcher,
        pytest.raises(InputError, match="this needs rendering: use the full matcher"),
    ):
        matcher.match_together(skylines)


@pytest.mark.parametrize(("margin", "lists"), [(-math.inf, 1), (math.inf, 2)])
def test_a_sure_answer_of_the_first_short_list_ends_the_search(terrain, monkeypatch, margin, lists):
    """The first list is of 2048 of the 2100 places; each is refined once it is fitted."""
    effort = SearchEffort(whole=QUICK, sure_margin=margin)
    monkeypatch.setattr(FullMatcher, "effort", effort)
    steps = []
    skylines = np.stack([curve(seed % 40, AZIMUTH_DEG) for seed in range(2100)])
    places = places_of(skylines, spacing_m=0.5)
    places = replace(
        places,
        easting_m=MIDDLE[0] + places.easting_m,
        northing_m=MIDDLE[1] + places.northing_m,
    )
    scene = RenderedScene(terrain, RenderConfig(360))
    matcher = FullMatcher([SearchedArea([LocalShard(places)], terrain.frame, scene)])
    matcher.found(rays(3, 77.0), NOTHING_KNOWN, lambda step, share: steps.append(step))
    scene.close()
    assert [step for step, _ in groupby(steps)] == ["screening", *["fitting", "refining"] * lists]


def test_a_large_area_is_searched_again_around_its_best_answers(
    store, terrain, queries, monkeypatch
):
    """The first refinement renders one pose and does not move it; places are 40 m apart."""
    hasty = replace(WHOLE, shortlist=1, rounds=1, restarts=0, final_rounds=0)

    def errors_m(large_area):
        effort = SearchEffort(whole=hasty, sure_margin=math.inf, large_area=large_area)
        monkeypatch.setattr(FullMatcher, "effort", effort)
        with Matcher(store, terrain, config=BOLD) as matcher:
            found = [matcher.match(query.skyline).best for query in queries]
        return [error_m(pose, query.truth) for pose, query in zip(found, queries, strict=True)]

    assert max(errors_m(math.inf)) > PLACES_M
    assert max(errors_m(0)) < 0.5 * PLACES_M


def test_the_search_around_the_best_answers_is_the_last_step_and_reported_by_answer(
    store, terrain, queries, monkeypatch
):
    effort = SearchEffort(sure_margin=math.inf, large_area=0, surroundings_km=0.05)
    monkeypatch.setattr(FullMatcher, "effort", effort)
    reports = []
    with Matcher(store, terrain, config=BOLD) as matcher:
        matcher.match(queries[0].skyline, report_progress=lambda *report: reports.append(report))
    shares = [share for step, share in reports if step == Step.SURROUNDINGS]
    assert shares == pytest.approx([0.0, 1 / 3, 2 / 3])
    assert [step for step, _ in reports[-3:]] == [Step.SURROUNDINGS] * 3


def test_the_number_of_candidates_changes_none_of_them(store, terrain, queries):
    with Matcher(store, terrain, config=BOLD) as matcher:
        few, some, many = (matcher.match(queries[0].skyline, top=top) for top in (1, 2, 30))
        assert few.candidates == many.candidates[:1]
        assert some.candidates == many.candidates[:2]
        assert [one.rank for one in many.candidates][:3] == [1, 2, 3]
        with pytest.raises(InputError, match="top is 0"):
            matcher.match(queries[0].skyline, top=0)


def test_a_skyline_in_haze_is_searched_where_the_rocks_before_it_fit_nowhere(
    store, terrain, queries
):
    query = queries[2]
    skyline = read_skyline(in_haze(query.skyline), query.skyline.fov_deg)
    with Matcher(store, terrain) as matcher:
        found = matcher.match(skyline)
        drawn = matcher.match(replace(skyline, is_drawn=True))
    assert error_m(found.answer, query.truth) < 30.0
    assert drawn.answer is None
    assert error_m(drawn.best, query.truth) > 300.0
