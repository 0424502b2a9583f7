"""The benchmark of summits, on real DEMs."""

import pytest

from skyline_bench.runs.summits import SummitsConfig, measure

CONFIG = SummitsConfig(eyes=4, places=10)


@pytest.mark.parametrize("name", ["davos/davos_srtm1_30m.tif", "california/N37W120.hgt.gz"])
def test_the_highest_summits_of_real_dems_are_kept(shared_data, name):
    rows = {row["surface"]: row for row in measure([shared_data / name], None, CONFIG)}
    own, plain = rows["as read"], rows["bilinear"]
    assert own["summits"] == 200
    assert own["summits_off"] == 0
    assert max(abs(own["lowest_m"]), abs(own["highest_m"])) < 0.01
    assert plain["summits_off"] > 100
    assert own["median_sight_m"] < 1.0 < plain["median_sight_m"]
    assert own["rms_off_m"] < plain["rms_off_m"]
    assert abs(own["bias_m"]) < 0.05


def test_a_metric_dem_is_its_own_surface(shared_data):
    path = shared_data / "rofental" / "dem_rofental_50.asc"
    (row,) = measure([path], "EPSG:32632", CONFIG)
    assert row["summits_off"] == 0
    assert row["rms_off_m"] < 1e-3
    assert row["p90_sight_m"] < 1e-3
