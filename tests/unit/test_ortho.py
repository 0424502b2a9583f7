"""Photos on the ground, against pictures whose colours are places."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from scenes import candidate_at, field_from, field_of, fractal

from skyline.errors import InputError
from skyline.geodesy.cell_grid import CellGrid
from skyline.geodesy.earth import Curvature
from skyline.photo.skyline import PhotoSkyline
from skyline.report.ortho import (
    grid_of,
    lay,
    mosaic,
    place_sd_m,
    write_ortho,
    write_pixel_lengths,
)
from skyline.view.viewer import Viewer

WIDTH_PX, HEIGHT_PX = 600, 400
PHOTO = PhotoSkyline(np.full(WIDTH_PX, np.nan), np.zeros(WIDTH_PX), WIDTH_PX, HEIGHT_PX)
HILLS = field_from(
    lambda east, north: 60.0 * np.sin(east / 150.0) * np.cos(north / 170.0) + 0.1 * north, 81, 25.0
)


SMOOTH = field_from(
    lambda east, north: 100.0 * np.sin(east / 500.0) * np.cos(north / 600.0), 81, 25.0
)
ROUGH = field_of(1000.0 + fractal(90, 100, 900.0, seed=11), 30.0)


def view_of(heading_deg=0.0, north_m=-900.0, height_m=250.0, fov_deg=60.0):
    ground_m = float(HILLS.height_at(easting_m=0.0, northing_m=north_m))
    pose = candidate_at(
        0.0, north_m, heading_deg, -15.0, 4.0, fov_deg, eye_elevation_m=ground_m + height_m
    )
    return Viewer(HILLS, curvature=Curvature(enabled=False)).ground_view(pose, PHOTO)


def picture_of(view):
    """Return the picture (H, W, 2) of easting and northing in each pixel; 0 for sky."""
    row, column = (one.astype(float) for one in np.mgrid[:HEIGHT_PX, :WIDTH_PX])
    azimuth_deg, tan = view.camera.directions(column, row)
    azimuth = np.radians(azimuth_deg)
    east_m, north_m, _ = view.at_m(azimuth, tan, view.hits_m(azimuth, tan))
    return np.nan_to_num(np.stack([east_m, north_m], axis=-1)).astype(np.float32)


@pytest.fixture(scope="module")
def laid():
    view = view_of()
    grid = grid_of([view], 8.0)
    return grid, lay(view, picture_of(view), grid)


def middles_m(grid):
    """Return eastings and northings (rows, cols, 2) of a grid's cells."""
    return np.stack(np.meshgrid(grid.eastings_m(), grid.northings_m()), axis=-1)


def test_cells_show_their_own_place_within_half_a_cell(laid):
    grid, found = laid
    off = np.abs(found.values - middles_m(grid)).max(axis=-1)[found.is_seen]
    assert found.is_seen.sum() > 5000
    assert np.mean(off <= 0.5 * grid.cell_m) >= 0.95


@pytest.mark.parametrize(
    ("terrain", "place_m"), [(SMOOTH, (0.0, -900.0)), (ROUGH, (1400.0, -1300.0))]
)
@pytest.mark.parametrize("cell_m", [4.0, 8.0])
def test_cells_show_their_own_place_on_smooth_and_on_rough_ground(terrain, place_m, cell_m):
    ground_m = float(terrain.height_at(easting_m=place_m[0], northing_m=place_m[1]))
    pose = candidate_at(*place_m, 0.0, -15.0, 4.0, 60.0, eye_elevation_m=ground_m + 250.0)
    view = Viewer(terrain, curvature=Curvature(enabled=False)).ground_view(pose, PHOTO)
    grid = grid_of([view], cell_m)
    found = lay(view, picture_of(view), grid)
    assert found.is_seen.sum() > 2000
    off_m = np.abs(found.values - middles_m(grid)).max(axis=-1)[found.is_seen]
    assert np.mean(off_m <= 0.5 * cell_m) >= 0.95


def test_cells_beside_hidden_ground_are_left_out():
    """A wall of 60 m, 300 m before a camera 100 m up, hides 450 m of the plane behind it."""
    wall = field_from(lambda east, north: np.where(np.abs(north) < 1.0, 60.0, 0.0), 101, 20.0)
    pose = candidate_at(0.0, -300.0, 0.0, -10.0, eye_elevation_m=100.0)
    view = Viewer(wall, curvature=Curvature(enabled=False)).ground_view(pose, PHOTO)
    grid = CellGrid(-2.0, 700.0, 4.0, 250, 2)
    found = lay(view, np.ones((HEIGHT_PX, WIDTH_PX, 1), dtype=np.uint8), grid)
    shown_m = middles_m(grid)[found.is_seen, 1]
    behind_m = shown_m[shown_m > 0.0].min()
    # A pixel is 11 m long there: two, less the half pixel by which ground must be hidden.
    assert behind_m == pytest.approx(450.0 + 1.5 * 11.0, abs=4.0)


def test_cells_that_are_hidden_or_outside_the_photo_are_empty(laid):
    grid, found = laid
    east_m, north_m = np.moveaxis(middles_m(grid), -1, 0)
    assert not found.is_seen[north_m < -900.0].any()
    shown = found.is_seen[(np.abs(east_m) < 100.0) & (north_m > -600.0) & (north_m < 500.0)]
    # Some of the ground behind the hills is hidden.
    assert 0.5 < shown.mean() < 1.0
    assert (found.values[~found.is_seen] == 0.0).all()


def test_a_pixel_is_as_long_on_level_ground_as_trigonometry_has_it():
    plane = field_from(lambda east, north: 0.0 * east, 81, 25.0)
    pose = candidate_at(0.0, -900.0, 0.0, -10.0, eye_elevation_m=100.0)
    view = Viewer(plane, curvature=Curvature(enabled=False)).ground_view(pose, PHOTO)
    grid = CellGrid(-20.0, -380.0, 5.0, 8, 8)
    found = lay(view, np.zeros((HEIGHT_PX, WIDTH_PX, 1), dtype=np.uint8), grid)
    # At 500 m, 100 m below the eye and 1.3 degrees off the axis.
    per_px = np.tan(np.radians(30.0)) / 300.0
    down = np.radians(10.0) - np.arctan(0.2)
    length_m = per_px * np.cos(down) ** 2 * (500.0**2 + 100.0**2) / 100.0
    assert np.nanmedian(found.pixel_m) == pytest.approx(length_m, rel=0.03)


def test_the_grid_is_as_fine_as_the_photo_shows_the_ground():
    coarse, fine = grid_of([view_of()]), grid_of([view_of(fov_deg=30.0)])
    assert 0.5 < coarse.cell_m < 10.0
    assert fine.cell_m < coarse.cell_m
    with pytest.raises(InputError):
        grid_of([view_of()], 0.01)
    with pytest.raises(InputError):
        grid_of([view_of(heading_deg=0.0, height_m=19_000.0)], 1.0)


def test_a_place_on_the_grid_is_as_unsure_as_its_pose_and_the_model():
    view = view_of()
    grid = grid_of([view], 8.0)
    # 30 m east and 40 m north of the eye are 50 m of a place on level ground.
    still, moved = (
        replace(view, covariance=np.diag([*variances, *[0.0] * 5]))
        for variances in ([0.0, 0.0], [900.0, 1600.0])
    )
    added_m = np.sqrt(place_sd_m([moved], grid) ** 2 - place_sd_m([still], grid) ** 2)
    assert added_m == pytest.approx(50.0, rel=0.3)


def test_of_two_photos_the_one_with_finer_pixels_is_taken():
    near, far = view_of(), view_of(heading_deg=180.0, north_m=900.0)
    grid = grid_of([near, far], 20.0)
    one, two = (
        lay(view, np.full((HEIGHT_PX, WIDTH_PX, 1), value, dtype=np.uint8), grid)
        for view, value in ((near, 1), (far, 2))
    )
    both = mosaic([one, two])
    assert both.is_seen.sum() > max(one.is_seen.sum(), two.is_seen.sum())
    expected = np.where(one.pixel_m <= two.pixel_m, 1, 2)[one.is_seen & two.is_seen]
    np.testing.assert_array_equal(both.values[one.is_seen & two.is_seen, 0], expected)


def test_files_are_cloud_optimized_and_have_their_crs_and_alpha(laid, tmp_path):
    grid, found = laid
    colours = np.zeros((grid.rows, grid.cols, 3), dtype=np.uint8) + np.uint8(90)
    write_ortho(tmp_path / "o.tif", replace(found, values=colours), grid, HILLS)
    write_pixel_lengths(tmp_path / "p.tif", found, grid, HILLS)
    with rasterio.open(tmp_path / "o.tif") as raster:
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert [one.name for one in raster.colorinterp] == ["red", "green", "blue", "alpha"]
        assert raster.crs is not None
        assert raster.transform.a == grid.cell_m
        np.testing.assert_array_equal(raster.read(4) == 255, found.is_seen)
    with rasterio.open(tmp_path / "p.tif") as raster:
        np.testing.assert_array_equal(raster.read(1), found.pixel_m)
    with pytest.raises(InputError):
        write_ortho(tmp_path / "o.png", replace(found, values=colours), grid, HILLS)
