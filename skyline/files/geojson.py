"""GeoJSON (RFC 7946): suffixes, features, and the decimals of degrees."""

from collections.abc import Mapping, Sequence
from typing import Any

Json = dict[str, Any]
GEOJSON = (".geojson", ".json")
"""Suffixes of GeoJSON."""
DEGREE_DECIMALS = 7
"""Decimals of degrees in files: a centimetre on the ground."""


def feature(kind: str, coordinates: Sequence[Any], properties: Mapping[str, Any]) -> Json:
    """Return a feature of a kind of geometry."""
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def collection(features: Sequence[Json], **members: Any) -> Json:
    """Return a collection of features, with further members."""
    return {"type": "FeatureCollection", **members, "features": features}
