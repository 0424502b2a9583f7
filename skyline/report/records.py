"""A match in the terms of the public JSON."""

from collections.abc import Iterable
from typing import NotRequired, TypedDict, cast

from skyline.matching.confidence import DISTANCES_M
from skyline.matching.ranking import Candidate
from skyline.report.claims import ExifRecord


class CandidateRecord(TypedDict):
    """One `Candidate` as ``skyline match --json`` prints it; the heading is from true north."""

    easting_m: float
    northing_m: float
    lon: float
    lat: float
    eye_elevation_m: float
    radius_m: float | None
    heading_deg: float
    pitch_deg: float
    roll_deg: float
    fov_deg: float
    distortion: float
    score: float
    confidence: float | None
    confidence_1km: float | None
    refined: bool
    beyond_share: float | None


class LensRecord(TypedDict):
    """What a photo's EXIF says of its field of view, and why that was believed or not."""

    fov_deg: float | None
    sd_deg: float | None
    most_deg: float | None
    said: str


class MatchRecord(TypedDict):
    """One query as ``skyline match --json`` prints it; without an answer it says why.

    ``seconds`` count from the file to the candidates, ``loading_seconds`` opened the store and its
    elevation model, once for all queries. ``answer_within_m`` is how near the answer is sure to be,
    200 or 1000. ``exif`` is there where the photo notes a place or a
    direction, ``lens`` where it notes a lens and no field of view was given.
    """

    query: str
    answer: CandidateRecord | None
    answer_within_m: float | None
    candidates: list[CandidateRecord]
    seconds: float
    loading_seconds: float
    refusal: NotRequired[str]
    exif: NotRequired[ExifRecord]
    lens: NotRequired[LensRecord]


class FailureRecord(TypedDict):
    """One query that cannot be matched as ``skyline match --json`` prints it."""

    query: str
    error: str


def confidence_within(candidate: Candidate, within_m: float | None) -> float | None:
    """Return how likely a candidate is right within a distance, one of `DISTANCES_M` or None."""
    return candidate.confidence_1km if within_m == DISTANCES_M[1] else candidate.confidence


def describe_candidates(candidates: Iterable[Candidate]) -> list[CandidateRecord]:
    """Return candidates in the public JSON's terms."""
    return [describe_candidate(candidate) for candidate in candidates]


def describe_candidate(candidate: Candidate) -> CandidateRecord:
    """Return one candidate in the public JSON's terms."""
    names = CandidateRecord.__annotations__
    return cast(CandidateRecord, {name: getattr(candidate, name) for name in names})
