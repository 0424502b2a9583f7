"""A match in the terms of the public JSON, and what is said of it in words."""

from collections.abc import Iterable
from typing import NotRequired, TypedDict, cast

from pyproj import Geod

from skyline.geodesy import in_turn
from skyline.match.confidence import DISTANCES_M
from skyline.match.ranking import Candidate
from skyline.photo.exif import NotedPlace

_WORTH_SAYING = 0.1
"""Part of a skyline below which nothing is said of terrain beyond the elevation model."""
_DISAGREES_M, _DISAGREES_ACCURACIES = 500.0, 5.0
_DISAGREES_DEG = 45.0
"""Farther off than phones usually are."""
_NORTH = {True: ", from magnetic north", False: "", None: ", from a north that it does not name"}
_WGS84 = Geod(ellps="WGS84")


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


class ExifRecord(TypedDict):
    """What a photo's EXIF says, and how far the best candidate is from it.

    ``heading_off_deg`` is how far the best candidate's heading is clockwise of the photo's;
    ``heading_is_magnetic`` is null where the photo does not say which north it counts from.
    ``left_aside`` says in words which GPS tags cannot be used, and why.
    """

    lon: float | None
    lat: float | None
    elevation_m: float | None
    accuracy_m: float | None
    heading_deg: float | None
    heading_is_magnetic: bool | None
    distance_m: float | None
    heading_off_deg: float | None
    left_aside: str


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
    200 or 1000. ``exif`` is there where the photo notes a place or a direction, ``lens`` where it
    notes a lens and no field of view was given.
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


def beyond_in_words(share: float | None) -> str | None:
    """Return that a share of the skyline may be of terrain the elevation model lacks.

    None where the share is not known, or small.
    """
    if share is None or share < _WORTH_SAYING:
        return None
    return (
        f"{100.0 * share:.0f} % of the skyline may be of terrain beyond the elevation model's "
        "edge; a model that reaches farther may give another answer"
    )


def name_of(candidate: Candidate) -> str:
    """Return a candidate's name among those of its photo, such as "candidate 2"."""
    if candidate.rank is not None:
        return f"candidate {candidate.rank}"
    return "the fitted pose" if candidate.refined else "the pose set by hand"


def pose_name(candidate: Candidate) -> str:
    """Return the name of the pose that a report shows: `name_of`, but for the best candidate's."""
    return "the best candidate" if candidate.rank == 1 else name_of(candidate)


def apart_in_words(candidate: Candidate) -> str:
    """Return how far the skylines of a fitted pose are apart; empty for a pose that is not."""
    if candidate.residual_deg is None or candidate.terrain_share is None:
        return ""
    return (
        f"the skylines are {candidate.residual_deg:.2f} degrees apart (rms) over "
        f"{100.0 * candidate.terrain_share:.0f} % of the skyline"
    )


def describe_claim(noted: NotedPlace, best: Candidate | None) -> ExifRecord | None:
    """Return what a photo notes against the best candidate; None where it notes nothing."""
    if noted == NotedPlace():
        return None
    lon, lat = noted.lonlat_deg or (None, None)
    distance_m = off_deg = None
    if best is not None and noted.lonlat_deg is not None:
        distance_m = float(_WGS84.inv(*noted.lonlat_deg, best.lon, best.lat)[2])
    if best is not None and noted.heading_deg is not None:
        off_deg = float(in_turn(best.heading_deg - noted.heading_deg))
    return ExifRecord(
        lon=lon,
        lat=lat,
        elevation_m=noted.elevation_m,
        accuracy_m=noted.accuracy_m,
        heading_deg=noted.heading_deg,
        heading_is_magnetic=noted.is_magnetic,
        distance_m=distance_m,
        heading_off_deg=off_deg,
        left_aside=noted.left_aside,
    )


def claim_in_words(
    noted: NotedPlace, best: Candidate | None, is_answer: bool, with_place: bool = True
) -> str:
    """Return what a photo notes against the best candidate, in sentences, or "" for nothing.

    ``is_answer`` is whether that candidate is the answer, ``with_place`` whether the sentences give
    the photo's own longitude and latitude.
    """
    claim = describe_claim(noted, best)
    if claim is None:
        return ""
    said: list[str] = []
    it = "the answer" if is_answer or best is None else name_of(best)
    if claim["lat"] is not None:
        where = f"lat {claim['lat']:.5f} lon {claim['lon']:.5f}" if with_place else "a place"
        sure = "" if claim["accuracy_m"] is None else f" (good to {claim['accuracy_m']:.0f} m)"
        off = "" if claim["distance_m"] is None else f", {_metres(claim['distance_m'])} from {it}"
        said.append(f"The photo says {where}{off}{sure}.")
    if claim["heading_deg"] is not None:
        north = _NORTH[claim["heading_is_magnetic"]]
        own = "" if best is None else f", {it} {best.heading_deg:.0f}"
        said.append(f"Its compass says {claim['heading_deg']:.0f} degrees{north}{own}.")
    far_m = max(_DISAGREES_M, _DISAGREES_ACCURACIES * (claim["accuracy_m"] or 0.0))
    wrong = ["position"] if (claim["distance_m"] or 0.0) > far_m else []
    if abs(claim["heading_off_deg"] or 0.0) > _DISAGREES_DEG:
        wrong.append("compass")
    if wrong:
        said.append(f"The photo's {' and '.join(wrong)} and {it} disagree: one of them is wrong.")
    return " ".join(filter(None, [*said, claim["left_aside"]]))


def _metres(distance_m: float) -> str:
    return f"{distance_m:.0f} m" if distance_m < 10_000.0 else f"{distance_m / 1000.0:,.0f} km"
