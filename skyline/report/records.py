"""A match in the terms of the public JSON."""

from collections.abc import Iterable
from typing import NotRequired, TypedDict

from skyline.geodesy import Frame
from skyline.matching.ranking import Candidate


class CandidateRecord(TypedDict):
    """One candidate as ``skyline match --json`` prints it; the heading is from true north."""

    easting: float
    northing: float
    lon: float
    lat: float
    heading_deg: float
    pitch_deg: float
    roll_deg: float
    fov_deg: float
    score: float
    confidence: float | None
    refined: bool


class MatchRecord(TypedDict):
    """One query as ``skyline match --json`` prints it; without an answer it says why."""

    query: str
    answer: CandidateRecord | None
    candidates: list[CandidateRecord]
    seconds: float
    refusal: NotRequired[str]


def describe_candidates(candidates: Iterable[Candidate], frame: Frame) -> list[CandidateRecord]:
    """Return candidates in the public JSON's terms."""
    return [describe_candidate(candidate, frame) for candidate in candidates]


def describe_candidate(candidate: Candidate, frame: Frame) -> CandidateRecord:
    """Return one candidate in the public JSON's terms."""
    place = candidate.easting_m, candidate.northing_m
    lon, lat = frame.to_lonlat(*place)
    return CandidateRecord(
        easting=candidate.easting_m,
        northing=candidate.northing_m,
        lon=float(lon),
        lat=float(lat),
        heading_deg=float((candidate.heading_deg + frame.convergence_deg(*place)) % 360.0),
        pitch_deg=candidate.pitch_deg,
        roll_deg=candidate.roll_deg,
        fov_deg=candidate.fov_deg,
        score=candidate.score,
        confidence=candidate.confidence,
        refined=candidate.refined,
    )
