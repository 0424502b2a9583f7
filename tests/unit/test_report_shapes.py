"""Wedges, ellipses and GeoJSON say where a candidate is and where it looks."""

import json
import xml.etree.ElementTree as Xml

import numpy as np
import pytest
from pyproj import Geod
from scenes import at_m, candidate_at
from shapely import MultiPolygon, Polygon

from skyline.geodesy import Frame, lonlat_rings
from skyline.match.answer import MatchResult
from skyline.match.candidate import Ellipse, view_wedge_m
from skyline.photo.query import QuerySkyline
from skyline.report.exports import VIEW_REACH_M, export_matches

UTM = Frame.from_crs("EPSG:32632")
PLACE = UTM.from_lonlat(10.78277, 46.79586)
BEST = candidate_at(
    *PLACE, 275.0, -8.5, 1.0, 78.7, confidence=0.9, frame=UTM,
    covariance_m2=((400.0, 100.0), (100.0, 900.0)),
)  # fmt: skip
OTHER = candidate_at(BEST.easting_m + 500.0, BEST.northing_m, 350.0, score=0.4, frame=UTM, rank=2)


def signed_area(ring):
    """Positive for a counter-clockwise ring of (x, y)."""
    x, y = np.array(ring).T
    return 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def test_an_ellipse_has_the_covariance_s_axes():
    along, across, azimuth_deg = 30.0, 10.0, 25.0
    major = np.array([np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg))])
    minor = np.array([major[1], -major[0]])
    covariance = along**2 * np.outer(major, major) + across**2 * np.outer(minor, minor)
    ellipse = Ellipse.of(candidate_at(5.0, 7.0, covariance_m2=covariance))
    quantile = np.sqrt(-2.0 * np.log(0.05))
    assert ellipse.semi_major_m == pytest.approx(along * quantile)
    assert ellipse.semi_minor_m == pytest.approx(across * quantile)
    outline = ellipse.outline_m
    away = outline - [5.0, 7.0]
    assert np.degrees(np.arctan2(*away[0])) % 180.0 == pytest.approx(azimuth_deg)
    off = np.einsum("pi,ij,pj->p", away, np.linalg.inv(covariance), away)
    np.testing.assert_allclose(off, quantile**2)
    np.testing.assert_array_equal(outline[0], outline[-1])
    assert signed_area(outline) == pytest.approx(np.pi * along * across * quantile**2, rel=0.01)


def test_a_wedge_spans_the_field_of_view_about_the_heading():
    wedge = view_wedge_m(OTHER, 1000.0)
    np.testing.assert_array_equal(wedge[[0, -1]], [[OTHER.easting_m, OTHER.northing_m]] * 2)
    away = wedge[1:-1] - wedge[0]
    np.testing.assert_allclose(np.hypot(*away.T), 1000.0)
    azimuth = np.degrees(np.arctan2(*away.T)) % 360.0
    np.testing.assert_allclose(azimuth[[-1, 0]], [320.0, 20.0])
    assert signed_area(wedge) > 0.0


def test_geojson_holds_points_views_and_ellipses_in_degrees(tmp_path):
    path = tmp_path / "new" / "matches.geojson"
    found = {"<b>.jpg": [BEST, OTHER], "none.csv": []}
    export_matches(
        path, [MatchResult(None, some, 0.0, name=name) for name, some in found.items()], UTM
    )
    collection = json.loads(path.read_text())
    assert collection["type"] == "FeatureCollection"
    noted = [feature["properties"] for feature in collection["features"]]
    assert {one["query"] for one in noted} == {"<b>.jpg"}
    assert [(one["rank"], one["shape"]) for one in noted] == [
        (1, "candidate"), (1, "view"), (1, "ellipse95"), (2, "candidate"), (2, "view"),
    ]  # fmt: skip
    point, view, ellipse, *_ = collection["features"]
    np.testing.assert_allclose(point["geometry"]["coordinates"], [10.78277, 46.79586], atol=1e-7)
    convergence_deg = float(UTM.convergence_deg(**at_m(PLACE)))
    assert point["properties"]["heading_deg"] == pytest.approx(275.0 + convergence_deg)
    names = "lon lat easting_m northing_m pitch_deg roll_deg fov_deg score confidence refined"
    assert set(names.split()) <= point["properties"].keys()
    assert ellipse["properties"]["semi_major_m"] > ellipse["properties"]["semi_minor_m"] > 0.0
    for polygon in (view, ellipse):
        (ring,) = polygon["geometry"]["coordinates"]
        assert polygon["geometry"]["type"] == "Polygon"
        assert ring[0] == ring[-1]
        assert signed_area(ring) > 0.0
    back = UTM.from_lonlat(*np.array(view["geometry"]["coordinates"][0][1:-1]).T)
    away = np.hypot(back[0] - BEST.easting_m, back[1] - BEST.northing_m)
    np.testing.assert_allclose(away, VIEW_REACH_M, atol=0.05)


GEOD = Geod(ellps="WGS84")
FIJI = Frame.local(lon=180.0, lat=-17.0)


@pytest.mark.parametrize("fov_deg", [1.0, 200.0, 360.0])
@pytest.mark.parametrize("east_m", [-3000.0, -1999.0, 0.0, 1e-4, 300.0])
def test_a_view_is_cut_at_the_antimeridian(east_m, fov_deg):
    for heading_deg in range(0, 360, 15):
        held = candidate_at(east_m, 0.0, heading_deg, fov_deg=fov_deg, frame=FIJI)
        wedge = view_wedge_m(held, 2000.0)
        rings = lonlat_rings(wedge, FIJI)
        polygons = [Polygon(ring) for ring in rings]
        assert MultiPolygon(polygons).is_valid
        assert all(one.exterior.is_ccw for one in polygons)
        assert np.abs(np.concatenate(rings)[:, 0]).max() <= 180.0
        assert max(np.ptp(ring[:, 0]) for ring in rings) < 0.05
        area_m2 = sum(GEOD.geometry_area_perimeter(one)[0] for one in polygons)
        assert area_m2 == pytest.approx(Polygon(wedge).area, rel=1e-3)
        sides = {bool(np.mean(ring[:, 0]) > 0.0) for ring in rings}
        assert sides == {bool(side) for side in wedge[np.abs(wedge[:, 0]) > 0.05, 0] < 0.0}


def test_geojson_and_kml_cut_what_crosses_the_antimeridian(tmp_path):
    covariance_m2 = ((400.0, 100.0), (100.0, 900.0))
    held = candidate_at(-5.0, 0.0, 90.0, covariance_m2=covariance_m2, frame=FIJI)
    query = QuerySkyline(np.full(9, 4.0), np.ones(9), 9, 6)
    matches = [MatchResult(query, (held,), 0.0, name="q.jpg")]
    export_matches(tmp_path / "a.geojson", matches, FIJI)
    point, *shapes = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert point["geometry"]["coordinates"][0] == pytest.approx(179.99995, abs=1e-5)
    for one in shapes:
        assert one["geometry"]["type"] == "MultiPolygon"
        sides = [np.array(ring)[:, 0] for (ring,) in one["geometry"]["coordinates"]]
        west, east = sorted((side.min(), side.max()) for side in sides)
        assert west == (-180.0, pytest.approx(-179.99, abs=0.02))
        assert east == (pytest.approx(179.9999, abs=1e-3), 180.0)
    export_matches(tmp_path / "a.kml", matches, FIJI)
    assert len(Xml.parse(tmp_path / "a.kml").findall(".//{*}Polygon")) == 2
