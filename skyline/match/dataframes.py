"""Results as tables of pandas and GeoPandas, which are loaded when they are asked for."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from skyline.errors import library
from skyline.match.candidate import Candidate

if TYPE_CHECKING:
    from skyline.match.answer import MatchResult
    from skyline.match.orient import Orientation

_COVARIANCE = ("easting_variance_m2", "northing_variance_m2", "easting_northing_covariance_m2")


def as_table(rows: Iterable[Mapping[str, Any]]) -> Any:
    """Return rows as a pandas DataFrame; `InputError` where pandas is not installed."""
    return library("pandas", "a DataFrame").DataFrame(list(rows))


def to_dataframe(results: "Iterable[MatchResult | Orientation]") -> Any:
    """Return results as a table, one row each.

    Returns
    -------
    pandas.DataFrame
        The columns of ``skyline match --results`` or of ``skyline orient --csv``: the photo, the
        best pose, its confidence, and the reason where there is no answer.

    Raises
    ------
    InputError
        Pandas is not installed.
    """
    return as_table(one.to_row() for one in results)


def to_geodataframe(results: "Iterable[MatchResult]") -> Any:
    """Return the candidates of results as points, one row each.

    Returns
    -------
    geopandas.GeoDataFrame
        Points in EPSG:4326, with ``query`` (the result's number, from 0), ``rank`` (1 is the
        best), ``is_answer`` (whether it is the answer) and the fields of `Candidate`; of the
        covariance three columns, which files can hold. Unknown values are missing.

    Raises
    ------
    InputError
        GeoPandas is not installed.
    """
    geopandas = library("geopandas", "a GeoDataFrame")
    names = [n for n in Candidate.__dataclass_fields__ if n not in {"covariance_m2", "rank"}]
    columns: dict[str, list[Any]] = {
        name: [] for name in ("query", "rank", "is_answer", *names, *_COVARIANCE)
    }
    for number, result in enumerate(results):
        for one in result.candidates:
            (east, both), (_, north) = one.covariance_m2 or ((None, None), (None, None))
            row = asdict(one) | dict(zip(_COVARIANCE, (east, north, both), strict=True))
            row |= {"query": number, "is_answer": one is result.answer}
            for name, values in columns.items():
                values.append(math.nan if row[name] is None else row[name])
    places = geopandas.points_from_xy(columns["lon"], columns["lat"])
    return geopandas.GeoDataFrame(columns, geometry=places, crs="EPSG:4326")
