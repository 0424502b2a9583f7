"""``skyline horizon``, ``sun`` and ``panorama``: output, files and errors."""

import csv
import io
import json

import numpy as np
import pytest
from commands import assert_refused, csv_of, lonlat_of
from font_scenes import UNDRAWN
from pyproj import Geod
from rasterio.transform import from_origin
from scenes import fractal, write_dem

from skyline import Frame, horizon, read_dem, stand_at


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    heights = 1500.0 + fractal(120, 140, 900.0, seed=6)
    heights[5:9, 5:9] = np.nan
    heights[4:30, 60:100] = np.nan
    return write_dem(tmp_path_factory.mktemp("dem") / "dem.tif", heights, nodata=np.nan)


@pytest.fixture(scope="module")
def places(dem):
    """Return three places on the DEM, as LON,LAT."""
    terrain = read_dem([dem])
    lon, lat = terrain.frame.to_lonlat(*terrain.to_map([60.0, 80.0, 40.0], [70.0, 30.0, 20.0]))
    return [f"{a:.7f},{b:.7f}" for a, b in zip(lon, lat, strict=True)]


def table(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_csv_is_printed_and_equals_the_result_in_python(run, dem, places, caplog):
    done = run("horizon", dem, "--at", places[0], "--at", places[1]).ok()
    assert len(caplog.records) == 1
    rows = table(done.out)
    assert list(rows[0]) == ["lon", "lat", "azimuth_deg", "elevation_deg", "distance_m"]
    assert len(rows) == 2 * 720
    lon, lat = np.array([place.split(",") for place in places[:2]], dtype=float).T
    found = horizon(read_dem([dem]), lon=lon, lat=lat)
    for name in ("azimuth_deg", "elevation_deg", "distance_m"):
        written = [float(row[name]) for row in rows]
        np.testing.assert_allclose(written, getattr(found, name).ravel(), rtol=1e-5, atol=0.05)
    assert rows[720]["lon"] == places[1].split(",")[0]


MAPS = {
    "EPSG:32632": (9.8, 46.7),
    "EPSG:3857": (9.8, 46.7),
    "EPSG:3395": (9.8, 46.7),
    "EPSG:3413": (16.0, 78.0),
    "EPSG:3034": (9.8, 46.7),
    "EPSG:6933": (9.8, 46.7),
}
"""Maps on which a metre of the ground is between 0.80 and 1.46 m, and a place on each."""


def hill_to_the_north_east(path, crs):
    """Write a DEM of a hill 5 km away from the place on a map, 1,000 m high; return its path."""
    place, frame = MAPS[crs], Frame.from_crs(crs)
    lon, lat, _ = Geod(ellps="WGS84").fwd(*place, 45.0, 5000.0)
    corners = np.array([frame.from_lonlat(*place), frame.from_lonlat(lon, lat)])
    west, south = corners.min(axis=0)
    cols, rows = (np.ptp(corners, axis=0) / 30.0).astype(int) + 40
    transform = from_origin(west - 600.0, south - 600.0 + 30.0 * rows, 30.0, 30.0)
    row, col = np.mgrid[0:rows, 0:cols] + 0.5
    at = frame.to_lonlat(transform.c + 30.0 * col, transform.f - 30.0 * row)
    shape = np.broadcast_to(lon, at[0].shape), np.broadcast_to(lat, at[0].shape)
    from_summit_m = Geod(ellps="WGS84").inv(*at, *shape)[2]
    # A flat top of 100 m, so that no sample misses it.
    heights = 500.0 + np.clip(1000.0 - 0.5 * (from_summit_m - 100.0), 0.0, 1000.0)
    return write_dem(path, heights.astype(np.float32), crs, transform=transform)


@pytest.mark.parametrize("crs", MAPS)
def test_a_hill_is_as_high_as_on_the_ground_on_every_map(run, tmp_path, crs):
    dem = hill_to_the_north_east(tmp_path / "dem.tif", crs)
    common = "horizon", dem, "--at", "{},{}".format(*MAPS[crs]), "--step-deg", 0.25
    done = run(*common).ok()
    highest = max(table(done.out), key=lambda row: float(row["elevation_deg"]))
    # 998 m above the eye less a drop of 1.6 m, 4.9 km away; samples are 30 m apart.
    assert float(highest["elevation_deg"]) == pytest.approx(11.49, abs=0.08)
    assert float(highest["distance_m"]) == pytest.approx(4900.0, abs=35.0)
    assert abs(float(highest["azimuth_deg"]) - 45.0) < 1.0
    assert read_dem([dem]).frame.is_local == (crs != "EPSG:32632")
    assert run(*common, "-q").out == done.out


def test_a_surface_is_shown_beside_the_bare_horizon(run, dem, places, tmp_path):
    canopy = write_dem(tmp_path / "canopy.tif", np.full((120, 140), 20.0, np.float32))
    common = ("horizon", dem, "--at", places[0])
    done = run(*common, "--surface", canopy).ok()
    rows, bare = table(done.out), table(run(*common).out)
    assert all(float(row.pop("surface_deg")) >= float(row["elevation_deg"]) for row in rows)
    assert rows == bare
    target = tmp_path / "both.json"
    assert run(*common, "--surface", canopy, "-o", target).code == 0
    (written,) = json.loads(target.read_text())["places"]
    both = np.array([written["elevation_deg"], written["surface_deg"]])
    assert (both[1] >= both[0]).all()


def test_points_are_read_and_json_is_written(run, dem, places, tmp_path):
    points = csv_of(tmp_path / "points.csv", places, "lon,lat")
    target = tmp_path / "horizons.json"
    run("horizon", dem, "--viewpoints", points, "--step-deg", "10", "-o", target).ok()
    written = json.loads(target.read_text())["places"]
    assert len(written) == 3
    assert written[2]["azimuth_deg"] == list(range(0, 360, 10))
    assert 0.0 < written[0]["sky_view_factor"] < 1.0
    assert len(written[1]["elevation_deg"]) == len(written[1]["distance_m"]) == 36


def test_places_on_standard_input_keep_their_ids(run, dem, places, monkeypatch):
    listed = "longitude;latitude;name\n" + "".join(
        f'{place.replace(",", ";")};"site {number}, A"\n' for number, place in enumerate(places)
    )
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(listed.encode())))
    done = run("horizon", dem, "--viewpoints", "-", "--step-deg", "10", "-o", "-").ok()
    rows = table(done.out)
    assert [row["id"] for row in rows[::36]] == ["site 0, A", "site 1, A", "site 2, A"]
    assert float(rows[36]["lon"]) == pytest.approx(float(places[1].split(",")[0]), abs=1e-7)


def test_the_file_of_pvgis_has_one_angle_a_line_from_north(run, dem, places, tmp_path):
    target = tmp_path / "horizon.txt"
    assert run("horizon", dem, "--at", places[0], "--step-deg", "7.5", "-o", target).code == 0
    angles = [float(line) for line in target.read_text().splitlines()]
    lon, lat = (float(part) for part in places[0].split(","))
    found = horizon(read_dem([dem]), lon=lon, lat=lat, step_deg=7.5)
    np.testing.assert_allclose(angles, np.maximum(found.elevation_deg, 0.0), atol=0.0051)


def test_a_horizon_is_of_the_highest_point_that_was_asked_for(run, dem, places, tmp_path):
    points = csv_of(tmp_path / "points.csv", places[:1], "lon,lat")
    lon, lat = (float(part) for part in places[0].split(","))
    highest = horizon(read_dem([dem]), lon=lon, lat=lat, summit_within_m=100.0)
    for place in (("--at", places[0]), ("--viewpoints", points)):
        first = table(run("horizon", dem, *place, "--summit-within", "100").out)[0]
        assert lon != float(first["lon"]) == pytest.approx(highest.lon, abs=1e-6)
        assert lat != float(first["lat"]) == pytest.approx(highest.lat, abs=1e-6)


@pytest.mark.parametrize(("height_m", "is_asked"), [(120, False), (1500, True)])
def test_an_eye_height_that_may_be_an_elevation_is_asked_about(
    run, dem, places, height_m, is_asked
):
    said = run("horizon", dem, "--at", places[0], "--eye-height", height_m).ok().err
    lon, lat = (float(part) for part in places[0].split(","))
    elevation_m = stand_at(read_dem(dem), lon=lon, lat=lat, eye_height_m=1500.0).eye_elevation_m[0]
    asked = (
        f"up to {elevation_m:.0f} m; if 1500 m is an elevation, give the height above the ground"
    )
    assert (asked in said) == is_asked


def test_a_place_on_a_hole_is_refused(run, dem, tmp_path):
    at = "{:.6f},{:.6f}".format(*lonlat_of(dem, *read_dem([dem]).to_map(15.0, 80.0)))
    panorama = "panorama", "-o", tmp_path / "panorama.png"
    for command in (("horizon",), ("sun", "--date", "2026-06-21"), panorama):
        done = run(command[0], dem, "--at", at, *command[1:])
        assert_refused(done)
    assert not list(tmp_path.iterdir())


def test_the_sun_comes_and_goes(run, dem, places):
    done = run("sun", dem, "--at", places[0], "--date", "2026-06-21").ok()
    rows = table(done.out)
    assert rows
    assert all(row["from_utc"] < row["to_utc"] for row in rows)
    assert rows[0]["from_utc"].startswith("2026-06-21T")
    assert {row["body"] for row in rows} == {"sun", "moon"}
    # It rises in the east and sets in the west.
    assert 0.0 < float(rows[0]["from_azimuth_deg"]) < 180.0 < float(rows[0]["to_azimuth_deg"])


def test_places_are_given_from_which_the_sun_is_over_a_summit(run, dem, places):
    terrain = read_dem([dem])
    row, col = np.unravel_index(np.nanargmax(terrain.heights_m), terrain.heights_m.shape)
    lon, lat = lonlat_of(dem, *terrain.to_map(row, col))
    common = "sun", dem, "--at", f"{lon},{lat}", "--date", "2026-12-21"
    rows = table(run(*common, "--over", f"{lon},{lat}", "--within", 2).ok().out)
    assert list(rows[0])[:4] == ["time_utc", "lon", "lat", "distance_m"]
    # In December the sun is in the south at noon, so one stands in the north.
    noon = min(rows, key=lambda one: abs(float(one["azimuth_deg"]) - 180.0))
    assert float(noon["lat"]) > lat


def test_a_summit_over_which_the_sun_never_stands_is_said(run, dem, places):
    # Seen from within 10 m, it is overhead.
    over = "--over", places[0], "--within", 0.01
    done = run("sun", dem, "--at", places[0], "--date", "2026-12-21", *over).ok()
    assert table(done.out) == []
    assert "neither the sun nor the moon stands over the summit on 2026-12-21" in done.err


def test_a_panorama_with_geojson_peaks(run, dem, places, tmp_path):
    terrain = read_dem([dem])
    row, col = np.unravel_index(np.nanargmax(terrain.heights_m), terrain.heights_m.shape)
    lon, lat = lonlat_of(dem, *terrain.to_map(row, col))
    point = {"type": "Point", "coordinates": [lon, lat]}
    features = [
        {"type": "Feature", "properties": properties, "geometry": geometry}
        for properties, geometry in (
            ({"name": "Top", "ele": "about 2400"}, point),
            ({"ele": "2400"}, point),
            ({"name": "A way"}, {"type": "LineString", "coordinates": [[lon, lat]]}),
        )
    ]
    peaks = tmp_path / "peaks.geojson"
    peaks.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    target = tmp_path / "panorama.svg"
    arguments = ("panorama", dem, "--at", places[1], "--eye-height", "900", "-o", target)
    done = run(*arguments, "--peaks", peaks).ok()
    assert "1 of 1 peaks are seen" in done.out
    assert target.read_bytes().startswith(b"<?xml")


@pytest.mark.parametrize(
    "text", ['{"features": 3}', "[]", "{", '{"features": [{"properties": null}]}']
)
def test_geojson_that_is_none_is_refused(run, dem, places, tmp_path, text):
    peaks = tmp_path / "peaks.geojson"
    peaks.write_text(text)
    arguments = "panorama", dem, "--at", places[1], "-o", tmp_path / "panorama.svg"
    assert_refused(run(*arguments, "--peaks", peaks))
    assert not (tmp_path / "panorama.svg").exists()


def test_a_panorama_names_the_peaks_that_no_font_draws(run, dem, places, tmp_path, install_font):
    terrain = read_dem([dem])
    row, col = np.unravel_index(np.nanargmax(terrain.heights_m), terrain.heights_m.shape)
    easting_m, northing_m = terrain.to_map(row, col)
    header = "name,easting,northing"
    peaks = csv_of(tmp_path / "peaks.csv", [f"{UNDRAWN},{easting_m},{northing_m}"], header)
    target = tmp_path / "panorama.pdf"
    arguments = "panorama", dem, "--at", places[1], "--eye-height", "900", "-o", target
    without = "1 of 1 peaks are seen; no installed font draws 1 name: "
    assert run(*arguments, "--peaks", peaks).ok().out.endswith(f"{without}{UNDRAWN}\n")
    install_font("Tiny", UNDRAWN)
    assert run(*arguments, "--peaks", peaks).ok().out.endswith("1 of 1 peaks are seen\n")
