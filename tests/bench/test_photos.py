"""Small runs of ``skyline-bench photos`` and ``sky-masks``: columns, places, losses, and masks."""

import json

import numpy as np
import pytest
from commands import assert_refused, lonlat_of
from photo_scenes import make_scene
from PIL import Image

from skyline import read_skyline
from skyline.errors import InputError, MissingFileError
from skyline_bench.queries.manifest import Photograph, read_manifest


@pytest.fixture
def manifest(tmp_path, dem, photo):
    """A photo to locate, the same with a wrong lens and with half of its skyline painted away."""
    lon, lat = lonlat_of(dem)
    image = Image.open(photo)
    sky = np.array(image)
    sky[: int(0.97 * len(sky))] = (90, 140, 200)
    Image.fromarray(sky).save(tmp_path / "sky.jpg")
    query = read_skyline(photo, 60.0)
    rows = np.arange(query.height_px)[:, np.newaxis]
    ground = rows > np.nan_to_num(query.row_px, nan=1e9)
    Image.fromarray(ground).convert("RGB").save(tmp_path / "mask.png")
    lines = [
        "photo,kind,lon,lat,heading_deg,given_fov_deg,mask",
        f"{photo},locate,{lon},{lat},140.95,60,mask.png",
        f"sky.jpg,locate,{lon},{lat},,60,",
        f"{photo},refuse,{lon},{lat},,35,",
        f"{photo},extract,,,,,mask.png",
    ]
    path = tmp_path / "manifest.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_photographs_are_measured(run_bench, manifest, dem, tmp_path):
    record, page = tmp_path / "record.json", tmp_path / "page.html"
    run_bench(
        "photos", manifest, dem, "--side-km", "1.2", "--json", record, "--page", page,
        "--folder", tmp_path / "areas",
    ).ok()  # fmt: skip
    rows = json.loads(record.read_text())["rows"]
    found, sky, refused, extracted = rows
    assert found["error_m"] < 100.0
    assert found["rank"] == 1
    assert abs(found["heading_error_deg"]) < 2.0
    assert found["lost"] in (None, "confidence")
    assert found["right_columns"] > 0.99
    assert (sky["lost"], refused["answered"], refused["lost"]) == ("extraction", False, None)
    assert extracted["found_columns"] > 0.9
    assert str(tmp_path) not in json.dumps(rows)
    assert page.read_text().count("<img") == 3
    summary = json.loads(record.read_text())["summary"]["photos"]
    assert [row["kind"] for row in summary] == ["locate", "refuse", "extract"]
    assert summary[0]["within_200m"] == 0.5
    (store,) = (tmp_path / "areas").rglob("*.h5")
    run_bench("photos", manifest, dem, "--store", store, "--json", record).ok()
    again = json.loads(record.read_text())["rows"][0]
    assert (again["searched"], again["error_m"]) == (store.stem, found["error_m"])


def test_a_mask_s_upper_edge_is_the_truth_whichever_colour_is_sky(tmp_path):
    ground = np.zeros((100, 60, 3), np.uint8)
    ground[40:] = 255
    ground[70:] = 0  # a lake
    for name, picture in (("a.png", ground), ("b.png", 255 - ground)):
        Image.fromarray(picture).save(tmp_path / name)
        one = Photograph(tmp_path / name, "extract", mask=tmp_path / name)
        np.testing.assert_allclose(one.true_row_px(120, 200), 79.5)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("photo,kind\nabsent.jpg,extract\n", MissingFileError, "names 1 files that do not exist"),
        ("photo,kind\na.jpg,locate\n", InputError, "no lon and lat, which locate needs"),
        ("photo,kind\n", InputError, "names no photograph"),
    ],
)
def test_a_bad_manifest_is_one_line(tmp_path, text, error, message):
    path = tmp_path / "manifest.csv"
    path.write_text(text)
    with pytest.raises(error, match=message) as caught:
        read_manifest(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("shift", [0, 8])
def test_masks_say_how_many_trusted_columns_are_right(run_bench, tmp_path, shift):
    for seed in (100, 101):
        scene = make_scene("clear", seed, 480, 320)
        Image.fromarray(scene.image).save(tmp_path / f"clear{seed}.jpg", quality=92)
        is_ground = np.arange(320)[:, np.newaxis] > scene.row_px + shift
        Image.fromarray(is_ground).save(tmp_path / f"clear{seed}.mask.png")
    run_bench("sky-masks", tmp_path, "--json", tmp_path / "record.json").ok()
    rows = json.loads((tmp_path / "record.json").read_text())["rows"]
    assert [(row["half"], row["photos"]) for row in rows] == [("development", 1), ("held out", 1)]
    for row in rows:
        assert row["within"] < 0.1 if shift else row["within"] > 0.95
        assert row["mostly_wrong"] == (1 if shift else 0)
        assert row["trusted"] > 0.85
        assert row["refused"] == 0
    assert_refused(run_bench("sky-masks", tmp_path / "none"), "has 0 masks")
