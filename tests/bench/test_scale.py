"""Size measured: what is searched for a query, what is kept, and where a query is lost."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import FRAME, field_of, fractal

from skyline.errors import InputError
from skyline.places import Places
from skyline_bench.measuring.timing import own_bytes, peak_bytes, reset_peak
from skyline_bench.queries.synthetic import QueryConfig, Truth
from skyline_bench.runs.scale import ScaleConfig, Search, measure
from skyline_bench.trials.traced import STAGES, Traced

AREA_M = (1000.0, 2000.0, 11_000.0, 8000.0)
CONFIG = ScaleConfig(
    spacing_m=300.0, areas_km2=(2.0, 70.0), near_km=(0.5,), queries=2,
    query=QueryConfig(width_px=240, height_px=360, azimuths=2560),
)  # fmt: skip


@pytest.fixture(scope="module")
def terrain():
    """Return rough terrain, 3.6 x 2.4 km."""
    return field_of(fractal(81, 121, 250.0, seed=5), west_m=1000.0, north_m=5000.0)


def truth_at(easting_m, northing_m):
    return Truth(easting_m, northing_m, 1000.0, 90.0, 0.0, 0.0, 60.0)


def test_a_square_holds_the_place_anywhere_and_lies_within_the_area():
    generator = np.random.default_rng(3)
    search, west = Search("4 km2", 4.0, side_m=2000.0), []
    for number in range(50):
        place = generator.uniform(AREA_M[:2], AREA_M[2:])
        found = search.about(truth_at(*place), AREA_M, FRAME, [0, number]).rectangle_m
        low, high = np.array(found).reshape(2, 2)
        np.testing.assert_allclose(high - low, 2000.0)
        assert ((low <= place) & (place <= high)).all()
        assert ((low >= AREA_M[:2]) & (high <= AREA_M[2:])).all()
        west.append((place - low)[0] / 2000.0)
    assert min(west) < 0.2
    assert max(west) > 0.8


def test_a_square_wider_than_the_area_is_cut():
    search = Search("49 km2", 49.0, side_m=7000.0)
    _, south, _, north = search.about(truth_at(5e3, 5e3), AREA_M, FRAME, [0, 0]).rectangle_m
    assert (south, north) == (2000.0, 8000.0)


def test_a_circle_holds_the_place():
    search = Search("near 2 km", 12.6, radius_m=2000.0)
    off_m = []
    for number in range(20):
        found = search.about(truth_at(5e3, 5e3), AREA_M, FRAME, [0, number])
        ((east_m, north_m, _radius_m),) = found.circles_m
        off_m.append(np.hypot(east_m - 5e3, north_m - 5e3))
    assert max(off_m) <= 2000.0 * 1.001
    assert max(off_m) > 1500.0


@pytest.mark.usefixtures("refined_once")
def test_areas_are_searched_and_what_was_found_is_kept(terrain, tmp_path, caplog):
    cost, rows = measure(terrain, CONFIG, tmp_path)
    assert cost["places"] == 12 * 8
    assert cost["km2"] == pytest.approx(8.64)
    assert min(cost[key] for key in ("build_s", "build_cpu_s", "bytes", "open_s")) > 0
    assert "the store covers 9 km2: 70 km2" in caplog.text
    everything = [row for row in rows if row["group"] == "all"]
    assert [row["search"] for row in everything] == ["near 0.5 km", "2 km2", "all"]
    for row in everything:
        assert row["n"] == 2
        assert row["within_200m"] <= row["within_1km"]
        assert row["fitted"] >= row["retrieved"]
        assert row["query_s"] > 0.0
        groups = [one for one in rows if one["search"] == row["search"]]
        assert sum(one["n"] for one in groups[1:]) == 2
    (kept,) = tmp_path.glob("scale-*.jsonl")
    lines = kept.read_text().splitlines()
    assert len(lines) == 2 * 3
    # What was killed on the way goes on, and comes to the same.
    kept.write_text("\n".join(lines[:4]) + "\n")
    told = []
    _, again = measure(terrain, CONFIG, tmp_path, lambda *done: told.append(done))
    assert told[-2:] == [(4, 6), (5, 6)]
    for row, other in zip(rows, again, strict=True):
        for key in ("within_200m", "median_m", "answered", *STAGES):
            assert row[key] == other[key]
    # More queries go on from those.
    more = dataclasses.replace(CONFIG, queries=3, near_km=(), areas_km2=())
    measure(terrain, more, tmp_path)
    assert len(kept.read_text().splitlines()) == 7
    assert json.loads(lines[0])["query"] == 0


def test_bad_settings_are_refused(terrain, tmp_path):
    for options, said in (
        ({"areas_km2": (0.0,)}, "area is 0.0 km2"),
        ({"near_km": (np.nan,)}, "radius is nan km"),
        ({"queries": 0}, "queries is 0"),
        ({"seed": -1}, "seed is -1"),
    ):
        with pytest.raises(InputError, match=said):
            ScaleConfig(**options)
    with pytest.raises(InputError, match="too small for a grid of 3000 m"):
        measure(terrain, dataclasses.replace(CONFIG, spacing_m=3000.0), tmp_path)


def test_a_pose_is_there_within_a_spacing_and_looking_the_right_way():
    empty = np.zeros((1, 0))
    place = Places(
        np.zeros(1), np.zeros(1), np.zeros(1, np.float32), np.full(1, 40.0, np.float32),
        np.zeros(1, np.float32), *(empty.astype(kind) for kind in (np.int8, np.uint8, np.uint8)),
    )  # fmt: skip
    traced = Traced(place, lambda east, north: 0.0 * east, SimpleNamespace(edge=None), FRAME)
    assert traced.spacing_m == 80.0
    truth = truth_at(0.0, 0.0)
    assert traced._is_there([500.0, 60.0], [0.0, -50.0], [90.0, 98.0], truth)
    assert not traced._is_there([500.0, 60.0], [0.0, -50.0], [90.0, 102.0], truth)
    assert not traced._is_there([70.0], [-50.0], [90.0], truth)
    assert not traced._is_there([], [], [], truth)


def test_memory_is_measured():
    reset_peak()
    before, own = peak_bytes(), own_bytes()
    if before is None or own is None:
        pytest.skip("this system does not say")
    taken = np.ones(30_000_000)
    assert peak_bytes() >= before + 0.9 * taken.nbytes
    assert own_bytes() >= own + 0.9 * taken.nbytes
