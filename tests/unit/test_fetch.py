"""Tiles fetched from a server of the test's own, which is slow, fails or breaks off on request."""

import numpy as np
import pytest
import rasterio
from range_server import serve_apart
from tile_scenes import (
    BOUNDS,
    EAST,
    IN_THE_EAST,
    NAMES,
    ONCE_MORE,
    SAMPLES,
    VRT,
    fetch,
    geotiff,
    masked_tile,
)

from skyline import read_dem
from skyline.errors import FetchError, InputError
from skyline.fetch import remote
from skyline.fetch.dem_tiles import SOURCES, address, tile_corners
from skyline.fetch.remote import Patience


def expect_heights(result, heights):
    """Compare fetched tiles with the samples of the server."""
    for path in result.files:
        with rasterio.open(path) as file:
            left = round((file.transform.c + 0.5 / SAMPLES - 9.0) * SAMPLES)
            top = round((47.0 - file.transform.f + 0.5 / SAMPLES) * SAMPLES)
            there = heights[top:, left:][: file.height, : file.width]
            np.testing.assert_array_equal(file.read(1), there)


def test_tiles_are_cut_to_the_bounds_and_make_one_dem(template, server, heights, tmp_path):
    done = fetch(template, tmp_path / "new" / "dem")
    assert [path.name for path in done.files] == ["N46E009.tif", "N46E010.tif"]
    assert (done.fetched, done.missing) == (2, ())
    expect_heights(done, heights)
    with rasterio.open(done.files[0]) as west, rasterio.open(done.files[1]) as east:
        assert west.bounds.left <= BOUNDS[0] < west.bounds.left + 1.01 / SAMPLES
        assert east.bounds.right >= BOUNDS[2] > east.bounds.right - 1.01 / SAMPLES
        assert west.bounds.bottom <= BOUNDS[1] < BOUNDS[3] <= west.bounds.top
        assert west.bounds.right == pytest.approx(east.bounds.left)
        assert west.tags()["AREA_OR_POINT"] == "Point"
    assert read_dem(done.files).height_range_m[1] > 0.0
    assert not list(tmp_path.rglob("*.partial"))
    assert server.sent < sum(map(len, server.files.values())) / 2


def test_tiles_that_are_there_are_not_fetched_again(template, server, tmp_path):
    first = fetch(template, tmp_path)
    server.requests.clear()
    assert fetch(template, tmp_path).fetched == 0
    assert not server.requests
    first.files[1].unlink()
    assert fetch(template, tmp_path).fetched == 1
    assert fetch(template, tmp_path, (9.8, 46.5, 10.1, 46.8)).fetched == 2
    with pytest.raises(InputError):
        fetch(template.replace("127.0.0.1", "localhost"), tmp_path)


def test_a_tile_of_another_box_grows_to_both(template, server, heights, tmp_path):
    for bounds in ((9.6, 46.6, 9.7, 46.8), (9.8, 46.5, 9.9, 46.7)):
        done = fetch(template, tmp_path, bounds)
        assert done.fetched == 1
    expect_heights(done, heights)
    with rasterio.open(done.files[0]) as file:
        assert file.bounds[:2] == pytest.approx((9.6, 46.5), abs=1.01 / SAMPLES)
        assert file.bounds[2:] == pytest.approx((9.9, 46.8), abs=1.01 / SAMPLES)
    server.requests.clear()
    assert fetch(template, tmp_path, (9.6, 46.6, 9.7, 46.8)).fetched == 0
    assert not server.requests


def test_a_clipped_tile_is_taken(template, server, heights, tmp_path):
    server.files[EAST] = geotiff(heights[:, SAMPLES : SAMPLES + 40], west=10.0)
    expect_heights(fetch(template, tmp_path), heights)


def test_a_box_across_the_antimeridian_has_tiles_on_both_sides():
    assert tile_corners((179.5, 10.0, -179.5, 11.0)) == [(10, 179), (10, -180)]


def test_what_an_earlier_fetch_has_is_copied(template, server, heights, tmp_path):
    whole = fetch(template, tmp_path / "whole")
    server.sent = 0
    fetch(template, tmp_path / "none")
    alone = server.sent
    server.sent = 0
    bounds = (9.85, 46.65, 10.15, 46.85)
    done = fetch(template, tmp_path / "next", bounds, earlier=[tmp_path / "whole"])
    expect_heights(done, heights)
    assert done.fetched == 2
    assert server.sent < alone
    server.sent = 0
    fetch(template, tmp_path / "again", earlier=[tmp_path / "whole"])
    assert server.sent < alone / 4
    for one, other in zip(whole.files, sorted((tmp_path / "again").iterdir()), strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_tiles_over_the_sea_are_missing_not_an_error(template, tmp_path):
    done = fetch(template, tmp_path, (9.8, 46.6, 10.1, 47.2))
    assert done.missing == ("N47E009", "N47E010")
    assert len(done.files) == 2
    with pytest.raises(InputError):
        fetch(template, tmp_path / "sea", (30.2, 20.2, 30.4, 20.4))
    assert not (tmp_path / "sea").exists()


@pytest.mark.parametrize(
    "trouble", [{"failures": 2}, {"failing_get": 2}, {"truncate": 1}, {"truncate": 3}]
)
def test_failures_and_bodies_that_break_off_are_read_again(
    template, server, heights, tmp_path, trouble
):
    vars(server).update(trouble)
    expect_heights(fetch(template, tmp_path), heights)


@pytest.mark.parametrize(
    "trouble",
    [{"truncate": 10_000}, {"failures": 10_000}, {"status": {EAST: 403}}, {"files": {EAST: VRT}}],
)
def test_lasting_failures_leave_no_part_of_a_tile(template, server, tmp_path, trouble):
    vars(server).update(trouble)
    with pytest.raises(FetchError):
        fetch(template, tmp_path, patience=ONCE_MORE)
    assert {path.name for path in tmp_path.rglob("*")} <= {"N46E009.tif"}


@pytest.mark.parametrize(
    "trouble", [{"status": {EAST: 403}}, {"status": {EAST: 503}}, {"files": {EAST: VRT}}]
)
def test_a_tile_that_is_refused_does_not_stop_the_others(
    template, server, contents, heights, tmp_path, trouble
):
    north = geotiff(heights[:, :SAMPLES], north=48.0), geotiff(heights[:, SAMPLES:], 10.0, 48.0)
    server.files |= dict(zip(("/N47E009.tif", "/N47E010.tif"), north, strict=True))
    for name, value in trouble.items():
        setattr(server, name, {**getattr(server, name), **value})
    bounds = (9.8, 46.6, 10.1, 47.2)
    with pytest.raises(FetchError):
        fetch(template, tmp_path, bounds, ONCE_MORE)
    assert {path.name for path in tmp_path.iterdir()} == {
        "N46E009.tif",
        "N47E009.tif",
        "N47E010.tif",
    }
    server.status, server.files[EAST] = {}, contents[EAST]
    assert fetch(template, tmp_path, bounds).fetched == 1


def test_where_all_tiles_are_refused_no_folder_is_made(template, server, tmp_path):
    server.status = {"/N46E009.tif": 403, EAST: 403}
    with pytest.raises(FetchError):
        fetch(template, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_server_that_fails_for_two_tiles_in_a_row_is_left_alone(template, server, tmp_path):
    server.failures = 10_000
    with pytest.raises(FetchError):
        fetch(template, tmp_path, (9.8, 46.6, 15.1, 46.8))
    assert {path for _, path, _ in server.requests} == {"/N46E009.tif", EAST}


def test_a_server_that_is_not_found_is_tried_three_times(tmp_path, monkeypatch):
    """After one and two seconds, however many repetitions there may be of other failures."""
    waited = []
    monkeypatch.setattr(remote.time, "sleep", waited.append)
    with pytest.raises(FetchError):
        fetch("http://127.0.0.1:9/{lat}{lon}.tif", tmp_path, patience=Patience())
    assert waited == [1.0, 2.0]


def test_copernicus_addresses_are_as_documented():
    template = SOURCES["copernicus"]
    addresses = [address(template, *tile) for tile in tile_corners((-0.5, -0.5, 0.5, 0.5))]
    names = ["S01_00_W001", "S01_00_E000", "N00_00_W001", "N00_00_E000"]
    for found, name in zip(addresses, names, strict=True):
        full = f"Copernicus_DSM_COG_10_{name}_00_DEM"
        assert found == f"https://copernicus-dem-30m.s3.amazonaws.com/{full}/{full}.tif"


@pytest.mark.parametrize(
    "options", [{"west": 10.0, "crs": "EPSG:32632"}, {"west": 20.0}, {"west": 9.0}]
)
def test_tiles_that_do_not_fit_are_refused(template, server, heights, tmp_path, options):
    server.files[EAST] = geotiff(heights[:, SAMPLES:], **options)
    with pytest.raises(InputError):
        fetch(template, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["mask", "alpha"])
def test_a_tile_with_a_mask_is_refused(heights, tmp_path, kind):
    files = masked_tile(kind, heights[:, SAMPLES:], tmp_path / "masked.tif")
    with serve_apart(files) as server, pytest.raises(InputError):
        fetch(server.address + NAMES, tmp_path / "new", IN_THE_EAST)
    assert not (tmp_path / "new").exists()


def test_a_file_of_someone_else_is_not_replaced(template, tmp_path):
    (tmp_path / "N46E009.tif").write_bytes(b"mine")
    with pytest.raises(InputError):
        fetch(template, tmp_path)
    assert (tmp_path / "N46E009.tif").read_bytes() == b"mine"


def test_secrets_in_an_address_are_not_stored(template, server, contents, tmp_path):
    secret = template.replace("http://", "http://me:secret@") + "?sig=secret"
    server.files = {f"{path}?sig=secret": content for path, content in contents.items()}
    done = fetch(secret, tmp_path)
    assert done.fetched == 2
    assert not any(b"secret" in path.read_bytes() for path in done.files)
