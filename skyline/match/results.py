"""What matching gives back, also as a table of GeoPandas (extra ``geo``)."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from html import escape
from typing import Any

import numpy as np

from skyline.errors import library
from skyline.match.ranking import Candidate
from skyline.match.records import beyond_in_words, claim_in_words, confidence_within
from skyline.photo.query import QuerySkyline

COLUMNS = {
    "latitude °": ("lat", ".5f"), "longitude °": ("lon", ".5f"),
    "heading °": ("heading_deg", ".2f"), "pitch °": ("pitch_deg", ".2f"),
    "roll °": ("roll_deg", ".2f"), "FOV °": ("fov_deg", ".2f"), "score": ("score", ".4f"),
    "confidence": ("confidence", ".2f"), "within 1 km": ("confidence_1km", ".2f"),
}  # fmt: skip
"""Columns of a table of candidates: the field of `Candidate`, and its format."""
_COVARIANCE = ("easting_variance_m2", "northing_variance_m2", "easting_northing_covariance_m2")
_FIELDS = (
    *(name for name in Candidate.__dataclass_fields__ if name not in {"covariance_m2", "rank"}),
    *_COVARIANCE,
)


@dataclass(frozen=True, slots=True)
class MatchResult:
    """What was found for one query.

    Attributes
    ----------
    query : QuerySkyline
        The skyline that was matched.
    candidates : tuple of Candidate
        Best first.
    seconds : float
        From the query to the candidates.
    refusal : str or None
        Why there is no answer, where there is none.
    within_m : float or None
        Distance within which the best candidate is sure to be right: 200 m, or 1 km where only
        that is sure. None without an answer, and for matchers without a confidence.
    """

    query: QuerySkyline
    candidates: tuple[Candidate, ...]
    seconds: float
    refusal: str | None = None
    within_m: float | None = None

    @property
    def answer(self) -> Candidate | None:
        """The best candidate, if the matcher stands by it."""
        return self.candidates[0] if self.candidates and not self.refusal else None

    @property
    def confidence(self) -> float | None:
        """The estimated chance that the answer is right within `within_m`; None without any."""
        return None if self.answer is None else confidence_within(self.answer, self.within_m)

    @property
    def claim(self) -> str:
        """Where the photo says that it was taken, against the best candidate; empty without."""
        best = next(iter(self.candidates), None)
        return claim_in_words(self.query.noted, best, self.answer is not None)

    @property
    def beyond(self) -> str | None:
        """How much of the skyline may be of terrain past the model's edge; None if little."""
        return beyond_in_words(self.candidates[0].beyond_share if self.candidates else None)

    def __repr__(self) -> str:
        return f"MatchResult({_in_short(self)}; candidates: {len(self.candidates)})"

    def _repr_html_(self) -> str:
        header = "".join(f"<th>{escape(name)}</th>" for name in ("#", *COLUMNS))
        rows = "".join(
            f"<tr><td>{one.rank}</td>{''.join(f'<td>{text}</td>' for text in columns_of(one))}</tr>"
            for one in self.candidates
        )
        table = f"<table><tr>{header}</tr>{rows}</table>" if rows else ""
        return f"<div><p>{escape(_in_short(self))}</p>{_skyline_svg(self.query)}{table}</div>"

    def to_geodataframe(self) -> Any:
        """Return the candidates as points of a GeoDataFrame; see `skyline.to_geodataframe`."""
        return to_geodataframe([self])


@dataclass(frozen=True, slots=True)
class JointResult:
    """What was found for several queries of one place.

    Attributes
    ----------
    results : tuple of MatchResult
        One for each query. The candidates of those that agree are the same places with the same
        confidences; each has its own camera there. A query that does not agree has no candidates,
        and its refusal says why.
    agrees : tuple of bool
        Whether each query was taken at the best place rather than anywhere else.
    seconds : float
        From the queries to the places.
    refusal : str or None
        Why there is no answer, where there is none.
    """

    results: tuple[MatchResult, ...]
    agrees: tuple[bool, ...]
    seconds: float
    refusal: str | None = None

    @property
    def places(self) -> tuple[Candidate, ...]:
        """The places, best first, with the camera of the first query that agrees."""
        of_agreeing = (one.candidates for one, is_of in self._each() if is_of)
        return next(of_agreeing, ())

    @property
    def answer(self) -> Candidate | None:
        """The best place, if the matcher stands by it; the camera as of `places`."""
        return self.places[0] if self.places and not self.refusal else None

    @property
    def within_m(self) -> float | None:
        """Distance within which the answer is sure to be right; None without an answer."""
        return next((one.within_m for one, is_of in self._each() if is_of), None)

    def __repr__(self) -> str:
        agree = f"{sum(self.agrees)} of {len(self.agrees)} photos agree"
        return f"JointResult({_in_short(self)}; {agree})"

    def to_geodataframe(self) -> Any:
        """Return the cameras as points of a GeoDataFrame; see `skyline.to_geodataframe`."""
        return to_geodataframe(self.results)

    def _each(self) -> Iterable[tuple[MatchResult, bool]]:
        return zip(self.results, self.agrees, strict=True)


def columns_of(candidate: Candidate) -> list[str]:
    """Return a candidate's `COLUMNS` as text; empty where a value is not known."""
    values = [(getattr(candidate, name), form) for name, form in COLUMNS.values()]
    return [
        "" if value is None or not math.isfinite(value) else format(value, form)
        for value, form in values
    ]


def _skyline_svg(query: QuerySkyline) -> str:
    runs = np.flatnonzero(np.diff(query.trusted, prepend=False, append=False)).reshape(-1, 2)
    lines = "".join(
        "M" + " ".join(f"{col},{query.row_px[col]:.1f}" for col in range(start, stop))
        for start, stop in runs.tolist()
    )
    size = f"{query.width_px} {query.height_px}"
    return (
        f'<svg viewBox="0 0 {size}" width="360" style="border: 1px solid; margin: 0.5em 0">'
        f'<path d="{lines}" fill="none" stroke="crimson" vector-effect="non-scaling-stroke"/></svg>'
    )


def _in_short(result: MatchResult | JointResult) -> str:
    best = result.answer
    if best is None:
        return f"no answer: {result.refusal or 'no place fits'}"
    said = f"latitude {best.lat:.5f}, longitude {best.lon:.5f}, heading {best.heading_deg:.1f}"
    if result.within_m is not None:
        said += f", right within {result.within_m:g} m"
    confidence = confidence_within(best, result.within_m)
    return said if confidence is None else f"{said}, confidence {confidence:.2f}"


def to_geodataframe(results: Iterable[MatchResult]) -> Any:
    """Return the candidates of results as points, one row each.

    Returns
    -------
    geopandas.GeoDataFrame
        Points in EPSG:4326, with ``query`` (the result's number, from 0), ``rank`` (1 is the
        best), ``is_answer`` (whether the matcher stands by it) and the fields of `Candidate`; of
        the covariance three columns, which files can hold. What is not known is missing.

    Raises
    ------
    InputError
        GeoPandas is not installed.
    """
    geopandas = library("geopandas", "geo", "a GeoDataFrame")
    rows = [
        {"query": query, "is_answer": candidate is result.answer, **_row(candidate)}
        for query, result in enumerate(results)
        for candidate in result.candidates
    ]
    names = ("query", "rank", "is_answer", *_FIELDS)
    columns = {name: [row[name] for row in rows] for name in names}
    places = geopandas.points_from_xy(columns["lon"], columns["lat"])
    return geopandas.GeoDataFrame(columns, geometry=places, crs="EPSG:4326")


def _row(candidate: Candidate) -> dict[str, object]:
    row = asdict(candidate)
    nan = float("nan")
    covariance_m2 = row.pop("covariance_m2") or ((nan, nan), (nan, nan))
    (east, both), (_, north) = covariance_m2
    for name, value in row.items():
        row[name] = nan if value is None else value
    return row | dict(zip(_COVARIANCE, (east, north, both), strict=True))
