"""Candidates as KML 2.2 (OGC 07-147r2): places, views, and the photo standing in the landscape."""

import io
import math
import re
import zipfile
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as Xml

import cv2

from skyline.arrays import UInt8Array
from skyline.files import write_with_folders
from skyline.geodesy import Frame
from skyline.matching.ranking import Candidate
from skyline.photo.projection import Projection
from skyline.photo.query import QuerySkyline
from skyline.report.geojson import VIEW_REACH_M, lonlat_of
from skyline.report.matched import Matched
from skyline.report.shapes import view_wedge_m

_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What XML 1.0 has no way to say."""
_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 90]
_NAMESPACE = "http://www.opengis.net/kml/2.2"
_PHOTO_AT_M = 300.0
"""How far before the camera the photo stands."""


def write_kml(path: Path, matches: Sequence[Matched], frame: Frame) -> None:
    """Write matches as KML, or with their photos in it as KMZ where that is the file's suffix.

    Each candidate is a place and a view of 2 km. The best of each query has a PhotoOverlay, whose
    picture is the photo's file beside the KML, or the photo in the KMZ.

    Raises `InputError` where the file cannot be written.
    """
    packed = path.suffix.lower() == ".kmz"
    pictures: dict[str, UInt8Array] = {}
    root = document("kml", _NAMESPACE)
    folder = child(root, "Document")
    child(folder, "name", "Where these were taken")
    for number, matched in enumerate(matches, start=1):
        href = Path(matched.name).name
        if packed and matched.photo is not None:
            href = f"files/{number:02d}.jpg"
            pictures[href] = matched.photo
        _add(folder, matched, frame, href)
    text = Xml.tostring(root, encoding="utf-8", xml_declaration=True)
    write_with_folders(path, _packed(text, pictures) if packed else text)


def _packed(kml: bytes, pictures: dict[str, UInt8Array]) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        archive.writestr("doc.kml", kml, zipfile.ZIP_DEFLATED)
        for name, picture in pictures.items():
            archive.writestr(name, cv2.imencode(".jpg", picture[..., ::-1], _QUALITY)[1].tobytes())
    return held.getvalue()


def _add(folder: Xml.Element, matched: Matched, frame: Frame, href: str) -> None:
    name = Path(matched.name).name
    for rank, candidate in enumerate(matched.candidates, start=1):
        mark = child(folder, "Placemark")
        child(mark, "name", f"{name}: candidate {rank}")
        child(mark, "description", described(candidate))
        shapes = child(mark, "MultiGeometry")
        _add_point(shapes, candidate)
        ring = child(child(child(shapes, "Polygon"), "outerBoundaryIs"), "LinearRing")
        outline = lonlat_of(view_wedge_m(candidate, VIEW_REACH_M), frame)
        child(ring, "coordinates", " ".join(f"{lon},{lat}" for lon, lat in outline))
    if matched.candidates and matched.query.projection is Projection.PERSPECTIVE:
        _add_photo(folder, name, matched.query, matched.candidates[0], href)


def _add_photo(
    folder: Xml.Element, name: str, query: QuerySkyline, candidate: Candidate, href: str
) -> None:
    overlay = child(folder, "PhotoOverlay")
    child(overlay, "name", name)
    camera = child(overlay, "Camera")
    half = math.radians(candidate.fov_deg) / 2.0
    up_deg = math.degrees(math.atan(math.tan(half) * query.height_px / query.width_px))
    for tag, value in (
        ("longitude", f"{candidate.lon:.7f}"),
        ("latitude", f"{candidate.lat:.7f}"),
        ("altitude", f"{candidate.eye_elevation_m:.2f}"),
        ("heading", f"{candidate.heading_deg:.3f}"),
        # A tilt counts from straight down, a roll counter-clockwise as seen from behind.
        ("tilt", f"{90.0 + candidate.pitch_deg:.3f}"),
        ("roll", f"{-candidate.roll_deg:.3f}"),
        ("altitudeMode", "absolute"),
    ):
        child(camera, tag, value)
    child(child(overlay, "Icon"), "href", href)
    volume = child(overlay, "ViewVolume")
    side_deg = candidate.fov_deg / 2.0
    for tag, degrees in (
        ("leftFov", -side_deg),
        ("rightFov", side_deg),
        ("bottomFov", -up_deg),
        ("topFov", up_deg),
    ):
        child(volume, tag, f"{degrees:.3f}")
    child(volume, "near", f"{_PHOTO_AT_M:g}")
    _add_point(overlay, candidate)
    child(overlay, "shape", "rectangle")


def _add_point(parent: Xml.Element, candidate: Candidate) -> None:
    place = f"{candidate.lon:.7f},{candidate.lat:.7f},{candidate.eye_elevation_m:.2f}"
    child(child(parent, "Point"), "coordinates", place)


def described(candidate: Candidate) -> str:
    """Return how a candidate's camera stood and how sure it is, in words."""
    sure = "" if candidate.confidence is None else f"; confidence {candidate.confidence:.2f}"
    return (
        f"Heading {candidate.heading_deg:.1f}° from true north, pitch {candidate.pitch_deg:.1f}°, "
        f"roll {candidate.roll_deg:.1f}°, field of view {candidate.fov_deg:.1f}°, eye "
        f"{candidate.eye_elevation_m:.0f} m above the datum{sure}"
    )


def document(tag: str, namespace: str, **attributes: str) -> Xml.Element:
    """Return the root of a document, all of whose elements are of one namespace."""
    return Xml.Element(tag, {"xmlns": namespace, **attributes})


def child(parent: Xml.Element, tag: str, text: str = "", **attributes: str) -> Xml.Element:
    """Return a new last child of an element."""
    element = Xml.SubElement(parent, tag, attributes)
    if text:
        element.text = _NOT_XML.sub("\ufffd", text)
    return element
