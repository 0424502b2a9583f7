"""Matches and places as files that other programs read.

Candidates are points, views and ellipses in degrees of WGS 84 as GeoJSON (RFC 7946); places, views,
and the photo standing in the landscape as KML 2.2 (OGC 07-147r2); and waypoints, which navigation
devices and hiking maps read, as GPX 1.1. The places of a store are a GeoPackage.
"""

import io
import json
import math
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.parse import quote
from xml.etree import ElementTree as Xml

import cv2
import numpy as np

from skyline.arrays import Float64Array, UInt8Array
from skyline.errors import printable, suffix_of
from skyline.files import write_whole, write_with_folders
from skyline.geodesy import Frame
from skyline.match.answer import MatchResult
from skyline.match.candidate import Candidate
from skyline.photo.query import Projection, QuerySkyline
from skyline.photo.read import read_picture
from skyline.report.shapes import Ellipse, lonlat_rings, view_wedge_m
from skyline.store import Store

VIEW_REACH_M = 2000.0
"""Radius of the wedge drawn for a view; a camera sees farther, but longer wedges would overlap."""

_DECIMALS = 7
"""Decimals of degrees in files: a centimetre on the ground."""
_KML, _GPX = "http://www.opengis.net/kml/2.2", "http://www.topografix.com/GPX/1/1"
_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 90]
_OVERLAY = """<PhotoOverlay><name/><Camera>
<longitude>{at.lon:.7f}</longitude><latitude>{at.lat:.7f}</latitude>
<altitude>{at.eye_elevation_m:.2f}</altitude><heading>{at.heading_deg:.3f}</heading>
<tilt>{tilt_deg:.3f}</tilt><roll>{roll_deg:.3f}</roll><altitudeMode>absolute</altitudeMode>
</Camera><Icon><href/></Icon><ViewVolume><leftFov>-{side_deg:.3f}</leftFov>
<rightFov>{side_deg:.3f}</rightFov><bottomFov>-{up_deg:.3f}</bottomFov><topFov>{up_deg:.3f}</topFov>
<near>300</near></ViewVolume>
<Point><coordinates>{at.lon:.7f},{at.lat:.7f},{at.eye_elevation_m:.2f}</coordinates></Point>
<shape>rectangle</shape></PhotoOverlay>"""
"""A photo that stands 300 m before the camera; its name and address are set as texts."""
Json = dict[str, object]
Photos = Sequence[UInt8Array | None]


def _geojson(results: Sequence[MatchResult], frame: Frame) -> str:
    """Return the candidates of results as a FeatureCollection.

    Each is a Point with the properties of the public JSON, a Polygon of the view out to 2 km, and
    where its covariance is known one of the ellipse; ``shape`` is ``candidate``, ``view`` or
    ``ellipse95``.
    """
    features = [
        feature
        for one in results
        for candidate in one.candidates
        for feature in _features(printable(one.name), candidate, frame)
    ]
    collection = {"type": "FeatureCollection", "features": features}
    return json.dumps(collection, indent=1, allow_nan=False) + "\n"


def _features(query: str, candidate: Candidate, frame: Frame) -> list[Json]:
    """Return the point, the view and the ellipse of a candidate as GeoJSON features."""
    record: Json = {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in candidate.to_dict().items()
    }
    of_pose: Json = {"rank": candidate.rank, "origin": candidate.origin}
    place = [round(candidate.lon, _DECIMALS), round(candidate.lat, _DECIMALS)]
    point: Json = {"type": "Point", "coordinates": place}
    wedge = _polygon(view_wedge_m(candidate, VIEW_REACH_M), frame)
    shapes: list[tuple[str, Json, Json]] = [
        ("candidate", point, record),
        ("view", wedge, {"reach_m": VIEW_REACH_M}),
    ]
    ellipse = Ellipse.of(candidate)
    if ellipse is not None:
        axes: Json = {"semi_major_m": ellipse.semi_major_m, "semi_minor_m": ellipse.semi_minor_m}
        shapes.append(("ellipse95", _polygon(ellipse.outline_m, frame), axes))
    return [
        {
            "type": "Feature",
            "geometry": geometry,
            "properties": {"query": query, **of_pose, "shape": shape, **about},
        }
        for shape, geometry, about in shapes
    ]


def _polygon(outline_m: Float64Array, frame: Frame) -> Json:
    """Return an outline as a Polygon, or as a MultiPolygon where the antimeridian cuts it."""
    rings = _rings(outline_m, frame)
    if len(rings) == 1:
        return {"type": "Polygon", "coordinates": rings}
    return {"type": "MultiPolygon", "coordinates": [[ring] for ring in rings]}


def _rings(outline_m: Float64Array, frame: Frame) -> list[list[list[float]]]:
    """Return the rings of an outline (P, 2), metres, in degrees to a centimetre."""
    return [np.round(ring, _DECIMALS).tolist() for ring in lonlat_rings(outline_m, frame)]


def _kml(results: Sequence[MatchResult], frame: Frame, hrefs: Sequence[str | None]) -> bytes:
    """Return results as KML, with a PhotoOverlay of each photo whose address is given.

    Each candidate is a place and a view of 2 km; the first of each photo has the PhotoOverlay.
    """
    root = Xml.Element("kml", xmlns=_KML)
    folder = _child(root, "Document")
    _child(folder, "name", "Where the photos were taken")
    for result, href in zip(results, hrefs, strict=True):
        name = Path(result.name).name
        for candidate in result.candidates:
            _add_candidate(folder, name, candidate, frame)
        is_flat = result.query.projection is Projection.PERSPECTIVE
        if href is not None and result.candidates and is_flat:
            _add_photo(folder, name, result.query, result.candidates[0], href)
    return bytes(Xml.tostring(root, encoding="utf-8", xml_declaration=True))


def _linked_kml(
    path: Path, results: Sequence[MatchResult], frame: Frame, photos: Photos | None
) -> bytes:
    """Return KML that links to photos: by the path from its folder to the file (RFC 3986, 4.2).

    If ``photos`` are given, the address is the file's name: the file should lie beside the KML.
    """
    hrefs: list[str | None] = []
    for photo in (Path(one.name) for one in results):
        href = photo.name
        if photos is None:
            # A link among the folders would lead `..` to another folder.
            href = os.path.relpath(photo.parent.resolve() / photo.name, path.parent.resolve())
        has_picture = photo.name and photo.suffix.lower() != ".csv"
        hrefs.append(quote(os.fsencode(href)) if has_picture else None)
    return _kml(results, frame, hrefs)


def _kmz(results: Sequence[MatchResult], frame: Frame, photos: Photos | None) -> bytes:
    """Return KML and its photos as a KMZ; photos that are not given are read from their files."""
    if photos is None:
        photos = [read_picture(one.name) if one.name else None for one in results]
    pictures = {f"files/{n:02d}.jpg": photo for n, photo in enumerate(photos, start=1)}
    hrefs = [None if photo is None else href for href, photo in pictures.items()]
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("doc.kml", _kml(results, frame, hrefs), zipfile.ZIP_DEFLATED)
        for href, photo in pictures.items():
            if photo is not None:
                jpeg = cv2.imencode(".jpg", photo[..., ::-1], _QUALITY)[1].tobytes()
                archive.writestr(href, jpeg)
    return file.getvalue()


def _add_candidate(folder: Xml.Element, name: str, candidate: Candidate, frame: Frame) -> None:
    mark = _child(folder, "Placemark")
    _child(mark, "name", f"{name}: {candidate.name}")
    _child(mark, "description", _described(candidate))
    shapes = _child(mark, "MultiGeometry")
    place = f"{candidate.lon:.7f},{candidate.lat:.7f},{candidate.eye_elevation_m:.2f}"
    _child(_child(shapes, "Point"), "coordinates", place)
    for outline in _rings(view_wedge_m(candidate, VIEW_REACH_M), frame):
        ring = _child(_child(_child(shapes, "Polygon"), "outerBoundaryIs"), "LinearRing")
        _child(ring, "coordinates", " ".join(f"{lon},{lat}" for lon, lat in outline))


def _add_photo(
    folder: Xml.Element, name: str, query: QuerySkyline, candidate: Candidate, href: str
) -> None:
    """Add a PhotoOverlay: the photo standing before the camera at a candidate."""
    side_deg = candidate.fov_deg / 2.0
    up = math.tan(math.radians(side_deg)) * query.height_px / query.width_px
    # A tilt counts from straight down, a roll counter-clockwise as seen from behind.
    angles = {"tilt_deg": 90.0 + candidate.pitch_deg, "roll_deg": -candidate.roll_deg}
    up_deg = math.degrees(math.atan(up))
    text = _OVERLAY.format(at=candidate, side_deg=side_deg, up_deg=up_deg, **angles)
    overlay = Xml.fromstring(text)
    overlay[0].text, overlay[2][0].text = printable(name), href
    folder.append(overlay)


def _described(candidate: Candidate) -> str:
    """Return in words the origin of a pose, the attitude of its camera and its confidence."""
    sure = "" if candidate.confidence is None else f"; confidence {candidate.confidence:.2f}"
    return (
        f"{candidate.origin.capitalize()}. Heading {candidate.heading_deg:.1f}° from true north, "
        f"pitch {candidate.pitch_deg:.1f}°, "
        f"roll {candidate.roll_deg:.1f}°, field of view {candidate.fov_deg:.1f}°, eye "
        f"{candidate.eye_elevation_m:.0f} m above the datum{sure}"
    )


def _gpx(results: Sequence[MatchResult]) -> bytes:
    """Return the candidates of results as waypoints."""
    root = Xml.Element("gpx", xmlns=_GPX, version="1.1", creator="skyline")
    for result in results:
        name = Path(result.name).name
        for candidate in result.candidates:
            place = {"lat": f"{candidate.lat:.7f}", "lon": f"{candidate.lon:.7f}"}
            point = _child(root, "wpt", **place)
            _child(point, "ele", f"{candidate.eye_elevation_m:.1f}")
            _child(point, "name", f"{name}: {candidate.name}")
            _child(point, "desc", _described(candidate))
    return bytes(Xml.tostring(root, encoding="utf-8", xml_declaration=True))


def _child(parent: Xml.Element, tag: str, text: str = "", **attributes: str) -> Xml.Element:
    element = Xml.SubElement(parent, tag, attributes)
    if text:
        element.text = printable(text)
    return element


EXPORTS: Mapping[
    str, Callable[[Path, Sequence[MatchResult], Frame, Photos | None], str | bytes]
] = {
    ".geojson": lambda _, results, frame, __: _geojson(results, frame),
    ".kml": _linked_kml,
    ".kmz": lambda _, results, frame, photos: _kmz(results, frame, photos),
    ".gpx": lambda _, results, *__: _gpx(results),
}
"""The function that returns the content of a file of each suffix."""


def export_matches(
    path: str | Path,
    results: Sequence[MatchResult],
    frame: Frame,
    photos: Photos | None = None,
) -> None:
    """Write the candidates of results by the suffix: GeoJSON, KML, KMZ or GPX.

    Parameters
    ----------
    path : str or Path
        Missing folders are made.
    results : sequence of MatchResult
        Each is named after its photo's file.
    frame : Frame
        Frame of the candidates: `Matcher.frame`.
    photos : sequence of (H, W, 3) uint8 or None, optional
        RGB of each result's photo, which a KMZ holds. By default the photos are read from the files
        that the results are named after.

    Raises
    ------
    InputError
        The suffix is not known, a photo cannot be read, or the file cannot be written.
    """
    path = Path(path)
    content = EXPORTS[suffix_of(path, EXPORTS)](path, results, frame, photos)
    write_with_folders(path, content)


def write_geopackage(store: Store, path: Path) -> int:
    """Write the places of a store as points, with spacing and tolerance; return their number.

    Raises `InputError` for a store of renderings, for a path that cannot be written or does not end
    in ``.gpkg``, and without GeoPandas; `StoreError` for damaged data.
    """
    suffix_of(path, [".gpkg"])
    table = store.to_geodataframe()
    # The file is made in memory: SQLite needs file locks, which some network folders lack.
    held = io.BytesIO()
    table.to_file(held, layer="places", driver="GPKG")
    write_whole(path, held.getvalue())
    return len(table)
