"""The benchmark of horizons, and GRASS as its peer."""

import json

import numpy as np
import pytest
from scenes import FRAME, at_m, fractal, write_dem

from skyline import Curvature, HeightField, SkylineError, horizon, stand_on
from skyline_bench.peers import grass
from skyline_bench.runs.horizon import HorizonConfig, measure

needs_grass = pytest.mark.skipif(not grass.is_installed(), reason="grass is not installed")


@pytest.fixture(scope="module")
def field():
    heights = 1500.0 + fractal(160, 150, 700.0, seed=2)
    return HeightField(heights.astype(np.float32), 0.0, 0.0, 30.0, 30.0, FRAME)


def test_skyline_is_the_oracle_s_and_the_rays_within_their_bracket(field):
    rows = measure(field, HorizonConfig(12, 4, 2, (11, 13), 1))
    ours, *others = rows
    assert ours["tool"] == "Skyline"
    assert ours["max_error_deg"] < 1e-3
    assert ours["seconds_for_1000"] > 0.0
    for row in others:
        if row["tool"] == "Embree rays":
            bracket_deg = float(row["setting"].split()[2])
            assert 0.2 * bracket_deg < row["max_error_deg"] < 1.2 * bracket_deg
        else:
            assert row["max_error_deg"] > ours["max_error_deg"]


@needs_grass
def test_grass_answers_by_azimuth_from_true_north(field):
    eyes = stand_on(field, **at_m(field.to_map([80.0, 60.0], [70.0, 90.0])), eye_height_m=0.0)
    angles, seconds = grass.horizons(field, eyes, 2.0)
    assert angles.shape == (2, 180)
    assert seconds.shape == (1,)
    lon, lat = field.frame.to_lonlat(eyes.easting_m, eyes.northing_m)
    flat = Curvature(enabled=False)
    found = np.maximum(
        horizon(
            field, lon=lon, lat=lat, eye_height_m=0.0, step_deg=2.0, curvature=flat
        ).elevation_deg,
        0.0,
    )
    off = [np.abs(np.roll(angles, turn, axis=1) - found).mean() for turn in range(180)]
    assert min(off[0], off[1], off[-1]) == min(off)


@needs_grass
def test_grass_that_fails_is_one_line(field, monkeypatch):
    monkeypatch.setattr(grass, "_SCRIPT", "echo no such thing >&2; exit 3\n")
    with pytest.raises(SkylineError, match=r"r\.horizon gave 0 angles"):
        grass.horizons(field, stand_on(field, **at_m(field.to_map(80.0, 70.0))), 2.0)


def test_the_command_writes_its_record(run_bench, tmp_path, monkeypatch):
    monkeypatch.setattr(grass, "is_installed", lambda: False)
    dem = write_dem(tmp_path / "dem.tif", 1500.0 + fractal(120, 120, 700.0, seed=4))
    target = tmp_path / "horizon.json"
    done = run_bench("horizon", dem, "--quick", "--json", target)
    assert done.code == 0, done.err
    record = json.loads(target.read_text())
    assert record["bench"] == "horizon"
    assert record["rows"][0]["places"] == 40
