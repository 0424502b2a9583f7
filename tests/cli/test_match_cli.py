"""`skyline match` and `skyline extract`: places found, narrowed, refused."""

import json
import math
import re
import shutil

import cv2
import numpy as np
import pytest
from commands import assert_refused, csv_of
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from PIL.TiffImagePlugin import IFDRational
from scenes import SPACING_M, fractal, write_dem

from skyline import Matcher, Narrowing, console, read_dem, stand_on
from skyline.render.depth import DepthRenderer
from skyline_bench.queries.photographs import photograph
from skyline_bench.queries.pinhole import Camera


def test_extract_then_match_the_trace(run, store, photo, tmp_path):
    trace, overlay = tmp_path / "trace.csv", tmp_path / "overlay.png"
    done = run("extract", photo, "-o", trace, "--overlay", overlay)
    assert done.code == 0, done.err
    assert trace.read_text().startswith("# width=960 height=640\n")
    assert cv2.imread(str(overlay)).shape == (640, 960, 3)
    found = run("match", store, trace, "--fov-deg", "60", "--min-confidence", "0", "--json")
    assert found.code == 0, found.err
    record = json.loads(found.out)
    assert set(record) == {
        "query",
        "answer",
        "answer_within_m",
        "candidates",
        "seconds",
        "loading_seconds",
    }
    assert set(record["answer"]) == {
        "easting", "northing", "lon", "lat", "eye_elevation_m", "radius_m", "heading_deg",
        "pitch_deg", "roll_deg", "fov_deg", "score", "confidence", "confidence_1km",
        "refined",
    }  # fmt: skip
    assert record["answer"] == record["candidates"][0]
    assert record["answer"]["refined"] is True
    assert 0.0 < record["answer"]["radius_m"] < 100.0
    found = run("match", store, trace, "--fov-deg", "60", "--min-confidence", "1", "--json")
    record = json.loads(found.out)
    assert record["answer"] is None
    assert "confidence" in record["refusal"]


@pytest.mark.parametrize("matcher", ["paper", "correlation"])
def test_match_finds_the_stored_place_of_a_photo(run, renderings, photo, matcher):
    found = run("match", renderings, photo, "--fov-deg", "60", "--matcher", matcher, "--json")
    answer = json.loads(found.out)["answer"]
    assert abs(answer["easting"] - 601_800.0) < 1.0
    assert abs(answer["northing"] - 5_178_000.0) < 1.0
    terrain_turn = 0.95  # grid convergence near 10.33 E in UTM 32, degrees
    assert abs(answer["heading_deg"] - 140.0 - terrain_turn) < 1.5
    plain = run("match", renderings, photo, "--fov-deg", "60", "--matcher", matcher)
    assert "unrefined" in plain.out
    narrowed = run(
        *("match", renderings, photo, "--fov-deg", "60", "--matcher", matcher),
        *("--heading", "140,10"),
    )
    assert_refused(narrowed, "only the full matcher can narrow its search")
    assert_refused(
        run("match", renderings, photo, "--fov-deg", "60"), "holds renderings, not places"
    )


@pytest.mark.parametrize("matcher", ["paper", "correlation"])
def test_the_papers_matchers_take_renderings_alone(run, store, photo, matcher):
    done = run("match", store, photo, "--fov-deg", "60", "--matcher", matcher)
    assert_refused(done, "holds places, not renderings")


def lonlat_of(dem, easting_m, northing_m):
    lon, lat = read_dem([dem]).frame.to_lonlat(easting_m, northing_m)
    return float(lon), float(lat)


CELL_M = 40.0 * math.sqrt(2.0)
"""No place of a grid of 80 m is farther off than this."""


def retrieved(run, store, photo, *options):
    """Return what was found for a photo taken at (601800, 5178000), looking 141 degrees."""
    found = run(
        *("match", store, photo, "--fov-deg", "60", "--no-refine", "--min-confidence", "0"),
        *("--json", *options),
    )
    assert found.code == 0, found.err
    record = json.loads(found.out)
    assert record["candidates"]
    return record["candidates"]


def off_m(place, easting_m=601_800.0, northing_m=5_178_000.0):
    return math.hypot(place["easting"] - easting_m, place["northing"] - northing_m)


def test_match_near_a_place(run, store, dem, photo):
    lon, lat = lonlat_of(dem, 602_000.0, 5_178_100.0)
    found = retrieved(run, store, photo, "--near", f"{lon},{lat},0.4")
    assert off_m(found[0]) < CELL_M
    assert max(off_m(place, 602_000.0, 5_178_100.0) for place in found) < 401.0
    lon, lat = lonlat_of(dem, 601_000.0, 5_179_000.0)
    found = retrieved(run, store, photo, "--near", f"{lon},{lat},0.4")
    assert max(off_m(place, 601_000.0, 5_179_000.0) for place in found) < 401.0


def test_match_within_bounds(run, store, dem, photo):
    west, south = lonlat_of(dem, 600_800.0, 5_177_500.0)
    east, north = lonlat_of(dem, 601_500.0, 5_178_500.0)
    for place in retrieved(run, store, photo, "--bounds", f"{west},{south},{east},{north}"):
        # Meridians are not parallel to the map's north.
        assert 600_800.0 - 20.0 < place["easting"] < 601_500.0 + 20.0
        assert 5_177_500.0 - 20.0 < place["northing"] < 5_178_500.0 + 20.0


@pytest.mark.parametrize("heading", [141.0, 300.0])
def test_match_along_a_heading(run, store, photo, heading):
    found = retrieved(run, store, photo, "--heading", f"{heading},8")
    for place in found:
        assert abs(place["heading_deg"] - heading) <= 8.0
    assert (off_m(found[0]) < CELL_M) == (heading == 141.0)


def test_match_between_elevations(run, store, dem, photo):
    ground_m = read_dem([dem]).height_at
    true_m = float(ground_m(601_800.0, 5_178_000.0))
    found = retrieved(run, store, photo, "--elevation", f"{true_m - 20},{true_m + 20}")
    assert off_m(found[0]) < CELL_M
    # A retrieved eye stands where the slope of its place says that the ground is.
    for place in retrieved(run, store, photo, "--elevation", f"{true_m + 40},{true_m + 400}"):
        assert ground_m(place["easting"], place["northing"]) > true_m + 30.0


def test_refined_places_stay_within_bounds(run, store, dem, photo):
    west, south = lonlat_of(dem, 600_800.0, 5_177_500.0)
    east, north = lonlat_of(dem, 601_500.0, 5_178_500.0)
    found = run(
        *("match", store, photo, "--fov-deg", "60", "--json"),
        *("--bounds", f"{west},{south},{east},{north}"),
    )
    for place in json.loads(found.out)["candidates"]:
        assert 600_800.0 - 20.0 < place["easting"] < 601_500.0 + 20.0


def lensed(photo, path, focal_mm, size=None):
    """Write a copy of a photo, 960 x 640, that notes a 35 mm equivalent and a frame's size."""
    exif = Image.Exif()
    noted = exif.get_ifd(IFD.Exif)
    noted[Base.FocalLengthIn35mmFilm] = focal_mm
    if size is not None:
        noted[Base.ExifImageWidth], noted[Base.ExifImageHeight] = size
    with Image.open(photo) as image:
        image.save(path, quality=95, exif=exif)
    return path


def test_what_a_photo_notes_of_its_lens_is_weighed(run, store, photo, tmp_path):
    """The photo spans 60 degrees: 36 mm of film at 31 mm."""
    plain = lensed(photo, tmp_path / "plain.jpg", 31, (3000, 2000))
    cropped = lensed(photo, tmp_path / "cropped.jpg", 24, (4000, 3000))
    lie = lensed(photo, tmp_path / "lie.jpg", 9999)
    found = run("match", store, plain, cropped, lie, "--json")
    assert found.code == 0, found.err
    told = [json.loads(line) for line in found.out.splitlines()]
    assert all(off_m(one["answer"]) < 60.0 for one in told)
    assert all(abs(one["answer"]["fov_deg"] - 60.0) < 1.5 for one in told)
    lenses = [one["lens"] for one in told]
    assert lenses[0]["fov_deg"] == pytest.approx(60.3, abs=0.1)
    assert lenses[1]["most_deg"] > 60.0 > lenses[1]["fov_deg"]
    assert "cropped" in lenses[1]["said"]
    assert lenses[2]["fov_deg"] is None
    said = run("match", store, plain, cropped, lie, "--no-refine").out
    assert "field of view: 60.3 degrees; EXIF's 35 mm equivalent" in said
    assert "field of view: 53.7 degrees, give or take 10; EXIF's 35 mm equivalent, but" in said
    assert "field of view: not known; EXIF's 35 mm equivalent left aside: 0.21 degrees" in said


def test_a_list_of_photos_says_what_is_known_of_each(run, store, dem, photo, tmp_path):
    lon, lat = lonlat_of(dem, 602_000.0, 5_178_100.0)
    shutil.copy(photo, tmp_path / "one.jpg")
    rows = ["one.jpg,60,2,,,", f"one.jpg,60,,{lon},{lat},0.4", "absent.jpg,60,,,,"]
    photos = csv_of(tmp_path / "list.csv", rows, "path,fov_deg,eye_height_m,lon,lat,radius_km")
    found = run("match", store, photos, "--no-refine", "--min-confidence", "0", "--json")
    assert found.code == 2
    told = [json.loads(line) for line in found.out.splitlines()]
    assert [one["query"] for one in told] == [str(tmp_path / name) for name in (
        "one.jpg", "one.jpg", "absent.jpg"
    )]  # fmt: skip
    assert max(off_m(place, 602_000.0, 5_178_100.0) for place in told[1]["candidates"]) < 401.0
    assert max(off_m(place, 602_000.0, 5_178_100.0) for place in told[0]["candidates"]) > 401.0
    assert "does not exist" in told[2]["error"]
    assert found.err.count("\n") == 1


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        ("path,fov", "one.jpg,60", "has the column 'fov'; expected some of path, fov_deg"),
        ("path,fov_deg", "one.jpg,wide", "line 2: fov_deg is 'wide'; expected a number"),
        ("path,lon,lat", "one.jpg,10,46", "has some of lon, lat, radius_km; expected all"),
        ("path,fov_deg", ",60", "line 2 has no path"),
        ("path,eye_height_m", "one.jpg,-3", "line 2: the eye is -3 m above the ground"),
        ("path,fov_deg", "one.jpg,400", "horizontal field of view is 400 degrees"),
    ],
)
def test_a_list_that_is_none_is_one_line(run, store, photo, tmp_path, header, row, said):
    shutil.copy(photo, tmp_path / "one.jpg")
    photos = csv_of(tmp_path / "list.csv", [row], header)
    assert_refused(run("match", store, photos), said)


def test_a_wrong_query_is_refused_before_the_store_is_opened(run, photo, tmp_path):
    """The store is none: opening it would be the error."""
    trace = tmp_path / "trace.csv"
    trace.write_text("# width=960 height=640\ncolumn_px,row_px\n1200,300\n")
    for query, options, said in (
        (photo, ("--fov-deg", "200"), "horizontal field of view is 200 degrees"),
        (trace, ("--fov-deg", "60"), "column 1200 is outside the image"),
        (tmp_path / "absent.jpg", (), "does not exist"),
    ):
        assert_refused(run("match", photo, query, *options), said)


def test_what_takes_long_is_said(run, store, photo, monkeypatch):
    monkeypatch.setattr(console, "_PATIENCE_S", 0.0)
    done = run("match", store, photo, "--fov-deg", "60", "--no-refine", "--top", "9999")
    assert f"opening {store} and its elevation model takes a while" in done.err
    assert f"matching {photo} takes a while" in done.err
    assert "of 9999 candidates" in done.out


def test_a_surface_is_heeded_in_refinement(run, store, photo, tmp_path):
    canopy = write_dem(tmp_path / "canopy.tif", np.zeros((110, 120), np.float32))
    common = ("match", store, photo, "--fov-deg", "60", "--json")
    done = run(*common, "--surface", canopy)
    assert done.code == 0, done.err
    found, plain = (json.loads(one.out)["candidates"][0] for one in (done, run(*common)))
    assert math.hypot(*(found[axis] - plain[axis] for axis in ("easting", "northing"))) < 20.0
    assert found["score"] != plain["score"]
    for options in (("--no-refine",), ("--matcher", "paper")):
        assert_refused(run(*common, "--surface", canopy, *options), "a surface acts in refinement")
    assert_refused(run(*common, "--surface", "none.tif"), "no file")


def test_a_folder_that_was_stopped_goes_on(run, store, photo, tmp_path):
    folder, results = tmp_path / "photos", tmp_path / "results.csv"
    folder.mkdir()
    for name in ("a.jpg", "b.JPG"):
        shutil.copy(photo, folder / name)
    (folder / "notes.txt").write_text("no photo")
    command = ("match", store, folder, "--fov-deg", "60", "--no-refine", "--results", results)
    assert run(*command).code == 0
    whole = results.read_text()
    assert [line.split(",")[0] for line in whole.splitlines()] == [
        "query", str(folder / "a.jpg"), str(folder / "b.JPG"),
    ]  # fmt: skip
    results.write_text(whole[:-20])
    again = run(*command)
    assert "1 of 2 are there already" in again.err
    assert "a.jpg" not in again.out
    rows = [line.split(",") for line in results.read_text().splitlines()]
    wanted = [line.split(",") for line in whole.splitlines()]
    seconds = wanted[0].index("seconds")
    for row, other in zip(rows, wanted, strict=True):
        row[seconds] = other[seconds]
    assert rows == wanted
    assert run(*command).out == ""
    assert_refused(run(*command, "--near", "10,46,9"), "another store or other options")
    (tmp_path / "empty").mkdir()
    assert_refused(run("match", store, tmp_path / "empty"), "has no pictures")
    wild = run("match", store, folder / "?.jpg", "--fov-deg", "60", "--no-refine")
    assert wild.out.count("(unrefined)") == 5


def claiming(photo, path, lonlat, heading_deg=None, reference="T"):
    """Write a copy of a photo that says it was taken elsewhere; return its path."""
    exif = Image.Exif()
    gps = exif.get_ifd(IFD.GPSInfo)
    for angle, name, side in zip(lonlat, ("Longitude", "Latitude"), ("EW", "NS"), strict=True):
        gps[GPS[f"GPS{name}"]] = (IFDRational(round(abs(angle) * 1e6), 1_000_000), 0.0, 0.0)
        gps[GPS[f"GPS{name}Ref"]] = side[angle < 0.0]
    if heading_deg is not None:
        gps[GPS.GPSImgDirection] = IFDRational(round(heading_deg * 100), 100)
        gps[GPS.GPSImgDirectionRef] = reference
    with Image.open(photo) as image:
        image.save(path, quality=95, exif=exif)
    return path


def test_a_photo_s_own_claim_is_shown(run, store, dem, photo, tmp_path):
    told = claiming(photo, tmp_path / "told.jpg", lonlat_of(dem, 601_800.0, 5_178_240.0), 112.0)
    found = run("match", store, told, "--fov-deg", "60", "--json")
    exif = json.loads(found.out)["exif"]
    assert exif["distance_m"] == pytest.approx(240.0, abs=40.0)
    assert exif["heading_off_deg"] == pytest.approx(29.0, abs=2.0)
    assert exif["heading_is_magnetic"] is False
    said = run("match", store, told, "--fov-deg", "60", "--report", tmp_path / "report").out
    assert "m from the answer. Its compass says 112 degrees, the answer 141." in said
    page = (tmp_path / "report" / "index.html").read_text()
    assert "m from the answer. Its compass says 112 degrees" in page
    assert f"{exif['lat']:.5f}" not in page
    assert "exif" not in json.loads(run("match", store, photo, "--fov-deg", "60", "--json").out)


@pytest.mark.parametrize("workers", [(), ("--workers", "1")])
def test_a_wrong_claim_does_not_hide_the_right_place(run, store, dem, photo, tmp_path, workers):
    right, beside = (601_800.0, 5_178_000.0), (601_000.0, 5_179_000.0)
    claims = [
        claiming(photo, tmp_path / "right.jpg", lonlat_of(dem, *right), 141.0),
        claiming(photo, tmp_path / "beside.jpg", lonlat_of(dem, *beside), 300.0, "M"),
        claiming(photo, tmp_path / "far.jpg", (-70.0, -33.0)),
    ]
    found = run("match", store, *claims, "--fov-deg", "60", "--use-gps", "--json", *workers)
    assert found.code == 0, found.err
    told = [json.loads(line) for line in found.out.splitlines()]
    assert all(off_m(one["answer"]) < 30.0 for one in told)
    assert off_m(told[0]["answer"]) < 10.0
    assert told[1]["exif"]["distance_m"] == pytest.approx(math.hypot(800.0, 1000.0), abs=40.0)
    assert told[2]["exif"]["distance_m"] > 1e7


def test_the_gps_acts_in_refinement(run, store, photo):
    done = run("match", store, photo, "--use-gps", "--no-refine")
    assert_refused(done, "--use-gps acts in refinement")


def test_a_search_narrowed_to_nothing_is_one_line(run, store, photo, tmp_path):
    command = ["match", store, photo, "--fov-deg", "60"]
    for options in (
        ("--bounds", "9.0,46.0,9.1,46.1"),
        ("--near", "9.0,46.0,5"),
        ("--elevation", "8000,9000"),
    ):
        done = run(*command, *options)
        assert_refused(done, "no place within what the search is narrowed to")
    done = run(*command, "--elevation", "8000,9000", "--report", tmp_path / "report")
    assert done.code == 2
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--near", "10.3,46.7"), "--near is `10.3,46.7`; expected 3 numbers LON,LAT,KM"),
        (("--near", "10.3,46.7,0"), "a radius above 0 km"),
        (("--near", "10.3,95,3"), "longitude and latitude"),
        (("--bounds", "1,2,3"), "bounds are `1,2,3`"),
        (("--heading", "140"), "--heading is `140`; expected 2 numbers DEG,SLACK"),
        (("--heading", "north,5"), "--heading is `north,5`"),
        (("--heading", "140,0"), "expected a slack above 0"),
        (("--elevation", "900,100"), "expected two that increase"),
        (("--elevation", "nan,100"), "expected two that increase"),
    ],
)
def test_a_narrowing_that_is_none_is_one_line(run, store, photo, options, said):
    assert_refused(run("match", store, photo, "--fov-deg", "60", *options), said)


def test_a_dem_that_is_not_the_stores_is_one_line(run, store, photo, tmp_path):
    other = write_dem(tmp_path / "other.tif", fractal(110, 120, seed=99))
    done = run("match", store, photo, "--fov-deg", "60", "--dem", other)
    assert_refused(done, "digest")


@pytest.mark.parametrize("workers", [(), ("--workers", "1")])
def test_a_query_that_fails_does_not_stop_the_others(run, store, photo, tmp_path, workers):
    text, geojson = tmp_path / "text.jpg", tmp_path / "found.geojson"
    text.write_text("no photo")
    command = ["match", store, photo, text, photo, "--fov-deg", "60", "--no-refine"]
    done = run(*command, "--json", "--export", geojson, *workers)
    assert done.code == 2
    found = [json.loads(line) for line in done.out.splitlines()]
    assert [one["query"] for one in found] == [str(photo), str(text), str(photo)]
    assert found[1].keys() == {"query", "error"}
    assert "text.jpg" in found[1]["error"]
    assert re.fullmatch(r"error: .*text\.jpg.*\n", done.err)
    assert json.loads(geojson.read_text())["features"]


def test_what_is_read_is_not_written_over(run, store, photo):
    before = photo.read_bytes(), store.read_bytes()
    for command in (
        ("extract", photo, "-o", photo),
        ("extract", photo, "-o", photo.with_suffix(".csv"), "--overlay", photo),
        ("match", store, photo, "--fov-deg", "60", "--export", store),
        ("match", store, photo, "--fov-deg", "60", "--export", photo),
    ):
        done = run(*command)
        assert done.code == 2
        assert "choose another name" in done.err
    assert (photo.read_bytes(), store.read_bytes()) == before


def test_match_writes_a_report_and_geojson_beside_the_same_json(run, store, photo, tmp_path):
    peaks = csv_of(tmp_path / "peaks.csv", ["Top,601900,5177000"], "name,easting,northing")
    folder, geojson = tmp_path / "report", tmp_path / "found.geojson"
    query = ["match", store, photo, "--fov-deg", "60", "--json"]
    plain = json.loads(run(*query).out)
    done = run(*query, "--report", folder, "--peaks", peaks, "--export", geojson)
    assert done.code == 0, done.err
    record = json.loads(done.out)
    assert record["candidates"] == plain["candidates"]
    html = (folder / "index.html").read_text()
    assert f"{record['answer']['lat']:.5f}" in html
    assert "the skyline rendered at the best candidate" in html
    assert cv2.imread(str(folder / "01-overlay.jpg")).std() > 20.0
    features = json.loads(geojson.read_text())["features"]
    points = [f for f in features if f["properties"]["shape"] == "candidate"]
    ranks = [point["properties"]["rank"] for point in points]
    assert ranks == list(range(1, len(record["candidates"]) + 1))
    assert points[0]["properties"]["query"] == str(photo)
    assert_refused(run(*query, "--peaks", peaks), "--report")
    assert_refused(run(*query, "--report", folder, "--peaks", photo), "cannot be read")
    unwritable = run(*query, "--export", photo / "a.json")
    assert unwritable.code == 2
    assert "cannot be written" in unwritable.err


def test_a_report_goes_without_relief_where_the_dem_is_gone(run, dem, photo, tmp_path, caplog):
    moved, store = tmp_path / "moved.tif", tmp_path / "store.h5"
    moved.write_bytes(dem.read_bytes())
    assert run("build", moved, "-o", store, "--spacing", "300").code == 0
    moved.unlink()
    done = run("match", store, photo, "--fov-deg", "60", "--report", tmp_path / "report")
    assert done.code == 0, done.err
    assert "no relief: the store's DEM is not at" in caplog.text
    assert "no elevation model" in (tmp_path / "report" / "index.html").read_text()


def test_bad_queries_are_one_line(run, store, photo, tmp_path):
    sky = tmp_path / "sky.png"
    Image.new("RGB", (320, 240), (120, 160, 220)).save(sky)
    corrupt = tmp_path / "corrupt.jpg"
    corrupt.write_bytes(photo.read_bytes()[:2000])
    for path, message in [(sky, "no skyline"), (corrupt, "corrupt.jpg")]:
        assert_refused(run("match", store, path, "--fov-deg", "60"), message)
        assert_refused(run("extract", path, "-o", tmp_path / "trace.csv"), message)
    assert not (tmp_path / "trace.csv").exists()


def test_a_truncated_store_is_refused(run, store, photo, tmp_path):
    cut = tmp_path / "cut.h5"
    cut.write_bytes(store.read_bytes()[:900_000])
    for arguments in (["match", cut, photo, "--fov-deg", "60"], ["info", cut]):
        assert_refused(run(*arguments), "cut.h5")


def place_m(candidate):
    return candidate.easting_m, candidate.northing_m


def test_the_python_interface_of_the_documents(store, photo):
    result = Matcher(store).match(photo, fov_deg=60.0)
    assert result.answer is not None
    assert result.answer == result.candidates[0]
    eye_m = result.answer.eye_elevation_m
    beside = Narrowing(elevation_m=(eye_m - 30.0, eye_m + 30.0))
    same = Matcher(store).match(photo, fov_deg=60.0, narrowing=beside)
    assert math.dist(place_m(same.answer), place_m(result.answer)) < SPACING_M
    assert all(abs(one.eye_elevation_m - eye_m) <= 30.0 for one in same.candidates)
    above = Narrowing(elevation_m=(eye_m + 30.0, 9000.0))
    others = Matcher(store).match(photo, fov_deg=60.0, narrowing=above).candidates
    assert all(one.eye_elevation_m >= eye_m + 30.0 for one in others)


@pytest.fixture(scope="module")
def photos_of_one_place(dem, photo, tmp_path_factory):
    """The photo, one more from its place, and one from another place."""
    folder, terrain = tmp_path_factory.mktemp("photos"), read_dem([dem])
    looks = {
        "other_way.jpg": (601_800.0, 5_178_000.0, 30.0),
        "stranger.jpg": (601_200.0, 5_178_600.0, 200.0),
    }
    with DepthRenderer(terrain, 1600) as renderer:
        for name, (*place, heading_deg) in looks.items():
            eye = stand_on(terrain, *place)
            picture = photograph(renderer, eye, 0, Camera(heading_deg, fov_deg=60.0), seed=3)
            Image.fromarray(picture).save(folder / name, quality=92)
    return [photo, *(folder / name for name in looks)]


def test_photos_of_one_place_are_matched_together(run, store, photos_of_one_place, tmp_path):
    first, second, stranger = photos_of_one_place
    points, broken = tmp_path / "points.geojson", tmp_path / "broken.jpg"
    broken.write_bytes(b"no picture")
    done = run(
        *("match", store, first, second, stranger, broken, "--fov-deg", "60", "--same-place"),
        *("--json", "--top", "1", "--export", points),
    )
    assert done.code == 2
    assert str(broken) in done.err
    record = json.loads(done.out)
    assert record["answer_within_m"] in (200.0, 1000.0)
    assert record["candidates"] == [record["answer"]]
    assert math.hypot(
        record["answer"]["easting"] - 601_800.0, record["answer"]["northing"] - 5_178_000.0
    ) < min(10.0, 3.0 * record["answer"]["radius_m"])
    assert [one["query"] for one in record["photos"]] == [str(one) for one in photos_of_one_place]
    assert [one["agrees"] for one in record["photos"]] == [True, True, False]
    assert abs(record["photos"][0]["heading_deg"] - 141.0) < 1.0
    assert abs(record["photos"][1]["heading_deg"] - 31.0) < 1.0
    assert "heading_deg" not in record["photos"][2]
    features = json.loads(points.read_text())["features"]
    at = [one["geometry"]["coordinates"] for one in features if one["geometry"]["type"] == "Point"]
    assert len(at) == 2
    assert at[0] == at[1]


def test_what_does_not_go_with_one_place_is_refused_at_once(run, photo, tmp_path):
    def refused(*arguments):
        return run("match", tmp_path / "no_store.h5", photo, *arguments, "--same-place")

    assert_refused(refused(), "needs two photos or more that can be read, and has 1")
    assert_refused(refused(photo, "--results", tmp_path / "r.csv"), "leave --results out")
    assert_refused(refused(photo, "--no-refine"), "leave --no-refine and --matcher out")
    assert_refused(refused(photo, "--workers", 2), "leave --workers and --scheduler out")
