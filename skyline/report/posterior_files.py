"""Posteriors as files: a GeoTIFF for one photo, or outlines for several."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError, printable, suffix_of
from skyline.files.disk import write_whole
from skyline.files.geojson import GEOJSON, Json, collection, feature
from skyline.geodesy.antimeridian import lonlat_rings
from skyline.match.posterior import SHARES, Posterior
from skyline.report.geotiff import GEOTIFFS, geotiff
from skyline.report.kml import add, add_polygon, kml_document, xml_bytes

POSTERIOR_FILES = (*GEOTIFFS, *GEOJSON, ".kml")
"""Suffixes of files of posteriors; a GeoTIFF holds one photo's."""
_DECIMALS = 6
"""Decimals of degrees in files: a tenth of a metre."""
_COLOURS = {0.5: "b03030e0", 0.8: "803080f0", 0.95: "5030d0f0"}
"""Colours of regions in KML: opacity, blue, green, red."""


def write_posteriors(
    paths: Sequence[str | Path], posteriors: Iterable[tuple[str, Posterior]]
) -> None:
    """Write the posteriors of photos to files of one or more kinds.

    Parameters
    ----------
    paths : sequence of path
        The suffix chooses the kind: GeoTIFF, the probability of each cell; GeoJSON or KML, the
        outlines of the smallest areas that hold 50, 80 and 95 % of the probability. Missing folders
        are made.
    posteriors : iterable of (str, Posterior)
        The file of each photo with its posterior. They may be made one by one: none is kept.

    Raises
    ------
    InputError
        A suffix is unknown, there are several photos for a GeoTIFF, or a file cannot be written.
    """
    kinds = {Path(path): suffix_of(path, POSTERIOR_FILES) for path in paths}
    rasters = [path for path, kind in kinds.items() if kind in GEOTIFFS]
    features: list[Json] = []
    for number, (photo, posterior) in enumerate(posteriors):
        if rasters and number:
            raise InputError(f"{rasters[0]} holds one photo; give one, or {GEOJSON[0]} or .kml")
        for path in rasters:
            write_whole(path, _geotiff(posterior))
        if len(rasters) < len(kinds):
            features += [_feature(printable(photo), posterior, share) for share in SHARES]
    for path, kind in kinds.items():
        if kind == ".kml":
            write_whole(path, _kml(features))
        elif kind in GEOJSON:
            write_whole(path, json.dumps(collection(features)) + "\n")


def _feature(photo: str, posterior: Posterior, share: float) -> Json:
    """Return the region of a share as a GeoJSON feature."""
    polygons = [
        polygon for rings in posterior.region(share) for polygon in _polygons(rings, posterior)
    ]
    area_km2 = round(posterior.area_km2(share), 6)
    about = {"photo": photo, "share": share, "area_km2": area_km2}
    return feature("MultiPolygon", polygons, about)


def _polygons(rings: Sequence[Float64Array], posterior: Posterior) -> list[list[list[list[float]]]]:
    """Return an outline with its holes as polygons, cut at the antimeridian."""
    outer, *holes = (
        [np.round(part, _DECIMALS) for part in lonlat_rings(ring, posterior.frame)]
        for ring in rings
    )
    polygons = [[part] for part in outer]
    for hole in (part for parts in holes for part in parts):
        middle = hole.mean(axis=0)
        for polygon in polygons:
            low, high = polygon[0].min(axis=0), polygon[0].max(axis=0)
            if ((low <= middle) & (middle <= high)).all():
                polygon.append(hole)
                break
    return [[ring.tolist() for ring in polygon] for polygon in polygons]


def _kml(features: Sequence[Json]) -> bytes:
    """Return regions as KML, the widest ones lowest."""
    root, document = kml_document()
    for share, colour in _COLOURS.items():
        style = add(document, "Style", id=f"held{share * 100:.0f}")
        for part in ("LineStyle", "PolyStyle"):
            add(add(style, part), "color", colour)
    for one in sorted(features, key=lambda region: -region["properties"]["share"]):
        about = one["properties"]
        percent = f"{about['share'] * 100:.0f}"
        mark = add(document, "Placemark")
        add(mark, "name", f"{Path(about['photo']).name}: {percent} %")
        text = f"Taken in this area with a probability of {percent} %; {about['area_km2']:.3g} km²"
        add(mark, "description", text)
        add(mark, "styleUrl", f"#held{percent}")
        shapes = add(mark, "MultiGeometry")
        for rings in one["geometry"]["coordinates"]:
            add_polygon(shapes, rings)
    return xml_bytes(root)


def _geotiff(posterior: Posterior) -> bytes:
    """Return the probability of each cell as a GeoTIFF."""
    return geotiff(
        posterior.probability[np.newaxis],
        posterior.grid,
        posterior.frame,
        names=["probability of the cell"],
        predictor="yes",
    )
