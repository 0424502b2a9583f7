"""Posteriors: where a photo was taken, with which probability; and their files."""

import json
import math
from dataclasses import replace
from xml.etree import ElementTree as Xml

import geopandas
import numpy as np
import pytest
import rasterio
from place_scenes import AZIMUTH_DEG, curve, places_of, rays
from scenes import FRAME, candidate_at

from skyline import Frame, InputError, Narrowing
from skyline.geodesy.cell_grid import CellGrid
from skyline.match.joined_shards import JoinedShards
from skyline.match.position_prior import PositionPrior
from skyline.match.posterior import SHARES, SPREAD, Findings, Posterior, posterior_of
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.retrieval import Retriever
from skyline.match.screen import AlikePlaces
from skyline.match.shard import LocalShard
from skyline.pose.outlines import Ellipse
from skyline.pose.poses import Poses
from skyline.report.posterior_files import write_posteriors

SURE = candidate_at(
    1000.0, 900.0, confidence=1.0, confidence_1km=1.0,
    covariance_m2=((400.0, 150.0), (150.0, 225.0)),
)  # fmt: skip
NO_FITS = Poses.of(SURE)[:0]


def grid_of_places(side_m=4000.0, spacing_m=100.0):
    """Return places on a square whose skylines are all equally like the photo's."""
    along_m = np.arange(0.5 * spacing_m, side_m, spacing_m)
    easting_m, northing_m = (one.ravel() for one in np.meshgrid(along_m, along_m))
    tolerance_m = np.full(easting_m.shape, 0.5 * spacing_m)
    return AlikePlaces(easting_m, northing_m, tolerance_m, np.zeros(easting_m.shape))


def within(posterior, east_m, north_m, radius_m):
    """Return the probability within a circle."""
    at = posterior.to_xarray()
    near = (at.x - east_m) ** 2 + (at.y - north_m) ** 2 <= radius_m**2
    return float(at.where(near).sum())


def area_m2(ring):
    """Return the area of a closed outline, above 0 if it is counter-clockwise."""
    x, y = (ring - ring[0]).T
    return 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def test_a_sure_candidate_s_region_of_95_percent_is_its_ellipse():
    posterior = posterior_of(Findings([SURE], NO_FITS, grid_of_places(2000.0)), FRAME)
    ((ring,),) = posterior.region(0.95)
    off_m = ring - [SURE.easting_m, SURE.northing_m]
    squares = np.einsum("ki,ij,kj->k", off_m, np.linalg.inv(SURE.covariance_m2), off_m)
    np.testing.assert_allclose(np.sqrt(squares / 5.9915), 1.0, atol=0.02)
    assert area_m2(ring) == pytest.approx(area_m2(Ellipse.of(SURE).outline_m), rel=0.03)
    # Student's t is steeper than the normal distribution, whose half lies within q = 1.386.
    assert posterior.area_km2(0.5) < 0.6 * 1.386 / 5.9915 * posterior.area_km2(0.95)


def test_probabilities_add_up_to_one_at_the_border_too():
    at_corner = replace(SURE, easting_m=0.0, northing_m=0.0)
    for candidates in ((SURE,), (at_corner,), ()):
        posterior = posterior_of(Findings(candidates, NO_FITS, grid_of_places()), FRAME)
        assert posterior.probability.sum(dtype=float) == pytest.approx(1.0, abs=1e-5)
        assert (posterior.probability >= 0.0).all()


def test_candidates_have_the_probabilities_of_their_confidences():
    best = replace(SURE, confidence=0.5, confidence_1km=0.6)
    beside = replace(best, easting_m=1150.0, rank=2)  # Within 200 m: a part of the best one
    other = replace(SURE, easting_m=3200.0, northing_m=3200.0, confidence=0.1, rank=3)
    posterior = posterior_of(Findings([best, beside, other], NO_FITS, grid_of_places()), FRAME)
    # Of the 0.3 that no candidate has, a circle of 200 m holds 0.126 of 16 km2.
    even = 0.3 * 0.1257 / 16.0
    # Of the 0.1 between 200 m and 1 km, 12 % lie within 200 m of the middle.
    assert within(posterior, 1000.0, 900.0, 200.0) == pytest.approx(0.512 + even, abs=0.005)
    assert within(posterior, 3200.0, 3200.0, 200.0) == pytest.approx(0.1 + even, abs=0.005)


def test_without_a_candidate_places_count_by_their_likeness_and_their_size():
    places = AlikePlaces(
        np.array([0.0, 3000.0, 6000.0]), np.zeros(3), np.array([50.0, 50.0, 100.0]),
        np.array([math.log(2.0) / SPREAD.score_weight, 0.0, 0.0]),
    )  # fmt: skip
    posterior = posterior_of(Findings([], NO_FITS, places), FRAME)
    # Of the area 1, 1 and 4; the first fits e^ln 2 as well.
    for east_m, share in ((0.0, 2 / 7), (3000.0, 1 / 7), (6000.0, 4 / 7)):
        assert within(posterior, east_m, 0.0, 1000.0) == pytest.approx(share, abs=0.02)


def test_fitted_poses_share_what_no_candidate_has():
    doubtful = replace(SURE, confidence=0.2, confidence_1km=0.2)
    fitted = Poses.of(replace(SURE, easting_m=3000.0, northing_m=3000.0))
    posterior = posterior_of(Findings([doubtful], fitted, grid_of_places()), FRAME)
    # Half of the 0.8 lies around it, and of the other half as much as of the area.
    expected = 0.5 * 0.8 * (1.0 + 0.2827 / 16.0)
    assert within(posterior, 3000.0, 3000.0, 300.0) == pytest.approx(expected, abs=0.01)


def test_places_near_the_one_that_a_photo_notes_are_preferred():
    noted = PositionPrior(3000.0, 1000.0, 30.0)
    posterior = posterior_of(Findings([], NO_FITS, grid_of_places(), Prior(position=noted)), FRAME)
    # Its error exceeds 600 m in 5 % of photos, and in 5 % it is the place of another photo.
    assert within(posterior, 3000.0, 1000.0, 600.0) > 0.9


def test_greater_shares_have_greater_regions():
    doubtful = replace(SURE, confidence=0.4, confidence_1km=0.5)
    places = grid_of_places(2000.0)
    places = replace(places, score=-places.easting_m / 1000.0)
    posterior = posterior_of(Findings([doubtful], NO_FITS, places), FRAME)
    least = [posterior.least_probability(share) for share in SHARES]
    assert least == sorted(least, reverse=True)
    for share, one in zip(SHARES, least, strict=True):
        held = posterior.probability[posterior.probability >= one].sum(dtype=float)
        assert held == pytest.approx(share, abs=1e-3)
        outlines = sum(area_m2(ring) for rings in posterior.region(share) for ring in rings)
        assert outlines / 1e6 == pytest.approx(posterior.area_km2(share), rel=0.05)
    assert posterior.share_at(easting_m=1000.0, northing_m=900.0) < 0.05
    assert 0.9 < posterior.share_at(easting_m=1950.0, northing_m=1950.0) <= 1.0
    off = {"easting_m": -5000.0, "northing_m": 0.0}
    assert posterior.probability_at(**off) == 0.0
    assert posterior.share_at(**off) == pytest.approx(1.0)


def test_outlines_turn_left_and_holes_turn_right():
    row, col = np.mgrid[0:41, 0:41]
    ring = np.exp(-0.1 * (np.hypot(row - 20, col - 20) - 12.0) ** 2)
    grid = CellGrid(west_m=5e5, north_m=5e6, cell_m=10.0, rows=41, cols=41)
    posterior = Posterior((ring / ring.sum()).astype(np.float32), grid, FRAME)
    ((outline, hole),) = posterior.region(0.8)
    assert area_m2(outline) > -area_m2(hole) > 0.0


def test_a_single_cell_has_an_outline():
    cells = np.full((9, 9), 1e-3, dtype=np.float32)
    cells[4, 4] = 1.0 - 80e-3
    grid = CellGrid(west_m=0.0, north_m=900.0, cell_m=100.0, rows=9, cols=9)
    ((outline,),) = Posterior(cells, grid, FRAME).region(0.5)
    np.testing.assert_allclose(outline[:-1].mean(axis=0), [450.0, 450.0])
    assert 0.0 < area_m2(outline) < 100.0**2


@pytest.mark.parametrize("share", [0.0, 1.0, -0.5])
def test_a_share_lies_between_none_and_all(share):
    posterior = posterior_of(Findings([SURE], NO_FITS, grid_of_places(2000.0)), FRAME)
    with pytest.raises(InputError, match="between 0 and 1"):
        posterior.region(share)


def test_places_alike_are_those_within_the_narrowing():
    places = places_of(np.stack([curve(seed, AZIMUTH_DEG) for seed in range(20)]))
    retriever = Retriever(JoinedShards([[LocalShard(places)]]))
    every = retriever.alike_places([(rays(7, 120.0), NOTHING_KNOWN)])
    assert len(every) == 20
    assert every.easting_m[every.score.argmax()] == 700.0
    lon, lat = FRAME.to_lonlat(700.0, 0.0)
    near = Prior.of(Narrowing(near=(float(lon), float(lat), 0.25)), FRAME)
    some = retriever.alike_places([(rays(7, 120.0), near)])
    assert sorted(some.easting_m) == [500.0, 600.0, 700.0, 800.0, 900.0]
    with pytest.raises(InputError, match="no place"):
        retriever.alike_places([(rays(7, 120.0), Prior.of(Narrowing(near=(20, 10, 1)), FRAME))])


# --- files ----------------------------------------------------------------------------------


def doubtful_posterior():
    doubtful = replace(SURE, confidence=0.6, confidence_1km=0.7)
    return posterior_of(Findings([doubtful], NO_FITS, grid_of_places(2000.0)), FRAME)


def test_the_geotiff_lies_on_the_map(tmp_path):
    posterior = doubtful_posterior()
    write_posteriors([tmp_path / "new" / "map.tif"], [("a.jpg", posterior)])
    with rasterio.open(tmp_path / "new" / "map.tif") as raster:
        cells = raster.read(1)
        row, col = np.unravel_index(cells.argmax(), cells.shape)
        assert raster.xy(row, col) == pytest.approx((1000.0, 900.0), abs=posterior.grid.cell_m)
        assert raster.crs == rasterio.CRS.from_wkt(FRAME.wkt)
    np.testing.assert_array_equal(cells, posterior.probability)


@pytest.mark.parametrize("name", ["map.geojson", "map.kml"])
def test_outlines_of_several_photos_are_valid_and_nested(tmp_path, name):
    path = tmp_path / name
    write_posteriors([path], [(photo, doubtful_posterior()) for photo in ("a&b.jpg", "c.jpg")])
    shapes = geopandas.read_file(path).set_crs(4326).to_crs(FRAME.wkt)
    assert len(shapes) == 6
    assert shapes.is_valid.all()
    first = sorted(shapes.geometry[:3] if name.endswith("json") else shapes.geometry[::2],
                   key=lambda shape: shape.area)  # fmt: skip
    assert first[1].buffer(2.0).contains(first[0])
    assert first[2].buffer(2.0).contains(first[1])
    if name.endswith("json"):
        about = [one["properties"] for one in json.loads(path.read_text())["features"]]
        assert [one["share"] for one in about] == [0.5, 0.8, 0.95] * 2
        assert about[0]["photo"] == "a&b.jpg"
        areas_km2 = [one["area_km2"] for one in about]
        np.testing.assert_allclose(shapes.area / 1e6, areas_km2, rtol=0.1)
    else:
        texts = [mark.findtext("{*}name") for mark in Xml.parse(path).iterfind(".//{*}Placemark")]
        assert texts[0] == "a&b.jpg: 95 %"


def test_a_region_across_the_antimeridian_is_cut(tmp_path):
    frame = Frame.local(lon=180.0, lat=10.0)
    place = dict(zip(("lon", "lat"), map(float, frame.to_lonlat(0.0, 0.0)), strict=True))
    best = replace(SURE, easting_m=0.0, northing_m=0.0, **place)
    places = grid_of_places(2000.0)
    places = replace(places, easting_m=places.easting_m - 1e3, northing_m=places.northing_m - 1e3)
    write_posteriors(
        [tmp_path / "a.json"], [("a.jpg", posterior_of(Findings([best], NO_FITS, places), frame))]
    )
    shapes = geopandas.read_file(tmp_path / "a.json")
    assert shapes.is_valid.all()
    assert (shapes.bounds.minx < -179.9).all()
    assert (shapes.bounds.maxx > 179.9).all()
    # Square degrees: no part goes round the world.
    assert all(shape.area < 1e-3 for shape in shapes.geometry)


def test_a_geotiff_holds_one_photo(tmp_path):
    photos = [(name, doubtful_posterior()) for name in ("a.jpg", "b.jpg")]
    with pytest.raises(InputError, match="holds one photo"):
        write_posteriors([tmp_path / "map.tif"], photos)
    with pytest.raises(InputError, match="suffix"):
        write_posteriors([tmp_path / "map.png"], photos)
