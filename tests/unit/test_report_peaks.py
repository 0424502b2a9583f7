"""The peaks that are visible from an eye, and the form of a gazetteer."""

import json
import logging
from dataclasses import replace

import numpy as np
import pytest
from scenes import FRAME, candidate_at, field_from

from skyline.errors import InputError, OffMapError
from skyline.geodesy.earth import Curvature
from skyline.geodesy.map_frame import Frame
from skyline.photo.skyline import PhotoSkyline
from skyline.terrain.viewpoints import stand_on
from skyline.view.peaks import Peaks, read_peaks
from skyline.view.sightings import Sighting, visible_peaks
from skyline.view.viewer import Viewer

FLAT = Curvature(enabled=False)


def cone(east, north, at_east, at_north, height_m, slope=1.0):
    return np.maximum(height_m - slope * np.hypot(east - at_east, north - at_north), 0.0)


def named(**places):
    east, north = np.array(list(places.values()), dtype=float).T
    unknown_m = np.full(len(places), np.nan)
    return Peaks(names=tuple(places), easting_m=east, northing_m=north, height_m=unknown_m)


# Named 50 m beside their summits, as gazetteers do.
TWO = named(west=(-860.0, 3030.0), east=(930.0, 2960.0))


def two_cones(wall_m):
    """Two cones north of the eye, and a wall before the eastern one."""

    def height_m(east, north):
        cones = cone(np.abs(east), north, 900.0, 3000.0, 600.0)
        return cones + np.where((north == 1500.0) & (east > 0.0), wall_m, 0.0)

    return field_from(height_m, 301, 30.0)


def names_seen(wall_m):
    terrain = two_cones(wall_m)
    eye = stand_on(terrain, easting_m=0.0, northing_m=-900.0, eye_height_m=2.0)
    return [peak.label for peak in visible_peaks(terrain, eye, TWO, FLAT)]


def test_a_peak_is_seen_unless_something_before_it_stands_higher():
    # On the line to the eastern summit the wall is reached after 1500 + 900 of 3900 m north.
    level_m = 2.0 + (600.0 - 2.0) * 2400.0 / 3900.0
    assert names_seen(0.0) == ["west", "east"]
    assert names_seen(level_m - 20.0) == ["west", "east"]
    assert names_seen(level_m + 20.0) == ["west"]


def test_a_height_in_feet_is_not_shown_as_metres(caplog):
    """Both summits are 600 m high, which are 1969 ft."""
    terrain = two_cones(0.0)
    eye = stand_on(terrain, easting_m=0.0, northing_m=-900.0, eye_height_m=2.0)
    peaks = replace(TWO, height_m=np.array([1969.0, 610.0]))
    labels = [peak.label for peak in visible_peaks(terrain, eye, peaks, FLAT)]
    assert labels == ["west", "east 610 m"]
    (record,) = caplog.records
    assert "1 of 2 peaks have heights that differ by more than 200 m" in record.getMessage()


def test_numbers_stay_behind_a_name_from_right_to_left():
    seen = Sighting(
        name="Hermon", easting_m=0.0, northing_m=0.0, surface_m=0.0, grid_azimuth_deg=0.0,
        elevation_tan=0.0, distance_m=9.0, height_m=2814.0,
    )  # fmt: skip
    assert seen.label == "Hermon 2814 m"
    for name in ("\u05d4\u05e8", "\u062c\u0628\u0644"):
        assert replace(seen, name=name).label == f"\u200e{name}\u200e 2814 m"


def test_the_curve_of_the_earth_hides_what_is_far():
    terrain = field_from(lambda east, north: cone(east, north, 0.0, 50_000.0, 150.0, 0.1), 241, 500)
    eye = stand_on(terrain, easting_m=0.0, northing_m=-50_000.0, eye_height_m=2.0)
    far = named(far=(0.0, 50_000.0))
    assert [peak.label for peak in visible_peaks(terrain, eye, far, FLAT)] == ["far"]
    assert visible_peaks(terrain, eye, far, Curvature()) == []


def test_a_viewer_warns_of_peaks_that_are_elsewhere(caplog):
    lon, lat = FRAME.to_lonlat(TWO.easting_m, TWO.northing_m)
    east, north = FRAME.from_lonlat(lat, lon)
    Viewer(two_cones(0.0), TWO)
    assert not caplog.records
    Viewer(two_cones(0.0), replace(TWO, easting_m=east, northing_m=north))
    assert len(caplog.records) == 1
    with pytest.raises(InputError):
        Viewer(two_cones(0.0), replace(TWO, easting_m=lon, northing_m=lat))


def test_a_viewer_says_why_a_photo_does_not_show_a_peak():
    photo = PhotoSkyline(np.full(90, np.nan), np.zeros(90), 90, 60)
    places = {"behind": (-860.0, -2000.0), "away": (0.0, 90_000.0)}
    peaks = named(west=(-860.0, 3030.0), east=(930.0, 2960.0), **places)
    with Viewer(two_cones(500.0), peaks) as viewer:
        pose = replace(candidate_at(0.0, -900.0, 0.0), eye_elevation_m=2.0)
        seen = viewer.summits(pose, photo)
        assert [one.name for one in seen] == ["west"]
        unseen = viewer.unseen(pose, photo, seen)
    assert (unseen.hidden, unseen.outside, unseen.off_map) == (("east",), ("behind",), ("away",))


def test_a_viewer_refuses_poses_that_no_camera_has():
    skyline = PhotoSkyline(np.full(90, np.nan), np.zeros(90), 90, 60)
    viewer, pose = Viewer(two_cones(0.0), TWO), candidate_at(0.0, -900.0)
    assert viewer.summits(pose, skyline)
    with pytest.raises(OffMapError):
        viewer.summits(replace(pose, easting_m=1e6), skyline)
    with pytest.raises(InputError):
        viewer.summits(replace(pose, fov_deg=200.0), skyline)


def test_a_gazetteer_in_degrees_or_metres(tmp_path):
    lon, lat = FRAME.to_lonlat(1200.0, -3400.0)
    degrees, metres = tmp_path / "degrees.csv", tmp_path / "metres.csv"
    degrees.write_text(
        f"name,lon,lat,height_m\nWeißkugel,{lon},{lat},3738\nB,{lon},{lat},12303.15 ft\n"
    )
    metres.write_text('easting,northing,name\n1200,-3400,"A, the  first"\n\n')
    first, second = read_peaks(degrees, FRAME), read_peaks(metres, FRAME)
    assert first.names == ("Weißkugel", "B")
    assert second.names == ("A, the first",)
    np.testing.assert_allclose(first.easting_m, 1200.0, atol=1e-3)
    np.testing.assert_allclose(first.northing_m, -3400.0, atol=1e-3)
    np.testing.assert_array_equal(first.height_m, [3738.0, 3750.00012])
    np.testing.assert_array_equal(second.easting_m, [1200.0])
    assert np.isnan(second.height_m).all()


def geojson_of(path, heights):
    """Write points with these `ele` (None: the property is not there), and return the path."""
    features = []
    for at, (ele, name) in enumerate(zip(heights, "ABCD", strict=False)):
        point = {"type": "Point", "coordinates": [9.0 + 0.01 * at, 46.0]}
        noted = {"name": name} | ({} if ele is None else {"ele": ele})
        features.append({"type": "Feature", "properties": noted, "geometry": point})
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


@pytest.mark.parametrize(
    ("ele", "height_m"),
    [
        (4421, 4421.0),
        (" -28.5 ", -28.5),
        ("1.25 km", 1250.0),
        ("14505 Feet", 4421.124),
        ("432\u20321\u2033", 131.699),
        ("432' 1.5\"", 131.7117),
    ],
)
def test_ele_is_read_by_openstreetmap_s_conventions(tmp_path, caplog, ele, height_m):
    peaks = read_peaks(geojson_of(tmp_path / "peaks.geojson", [ele]), FRAME)
    np.testing.assert_allclose(peaks.height_m, [height_m], rtol=0.0, atol=1e-9)
    assert not caplog.records


def test_geojson_in_metres_is_refused_and_in_degrees_of_any_datum_read(tmp_path):
    path = geojson_of(tmp_path / "peaks.geojson", ["1200"])
    read = json.loads(path.read_text())
    for name in ("urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:EPSG::4258"):
        path.write_text(json.dumps(read | {"crs": {"type": "name", "properties": {"name": name}}}))
        assert read_peaks(path, FRAME).names == ("A",)
    read["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::2056"}}
    path.write_text(json.dumps(read))
    with pytest.raises(InputError):
        read_peaks(path, FRAME)


def test_degrees_of_another_datum_are_carried_to_wgs_84(tmp_path):
    """In Tokyo's datum of 1918 the same degrees are 460 m farther north-west."""
    read = json.loads(geojson_of(tmp_path / "peaks.geojson", [3776]).read_text())
    read["features"][0]["geometry"]["coordinates"] = [138.7306, 35.3574]
    read["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::4301"}}
    (tmp_path / "peaks.geojson").write_text(json.dumps(read))
    frame = Frame.local(lon=138.7306, lat=35.3574)
    peaks = read_peaks(tmp_path / "peaks.geojson", frame)
    east_m, north_m = float(peaks.easting_m[0]), float(peaks.northing_m[0])
    assert (east_m, north_m) == (pytest.approx(-285.0, abs=25.0), pytest.approx(360.0, abs=25.0))


@pytest.mark.parametrize(
    ("lon", "crs", "reason"),
    [
        (8.5, {"type": "EPSG", "properties": {"code": 32632}}, "UTM zone 32N"),
        (8.5, {"type": "name", "properties": {"name": "MyGrid"}}, "MyGrid, which is not known"),
        (8.5, {"type": "link", "properties": {"href": "a.wkt"}}, "which is not known"),
        (1_057_535.0, None, "1.05754e.06,46.5; expected longitude and latitude"),
    ],
    ids=["code", "unknown", "link", "metres"],
)
def test_geojson_whose_places_may_not_be_degrees_of_wgs_84_is_refused(tmp_path, lon, crs, reason):
    path = tmp_path / "peaks.geojson"
    point = {"type": "Point", "coordinates": [lon, 46.5]}
    feature = {"type": "Feature", "properties": {"name": "A"}, "geometry": point}
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature], "crs": crs}))
    with pytest.raises(InputError, match=reason):
        read_peaks(path, FRAME)


@pytest.mark.parametrize("ele", ["14,505 ft", "1200;1210", '12"', "nan", "18941", True])
def test_any_other_ele_is_counted_and_its_peak_has_a_place_alone(tmp_path, caplog, ele):
    path = geojson_of(tmp_path / "peaks.geojson", ["1200", ele, "", None])
    with caplog.at_level(logging.WARNING):
        peaks = read_peaks(path, FRAME)
    assert peaks.names == ("A", "B", "C", "D")
    np.testing.assert_array_equal(peaks.height_m, [1200.0, np.nan, np.nan, np.nan])
    assert np.isfinite(peaks.easting_m).all()
    assert len(caplog.records) == 1
