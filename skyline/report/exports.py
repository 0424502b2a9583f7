"""The candidates of matches as files that other programs read.

They are GeoJSON (RFC 7946): points, views and ellipses in degrees of WGS 84; KML 2.2 (OGC
07-147r2): points, views, and the photo standing in the landscape; and GPX 1.1: waypoints, which
navigation devices and hiking maps read.
"""

from __future__ import annotations

import io
import json
import math
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self
from urllib.parse import quote
from xml.etree import ElementTree as Xml

import cv2
import numpy as np

from skyline.arrays import Float64Array, UInt8Array
from skyline.camera.projection import Projection
from skyline.errors import InputError, printable, suffix_of
from skyline.files.disk import STANDARD, write_whole
from skyline.files.geojson import DEGREE_DECIMALS, Json, collection, feature
from skyline.geodesy.antimeridian import lonlat_rings
from skyline.geodesy.map_frame import Frame
from skyline.match.result import MatchResult, listed
from skyline.photo.read import read_picture
from skyline.photo.skyline import PhotoSkyline
from skyline.pose.outlines import Ellipse, view_wedge_m
from skyline.pose.pose import COLUMNS, Pose
from skyline.report.kml import add, add_polygon, kml_document, xml_bytes

VIEW_REACH_M = 2000.0
"""Radius of the wedge drawn for a view; a camera sees farther, but longer wedges would overlap."""

_OVERLAY = """<PhotoOverlay><name/><Camera>
<longitude>{mark.lon}</longitude><latitude>{mark.lat}</latitude>
<altitude>{pose.eye_elevation_m:.2f}</altitude><heading>{pose.heading_deg:.3f}</heading>
<tilt>{tilt_deg:.3f}</tilt><roll>{roll_deg:.3f}</roll><altitudeMode>absolute</altitudeMode>
</Camera><Icon><href/></Icon><ViewVolume><leftFov>-{side_deg:.3f}</leftFov>
<rightFov>{side_deg:.3f}</rightFov><bottomFov>-{up_deg:.3f}</bottomFov><topFov>{up_deg:.3f}</topFov>
<near>300</near></ViewVolume>
<Point><coordinates>{mark.coordinates}</coordinates></Point>
<shape>rectangle</shape></PhotoOverlay>"""
"""A photo that stands 300 m in front of the camera; its name and address are set as texts."""
Photos = Sequence[UInt8Array | None]


@dataclass(frozen=True, slots=True)
class _Placemark:
    """A pose with its texts for KML and GPX."""

    pose: Pose
    name: str
    """Its photo's file, and its name among the poses of the photo."""
    description: str
    """Its origin, attitude and confidence in words."""
    lon: str
    """Longitude, degrees."""
    lat: str
    """Latitude, degrees."""

    @classmethod
    def of(cls, photo: str, pose: Pose) -> Self:
        """Return the placemark of a photo's pose, with the photo's file."""
        confidence = dict(zip(COLUMNS, pose.cells(), strict=True))["confidence"]
        sure = f"; confidence {confidence}" if confidence else ""
        description = (
            f"{pose.origin.capitalize()}. Heading {pose.heading_deg:.1f}° from true north, "
            f"pitch {pose.pitch_deg:.1f}°, roll {pose.roll_deg:.1f}°, field of view "
            f"{pose.fov_deg:.1f}°, eye {pose.eye_elevation_m:.0f} m above the datum{sure}"
        )
        lon, lat = (f"{degrees:.{DEGREE_DECIMALS}f}" for degrees in (pose.lon, pose.lat))
        return cls(pose, f"{photo}: {pose.name}", description, lon, lat)

    @property
    def coordinates(self) -> str:
        """Longitude, latitude and elevation as KML writes them."""
        return f"{self.lon},{self.lat},{self.pose.eye_elevation_m:.2f}"


def _geojson(results: Sequence[MatchResult], frames: Sequence[Frame]) -> str:
    """Return the candidates of results as a FeatureCollection.

    Each is a Point with the properties of the public JSON, a Polygon of the view out to 2 km and,
    where its covariance is known, a Polygon of the ellipse. The property ``shape`` is
    ``candidate``, ``view`` or ``ellipse95``.
    """
    features = [
        found
        for one in results
        for candidate in one.candidates
        for found in _features(printable(one.name), candidate, frames[candidate.area])
    ]
    return json.dumps(collection(features), indent=1, allow_nan=False) + "\n"


def _features(photo: str, candidate: Pose, frame: Frame) -> list[Json]:
    """Return the GeoJSON features of a candidate: point, view and ellipse."""
    of_pose: Json = {"photo": photo, "rank": candidate.rank, "origin": candidate.origin}
    lonlat_deg = [round(candidate.lon, DEGREE_DECIMALS), round(candidate.lat, DEGREE_DECIMALS)]
    about = of_pose | {"shape": "candidate"} | candidate.to_dict()
    wedge = _polygon(view_wedge_m(candidate, VIEW_REACH_M), frame)
    shapes = [
        feature("Point", lonlat_deg, about),
        feature(*wedge, of_pose | {"shape": "view", "reach_m": VIEW_REACH_M}),
    ]
    ellipse = Ellipse.of(candidate)
    if ellipse is not None:
        axes = {"semi_major_m": ellipse.semi_major_m, "semi_minor_m": ellipse.semi_minor_m}
        outline = _polygon(ellipse.outline_m, frame)
        shapes.append(feature(*outline, of_pose | {"shape": "ellipse95"} | axes))
    return shapes


def _polygon(outline_m: Float64Array, frame: Frame) -> tuple[str, Sequence[object]]:
    """Return an outline as a Polygon, or a MultiPolygon across the antimeridian."""
    rings = _rings(outline_m, frame)
    if len(rings) == 1:
        return "Polygon", rings
    return "MultiPolygon", [[ring] for ring in rings]


def _rings(outline_m: Float64Array, frame: Frame) -> list[list[list[float]]]:
    """Return the rings in degrees of an outline (P, 2) in metres."""
    return [np.round(ring, DEGREE_DECIMALS).tolist() for ring in lonlat_rings(outline_m, frame)]


def _kml(
    results: Sequence[MatchResult], frames: Sequence[Frame], hrefs: Sequence[str | None]
) -> bytes:
    """Return results as KML; photos with an address stand in the landscape.

    Each candidate is a point and a view of 2 km. The first candidate of each photo has a
    PhotoOverlay, which shows the file at the photo's address.
    """
    root, folder = kml_document()
    add(folder, "name", "Where the photos were taken")
    for result, href in zip(results, hrefs, strict=True):
        name = Path(result.name).name
        marks = [_Placemark.of(name, one) for one in result.candidates]
        for mark in marks:
            _add_placemark(folder, mark, frames[mark.pose.area])
        is_flat = result.skyline.projection is Projection.PERSPECTIVE
        if href is not None and marks and is_flat:
            _add_photo(folder, name, result.skyline, marks[0], href)
    return xml_bytes(root)


def _linked_kml(
    path: Path, results: Sequence[MatchResult], frames: Sequence[Frame], photos: Photos | None
) -> bytes:
    """Return KML that links to the files of photos.

    A link is the path from the folder of the KML (RFC 3986, 4.2). If ``photos`` are given, it is
    the file's name: the file should lie beside the KML.
    """
    hrefs: list[str | None] = []
    for photo in (Path(one.name) for one in results):
        href = photo.name
        if photos is None:
            # Symbolic links are resolved first, since `..` would lead from a link's target.
            href = os.path.relpath(photo.parent.resolve() / photo.name, path.parent.resolve())
        has_picture = photo.name not in ("", STANDARD) and photo.suffix.lower() != ".csv"
        hrefs.append(quote(os.fsencode(href)) if has_picture else None)
    return _kml(results, frames, hrefs)


def _kmz(results: Sequence[MatchResult], frames: Sequence[Frame], photos: Photos | None) -> bytes:
    """Return KML and its photos as a KMZ.

    Photos that are not given are read from their files.
    """
    if photos is None:
        photos = [read_picture(one.name) if one.name else None for one in results]
    pictures = {f"files/{n:02d}.jpg": photo for n, photo in enumerate(photos, start=1)}
    hrefs = [None if photo is None else href for href, photo in pictures.items()]
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("doc.kml", _kml(results, frames, hrefs), zipfile.ZIP_DEFLATED)
        for href, photo in pictures.items():
            if photo is not None:
                quality = [cv2.IMWRITE_JPEG_QUALITY, 90]
                jpeg = cv2.imencode(".jpg", photo[..., ::-1], quality)[1].tobytes()
                archive.writestr(href, jpeg)
    return file.getvalue()


def _add_placemark(folder: Xml.Element, mark: _Placemark, frame: Frame) -> None:
    """Add a pose to KML, with its view."""
    element = add(folder, "Placemark")
    add(element, "name", mark.name)
    add(element, "description", mark.description)
    shapes = add(element, "MultiGeometry")
    add(add(shapes, "Point"), "coordinates", mark.coordinates)
    for outline in _rings(view_wedge_m(mark.pose, VIEW_REACH_M), frame):
        add_polygon(shapes, [outline])


def _add_photo(
    folder: Xml.Element, name: str, skyline: PhotoSkyline, mark: _Placemark, href: str
) -> None:
    """Add a PhotoOverlay to KML: the photo standing before the camera."""
    pose = mark.pose
    side_deg = pose.fov_deg / 2.0
    up = math.tan(math.radians(side_deg)) * skyline.height_px / skyline.width_px
    text = _OVERLAY.format(
        mark=mark,
        pose=pose,
        # A tilt counts from straight down, a roll counter-clockwise as seen from behind.
        tilt_deg=90.0 + pose.pitch_deg,
        roll_deg=-pose.roll_deg,
        side_deg=side_deg,
        up_deg=math.degrees(math.atan(up)),
    )
    overlay = Xml.fromstring(text)
    overlay[0].text = printable(name)
    overlay[2][0].text = href
    folder.append(overlay)


def _gpx(results: Sequence[MatchResult]) -> bytes:
    namespace = "http://www.topografix.com/GPX/1/1"
    root = Xml.Element("gpx", xmlns=namespace, version="1.1", creator="skyline")
    for result in results:
        for candidate in result.candidates:
            mark = _Placemark.of(Path(result.name).name, candidate)
            point = add(root, "wpt", lat=mark.lat, lon=mark.lon)
            add(point, "ele", f"{candidate.eye_elevation_m:.1f}")
            add(point, "name", mark.name)
            add(point, "desc", mark.description)
    return xml_bytes(root)


EXPORTS: Mapping[
    str, Callable[[Path, Sequence[MatchResult], Sequence[Frame], Photos | None], str | bytes]
] = {
    ".geojson": lambda _, results, frames, __: _geojson(results, frames),
    ".kml": _linked_kml,
    ".kmz": lambda _, results, frames, photos: _kmz(results, frames, photos),
    ".gpx": lambda _, results, *__: _gpx(results),
}
"""Functions that return the content of files, by the suffix of the file."""


def export_matches(
    path: str | Path,
    results: Sequence[MatchResult],
    frame: Frame | Sequence[Frame],
    photos: Photos | None = None,
) -> None:
    """Write the candidates of results as GeoJSON, KML, KMZ or GPX.

    Parameters
    ----------
    path : str or Path
        Its suffix chooses the format; missing folders are made.
    results : sequence of MatchResult
        Each is named after its photo's file.
    frame : Frame or sequence of Frame
        Frame of the candidates: `Matcher.frame`, or one for each of `Matcher.areas`.
    photos : sequence of (H, W, 3) uint8 or None, optional
        RGB of each result's photo, which a KMZ holds. By default the photos are read from the files
        that the results are named after.

    Raises
    ------
    InputError
        The suffix is unknown, a photo cannot be read or is missing, the frame belongs to another
        world than the Earth, or the file cannot be written.
    """
    path = Path(path)
    frames = [frame] if isinstance(frame, Frame) else frame
    elsewhere = next((one for one in frames if not one.is_of_earth), None)
    if elsewhere is not None:
        raise InputError(
            f"{path} would show places of another world ({elsewhere.name}) on the Earth; take the "
            "candidates from the results"
        )
    results = listed(results)
    if photos is not None and len(photos) != len(results):
        raise InputError(f"{len(photos)} photos are given for {len(results)} results")
    content = EXPORTS[suffix_of(path, EXPORTS)](path, results, frames, photos)
    write_whole(path, content)
