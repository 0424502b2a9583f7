"""How extraction is measured: drawn conditions, masks of real photographs, training photographs."""

import sys

import cv2
import numpy as np
import pytest
from photo_scenes import make_scene
from PIL import Image

from skyline.errors import InputError
from skyline.photo.extract import extract_skyline
from skyline_bench.queries.drawn_photos import CONDITIONS, draw_recipe
from skyline_bench.runs.sky_masks import mask_rows, measure
from skyline_bench.training.landscapes import GROUND, SKY
from skyline_bench.training.training_photos import draw_training_photo, draw_view


def silent(done, total):
    assert done <= total


@pytest.mark.slow
@pytest.mark.parametrize(
    ("condition", "wrong"),
    [
        ("clear", 0.05),
        ("clouds on the ridge", 0.25),
        ("haze", 0.2),
        ("people", 0.1),
        ("trees", 0.1),
        ("lake", 0.2),
        ("caption and border", 0.15),
        ("snow, blue sky", 0.05),
    ],
)
def test_hard_photos_are_traced_or_masked(condition, wrong):
    error_px, seen, drawn = [], [], list(CONDITIONS).index(condition)
    for seed in (1, 2):
        photo = draw_recipe(np.random.default_rng([seed, drawn]), CONDITIONS[condition])
        found = extract_skyline(photo.image)
        error_px.append(np.abs(found.row_px - photo.row_px)[found.trusted])
        seen.append(found.trusted[photo.visible])
    # A degree of a photo of 1200 columns and 60 degrees; a column in a border has no skyline.
    error_px = np.nan_to_num(np.concatenate(error_px), nan=np.inf)
    assert np.concatenate(seen).mean() > 0.6
    assert (error_px > 600.0 / np.tan(np.radians(30.0)) * np.tan(np.radians(1.0))).mean() < wrong
    assert np.median(error_px) < 1200.0 / 640.0


def write_pair(folder, name, scene, shift=0):
    Image.fromarray(scene.image).save(folder / f"{name}.jpg", quality=92)
    rows = np.arange(len(scene.image))[:, np.newaxis]
    white = 255 * (rows + 0.5 > scene.row_px + 0.5 + shift)
    cv2.imwrite(str(folder / f"{name}.mask.png"), white.astype(np.uint8))


def test_masks_say_how_many_trusted_columns_are_right(tmp_path):
    for seed in (100, 101):
        write_pair(tmp_path, f"clear{seed}", make_scene("clear", seed, 480, 320))
    rows = measure(tmp_path, False, silent)
    assert [row["photos"] for row in rows] == [1, 1]
    for row in rows:
        assert row["within"] > 0.95
        assert row["trusted"] > 0.85
        assert (row["refused"], row["mostly_wrong"]) == (0, 0)
        assert 0.0 < row["seconds"] < row["seconds_12mp"]


def test_a_mask_elsewhere_makes_the_columns_wrong(tmp_path):
    for seed in (100, 101):
        write_pair(tmp_path, f"clear{seed}", make_scene("clear", seed, 480, 320), shift=8)
    rows = measure(tmp_path, True, silent)
    assert all(row["within"] < 0.1 and row["mostly_wrong"] == 1 for row in rows)


def test_columns_without_an_edge_have_no_truth():
    mask = np.zeros((6, 3), np.uint8)
    mask[2:4, 0] = mask[:, 1] = 255
    np.testing.assert_array_equal(mask_rows(mask), [1.5, np.nan, np.nan])


def test_a_folder_without_masks_is_refused(tmp_path):
    with pytest.raises(InputError, match="has 0 masks"):
        measure(tmp_path, False, silent)


def landscape(seed):
    return draw_training_photo((5, seed), 200, 152)


def view(seed):
    return draw_view((5, seed), 1, (200, 152))


@pytest.mark.parametrize("draw", [landscape, view])
def test_training_photographs_have_sky_above_and_ground_below_their_skyline(draw):
    shown = 0
    for seed in range(12):
        photo = draw(seed)
        columns = np.flatnonzero(np.isfinite(photo.row_px))
        row = photo.row_px[columns]
        above = photo.label[np.floor(row - 1.0).astype(int), columns]
        below = photo.label[np.ceil(row + 1.0).clip(max=151).astype(int), columns]
        assert (above == SKY).all()
        assert (below == GROUND).all()
        shown += len(columns)
    assert shown > 0.4 * 12 * 200
    assert draw(11).image.tobytes() == photo.image.tobytes()


def test_training_says_what_it_needs(run_bench, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    done = run_bench("train-sky-model", "-o", tmp_path / "sky.onnx.gz", "--quick")
    assert done.code == 2
    assert "pip install" in done.err
    assert done.err.count("\n") == 1


def test_a_trained_network_is_written_and_read(run_bench, tmp_path):
    pytest.importorskip("torch", reason="torch, which trains, is not installed")
    path = tmp_path / "sky.onnx.gz"
    assert run_bench("train-sky-model", "-o", path, "--quick").code == 0
    assert path.stat().st_size < 600_000
