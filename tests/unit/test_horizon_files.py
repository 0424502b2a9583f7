"""Horizons as other programs read them, by the descriptions of their files."""

import configparser
import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skyline.errors import InputError
from skyline.geodesy.crs import WGS84
from skyline.horizons.horizon import with_photo
from skyline.horizons.local_horizons import LocalHorizons
from skyline.report.horizon_files import check_can_hold, write_horizons


def rising_to_the_east(step_deg=0.5, lat=46.75):
    """A horizon of 10 degrees in the east that falls evenly to -2 degrees in the west."""
    azimuth_deg = np.arange(0.0, 360.0, step_deg)[np.newaxis]
    away_deg = np.abs((azimuth_deg - 90.0 + 180.0) % 360.0 - 180.0)
    elevation_deg = (10.0 - away_deg / 15.0).astype(np.float32)
    return LocalHorizons(
        np.array([9.85]), np.array([lat]), np.array([1500.0]), azimuth_deg, elevation_deg,
        np.full_like(elevation_deg, 1000.0), np.zeros(azimuth_deg.shape, np.uint8),
        np.full_like(elevation_deg, np.nan), np.array([""]),
    )  # fmt: skip


@pytest.fixture
def written(tmp_path):
    """Return a function that writes the horizon, and returns the file."""

    def write(name):
        write_horizons(rising_to_the_east(), tmp_path / name)
        return tmp_path / name

    return write


def test_pvsyst_and_meteonorm_count_azimuths_from_the_south(written):
    pairs = [line.split(" ") for line in written("x.hor").read_text().splitlines()]
    read = {int(azimuth): float(elevation) for azimuth, elevation in pairs}
    assert list(read) == list(range(-180, 180))
    # East, south, north, and west, where the horizon is below 0.
    assert (read[-90], read[0], read[-180], read[90]) == (10.0, 4.0, 4.0, 0.0)


def test_sam_loses_the_beam_of_a_sun_behind_the_horizon(written):
    table = np.genfromtxt(written("x.sam.csv"), delimiter=",")
    assert table.shape == (92, 362)
    np.testing.assert_array_equal(table[0, 1:], np.arange(361))
    np.testing.assert_array_equal(table[1:, 0], np.arange(91))
    east, west = (table[1:, 1 + azimuth] for azimuth in (90, 270))
    assert set(east[:10]) == {100.0}
    assert not east[10:].any()
    assert not west.any()


def test_observers_read_azimuths_from_north_to_north(written):
    text = written("x.hrz").read_text()
    lines = [line.split() for line in text.splitlines() if not line.startswith("#")]
    azimuth_deg, altitude_deg = np.array(lines, dtype=float).T
    assert (azimuth_deg[0], azimuth_deg[-1]) == (0.0, 360.0)
    np.testing.assert_allclose(
        np.interp([90.0, 180.0, 270.0], azimuth_deg, altitude_deg), [10, 4, -2]
    )


def test_stellarium_reads_a_landscape_with_its_horizon(written):
    with zipfile.ZipFile(written("x.zip")) as archive:
        ini = configparser.ConfigParser()
        ini.read_string(archive.read("skyline_46.75000_9.85000/landscape.ini").decode())
        landscape, place = ini["landscape"], ini["location"]
        listed = archive.read(
            f"skyline_46.75000_9.85000/{landscape['polygonal_horizon_list']}"
        ).decode()
    assert landscape["type"] == "polygonal"
    assert landscape["polygonal_horizon_list_mode"] == "azDeg_altDeg"
    assert float(landscape["minimal_altitude"]) < -2.0
    assert (place["latitude"], place["longitude"]) == ("+46d45'00.0\"", "+9d51'00.0\"")
    read = dict(np.genfromtxt(io.StringIO(listed)))
    assert (len(read), read[90.0], read[270.0]) == (720, 10.0, -2.0)


def test_landscapes_of_two_places_are_two_for_stellarium(tmp_path):
    """It names an installed landscape by its folder, and installs none twice."""
    write_horizons(rising_to_the_east(), tmp_path / "a.zip")
    write_horizons(rising_to_the_east(lat=46.8), tmp_path / "b.zip")
    folders = set()
    for name in ("a.zip", "b.zip"):
        with zipfile.ZipFile(tmp_path / name) as archive:
            (folder,) = {one.split("/")[0] for one in archive.namelist()}
        folders.add(folder)
    assert len(folders) == 2


@pytest.mark.parametrize("name", ["x.hor", "x.sam.csv", "x.hrz", "x.zip", "x.txt"])
def test_files_of_one_horizon_refuse_several_or_unknown_ones(tmp_path, name):
    one = rising_to_the_east()
    two = one[[0, 0]]
    unknown = one.elevation_deg.copy()
    unknown[0, 3] = np.nan
    for horizons, said in (
        (two, "would hold 2 horizons"),
        (replace(one, elevation_deg=unknown), "unknown at some azimuths"),
    ):
        with pytest.raises(InputError, match=said):
            write_horizons(horizons, tmp_path / name)


def test_what_a_file_cannot_hold_is_refused_before_it_is_rendered():
    check_can_hold(Path("x.csv"), 2, True, WGS84)
    with pytest.raises(InputError, match="would hold 2 horizons"):
        check_can_hold(Path("x.txt"), 2, False, WGS84)


def test_a_photos_skyline_replaces_the_horizon_where_it_is():
    one = rising_to_the_east()
    # From 350 over north to 10 degrees, every 0.1 degrees.
    azimuth_deg = np.arange(-10.0, 10.05, 0.1)
    joined, share = with_photo(one, azimuth_deg, np.full(len(azimuth_deg), 30.0))
    is_near = np.abs((one.azimuth_deg[0] + 180.0) % 360.0 - 180.0) < 10.3
    np.testing.assert_array_equal(joined.elevation_deg[0] == 30.0, is_near)
    np.testing.assert_array_equal(joined.elevation_deg[0, ~is_near], one.elevation_deg[0, ~is_near])
    assert np.isnan(joined.distance_m[0, is_near]).all()
    assert share == pytest.approx(41 / 720)
