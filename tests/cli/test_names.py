"""Files whose names are not UTF-8, or hold line ends and control characters."""

import csv
import json
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as Xml
from pathlib import Path

import pytest
from commands import assert_refused, csv_of, lonlat_of

NOT_UTF8 = os.fsdecode(b"b\xe4r")
NAMES = {f"{NOT_UTF8}.jpg": r"b\xe4r.jpg", "a\n<i>\x1b[31m.jpg": r"a\n<i>\x1b[31m.jpg"}
"""Names of photos, and how each is shown."""


@pytest.fixture
def photos(photo, tmp_path, monkeypatch):
    """The photo under each name, in the working folder."""
    monkeypatch.chdir(tmp_path)
    for name in NAMES:
        shutil.copy(photo, name)
    return list(NAMES)


def test_a_dem_that_gdal_cannot_open_is_refused(run, dem, store, photo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    odd = f"{NOT_UTF8}.tif"
    shutil.copy(dem, odd)
    for command in (
        f"info {odd}",
        f"build {odd} -o new.h5",
        f"panorama {odd} --at 10.33,46.74 -o new.png",
        f"match {store} {photo} --dem {odd}",
        f"match {store} {photo} --surface {odd} --results new.csv",
    ):
        assert_refused(run(*command.split()), r"b\xe4r")
        assert [path.name for path in tmp_path.iterdir()] == [odd]


def test_photos_of_any_name_are_matched_and_written(run, store, photos):
    kinds = ("kml", "gpx", "geojson")
    written = [part for kind in kinds for part in ("--export", f"out.{kind}")]
    common = ("match", store, *photos, "--fov-deg", "60", "--matcher", "unrefined")
    done = run(*common, *written, "--report", "report", "--results", "out.csv", "--json").ok()
    shown = list(NAMES.values())
    assert [json.loads(line)["photo"] for line in done.out.splitlines()] == shown
    with Path("out.csv").open(encoding="utf-8", newline="") as file:
        assert [row["photo"] for row in csv.DictReader(file)] == shown
    table = json.loads(Path("out.geojson").read_text(encoding="utf-8"))
    assert {one["properties"]["photo"] for one in table["features"]} == set(shown)
    for kind in ("kml", "gpx"):
        names = {one.text.rpartition(":")[0] for one in Xml.parse(f"out.{kind}").iter() if one.text}
        assert set(shown) <= names
    page = Path("report/index.html").read_text(encoding="utf-8")
    assert r"<h2>b\xe4r.jpg</h2>" in page
    assert r"<h2>a\n&lt;i&gt;\x1b[31m.jpg</h2>" in page
    again = run(*common, "--results", "out.csv")
    assert (again.code, again.out) == (0, "")


def test_ids_of_any_name_are_written(run, dem, tmp_path):
    (tmp_path / "points.csv").write_bytes(
        b"id,lon,lat\nb\xe4r," + "{},{}\n".format(*lonlat_of(dem)).encode()
    )
    common = "horizon", dem, "--viewpoints", tmp_path / "points.csv", "--step-deg", "45"
    for name in ("out.csv", "out.json"):
        run(*common, "-o", tmp_path / name).ok()
    assert rows_of(tmp_path / "out.csv")[0]["id"] == r"b\xe4r"
    assert json.loads((tmp_path / "out.json").read_text())["places"][0]["id"] == r"b\xe4r"


def test_stores_and_pictures_of_any_name(run, dem, store, photo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    odd = f"{NOT_UTF8}.h5"
    shutil.copy(store, odd)
    for command, shown in (
        (f"store check {odd}", r"b\xe4r.h5: 1,804 places, whole"),
        (f"store check {odd} --json", r'"b\\xe4r.h5"'),
        (f"store merge {odd} {store} -o m{odd}", r"mb\xe4r.h5: 1,804 places"),
        (f"store export {odd} -o {NOT_UTF8}.gpkg", r"b\xe4r.gpkg: 1,804 places"),
        (f"build {dem} -o n{odd} --spacing 900", r"nb\xe4r.h5: "),
        (f"extract {photo} -o {NOT_UTF8}.csv --overlay {NOT_UTF8}.png", r"b\xe4r.csv"),
        (f"match {odd} {NOT_UTF8}.csv --fov-deg 60 --matcher unrefined", r"b\xe4r.csv ("),
        (f"render {dem} -o r{odd} --spacing 2000 --depth-images {NOT_UTF8}", r"rb\xe4r.h5: "),
    ):
        done = run(*command.split()).ok()
        assert shown in done.out
    assert (tmp_path / NOT_UTF8 / "0000_heading_0.tif").stat().st_size > 1000


POSIX = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def test_a_terminal_of_few_letters_takes_what_is_printed(store, photo, tmp_path):
    name = b"\xe5\xb1\xb1 b\xe4r.jpg"
    shutil.copy(photo, tmp_path / os.fsdecode(name))
    command = [sys.executable, "-m", "skyline", "match", store, name, b"no\xe4.jpg"]
    command += ["--fov-deg", "60", "--matcher", "unrefined"]
    options = {"env": os.environ | POSIX, "cwd": tmp_path}
    done = subprocess.run(command, capture_output=True, check=False, **options)
    assert done.returncode == 2, done.stderr
    assert rb"b\xe4r.jpg (" in done.stdout
    assert done.stderr.startswith(rb"error: no\xe4.jpg does not exist")
    assert b"Traceback" not in done.stderr


FORMULA = "=cmd|' /C calc'!A0"


def rows_of(path):
    with Path(path).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_no_name_is_a_formula_to_a_spreadsheet(run, dem, store, photo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(photo, "-2+3.jpg")
    place = "{:.6f},{:.6f}".format(*lonlat_of(dem))
    csv_of(Path("points.csv"), [f"{FORMULA},{place}"], "id,lon,lat")
    csv_of(Path("list.csv"), [f"-2+3.jpg,{FORMULA},60"], "path,id,fov_deg")
    run("horizon", dem, "--viewpoints", "points.csv", "-o", "horizon.csv").ok()
    common = "list.csv", "--matcher", "unrefined"
    found = json.loads(run("match", store, *common, "--results", "results.csv", "--json").ok().out)
    run("orient", "list.csv", "--at", place, "--dem", dem, "-o", "oriented.csv").ok()
    assert found["id"] == FORMULA
    for table in ("horizon.csv", "results.csv", "oriented.csv"):
        row = rows_of(table)[0]
        assert row["id"] == f"'{FORMULA}"
        assert float(row["lon"]) == pytest.approx(found["candidates"][0]["lon"], abs=0.02)
        if "photo" in row:
            assert row["photo"] == "'-2+3.jpg"
    # What is written is read as it was.
    csv_of(Path("points.csv"), [f"{rows_of('horizon.csv')[0]['id']},{place}"], "id,lon,lat")
    run("horizon", dem, "--viewpoints", "points.csv", "-o", "horizon.json").ok()
    assert json.loads(Path("horizon.json").read_text())["places"][0]["id"] == FORMULA
