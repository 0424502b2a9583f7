"""Why a pose is no answer, and how near an answer is sure to be."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import candidate_at

from skyline.camera.projection import Projection
from skyline.match.config import MatchConfig
from skyline.match.other_projection import OtherProjection
from skyline.match.rays import Rays
from skyline.match.verdict import Verdict, candidate_reached
from skyline.photo.skyline import PhotoSkyline

GIVEN_DEG, SD_DEG = 60.0, 1.5


@pytest.fixture
def rays():
    u = np.linspace(-0.5, 0.5, 100)
    return Rays(u=u, v=0.0 * u, weight=np.ones_like(u), fov_deg=GIVEN_DEG).about(SD_DEG)


def skyline_of(fov_deg):
    return PhotoSkyline(np.full(40, 12.0), np.ones(40), 40, 30, fov_deg)


def verdict(rays, candidate, other=None):
    return Verdict.of_search([candidate], other, MatchConfig(), skyline_of(GIVEN_DEG), rays)


def refusal(rays, found_deg, confidence=None):
    """Return the refusal of a candidate with a field of view."""
    sure = {"confidence": confidence, "confidence_1km": confidence}
    return verdict(rays, candidate_at(0.0, 0.0, fov_deg=found_deg, **sure)).refusal


@pytest.mark.parametrize(("found_deg", "named"), [(56.9, True), (63.1, True), (57.8, False)])
def test_a_field_of_view_that_hardly_fits_is_named(rays, found_deg, named):
    why = refusal(rays, found_deg, confidence=0.1)
    assert why.startswith("the best place has a confidence of 0.10 within 1 km, and 0.80 is needed")
    hint = f"field of view of {found_deg:.1f} degrees, and {GIVEN_DEG:.1f} was expected"
    assert (hint in why) == ("expected" in why) == named


@pytest.mark.parametrize(("found_deg", "refused"), [(54.0, True), (66.0, True), (65.9, False)])
def test_a_field_of_view_at_the_end_of_the_range_searched_is_no_answer(rays, found_deg, refused):
    assert rays.fov_bounds_deg == (54.0, 66.0)
    why = refusal(rays, found_deg, confidence=0.95)
    assert (why is not None) == refused
    assert not refused or "--fov-deg" in why


def test_a_place_without_a_confidence_is_no_answer(rays):
    why = refusal(rays, GIVEN_DEG)
    assert why.startswith("the matcher estimates no confidence, so the best place is not judged")
    # Who asks for an answer whatever its confidence gets one.
    bold = MatchConfig(min_confidence=0.0)
    candidates = [candidate_at(0.0, 0.0, fov_deg=GIVEN_DEG)]
    assert Verdict.of_search(candidates, None, bold, skyline_of(GIVEN_DEG), rays).refusal is None


@pytest.mark.parametrize(
    ("near", "roughly", "within_m"),
    [(0.9, 0.95, 200.0), (0.89, 0.95, 1000.0), (0.5, 0.8, 1000.0), (0.5, 0.79, None)],
)
def test_the_nearer_claim_leaves_half_of_the_doubt(rays, near, roughly, within_m):
    candidate = candidate_at(0.0, 0.0, fov_deg=GIVEN_DEG, confidence=near, confidence_1km=roughly)
    assert verdict(rays, candidate).within_m == within_m
    # A circle of more than 200 m cannot be sure to 200 m.
    vague = replace(candidate, covariance_m2=((150.0**2, 0.0), (0.0, 150.0**2)))
    assert vague.radius_m > 200.0
    assert verdict(rays, vague).within_m == (within_m and 1000.0)


def test_another_projection_joins_other_reasons(rays):
    likely = OtherProjection(Projection.CYLINDRICAL, 108.2, 0.9)
    said = "the skyline is bent as by a panorama of about 108 degrees; if it is one, give "
    said += "--projection cylindrical --fov-deg 108"
    sure = candidate_at(0.0, 0.0, fov_deg=GIVEN_DEG, confidence=0.95, confidence_1km=0.97)
    unsure = replace(sure, confidence=0.1, confidence_1km=0.2)
    assert verdict(rays, sure, likely) == Verdict(said)
    alone = verdict(rays, unsure).refusal
    assert verdict(rays, unsure, likely) == Verdict(f"{alone}; {said}")
    assert verdict(rays, sure, replace(likely, probability=0.1)) == Verdict(None, 200.0)


def test_a_search_of_several_photos_names_the_one_that_is_bent():
    sure = candidate_at(0.0, 0.0, fov_deg=GIVEN_DEG, confidence=0.95, confidence_1km=0.97)
    likely = OtherProjection(Projection.CYLINDRICAL, 108.2, 0.9)

    def joint(*others, count=2):
        return Verdict.of_joint_search([[sure]] * count, others, MatchConfig())

    assert joint(("a.jpg", None), ("b.jpg", None)) == Verdict(None, 200.0)
    assert joint(("a.jpg", None), ("b.jpg", likely)).refusal.startswith(
        "b.jpg: the skyline is bent"
    )
    assert joint(("", likely), ("b.jpg", None)).refusal.startswith("a photo: the skyline is bent")
    assert joint(("a.jpg", None), count=1).refusal == "fewer than two photos agree on a place"


def candidate(east_m, cost, heading_deg=90.0, rank=1, sure=None):
    """A candidate at the origin's northing; its confidences are one and the same."""
    alike = {"confidence": sure, "confidence_1km": sure}
    return candidate_at(east_m, 0.0, heading_deg, cost=cost, rank=rank, **alike)


# One that is sure, a worse one 150 m beside it, and one 5 km away.
FOUND = [
    candidate(0.0, -1000.0, rank=1, sure=0.92),
    candidate(150.0, -900.0, rank=2, sure=0.91),
    candidate(5000.0, -800.0, rank=3, sure=0.04),
]


@pytest.mark.parametrize(
    ("start_m", "fitted_m", "cost", "rank"),
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
def test_a_fit_that_leads_to_a_candidate_is_the_candidate(start_m, fitted_m, cost, rank):
    fitted = candidate(fitted_m, cost, rank=None)
    again = candidate_reached(FOUND, candidate(start_m, np.nan, rank=None), fitted)
    assert again is FOUND[rank - 1]


@pytest.mark.parametrize(
    ("fitted_m", "cost", "rank"), [(-60.0, -1009.0, 1), (160.0, -950.0, 2), (5100.0, -990.0, 3)]
)
def test_a_better_fit_of_the_same_answer_takes_the_candidates_place(fitted_m, cost, rank):
    fitted = candidate(fitted_m, cost, rank=None)
    again = candidate_reached(FOUND, fitted, fitted)
    assert (again.rank, again.confidence) == (rank, FOUND[rank - 1].confidence)
    assert (again.easting_m, again.cost) == (fitted_m, cost)


@pytest.mark.parametrize(
    ("fitted_m", "cost", "heading_deg"),
    [
        (900.0, -999.0, 90.0),
        (0.0, -1001.0, 150.0),  # It looks another way.
        (5000.0, -1001.0, 90.0),  # It is better than all candidates, though seldom right by them.
    ],
)
def test_a_fit_of_another_answer_is_none_of_the_candidates(fitted_m, cost, heading_deg):
    fitted = candidate(fitted_m, cost, heading_deg, rank=None)
    assert candidate_reached(FOUND, fitted, fitted) is None
    assert candidate_reached((), fitted, fitted) is None


def test_a_fit_fails_where_few_such_fits_are_right_or_the_answer_fits_better():
    def said(answer=None, sure=0.71, cost=-900.0, heading_deg=90.0):
        fitted = candidate(2400.0, cost, heading_deg, rank=None, sure=sure)
        fitted = replace(fitted, residual_deg=0.1, terrain_share=0.5)
        return Verdict.of_fit(fitted, answer, MatchConfig()).refusal

    apart = "the skylines are 0.10 degrees apart (rms) over 50 % of the skyline; "
    few = apart + "of poses that fit like this 69 % are right, and 70 % are needed"
    assert said() is said(FOUND[0], cost=-1001.0) is None
    assert said(sure=0.69) == said(FOUND[0], 0.69, -1001.0) == few
    # No share is named beside the confidence of a better candidate.
    assert said(FOUND[0]) == said(FOUND[0], 0.69) == apart + "candidate 1, 2400 m away, fits better"
    turned = said(FOUND[0], heading_deg=260.0)
    assert turned == apart + "candidate 1, 2400 m and 170 degrees of heading away, fits better"
