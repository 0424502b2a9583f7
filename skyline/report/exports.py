"""Matches as files that other programs read, by the file's suffix.

Candidates are points, views and ellipses in degrees of WGS 84 as GeoJSON (RFC 7946); places, views,
and the photo standing in the landscape as KML 2.2 (OGC 07-147r2); waypoints, which navigation
devices and hiking maps read, as GPX 1.1; and cameras in UTM as plain JSON, for monoplotting and
photogrammetry.
"""

import io
import json
import math
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from urllib.parse import quote
from xml.etree import ElementTree as Xml

import cv2
import numpy as np

from skyline.arrays import Float64Array, UInt8Array
from skyline.errors import InputError, printable
from skyline.files import write_with_folders
from skyline.geodesy import Frame
from skyline.match.answer import MatchResult
from skyline.match.candidate import Candidate
from skyline.photo.projection import Projection
from skyline.photo.query import QuerySkyline
from skyline.photo.read import read_picture
from skyline.report.shapes import Ellipse, lonlat_rings, view_wedge_m

VIEW_REACH_M = 2000.0
"""Radius of the wedge drawn for a view; a camera sees farther, but longer wedges would overlap."""

_DECIMALS = 7
"""Decimals of degrees in files: a centimetre on the ground."""
_KML, _GPX = "http://www.opengis.net/kml/2.2", "http://www.topografix.com/GPX/1/1"
_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 90]
_PHOTO_AT_M = 300.0
"""Distance from the camera at which a PhotoOverlay shows its photo."""

Json = dict[str, object]
Photos = Sequence[UInt8Array | None]


def write_geojson(path: Path, results: Sequence[MatchResult], frame: Frame) -> None:
    """Write the candidates of results as a FeatureCollection; ``frame`` is that of the candidates.

    Per candidate a Point whose properties are those of the public JSON with ``query``, ``rank``
    (null where no search found the pose), ``origin`` (see `Candidate.origin`) and ``shape`` =
    ``candidate``; a Polygon with ``shape`` = ``view``, the field of view out to
    2 km; and where its covariance is known one with ``shape`` = ``ellipse95``, ``semi_major_m``
    and ``semi_minor_m``. A shape that the antimeridian cuts is a MultiPolygon.

    Raises `InputError` where the file cannot be written.
    """
    features = [
        feature
        for one in results
        for candidate in one.candidates
        for feature in _features(printable(one.name), candidate, frame)
    ]
    collection = {"type": "FeatureCollection", "features": features}
    write_with_folders(path, json.dumps(collection, indent=1, allow_nan=False) + "\n")


def _features(query: str, candidate: Candidate, frame: Frame) -> list[Json]:
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
        shapes.append(("ellipse95", _polygon(ellipse.outline_m(), frame), axes))
    return [
        {
            "type": "Feature",
            "geometry": geometry,
            "properties": {"query": query, **of_pose, "shape": shape, **about},
        }
        for shape, geometry, about in shapes
    ]


def _polygon(outline_m: Float64Array, frame: Frame) -> Json:
    """Return a shape, which is two or more polygons where the antimeridian cuts it."""
    rings = _rings(outline_m, frame)
    if len(rings) == 1:
        return {"type": "Polygon", "coordinates": rings}
    return {"type": "MultiPolygon", "coordinates": [[ring] for ring in rings]}


def _rings(outline_m: Float64Array, frame: Frame) -> list[list[list[float]]]:
    """Return the rings of an outline (P, 2), metres, in degrees to a centimetre."""
    return [np.round(ring, _DECIMALS).tolist() for ring in lonlat_rings(outline_m, frame)]


def write_cameras(path: Path, results: Sequence[MatchResult]) -> None:
    """Write the candidates of results as cameras.

    A point X (easting, northing, elevation) is seen at the pixel ``matrix @ rotation @ (X -
    position)``, divided by its third component: columns to the right and rows down, the middle of
    the first pixel at 0.5, 0.5. A panorama has no matrix. A wide lens may bend what it shows by
    `Candidate.distortion`.

    Raises `InputError` where the file cannot be written.
    """
    photos = [
        {
            "photo": printable(result.name),
            "width_px": result.query.width_px,
            "height_px": result.query.height_px,
            "cameras": [_camera(result.query, one) for one in result.candidates],
        }
        for result in results
    ]
    write_with_folders(path, json.dumps({"photos": photos}, indent=1).encode())


def _camera(query: QuerySkyline, candidate: Candidate) -> dict[str, object]:
    zone = int((candidate.lon + 180.0) % 360.0 // 6.0) + 1
    crs = f"EPSG:{(32600 if candidate.lat >= 0.0 else 32700) + zone}"
    utm = Frame.from_crs(crs)
    easting_m, northing_m = (float(at) for at in utm.from_lonlat(candidate.lon, candidate.lat))
    grid_deg = candidate.heading_deg - float(
        utm.convergence_deg(easting_m=easting_m, northing_m=northing_m)
    )
    return {
        "crs": crs,
        "position_m": [easting_m, northing_m, candidate.eye_elevation_m],
        "rotation": _rotation(grid_deg, candidate.pitch_deg, candidate.roll_deg).tolist(),
        "matrix": _matrix(query, candidate.fov_deg),
        "distortion": candidate.distortion,
        "confidence": candidate.confidence,
        "rank": candidate.rank,
        "origin": candidate.origin,
    }


def _rotation(heading_deg: float, pitch_deg: float, roll_deg: float) -> Float64Array:
    """Return the camera's axes, right, down and forward, as rows in easting, northing and up."""
    heading, pitch, roll = np.radians((heading_deg, pitch_deg, roll_deg))
    ahead = np.array([np.sin(heading), np.cos(heading), 0.0])
    zenith = np.array([0.0, 0.0, 1.0])
    level = np.array([np.cos(heading), -np.sin(heading), 0.0])
    forward = ahead * np.cos(pitch) + zenith * np.sin(pitch)
    upright = zenith * np.cos(pitch) - ahead * np.sin(pitch)
    right = level * np.cos(roll) - upright * np.sin(roll)
    return np.stack([right, np.cross(forward, right), forward])


def _matrix(query: QuerySkyline, fov_deg: float) -> list[list[float]] | None:
    if query.projection is not Projection.PERSPECTIVE:
        return None
    focal_px = 0.5 * query.width_px / math.tan(math.radians(0.5 * fov_deg))
    middle = 0.5 * query.width_px, 0.5 * query.height_px
    return [[focal_px, 0.0, middle[0]], [0.0, focal_px, middle[1]], [0.0, 0.0, 1.0]]


def write_kml(
    path: Path, results: Sequence[MatchResult], frame: Frame, photos: Photos | None = None
) -> None:
    """Write results as KML, or with their photos in it as KMZ where that is the file's suffix.

    Each candidate is a place and a view of 2 km. The first of each photo has a PhotoOverlay. Its
    picture is the photo in the KMZ. In a KML it is the path from the KML's folder to the photo's
    file; if ``photos`` are given, it is the file's name, and the file should be put beside the KML.

    Raises `InputError` where the file cannot be written.
    """
    packed = path.suffix.lower() == ".kmz"
    pictures: dict[str, UInt8Array] = {}
    root = Xml.Element("kml", xmlns=_KML)
    folder = _child(root, "Document")
    _child(folder, "name", "Where these were taken")
    for number, result in enumerate(results, start=1):
        href = None
        if packed:
            picture = None if photos is None else photos[number - 1]
            if photos is None and result.name:
                picture = read_picture(result.name)
            if picture is not None:
                href = f"files/{number:02d}.jpg"
                pictures[href] = picture
        elif result.name and Path(result.name).suffix.lower() != ".csv":
            href = _href(Path(result.name), path.parent if photos is None else None)
        _add_match(folder, result, frame, href)
    content = Xml.tostring(root, encoding="utf-8", xml_declaration=True)
    if packed:
        held = io.BytesIO()
        with zipfile.ZipFile(held, "w") as archive:
            archive.writestr("doc.kml", content, zipfile.ZIP_DEFLATED)
            for name, picture in pictures.items():
                jpeg = cv2.imencode(".jpg", picture[..., ::-1], _QUALITY)[1].tobytes()
                archive.writestr(name, jpeg)
        content = held.getvalue()
    write_with_folders(path, content)


def _href(photo: Path, folder: Path | None) -> str:
    """Return a photo's address relative to a folder; without one, its file name (RFC 3986, 4.2)."""
    if folder is None:
        return quote(os.fsencode(photo.name))
    # A link among the folders would lead `..` to another folder.
    file = photo.parent.resolve() / photo.name
    return quote(os.fsencode(os.path.relpath(file, folder.resolve())))


def _add_match(folder: Xml.Element, result: MatchResult, frame: Frame, href: str | None) -> None:
    name = Path(result.name).name
    for candidate in result.candidates:
        mark = _child(folder, "Placemark")
        _child(mark, "name", f"{name}: {candidate.name}")
        _child(mark, "description", _described(candidate))
        shapes = _child(mark, "MultiGeometry")
        _add_point(shapes, candidate)
        for outline in _rings(view_wedge_m(candidate, VIEW_REACH_M), frame):
            ring = _child(_child(_child(shapes, "Polygon"), "outerBoundaryIs"), "LinearRing")
            _child(ring, "coordinates", " ".join(f"{lon},{lat}" for lon, lat in outline))
    is_flat = result.query.projection is Projection.PERSPECTIVE
    if href is not None and result.candidates and is_flat:
        _add_photo(folder, name, result.query, result.candidates[0], href)


def _add_photo(
    folder: Xml.Element, name: str, query: QuerySkyline, candidate: Candidate, href: str
) -> None:
    overlay = _child(folder, "PhotoOverlay")
    _child(overlay, "name", name)
    camera = _child(overlay, "Camera")
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
        _child(camera, tag, value)
    _child(_child(overlay, "Icon"), "href", href)
    volume = _child(overlay, "ViewVolume")
    side_deg = candidate.fov_deg / 2.0
    for tag, degrees in (
        ("leftFov", -side_deg),
        ("rightFov", side_deg),
        ("bottomFov", -up_deg),
        ("topFov", up_deg),
    ):
        _child(volume, tag, f"{degrees:.3f}")
    _child(volume, "near", f"{_PHOTO_AT_M:g}")
    _add_point(overlay, candidate)
    _child(overlay, "shape", "rectangle")


def _add_point(parent: Xml.Element, candidate: Candidate) -> None:
    place = f"{candidate.lon:.7f},{candidate.lat:.7f},{candidate.eye_elevation_m:.2f}"
    _child(_child(parent, "Point"), "coordinates", place)


def _described(candidate: Candidate) -> str:
    """Return in words the origin of a pose, the attitude of its camera and its confidence."""
    sure = "" if candidate.confidence is None else f"; confidence {candidate.confidence:.2f}"
    return (
        f"{candidate.origin.capitalize()}. Heading {candidate.heading_deg:.1f}° from true north, "
        f"pitch {candidate.pitch_deg:.1f}°, "
        f"roll {candidate.roll_deg:.1f}°, field of view {candidate.fov_deg:.1f}°, eye "
        f"{candidate.eye_elevation_m:.0f} m above the datum{sure}"
    )


def write_gpx(path: Path, results: Sequence[MatchResult]) -> None:
    """Write the candidates of results as waypoints.

    Raises `InputError` where the file cannot be written.
    """
    root = Xml.Element("gpx", xmlns=_GPX, version="1.1", creator="skyline")
    for result in results:
        name = Path(result.name).name
        for candidate in result.candidates:
            place = {"lat": f"{candidate.lat:.7f}", "lon": f"{candidate.lon:.7f}"}
            point = _child(root, "wpt", **place)
            _child(point, "ele", f"{candidate.eye_elevation_m:.1f}")
            _child(point, "name", f"{name}: {candidate.name}")
            _child(point, "desc", _described(candidate))
    write_with_folders(path, Xml.tostring(root, encoding="utf-8", xml_declaration=True))


def _child(parent: Xml.Element, tag: str, text: str = "", **attributes: str) -> Xml.Element:
    element = Xml.SubElement(parent, tag, attributes)
    if text:
        element.text = printable(text)
    return element


Writer = Callable[[Path, Sequence[MatchResult], Frame, Photos | None], None]

EXPORTS: Mapping[str, Writer] = MappingProxyType(
    {
        ".geojson": lambda path, results, frame, _: write_geojson(path, results, frame),
        ".kml": write_kml,
        ".kmz": write_kml,
        ".gpx": lambda path, results, *_: write_gpx(path, results),
        ".json": lambda path, results, *_: write_cameras(path, results),
    }
)
"""The function that writes a file of each suffix."""


def check_export(path: str | Path) -> Writer:
    """Return the writer for a file's suffix; raises `InputError` for an unknown one."""
    suffix = Path(path).suffix.lower()
    if suffix not in EXPORTS:
        raise InputError(f"{path}: the suffix is {suffix!r}; expected one of {', '.join(EXPORTS)}")
    return EXPORTS[suffix]


def export_matches(
    path: str | Path,
    results: Sequence[MatchResult],
    frame: Frame,
    photos: Photos | None = None,
) -> None:
    """Write the candidates of results by the suffix: GeoJSON, KML, KMZ, GPX, or cameras in JSON.

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
    check_export(path)(Path(path), results, frame, photos)
