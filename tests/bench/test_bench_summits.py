"""The benchmark of summits, on real DEMs."""

import numpy as np

from skyline import DemOptions, read_dem
from skyline_bench.summits import SummitsConfig, measure, prominences

CONFIG = SummitsConfig(eyes=4, places=10, beside=2, anywhere=200)


def test_the_highest_summits_of_a_real_dem_are_kept(shared_data):
    tile = shared_data / "california" / "N37W120.hgt.gz"
    rows = {row["surface"]: row for row in measure([tile], read_dem([tile]), config=CONFIG)}
    own, plain = rows["as read"], rows["bilinear"]
    assert own["summits"] == 200
    assert own["summits_off"] == 0
    assert max(abs(own["lowest_m"]), abs(own["highest_m"])) < 0.01
    assert plain["summits_off"] > 100
    assert own["median_sight_m"] < 1.0 < plain["median_sight_m"]
    assert own["rms_off_m"] < plain["rms_off_m"]
    assert abs(own["bias_m"]) < 0.05
    assert own["prominent"] == 10
    for stood in ("summit_height", "within_100_m"):
        assert own[f"{stood}_below"] > own["summit_below"] - 0.02 > own["slope_below"]
        assert own[f"{stood}_off"] < 0.5 * own["slope_off"]
    assert (own["anywhere"], own["anywhere_else_changed"]) == (200, 0)
    assert own["anywhere_on_summits"] < 10


def test_a_metric_dem_is_its_own_surface(shared_data):
    path = shared_data / "rofental" / "dem_rofental_50.asc"
    surface = read_dem([path], DemOptions(crs="EPSG:32632"))
    (row,) = measure([path], surface, "EPSG:32632", CONFIG)
    assert row["summits_off"] == 0
    assert row["rms_off_m"] < 1e-3
    assert row["p90_sight_m"] < 1e-3


def test_a_prominence_is_the_height_above_the_highest_pass_to_higher_ground():
    heights = np.array([
        [1.0, 9.0, 3.0, 7.0, np.nan, 5.0],
        [1.0, 1.0, 4.0, 1.0, np.nan, 2.0],
        [6.0, 2.0, 1.0, 5.0, np.nan, 2.0],
    ])  # fmt: skip
    row, col, prominence_m = prominences(heights)
    found = {(r, c): p for r, c, p in zip(row.tolist(), col.tolist(), prominence_m, strict=True)}
    # From 7 over 4 to 9, from 6 over 2 to 9, from 5 over 4 to 9; nothing leads from the other 5.
    assert found == {(0, 1): 8.0, (0, 3): 3.0, (2, 0): 4.0, (2, 3): 1.0, (0, 5): 4.0}
    assert prominence_m.tolist() == sorted(prominence_m, reverse=True)
