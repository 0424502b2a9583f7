"""What a matcher's answers are worth, and their summary."""

import numpy as np
import pytest
from scenes import candidate_at

from skyline.errors import InputError
from skyline.photo.query import QuerySkyline
from skyline.pipeline.results import MatchResult
from skyline_bench.queries.synthetic import SyntheticQuery, Truth
from skyline_bench.trials.trials import run_trials, summarize

MISS_M = 5000.0
SKYLINE = QuerySkyline(np.full(8, 3.0), np.ones(8), 8, 8, 60.0)


def query_at(easting_m, heading_deg):
    truth = Truth(easting_m, 0.0, 1000.0, heading_deg, 0.0, 0.0, 60.0)
    return SyntheticQuery(SKYLINE, 60.0, (57.0, 63.0), truth, SKYLINE.row_px, 4000.0, ())


class Nearby:
    """Answers the origin for all, refuses the third query and finds nothing for the fourth."""

    def __init__(self):
        self.calls = 0

    def match(self, query, fov_deg=None, top=5):
        self.calls += 1
        if self.calls == 3:
            raise InputError("too little to see")
        found = [candidate_at(0.0, 100.0 * i, 5.0) for i in range(top)]
        return MatchResult(query, () if self.calls == 4 else tuple(found), 0.5)


class Nothing:
    """Finds nothing."""

    def match(self, query, fov_deg=None, top=5):
        return MatchResult(query, (), 0.5)


@pytest.fixture
def trials():
    queries = [query_at(30.0, 355.0), query_at(-900.0, 5.0), query_at(0, 0), query_at(0, 0)]
    return list(run_trials(Nearby(), queries, MISS_M, top=3))


def test_errors_are_those_of_the_best_candidate(trials):
    assert [trial.error_m for trial in trials] == [30.0, 900.0, MISS_M, MISS_M]
    assert [trial.right for trial in trials] == [True, False, False, False]
    assert [trial.answered_within_m for trial in trials] == [200.0, 200.0, None, None]
    assert trials[0].heading_error_deg == pytest.approx(10.0)
    assert np.isnan(trials[2].heading_error_deg)


def test_a_summary_counts_every_query(trials):
    row = summarize(trials, seed=0)
    assert (row["n"], row["within_200m"], row["answered"], row["precision"]) == (4, 0.25, 0.5, 0.5)
    assert row["mean_m"] == pytest.approx(np.mean([30.0, 900.0, MISS_M, MISS_M]))
    assert row["median_m"] == pytest.approx((900.0 + MISS_M) / 2.0)
    assert row["heading_median_deg"] == pytest.approx(10.0)
    assert row == summarize(trials, seed=0)


def test_intervals_hold_the_figure_and_shrink_with_more_queries(trials):
    few, many = (summarize(trials * times, seed=1) for times in (5, 100))
    for row in (few, many):
        assert row["within_200m_low"] <= row["within_200m"] <= row["within_200m_high"]
        assert row["median_m_low"] <= row["median_m"] <= row["median_m_high"]
    width = many["within_200m_high"] - many["within_200m_low"]
    # Two standard errors either side of a share of 1/4 among 400.
    assert width == pytest.approx(4.0 * np.sqrt(0.25 * 0.75 / 400.0), rel=0.15)
    assert few["within_200m_high"] - few["within_200m_low"] > 3.0 * width


def test_no_candidate_is_never_right():
    lost, *_ = run_trials(Nothing(), [query_at(0.0, 0.0)], 150.0, top=3)
    assert lost.error_m == 150.0
    assert not lost.right


def test_nothing_right_has_no_heading(trials):
    row = summarize(trials[2:], seed=0)
    assert row["heading_median_deg"] is None
    assert row["precision"] is None
