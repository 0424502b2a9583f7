"""The names of summits in a photo, and the places of its pixels, from the command line."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from commands import assert_refused, csv_of, lonlat_of
from font_scenes import UNDRAWN
from PIL import Image

from skyline import read_dem
from skyline.errors import InputError
from skyline.files.disk import check_outputs


@pytest.fixture(scope="module")
def peaks(dem, tmp_path_factory):
    """A gazetteer of the highest point of each part of the terrain."""
    terrain, rows = read_dem([dem]), []
    for top in range(0, terrain.rows - 10, 10):
        for left in range(0, terrain.cols - 10, 10):
            part = terrain.heights_m[top : top + 10, left : left + 10]
            row, col = np.unravel_index(part.argmax(), part.shape)
            east, north = terrain.to_map(top + row, left + col)
            rows.append(f"P{top}-{left},{east},{north},")
    path = tmp_path_factory.mktemp("peaks") / "peaks.csv"
    return csv_of(path, rows, "name,easting,northing,height_m")


def test_summits_are_named_where_the_pixels_show_them(run, dem, photo, pose, peaks, tmp_path):
    places = tmp_path / "places.npz"
    assert run("pixels", photo, "--pose", pose, "--dem", dem, "-o", places).code == 0
    with np.load(places) as file:
        distance_m = file["distance_m"]
    with Image.open(photo) as picture:
        assert distance_m.shape == picture.size[::-1]
    out = tmp_path / "names.json"
    done = run("label", photo, "--pose", pose, "--dem", dem, "--peaks", peaks, "-o", out)
    named = json.loads(out.read_text())
    total = peaks.read_text().count("\n") - 1
    assert done.out.startswith(f"{out}: {len(named)} of {total} peaks are seen\n")
    assert 3 < len(named) < total
    assert set(named[0]) == {"name", "column_px", "row_px", "distance_m", "elevation_m"}
    terrain = read_dem([dem])
    for one in named:
        row, col = round(one["row_px"]), round(one["column_px"])
        around = distance_m[max(row - 5, 0) : row + 6, max(col - 5, 0) : col + 6]
        assert np.nanmin(np.abs(around - one["distance_m"])) < 60.0, one
        assert one["elevation_m"] <= terrain.heights_m.max()


def test_one_command_names_the_mountains_seen_from_a_place(run, dem, photo, pose, peaks, tmp_path):
    common = "label", photo, "--dem", dem, "--peaks", peaks, "-o", tmp_path / "names.json"
    named = []
    at = "{lon},{lat}".format(**json.loads(pose.read_text()))
    for options in (("--pose", pose), ("--at", at, "--fov-deg", 60)):
        done = run(*common, *options).ok()
        written = json.loads((tmp_path / "names.json").read_text())
        named.append({one["name"]: one for one in written})
    assert "heading" in done.err
    by_pose, by_place = named
    assert len(by_pose.keys() & by_place.keys()) > 0.8 * len(by_pose)
    for name in by_pose.keys() & by_place.keys():
        assert abs(by_pose[name]["column_px"] - by_place[name]["column_px"]) < 10.0


def test_the_pose_that_orient_prints_is_read(run, dem, photo, pose, tmp_path):
    at = "{lon},{lat}".format(**json.loads(pose.read_text()))
    printed = run("orient", photo, "--at", at, "--dem", dem, "--fov-deg", 60, "--json").ok().out
    oriented, places = tmp_path / "oriented.json", tmp_path / "places.npz"
    oriented.write_text(printed)
    assert json.loads(printed)["projection"] == "perspective"
    common = "pixels", photo, "--dem", dem, "--step", 20, "-o", places
    run(*common, "--pose", oriented).ok()
    with np.load(places) as file:
        assert np.isfinite(file["distance_m"]).any()


def test_a_photo_that_does_not_fit_its_place_has_no_names(run, dem, photo, peaks, tmp_path):
    elsewhere = "{},{}".format(*lonlat_of(dem, 600_900.0, 5_177_000.0))
    out = tmp_path / "names.json"
    common = "label", photo, "--dem", dem, "--peaks", peaks, "-o", out
    assert_refused(run(*common, "--at", elsewhere, "--fov-deg", 60))
    assert not out.exists()


def test_each_peak_that_is_missing_has_its_reason(run, dem, photo, pose, peaks, tmp_path):
    common = "label", photo, "--pose", pose, "--dem", dem
    run(*common, "--peaks", peaks, "-o", tmp_path / "names.json").ok()
    seen = json.loads((tmp_path / "names.json").read_text())[0]["name"]
    row = next(one for one in peaks.read_text().splitlines() if one.startswith(f"{seen},"))
    crowd = [row.replace(seen, f"Twin {number}").rstrip(",") for number in range(20)]
    others = ["Behind,600900,5179500", "Away,500000,5000000"]
    some = csv_of(tmp_path / "some.csv", [*crowd, *others], "name,easting,northing")
    shown, *missing = run(*common, "--peaks", some, "-o", tmp_path / "a.png").ok().out.splitlines()
    assert shown.endswith("20 of 22 peaks are seen")
    assert [line.partition(":")[0] for line in missing] == [
        "  no room for a name",
        "  outside the photo",
        "  off the elevation model",
    ]
    assert missing[0].count("Twin") > 5
    assert missing[1].endswith("Behind")
    assert missing[2].endswith("Away")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".svg"])
def test_pictures_have_the_names(run, dem, photo, pose, peaks, tmp_path, suffix):
    out = tmp_path / f"names{suffix}"
    common = "label", photo, "--pose", pose, "--dem", dem, "--peaks", peaks, "--ridges"
    done = run(*common, "-o", out)
    assert (done.code, done.err) == (0, "")
    assert "peaks are seen" in done.out
    if suffix == ".svg":
        text = out.read_text()
        assert re.search(r"<text[^>]*>P\d+-\d+  \d+\.\d km</text>", text)
        assert "data:image/png;base64" in text
    else:
        with Image.open(out) as picture, Image.open(photo) as taken:
            assert picture.height > taken.height * picture.width / taken.width


def test_a_picture_names_the_summits_that_no_font_draws(
    run, dem, photo, pose, peaks, tmp_path, install_font
):
    common = "label", photo, "--pose", pose, "--dem", dem
    run(*common, "--peaks", peaks, "-o", tmp_path / "names.json").ok()
    seen = json.loads((tmp_path / "names.json").read_text())[0]["name"]
    renamed = tmp_path / "renamed.csv"
    renamed.write_text(peaks.read_text().replace(f"{seen},", f"{UNDRAWN},"))
    said = f"\n  no installed font draws 1 name: {UNDRAWN}\n"
    assert said in run(*common, "--peaks", renamed, "-o", tmp_path / "a.svg").ok().out
    assert UNDRAWN not in (tmp_path / "a.svg").read_text()
    install_font("Tiny", UNDRAWN)
    done = run(*common, "--peaks", renamed, "-o", tmp_path / "a.svg").ok()
    assert "no installed font" not in done.out
    assert UNDRAWN in (tmp_path / "a.svg").read_text()


def lines_of_two(photo, record, off):
    """Return the lines of another photo's answer and of the photo's."""
    other = {"photo": "other.jpg", "answer": off, "candidates": [off]}
    result = {"photo": str(photo), "answer": record, "candidates": [record, off]}
    return f"{json.dumps(other)}\n{json.dumps(result)}\n"


@pytest.mark.parametrize(
    ("written", "is_noted"),
    [
        (lambda _, record, off: json.dumps({"answer": record, "candidates": [record, off]}), False),
        (lines_of_two, False),
        (lambda _, record, off: json.dumps({"answer": None, "candidates": [record, off]}), True),
        (lambda _, record, off: json.dumps(record | {"refusal": "fog"}), True),
    ],
    ids=["answer", "lines", "no answer", "refused"],
)
def test_a_pose_is_read_as_commands_print_it(run, dem, photo, pose, tmp_path, written, is_noted):
    def distances_m(path):
        common = "pixels", photo, "--pose", path, "--dem", dem, "--step", 20
        done = run(*common, "-o", tmp_path / "form.npz").ok()
        with np.load(tmp_path / "form.npz") as file:
            return file["distance_m"], done.err

    record = json.loads(pose.read_text())
    form = tmp_path / "form.json"
    form.write_text(written(photo, record, record | {"heading_deg": 10.0}))
    found_m, note = distances_m(form)
    np.testing.assert_array_equal(found_m, distances_m(pose)[0])
    assert bool(note) == is_noted


def test_a_pose_has_the_projection_of_its_photo(run, dem, photo, pose, peaks, tmp_path):
    """A candidate has it from its result, as `match --json` prints it."""
    record = json.loads(pose.read_text()) | {"fov_deg": 120.0}
    result = {"projection": "fisheye", "answer": record, "candidates": [record]}
    for name, content in (("plain", record), ("noted", result)):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))

    def distances_m(name, *options):
        common = "pixels", photo, "--pose", tmp_path / f"{name}.json", "--dem", dem, "--step", 20
        run(*common, *options, "-o", tmp_path / "places.npz").ok()
        with np.load(tmp_path / "places.npz") as file:
            return file["distance_m"]

    fisheye_m = distances_m("plain", "--projection", "fisheye")
    np.testing.assert_array_equal(distances_m("noted"), fisheye_m)
    assert not np.array_equal(distances_m("plain"), fisheye_m, equal_nan=True)
    label = "label", photo, "--pose", tmp_path / "noted.json", "--dem", dem, "--peaks", peaks
    run(*label, "-o", tmp_path / "a.json").ok()
    contradicted = run(*label, "--projection", "cylindrical", "-o", tmp_path / "b.json")
    assert_refused(contradicted, "whose projection is fisheye")


@pytest.mark.parametrize("above_m", [0.0, -4.0])
def test_an_eye_lower_than_a_camera_is_held_is_lifted(run, dem, photo, pose, tmp_path, above_m):
    record = json.loads(pose.read_text())
    ground_m = float(read_dem([dem]).height_at(lon=record["lon"], lat=record["lat"]))
    low = tmp_path / "low.json"
    low.write_text(json.dumps(record | {"eye_elevation_m": ground_m + above_m}))
    common = "pixels", photo, "--pose", low, "--dem", dem, "--step", 20
    run(*common, "-o", tmp_path / "low.npz").ok()
    with np.load(tmp_path / "low.npz") as file:
        seen_m = file["distance_m"][np.isfinite(file["distance_m"])]
        held = json.loads(str(file["pose"]))
    assert held["eye_elevation_m"] == pytest.approx(ground_m + 0.3, abs=1e-6)
    assert np.mean(seen_m < 0.3) < 0.1


def test_pixels_do_not_replace_the_elevation_model(run, dem, photo, pose):
    before = dem.read_bytes()
    assert_refused(run("pixels", photo, "--pose", pose, "--dem", dem.parent, "-o", dem))
    assert dem.read_bytes() == before
    new = dem.with_name("new.tif")
    for output in (new, dem.parent / "new" / "new.tif"):
        done = run("pixels", photo, "--pose", pose, "--dem", dem.parent, "-o", output)
        assert_refused(done)
        assert not output.exists()


def test_two_outputs_of_one_name_are_refused(dem):
    check_outputs([dem], [Path("https://" + 5000 * "x")])  # An address is no file, however long.
    with pytest.raises(InputError):
        check_outputs([dem, None, dem], [])
