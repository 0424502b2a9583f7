"""The full matcher, from a store to an answer or a refusal."""

import logging
import sys
from dataclasses import replace

import numpy as np
import pytest
from scenes import NORTH_M, SPACING_M, WEST_M, at_deg, fractal, write_dem

from skyline import (
    MatchConfig,
    Matcher,
    Narrowing,
    RenderConfig,
    build_places,
    build_uniform,
    horizon,
    read_dem,
)
from skyline.errors import InputError, StoreError, StoreMismatchError
from skyline.match import full
from skyline.match.batch import _opened
from skyline.match.full import FullMatcher
from skyline.match.retrieval import Retriever
from skyline.match.scene import RenderedScene
from skyline.photo.projection import Projection
from skyline.photo.query import QuerySkyline
from skyline.store import open_store
from skyline.store.stored_dem import curvature_of
from skyline.terrain.heightfield import ground_of
from skyline_bench.queries.synthetic import QueryConfig, make_queries, make_queries_together

MIDDLE = (WEST_M + 3600.0, NORTH_M - 4800.0, WEST_M + 4800.0, NORTH_M - 3600.0)
SHARP = QueryConfig(max_tilt_deg=3.0, noise_deg=(0.03, 0.03), smooth_share=0.0)
BOLD = MatchConfig(min_confidence=0.0)
PLACES_M = 40.0
LESS_THOROUGH = replace(full.WHOLE, particles=48, rounds=5, keep_least=16, restarts=2, finalists=8)


def write_hills(path, seed):
    """Write hills within a ring of mountains, so that no skyline lies on the data's border."""
    heights = fractal(280, 280, relief_m=1200.0, seed=seed, exponent=2.2)
    across = SPACING_M * (np.arange(280) - 139.5)
    ring_m = np.hypot(across, across[:, np.newaxis]) - 3300.0
    heights = heights + 900.0 * np.exp(-((ring_m / 500.0) ** 2))
    return write_dem(path, heights.astype(np.float32))


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    return write_hills(tmp_path_factory.mktemp("dem") / "dem.tif", seed=11)


@pytest.fixture(scope="module")
def terrain(dem):
    return read_dem([dem])


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
def renderings(tmp_path_factory, terrain, bounds_deg):
    path = tmp_path_factory.mktemp("renderings") / "renderings.h5"
    build_uniform(terrain, path, 400.0, bounds_deg, RenderConfig(width=320))
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
    for one, query in zip(found, queries, strict=True):
        best = one.answer
        assert best.refined
        assert 0.0 < best.confidence < 1.0
        if error_m(best, query.truth) < 10.0:
            assert np.linalg.eigvalsh(best.covariance_m2).min() > 0.0
            turn = (best.grid_heading_deg - query.truth.heading_deg + 180.0) % 360.0 - 180.0
            assert abs(turn) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slack", "given", "answered"), [(0.0, 1.0, True), (0.025, 1.0, True), (0.01, 1.1, False)]
)
def test_a_field_of_view_at_the_end_of_what_is_searched_is_no_answer(
    store, terrain, queries, slack, given, answered
):
    query = queries[3]
    skyline = query.skyline.with_fov(given * query.truth.fov_deg)
    with Matcher(store, terrain, config=replace(BOLD, fov_slack=slack)) as matcher:
        found = matcher.match(skyline)
    assert found.candidates
    assert (found.answer is not None) == answered
    assert answered or "--fov-deg" in found.refusal


def test_a_place_beyond_doubt_is_refined_no_further(store, terrain, queries, monkeypatch):
    rays = [query.rays() for query in queries[:2]]
    with open_store(store) as opened:
        scene = RenderedScene(
            terrain, RenderConfig(width=360, curvature=curvature_of(opened.header))
        )
        matcher = FullMatcher(Retriever(opened.places(), ground_of(terrain)), scene)
    retrieved = [matcher.retrieve(one) for one in rays]
    monkeypatch.setattr(full, "WHOLE", LESS_THOROUGH)

    def refined(sure_margin):
        monkeypatch.setattr(full, "_SURE_MARGIN", sure_margin)
        return [matcher.refine(*one) for one in zip(retrieved, rays, strict=True)]

    always = refined(0.0)
    # One of two is sure.
    sure_margin = min(float(quick.margin[0]) for quick in always)
    found = always, refined(sure_margin), refined(np.inf)
    scene.release()
    for quick, chosen, thorough in zip(*found, strict=True):
        sure = quick.margin[0] > sure_margin
        expected, other = (quick, thorough) if sure else (thorough, quick)
        np.testing.assert_array_equal(chosen.hypotheses.score, expected.hypotheses.score)
        assert not np.array_equal(chosen.hypotheses.score, other.hypotheses.score)
        if sure:
            # Both end where the fit cannot separate places: within three deviations.
            one, other = (
                (h.easting_m[0], h.northing_m[0]) for h in (quick.hypotheses, thorough.hypotheses)
            )
            apart_m = np.hypot(*np.subtract(one, other))
            assert apart_m < 3.0 * np.sqrt(np.trace(thorough.covariance_m2[0]))
    assert {bool(quick.margin[0] > sure_margin) for quick in always} == {True, False}


def test_places_find_where_a_photo_was_taken_and_which_way_it_looks(store, terrain, queries):
    with open_store(store) as opened:
        places = opened.places()
    retriever = Retriever(places, ground_of(terrain))
    assert len(places) == pytest.approx((1200.0 / PLACES_M) ** 2, rel=0.1)
    off_m, turn_deg = [], []
    for query in queries:
        found = retriever.shortlist(query.rays(), 20)
        apart_m = np.hypot(
            found.easting_m - query.truth.easting_m, found.northing_m - query.truth.northing_m
        )
        assert (np.diff(found.score) >= 0.0).all()
        off_m.append(apart_m[0])
        turn = (found.heading_deg[0] - query.truth.heading_deg + 180.0) % 360.0 - 180.0
        turn_deg.append(abs(turn))
    assert np.median(off_m) < PLACES_M
    assert np.median(turn_deg) < 1.0


def test_a_narrowed_search_looks_nowhere_else(store, terrain, queries):
    query, truth = queries[0].skyline, queries[0].truth
    lon, lat = terrain.frame.to_lonlat(truth.easting_m, truth.northing_m)
    turn = float(
        terrain.frame.convergence_deg(easting_m=truth.easting_m, northing_m=truth.northing_m)
    )
    with Matcher(store, terrain, config=replace(BOLD, refine=False)) as matcher:
        right = Narrowing(
            near=(float(lon), float(lat), 0.2),
            heading_deg=(truth.heading_deg + turn, 5.0),
            elevation_m=(truth.eye_elevation_m - 60.0, truth.eye_elevation_m + 60.0),
        )
        for place in matcher.match(query, narrowing=right).candidates:
            assert error_m(place, truth) <= 200.0 + 1.0
            off_deg = place.heading_deg - (truth.heading_deg + turn)
            assert abs((off_deg + 180.0) % 360.0 - 180.0) <= 5.0
            assert abs(place.eye_elevation_m - truth.eye_elevation_m) <= 60.0
        away = Narrowing(heading_deg=(truth.heading_deg + turn + 180.0, 40.0))
        for place in matcher.match(query, narrowing=away).candidates:
            off_deg = place.heading_deg - (truth.heading_deg + turn)
            assert abs((off_deg + 180.0) % 360.0 - 180.0) >= 140.0
        with pytest.raises(InputError, match="lies within what the search is narrowed to"):
            matcher.match(query, narrowing=Narrowing(elevation_m=(8000.0, 9000.0)))


def test_each_matcher_has_its_kind_of_store(store, renderings, terrain, queries):
    with pytest.raises(InputError, match="holds renderings, not places"):
        Matcher(renderings, terrain)
    for matcher in ("paper", "correlation"):
        with pytest.raises(InputError, match="holds places, not renderings"):
            Matcher(store, terrain, matcher)
        assert Matcher(renderings, terrain, matcher).match(queries[0].skyline, 60.0).candidates
    narrowed = Narrowing(heading_deg=(0.0, 10.0))
    with pytest.raises(InputError, match="only the full matcher can narrow"):
        Matcher(renderings, terrain, "paper").match(queries[0].skyline, narrowing=narrowed)


def test_without_refinement_places_are_those_retrieved(store, terrain, queries):
    matcher = Matcher(store, terrain, config=replace(BOLD, refine=False))
    found = [matcher.match(query.skyline) for query in queries]
    off_m = [error_m(one.answer, query.truth) for one, query in zip(found, queries, strict=True)]
    assert np.median(off_m) < 100.0
    assert not any(one.answer.refined for one in found)
    assert all(one.answer.covariance_m2 is None for one in found)


def test_a_dem_that_has_gone_leaves_answers_unrefined(tmp_path, caplog, queries, bounds_deg):
    dem = write_hills(tmp_path / "dem.tif", seed=11)
    terrain, path = read_dem([dem]), tmp_path / "store.h5"
    build_places(terrain, path, 150.0, bounds_deg)
    assert Matcher(path).terrain is not None
    moved = dem.rename(tmp_path / "moved.tif")
    with caplog.at_level(logging.WARNING):
        matcher = Matcher(path, config=BOLD)
    assert "unrefined" in caplog.text
    assert matcher.terrain is None
    assert not matcher.match(queries[0].skyline).candidates[0].refined
    assert Matcher(path, moved).terrain is not None


def test_a_dem_of_another_area_is_refused(tmp_path, store):
    with pytest.raises(StoreMismatchError, match="digest"):
        Matcher(store, write_hills(tmp_path / "other.tif", seed=12))


def test_too_little_skyline_is_refused(store, terrain, queries):
    skyline = queries[0].skyline
    row_px = np.where(np.arange(skyline.width_px) < 150, skyline.row_px, np.nan)
    row_px[:150] = np.nan_to_num(row_px[:150], nan=300.0)
    little = QuerySkyline(
        row_px, np.isfinite(row_px).astype(float), skyline.width_px, skyline.height_px, 60.0
    )
    result = Matcher(store, terrain).match(little)
    assert result.answer is None
    assert result.candidates == ()
    assert "degrees of skyline" in result.refusal


def test_below_the_least_confidence_there_are_only_candidates(store, terrain, queries):
    matcher = Matcher(store, terrain, config=MatchConfig(min_confidence=1.0))
    result = matcher.match(queries[0].skyline)
    assert result.answer is None
    assert result.candidates
    assert "confidence" in result.refusal


def test_the_number_of_candidates_changes_none_of_them(store, terrain, queries):
    with Matcher(store, terrain, config=BOLD) as matcher:
        for query in queries[:3]:
            few, usual, many = (matcher.match(query.skyline, top=top) for top in (1, 5, 30))
            assert many.candidates[:5] == usual.candidates
            assert usual.candidates[:1] == few.candidates
            assert [one.rank for one in usual.candidates] == [1, 2, 3, 4, 5][
                : len(usual.candidates)
            ]
        with pytest.raises(InputError, match="top is 0"):
            matcher.match(queries[0].skyline, top=0)


def test_an_unknown_field_of_view_is_searched(store, renderings, terrain, queries):
    skyline = replace(queries[1].skyline, fov_deg=None)
    best = Matcher(store, terrain, config=BOLD).match(skyline).answer
    assert error_m(best, queries[1].truth) < 50.0
    assert best.fov_deg == pytest.approx(60.0, abs=2.0)
    with pytest.raises(InputError, match="--fov-deg"):
        Matcher(renderings, terrain, "correlation").match(skyline)


def test_a_panorama_needs_its_field_of_view(store, terrain, queries):
    skyline = replace(queries[1].skyline, fov_deg=None, projection=Projection.CYLINDRICAL)
    with pytest.raises(InputError, match="--fov-deg"):
        Matcher(store, terrain, config=BOLD).match(skyline)


@pytest.mark.slow
@pytest.mark.parametrize(("fov_deg", "said_deg"), [(200.0, 203.0), (360.0, 360.0)])
def test_a_panorama_that_sees_behind_is_found(store, terrain, fov_deg, said_deg):
    width, heading_deg, raised_deg = 1800, 250.0, 3.0
    east, north = 0.5 * (MIDDLE[0] + MIDDLE[2]) + 137.0, 0.5 * (MIDDLE[1] + MIDDLE[3]) - 211.0
    seen = horizon(terrain, **at_deg(terrain.frame.to_lonlat(east, north)))[0]
    turn_deg = fov_deg * ((np.arange(width) + 0.5) / width - 0.5)
    elevation_deg = np.interp(
        heading_deg + turn_deg, seen.azimuth_deg, seen.elevation_deg, period=360.0
    )
    up = np.tan(np.radians(elevation_deg)) - np.tan(np.radians(raised_deg))
    row_px = 400.0 - width / np.radians(fov_deg) * up
    query = QuerySkyline(row_px, np.ones(width), width, 801, said_deg, Projection.CYLINDRICAL)
    best = Matcher(store, terrain, config=BOLD).match(query).answer
    assert np.hypot(best.easting_m - east, best.northing_m - north) < 10.0
    assert best.heading_deg == pytest.approx(heading_deg, abs=0.2)
    assert best.pitch_deg == pytest.approx(raised_deg, abs=0.2)
    assert best.fov_deg == pytest.approx(fov_deg, abs=0.5)


@pytest.mark.parametrize("wrong", [{"refraction_k": "x"}, {"radius_m": [1]}, {"radius_m": -1.0}])
def test_an_impossible_curvature_is_refused(store, wrong):
    with open_store(store) as opened:
        header = opened.header
    with pytest.raises(StoreError, match="curvature"):
        curvature_of(replace(header, config={"curvature": wrong}))


def test_a_process_keeps_one_matcher_open(store, terrain, queries, monkeypatch):
    released = []

    def release(matcher):
        released.append(matcher)

    monkeypatch.setattr(Matcher, "release", release)
    # A matcher that an earlier test left open must not be counted.
    monkeypatch.setattr(sys.modules[_opened.__module__], "_here", {})
    first = _opened(1, str(store), None, "full")
    assert _opened(1, str(store), None, "full") is first
    assert _opened(2, str(store), None, "full") is not first
    assert released == [first]


def test_the_same_query_has_the_same_answer(store, terrain, queries):
    first, second = (Matcher(store, terrain).match(queries[1].skyline) for _ in range(2))
    assert first.candidates == second.candidates


@pytest.mark.parametrize(
    "wrong",
    [
        {"min_confidence": 1.5},
        {"fov_slack": 1.0},
        {"fov_range_deg": (80.0, 30.0)},
    ],
)
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(InputError, match="expected"):
        MatchConfig(**wrong)


def test_an_unknown_matcher_is_refused(store):
    with pytest.raises(InputError, match="full, paper, correlation"):
        Matcher(store, matcher="best")


def test_photos_of_one_place_have_one_answer_and_a_stranger_is_named(store, terrain):
    (first, second), (stranger, _) = make_queries_together(terrain, MIDDLE, 2, 2, 5, SHARP)
    bare = QuerySkyline(np.full(8, np.nan), np.zeros(8), 8, 8, 60.0)
    with Matcher(store, terrain, config=BOLD) as matcher:
        found = matcher.match_together(
            [first.skyline, stranger.skyline, second.skyline, bare], top=3
        )
        with pytest.raises(InputError, match="expected two photos"):
            matcher.match_together([first.skyline])
        little = matcher.match_together([first.skyline, bare])
    assert found.agrees == (True, False, True, False)
    assert found.answer is found.places[0]
    within_m = 3.0 * np.sqrt(np.trace(found.answer.covariance_m2))
    assert error_m(found.answer, first.truth) < within_m < 60.0
    one, other, another, nothing = found.results
    assert [len(some.candidates) for some in (other, nothing)] == [0, 0]
    assert "does not fit where the others" in other.refusal
    assert "degrees of skyline are visible" in nothing.refusal
    for mine, query in ((one, first), (another, second)):
        turn = mine.answer.grid_heading_deg - query.truth.heading_deg
        assert abs((turn + 180.0) % 360.0 - 180.0) < 1.0
    for name in ("lon", "lat", "radius_m", "confidence", "eye_elevation_m"):
        assert getattr(one.answer, name) == pytest.approx(getattr(another.answer, name))
    assert (little.answer, little.places) == (None, ())
    assert "fewer than two photos" in little.refusal


def test_a_narrowing_of_one_photo_holds_for_the_place(store, terrain):
    ((first, second),) = make_queries_together(terrain, MIDDLE, 1, 2, 5, SHARP)
    lon, lat = terrain.frame.to_lonlat(first.truth.easting_m + 500.0, first.truth.northing_m)
    near = Narrowing(near=(float(lon), float(lat), 0.3))
    skylines = [first.skyline, second.skyline]
    with Matcher(store, terrain, config=BOLD) as matcher:
        found = matcher.match_together(skylines, narrowings=[None, near])
    for place in found.places:
        off_m = np.hypot(
            place.easting_m - first.truth.easting_m - 500.0,
            place.northing_m - first.truth.northing_m,
        )
        assert off_m < 301.0
    with (
        Matcher(store, terrain, config=replace(BOLD, refine=False)) as matcher,
        pytest.raises(InputError, match="together by rendering"),
    ):
        matcher.match_together(skylines)
