"""Photos on the ground and poses from control points, from the command line."""

import json

import numpy as np
import pytest
import rasterio
from commands import assert_refused, csv_of, lonlat_of
from PIL import Image
from PIL.ExifTags import Base
from scenes import candidate_at

from skyline import Viewer, read_dem, read_photo


@pytest.fixture
def lay(run, dem, photo, pose, tmp_path):
    def laid(*options, poses=(pose,), out="o.tif"):
        given = [word for one in poses for word in ("--pose", one)]
        return run("ortho", photo, *given, "--dem", dem, "-o", tmp_path / out, *options)

    return laid


def test_a_photo_lies_on_the_ground_that_it_shows(lay, dem, photo, tmp_path):
    done = lay("--resolution", 20, "--pixel-lengths", tmp_path / "p.tif").ok()
    assert "cells of 20 m" in done.out
    assert "its place good to" in done.out
    assert "errors assumed, since no covariance is given: place 10 m" in done.out
    terrain = read_dem([dem])
    with rasterio.open(tmp_path / "o.tif") as raster, rasterio.open(tmp_path / "p.tif") as lengths:
        alpha = raster.read(4)
        assert raster.shape == lengths.shape
        assert 0.0 < (alpha == 255).mean() < 1.0
        np.testing.assert_array_equal(alpha == 255, np.isfinite(lengths.read(1)))
        west, south, east, north = terrain.bounds_m
        assert west - 60.0 <= raster.bounds.left < raster.bounds.right <= east + 60.0
        assert south - 60.0 <= raster.bounds.bottom < raster.bounds.top <= north + 60.0


@pytest.mark.parametrize(
    ("options", "out", "said"),
    [
        (("--resolution", 0.001), "o.tif", "give"),
        (("--resolution", -3), "o.tif", "expected above 0"),
        ((), "o.png", "suffix"),
    ],
)
def test_a_mistake_is_one_line(lay, tmp_path, options, out, said):
    assert_refused(lay(*options, out=out), said)
    assert not (tmp_path / out).exists()


def test_as_many_poses_as_photos_are_given(lay, pose):
    assert_refused(lay(poses=(pose, pose)), "2 poses are given for 1 photos")


@pytest.fixture(scope="module")
def points(dem, photo, tmp_path_factory):
    """Six points that the photo shows; the fourth is marked 80 px beside."""
    terrain = read_dem([dem])
    east_m, north_m = 601_800.0, 5_178_000.0
    eye_m = float(terrain.height_at(easting_m=east_m, northing_m=north_m)) + 2.0
    true = candidate_at(east_m, north_m, 140.0, frame=terrain.frame, eye_elevation_m=eye_m)
    view = Viewer(terrain).ground_view(true, read_photo(photo))
    column, row = (one.ravel().astype(float) for one in np.mgrid[20:960:20, 150:600:15])
    seen = view.points(column, row)
    far = np.flatnonzero((seen.distance_m > 400.0) & ~seen.is_grazing)
    chosen = far[np.linspace(0, len(far) - 1, 6).astype(int)]
    lon, lat = terrain.frame.to_lonlat(seen.easting_m[chosen], seen.northing_m[chosen])
    column[chosen[3]] += 80.0
    rows = [
        f"{name},{column[k]},{row[k]},{x},{y}"
        for name, k, x, y in zip("ABCDEF", chosen, lon, lat, strict=True)
    ]
    path = tmp_path_factory.mktemp("points") / "points.csv"
    return csv_of(path, rows, "name,column_px,row_px,lon,lat")


def test_points_orient_a_photo_and_the_wrong_one_is_named(run, dem, photo, pose, points, tmp_path):
    true = json.loads(pose.read_text())
    at = f"{true['lon']},{true['lat']}"
    common = "orient", photo, "--dem", dem, "--points", points, "--height-sd", 1
    checked = tmp_path / "checked.points"
    done = run(*common, "--at", at, "--fov-deg", 60, "--residuals", checked, "--json").ok()
    found = json.loads(done.out)
    assert abs(found["heading_deg"] - true["heading_deg"]) < 0.3
    assert [one["name"] for one in found["points"] if not one["used"]] == ["D"]
    assert checked.read_text().startswith("#CRS: EPSG:4326\nmapX,mapY,sourceX,sourceY,enable")
    held = tmp_path / "held.json"
    held.write_text(done.out)
    again = run(*common, "--pose", held).ok()
    assert "point D: " in again.out
    assert "wrong: left out" in again.out


def test_mistakes_about_points_are_one_line(run, dem, photo, pose, points, tmp_path):
    common = "orient", photo, "--dem", dem
    at = "--at", "{:.6f},{:.6f}".format(*lonlat_of(dem))
    assert_refused(run(*common, *at, "--pose", pose), "give --points FILE too")
    assert_refused(run(*common, "--points", points), "notes no GPS position")
    assert_refused(run(*common, "--points", points, "--pose", pose), "has no covariance")
    assert_refused(run(*common, "--points", points, "--pose", pose, *at), "leave --at")
    off = csv_of(tmp_path / "off.csv", ["961,1,9,46"] * 3, "column_px,row_px,lon,lat")
    assert_refused(run(*common, *at, "--points", off), "outside")


def test_pixels_of_qgis_are_refused_in_a_photo_that_exif_turns(
    run, dem, photo, pose, points, tmp_path
):
    turned, marked, drawn = (tmp_path / name for name in ("turned.jpg", "a.points", "a.geojson"))
    exif = Image.Exif()
    exif[Base.Orientation] = 6
    Image.open(photo).save(turned, exif=exif)
    marked.write_text("#CRS: EPSG:4326\nmapX,mapY,sourceX,sourceY\n9,46,10.5,-20.5\n")
    drawn.write_text('{"type": "Point", "coordinates": [10.5, -20.5]}')
    out = tmp_path / "out.geojson"
    at = "--at", "{:.6f},{:.6f}".format(*lonlat_of(dem))
    orient = "orient", turned, "--dem", dem, *at
    draw = "draw", turned, "--dem", dem, "--pose", pose, "--vectors", drawn, "--pixels", "-o", out
    says = f"is of QGIS, which shows {turned} as its file stores it"
    assert_refused(run(*orient, "--points", marked), f"{marked} {says}")
    checked = tmp_path / "b.points"
    assert_refused(run(*orient, "--points", points, "--residuals", checked), f"{checked} {says}")
    assert_refused(run(*draw), f"{drawn} {says}")
