"""Messages of mistakes, and options whose names and meanings go one to one."""

import logging
import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import assert_refused, csv_of, lonlat_of
from scenes import WEST_M, fractal, write_dem

from skyline import cli
from skyline.errors import start_logging


def options():
    """Yield the command and the options of every command."""
    for names in cli.COMMANDS.values():
        for name in names:
            command = cli.loaded(name)
            for sub in getattr(command, "commands", {"": command}).values():
                yield (
                    f"{name} {sub.name}",
                    [one for one in sub.params if one.param_type_name == "option"],
                )


def test_an_option_takes_the_same_in_every_command():
    """Files and folders that are written differ by their kind alone."""
    taken = {}
    for command, some in options():
        for option in some:
            if option.metavar and "--output" not in option.opts:
                taken.setdefault(option.opts[0], {}).setdefault(option.metavar, command)
    assert {name: found for name, found in taken.items() if len(found) > 1} == {}


def test_what_is_known_of_a_photo_is_said_to_locate_as_to_match():
    known = {
        command: {
            option.opts[0]
            for option in some
            if option.rich_help_panel == "The photos"
            or option.opts[0] in {"--fov-deg", "--near", "--bounds"}
        }
        for command, some in options()
    }
    assert known["locate locate"] == known["match match"]
    assert {"--heading", "--eye-height", "--use-gps"} <= known["locate locate"]


@pytest.mark.parametrize("command", [(), ("match",), ("dem", "fetch")])
def test_h_is_help(run, command):
    short = run(*command, "-h").ok()
    assert short.out == run(*command, "--help").out
    assert "Usage" in short.out


def test_v_is_the_version(run):
    assert run("-v").ok().out == run("--version").out


def test_a_photo_before_the_store_is_told(run, store, photo):
    for command in ("match", "serve"):
        done = run(command, photo, store)
        assert_refused(done, f"{store} is a store and is named after {photo}")


def test_a_missing_store_is_not_called_a_dem(run, tmp_path):
    for command in (("info",), ("store", "check")):
        done = run(*command, tmp_path / "none.h5")
        assert_refused(done, "none.h5 does not exist; check the name, or build it")
        assert "DEM" not in done.err


def test_a_store_in_place_of_a_dem_is_told(run, store):
    assert_refused(run("horizon", store, "--at", "10.33,46.74"), "is a store; name the elevation")


def test_other_bounds_for_a_store_are_explained(run):
    shown = " ".join(run("build", "--help").ok().out.replace("│", " ").split())
    assert "If it exists, the places of other --bounds are added to it" in shown


def test_a_warning_looks_like_an_error(capsys):
    root = logging.getLogger()
    kept, root.handlers = root.handlers, []
    try:
        start_logging()
        logging.getLogger("skyline").warning("of\nsomething")
        assert capsys.readouterr().err == "warning: of\\nsomething\n"
    finally:
        root.handlers = kept


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
    ("build {dem} -o {renderings}", "is 'renderings' there, 'places' here"),
    ("build {dem} -o {out} --workers 0", "workers is 0; expected 1 or more"),
    ("build {dem} -o {out} --workers nonsense://x", "no dask scheduler answers"),
    ("build {dem} -o {out} --places 400 --spacing 80", "give one of the spacing (a"),
    ("build {dem} -o {out} --spacing 1e9", "choose a smaller spacing"),
    ("build {dem} -o {out} --bounds 46.74,10.32,46.75,10.34", "give 10.32,46.74,10."),
    ("build {dem} -o {tmp}/no/folder.h5", "folder"),
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
    ("explain {dem} --at 5", "expected LON,LAT"),
    ("explain {dem} --at 46.7,190.3", "swapped: give 190.3,46.7"),
    # Match
    ("match {renderings} {photo} --matcher paper", "--fov-deg"),
    ("match {store} {renderings}", "are stores; name photos to find in them"),
    ("match {store} - --workers 2", "standard input is read in this process"),
    ("match {store} {tmp}", "has no pictures"),
    ("match {tmp}/none.h5 {photo} --fov-deg 60", "none.h5"),
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
        "--use-gps acts in refinement",
    ),
    (
        "match {store} {photo} --fov-deg 60 --surface {dem} --matcher unrefined",
        "a surface acts in refinement",
    ),
    (
        "match {store} {photo} --fov-deg 60 --surface {dem} --matcher paper",
        "a surface acts in refinement",
    ),
    ("match {store} {photo} --fov-deg 60 --surface none.tif", "no file"),
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
        "leave --at, --elevation and --fov-deg out",
    ),
    (
        "label {photo} --pose {pose} --dem {dem} --peaks {peaks} -o {tmp}/n.gif",
        "is '.gif'; expected one of .png",
    ),
    (
        "label {photo} --pose {pose} --dem {dem} --peaks {peaks} -o {tmp}/none/n.png",
        "cannot be written",
    ),
    ("label {photo} --pose {pose} --dem {dem} --peaks {peaks} -o {pose}", "is an input"),
    (
        "label {photo} --pose {tmp}/none.json --dem {dem} --peaks {peaks} -o {tmp}/n.png",
        "does not exist; expected JSON as",
    ),
    ("label {photo} --pose {pose} --dem {dem} --peaks {tmp}/none.csv -o {tmp}/n.png", "gazetteer"),
    ("label {photo} --pose {pose} --dem {tmp}/none.tif --peaks {peaks} -o {tmp}/n.png", "none.tif"),
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
    ("locate {peaks} {file} --near {at},2 --dem {dem}", "expected"),
    # Folders in place of files, and arguments left out
    ("orient {photo} --dem {dem} --at {at} -o {tmp}", "is a folder; name a file for the output"),
    ("extract {photo} -o {tmp}", "is a folder; name a file for the output"),
    ("build {dem} --spacing 600 -o {tmp}", "is a folder; name the file of a store"),
    ("orient", "Missing argument 'PHOTO'; see `"),
    # Horizon
    ("horizon {dem}", "give positions as --at LON,LAT or as --viewpoints"),
    ("horizon {dem} --at 7.0,46.8", "the place at lon 7.00000, lat 46.80000 is off"),
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
    ("sun {dem} --at {at} --date 21.6.", "expected a day such as"),
    ("sun {dem} --at {at} --date 0001-01-01", "expected a day such as"),
    ("panorama {dem} --at {at} -o {tmp}/p.svg --fov-deg 2", "expected a field of view of 5 to 360"),
    # Old names
    ("horizon dem.tif --points p.csv", "--viewpoints"),
    ("horizon dem.tif --k 0.2", "No such option: --k"),
    ("peaks --bbox 9,46,10,47", "No such option: --bbox"),
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


def test_stores_of_other_elevation_models_are_not_joined(run, store, photo, tmp_path):
    other, flat = tmp_path / "other.h5", tmp_path / "flat.tif"
    write_dem(flat, np.zeros((40, 40), dtype=np.float32))
    run("build", flat, "--spacing", 80, "-o", other).ok()
    refused = run("match", store, other, photo, "--fov-deg", 60)
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
            "has no lon, lat, heading_deg, fov_deg; expected",
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
