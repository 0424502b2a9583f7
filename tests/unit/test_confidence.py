"""The figures that a confidence is learned from, and the probabilities that it gives."""

from dataclasses import replace

import numpy as np
import pytest
from ray_scenes import equally_trusted, poses

from skyline.match import confidence
from skyline.pose.pose import DISTANCES_M
from skyline.pose.poses import FitFigures

AZIMUTH_RAD = np.linspace(-0.5, 0.5, 200)
RAYS = equally_trusted(AZIMUTH_RAD, 0.1 * np.sin(9.0 * AZIMUTH_RAD), 60.0)


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
        angle_sd_deg=np.ones((count, 4)),
        covariance=np.tile(np.eye(8), (count, 1, 1)),
    )
    return replace(retrieved([0.0] * count, [0.0] * count), fits=fits)


def test_a_pose_that_no_search_found_is_judged_by_how_well_it_fits():
    poses = fitted(np.array([0.02, 0.1, 0.5, 1.44]))
    figures = confidence.pose_figures(poses, RAYS)
    for sure in confidence.probabilities(confidence.models(), confidence.FITTED, figures):
        assert (np.diff(sure) <= 0.0).all()
        # Fits below 0.7 have failed.
        assert (sure[:2] > 0.7).all()
        assert (sure[2:] < 0.7).all()


def test_a_model_is_not_used_without_the_figures_that_it_needs():
    """A figure that was given another name is missing, and would count as its mean."""
    model = confidence.models()[confidence.model_name("retrieved", 1000.0)]
    figures = confidence.retrieved_figures(retrieved([0.0, 9_000.0], [1.0, 2.0]), RAYS)
    assert set(model.names) == set(figures)
    figures["score"] = figures.pop("cost")
    with pytest.raises(ValueError, match="cost"):
        model.probability(figures)


def test_the_parts_of_a_figure_add_up_to_its_deviation_held_within_4():
    model = confidence.Logistic(["a"], [1.0], [2.0], (), 0.0)
    parts = model.segments({"a": np.array([1.0, 2.0, -4.0, 99.0])})
    # Of 0, 0.5, -2.5 and 49 deviations; the lines bend at -1, 0 and 1.
    expected = [[0, 0, 0, 0], [0, 0, 0.5, 0], [-1.5, -1, 0, 0], [0, 0, 1, 3]]
    np.testing.assert_allclose(parts[:, 0], expected)


def test_a_model_adds_up_the_slopes_of_its_figures():
    model = confidence.Logistic(["a"], [0.0], [1.0], [[5.0, 4.0, 3.0, 2.0]], -1.0)
    sure = model.probability({"a": np.array([0.0, 2.0, -2.0])})
    logit = np.array([-1.0, -1.0 + 3.0 + 2.0, -1.0 - 4.0 - 5.0])
    np.testing.assert_allclose(sure, 1.0 / (1.0 + np.exp(-logit)))


def test_a_lens_without_distortion_has_no_warp_which_counts_as_its_mean():
    model = confidence.models()[confidence.model_name(confidence.FITTED, 200.0)]
    figures = confidence.pose_figures(fitted(np.array([0.1])), RAYS)
    assert "warp_deviations" not in figures
    mean = dict(zip(model.names, model.mean, strict=True))["warp_deviations"]
    at_mean = model.probability(figures | {"warp_deviations": np.array([mean])})
    np.testing.assert_array_equal(model.probability(figures), at_mean)


def test_a_narrow_search_divides_the_odds_by_the_square_of_its_extent():
    def log_odds(extent_m):
        found = retrieved([0.0, extent_m], [1.0, 2.0])
        return confidence.refined_figures(fitted(np.full(2, 0.1)), found, RAYS)["log_odds"]

    # From the extent that was learned from, 8.5 km, nothing is taken off.
    np.testing.assert_array_equal(log_odds(8_500.0), log_odds(80_000.0))
    for extent_m in (990.0, 1_010.0, 4_000.0):
        off = log_odds(80_000.0) - log_odds(extent_m)
        assert off == pytest.approx(2.0 * np.log(8_500.0 / extent_m))


def test_an_answer_leads_by_how_much_less_its_place_costs_in_retrieval_than_any_other():
    """The refined pose, at 0 m, owns retrieved poses up to 200 m or 1 km away that look its way."""
    found = retrieved([100.0, 600.0, 5_000.0], [1.5, 1.2, 1.9])
    figures = confidence.refined_figures(fitted(np.array([0.1])), found, RAYS)
    assert figures["lead"] == pytest.approx(1.2 - 1.5)
    assert figures["far_lead"] == pytest.approx(1.9 - 1.2)
    turned = replace(found, grid_heading_deg=np.add(found.grid_heading_deg, [0.0, 31.0, 0.0]))
    figures = confidence.refined_figures(fitted(np.array([0.1])), turned, RAYS)
    assert figures["far_lead"] == pytest.approx(1.2 - 1.5)


def test_an_answer_that_retrieval_does_not_list_is_behind_as_its_worst_pose():
    found = retrieved([5_000.0, 9_000.0], [1.2, 1.9])
    figures = confidence.refined_figures(fitted(np.array([0.1])), found, RAYS)
    assert figures["lead"] == figures["far_lead"] == pytest.approx(1.2 - 1.9)


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


def test_the_odds_of_rivals_count_against_a_pose():
    # Odds of 4 and of 1: four parts for the pose, one for its rival, and one for neither.
    assert confidence.beside_rivals(0.8, [0.5]) == pytest.approx(4.0 / 6.0)
    assert confidence.beside_rivals(0.8, []) == pytest.approx(0.8)
    assert confidence.beside_rivals(0.8, [0.5, 0.5]) == pytest.approx(4.0 / 7.0)
