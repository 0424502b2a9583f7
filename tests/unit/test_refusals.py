"""Why a match is no answer, and how near an answer is sure to be."""

import numpy as np
import pytest
from scenes import candidate_at

from skyline.match.matchers import MatchConfig
from skyline.match.query_rays import QueryRays
from skyline.match.refusals import at_bound, lens_in_doubt, sure_within_m
from skyline.photo.query import QuerySkyline

GIVEN_DEG, SD_DEG = 60.0, 1.5


@pytest.fixture
def rays():
    u = np.linspace(-0.5, 0.5, 100)
    return QueryRays(u, 0.0 * u, np.ones_like(u), GIVEN_DEG).about(SD_DEG)


def query(fov_deg):
    return QuerySkyline(np.full(40, 12.0), np.ones(40), 40, 30, fov_deg)


@pytest.mark.parametrize("found_deg", [56.9, 63.1])
def test_a_field_of_view_that_hardly_fits_is_named(rays, found_deg):
    said = lens_in_doubt([candidate_at(0.0, 0.0, fov_deg=found_deg)], query(GIVEN_DEG), rays)
    assert f"field of view of {found_deg:.1f} degrees, and {GIVEN_DEG:.1f} was given" in said


def test_a_field_of_view_that_fits_or_was_not_given_is_no_matter(rays):
    near = [candidate_at(0.0, 0.0, fov_deg=62.9)]
    far = [candidate_at(0.0, 0.0, fov_deg=65.0)]
    assert lens_in_doubt(near, query(GIVEN_DEG), rays) == ""
    assert lens_in_doubt(far, query(None), rays) == ""
    assert lens_in_doubt([], query(GIVEN_DEG), rays) == ""


@pytest.mark.parametrize(("found_deg", "refused"), [(54.0, True), (66.0, True), (65.9, False)])
def test_a_field_of_view_at_the_end_of_what_is_searched_is_no_answer(rays, found_deg, refused):
    assert rays.fov_bounds_deg == (54.0, 66.0)
    said = at_bound([candidate_at(0.0, 0.0, fov_deg=found_deg)], rays)
    assert (said is not None) == refused
    assert not refused or "--fov-deg" in said


@pytest.mark.parametrize(
    ("near", "roughly", "within_m"),
    [(0.9, 0.95, 200.0), (0.89, 0.95, 1000.0), (0.5, 0.8, 1000.0), (0.5, 0.79, None)],
)
def test_the_nearer_claim_leaves_half_of_the_doubt(near, roughly, within_m):
    candidate = candidate_at(0.0, 0.0, confidence=near, confidence_1km=roughly)
    assert sure_within_m(candidate, MatchConfig(min_confidence=0.8)) == within_m
