"""Answers in words, JSON and rows; why a match has no answer, and how near one is sure to be."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import candidate_at

from skyline.errors import InputError
from skyline.match.confidence import MatchConfig, refusal_of, sure_within_m
from skyline.match.rays import Rays
from skyline.match.result import MatchResult
from skyline.photo.exif import NOTHING_NOTED, NotedPlace
from skyline.photo.skyline import Lens, PhotoSkyline

GIVEN_DEG, SD_DEG = 60.0, 1.5


@pytest.fixture
def rays():
    u = np.linspace(-0.5, 0.5, 100)
    return Rays(u=u, v=0.0 * u, weight=np.ones_like(u), fov_deg=GIVEN_DEG).about(SD_DEG)


def query(fov_deg=GIVEN_DEG, noted=NOTHING_NOTED, lens=None):
    return PhotoSkyline(np.full(40, 12.0), np.ones(40), 40, 30, fov_deg, noted=noted, lens=lens)


def refusal(rays, found_deg, given_deg=GIVEN_DEG, confidence=None):
    """Return the refusal of a candidate with a field of view."""
    sure = {"confidence": confidence, "confidence_1km": confidence}
    found = candidate_at(0.0, 0.0, fov_deg=found_deg, **sure)
    return refusal_of([found], MatchConfig(), query(given_deg), rays)


@pytest.mark.parametrize(("found_deg", "named"), [(56.9, True), (63.1, True), (57.8, False)])
def test_a_field_of_view_that_hardly_fits_is_named(rays, found_deg, named):
    why = refusal(rays, found_deg, confidence=0.1)
    assert why.startswith("the best place has confidence 0.10, within 1 km 0.10; 0.80 is needed")
    hint = f"field of view of {found_deg:.1f} degrees, and {GIVEN_DEG:.1f} was expected"
    assert (hint in why) == ("expected" in why) == named


@pytest.mark.parametrize(("found_deg", "refused"), [(54.0, True), (66.0, True), (65.9, False)])
def test_a_field_of_view_at_the_end_of_the_range_searched_is_no_answer(rays, found_deg, refused):
    assert rays.fov_bounds_deg == (54.0, 66.0)
    why = refusal(rays, found_deg)
    assert (why is not None) == refused
    assert not refused or "--fov-deg" in why


@pytest.mark.parametrize(
    ("near", "roughly", "within_m"),
    [(0.9, 0.95, 200.0), (0.89, 0.95, 1000.0), (0.5, 0.8, 1000.0), (0.5, 0.79, None)],
)
def test_the_nearer_claim_leaves_half_of_the_doubt(near, roughly, within_m):
    candidate = candidate_at(0.0, 0.0, confidence=near, confidence_1km=roughly)
    config = MatchConfig(min_confidence=0.8)
    assert sure_within_m(candidate, config) == within_m
    with pytest.raises(InputError, match="least confidence is 80; expected 0"):
        MatchConfig(min_confidence=80)
    # A circle of more than 200 m cannot be sure to 200 m.
    vague = replace(candidate, covariance_m2=((150.0**2, 0.0), (0.0, 150.0**2)))
    assert vague.radius_m > 200.0
    assert sure_within_m(vague, config) == (within_m and 1000.0)


BEST = replace(candidate_at(0.0, 0.0), lon=9.8, lat=46.7, heading_deg=131.0)


def noting(noted, refusal=None):
    """Return a result for a photo whose EXIF notes a place."""
    return MatchResult(query(noted=noted), (BEST,), 0.0, refusal)


def test_the_photo_s_own_place_is_compared_with_the_answer():
    noted = NotedPlace((9.8, 46.7 + 240.0 / 111_170.0), 1800.0, 112.0, True, 5.0)
    result = noting(noted)
    assert result.exif["distance_m"] == pytest.approx(240.0, abs=0.5)
    assert result.exif["heading_off_deg"] == pytest.approx(19.0)
    assert result.to_dict()["exif"] == result.exif
    assert result.to_row()["exif_distance_m"] == result.exif["distance_m"]
    words = result.exif_in_words()
    assert "lon 9.80000, 240 m from the answer (good to 5 m). Its" in words
    assert "compass says 112 degrees, from magnetic north, the answer 131." in words
    assert "disagree" not in words
    assert "46.7" not in result.exif_in_words(with_place=False)
    far = noting(NotedPlace((-70.0, 46.7), None, 359.0), "not sure").exif_in_words()
    assert "compass and candidate 1 disagree: if the photo is right, search round its" in far


def test_an_answer_and_a_refusal_are_printed_with_their_query():
    lens = Lens(60.3, 5.0, reason="EXIF's 35 mm equivalent alone")
    sure = replace(BEST, confidence=0.93, confidence_1km=0.97, refined=True)
    first, answer, place, *_, lens_line = (
        MatchResult(query(lens=lens), (sure,), 1.5, None, 200.0, "a\nb.jpg").to_text().splitlines()
    )
    assert first == r"a\nb.jpg (1.50 s)"
    assert "candidate 1, right within 200 m" in answer
    assert "lat 46.70000 lon 9.80000" in place
    assert "60.3 degrees, give or take 5; EXIF's 35 mm equivalent alone" in lens_line
    scored = MatchResult(query(), (replace(BEST, cost=0.00421, confidence=None),), 1.5, None)
    assert "cost 0.00421 (the lower" in scored.to_text()
    refused = MatchResult(query(), (), 1.5, "no place fits", name="c.jpg")
    assert refused.to_text() == "c.jpg (1.50 s)\n  no answer: no place fits"
    assert replace(refused, name="").to_text().startswith("query (1.50 s)")
    said = {"query": "c.jpg", "seconds": 1.5, "refusal": "no place fits"}
    assert refused.to_dict() == said | {
        "answer": None,
        "answer_within_m": None,
        "answer_confidence": None,
        "candidates": [],
    }
