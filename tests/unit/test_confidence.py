"""The figures that a confidence is learned from, and the probabilities that it gives."""

from dataclasses import replace

import numpy as np
import pytest
from query_scenes import equally_trusted, poses
from scenes import candidate_at

from skyline.match import confidence
from skyline.pose import DISTANCES_M, FitFigures

AZIMUTH_RAD = np.linspace(-0.5, 0.5, 200)
QUERY = equally_trusted(AZIMUTH_RAD, 0.1 * np.sin(9.0 * AZIMUTH_RAD), 60.0)


def retrieved(easting_m, cost):
    """Poses along a line to the east."""
    return poses(len(cost), easting_m=easting_m, cost=cost)


def fitted(residual_deg):
    """Refined poses at one place that differ by their residuals alone."""
    count = len(residual_deg)
    one = np.ones(count)
    fits = FitFigures(
        covariance_m2=np.tile(100.0 * np.eye(2), (count, 1, 1)),
        residual_deg=residual_deg,
        terrain_share=one,
        skyline_m=1e3 * one,
        beyond_share=0.0 * one,
        effective_columns=180.0 * one,
        height_sd_m=5.0 * one,
        margin=0.0 * one,
        far_margin=0.0 * one,
        angle_sd_deg=np.ones((count, 4)),
    )
    return replace(retrieved([0.0] * count, [0.0] * count), fits=fits)


@pytest.mark.parametrize("within_m", DISTANCES_M)
def test_a_pose_that_no_search_found_is_judged_by_how_well_it_fits(within_m):
    model = confidence.models()[confidence.model_name(confidence.FITTED, within_m)]
    poses = fitted(np.array([0.02, 0.1, 0.5, 1.44]))
    sure = model.probability(confidence.pose_figures(poses, QUERY))
    assert (np.diff(sure) < 0.0).all()
    assert sure[0] > 0.9
    assert (sure[:2] > 0.8).all()
    assert (sure[2:] < 0.75).all()  # Such fits have failed.


def candidate(east_m, score, heading_deg=90.0, rank=1, sure=None):
    """A candidate at the origin's northing; its confidences are one and the same."""
    alike = {"confidence": sure, "confidence_1km": sure}
    return candidate_at(east_m, 0.0, heading_deg, cost=score, rank=rank, **alike)


# One that is sure, a worse one 150 m beside it, and one 5 km away.
FOUND = [
    candidate(0.0, -1000.0, rank=1, sure=0.92),
    candidate(150.0, -900.0, rank=2, sure=0.91),
    candidate(5000.0, -800.0, rank=3, sure=0.04),
]


@pytest.mark.parametrize(
    ("start_m", "fitted_m", "score", "rank"),
    [
        (0.0, 0.0, -1000.0, 1),
        (0.0, 13.0, -1007.9, 1),  # The odds that it is better are less than e to 1.
        (30.0, 70.0, -850.0, 1),  # It is worse than the candidate that it ended near,
        (30.0, 900.0, -850.0, 1),  # and than the one that it started from.
        (150.0, 160.0, -899.0, 2),
        (150.0, 20.0, -990.0, 1),
        (5000.0, 5190.0, -700.0, 3),
    ],
)
def test_a_fit_that_leads_to_a_candidate_is_the_candidate(start_m, fitted_m, score, rank):
    fitted = candidate(fitted_m, score, rank=None)
    again = confidence.found_again(FOUND, candidate(start_m, np.nan, rank=None), fitted)
    assert again is FOUND[rank - 1]


@pytest.mark.parametrize(
    ("fitted_m", "score", "rank"), [(-60.0, -1009.0, 1), (160.0, -950.0, 2), (5100.0, -990.0, 3)]
)
def test_a_better_fit_of_the_same_answer_takes_the_candidates_place(fitted_m, score, rank):
    fitted = candidate(fitted_m, score, rank=None)
    again = confidence.found_again(FOUND, fitted, fitted)
    assert (again.rank, again.confidence) == (rank, FOUND[rank - 1].confidence)
    assert (again.easting_m, again.cost) == (fitted_m, score)


@pytest.mark.parametrize(
    ("fitted_m", "score", "heading_deg"),
    [
        (900.0, -999.0, 90.0),
        (0.0, -1001.0, 150.0),  # It looks another way.
        (5000.0, -1001.0, 90.0),  # It is better than all candidates, though seldom right by them.
    ],
)
def test_a_fit_of_another_answer_is_none_of_the_candidates(fitted_m, score, heading_deg):
    fitted = candidate(fitted_m, score, heading_deg, rank=None)
    assert confidence.found_again(FOUND, fitted, fitted) is None
    assert confidence.found_again((), fitted, fitted) is None


def test_a_fit_fails_where_few_such_fits_are_right_or_the_answer_fits_better():
    def said(answer=None, sure=0.76, cost=-900.0, heading_deg=90.0):
        fitted = candidate(2400.0, cost, heading_deg, rank=None, sure=sure)
        fitted = replace(fitted, residual_deg=0.1, terrain_share=0.5)
        return confidence.misfit(fitted, confidence.MatchConfig(), answer)

    apart = "the skylines are 0.10 degrees apart (rms) over 50 % of the skyline; "
    few = apart + "of poses that fit like this 74 % are right, and 75 % are needed"
    assert said() is said(FOUND[0], cost=-1001.0) is None
    assert said(sure=0.74) == said(FOUND[0], 0.74, -1001.0) == few
    # No share is named beside the confidence of a better candidate.
    assert said(FOUND[0]) == said(FOUND[0], 0.74) == apart + "candidate 1, 2400 m away, fits better"
    turned = said(FOUND[0], heading_deg=260.0)
    assert turned == apart + "candidate 1, 2400 m and 170 degrees of heading away, fits better"


def test_a_narrow_search_divides_the_odds_by_the_square_of_its_extent():
    def log_odds(extent_m):
        found = retrieved([0.0, extent_m], [1.0, 2.0])
        return confidence.refined_figures(fitted(np.full(2, 0.1)), found, QUERY)["log_odds"]

    # From the extent that was learned from, 8.5 km, nothing is taken off.
    np.testing.assert_array_equal(log_odds(8_500.0), log_odds(80_000.0))
    for extent_m in (990.0, 1_010.0, 4_000.0):
        off = log_odds(80_000.0) - log_odds(extent_m)
        assert off == pytest.approx(2.0 * np.log(8_500.0 / extent_m))


def test_poses_near_one_another_share_one_probability_and_others_the_rest():
    half = confidence.Logistic((), (), (), (), 0.0)
    models = {confidence.model_name("refined", within_m): half for within_m in DISTANCES_M}
    # Three within a kilometre, two of them one answer, and two that are one answer farther away.
    some = retrieved([0.0, 100.0, 600.0, 5000.0, 5100.0], [3.0, 4.0, 11.0, 5.0, 4.0])
    near, roughly = confidence.shared_probabilities(models, some, {"any": np.zeros(5)})
    assert near[0] == near[1] == roughly[0] == roughly[1] == pytest.approx(0.5)
    assert 0.0 < near[2] < 0.5
    assert roughly[2] == pytest.approx(0.5)
    assert near[3] == near[4] == pytest.approx(0.5 - near[2])
    assert near[3] <= roughly[3] <= 0.5
    # What fits far worse has no share, nor has what may not be.
    worse = retrieved([0.0, 5000.0, 9000.0], [3.0, 203.0, np.inf])
    near, _ = confidence.shared_probabilities(models, worse, {"any": np.zeros(3)})
    assert near == pytest.approx([0.5, 0.0, 0.0], abs=1e-9)
