"""Matches as files that other programs read, by the file's suffix."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from skyline.errors import InputError
from skyline.geodesy import Frame
from skyline.report.cameras import write_cameras
from skyline.report.geojson import write_geojson
from skyline.report.gpx import write_gpx
from skyline.report.kml import write_kml
from skyline.report.matched import Matched

Writer = Callable[[Path, Sequence[Matched], Frame], None]


EXPORTS: Mapping[str, Writer] = MappingProxyType(
    {
        ".geojson": write_geojson,
        ".kml": write_kml,
        ".kmz": write_kml,
        ".gpx": lambda path, matches, _: write_gpx(path, matches),
        ".json": lambda path, matches, _: write_cameras(path, matches),
    }
)
"""What writes a file of each suffix."""


def check_export(path: str | Path) -> Writer:
    """Return what writes such a file; raises `InputError` where its suffix is not known."""
    suffix = Path(path).suffix.lower()
    if suffix not in EXPORTS:
        raise InputError(f"{path}: the suffix is {suffix!r}; expected one of {', '.join(EXPORTS)}")
    return EXPORTS[suffix]


def export_matches(path: str | Path, matches: Sequence[Matched], frame: Frame) -> None:
    """Write the candidates of matches by the suffix: GeoJSON, KML, KMZ, GPX, or cameras in JSON.

    Parameters
    ----------
    path : str or Path
        Folders that it needs are made.
    frame : Frame
        Of the candidates: `Matcher.frame`.

    Raises
    ------
    InputError
        The suffix is not known, or the file cannot be written.
    """
    check_export(path)(Path(path), matches, frame)
