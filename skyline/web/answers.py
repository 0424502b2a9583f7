"""Poses and results in JSON, as the page has them."""

from typing import Any

from skyline import MatchResult, Pose
from skyline.web.engine import Engine

POSE = {
    "lon": "lon", "lat": "lat", "heading": "heading_deg", "pitch": "pitch_deg", "roll": "roll_deg",
    "fov": "fov_deg",
}  # fmt: skip
"""The numbers of a pose: their names on the page and in Skyline."""


def outcome_json(result: MatchResult, engine: Engine) -> dict[str, Any]:
    """Return the candidates and the verdict of a search or fit."""
    lens = "" if result.skyline.lens is None else result.skyline.lens.in_words
    return {
        "candidates": [candidate_json(one, engine) for one in result.candidates],
        "answered": result.answer is not None,
        "within": result.within_m,
        "confidence": result.confidence,
        "refusal": result.refusal,
        "notes": [note for note in (result.exif_in_words(), lens, result.beyond) if note],
        "seconds": result.seconds,
    }


def candidate_json(candidate: Pose, engine: Engine) -> dict[str, Any]:
    """Return a candidate; `POSE` has the names of its numbers."""
    return {name: getattr(candidate, field) for name, field in POSE.items()} | {
        "distortion": candidate.distortion,
        "wander": candidate.wander,
        "rank": candidate.rank,
        "elevation": candidate.eye_elevation_m,
        "eyeHeight": engine.eye_height_m(candidate),
        "confidence": candidate.confidence,
        "refined": candidate.refined,
        "covariance": candidate.covariance_m2,
        "convergence": candidate.convergence_deg,
        "residual": candidate.residual_in_words,
    }
