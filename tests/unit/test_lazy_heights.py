"""Heights that are made block by block are those of a whole reading, and stay in a file."""

import itertools
import logging
import math
import os
import pickle
import shutil
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from pyproj import CRS
from rasterio.transform import from_origin
from scenes import fractal, write_dem

from skyline import read_dem
from skyline.errors import InputError
from skyline.geodesy.map_frame import Frame
from skyline.terrain.field_files import read_field, save_dem
from skyline.terrain.grid import Grid
from skyline.terrain.heightfield import field_of
from skyline.terrain.kept_models import models_folder, noted_warnings, remove_models
from skyline.terrain.lazy_heights import Blocks, LazyHeights, block_counts
from skyline.terrain.metric_dem import MetricDem, WarpSource
from skyline.terrain.provenance import Provenance
from skyline.terrain.resampling import Warp

STEP_DEG = 1.0 / 1200.0


def holed(rows, cols, seed):
    """Return rough ground with holes, a cliff at a seam, a sea and level places."""
    rng = np.random.default_rng(seed)
    heights = fractal(rows, cols, 2000.0, seed=seed).astype(np.float32)
    heights[:, cols // 2 :] += 300.0
    heights = np.maximum(np.round(heights), -200.0)
    for top, left in rng.integers(0, [rows - 9, cols - 9], (12, 2)):
        heights[top : top + 9, left : left + 9] = np.nan
    return heights


def source_of(heights):
    rows, cols = heights.shape
    grid = Grid(9.0, 47.0, STEP_DEG, STEP_DEG, rows, cols)
    frame = Frame.local(lon=9.0 + 0.5 * cols * STEP_DEG, lat=47.0 - 0.5 * rows * STEP_DEG)
    return WarpSource(heights, Warp(grid, CRS.from_epsg(4326), frame, 60.0)), frame


def dem_of(source, frame):
    return MetricDem(source.in_memory(), source.warp.target, frame, Provenance(), source)


@pytest.mark.parametrize("seed", range(3))
def test_parts_are_those_of_one_block_over_the_whole_grid(seed):
    source, _ = source_of(holed(210, 1500, seed))
    target = source.warp.target
    whole = source.block(slice(0, target.rows), slice(0, target.cols))
    rng = np.random.default_rng(seed)
    lazy = source.in_memory()
    for _ in range(20):
        top, bottom = np.sort(rng.integers(0, target.rows + 1, 2))
        left, right = np.sort(rng.integers(0, target.cols + 1, 2))
        rows, cols = slice(top, bottom), slice(left, right)
        np.testing.assert_array_equal(lazy.part(rows, cols), whole[rows, cols])
    np.testing.assert_array_equal(lazy.whole(), whole)


def test_a_summit_at_the_edge_of_a_polar_model_is_kept_whatever_the_blocks():
    """At 89.4 degrees a metric sample is 50 samples of the source wide."""
    rng = np.random.default_rng(0)
    heights = rng.uniform(0.0, 10.0, (240, 1500)).astype(np.float32)
    heights[rng.random(heights.shape) < 0.001] = 1000.0
    grid = Grid(10.0, 89.5, STEP_DEG, STEP_DEG, *heights.shape)
    frame = Frame.local(lon=grid.centre[0], lat=grid.centre[1])
    source = WarpSource(heights, Warp(grid, CRS.from_epsg(4326), frame, 45.0))
    target = source.warp.target
    whole = source.block(slice(0, target.rows), slice(0, target.cols))
    np.testing.assert_array_equal(source.in_memory().whole(), whole)


@pytest.mark.parametrize("seed", range(3))
def test_heights_at_positions_are_those_of_the_whole_grid(seed):
    source, frame = source_of(holed(210, 1500, seed))
    field = field_of(dem_of(source, frame))
    row, col = np.random.default_rng(seed).uniform(0.0, [[field.rows], [field.cols]], (2, 500))
    at = dict(zip(("easting_m", "northing_m"), field.to_map(row, col), strict=True))
    found = field.height_at(**at)
    whole = replace(field, heights_m=field.heights_m)
    np.testing.assert_array_equal(found, whole.height_at(**at))


@pytest.mark.parametrize("seed", range(3))
def test_no_height_is_above_its_bound(seed):
    source, _ = source_of(holed(210, 1500, seed))
    lazy = source.in_memory()
    whole = lazy.whole()
    for top, left in itertools.product(range(0, 150, 50), range(0, 800, 200)):
        part = slice(top, top + 50), slice(left, left + 200)
        assert np.fmax.reduce(whole[part], axis=None, initial=-np.inf) <= lazy.highest_m(*part)


def test_the_range_is_exact_though_few_blocks_are_made():
    source, _ = source_of(holed(900, 1500, 5))
    whole = source.in_memory().whole()
    made = []

    def make(rows, cols):
        made.append((rows, cols))
        return source.block(rows, cols)

    lazy = LazyHeights(Blocks.in_memory(whole.shape), make, source.bounds_m)
    assert lazy.range_m() == (np.nanmin(whole), np.nanmax(whole))
    assert len(made) < source.bounds_m[0].size / 2


def saved(path, **options):
    """Write a DEM whose blocks have yet to be made, and return how it should be read."""
    source, frame = source_of(holed(210, 1500, 1))
    dem = dem_of(source, frame)
    save_dem(dem, path, **options)
    return field_of(dem)


def test_a_file_gives_the_heights_of_a_reading_and_keeps_its_blocks(tmp_path):
    path = tmp_path / "model.terrain"
    expected = saved(path)
    some = slice(0, 70), slice(0, 90)
    np.testing.assert_array_equal(read_field(path).part(*some), expected.heights_m[some])
    # The source is at the end of the file: without it, only blocks that are kept can be read.
    with path.open("r+b") as file:
        file.seek(-1000, 2)
        file.write(b"\1" * 1000)
    again = read_field(path)
    np.testing.assert_array_equal(again.part(*some), expected.heights_m[some])
    with pytest.raises(InputError, match="was damaged, and is removed"):
        again.part(slice(0, again.rows), slice(0, again.cols))
    assert not path.exists()


def test_a_block_whose_writing_was_cut_short_is_made_anew(tmp_path):
    path = tmp_path / "model.terrain"
    expected = saved(path)
    assert read_field(path).digest == expected.digest
    content = path.read_bytes()
    sample = expected.heights_m[40, 50:80].tobytes()
    assert content.count(sample) == 1
    path.write_bytes(content.replace(sample, bytes(len(sample))))
    np.testing.assert_array_equal(read_field(path).heights_m, expected.heights_m)


@pytest.mark.parametrize("seed", range(3))
def test_no_flipped_byte_gives_a_wrong_model(tmp_path, seed):
    """The first half of the flips hits the sections that come before the samples."""
    path = tmp_path / "model.terrain"
    expected = saved(path)
    assert read_field(path).digest == expected.digest
    content = path.read_bytes()
    first_pages = len(content.splitlines(keepends=True)[0]) + 3 * 4096
    rng = np.random.default_rng(seed)
    for at in rng.integers(0, np.repeat([first_pages, len(content)], 20)):
        damaged = bytearray(content)
        damaged[at] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            found = read_field(path)
            heights_m = found.heights_m
        except InputError:
            continue
        np.testing.assert_array_equal(heights_m, expected.heights_m)
        assert (found.bounds_m, found.digest) == (expected.bounds_m, expected.digest)
        assert found.frame.wkt == expected.frame.wkt
        assert found.provenance == expected.provenance


@pytest.mark.parametrize("section", ["west", "digest", "bounds"])
def test_damage_beside_the_samples_is_noticed(tmp_path, section):
    path = tmp_path / "model.terrain"
    expected = saved(path)
    assert read_field(path).digest == expected.digest
    content = bytearray(path.read_bytes())
    line = content.index(b"\n") + 1
    pages = -(-line // 4096)
    at = {
        "west": content.index(b'"west"') + 10,
        "digest": 4096 * pages,
        "bounds": 4096 * (pages + 1),
    }[section]
    content[at] ^= 1
    path.write_bytes(content)
    if section == "digest":
        assert read_field(path).digest == expected.digest
    else:
        with pytest.raises(InputError, match="holds no elevation model"):
            read_field(path)


def test_threads_may_share_a_model():
    source, _ = source_of(holed(210, 1500, 1))
    expected = source.in_memory().whole()
    for _ in range(3):
        lazy = source.in_memory()
        with ThreadPoolExecutor(4) as pool:
            for found in [pool.submit(lazy.whole) for _ in range(4)]:
                np.testing.assert_array_equal(found.result(), expected)


FULL_DISK = """
import os, sys
from pathlib import Path
from skyline.terrain.field_files import read_field
from test_lazy_heights import saved
path = Path("/mnt/model.terrain")
expected = saved(path)
disk = os.statvfs(path)
Path("/mnt/filler").write_bytes(bytes(disk.f_bavail * disk.f_frsize))
assert read_field(path).digest == expected.digest
print("right")
"""


def test_a_disk_that_is_full_ends_no_reading():
    in_namespace = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
    mount = "mount -t tmpfs -o size=4m disk /mnt"
    if shutil.which("unshare") is None or run_quietly([*in_namespace, mount]).returncode:
        pytest.skip("no disk can be mounted here")
    tests = Path(__file__).parent
    path = os.pathsep.join([str(tests), str(tests.parent), *sys.path])
    command = f'{mount} && "{sys.executable}" -c "$FULL_DISK"'
    given = os.environ | {"PYTHONPATH": path, "FULL_DISK": FULL_DISK}
    assert run_quietly([*in_namespace, command], env=given).stdout == "right\n"


def run_quietly(command, **options):
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


def test_blocks_stay_in_memory_where_the_file_takes_no_more(tmp_path):
    """A file that is open to read stands for a full disk."""
    source, _ = source_of(holed(210, 1500, 1))
    shape = source.in_memory().shape
    path = tmp_path / "samples"
    end = 4 * shape[0] * shape[1]
    path.write_bytes(bytes(end + 4 * math.prod(block_counts(shape))))
    with path.open("rb") as file:
        blocks = Blocks.in_file(file, shape, 0, end)
        lazy = LazyHeights(blocks, source.block, source.bounds_m)
        np.testing.assert_array_equal(lazy.whole(), source.in_memory().whole())
    assert not any(path.read_bytes())


def test_a_field_is_pickled_with_all_its_heights():
    field = field_of(dem_of(*source_of(holed(210, 1500, 1))))
    again = pickle.loads(pickle.dumps(field))
    np.testing.assert_array_equal(again.heights_m, field.heights_m)
    assert again.digest == field.digest


@pytest.fixture
def large_dem(tmp_path, monkeypatch):
    """Write a DEM in degrees that is large enough to be kept, with a void that is not declared."""
    monkeypatch.setenv("SKYLINE_CACHE", str(tmp_path / "cache"))
    heights = np.round(fractal(1100, 1100, 900.0, seed=3)).astype(np.int16) + 1000
    heights[300:420, 500:640] = 0
    place = from_origin(9.0, 47.0, 1.0 / 3600.0, 1.0 / 3600.0)
    return write_dem(tmp_path / "dem.tif", heights, "EPSG:4326", transform=place)


def kept_models():
    return list(models_folder().glob("*.terrain"))


def test_a_second_reading_gives_the_same_heights_and_warnings(large_dem, caplog):
    first = read_dem(large_dem)
    warnings = [record.getMessage() for record in caplog.records]
    assert any("samples of exactly 0 m" in one for one in warnings)
    caplog.clear()
    digest = first.digest
    (kept,) = kept_models()
    again = read_dem(large_dem)
    assert [record.getMessage() for record in caplog.records] == warnings
    np.testing.assert_array_equal(again.heights_m, first.heights_m)
    assert (again.digest, again.provenance) == (digest, first.provenance)
    assert kept_models() == [kept]


def test_a_process_keeps_a_model_once(large_dem):
    """The first reading loads libraries, which write to the environment."""
    twice = "import sys, skyline; [skyline.read_dem(sys.argv[1]) for _ in range(2)]"
    given = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    assert run_quietly([sys.executable, "-c", twice, str(large_dem)], env=given).returncode == 0
    assert len(kept_models()) == 1


def test_warnings_of_a_quiet_reading_are_shown_by_the_next(large_dem, caplog):
    caplog.set_level(logging.ERROR)
    read_dem(large_dem)
    assert not caplog.records
    caplog.set_level(logging.WARNING)
    read_dem(large_dem)
    assert "samples of exactly 0 m" in caplog.text


def test_a_process_without_logging_shows_the_warnings_of_each_reading(
    large_dem, capsys, monkeypatch
):
    monkeypatch.setattr(logging.getLogger("skyline"), "propagate", False)
    for _ in range(2):
        read_dem(large_dem)
        assert capsys.readouterr().err.count("samples of exactly 0 m") == 1


def test_readings_in_threads_leave_the_logger_as_it_was(caplog):
    caplog.set_level(logging.ERROR)
    logger = logging.getLogger("skyline.terrain")
    inside = threading.Event()

    def note(first):
        if not first:
            inside.wait(10.0)
        with noted_warnings():
            inside.set()
            # The first leaves while the other one is inside, or waits.
            time.sleep(0.1 if first else 0.3)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(note, [True, False]))
    assert (logger.level, logger.propagate) == (logging.NOTSET, True)


def test_a_dem_that_has_changed_is_read_anew(large_dem):
    before = read_dem(large_dem).digest
    with rasterio.open(large_dem, "r+") as dataset:
        dataset.write(dataset.read() + 1)
    assert read_dem(large_dem).digest != before
    assert len(kept_models()) == 2


def test_a_mask_in_capital_letters_is_noticed(large_dem):
    """GDAL reads dem.tif.msk, whatever its case, and so without the first 500 rows."""
    before = read_dem(large_dem)
    with rasterio.open(large_dem) as dataset:
        profile = dataset.profile | {"driver": "GTiff", "dtype": "uint8", "nodata": None}
    mask = np.full((1, 1100, 1100), 255, dtype=np.uint8)
    mask[:, :500] = 0
    with rasterio.open(large_dem.parent / "mask", "w", **profile) as dataset:
        dataset.update_tags(INTERNAL_MASK_FLAGS_1="2")
        dataset.write(mask)
    (large_dem.parent / "mask").rename(large_dem.parent / "DEM.TIF.MSK")
    assert read_dem(large_dem).provenance.hollow > before.provenance.hollow + 400_000


def test_a_virtual_raster_of_any_ending_is_not_kept(large_dem, tmp_path):
    step = 1.0 / 3600.0
    virtual = tmp_path / "virtual.tif"
    virtual.write_text(
        '<VRTDataset rasterXSize="1100" rasterYSize="1100"><SRS>EPSG:4326</SRS>'
        f"<GeoTransform>9, {step}, 0, 47, 0, {-step}</GeoTransform>"
        '<VRTRasterBand dataType="Int16" band="1"><SimpleSource><SourceFilename relativeToVRT="1">'
        "dem.tif</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    read_dem(virtual)
    assert kept_models() == []


def test_a_setting_of_gdal_is_noticed(large_dem, monkeypatch):
    with rasterio.open(large_dem, "r+") as dataset:
        dataset.update_tags(AREA_OR_POINT="Point")
    before = read_dem(large_dem)
    monkeypatch.setenv("GTIFF_POINT_GEO_IGNORE", "TRUE")
    assert read_dem(large_dem).box_deg[0] > before.box_deg[0]


def test_a_model_for_which_the_disk_has_no_room_removes_no_other(large_dem, monkeypatch):
    read_dem(large_dem)
    kept = kept_models()
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    with rasterio.open(large_dem, "r+") as dataset:
        dataset.write(dataset.read() + 1)
    read_dem(large_dem)
    assert kept_models() == kept


def test_a_folder_among_the_models_stays(large_dem):
    read_dem(large_dem)
    (models_folder() / "other").mkdir()
    remove_models()
    assert [path.name for path in models_folder().iterdir()] == ["other"]


def test_a_kept_model_that_is_damaged_is_read_anew(large_dem):
    digest = read_dem(large_dem).digest
    (kept,) = kept_models()
    kept.write_bytes(kept.read_bytes()[:5000])
    assert read_dem(large_dem).digest == digest


def test_a_damaged_model_in_metres_is_removed(tmp_path, monkeypatch):
    """Such a model has no source in its file, from which a block could be made anew."""
    monkeypatch.setenv("SKYLINE_CACHE", str(tmp_path / "cache"))
    heights = fractal(1100, 1100, 900.0, seed=3).astype(np.float32)
    dem = write_dem(tmp_path / "metres.tif", heights)
    digest = read_dem(dem).digest
    (kept,) = kept_models()
    content = bytearray(kept.read_bytes())
    content[-2_000_000] ^= 1
    kept.write_bytes(content)
    with pytest.raises(InputError, match="was damaged, and is removed; run the command again"):
        _ = read_dem(dem).heights_m
    assert read_dem(dem).digest == digest


def test_a_dem_is_read_where_the_cache_cannot_be_written(large_dem, tmp_path, monkeypatch):
    digest = read_dem(large_dem).digest
    (tmp_path / "file").touch()
    for name in ("file", 300 * "x"):
        monkeypatch.setenv("SKYLINE_CACHE", str(tmp_path / name))
        assert read_dem(large_dem).digest == digest
