"""Placing measured: the same queries over uniform grids and planned places."""

import numpy as np
import pytest
from scenes import fractal, write_dem

from skyline import read_dem
from skyline.places import Places
from skyline.store import open_store
from skyline_bench.runs.placing import PlacingConfig, claimed_loss, measure, model_quality


@pytest.fixture(scope="module")
def measured(tmp_path_factory, refined_once):
    folder = tmp_path_factory.mktemp("placing")
    terrain = read_dem([write_dem(folder / "dem.tif", fractal(220, 220, 900.0, seed=4))])
    config = PlacingConfig((300.0,), (0.3,), queries=2)
    return folder, terrain, config, measure(terrain, config, folder)


def test_every_layout_has_its_rows(measured):
    folder, _, _, rows = measured
    everything = [row for row in rows if row["group"] == "all"]
    assert [row["layout"] for row in everything] == ["places-300", "planned-0.3"]
    for row in everything:
        assert row["n"] == 2
        with open_store(folder / f"{row['layout']}.h5") as store:
            assert row["places"] == len(store)
        assert 0.0 <= row["within_200m"] <= row["within_1km"] == pytest.approx(1.0 - row["lost"])
    # What was planned for is what is claimed of the places, but for the area's sides.
    assert everything[1]["claimed_loss"] == pytest.approx(0.3, abs=0.06)


def test_what_is_there_is_not_searched_again(measured):
    folder, terrain, config, rows = measured
    again = measure(terrain, config, folder)
    assert [row["query_s"] for row in again] == [row["query_s"] for row in rows]


def test_the_claim_is_weighted_by_what_places_stand_for(measured):
    folder, *_ = measured
    with open_store(folder / "planned-0.3.h5") as store:
        places = Places.concatenate(list(store.places().blocks()))
    twice = Places.concatenate([places, places])
    assert claimed_loss(twice) == pytest.approx(claimed_loss(places))


def test_precision_and_recall_are_of_what_is_found():
    expected = np.array([0.1, 0.2, 0.9, 0.6, 0.3])
    lost = np.array([False, True, True, False, False])
    quality = model_quality(expected, lost)
    assert quality["model_precision"] == pytest.approx(2 / 3)
    assert quality["model_recall"] == pytest.approx(2 / 3)
    assert quality["expected_loss"] == pytest.approx(0.42)
    assert quality["lost"] == pytest.approx(0.4)
