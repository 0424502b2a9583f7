"""A copy of a photo with the place and the direction written into its EXIF (2.32, 4.6.6).

A JPEG keeps its pixels bit for bit: only the segment that holds EXIF is another. What else can be
read is written as a JPEG of the upright photo.
"""

import io
from collections.abc import Iterator
from pathlib import Path

from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from PIL.TiffImagePlugin import IFDRational

from skyline.errors import InputError
from skyline.files import write_with_folders
from skyline.matching.ranking import Candidate
from skyline.photo.read import read_photo

_EXIF = b"Exif\x00\x00"
_APP0, _APP1, _SCAN = 0xE0, 0xE1, 0xDA
_LONGEST = 0xFFFF - 2
"""Bytes that a segment holds beside its length."""


def write_located(source: str | Path, path: str | Path, candidate: Candidate) -> None:
    """Write a copy of a photo that says where and in which direction it was taken.

    Parameters
    ----------
    source : str or Path
        The photo; it is not changed.
    path : str or Path
        The JPEG to write.

    Raises
    ------
    MissingFileError
        There is no such photo.
    InputError
        It cannot be read, its EXIF has no room for more, or the copy cannot be written.
    """
    rgb = read_photo(source).rgb
    data = Path(source).read_bytes()
    with Image.open(io.BytesIO(data)) as image:
        exif, is_jpeg = image.getexif(), image.format in {"JPEG", "MPO"}
        exif.get_ifd(IFD.Exif)
        exif.get_ifd(IFD.GPSInfo).update(_gps(candidate))
    if not is_jpeg:
        held = io.BytesIO()
        exif[Base.Orientation] = 1
        Image.fromarray(rgb).save(held, format="JPEG", quality=95)
        data = held.getvalue()
    write_with_folders(Path(path), _with_exif(data, exif.tobytes()))


def _gps(candidate: Candidate) -> dict[int, object]:
    below = candidate.eye_elevation_m < 0.0
    return {
        GPS.GPSVersionID: b"\x02\x03\x00\x00",
        GPS.GPSLatitudeRef: "S" if candidate.lat < 0.0 else "N",
        GPS.GPSLatitude: _sexagesimal(candidate.lat),
        GPS.GPSLongitudeRef: "W" if candidate.lon < 0.0 else "E",
        GPS.GPSLongitude: _sexagesimal(candidate.lon),
        GPS.GPSAltitudeRef: b"\x01" if below else b"\x00",
        GPS.GPSAltitude: IFDRational(round(100.0 * abs(candidate.eye_elevation_m)), 100),
        GPS.GPSImgDirectionRef: "T",
        GPS.GPSImgDirection: IFDRational(round(1000.0 * candidate.heading_deg), 1000),
        GPS.GPSMapDatum: "WGS-84",
        GPS.GPSProcessingMethod: b"ASCII\0\0\0" + _method(candidate).encode("ascii"),
    }


def _method(candidate: Candidate) -> str:
    """Return how the place was found; EXIF has a word of its own for "by hand"."""
    is_by_hand = candidate.rank is None and not candidate.refined
    return "MANUAL" if is_by_hand else f"SKYLINE: {candidate.origin}"


def _sexagesimal(degrees: float) -> tuple[IFDRational, ...]:
    """Return degrees, minutes and seconds of an angle's size, to a ten-thousandth of a second."""
    parts = round(abs(degrees) * 36_000_000)
    whole, rest = divmod(parts, 36_000_000)
    minutes, seconds = divmod(rest, 600_000)
    return IFDRational(whole, 1), IFDRational(minutes, 1), IFDRational(seconds, 10_000)


def _with_exif(jpeg: bytes, exif: bytes) -> bytes:
    """Return a JPEG with this EXIF in the place of its own."""
    exif = exif if exif.startswith(_EXIF) else _EXIF + exif
    if len(exif) > _LONGEST:
        raise InputError(
            f"the photo's EXIF would have {len(exif)} bytes; expected at most {_LONGEST}: remove "
            "its preview picture"
        )
    kept, start = [], 0
    for marker, segment, end in _segments(jpeg):
        is_exif = marker == _APP1 and segment[4:].startswith(_EXIF)
        if not is_exif:
            kept.append((marker, segment))
        start = end
    before = sum(1 for marker, _ in kept[:1] if marker == _APP0)
    segments = [segment for _, segment in kept]
    segments.insert(before, bytes([0xFF, _APP1]) + (len(exif) + 2).to_bytes(2, "big") + exif)
    return jpeg[:2] + b"".join(segments) + jpeg[start:]


def _segments(jpeg: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Yield the marker, the bytes and the end of each segment before the first scan."""
    at = 2
    while at + 4 <= len(jpeg) and jpeg[at] == 0xFF and jpeg[at + 1] != _SCAN:
        if jpeg[at + 1] == 0xFF:
            at += 1  # a fill byte
            continue
        end = at + 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
        yield jpeg[at + 1], jpeg[at:end], end
        at = end
