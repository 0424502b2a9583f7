"""`skyline match` and `skyline extract`: places found, written down, refused."""

import csv
import io
import json
import math
import shutil
from dataclasses import replace
from unittest.mock import Mock

import cv2
import geopandas
import numpy as np
import pytest
import rasterio
from commands import assert_refused, csv_of, lonlat_of, off_m
from scenes import write_dem
from shapely import Point

from skyline import InputError, MatchResult, PhotoSkyline, read_dem
from skyline.errors import ContextError
from skyline.geodesy.map_frame import Frame
from skyline.match.matcher import Matcher
from skyline.report.results_file import ResultsFile
from skyline.store.read import open_store
from skyline.store.write import write_store


def test_extract_then_match_the_trace(run, store, dem, photo, tmp_path):
    trace, overlay = tmp_path / "trace.csv", tmp_path / "overlay.png"
    run("extract", photo, "-o", trace, "--overlay", overlay).ok()
    assert trace.read_text().startswith("# width=960 height=640\n")
    assert cv2.imread(str(overlay)).shape == (640, 960, 3)
    found = run("match", store, trace, "--fov-deg", "60", "--json").ok()
    record = json.loads(found.out)
    keys = """photo projection width_px height_px answer answer_within_m answer_confidence
        candidates seconds loading_seconds"""
    assert set(record) == set(keys.split())
    keys = """easting_m northing_m lon lat eye_elevation_m radius_m heading_deg pitch_deg roll_deg
        fov_deg cost confidence confidence_1km refined beyond_share distortion wander
        residual_deg terrain_share skyline_m covariance"""
    assert set(record["answer"]) == set(keys.split())
    assert record["answer"] == record["candidates"][0]
    assert record["answer"]["refined"] is True
    assert 0.0 < record["answer"]["radius_m"] < 100.0
    aside = "{},{},0.4".format(*lonlat_of(dem, 601_000.0, 5_179_000.0))
    found = run("match", store, trace, "--fov-deg", "60", "--near", aside, "--json")
    record = json.loads(found.out)
    assert record["answer"] is None
    assert "confidence" in record["refusal"]


@pytest.mark.parametrize("matcher", ["paper", "correlation"])
def test_match_finds_the_stored_place_of_a_photo(run, renderings, photo, matcher):
    found = run("match", renderings, photo, "--fov-deg", "60", "--matcher", matcher, "--json")
    record = json.loads(found.out)
    best = record["candidates"][0]
    assert abs(best["easting_m"] - 601_800.0) < 1.0
    assert abs(best["northing_m"] - 5_178_000.0) < 1.0
    terrain_turn = 0.95  # grid convergence near 10.33 E in UTM 32, degrees
    assert abs(best["heading_deg"] - 140.0 - terrain_turn) < 1.5
    # These matchers estimate no confidence, so nothing says whether the place is right.
    assert record["answer"] is None
    assert "the matcher estimates no confidence" in record["refusal"]


def test_areas_of_one_dem_are_searched_together(run, store, dem, photo, tmp_path):
    lon, _ = lonlat_of(dem)
    west, east, grown = (tmp_path / f"{name}.h5" for name in ("w", "e", "grown"))
    for area, box in ((west, f"9,46,{lon + 0.003},47"), (east, f"{lon - 0.001},46,11,47")):
        assert run("build", dem, "--spacing", 80, "--bounds", box, "-o", area).code == 0
        run("build", dem, "--spacing", 80, "--bounds", box, "-o", grown).ok()

    def found(*areas):
        done = run("match", *areas, photo, "--fov-deg", 60, "--matcher", "unrefined", "--json").ok()
        return json.loads(done.out)["candidates"]

    assert found(west, east) == found(east, west) == found(grown) == found(store)


def test_a_list_of_photos_says_what_is_known_of_each(run, store, dem, photo, tmp_path):
    lon, lat = lonlat_of(dem, 602_000.0, 5_178_100.0)
    shutil.copy(photo, tmp_path / "one.jpg")
    rows = ["one.jpg,60,2,,,,A", f"one.jpg,60,,{lon},{lat},0.4,B", "absent.jpg,60,,,,,C"]
    header = "path,fov_deg,eye_height_m,lon,lat,radius_km,id"
    photos = csv_of(tmp_path / "list.csv", rows, header)
    found = run("match", store, photos, "--matcher", "unrefined", "--json")
    assert found.code == 2
    records = [json.loads(line) for line in found.out.splitlines()]
    names = ["one.jpg", "one.jpg", "absent.jpg"]
    assert [one["photo"] for one in records] == [str(tmp_path / name) for name in names]
    assert [one["id"] for one in records] == ["A", "B", "C"]
    assert max(off_m(place, 602_000.0, 5_178_100.0) for place in records[1]["candidates"]) < 401.0
    assert max(off_m(place, 602_000.0, 5_178_100.0) for place in records[0]["candidates"]) > 401.0
    assert "does not exist" in records[2]["error"]
    assert found.err.count("\n") == 1


def test_a_surface_is_heeded_in_refinement(run, store, photo, tmp_path):
    canopy = write_dem(tmp_path / "canopy.tif", np.zeros((110, 120), np.float32))
    common = ("match", store, photo, "--fov-deg", "60", "--json")
    done = run(*common, "--surface", canopy).ok()
    found, plain = (json.loads(one.out)["candidates"][0] for one in (done, run(*common)))
    assert math.hypot(*(found[axis] - plain[axis] for axis in ("easting_m", "northing_m"))) < 20.0
    assert found["cost"] != plain["cost"]


UNREFINED = "--fov-deg", "60", "--matcher", "unrefined"


@pytest.fixture
def folder(photo, tmp_path):
    """A folder of two photos and a note."""
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("a.jpg", "b.JPG"):
        shutil.copy(photo, folder / name)
    (folder / "notes.txt").write_text("no photo")
    return folder


def rows_of(results):
    """Return the rows of a file of results, without the times that they took."""
    with results.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        del row["seconds"]
    return rows


def test_a_folder_that_was_stopped_goes_on(run, store, folder, tmp_path):
    results = tmp_path / "results.csv"
    command = "match", store, folder, *UNREFINED, "--results", results
    run(*command).ok()
    whole, wanted = results.read_text(), rows_of(results)
    assert [row["photo"] for row in wanted] == [str(folder / "a.jpg"), str(folder / "b.JPG")]
    results.write_text(whole[:-20])
    again = run(*command)
    assert "a.jpg" not in again.out
    assert "b.JPG" in again.out
    assert rows_of(results) == wanted
    assert results.read_text().splitlines()[0] == whole.splitlines()[0]


def test_a_finished_folder_is_not_matched_again(run, store, folder, tmp_path):
    command = "match", store, folder, *UNREFINED, "--results", tmp_path / "results.csv"
    run(*command).ok()
    assert run(*command).ok().out == ""


def test_results_of_other_options_are_refused(run, store, photo, tmp_path):
    results = tmp_path / "results.csv"
    command = "match", store, photo, *UNREFINED, "--results", results
    run(*command).ok()
    before = results.read_text()
    assert_refused(run(*command, "--near", "10,46,9"))
    assert results.read_text() == before


def test_photos_on_standard_input_are_told_apart_by_their_bytes(
    run, store, photo, tmp_path, monkeypatch
):
    results = tmp_path / "piped.csv"
    for count, content in ((1, photo.read_bytes()), (2, photo.read_bytes() + b" ")):
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(content)))
        run("match", store, "-", *UNREFINED, "--results", results).ok()
        assert len(rows_of(results)) == count


def test_a_pattern_names_the_photos_that_it_matches(run, store, folder):
    assert run("match", store, folder / "?.jpg", *UNREFINED).ok().out.count("(unrefined)") == 5


@pytest.mark.parametrize("options", [(), ("--quiet",), ("--matcher", "unrefined")])
def test_a_store_on_a_map_with_wrong_slopes_is_refused(run, store, photo, tmp_path, options):
    """Earlier releases kept the map of a DEM in EPSG:3857."""
    old = tmp_path / "old.h5"
    with open_store(store) as opened:
        header = replace(opened.header, frame_wkt=Frame.from_crs("EPSG:3857").wkt)
        write_store(old, header, opened.stored())
    done = run("match", old, photo, "--fov-deg", "60", *options)
    assert_refused(done)


def test_a_folder_is_matched_with_its_subfolders_but_without_reports(
    run, store, photo, tmp_path, caplog
):
    folder = tmp_path / "photos"
    (folder / "day 10").mkdir(parents=True)
    (folder / "day 9").mkdir()
    for name in ("day 10/a.jpg", "day 9/IMG_1", "b.insp"):
        shutil.copy(photo, folder / name)
    (folder / "b.xmp").write_text("<x:xmpmeta/>")
    command = ["match", store, folder, "--fov-deg", "60", "--matcher", "unrefined", "--json"]
    done = run(*command, "--report", folder / "report").ok()
    expected = [str(folder / name) for name in ("b.insp", "day 9/IMG_1", "day 10/a.jpg")]
    assert [json.loads(line)["photo"] for line in done.out.splitlines()] == expected
    assert len(caplog.records) == 1
    again = run(*command, "--report", folder / "report").ok()
    assert [json.loads(line)["photo"] for line in again.out.splitlines()] == expected
    caplog.clear()
    assert run(*command, "--quiet").ok().err == ""
    assert not caplog.records


def test_a_repeated_match_ends_as_one_that_did_all_at_once(run, store, photo, tmp_path):
    """It reports the photo that cannot be read, and its export and report have all photos."""
    broken, results = tmp_path / "broken.jpg", tmp_path / "results.csv"
    broken.write_bytes(photo.read_bytes()[:2000])
    command = ["match", store, broken, photo, "--fov-deg", "60", "--matcher", "unrefined"]
    first = run(*command, "--results", results, "--export", tmp_path / "first.geojson")
    assert str(broken) in first.err
    rows = results.read_text()
    again = run(*command, "--results", results)
    assert again.out == ""
    assert again.err.endswith(first.err)
    assert (first.code, again.code) == (2, 2)
    others = "--export", tmp_path / "again.geojson", "--report", tmp_path / "report"
    again = run(*command, "--results", results, *others)
    assert again.code == 2
    assert again.err.endswith(first.err)
    assert others[1].read_bytes() == (tmp_path / "first.geojson").read_bytes()
    assert "photo.jpg" in (tmp_path / "report" / "index.html").read_text()
    assert results.read_text() == rows


def test_results_that_another_process_writes_are_refused(run, store, photo, tmp_path):
    results = tmp_path / "results.csv"
    command = "match", store, photo, "--fov-deg", "60", "--matcher", "unrefined"
    with ResultsFile(results, "another search"):
        done = run(*command, "--results", results)
    assert (done.code, done.out) == (1, "")
    run(*command, "--results", results).ok()
    assert len(results.read_text().splitlines()) == 2


def test_rows_of_a_list_that_are_new_or_changed_are_matched(run, store, photo, tmp_path):
    results = tmp_path / "results.csv"
    for rows, wanted in (
        (["one,60"], ["one"]),
        (["one,60", "two,60"], ["one", "two"]),
        (["one,55", "two,60"], ["one", "two", "one"]),
    ):
        listed = csv_of(tmp_path / "l.csv", [f"{photo},{row}" for row in rows], "path,id,fov_deg")
        run("match", store, listed, "--matcher", "unrefined", "--results", results)
        with results.open() as file:
            assert [row["id"] for row in csv.DictReader(file)] == wanted


def test_a_photo_that_fails_does_not_stop_the_others(run, store, photo, tmp_path):
    text, geojson = tmp_path / "text.jpg", tmp_path / "found.geojson"
    text.write_bytes(photo.read_bytes()[:2000])
    command = ["match", store, photo, text, photo, "--fov-deg", "60", "--matcher", "unrefined"]
    done = run(*command, "--json", "--export", geojson)
    assert done.code == 2
    found = [json.loads(line) for line in done.out.splitlines()]
    assert [one["photo"] for one in found] == [str(photo), str(text), str(photo)]
    assert found[1].keys() == {"photo", "error"}
    assert "text.jpg" in found[1]["error"]
    assert done.err.count("\n") == 1
    assert json.loads(geojson.read_text())["features"]


def test_a_failure_that_is_not_the_photo_s_is_tried_again(run, store, photo, tmp_path, monkeypatch):
    results = tmp_path / "results.csv"
    command = ["match", store, photo, "--fov-deg", "60", "--matcher", "unrefined"]
    with monkeypatch.context() as lost:
        lost.setattr(Matcher, "match", Mock(side_effect=ContextError("the GPU was lost")))
        done = run(*command, "--results", results)
    assert (done.code, done.err) == (1, f"error: {photo}: the GPU was lost\n")
    assert not results.exists() or "lost" not in results.read_text()
    run(*command, "--results", results).ok()
    assert "lost" not in results.read_text()


def test_results_are_not_kept_unrefined_without_a_word(run, dem, photo, tmp_path):
    copy, store = shutil.copy(dem, tmp_path / "dem.tif"), tmp_path / "s.h5"
    run("build", copy, "-o", store, "--spacing", "300").ok()
    copy.unlink()
    match = "match", store, photo, "--fov-deg", "60", "--results", tmp_path / "r.csv"
    assert_refused(run(*match))
    run(*match, "--matcher", "unrefined").ok()


def test_what_is_read_is_not_written_over(run, store, photo, tmp_path):
    peaks = csv_of(tmp_path / "peaks.csv", ["Top,601900,5177000"], "name,easting,northing")
    before = photo.read_bytes(), store.read_bytes(), peaks.read_bytes()
    for command in (
        ("extract", photo, "-o", photo),
        ("extract", photo, "-o", photo.with_suffix(".csv"), "--overlay", photo),
        ("match", store, photo, "--fov-deg", "60", "--export", store),
        ("match", store, photo, "--fov-deg", "60", "--export", photo),
        ("match", store, photo, "--report", tmp_path / "r", "--peaks", peaks, "--export", peaks),
        ("horizon", store, "--viewpoints", peaks, "-o", peaks),
    ):
        assert_refused(run(*command))
    assert (photo.read_bytes(), store.read_bytes(), peaks.read_bytes()) == before


def test_match_writes_a_report_and_geojson_beside_the_json(run, store, photo, tmp_path):
    peaks = csv_of(tmp_path / "peaks.csv", ["Top,601900,5177000"], "name,easting,northing")
    folder, geojson = tmp_path / "report", tmp_path / "found.geojson"
    command = ["match", store, photo, "--fov-deg", "60", "--json"]
    done = run(*command, "--report", folder, "--peaks", peaks, "--export", geojson).ok()
    record = json.loads(done.out)
    html = (folder / "index.html").read_text()
    assert f"{record['answer']['lat']:.5f}" in html
    assert "the skyline rendered at the best candidate" in html
    assert cv2.imread(str(folder / "01-overlay.jpg")).std() > 20.0
    assert json.loads(geojson.read_text())["features"][0]["properties"]["photo"] == str(photo)


@pytest.mark.parametrize("aside", [False, True], ids=["an answer", "no answer"])
def test_the_posterior_is_mapped(run, store, dem, photo, tmp_path, aside):
    tif, kml = tmp_path / "map.tif", tmp_path / "map.kml"
    command = ["match", store, photo, "--fov-deg", "60", "--probability", tif]
    place = 601_000.0, 5_179_000.0
    if aside:
        command += ["--near", "{},{},0.4".format(*lonlat_of(dem, *place))]
    done = run(*command, "--probability", kml).ok()
    assert ("no answer" in done.out) is aside
    with rasterio.open(tif) as raster:
        cells = raster.read(1)
        best = raster.xy(*np.unravel_index(cells.argmax(), cells.shape))
    assert cells.sum(dtype=float) == pytest.approx(1.0, abs=1e-4)
    assert math.dist(best, place if aside else (601_800.0, 5_178_000.0)) < (500 if aside else 30)
    assert kml.read_text().count("<Placemark>") == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--probability", "map.png"), "the suffix of map.png is '.png'; expected one of .tif"),
        (("--probability", "map.tif"), "give map.geojson or map.kml, which hold all"),
        (("--probability", "map.kml", "--matcher", "paper"), "leave --matcher paper out"),
        (("--walked", "4"), "--walked joins the maps of --probability FILE"),
        (("--probability", "map.kml", "--walked", "0"), "expected a speed above 0"),
        (("--probability", "map.kml", "--walked", "4"), "does not note when it was taken"),
    ],
)
def test_posteriors_that_cannot_be_written_are_refused(run, store, photo, options, message):
    assert_refused(run("match", store, photo, photo, "--fov-deg", "60", *options), message)


def test_the_maps_of_a_walk_are_joined(run, store, dem, photo, tmp_path):
    lon, lat = lonlat_of(dem, 601_000.0, 5_179_000.0)
    later = shutil.copy(photo, tmp_path / "later.jpg")
    # The second photo is searched 900 to 1700 m from the first, half an hour later.
    rows = f"{photo},2026-07-14T15:00,,,", f"{later},2026-07-14T15:30,{lon},{lat},0.4"
    walk = csv_of(tmp_path / "walk.csv", rows, "path,time,lon,lat,radius_km")
    found = tmp_path / "both.json"
    run("match", store, walk, "--fov-deg", "60", "--probability", found, "--walked", "2.8").ok()
    shapes = geopandas.read_file(found).to_crs(read_dem([dem]).frame.wkt)
    assert list(shapes.share) == [0.5, 0.8, 0.95] * 2
    first = Point(601_800.0, 5_178_000.0)
    assert shapes.geometry[2].hausdorff_distance(first) < 100.0
    # At most 1.4 km were walked. Half of its area alone lies farther away.
    likely = shapes.geometry[4]
    assert likely.distance(first) > 900.0
    assert likely.difference(first.buffer(1430.0)).area < 0.01 * likely.area
    never = csv_of(tmp_path / "never.csv", [f"{photo},soon"], "path,time")
    assert_refused(run("match", store, never), "expected a day and a time such as")


def test_a_posterior_is_of_a_search(store):
    fitted = MatchResult(PhotoSkyline(np.full(40, 10.0), np.ones(40), 40, 30), (), 1.0)
    with Matcher(store) as matcher:
        for wrong in (fitted, [fitted]):
            with pytest.raises(InputError, match="the result of `match`"):
                matcher.posterior(wrong)


@pytest.mark.slow
def test_photos_of_one_place_have_one_posterior(run, store, photo, tmp_path):
    maps = tmp_path / "map.tif", tmp_path / "map.json"
    asked = [part for one in maps for part in ("--probability", one)]
    run("match", store, photo, photo, "--fov-deg", "60", "--same-place", *asked).ok()
    assert len(json.loads(maps[1].read_text())["features"]) == 3
