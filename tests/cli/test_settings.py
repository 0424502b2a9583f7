"""Settings of the environment, and names of photos on standard input."""

import io
import json
import os
import re
import shutil
from pathlib import Path

import pytest
from commands import assert_refused, csv_of

from skyline import cli
from skyline.fetch.overpass import DEFAULT_SERVER

PAGE = Path(__file__).resolve().parents[2] / "docs" / "howto" / "scripts.md"


@pytest.fixture
def peaks(tmp_path):
    return csv_of(tmp_path / "peaks.csv", ["A,602400,5177400"], "name,easting,northing")


@pytest.fixture
def on_input(monkeypatch):
    """Return a function that puts text on standard input."""

    def put(text):
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(os.fsencode(text))))

    return put


def variables_of(command):
    """Return the variables that a command, or a group of them, reads."""
    options = {one.envvar for one in command.params if one.envvar}
    return options.union(*map(variables_of, getattr(command, "commands", {}).values()))


def test_the_page_on_scripts_names_all_settings():
    names = [name for some in cli.COMMANDS.values() for name in some]
    known = set().union(*(variables_of(cli.loaded(name)) for name in names))
    assert {"SKYLINE_DEM", "SKYLINE_QUIET"} < known
    listed = set(re.findall(r"^\| `(SKYLINE_\w+)` \|", PAGE.read_text(), re.MULTILINE))
    assert listed - {"SKYLINE_DEM_SOURCE", "SKYLINE_CACHE", "SKYLINE_GL"} == known


def test_the_model_and_the_peaks_are_those_of_the_environment(
    run, dem, photo, pose, peaks, tmp_path, monkeypatch
):
    monkeypatch.setenv("SKYLINE_DEM", str(dem))
    monkeypatch.setenv("SKYLINE_PEAKS", str(peaks))
    done = run("label", photo, "--pose", pose, "-o", tmp_path / "names.json").ok()
    assert "of 1 peaks are seen" in done.out
    missing = run("label", photo, "--pose", pose, "--dem", tmp_path, "-o", tmp_path / "n.json")
    assert_refused(missing)


def test_peaks_of_the_environment_ask_for_no_report(run, store, photo, peaks, monkeypatch):
    match = "match", store, photo, "--fov-deg", 60, "--matcher", "unrefined"
    assert_refused(run(*match, "--peaks", peaks), "give --report DIR too")
    monkeypatch.setenv("SKYLINE_PEAKS", str(peaks))
    run(*match).ok()


def test_a_quiet_environment_prints_no_notes(run, dem, photo, pose, peaks, tmp_path, monkeypatch):
    record = tmp_path / "pose.json"
    record.write_text(json.dumps(json.loads(pose.read_text()) | {"refusal": "fog"}))
    label = "label", photo, "--pose", record, "--dem", dem, "--peaks", peaks
    assert "fog" in run(*label, "-o", tmp_path / "n.json").ok().err
    monkeypatch.setenv("SKYLINE_QUIET", "1")
    assert run(*label, "-o", tmp_path / "n.json").ok().err == ""


def test_peaks_are_fetched_from_a_public_server_by_default(run, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr("skyline.cli.peaks.fetch_peaks", lambda *given: asked.append(given) or 0)
    peaks = "peaks", "--bounds", "9,46,10,47", "-o", tmp_path / "peaks.geojson"
    run(*peaks).ok()
    monkeypatch.setenv("SKYLINE_PEAKS_SERVER", "http://localhost/api")
    run(*peaks).ok()
    assert [server for _, server, _ in asked] == [DEFAULT_SERVER, "http://localhost/api"]


def photos_of(run, store):
    """Return the photos that a match of standard input names."""
    match = "match", store, "-", "--fov-deg", 60, "--matcher", "unrefined", "--json"
    return [json.loads(line)["photo"] for line in run(*match).ok().out.splitlines()]


def test_names_on_standard_input_are_photos(run, store, photo, on_input, tmp_path, monkeypatch):
    """As `find` prints them: spaces and commas are letters of a name, and a folder is its files."""
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    for name in ("a, b.jpg", "c.jpg", "folder/d.jpg"):
        shutil.copy(photo, name)
    on_input("a, b.jpg\nc.jpg\r\n\nfolder\n")
    assert photos_of(run, store) == ["a, b.jpg", "c.jpg", "folder/d.jpg"]


def test_a_list_on_standard_input_keeps_its_header(
    run, store, photo, on_input, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name in ("path", "c.jpg"):
        shutil.copy(photo, name)
    on_input("path\nc.jpg\n")
    assert photos_of(run, store) == ["c.jpg"]


def test_the_area_that_a_build_adds_to_a_store_is_said_before(run, dem, tmp_path):
    store = tmp_path / "store.h5"

    def built(*bounds):
        build = "build", dem, "--spacing", 300, "-o", store, "--bounds", ",".join(map(str, bounds))
        return run(*build).ok()

    west, south, east, north = json.loads(run("info", dem, "--json").ok().out)["bounds_deg"]
    middle = (west + east) / 2.0
    assert built(west, south, middle, north).err == ""
    (note,) = built(middle, south, east, north).err.splitlines()
    assert note.startswith(f"{store} covers {west:g},{south:g},{middle:g},{north:g}; {middle:g},")
    assert built(middle, south, east, north).err == ""


def test_workers_do_not_read_a_photo_on_standard_input(run, store, on_input):
    on_input("# width=160 height=120\ncolumn_px,row_px\n0,40\n159,50\n")
    refused = run("match", store, "-", "--workers", 2)
    assert_refused(refused, "on standard input is read in this process")


@pytest.mark.parametrize(
    ("text", "said"), [("", "standard input is empty"), ("none.jpg\n", "which is not a file")]
)
def test_input_without_photos_is_refused(run, store, on_input, text, said):
    on_input(text)
    assert_refused(run("match", store, "-"), said)
