"""What was found, as the page takes it."""

from collections.abc import Callable
from typing import Any

from skyline import Candidate, MatchResult, Stroke

Ground = Callable[[float, float], float | None]
"""Returns the ground's height at a longitude and a latitude; None where it is not known."""


def outcome(result: MatchResult, ground: Ground) -> dict[str, Any]:
    """Return a result as the page shows it."""
    return {
        "candidates": [candidate_json(one, ground) for one in result.candidates],
        "answered": result.answer is not None,
        "within": result.within_m,
        "chance": result.confidence,
        "refusal": result.refusal,
        "claim": result.claim,
        "beyond": result.beyond,
        "seconds": result.seconds,
    }


def candidate_json(candidate: Candidate, ground: Ground) -> dict[str, Any]:
    """Return a candidate as the page takes it."""
    ground_m = ground(candidate.lon, candidate.lat)
    above_m = None if ground_m is None else max(0.0, candidate.eye_elevation_m - ground_m)
    return {
        "lon": candidate.lon,
        "lat": candidate.lat,
        "heading": candidate.heading_deg,
        "pitch": candidate.pitch_deg,
        "roll": candidate.roll_deg,
        "fov": candidate.fov_deg,
        "distortion": candidate.distortion,
        "elevation": candidate.eye_elevation_m,
        "eyeHeight": above_m,
        "confidence": candidate.confidence,
        "refined": candidate.refined,
        "covariance": candidate.covariance_m2,
        "convergence": candidate.convergence_deg,
    }


def stroke_json(stroke: Stroke) -> dict[str, Any]:
    """Return a stroke as the page sends it."""
    return {"kind": str(stroke.kind), "radius": stroke.radius_px, "points": stroke.points_px}
