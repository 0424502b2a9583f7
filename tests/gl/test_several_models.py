"""Stores of several elevation models, searched as one."""

import json
import math
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from affine import Affine
from scenes import NORTH_M, SPACING_M, WEST_M, fractal, write_dem

from skyline import (
    MatchConfig,
    Matcher,
    Narrowing,
    build_places,
    build_uniform,
    read_dem,
    write_trace,
)
from skyline.errors import InputError
from skyline.match.search import FullMatcher
from skyline.photo.noted_place import NotedPlace
from skyline.render.horizon import RenderedScene
from skyline_bench.queries.synthetic import QueryConfig, make_queries

pytestmark = pytest.mark.usefixtures("refined_quickly")

BOLD = MatchConfig(min_confidence=0.0)
SHARP = QueryConfig(max_tilt_deg=3.0, noise_deg=(0.03, 0.03), smooth_share=0.0)
MIDDLE = (WEST_M + 1800.0, NORTH_M - 2700.0, WEST_M + 2700.0, NORTH_M - 1800.0)


def built(folder, name, seed, crs):
    """Build a store of 900 m of hills, 60 m apart; return its terrain and its path."""
    folder = folder / name
    folder.mkdir()
    across = np.abs(np.linspace(-1.0, 1.0, 150))
    ring = np.maximum(across, across[:, np.newaxis]) ** 8
    heights = 800.0 + fractal(150, 150, relief_m=900.0, seed=seed, exponent=2.2) + 900.0 * ring
    grid = Affine(SPACING_M, 0.0, WEST_M, 0.0, -SPACING_M, NORTH_M)
    terrain = read_dem([write_dem(folder / "dem.tif", np.float32(heights), crs, transform=grid)])
    lon, lat = terrain.frame.to_lonlat(MIDDLE[::2], MIDDLE[1::2])
    box = float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])
    build_places(terrain, folder / "store.h5", 60.0, box)
    return terrain, folder / "store.h5"


@pytest.fixture(scope="module")
def areas(tmp_path_factory):
    """Two areas at the same eastings of neighbouring zones, some 460 km apart."""
    folder = tmp_path_factory.mktemp("areas")
    return [built(folder, "west", 3, "EPSG:32632"), built(folder, "east", 4, "EPSG:32633")]


@pytest.fixture(scope="module")
def stores(areas):
    return [path for _, path in areas]


@pytest.fixture(scope="module")
def skylines(areas):
    """A photo in each area."""
    made = [make_queries(terrain, MIDDLE, 1, seed=5, config=SHARP)[0] for terrain, _ in areas]
    return [query.skyline for query in made]


@pytest.fixture(scope="module")
def matcher(stores):
    with Matcher(stores, config=BOLD) as matcher:
        yield matcher


@pytest.mark.parametrize("area", [0, 1])
def test_a_photo_is_found_in_its_own_area(matcher, areas, stores, skylines, area):
    best = matcher.match(skylines[area]).answer
    with Matcher(stores[area], config=BOLD) as alone:
        own = alone.match(skylines[area]).answer
    assert best.area == area
    assert matcher.areas[area].frame == areas[area][0].frame
    assert best.lon == pytest.approx(own.lon, abs=1e-4)
    assert best.lat == pytest.approx(own.lat, abs=1e-4)
    assert best.heading_deg == pytest.approx(own.heading_deg, abs=0.1)


def test_the_surroundings_of_an_answer_are_searched_in_its_own_area(matcher, skylines, monkeypatch):
    plain = matcher.match(skylines[1]).answer
    thorough = replace(FullMatcher.effort, sure_margin=math.inf, large_area=0)
    monkeypatch.setattr(FullMatcher, "effort", thorough)
    again = matcher.match(skylines[1]).answer
    assert again.area == 1
    assert again.cost <= plain.cost
    assert again.distance_m(plain) < 20.0


def test_the_order_of_the_stores_changes_no_answer(matcher, stores, skylines):
    best = matcher.match(skylines[1]).answer
    with Matcher(stores[::-1], config=BOLD) as turned:
        other = turned.match(skylines[1]).answer
    assert other.area == 0
    assert replace(other, area=1) == best


def test_a_search_is_narrowed_in_degrees_to_one_area(matcher, skylines):
    east = Narrowing(near=(best_lon(matcher, skylines[1]), 46.77, 20.0))
    found = matcher.match(skylines[0], narrowing=east).candidates
    assert {one.area for one in found} == {1}


def best_lon(matcher, skyline):
    return matcher.match(skyline).answer.lon


def test_a_noted_place_draws_a_photo_in_the_area_that_has_it(matcher, skylines):
    plain = matcher.match(skylines[1]).answer
    noted = replace(skylines[1], noted=NotedPlace(lonlat_deg=(plain.lon, plain.lat)))
    drawn = matcher.match(noted, narrowing=Narrowing(use_gps=True)).answer
    assert drawn.area == 1
    assert drawn.cost < plain.cost


def test_photo_spots_draw_a_photo_in_the_area_that_has_them(matcher, skylines):
    plain = matcher.match(skylines[1]).answer
    spots = Narrowing(photo_spots=((plain.lon, plain.lat),))
    drawn = matcher.match(skylines[1], narrowing=spots).answer
    assert drawn.area == 1
    assert drawn.cost < plain.cost


def test_a_pose_is_fitted_on_the_model_of_its_area(matcher, skylines):
    best = matcher.match(skylines[1]).answer
    fitted = matcher.fit(skylines[1], best).candidates[0]
    assert fitted.area == 1
    assert fitted.distance_m(best) < 20.0


def test_what_needs_one_model_is_refused_for_two(matcher, stores, skylines):
    for ask in (
        lambda: matcher.frame,
        lambda: matcher.viewpoints,
        lambda: matcher.match_together(skylines),
    ):
        with pytest.raises(InputError, match="of 2 elevation models, and this needs one"):
            ask()
    with pytest.raises(InputError, match="leave the DEM and the surface out"):
        Matcher(stores, dem="dem.tif")


def test_all_areas_stay_unrefined_if_the_model_of_one_is_not_at_hand(stores, skylines, caplog):
    dem = stores[0].with_name("dem.tif")
    dem.rename(dem.with_name("away.tif"))
    with Matcher(stores, config=BOLD) as matcher:
        best = matcher.match(skylines[1]).candidates[0]
    dem.with_name("away.tif").rename(dem)
    assert "answers unrefined" in caplog.text
    assert (best.area, best.refined) == (1, False)


def test_a_command_searches_and_exports_stores_of_several_models(run, stores, skylines, tmp_path):
    for name, skyline in zip("we", skylines, strict=True):
        write_trace(skyline, tmp_path / f"{name}.csv")
    out = tmp_path / "found.geojson"
    fov_deg = skylines[0].fov_deg
    traces = tmp_path / "w.csv", tmp_path / "e.csv"
    found = run("match", *stores, *traces, "--fov-deg", fov_deg, "--export", out, "--json")
    lon = [json.loads(line)["candidates"][0]["lon"] for line in found.out.splitlines()]
    features = json.loads(out.read_text())["features"]
    wedges = [one for one in features if one["properties"]["shape"] == "view"]
    for degrees, photo in zip(lon, traces, strict=True):
        wedge = next(one for one in wedges if one["properties"]["photo"] == str(photo))
        assert wedge["geometry"]["coordinates"][0][0][0] == pytest.approx(degrees, abs=0.05)
    assert lon[1] - lon[0] == pytest.approx(6.0, abs=0.1)
    refused = run("match", *stores, traces[0], "--fov-deg", fov_deg, "--report", tmp_path / "r")
    assert "of 2 elevation models, and this needs one" in refused.err


def test_a_matcher_that_cannot_open_its_second_store_closes_the_first_one(
    areas, stores, tmp_path, monkeypatch
):
    renderings = tmp_path / "renderings.h5"
    build_uniform(areas[1][0], renderings, 2000.0)
    close = Mock()
    monkeypatch.setattr(RenderedScene, "close", close)
    with pytest.raises(InputError, match="renderings"):
        Matcher([stores[0], renderings])
    close.assert_called_once()
