"""Messages of mistakes that a command tells without a server."""

import json
import logging
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import assert_refused, csv_of, lonlat_of
from packages import install
from refusals import assert_says
from scenes import NORTH_M, WEST_M, across_antimeridian, fractal, write_dem

from skyline import Frame, open_store, read_dem
from skyline.errors import start_logging
from skyline.files.disk import check_outputs
from skyline.report.results_file import ResultsFile
from skyline.store.write import write_store


def test_a_photo_before_the_store_is_told(run, store, photo):
    for command in ("match", "serve"):
        done = run(command, photo, store)
        assert_refused(done, f"{store} is a store and is named after {photo}")


@pytest.mark.parametrize("name", ["none.h5", "none.hdf5"])
def test_a_missing_store_is_not_called_a_dem(run, tmp_path, name):
    for command in (("info",), ("store", "check")):
        done = run(*command, tmp_path / name)
        assert_refused(done, f"{name} does not exist; check the name, or build it")
        assert "DEM" not in done.err


def test_a_store_in_place_of_a_dem_is_told(run, store):
    assert_refused(run("horizon", store, "--at", "10.33,46.74"), "is a store; name the elevation")


def test_a_warning_looks_like_an_error(capsys):
    root = logging.getLogger()
    kept, root.handlers = root.handlers, []
    try:
        start_logging()
        logging.getLogger("skyline").warning("of\nsomething")
        assert capsys.readouterr().err == "warning: of\\nsomething\n"
    finally:
        root.handlers = kept


WHEN = "when {photo} --pose {pose} --dem {dem}"
MISTAKES = [
    # Build and render
    ("render {dem} -o {out}", "give one of --viewpoints FILE.csv, --spacing M"),
    ("render {dem} -o {out} --planner lpov --workers 2", "--workers 2 does not"),
    ("render {dem} -o {out} --spacing 500 --width 0", "width is 0"),
    ("render {dem} -o {out} --planner lpov --coarse-spacing 50000", "larger than the area"),
    (
        "render {dem} -o {out} --planner nearest",
        "planner is 'nearest'; expected one of arov, hov, lpov, rov, sov",
    ),
    (
        "render {tmp} -o {out} --spacing 9 --depth-images {tmp}/depth",
        "name a folder that holds no DEM",
    ),
    ("render {dem} -o {store} --spacing 600", "is 'places' there, 'renderings' here"),
    ("render {dem} -o {renderings} --planner rov", "config planner is 'uniform' there, 'rov' here"),
    ("build {dem} -o {renderings}", "is 'renderings' there, 'places' here"),
    ("build {dem} -o {out} --workers 0", "workers is 0; expected 1 or more"),
    ("build {dem} -o {out} --workers nonsense://x", "no dask scheduler answers"),
    (
        "build {dem} -o {out} --places 400 --spacing 80",
        "give a spacing (for a uniform grid) or a number",
    ),
    ("build {dem} -o {out} --spacing 1e9", "choose a smaller spacing"),
    ("build {dem} -o {out} --bounds 46.74,10.32,46.75,10.34", "give 10.32,46.74,10."),
    ("build {dem} -o {tmp}/no/folder.h5", "no does not exist; make it first"),
    ("dem fetch --bounds 9.4,46.4 -o {out}", "expected W,S,E,N in degrees"),
    (
        "peaks --bounds 9,46,10,47 --server file:///etc/passwd -o {tmp}/p.geojson",
        "expected the address of an Overpass interpreter",
    ),
    # Stores
    (
        "store merge {store} {renderings} -o {out}",
        "a store holds rows of one kind; name another store",
    ),
    ("info", "nothing to describe"),
    ("info {dem} --crs EPSG:32633", "and --crs EPSG:32633 would put it 4"),
    ("explain {dem} --at 5", "expected LON,LAT"),
    ("explain {dem} --at 46.7,190.3", "swapped: give 190.3,46.7"),
    # Match
    ("match {renderings} {photo} --matcher paper", "--fov-deg"),
    ("match {store} {renderings}", "are stores; name photos to find in them"),
    ("match {store} {tmp}", "has no pictures"),
    ("match {tmp}/none.h5 {photo} --fov-deg 60", "none.h5 does not exist; check"),
    ("match {renderings} {photo} --fov-deg 60", "holds renderings, not places"),
    ("match {store} {photo} --fov-deg 60 --matcher magic", "'magic'"),
    ("match {store} {photo} --fov-deg 60 --matcher paper", "holds places, not renderings"),
    (
        "match {renderings} {photo} --fov-deg 60 --matcher paper --heading 140 --heading-slack 10",
        "cannot narrow its search; use the full one",
    ),
    (
        "match {store} {photo} --fov-deg 60 --report {store}",
        "is an input; choose another name for the output",
    ),
    ("match {store} {photo} --fov-deg 60 --report {file}", "is a file; name a folder"),
    ("match {store} {photo} --fov-deg 60 --report {tmp}/r --peaks {photo}", "cannot be read"),
    ("match {store} {photo} --fov-deg 60 --peaks {peaks}", "--report"),
    ("match {store} {photo} --fov-deg 60 --export {photo}/a.gpx", "cannot be written"),
    (
        "match {store} {photo} --fov-deg 60 --use-gps --matcher unrefined",
        "--use-gps works in refinement",
    ),
    (
        "match {store} {photo} --fov-deg 60 --surface {dem} --matcher unrefined",
        "a surface is used in refinement",
    ),
    (
        "match {store} {photo} --fov-deg 60 --surface {dem} --matcher paper",
        "a surface is used in refinement",
    ),
    ("match {store} {photo} --fov-deg 60 --surface none.tif", "there is no file none.tif"),
    (
        "match {store} {photo} --fov-deg 60 --bounds 9.0,46.0,9.1,46.1",
        "lies within what the search is narrowed to",
    ),
    (
        "match {store} {photo} --fov-deg 60 --near 9.0,46.0,5",
        "lies within what the search is narrowed to",
    ),
    (
        "match {store} {photo} --fov-deg 60 --near 46.7478,10.3327,5",
        "seem to be swapped: give 10.3",
    ),
    ("match {store} {photo} --fov-deg 60 --near 10.3,46.7,0", "a radius above 0 km"),
    ("match {store} {photo} --fov-deg 60 --near 1,2,3,4,5", "expected LON,LAT,KM"),
    ("match {store} {photo} --fov-deg 60 --near 9.8,46.7,9.9,46.8", "give W,S,E,N as --bounds"),
    ("match {store} {photo} --fov-deg 60 --heading 140", "expected both or neither"),
    (
        "match {store} {photo} --fov-deg 60 --heading 140 --heading-slack 0",
        "expected a slack above 0",
    ),
    (
        "match {tmp}/no.h5 {photo} --same-place",
        "needs two photos or more that can be read, and has 1",
    ),
    ("match {tmp}/no.h5 {photo} {photo} --same-place --results {tmp}/r.csv", "leave --results out"),
    ("match {tmp}/no.h5 {photo} {photo} --same-place --matcher unrefined", "leave --matcher out"),
    ("match {tmp}/no.h5 {photo} {photo} --same-place --workers 2", "leave --workers out"),
    # Orient and label
    ("orient {photo} --dem {dem}", "notes no GPS position; give the place: --at LON,LAT"),
    ("orient {photo} --dem {dem} --at 9", "expected LON,LAT in degrees"),
    ("orient {photo} --dem {dem} --at 0,0", "off the map"),
    ("orient {photo} --dem {dem} --at 9.2,46.7 --position-sd 900", "skyline match"),
    ("orient {photo} --dem {dem} --at {at} --elevation 30000", "is 30000 m; expected metres"),
    (
        "orient {photo} --dem {dem} --at {at} --elevation -400",
        "is -400 m, and the ground of the DEM lies",
    ),
    ("orient {tmp}/no.jpg --dem {dem} --at 9,46", "does not exist"),
    (
        "label {photo} --dem {dem} --peaks {peaks} -o {tmp}/n.json",
        "notes no GPS position; give the place: --at LON,LAT",
    ),
    (
        "label {photo} --dem {dem} --peaks {peaks} -o {tmp}/n.json --pose {pose} --at {at}",
        "leave --at, --elevation, --heading, --fov-deg and their errors out",
    ),
    (
        "label {photo} --pose {pose} --dem {dem} --peaks {peaks} -o {tmp}/n.gif",
        "is '.gif'; expected one of .png",
    ),
    (
        "label {photo} --pose {pose} --dem {dem} --peaks {peaks} -o {photo}/n.png",
        "cannot be written",
    ),
    ("label {photo} --pose {pose} --dem {dem} --peaks {peaks} -o {pose}", "is an input"),
    (
        "label {photo} --pose {tmp}/none.json --dem {dem} --peaks {peaks} -o {tmp}/n.png",
        "does not exist; expected JSON as",
    ),
    ("label {photo} --pose {pose} --dem {dem} --peaks {tmp}/none.csv -o {tmp}/n.png", "gazetteer"),
    (
        "label {photo} --pose {pose} --dem {tmp}/none.tif --peaks {peaks} -o {tmp}/n.png",
        "there is no file",
    ),
    ("pixels {photo} --pose {pose} --dem {dem} -o {tmp}/p.csv", "expected one of .npz, .tif"),
    ("pixels {photo} --pose {pose} --dem {dem} -o {dem}", "is an input"),
    # A store in place of an elevation model or of a photo
    ("pixels {photo} --pose {pose} --dem {store} -o {tmp}/p.npz", "is a store; name the elevation"),
    (
        "label {photo} --pose {pose} --dem {renderings} --peaks {peaks} -o {tmp}/n.png",
        "is a store; name the elevation",
    ),
    ("match {store} {photo} --fov-deg 60 --dem {store}", "is a store; name the elevation"),
    ("orient {store} --dem {dem} --at {at}", "is a store; expected a photo, a sky mask or a trace"),
    ("extract {store} -o {tmp}/t.csv", "is a store; expected a photo, a sky mask or a trace"),
    ("locate {store} --near {at},2 --dem {dem}", "is a store; expected a photo"),
    (
        "locate {peaks} {file} --near {at},2 --dem {dem}",
        "starts with 'name,easting,northing'; expected",
    ),
    # Folders in place of files, and arguments left out
    ("orient {photo} --dem {dem} --at {at} -o {tmp}", "is a folder; name a file for the output"),
    ("extract {photo} -o {tmp}", "is a folder; name a file for the output"),
    ("build {dem} --spacing 600 -o {tmp}", "is a folder; name the file of a store"),
    ("orient", "Missing argument 'PHOTO'; see `"),
    # Horizon
    ("horizon {dem}", "give positions as --at LON,LAT or as --viewpoints"),
    ("horizon {dem} --at 7.0,46.8", "the place at lon 7.00000, lat 46.80000 is 2"),
    ("horizon {dem} --at 9.8,95", "expected LON,LAT in degrees"),
    (
        "horizon {dem} --at 36.6,-118.3",
        "longitude and latitude seem to be swapped: give -118.3,36.6",
    ),
    ("horizon {dem} --at {at} -o horizon.doc", "expected one of .csv"),
    ("horizon {dem} --at {at} --surface {dem} -o {tmp}/h.txt", "leave --surface out"),
    (
        "horizon {dem} --at {at} --at {at} -o {tmp}/h.txt",
        "would hold 2 horizons, but .txt holds one",
    ),
    ("horizon {tmp}/no.tif --at 9,46 --step-deg 7", "a divisor of 360"),
    (f"{WHEN} --date 2026-06-21", "give one of --sun COLUMN,ROW"),
    (f"{WHEN} --date 2026-06-21 --sun 1,1 --moon 1,1", "give one of --sun COLUMN,ROW"),
    (f"{WHEN} --sun 1,1", "give --date YYYY-MM-DD for the time of day, or --time"),
    (f"{WHEN} --date 2026-06-21 --sun 1,x", "--sun is `1,x`; expected 2 numbers"),
    (f"{WHEN} --date 2026-06-21 --shadow 1,1", "expected 4 or 6 numbers"),
    (f"{WHEN} --date 2026-06-21 --sun 9999,1", "is outside the photo of"),
    (f"{WHEN} --date 2026-06-21 --shadow 1,1,2,2", "shows sky at this pose"),
    (f"{WHEN} --date 2026-12-01 --sun 1,1", "does not stand there on 2026-12-01"),
    (f"{WHEN} --time 2026-12-01 --sun 1,1", "expected a day and a time"),
    (f"{WHEN} --time 2026-12-01T22:00Z --sun 1,1", "degrees below the horizon at 2026-12-01 22:00"),
    ("sun {dem} --at {at} --date 21.6.", "expected a day such as"),
    ("sun {dem} --at {at} --date 0001-01-01", "expected a day such as"),
    ("sun {dem} --at {at} --date 2026-06-21 --over 46", "--over is `46`; expected LON,LAT"),
    ("sun {dem} --at {at} --date 2026-06-21 --over 0,0", "a DEM that reaches to it"),
    ("sun {dem} --at {at} --date 2026-06-21 --within 0", "expected kilometres above 0"),
    ("panorama {dem} --at {at} -o {tmp}/p.svg --fov-deg 2", "expected a field of view of 5 to 360"),
    ("panorama {dem} --at {at} -o {tmp}/p.svg --peaks {photo}", "cannot be read"),
    # Outputs of another format
    ("horizon {dem} --at {at} -o {tmp}/new.png", "is '.png'; expected one of .csv"),
    ("match {store} {photo} --report {tmp}/new.html", "promises a file"),
    # Old names
    ("horizon dem.tif --points p.csv", "--viewpoints"),
    ("horizon dem.tif --k 0.2", "No such option: --k"),
    ("peaks --bbox 9,46,10,47", "No such option: --bbox"),
    ("panoram {dem}", "Did you mean 'panorama'? See `skyline --help`"),
]
"""Commands, and what the error line of each says, above all what to do."""


@pytest.fixture(scope="module")
def read(dem, store, renderings, photo, pose, tmp_path_factory):
    """The files that commands read, by their names in `MISTAKES`."""
    peaks = tmp_path_factory.mktemp("peaks") / "peaks.csv"
    csv_of(peaks, ["Top,601900,5177000"], "name,easting,northing")
    paths = {"dem": dem, "store": store, "renderings": renderings, "photo": photo, "pose": pose}
    return paths | {"peaks": peaks, "file": Path(__file__)}


@pytest.mark.parametrize(("command", "said"), MISTAKES)
def test_a_mistake_is_one_line_and_writes_nothing(run, read, tmp_path, command, said):
    before = {path: path.read_bytes() for path in read.values()}
    at = "{:.6f},{:.6f}".format(*lonlat_of(read["dem"]))
    given = read | {"at": at, "tmp": tmp_path, "out": tmp_path / "out.h5"}
    assert_refused(run(*(word.format(**given) for word in command.split())), said)
    assert list(tmp_path.iterdir()) == []
    assert {path: path.read_bytes() for path in read.values()} == before


def test_stores_of_other_elevation_models_are_not_joined(run, store, tmp_path):
    other, flat = tmp_path / "other.h5", tmp_path / "flat.tif"
    write_dem(flat, np.zeros((40, 40), dtype=np.float32))
    run("build", flat, "--spacing", 80, "-o", other).ok()
    refused = run("store", "merge", store, other, "-o", tmp_path / "both.h5")
    assert_refused(refused, "cannot be joined: elevation model is 'dem.tif (")
    assert "build both with the same settings from one DEM of both areas" in refused.err


@pytest.mark.parametrize(
    "command", ["build {other} -o {store}", "match {store} {photo} --fov-deg 60 --dem {other}"]
)
def test_another_dem_than_the_stores_is_told(run, store, photo, tmp_path, command):
    other = write_dem(tmp_path / "other.tif", fractal(110, 120, seed=99))
    given = {"other": other, "store": store, "photo": photo}
    assert_refused(run(*(word.format(**given) for word in command.split())), "digest")


def test_a_report_in_the_folder_of_the_photos_is_told(run, store, photo, tmp_path):
    shutil.copy(photo, tmp_path / "a.jpg")
    done = run("match", store, tmp_path, "--report", tmp_path)
    assert_refused(done, "a folder of photos to match")


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        ("path,fov", "one.jpg,60", "has the column `fov`; expected some of path, fov_deg"),
        (
            "path,fov_slack",
            "one.jpg,0.1",
            "`fov_slack`; expected some of path, fov_deg, fov_sd_",
        ),
        ("path,fov_deg", "one.jpg,wide", "line 2: fov_deg is `wide`; expected a number"),
        ("path,lon,lat", "one.jpg,10,46", "has some of lon, lat, radius_km; expected all"),
        ("path,lowest_m,highest_m", "one.jpg,900,100", "line 2: elevations are 900 to 100 m"),
        ("path,fov_deg", "", "is a list without photos"),
    ],
)
def test_a_bad_list_is_refused_in_one_line(run, store, photo, tmp_path, header, row, said):
    shutil.copy(photo, tmp_path / "one.jpg")
    photos = csv_of(tmp_path / "list.csv", [row], header)
    assert_refused(run("match", store, photos), said)


_POSED = '{"lon": 9, "lat": 46, "heading_deg": 1, "fov_deg": 60'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "bad.json is empty; expected JSON as `skyline match --json`"),
        ("{", "bad.json is not JSON (Expecting property name"),
        ("column_px,row_px\n1,2\n", "bad.json is not JSON (Expecting value"),
        ("[1, 2]", "bad.json has no pose; expected JSON"),
        (
            '{"type": "FeatureCollection"}',
            "bad.json is GeoJSON, which draws poses on maps; expected JSON as",
        ),
        ('{"candidates": []}', "is of a match that found no place; give another pose"),
        ('{"lon": 9, "lat": 46, "heading_deg": 1}', "has no fov_deg"),
        ('{"lon": 9, "lat": 46, "heading_deg": "N", "fov_deg": 60}', "heading_deg is N"),
        ('{"lon": 9, "lat": 46, "heading_deg": 1, "fov_deg": 190}', "expected 1 to 179"),
        ('{"lon": 9, "lat": 40, "heading_deg": 1, "fov_deg": 60}', "off the map"),
        (f'{_POSED}, "wander": ["a", 0, 0, 0]}}', "wander is a;"),
        (f'{_POSED}, "wander": 0.1}}', "expected a list of 4 numbers"),
        (f'{_POSED}, "wander": [0.1, 0, 0, 0]}}', "is of a panorama"),
        (f'{_POSED}, "distortion": -2}}', "expected -0.3 to 0.3"),
        (f'{_POSED}, "distortion": true}}', "distortion is True"),
        (f'{_POSED}, "distortion": 1{"0" * 400}}}', "expected a number"),
        ('{"candidates": {"a": 1}}', "has no lon"),
        ('{"photo": "a"}\n{"photo": "b"}', "has 0 lines whose `photo`"),
    ],
)
def test_a_bad_pose_is_refused(run, dem, photo, tmp_path, text, message):
    bad = tmp_path / "bad.json"
    bad.write_text(text)
    out = tmp_path / "out.npz"
    assert_refused(run("pixels", photo, "--pose", bad, "--dem", dem, "-o", out), message)
    assert not out.exists()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("photo", "photo.jpg is a binary file, as photos are; expected JSON as"),
        ("store", "store.h5 is a store; expected JSON as"),
        ("tmp", "cannot be read (Is a directory); expected JSON as"),
        ("peaks", " is a table; expected JSON as"),
    ],
)
@pytest.mark.parametrize("command", ["label", "pixels"])
def test_what_is_no_file_of_a_pose_is_named(run, read, tmp_path, command, given, message):
    pose = (read | {"tmp": tmp_path})[given]
    out = tmp_path / ("out.npz" if command == "pixels" else "out.json")
    peaks = ("--peaks", read["peaks"]) if command == "label" else ()
    done = run(command, read["photo"], "--pose", pose, "--dem", read["dem"], *peaks, "-o", out)
    assert_refused(done, message)
    assert done.err.count("expected JSON") == 1


@pytest.mark.parametrize(
    ("header", "row", "message"),
    [
        ("easting,northing", f"{WEST_M},north", "line 2: northing is `north`"),
        ("easting,northing", "0,0", "off the map"),
        ("lon,lat", "46.75,10.33", "longitude and latitude seem to be swapped: give 10.33,46.75"),
        ("easting,northing,eye_elevation_m", "600900,5179100,-9000", "below the ground"),
    ],
)
def test_bad_viewpoints_are_one_line_and_write_nothing(run, dem, tmp_path, header, row, message):
    path, out = csv_of(tmp_path / "viewpoints.csv", [row], header), tmp_path / "out.h5"
    assert_refused(run("render", dem, "--viewpoints", path, "-o", out), message)
    assert not list(tmp_path.glob("out.h5*"))


def test_a_build_that_was_stopped(run, dem, tmp_path, monkeypatch):
    def stopped(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("skyline.tasks.build.build_store", stopped)
    out = tmp_path / "store.h5"
    part = tmp_path / "store.h5.parts" / "0123" / "places-00001-00004-of-00037.h5"
    part.parent.mkdir(parents=True)
    part.touch()
    done = run("build", dem, "-o", out, "--spacing", 80)
    assert (done.code, done.err.count("\n")) == (130, 1)
    assert "the same command continues" in done.err
    there = "its build is not finished (a part is there)"
    for reading in (("info", out), ("store", "check", out)):
        assert_refused(run(*reading), f"{there}; give the same `skyline build` command again")


def test_bounds_off_a_dem_across_the_antimeridian(run, tmp_path):
    dem, out = across_antimeridian(tmp_path / "dem.tif"), tmp_path / "no.h5"
    done = run("build", dem, "-o", out, "--bounds", "-179.9,-17,-179.8,-16.9")
    assert_refused(done, "which covers 179.9830,-17.0150,-179.9830,-16.9850")


@pytest.fixture
def holed(tmp_path):
    """A DEM with a hole in its middle."""
    heights = np.zeros((90, 90), np.float32)
    heights[30:60, 30:60] = np.nan
    return write_dem(tmp_path / "dem.tif", heights, nodata=np.nan)


@pytest.mark.parametrize(
    "command", ["horizon", "sun --date 2026-06-21", "panorama -o {tmp}/panorama.png"]
)
def test_a_place_on_a_hole(run, holed, tmp_path, command):
    at = "{:.6f},{:.6f}".format(*lonlat_of(holed, WEST_M + 1350.0, NORTH_M - 1350.0))
    name, *options = command.format(tmp=tmp_path).split()
    assert_refused(run(name, holed, "--at", at, *options), "is on a hole of the DEM")


def test_horizons_that_look_over_a_border_or_a_hole(run, holed, caplog):
    at = "{:.6f},{:.6f}".format(*lonlat_of(holed, WEST_M + 300.0, NORTH_M - 300.0))
    run("horizon", holed, "--at", at).ok()
    assert "look over the DEM's border or over a hole" in caplog.text


@pytest.mark.parametrize(
    "text", ['{"features": 3}', "[]", "{", '{"features": [{"properties": null}]}']
)
def test_geojson_that_is_none_is_named(run, dem, tmp_path, text):
    (tmp_path / "peaks.geojson").write_text(text)
    at = "{:.6f},{:.6f}".format(*lonlat_of(dem))
    panorama = "panorama", dem, "--at", at, "-o", tmp_path / "panorama.svg"
    assert_refused(run(*panorama, "--peaks", tmp_path / "peaks.geojson"), "peaks.geojson")


def test_labels_at_a_place_that_does_not_fit(run, read, tmp_path):
    elsewhere = "{},{}".format(*lonlat_of(read["dem"], 600_900.0, 5_177_000.0))
    common = "label", read["photo"], "--dem", read["dem"], "--peaks", read["peaks"]
    done = run(*common, "-o", tmp_path / "n.json", "--at", elsewhere, "--fov-deg", 60)
    assert_refused(done, "direction is not sure")


def test_two_outputs_of_one_name(dem):
    assert_says("the name of two outputs", lambda: check_outputs([dem, None, dem], []))


class TestPixels:
    def test_of_a_pose_that_is_no_answer(self, run, read, tmp_path):
        record, path = json.loads(read["pose"].read_text()), tmp_path / "pose.json"
        photo = {"photo": str(read["photo"])}
        for written, said in (
            ({"answer": None, "candidates": [record]}, "no answer, so the best candidate is taken"),
            (record | {"refusal": "fog"}, "not trusted: fog"),
        ):
            path.write_text(json.dumps(photo | written))
            done = pixels_of(run, read | {"pose": path}, tmp_path / "p.npz").ok()
            assert said in done.err

    @pytest.mark.parametrize(
        ("above_m", "said"), [(0.0, "0.0 m above the ground"), (-4.0, "4.0 m below the ground")]
    )
    def test_of_an_eye_that_is_lifted(self, run, read, tmp_path, above_m, said):
        record = json.loads(read["pose"].read_text())
        ground_m = read_dem([read["dem"]]).height_at(lon=record["lon"], lat=record["lat"])
        record["eye_elevation_m"] = float(ground_m) + above_m
        (tmp_path / "low.json").write_text(json.dumps(record))
        done = pixels_of(run, read | {"pose": tmp_path / "low.json"}, tmp_path / "p.npz").ok()
        assert f"the pose's eye is {said}" in done.err
        assert "it is lifted to 0.3 m above it" in done.err

    @pytest.mark.parametrize("name", ["new.tif", "new/new.tif"])
    def test_in_the_folder_of_the_dem(self, run, read, tmp_path, name):
        shutil.copy(read["dem"], tmp_path / "dem.tif")
        done = pixels_of(run, read | {"dem": tmp_path}, tmp_path / name)
        assert_refused(done, "would become a part of the DEM")


def pixels_of(run, read, out):
    """Run `skyline pixels` with the files that are read."""
    common = "pixels", read["photo"], "--pose", read["pose"], "--dem", read["dem"]
    return run(*common, "--step", 40, "-o", out)


class TestMatches:
    @pytest.fixture
    def match(self, run, store, photo, tmp_path):
        """Return a function that matches the photo, and keeps the results."""
        common = "--matcher", "unrefined", "--results", tmp_path / "r.csv"
        return lambda *more: run("match", store, photo, "--fov-deg", 60, *common, *more)

    def test_that_are_there_already(self, match, tmp_path):
        match().ok()
        results, report = tmp_path / "r.csv", tmp_path / "report"
        said = f"{results}: 1 of 1 are there already"
        assert match().ok().err == f"{said}\n"
        geojson = tmp_path / "x.geojson"
        done = match("--export", geojson, "--report", report).ok()
        assert done.err == f"{said}, and are matched again for {geojson} and {report}\n"

    def test_of_another_search(self, match):
        match().ok()
        assert_refused(match("--near", "10,46,9"), "another store or other options")

    def test_that_another_process_writes(self, match, tmp_path):
        with ResultsFile(tmp_path / "r.csv", "another search"):
            done = match()
        said = f"error: --results {tmp_path / 'r.csv'} is in use by another skyline; wait"
        assert done.err.startswith(said)

    def test_of_photos_that_fail_name_them(self, run, store, photo, tmp_path):
        broken = tmp_path / "text.jpg"
        broken.write_bytes(photo.read_bytes()[:2000])
        rows = [f"{photo},60", f"{broken},60", f"{photo},0.5"]
        listed = csv_of(tmp_path / "l.csv", rows, "path,fov_deg")
        said = run("match", store, listed, "--matcher", "unrefined").err
        assert said.count("\n") == 2
        assert f"error: {broken}" in said
        assert f"error: {photo}: horizontal field of view " in said

    def test_in_a_folder_with_other_files(self, run, store, photo, tmp_path, caplog):
        shutil.copy(photo, tmp_path / "a.jpg")
        (tmp_path / "b.xmp").write_text("<x:xmpmeta/>")
        run("match", store, tmp_path, "--fov-deg", 60, "--matcher", "unrefined").ok()
        said = f"{tmp_path}: 1 file is left out, which is not a picture: b.xmp"
        assert caplog.messages == [said]

    def test_in_a_store_on_a_map_with_wrong_slopes(self, run, store, photo, tmp_path):
        with open_store(store) as opened:
            header = replace(opened.header, frame_wkt=Frame.from_crs("EPSG:3857").wkt)
            write_store(tmp_path / "old.h5", header, opened.stored())
        done = run("match", tmp_path / "old.h5", photo, "--fov-deg", 60)
        said = "and on the map of EPSG:3857 slopes and directions are wrong by up to 8."
        assert_refused(done, said)
        assert "build it again" in done.err

    def test_that_could_not_be_refined(self, run, dem, photo, tmp_path):
        copy, store = shutil.copy(dem, tmp_path / "dem.tif"), tmp_path / "s.h5"
        run("build", copy, "-o", store, "--spacing", "300").ok()
        copy.unlink()
        match = "match", store, photo, "--fov-deg", "60", "--results", tmp_path / "r.csv"
        assert_refused(run(*match), "with --dem, or accept")


@pytest.mark.parametrize("name", ["index.html", "01-map.png", "02-detail.png", "matches.geojson"])
def test_a_report_that_would_replace_a_file_of_other_origin(
    run, store, photo, tmp_path, monkeypatch, name
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "page").mkdir()
    (tmp_path / "page" / name).write_text("mine")
    done = run("match", store, photo, "--fov-deg", 60, "--report", "page")
    said = f"page/{name} would be replaced, and page has no index.html that is marked"
    assert_refused(done, said)


def test_depth_images_that_would_replace_a_picture(run, dem, tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    (frames / "0000.png").write_bytes(b"mine")
    render = "render", dem, "--spacing", 3000, "--width", 32, "-o", tmp_path / "v.h5"
    done = run(*render, "--depth-images", frames)
    assert_refused(done, "0000.png would be replaced, and")


def test_a_planner_that_chooses_no_site(run, dem, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    code = "def wrong(problem, generator):\n    yield [-1]"
    install(tmp_path, "wrongly", code, "skyline.planners", wrong="wrongly:wrong")
    spacing = "--coarse-spacing", "1200", "--site-spacing", "300", "--width", "64"
    done = run("render", dem, "-o", tmp_path / "s.h5", "--planner", "wrong", *spacing)
    assert_refused(done, "planner 'wrong' chose")


@pytest.mark.parametrize("kind", ["store", "renderings"])
def test_a_store_that_is_damaged(run, request, tmp_path, kind):
    data = bytearray(request.getfixturevalue(kind).read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "damaged.h5").write_bytes(data)
    assert_refused(run("store", "check", tmp_path / "damaged.h5"), "is damaged")
