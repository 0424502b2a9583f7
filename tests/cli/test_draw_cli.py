"""Vectors of a photo on the map, and vectors of the map in the photo, from the command line."""

import json
from xml.etree import ElementTree

import geopandas
import numpy as np
import pytest
from commands import assert_refused
from PIL import Image
from scenes import candidate_at

from skyline import read_dem

LINE_PX = [[380.0, 500.0], [420.0, 520.0], [470.0, 500.0]]
AREA_PX = [[500.0, 500.0], [560.0, 500.0], [560.0, 540.0], [500.0, 540.0]]
SIZE = {"name": "photo.jpg", "width_px": 960, "height_px": 640}


def collection(kinds, **more):
    features = [
        {
            "type": "Feature",
            "geometry": {"type": kind, "coordinates": coordinates},
            "properties": {"name": name},
        }
        for name, (kind, coordinates) in kinds.items()
    ]
    return json.dumps({"type": "FeatureCollection", "features": features, **more})


DRAWN = {
    "hut": ("Point", [430.0, 510.0]),
    "path": ("LineString", LINE_PX),
    "lake": ("Polygon", [[*AREA_PX, AREA_PX[0]]]),
}


@pytest.fixture
def vectors(tmp_path):
    path = tmp_path / "drawn.geojson"
    path.write_text(collection(DRAWN, photo=SIZE))
    return path


@pytest.fixture(scope="module")
def sure_pose(dem, tmp_path_factory):
    """The true pose of the photo with a covariance, as `match --json` prints it."""
    terrain = read_dem([dem])
    east_m, north_m = 601_800.0, 5_178_000.0
    eye_m = float(terrain.height_at(easting_m=east_m, northing_m=north_m)) + 2.0
    true = candidate_at(east_m, north_m, 140.0, frame=terrain.frame, eye_elevation_m=eye_m)
    variances = [9.0, 9.0, 4.0, *[1e-6] * 3, 1e-6, 1e-4]
    path = tmp_path_factory.mktemp("sure") / "pose.json"
    path.write_text(json.dumps(true.to_dict() | {"covariance": np.diag(variances).tolist()}))
    return path


@pytest.fixture
def draw(run, dem, photo, sure_pose):
    def drawn(vectors, out, *options, pose=sure_pose):
        files = "--vectors", vectors, "-o", out
        return run("draw", photo, "--pose", pose, "--dem", dem, *files, *options)

    return drawn


def test_what_is_drawn_in_a_photo_has_places_lengths_and_areas_with_errors(draw, vectors, tmp_path):
    out = tmp_path / "map.geojson"
    done = draw(vectors, out).ok()
    assert done.err == ""
    assert "3 shapes on the map" in done.out
    hut, path, lake = json.loads(out.read_text())["features"]
    lon, lat, elevation_m = hut["geometry"]["coordinates"]
    about = hut["properties"]
    assert (about["name"], about["photo"]) == ("hut", "photo.jpg")
    assert (about["lon"], about["lat"], about["elevation_m"]) == (lon, lat, elevation_m)
    assert 0.0 < about["semi_minor_m"] < about["semi_major_m"]
    assert about["error_m"] < about["semi_major_m"] < 2.5 * about["error_m"]
    assert 0.0 <= about["azimuth_deg"] < 180.0
    assert len(path["geometry"]["coordinates"]) > 20
    assert path["properties"]["slope_length_m"] > path["properties"]["length_m"] > 0.0
    assert path["properties"]["length_sd_m"] > 0.0
    assert len(path["properties"]["vertices"]) == 3
    ring = np.array(lake["geometry"]["coordinates"][0])
    np.testing.assert_array_equal(ring[0], ring[-1])
    assert lake["properties"]["area_m2"] > 0.0
    assert lake["properties"]["area_sd_m2"] > 0.0


def test_geopackages_and_kml_hold_the_same(draw, vectors, tmp_path):
    draw(vectors, tmp_path / "map.gpkg").ok()
    for layer, count in {"points": 1, "lines": 1, "polygons": 1, "vertices": 7}.items():
        table = geopandas.read_file(tmp_path / "map.gpkg", layer=layer)
        assert (len(table), table.crs.to_epsg()) == (count, 4326)
        assert table.geometry.iloc[0].has_z
    draw(vectors, tmp_path / "map.kml").ok()
    root = ElementTree.parse(tmp_path / "map.kml").getroot()
    names = root.findall(".//{*}Placemark/{*}name")
    assert [one.text for one in names] == ["hut", "path", "lake"]


def test_all_layers_of_a_geopackage_are_drawn_into_the_photo(draw, vectors, tmp_path):
    draw(vectors, tmp_path / "map.gpkg").ok()
    done = draw(tmp_path / "map.gpkg", tmp_path / "in.geojson").ok()
    assert "3 shapes of the map; seen 3" in done.out
    assert done.err == ""


def test_there_and_back_is_where_it_was_drawn(draw, vectors, tmp_path):
    there, back = tmp_path / "map.geojson", tmp_path / "back.geojson"
    draw(vectors, there).ok()
    assert "seen 3, hidden 0" in draw(there, back).ok().out
    again = json.loads(back.read_text())
    assert again["photo"]["width_px"] == 960
    hut = again["features"][0]
    assert hut["properties"]["hidden"] is False
    np.testing.assert_allclose(hut["geometry"]["coordinates"], DRAWN["hut"][1], atol=0.2)
    # What is drawn back has the photo's size, so it is known for pixels.
    draw(back, tmp_path / "again.geojson").ok()


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_the_map_is_drawn_into_the_photo(draw, vectors, photo, tmp_path, suffix):
    there, out = tmp_path / "map.geojson", tmp_path / f"in{suffix}"
    draw(vectors, there).ok()
    draw(there, out).ok()
    if suffix == ".svg":
        assert "#ffd23f" in out.read_text()
    else:
        with Image.open(out) as picture, Image.open(photo) as taken:
            assert picture.width / picture.height == pytest.approx(taken.width / taken.height, 0.01)


def test_the_errors_of_a_pose_without_a_covariance_are_assumed_and_that_is_said(
    draw, vectors, pose, tmp_path
):
    out = draw(vectors, tmp_path / "a.kml", pose=pose).ok().out
    assert "errors assumed, since no covariance is given: place 10 m" in out
    assert "assumed" not in draw(vectors, tmp_path / "a.kml").ok().out


@pytest.mark.parametrize(
    ("content", "out", "options", "said"),
    [
        (collection(DRAWN, photo=SIZE | {"height_px": 641}), "a.kml", (), "photo of 960 x 641 px"),
        (collection({"it": ("Point", [480.0, 3.0])}, photo=SIZE), "a.kml", (), "row 3 shows sky"),
        (collection({"it": ("Point", [2e3, 3.0])}), "a.kml", ("--pixels",), "960 x 640 px; give"),
        (collection({"it": ("Point", [480.0, 510.0])}), "a.kml", (), "give --pixels if"),
        (collection({"it": ("Point", [6e5, 5e6])}), "a.png", (), "names no CRS"),
        (collection(DRAWN, photo=SIZE), "a.png", (), "vectors of the photo, which go onto the map"),
        (collection({"it": ("Point", [9.0, 46.0])}), "a.gpkg", (), "which go into the photo"),
        (collection({"it": ("Point", [9.0, 46.0])}), "a.png", (), "nothing of it is in the photo"),
        (
            collection({"it": ("LineString", [[46.0, 9.0], [46.7478, 10.3327]])}),
            "a.png",
            (),
            "longitude and latitude seem to be swapped: give 10.3327,46.7478",
        ),
    ],
)
def test_a_mistake_is_one_line(draw, tmp_path, content, out, options, said):
    path = tmp_path / "drawn.geojson"
    path.write_text(content)
    assert_refused(draw(path, tmp_path / out, *options), said)
    assert not (tmp_path / out).exists()


def test_the_pose_of_another_photo_is_refused(draw, vectors, sure_pose, tmp_path):
    other = tmp_path / "other.json"
    other.write_text(json.dumps(json.loads(sure_pose.read_text()) | {"photo": "b/other.jpg"}))
    done = draw(vectors, tmp_path / "a.kml", pose=other)
    assert_refused(done, "is of b/other.jpg, not of")
