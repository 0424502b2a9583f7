"""Skylines of photos: geometry, fields of view, traces and masks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from skyline.errors import InputError
from skyline.match import batch
from skyline.photo.photo import read_photo
from skyline.photo.read import read_skyline
from skyline.photo.skyline import PhotoSkyline
from skyline.photo.trace import read_trace, write_trace
from skyline.report.skyline_overlay import write_overlay


def skyline_of(row_px, height_px=100):
    row_px = np.asarray(row_px, dtype=float)
    return PhotoSkyline(row_px, np.isfinite(row_px) * 1.0, len(row_px), height_px)


@given(
    st.lists(st.one_of(st.just(np.nan), st.floats(-0.5, 99.5)), min_size=1, max_size=60).filter(
        lambda rows: np.isfinite(rows).any()
    )
)
def test_trace_roundtrip_is_exact(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("trace") / "trace.csv"
    skyline = skyline_of(rows)
    write_trace(skyline, path)
    back = read_trace(path)
    assert_array_equal(back.row_px, skyline.row_px)
    assert (back.width_px, back.height_px) == (skyline.width_px, skyline.height_px)
    assert path.read_text().startswith(f"# width={len(rows)} height=100\ncolumn_px,row_px\n")


def test_trust_is_a_number_from_0_to_1_and_a_masked_row_is_none():
    rows = np.ma.array([3.0, 4.0], mask=[False, True])
    assert PhotoSkyline(rows, np.array([1.0, 0.0]), 2, 9).trusted.tolist() == [True, False]
    assert PhotoSkyline(rows, np.array([1.0 + 1e-9, -1e-9]), 2, 9).trust[0] > 1.0
    for wrong in (255.0, -0.1, np.nan):
        with pytest.raises(InputError):
            PhotoSkyline(np.array([3.0, 4.0]), np.array([1.0, wrong]), 2, 9)


def trace_file(folder, points, notes=""):
    path = folder / "trace.csv"
    path.write_text(f"# width=100 height=50{notes}\ncolumn_px,row_px\n{points}")
    return path


def test_sparse_and_fractional_points_are_joined_but_not_across_gaps(tmp_path):
    drawn = read_trace(trace_file(tmp_path, "3,10\n4,\n5,10\n"))
    assert_array_equal(np.flatnonzero(drawn.trusted), [3, 5])
    # Points 7.5 columns apart are joined, points 10.5 apart (more than 100/10) are not.
    skyline = read_skyline(trace_file(tmp_path, "18.0,9\n0.5,20.0\n8.0,35.0\n28.5,1\n"), 60.0)
    trusted = np.flatnonzero(skyline.trusted)
    assert_array_equal(trusted, np.r_[1:19])
    assert_allclose(skyline.row_px[1:9], 20.0 + 2.0 * (np.arange(1, 9) - 0.5))
    assert skyline.row_px[18] == 9.0
    assert skyline.fov_deg == 60.0


@pytest.mark.parametrize("comma", [",", ";"])
def test_separators_may_stand_between_the_notes_of_a_trace(tmp_path, comma):
    path = tmp_path / "trace.csv"
    text = "# width = 50,height = 40, fov_deg=60,\ncolumn_px,row_px\n1,2\n"
    path.write_text(text.replace(",", comma))
    skyline = read_trace(path)
    assert (skyline.width_px, skyline.height_px) == (50, 40)


def test_a_photo_is_kept_made_smaller_and_a_mask_is_not(tmp_path):
    image = np.full((800, 3200, 3), 240, np.uint8)
    image[400:] = (60, 80, 100)
    Image.fromarray(image).save(tmp_path / "photo.png")
    drawn = PhotoSkyline(np.full(3200, 400.0), np.ones(3200), 3200, 800)
    picture = read_photo(tmp_path / "photo.png").described(drawn).picture
    assert (picture.shape, picture.dtype) == ((400, 1600, 3), np.uint8)
    assert_array_equal(picture[201:], np.broadcast_to(image[-1, 0], (199, 1600, 3)))
    Image.fromarray(np.where(image > 100, 255, 0).astype(np.uint8)).save(tmp_path / "mask.png")
    assert read_skyline(tmp_path / "mask.png").picture is None


def test_unwritable_place_is_named_and_nothing_is_left(tmp_path):
    skyline = skyline_of([1.0, 2.0])
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="file"):
        write_trace(skyline, tmp_path / "file" / "trace.csv")
    with pytest.raises(InputError, match="file"):
        write_overlay(np.zeros((100, 2, 3), np.uint8), skyline, tmp_path / "file" / "overlay.png")
    with pytest.raises(InputError, match="folder"):
        write_trace(skyline, tmp_path / "folder")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]


def test_mask_border_lies_between_last_sky_and_first_ground(tmp_path):
    mask = np.full((40, 5), 255, np.uint8)
    mask[10:, 0] = 0
    mask[11:, 1] = 0
    mask[0:, 2] = 0  # skyline above the image
    mask[20:, 4] = 0  # column 3: skyline below the image
    mask[30:, 4] = 255  # a lake in column 4
    Image.fromarray(mask).save(tmp_path / "mask.png")
    skyline = read_skyline(tmp_path / "mask.png", 50.0)
    assert_array_equal(skyline.row_px, [9.5, 10.5, np.nan, np.nan, 19.5])
    assert_array_equal(skyline.trust, [1, 1, 0, 0, 1])
    assert (skyline.width_px, skyline.height_px, skyline.fov_deg) == (5, 40, 50.0)


def test_smoothed_mask_is_read_to_a_fraction_of_a_pixel(tmp_path):
    border = 20.0 + np.linspace(0.0, 3.0, 60)
    share = np.clip(np.arange(200)[:, np.newaxis] + 0.5 - border, 0.0, 1.0)
    mask = np.rint(255 * (1 - share)).astype(np.uint8)
    Image.fromarray(mask).save(tmp_path / "mask.png")
    skyline = read_skyline(tmp_path / "mask.png")
    # Halfway between two levels differs from the area by at most 1/8 (at a share of 1/4).
    assert np.abs(skyline.row_px - border).max() < 0.13


def test_overlay_draws_trusted_columns_only(tmp_path):
    photo = np.zeros((20, 30, 3), np.uint8)
    skyline = skyline_of(np.r_[np.full(10, 5.0), np.full(10, np.nan), np.full(10, 12.0)], 20)
    write_overlay(photo, skyline, tmp_path / "overlay.png")
    drawn = np.asarray(Image.open(tmp_path / "overlay.png")).any(axis=2)
    assert drawn[5, :10].all()
    assert drawn[12, 20:].all()
    assert drawn.sum() == 20
    assert not photo.any()


def test_a_trace_notes_its_camera(tmp_path):
    in_one = " fov_deg=60 fov_sd_share=0.1 eye_height_m=12"
    in_two = "\n# fov_deg=60 fov_sd_share=0.1\n# drawn by hand eye_height_m=12"
    for notes in (in_one, in_two):
        skyline = read_skyline(trace_file(tmp_path, "0,30\n9,31\n", notes))
        assert (skyline.fov_deg, skyline.lens.fov_sd_deg, skyline.eye_height_m) == (60.0, 6.0, 12.0)
        assert skyline.row_px[0] == 30.0
        write_trace(skyline, tmp_path / "again.csv")
        again = read_skyline(tmp_path / "again.csv")
        assert (again.fov_deg, again.lens, again.eye_height_m) == (60.0, skyline.lens, 12.0)
    path = trace_file(tmp_path, "0,30\n9,31\n", notes)
    given = read_skyline(path, 50.0)
    assert (given.fov_deg, given.lens) == (50.0, None)
    for fov_deg, sd_deg in ((None, 12.0), (50.0, 10.0)):
        entry = batch.Entry(str(path), fov_deg, fov_sd_share=0.2).read()
        assert entry.lens.fov_sd_deg == pytest.approx(sd_deg)
