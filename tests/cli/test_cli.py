"""The command line as a user meets it: what it makes, and one line for every mistake."""

import json
import math
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from scenes import NORTH_M, SPACING_M, WEST_M, fractal, write_dem

from skyline import Matcher, Narrowing, build_places, build_uniform, cli, read_dem, stand_on
from skyline.pipeline import places
from skyline.render.depth import DepthRenderer
from skyline.store import open_store
from skyline_bench.queries.photographs import photograph
from skyline_bench.queries.pinhole import Camera
from skyline_bench.truth import oracle

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def csv_of(path, rows, header="easting,northing"):
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@pytest.fixture
def viewpoints_csv(tmp_path):
    return csv_of(
        tmp_path / "viewpoints.csv",
        [f"{WEST_M + 900 + 300 * i},{NORTH_M - 1500}" for i in range(3)],
    )


@pytest.fixture(scope="session")
def photo(dem, tmp_path_factory):
    """A photograph from a stored viewpoint, heading 140 degrees."""
    terrain = read_dem([dem])
    eye = stand_on(terrain, 601_800.0, 5_178_000.0)
    with DepthRenderer(terrain, 1600) as renderer:
        picture = photograph(renderer, eye, 0, Camera(140.0, fov_deg=60.0), seed=3)
    path = tmp_path_factory.mktemp("photo") / "photo.jpg"
    Image.fromarray(picture).save(path, quality=92)
    return path


def test_version_and_help(run):
    assert run("--version").out.startswith("skyline 0.")
    for command in ("render", "build", "match", "extract", "info"):
        shown = run(command, "--help")
        assert shown.code == 0
        assert "Usage" in shown.out


def test_render_a_list_of_viewpoints(run, dem, viewpoints_csv, tmp_path):
    pictures, out = tmp_path / "pictures", tmp_path / "out.h5"
    done = run(
        "render", dem, "--viewpoints", viewpoints_csv, "-o", out, "--width", "160",
        "--depth-images", pictures,
    )  # fmt: skip
    assert done.code == 0, done.err
    terrain = read_dem([dem])
    eyes = stand_on(terrain, WEST_M + 900 + 300 * np.arange(3), NORTH_M - 1500)
    truth = oracle.skyline(terrain, eyes, 160)
    with open_store(out) as opened:
        views = opened.views()
    assert len(views) == 12
    unflagged = views.flags == 0
    assert unflagged.mean() > 0.3
    error_px = (views.elevation_tan - truth.elevation_tan)[unflagged] * 80.0
    assert np.abs(error_px).max() < 0.51
    depth = cv2.imread(str(pictures / "0001_heading_2.tif"), cv2.IMREAD_UNCHANGED)
    assert depth.shape == (160, 160)
    assert depth.dtype == np.float32
    picture = cv2.imread(str(pictures / "0001.png"))
    assert picture is not None
    assert picture.std() > 20.0


def test_longitudes_and_latitudes_name_the_same_places(run, dem, tmp_path):
    terrain = read_dem([dem])
    lon, lat = terrain.frame.to_lonlat(WEST_M + 1200.0, NORTH_M - 1700.0)
    places = csv_of(tmp_path / "a.csv", [f"{lon:.9f},{lat:.9f},12"], "lon,lat,eye_height_m")
    assert run("render", dem, "--viewpoints", places, "-o", tmp_path / "a.h5").code == 0
    with open_store(tmp_path / "a.h5") as opened:
        place = opened.locations()
    expected = stand_on(terrain, WEST_M + 1200.0, NORTH_M - 1700.0, 12.0)
    np.testing.assert_allclose(place.easting_m, expected.easting_m[0], atol=1e-3)
    np.testing.assert_allclose(place.northing_m, expected.northing_m[0], atol=1e-3)
    np.testing.assert_allclose(place.eye_elevation_m, expected.eye_elevation_m[0], atol=1e-2)


@pytest.mark.parametrize(
    ("options", "rows", "holds"),
    [
        ((), 1804, "places"),
        (("--spacing", "300"), 121, "places"),
        (("--planner", "uniform", "--spacing", "900", "--width", "64"), 4 * 4 * 4, "renderings"),
    ],
)
def test_build_then_the_same_again_renders_nothing(run, dem, tmp_path, options, rows, holds):
    out = tmp_path / "store.h5"
    first = run("build", dem, "-o", out, *options)
    assert first.code == 0, first.err
    assert f"{rows} {holds}, {rows} of them new" in first.out
    again = run("build", dem, "-o", out, *options)
    assert again.code == 0, again.err
    assert f"{rows} {holds}, 0 of them new" in again.out
    with open_store(out) as opened:
        assert (len(opened), opened.header.holds) == (rows, holds)


def test_places_of_a_part_of_the_dem(run, dem, tmp_path):
    terrain, out = read_dem([dem]), tmp_path / "part.h5"
    lon, lat = terrain.frame.to_lonlat([601_000.0, 601_900.0], [5_178_000.0, 5_178_700.0])
    done = run("build", dem, "-o", out, "--bounds", f"{lon[0]},{lat[0]},{lon[1]},{lat[1]}")
    assert done.code == 0, done.err
    with open_store(out) as opened:
        eyes = opened.eyes()
    assert len(eyes.easting_m) == pytest.approx(900 * 700 / 80**2, rel=0.25)
    assert abs(eyes.easting_m - 601_450.0).max() < 450.0 + 30.0
    assert abs(eyes.northing_m - 5_178_350.0).max() < 350.0 + 30.0


RENDERED_ALONE = {
    "--width": 64, "--rows": "exact", "--tolerance-px": 0, "--shells": 12, "--pitch": 50,
    "--threshold-px": 3, "--coverage": 0.9, "--budget": 100, "--seed": 1, "--map": "map.png",
}  # fmt: skip


@pytest.mark.parametrize("option", RENDERED_ALONE)
def test_places_have_no_options_of_renderings(run, dem, tmp_path, option):
    done = run("build", dem, "-o", tmp_path / "s.h5", option, RENDERED_ALONE[option])
    assert_refused(done, "is for a store of renderings; give --planner too")
    assert f"error: {option} {RENDERED_ALONE[option]}" in done.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("option", ["--pitch", "--coverage", "--budget", "--seed", "--map"])
def test_a_uniform_grid_plans_nothing(run, dem, tmp_path, option):
    out = tmp_path / "s.h5"
    done = run("build", dem, "-o", out, "--planner", "uniform", option, RENDERED_ALONE[option])
    assert_refused(done, "uniform does not")
    assert not out.exists()


def test_a_store_holds_one_kind_of_rows(run, dem, store, renderings, viewpoints_csv, tmp_path):
    before = store.read_bytes(), renderings.read_bytes()
    for arguments, kinds in [
        (("build", dem, "-o", renderings), "is 'renderings' there, 'places' here"),
        (("build", dem, "-o", store, "--planner", "uniform"), "is 'places' there, 'renderings'"),
        (("build", dem, "-o", store, "--planner", "cover"), "holds places, not renderings"),
        (("render", dem, "-o", store, "--viewpoints", viewpoints_csv), "exists already"),
    ]:
        assert_refused(run(*arguments), kinds)
    done = run("store", "merge", store, renderings, "-o", tmp_path / "both.h5")
    assert_refused(done, "what it holds")
    assert (store.read_bytes(), renderings.read_bytes()) == before
    assert not (tmp_path / "both.h5").exists()


def test_an_interrupted_build_goes_on_to_the_same_store(dem, tmp_path):
    terrain = read_dem([dem])
    whole, broken = tmp_path / "whole.h5", tmp_path / "broken.h5"
    build_uniform(terrain, whole, 300.0)

    def stop(done, total):
        if done > total // 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_uniform(terrain, broken, 300.0, progress=stop)
    with open_store(broken) as opened:
        kept = len(opened)
    assert 0 < kept < 4 * 110
    resumed = build_uniform(terrain, broken, 300.0)
    assert resumed.rendered == resumed.renderings - kept
    with open_store(whole) as first, open_store(broken) as second:
        assert len(first) == len(second)
        for name in ("easting_m", "heading", "elevation_tan", "depth_m", "flags"):
            np.testing.assert_array_equal(
                getattr(first.views(), name), getattr(second.views(), name)
            )
        np.testing.assert_array_equal(first.keypoint_columns(), second.keypoint_columns())


def test_a_build_stopped_by_ctrl_c_says_so_in_one_line_and_goes_on(
    run, dem, store, tmp_path, monkeypatch
):
    out = tmp_path / "store.h5"

    def stop(done, _total):
        if done >= 1024:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(places.PlaceRows, "viewpoints_a_commit", 512)
        patch.setattr(cli, "build_places", lambda *given: build_places(*given[:-1], stop))
        done = run("build", dem, "-o", out)
    assert done.code == 130
    assert "the same command continues" in done.err
    assert done.err.count("\n") == 1
    again = run("build", dem, "-o", out)
    assert again.code == 0, again.err
    assert "1804 places, 780 of them new" in again.out
    for name, path in (("whole", store), ("resumed", out)):
        assert run("store", "compact", path, "-o", tmp_path / f"{name}.h5").code == 0
    assert (tmp_path / "resumed.h5").read_bytes() == (tmp_path / "whole.h5").read_bytes()


def test_info_of_a_dem_and_of_a_store(run, dem, store, renderings):
    facts = json.loads(run("info", dem, "--json").out)
    assert facts["samples"] == "120 x 110"
    assert facts["frame"] == "EPSG:32632"
    assert facts["spacing_m"] == [30.0, 30.0]
    facts = json.loads(run("info", renderings, "--json").out)
    assert facts["kind"] == "store"
    assert facts["renderings"] == 4 * 30
    assert facts["locations"] == 30
    assert "renderings" in run("info", renderings).out
    facts = json.loads(run("info", store, "--json").out)
    assert facts["kind"] == "store"
    assert facts["places"] == facts["locations"] == 1804
    assert facts["config"]["spacing_m"] == 80.0
    assert facts["dem_files"] == [str(dem)]
    assert "places" in run("info", store).out


def test_info_gl_says_what_was_chosen_and_why(run):
    shown = run("info", "--gl")
    assert shown.code == 0
    facts = json.loads(run("info", "--gl", "--json").out)
    assert facts["renderer"] in shown.out


def test_extract_then_match_the_trace(run, store, photo, tmp_path):
    trace, overlay = tmp_path / "trace.csv", tmp_path / "overlay.png"
    done = run("extract", photo, "-o", trace, "--overlay", overlay)
    assert done.code == 0, done.err
    assert trace.read_text().startswith("# width=960 height=640\n")
    assert cv2.imread(str(overlay)).shape == (640, 960, 3)
    found = run("match", store, trace, "--fov-deg", "60", "--min-confidence", "0", "--json")
    assert found.code == 0, found.err
    record = json.loads(found.out)
    assert set(record) == {"query", "answer", "candidates", "seconds"}
    assert set(record["answer"]) == {
        "easting", "northing", "lon", "lat", "heading_deg", "pitch_deg", "roll_deg", "fov_deg",
        "score", "confidence", "refined",
    }  # fmt: skip
    assert record["answer"] == record["candidates"][0]
    assert record["answer"]["refined"] is True
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
    done = run(*command, "--json", "--geojson", geojson, *workers)
    assert done.code == 2
    assert [json.loads(line)["query"] for line in done.out.splitlines()] == [str(photo)] * 2
    assert re.fullmatch(r"error: .*text\.jpg.*\n", done.err)
    assert json.loads(geojson.read_text())["features"]


def test_what_is_read_is_not_written_over(run, store, photo):
    before = photo.read_bytes(), store.read_bytes()
    for command in (
        ("extract", photo, "-o", photo),
        ("extract", photo, "-o", photo.with_suffix(".csv"), "--overlay", photo),
        ("match", store, photo, "--fov-deg", "60", "--geojson", store),
        ("match", store, photo, "--fov-deg", "60", "--geojson", photo),
    ):
        done = run(*command)
        assert done.code == 2
        assert "choose another name" in done.err
    assert (photo.read_bytes(), store.read_bytes()) == before


@pytest.mark.parametrize("group", ["store", "dem"])
def test_a_group_without_a_command_prints_its_help_alone(run, group):
    done = run(group)
    assert done.code == 2
    assert "Usage" in done.out + done.err
    assert "error:" not in done.err


def test_match_writes_a_report_and_geojson_beside_the_same_json(run, store, photo, tmp_path):
    peaks = csv_of(tmp_path / "peaks.csv", ["Top,601900,5177000"], "name,easting,northing")
    folder, geojson = tmp_path / "report", tmp_path / "found.geojson"
    query = ["match", store, photo, "--fov-deg", "60", "--json"]
    plain = json.loads(run(*query).out)
    done = run(*query, "--report", folder, "--peaks", peaks, "--geojson", geojson)
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
    unwritable = run(*query, "--geojson", photo / "a.json")
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


def test_examples_run(dem, store, photo, viewpoints_csv, tmp_path):
    bin_folder = Path(sys.executable).parent
    environment = {"PATH": f"{bin_folder}:/usr/bin:/bin"}
    batch = subprocess.run(
        [EXAMPLES / "render_batch.sh", dem, viewpoints_csv, tmp_path / "batch.h5"],
        capture_output=True, text=True, env=environment, check=False,
    )  # fmt: skip
    assert batch.returncode == 0, batch.stderr
    assert "12 renderings" in batch.stdout
    query = subprocess.run(
        [sys.executable, EXAMPLES / "match_query.py", store, photo],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert query.returncode == 0, query.stderr
    said = r": (\S+) (\S+) heading (\S+) from true north confidence 0\.\d\d$"
    places = re.findall(said, query.stdout, re.MULTILINE)
    assert 1 <= len(places) <= 3
    lat, lon, heading_deg = map(float, places[0])
    assert abs(heading_deg - 140.95) < 1.5  # the grid's 140, and 0.95 of convergence
    (east_m,), (north_m,) = read_dem([dem]).frame.from_lonlat([lon], [lat])
    assert math.hypot(east_m - 601_800.0, north_m - 5_178_000.0) < 200.0


BAD_CSV = {
    "empty": ("", "is empty"),
    "header only": ("easting,northing\n", "no viewpoints"),
    "wrong columns": ("x,y\n1,2\n", "columns are `x,y`"),
    "two eyes": ("easting,northing,eye_height_m,eye_elevation_m\n1,2,3,4\n", "at most one"),
    "not numbers": (f"easting,northing\n{WEST_M},north\n", "expected 2 numbers"),
    "short row": (f"easting,northing\n{WEST_M}\n", "expected 2 numbers"),
    "off the map": ("easting,northing\n0,0\n", "off the map"),
    "not finite": ("easting,northing\nnan,0\n", "not a finite number"),
    "below ground": (
        f"easting,northing,eye_elevation_m\n{WEST_M + 900},{NORTH_M - 900},-9000\n",
        "below the ground",
    ),
}


@pytest.mark.parametrize("case", BAD_CSV)
def test_bad_viewpoints_are_one_line_and_write_nothing(run, dem, tmp_path, case):
    text, message = BAD_CSV[case]
    path, out = tmp_path / "viewpoints.csv", tmp_path / "out.h5"
    path.write_text(text)
    done = run("render", dem, "--viewpoints", path, "-o", out)
    assert_refused(done, message)
    assert not list(tmp_path.glob("out.h5*"))


def assert_refused(done, message):
    assert done.code == 2, done
    assert message in done.err
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
    assert done.out == ""


def test_bad_dems_are_one_line(run, tmp_path):
    heights = fractal(20, 20)
    text = tmp_path / "text.tif"
    text.write_text("not a raster")
    bands = write_dem(tmp_path / "bands.tif", np.stack([heights, heights], axis=-1))
    naked = write_dem(tmp_path / "naked.tif", heights, crs=None)
    out = tmp_path / "out.h5"
    for path, message in [
        (tmp_path / "none.tif", "none.tif"),
        (text, "text.tif"),
        (bands, "2 bands"),
        (naked, "--crs"),
    ]:
        assert_refused(run("build", path, "-o", out), message)
    assert not out.exists()
    assert run("build", naked, "-o", out, "--crs", "EPSG:32632", "--spacing", "200").code == 0


def test_viewpoint_on_a_hole_is_refused(run, tmp_path):
    heights = fractal(80, 80)
    heights[20:60, 20:60] = np.nan
    dem = write_dem(tmp_path / "hole.tif", heights, nodata=np.nan)
    place = csv_of(tmp_path / "v.csv", [f"{WEST_M + 40 * SPACING_M},{NORTH_M - 40 * SPACING_M}"])
    done = run("render", dem, "--viewpoints", place, "-o", tmp_path / "out.h5")
    assert_refused(done, "on a hole")


def test_bad_options_are_one_line(run, dem, store, renderings, photo, tmp_path):
    out = tmp_path / "out.h5"
    for arguments, message in [
        (["render", dem, "-o", out], "--viewpoints FILE.csv and --grid"),
        (["render", dem, "-o", out, "--grid", "0"], "spacing is 0.0"),
        (["render", dem, "-o", out, "--grid", "500", "--width", "0"], "width is 0"),
        (["build", dem, "-o", out, "--planner", "uniform", "--width", "0"], "width is 0"),
        (["build", dem, "-o", out, "--planner", "uniform", "--rows", "packed"], "packed"),
        (["build", dem, "-o", out, "--k", "2"], "refraction k is 2.0"),
        (["build", dem, "-o", out, "--spacing", "nan"], "spacing is nan"),
        (["build", dem, "-o", out, "--spacing", "1e9"], "choose a smaller spacing"),
        (["build", dem, "-o", out, "--bounds", "1,2,3"], "bounds are `1,2,3`"),
        (["build", dem, "-o", out, "--bounds", "1,2,3,4"], "do not meet the DEM"),
        (["build", dem, "-o", out, "--planner", "best"], "planner is 'best'"),
        (["build", dem], "--output"),
        (["match", renderings, photo, "--matcher", "paper"], "--fov-deg"),
        (["match", store, photo, "--fov-deg", "0"], "0"),
        (["match", store, photo, "--fov-deg", "200"], "200"),
        (["match", store, photo, "--fov-deg", "60", "--matcher", "magic"], "'magic'"),
        (["match", store, photo, "--fov-deg", "60", "--top", "0"], "top is 0"),
        (["match", tmp_path / "none.h5", photo, "--fov-deg", "60"], "none.h5"),
        (["match", store, tmp_path / "none.jpg", "--fov-deg", "60"], "none.jpg"),
        (["info"], "nothing to describe"),
        (["polish"], "polish"),
        (["build", dem, "-o", tmp_path / "no" / "folder.h5"], "folder"),
    ]:
        assert_refused(run(*arguments), message)
    assert not out.exists()


def test_bad_queries_are_one_line(run, store, photo, tmp_path):
    sky = tmp_path / "sky.png"
    Image.new("RGB", (320, 240), (120, 160, 220)).save(sky)
    corrupt = tmp_path / "corrupt.jpg"
    corrupt.write_bytes(photo.read_bytes()[:2000])
    for path, message in [(sky, "no skyline"), (corrupt, "corrupt.jpg")]:
        assert_refused(run("match", store, path, "--fov-deg", "60"), message)
        assert_refused(run("extract", path, "-o", tmp_path / "trace.csv"), message)
    assert not (tmp_path / "trace.csv").exists()


@pytest.mark.parametrize("kind", ["store", "renderings"])
def test_a_store_of_another_dem_is_refused_and_kept(run, kind, tmp_path, request):
    other = write_dem(tmp_path / "other.tif", fractal(110, 120, seed=99))
    store = request.getfixturevalue(kind)
    before = store.read_bytes()
    planner = () if kind == "store" else ("--planner", "uniform", "--spacing", "600")
    done = run("build", other, "-o", store, *planner)
    assert_refused(done, "digest")
    assert store.read_bytes() == before


def test_a_truncated_store_is_refused(run, store, photo, tmp_path):
    cut = tmp_path / "cut.h5"
    cut.write_bytes(store.read_bytes()[:900_000])
    for arguments in (["match", cut, photo, "--fov-deg", "60"], ["info", cut]):
        assert_refused(run(*arguments), "cut.h5")


def test_the_python_interface_of_the_documents(store, photo):
    result = Matcher(store).match(photo, fov_deg=60.0)
    assert result.answer is not None
    assert result.answer == result.candidates[0]
    above = Narrowing(elevation_m=(result.answer.eye_elevation_m + 30.0, 9000.0))
    other = Matcher(store).match(photo, fov_deg=60.0, narrowing=above)
    assert result.answer not in other.candidates


def test_explain_says_what_was_modelled_and_what_it_costs(dem, run):
    west, south, east, north = read_dem([dem]).bounds_m
    place = f"{(west + east) / 2},{(south + north) / 2}"
    told = run("explain", dem, "--at", place, "--tolerance-px", "0.5", "--json")
    facts = json.loads(told.out)
    assert facts["curvature"] == "modelled"
    assert 0.0 <= facts["passed_over_measured_px"] <= facts["passed_over_bound_px"] == 0.5
    assert facts["data_reach_m"] > 0.0
    assert "sight_m" in run("explain", dem, "--at", place).out


@pytest.mark.parametrize(("place", "said"), [("5", "easting and northing"), ("0,0", "off the map")])
def test_explain_refuses_bad_places(dem, run, place, said):
    told = run("explain", dem, "--at", place)
    assert told.code == 2
    assert said in told.err
