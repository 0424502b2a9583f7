"""Small runs of ``skyline-bench orient``: photographs, made photos, summits, pixels, a webcam."""

import json

import pytest
from commands import headings, lonlat_of
from scenes import field_of, fractal, write_dem

from skyline_bench.queries.kinds import perturbed
from skyline_bench.queries.synthetic import make_queries
from skyline_bench.sights import label_row, pixel_row


def test_photographs_and_made_photos_are_measured(run_bench, dem, photo, tmp_path):
    lon, lat = lonlat_of(dem)
    manifest, record = tmp_path / "held.csv", tmp_path / "record.json"
    manifest.write_text(
        "photo,kind,lon,lat,heading_deg,fov_deg,given_fov_deg\n"
        f"{photo},locate,{lon},{lat},140.95,60,60\n{photo},refuse,{lon},{lat},,,20\n"
    )
    run_bench("orient", dem, "--photos", manifest, "--json", record).ok()
    held, strange, found, refused = json.loads(record.read_text())["rows"]
    other = write_dem(tmp_path / "other.tif", fractal(110, 120, 400.0, seed=12))
    asked = "--strange", other, "--queries", 1, "--quick"
    done = run_bench("orient", dem, *asked, "--json", record).ok()
    assert all({"n", "km2"} <= set(columns) for columns in headings(done.out))
    assert held["answered"]
    assert held["off_deg"] < 1.0
    assert abs(held["fov_off"]) < 0.03
    assert not strange["answered"]
    assert (found["n"], found["answered"], found["wrong"]) == (1, 1, 0)
    assert (refused["n"], refused["answered"]) == (1, 0)
    rows = json.loads(record.read_text())["rows"]
    measured = {row["measured"] for row in rows}
    of_photos = {"made photos", "unmarked", "strangers", "noted heights", "webcam"}
    assert measured == of_photos | {"labels", "pixels"}
    assert rows[-1]["frames"] == 1
    assert all(5.0 < row["km2"] < 12.0 for row in rows)


@pytest.fixture(scope="module")
def seen():
    """Rough terrain, and made photos of it."""
    field = field_of(1000.0 + fractal(160, 160, 900.0, seed=8, exponent=1.8), 30.0)
    area = (1431.0, -3339.0, 3339.0, -1431.0)  # Its middle
    return field, [(query, None) for query in make_queries(field, area, 3, seed=5)]


def test_at_the_true_pose_all_is_where_it_is(seen):
    field, posed = seen
    labels, pixels = (of(field, field, posed) for of in (label_row, pixel_row))
    assert labels["visible"] > 0
    assert labels["hidden"] > labels["hidden_named"] == 0
    assert labels["named"] == labels["within_5_px"] == 1.0
    assert pixels["sky_right"] > 0.99
    assert pixels["median_off_m"] < 0.1
    assert pixels["within_2_sd"] > 0.98


def test_another_model_moves_names_and_places(seen):
    field, posed = seen
    labels, pixels = (of(perturbed(field, 60.0), field, posed) for of in (label_row, pixel_row))
    assert labels["median_px"] > 1.0
    assert pixels["median_off_m"] > 1.0
    assert pixels["within_2_sd"] < 0.9
