"""Results of matching as a table of GeoPandas (extra ``geo``)."""

from collections.abc import Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from skyline.extras import library
from skyline.matching.ranking import Candidate

if TYPE_CHECKING:
    from skyline.pipeline.results import MatchResult

_COVARIANCE = ("easting_variance_m2", "northing_variance_m2", "easting_northing_covariance_m2")
_FIELDS = (
    *(name for name in Candidate.__dataclass_fields__ if name != "covariance_m2"),
    *_COVARIANCE,
)


def to_geodataframe(results: Iterable["MatchResult"]) -> Any:
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
        {"query": query, "rank": rank, "is_answer": candidate is result.answer, **_row(candidate)}
        for query, result in enumerate(results)
        for rank, candidate in enumerate(result.candidates, start=1)
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
    for name in ("confidence", "confidence_1km"):
        row[name] = nan if row[name] is None else row[name]
    return row | dict(zip(_COVARIANCE, (east, north, both), strict=True))
