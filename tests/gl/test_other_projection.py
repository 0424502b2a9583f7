"""Photos that are taken for perspective ones and are not: panoramas and fisheyes without marks."""

from dataclasses import replace

import pytest
from test_matcher import MIDDLE, SHARP
from test_orient import beside

from skyline import Matcher, build_places, orient
from skyline.camera.projection import Projection
from skyline_bench.queries.pinhole import CYLINDER, FISHEYES, PIN_HOLE
from skyline_bench.queries.synthetic import make_queries


def photo_of(terrain, mapping=PIN_HOLE, fov_deg=100.0, distortion_sd=0.0):
    """Return a made photo of a mapping; place, heading, pitch and roll are always the same."""
    config = replace(
        SHARP,
        fov_deg=(fov_deg, fov_deg),
        fov_error=0.02,
        mappings=(mapping,),
        distortion_sd=distortion_sd,
    )
    return make_queries(terrain, MIDDLE, 2, seed=1, config=config)[1]


@pytest.mark.parametrize("fov_deg", [90.0, 110.0])
def test_an_unmarked_panorama_is_named_with_its_projection(terrain, fov_deg):
    photo = photo_of(terrain, CYLINDER, fov_deg)
    found = orient(photo.skyline, terrain, **beside(terrain, photo.truth))
    assert found.answer is None
    assert "--projection cylindrical" in found.refusal


@pytest.mark.parametrize("mapping", FISHEYES)
def test_a_fisheye_is_not_trusted_as_a_perspective_photo(terrain, mapping):
    photo = photo_of(terrain, mapping)
    found = orient(photo.skyline, terrain, **beside(terrain, photo.truth))
    assert found.answer is None
    assert "as by a fisheye" in found.refusal


@pytest.mark.parametrize("mapping", FISHEYES)
def test_a_fisheye_that_is_said_to_be_one_is_oriented(terrain, mapping):
    photo = photo_of(terrain, mapping)
    told = replace(photo.skyline, fov_deg=100.0, projection=Projection.FISHEYE)
    found = orient(told, terrain, **beside(terrain, photo.truth))
    assert found.refusal is None
    assert found.pose.grid_heading_deg == pytest.approx(photo.truth.grid_heading_deg, abs=0.5)
    assert found.pose.fov_deg == pytest.approx(100.0, abs=3.0)


@pytest.mark.parametrize("distortion_sd", [0.0, 0.05])
def test_a_wide_lens_is_trusted_bent_or_not(terrain, distortion_sd):
    photo = photo_of(terrain, distortion_sd=distortion_sd)
    found = orient(photo.skyline, terrain, **beside(terrain, photo.truth))
    assert found.refusal is None


def test_a_search_names_the_projection_too(terrain, tmp_path):
    photo = photo_of(terrain, CYLINDER, 110.0)
    lon, lat = terrain.frame.to_lonlat(MIDDLE[::2], MIDDLE[1::2])
    bounds_deg = float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])
    build_places(terrain, tmp_path / "store.h5", 40.0, bounds_deg)
    with Matcher(tmp_path / "store.h5", terrain) as matcher:
        result = matcher.match(photo.skyline)
    assert result.answer is None
    assert "--projection cylindrical" in result.refusal
