"""Photos of one place measured: what rows count."""

import numpy as np
import pytest
from scenes import fractal, write_dem

from skyline import JointResult, MatchResult, read_dem
from skyline.build.grid import map_bounds
from skyline.errors import InputError
from skyline.matching.ranking import Candidate
from skyline_bench.queries.synthetic import make_queries_together
from skyline_bench.runs.same_place import SamePlaceConfig, _groups, _Measured, _row
from skyline_bench.trials.trials import trial_of


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    terrain = read_dem([write_dem(path, fractal(120, 120, 600.0, seed=4))])
    return make_queries_together(terrain, map_bounds(terrain, None), 3, 3, seed=1)


def joint(photo, east_m, agrees):
    truth = photo.truth
    place = Candidate(
        lon=0.0, lat=0.0, heading_deg=0.0, pitch_deg=0.0, roll_deg=0.0, fov_deg=60.0,
        easting_m=truth.easting_m + east_m, northing_m=truth.northing_m, eye_elevation_m=0.0,
        convergence_deg=0.0, score=0.0, confidence=1.0, covariance_m2=((4.0, 0.0), (0.0, 4.0)),
    )  # fmt: skip
    results = tuple(
        MatchResult(photo.skyline, (place,) if one else (), 1.0, None, 200.0 if one else None)
        for one in agrees
    )
    return JointResult(results, agrees, 1.0)


def test_photos_of_one_place_share_the_eye_alone(photos):
    assert [len(some) for some in photos] == [3, 3, 3]
    for some in photos:
        assert len({(one.truth.easting_m, one.truth.northing_m) for one in some}) == 1
        assert len({one.truth.heading_deg for one in some}) == 3
    assert len({some[0].truth.easting_m for some in photos}) == 3


def test_rows_count_what_was_found(photos):
    # Alone nothing is found of the first place, one photo of the second, all of the third.
    found = [(0, 500.0, (True, True, True)), (1, 1.0, (True, False, True)), (3, 2.0, (True,) * 3)]
    measured = []
    for some, (alone, east_m, agrees) in zip(photos, found, strict=True):
        right = joint(some[0], 0.0, (True,)).results[0]
        trials = tuple(
            trial_of(one, right if index < alone else None, 1.0, np.inf)
            for index, one in enumerate(some)
        )
        mixed = joint(some[0], east_m, (True, True, False))
        measured.append(_Measured(trials, joint(some[0], east_m, agrees), mixed, east_m, east_m))
    groups = {name: _row(some) for name, some in _groups(measured).items()}
    row = groups["all"]
    assert (row["places"], row["photos"]) == (3, 3)
    assert row["alone_within_200m"] == pytest.approx(4 / 9)
    assert row["within_200m"] == row["precision"] == row["mixed_within_200m"] == 2 / 3
    assert row["median_m"] == 2.0
    assert row["radius_holds"] == 1.0
    assert row["own_named_wrong"] == pytest.approx(1 / 3)
    assert row["stranger_named"] == 1.0
    hardest = groups["third found least alone"]
    assert (hardest["places"], hardest["alone_within_200m"], hardest["within_200m"]) == (1, 0, 0)
    assert groups["third of nearest skylines"]["places"] == 1


@pytest.mark.parametrize("wrong", [{"places": 1}, {"photos": 2}])
def test_too_few_are_refused(wrong):
    with pytest.raises(InputError, match="expected 3 or more of 2 or more"):
        SamePlaceConfig(**wrong)
