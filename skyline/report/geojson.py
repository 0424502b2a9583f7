"""Candidates as GeoJSON (RFC 7946): points, views and ellipses in degrees of WGS 84."""

import json
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyline.files import write_with_folders
from skyline.geodesy import Frame
from skyline.matching.ranking import Candidate
from skyline.report.matched import Matched
from skyline.report.records import describe_candidate
from skyline.report.shapes import Ellipse, view_wedge_m

VIEW_REACH_M = 2000.0
"""How far a view's wedge reaches; views see farther, but a map is for telling them apart."""

_DECIMALS = 7
"""A centimetre."""

Json = dict[str, object]


def match_collection(matches: Iterable[Matched], frame: Frame) -> Json:
    """Return the candidates of queries, whose frame is given, as a FeatureCollection.

    Returns
    -------
    dict
        Per candidate a Point whose properties are those of the public JSON with
        ``query``, ``rank`` and ``shape`` = ``candidate``; a Polygon with ``shape`` = ``view``, the
        field of view out to 2 km; and where its covariance is known one with ``shape`` =
        ``ellipse95``, ``semi_major_m`` and ``semi_minor_m``.
    """
    features = [
        feature
        for one in matches
        for rank, candidate in enumerate(one.candidates, start=1)
        for feature in _features(one.name, rank, candidate, frame)
    ]
    return {"type": "FeatureCollection", "features": features}


def write_geojson(path: Path, matches: Iterable[Matched], frame: Frame) -> None:
    """Write `match_collection` to a file; raises `InputError` where it cannot be written."""
    text = json.dumps(match_collection(matches, frame), indent=1, allow_nan=False)
    write_with_folders(path, text + "\n")


def _features(query: str, rank: int, candidate: Candidate, frame: Frame) -> list[Json]:
    about: Json = {"query": query, "rank": rank}
    record = {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in describe_candidate(candidate).items()
    }
    place = [round(candidate.lon, _DECIMALS), round(candidate.lat, _DECIMALS)]
    point: Json = {"type": "Point", "coordinates": place}
    wedge = _polygon(view_wedge_m(candidate, VIEW_REACH_M), frame)
    features = [
        _feature(point, {**about, "shape": "candidate", **record}),
        _feature(wedge, {**about, "shape": "view", "reach_m": VIEW_REACH_M}),
    ]
    ellipse = Ellipse.of(candidate)
    if ellipse is not None:
        axes = {"semi_major_m": ellipse.semi_major_m, "semi_minor_m": ellipse.semi_minor_m}
        outline = _polygon(ellipse.outline_m(), frame)
        features.append(_feature(outline, {**about, "shape": "ellipse95", **axes}))
    return features


def _feature(geometry: Json, properties: Json) -> Json:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _polygon(outline_m: NDArray[np.float64], frame: Frame) -> Json:
    return {"type": "Polygon", "coordinates": [lonlat_of(outline_m, frame)]}


def lonlat_of(places_m: NDArray[np.float64], frame: Frame) -> list[list[float]]:
    """Return longitudes and latitudes to a centimetre of places (P, 2), metres."""
    lon, lat = frame.to_lonlat(places_m[:, 0], places_m[:, 1])
    degrees = np.round(np.stack([lon, lat], axis=1), _DECIMALS)
    pairs: list[list[float]] = degrees.tolist()
    return pairs
