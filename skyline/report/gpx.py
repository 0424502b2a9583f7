"""Candidates as GPX 1.1 waypoints, which navigation devices and hiking maps read."""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as Xml

from skyline.files import write_with_folders
from skyline.report.kml import child, described, document
from skyline.report.matched import Matched

_NAMESPACE = "http://www.topografix.com/GPX/1/1"


def write_gpx(path: Path, matches: Sequence[Matched]) -> None:
    """Write the candidates of matches as waypoints, best first.

    Raises `InputError` where the file cannot be written.
    """
    root = document("gpx", _NAMESPACE, version="1.1", creator="skyline")
    for matched in matches:
        name = Path(matched.name).name
        for rank, candidate in enumerate(matched.candidates, start=1):
            place = {"lat": f"{candidate.lat:.7f}", "lon": f"{candidate.lon:.7f}"}
            point = child(root, "wpt", **place)
            child(point, "ele", f"{candidate.eye_elevation_m:.1f}")
            child(point, "name", f"{name}: candidate {rank}")
            child(point, "desc", described(candidate))
    write_with_folders(path, Xml.tostring(root, encoding="utf-8", xml_declaration=True))
