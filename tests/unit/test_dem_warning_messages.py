"""What is said of elevation models that are read all the same: each warning in one line."""

import numpy as np
import pytest
from dem_scenes import (
    clutter,
    depths,
    in_unit,
    mountains,
    ridges,
    rough_tiles,
    side_by_side,
    tile_at,
    west_tile,
)
from rasterio.transform import from_origin
from scenes import UTM, write_dem

from skyline.geodesy.map_frame import Frame
from skyline.terrain.dem import read_dem
from skyline.terrain.provenance import DemOptions


def test_files_without_heights_are_listed(tmp_path, caplog):
    folder = west_tile(tmp_path / "dems")
    clutter(folder)
    read_dem(folder)
    assert caplog.messages == [
        f"{folder}: 11 files are left out, which are not rasters of heights: README.txt, "
        "Thumbs.db, b_hillshade.tif and 1 more .tif, item.json, note0.md and 2 more .md, "
        "peaks.csv, thumbnail.jpg, tracks.gpkg; name one to have it read"
    ]


def test_a_link_to_nothing_that_is_no_tile(tmp_path, caplog):
    folder = west_tile(tmp_path / "dems")
    (folder / "gone.txt").symlink_to(folder / "nothing")
    read_dem(folder)
    assert "gone.txt" in caplog.text


def test_a_crs_that_is_not_needed(tmp_path, caplog):
    read_dem(write_dem(tmp_path / "a.tif", np.ones((4, 4), np.int16)), DemOptions(crs="EPSG:32633"))
    assert "--crs WGS 84 / UTM zone 33N is only for files that name none" in caplog.text


@pytest.mark.parametrize(
    ("crs", "place", "error_deg"),
    [
        ("EPSG:3035", (10.0, 46.5), 0.12),
        ("EPSG:3413", (15.0, 78.0), 0.56),
        ("EPSG:3857", (9.8, 46.8), 10.8),
        ("EPSG:3857", (37.3, -0.5), 0.38),
    ],
)
def test_a_map_of_wrong_slopes_is_warped(tmp_path, caplog, crs, place, error_deg):
    x, y = Frame.from_crs(crs).from_lonlat(*place)
    corner = from_origin(float(x) - 750.0, float(y) + 750.0, 30.0, 30.0)
    heights = np.ones((50, 50), np.float32)
    read_dem(write_dem(tmp_path / "dem.tif", heights, crs, transform=corner))
    assert "is warped to the local conformal frame" in caplog.text
    said_deg = float(caplog.text.split(" wrong by up to ")[1].split()[0])
    assert said_deg == pytest.approx(error_deg, rel=0.05, abs=0.01)


def test_a_real_map_of_wrong_slopes(shared_data, caplog):
    read_dem(shared_data / "sierra" / "sierra_ansel_adams_30m_albers.tif")
    assert "slopes and directions are wrong by up to 1.11 degrees" in caplog.text


@pytest.mark.parametrize(
    ("unit", "said"), [("m", "50 % of the steps between its samples are steeper"), ("ft", "")]
)
def test_heights_whose_unit_may_be_wrong(tmp_path, caplog, unit, said):
    read_dem(in_unit(tmp_path / "dem.tif", unit, ridges() / 0.3048))
    assert said in caplog.text
    assert bool(said) == bool(caplog.records)


@pytest.mark.parametrize(
    "name", ["davos/davos_srtm1_30m.tif", "everest/mt_everest_90m.tif", "andes/S33W071.tif"]
)
def test_no_real_mountains_are_too_steep(shared_data, caplog, name):
    read_dem(shared_data / name)
    assert "steeper" not in caplog.text


def test_a_map_whose_axes_point_south(tmp_path, caplog):
    corner = from_origin(1_047_000.0, 738_000.0, 30.0, 30.0)
    heights = np.ones((50, 50), np.float32)
    read_dem(write_dem(tmp_path / "dem.tif", heights, "EPSG:5513", transform=corner))
    assert "south" in caplog.text
    assert "is warped to the local conformal frame" in caplog.text


def test_heights_whose_sense_is_assumed(tmp_path, caplog):
    read_dem(depths(tmp_path / "depths.tif"))
    assert "values are depths, positive downward" in caplog.text


@pytest.mark.parametrize(
    ("other", "said"),
    [("EPSG:32632+5783", "DHHN92 height"), (UTM, "a datum that is not named")],
)
def test_tiles_of_other_datums(tmp_path, caplog, other, said):
    read_dem(side_by_side(tmp_path, (other, "m"), ("EPSG:32632+5773", "m")))
    assert said in caplog.text
    assert "EGM96 height" in caplog.text


def test_tiles_that_disagree(tmp_path, caplog):
    first, other = (np.full((5, 5), height_m, np.float32) for height_m in (10.0, 42.0))
    read_dem([tile_at(tmp_path, other, 4, 0), tile_at(tmp_path, first, 0, 0)])
    assert "up to 32.00 m" in caplog.text


@pytest.mark.parametrize(("raised_m", "said"), [(20.0, "above"), (-20.0, "below")])
@pytest.mark.parametrize(("row", "col"), [(0, 80), (0, -80), (80, 0), (-80, 0)])
def test_tiles_that_meet_at_a_wall(tmp_path, caplog, row, col, raised_m, said):
    read_dem(rough_tiles(tmp_path, row, col, raised_m))
    (line,) = caplog.messages
    assert float(line.split(" stands ")[1].split()[0]) == pytest.approx(20.0, abs=2.0)
    assert said in line


@pytest.mark.parametrize("raised_m", [20.0, -20.0])
@pytest.mark.parametrize(("row", "col"), [(0, 79), (-79, 0)])
def test_tiles_that_overlap_and_differ(tmp_path, caplog, row, col, raised_m):
    read_dem(rough_tiles(tmp_path, row, col, raised_m))
    (line,) = caplog.messages
    assert "differs by up to 20.00 m" in line


@pytest.mark.parametrize(("row", "col"), [(0, 80), (0, -80), (80, 0), (-80, 0), (0, 79), (-79, 0)])
def test_tiles_that_meet_as_one_terrain_are_not_named(tmp_path, caplog, row, col):
    read_dem(rough_tiles(tmp_path, row, col, 0.0))
    assert caplog.messages == []


def test_fill_and_sea_beds(tmp_path, caplog):
    heights = mountains()
    for values, said in (
        (np.where(np.arange(200) < 30, np.float32(0.0), heights), "exactly 0 m"),
        (heights - 3000.0, "the bed of a sea"),
    ):
        read_dem(in_unit(tmp_path / "dem.tif", "m", values))
        assert said in caplog.text
        caplog.clear()
