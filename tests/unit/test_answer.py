"""Answers in words, JSON and rows."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import candidate_at

from skyline.match.result import MatchResult
from skyline.photo.noted_place import NOTHING_NOTED, NotedPlace
from skyline.photo.skyline import Lens, PhotoSkyline


def skyline_of(noted=NOTHING_NOTED, lens=None):
    return PhotoSkyline(np.full(40, 12.0), np.ones(40), 40, 30, 60.0, noted=noted, lens=lens)


BEST = replace(candidate_at(0.0, 0.0), lon=9.8, lat=46.7, heading_deg=131.0)


def noting(noted, refusal=None):
    """Return a result for a photo whose EXIF notes a place."""
    return MatchResult(skyline_of(noted=noted), (BEST,), 0.0, refusal)


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


def test_an_answer_is_printed_with_its_photo():
    lens = Lens(60.3, 5.0, reason="only EXIF's 35 mm equivalent gives it")
    sure = replace(BEST, confidence=0.93, confidence_1km=0.97, refined=True)
    result = MatchResult(skyline_of(lens=lens), (sure,), 1.5, None, 200.0, "a\nb.jpg")
    first, answer, _, place, *_, lens_line = result.to_text().splitlines()
    assert first == r"a\nb.jpg (1.50 s)"
    assert "candidate 1, right within 200 m" in answer
    assert "lat 46.70000 lon 9.80000" in place
    assert "60.3 degrees, give or take 5; only EXIF's 35 mm equivalent gives it" in lens_line


def test_a_candidate_without_a_confidence_is_printed_with_its_cost():
    unrated = replace(BEST, cost=0.00421, confidence=None)
    text = MatchResult(skyline_of(), (unrated,), 1.5, None).to_text()
    assert "cost 0.00421 (the lower" in text


REFUSED = MatchResult(skyline_of(), (), 1.5, "no place fits", name="c.jpg")


def test_a_refusal_is_printed_with_its_photo():
    assert REFUSED.to_text() == "c.jpg (1.50 s)\n  no answer: no place fits"
    assert replace(REFUSED, name="").to_text().startswith("photo (1.50 s)")


def test_a_refusal_is_a_record_without_an_answer():
    assert REFUSED.to_dict() == {
        "photo": "c.jpg",
        "projection": "perspective",
        "width_px": 40,
        "height_px": 30,
        "seconds": 1.5,
        "refusal": "no place fits",
        "answer": None,
        "answer_within_m": None,
        "answer_confidence": None,
        "candidates": [],
    }
