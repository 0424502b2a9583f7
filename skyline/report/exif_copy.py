"""Copies of photos with a pose's place and heading in EXIF.

EXIF 2.32, 4.6.6, defines the tags. A JPEG keeps its pixels bit for bit. All of its EXIF but the GPS
directory keeps its position, since maker's notes and previews depend on offsets. Any other photo is
written as a JPEG of the upright picture. XMP tags of the camera's place and attitude are removed.
"""

import io
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from PIL.TiffImagePlugin import IFDRational, ImageFileDirectory_v2

from skyline.errors import InputError
from skyline.files.disk import write_whole
from skyline.photo.image import opened_image
from skyline.photo.noted_panorama import GPANO
from skyline.photo.photo import read_photo
from skyline.photo.xmp import (
    EXTENDED,
    HAS_EXTENDED,
    IN_JPEG,
    XMP_TAG,
    BrokenXmpError,
    Name,
    joined,
    without,
)
from skyline.pose.pose import Pose

_EXIF = b"Exif\x00\x00"
"""The beginning of a segment with EXIF."""
_APP0 = 0xE0
"""The marker of a JPEG's first segment, JFIF."""
_APP1 = 0xE1
"""The marker of segments with EXIF or XMP."""
_SCAN = 0xDA
"""The marker with which the pixels begin."""
_LONGEST = 0xFFFF - 2
"""Greatest number of bytes in a segment, without its length."""
_NO_EXIF = b"II*\x00\x08\x00\x00\x00" + bytes(6)
"""A TIFF with one empty directory."""
_SHORT = 3
"""TIFF's type of 16-bit numbers."""
_LONG = 4
"""TIFF's type of 32-bit numbers."""
_Segment = tuple[int, bytes]
"""A JPEG's segment: its marker and its body."""
_OF_THE_PHOTO = {
    Base.ImageDescription, Base.Make, Base.Model, Base.Software, Base.DateTime, Base.Artist,
    Base.Copyright, Base.ExifOffset,
}  # fmt: skip
"""Tags of a TIFF's directory that do not describe how its pixels are stored."""
_POSE = re.compile(
    r"(?i:gps\w*)|Latitude|Longitude|(?:Absolute|Relative|AboveGround)Altitude"
    r"|(?:Gimbal|Flight|Camera|Drone)\w+Degree|CameraOrientation\w+|Yaw|Pitch|Roll"
)
"""XMP's names of place and attitude, in any namespace: EXIF's GPS tags and tags of drones."""
_PANORAMA_POSE = re.compile(r"(?:Pose|InitialView)\w+")
"""Names of place and attitude that count only in the namespace of panoramas."""


def write_located(source: str | Path, path: str | Path, candidate: Pose) -> None:
    """Write a copy of a photo with a pose in its EXIF.

    The copy has the pose's place and heading. The photo's other GPS tags (its error, the time of a
    fix, a destination) belong to another pose and are left out.

    Parameters
    ----------
    source : str or Path
        The photo, which is not changed.
    path : str or Path
        The JPEG to write.

    Raises
    ------
    MissingFileError
        There is no such photo.
    InputError
        The photo cannot be read, its EXIF has no room, or the copy cannot be written.
    """
    source = Path(source)
    rgb = read_photo(source).rgb
    jpeg = source.read_bytes()
    with opened_image(source) as image:
        is_jpeg = image.format in {"JPEG", "MPO"}
        if not is_jpeg:
            image.load()  # A PNG may store its EXIF after its pixels.
        exif = image.info.get("exif") or _exif_of_tags(image.getexif())
    if not is_jpeg:
        held = io.BytesIO()
        Image.fromarray(rgb).save(held, format="JPEG", quality=95)
        jpeg = held.getvalue()
    exif = _with_gps(exif.removeprefix(_EXIF), _gps(candidate), made_upright=not is_jpeg)
    write_whole(Path(path), _with_exif(jpeg, _EXIF + exif))


def _gps(candidate: Pose) -> dict[int, object]:
    """Return the GPS tags of a pose's place and heading."""
    is_below = candidate.eye_elevation_m < 0.0
    # EXIF's word for a place that a person sets is MANUAL.
    is_by_hand = candidate.rank is None and not candidate.refined
    method = "MANUAL" if is_by_hand else f"SKYLINE: {candidate.origin}"
    gps: dict[int, object] = {
        GPS.GPSVersionID: b"\x02\x03\x00\x00",
        GPS.GPSLatitudeRef: "S" if candidate.lat < 0.0 else "N",
        GPS.GPSLatitude: _sexagesimal(candidate.lat),
        GPS.GPSLongitudeRef: "W" if candidate.lon < 0.0 else "E",
        GPS.GPSLongitude: _sexagesimal(candidate.lon),
        GPS.GPSAltitudeRef: b"\x01" if is_below else b"\x00",
        GPS.GPSAltitude: IFDRational(round(100.0 * abs(candidate.eye_elevation_m)), 100),
        GPS.GPSImgDirectionRef: "T",
        GPS.GPSImgDirection: IFDRational(round(1000.0 * candidate.heading_deg) % 360_000, 1000),
        GPS.GPSMapDatum: "WGS-84",
        GPS.GPSProcessingMethod: b"ASCII\0\0\0" + method.encode("ascii"),
    }
    if candidate.radius_m is not None:
        gps[GPS.GPSHPositioningError] = IFDRational(round(100.0 * candidate.radius_m), 100)
    return gps


def _sexagesimal(degrees: float) -> tuple[IFDRational, ...]:
    """Return an angle's degrees, minutes and seconds, without its sign.

    Seconds are rounded to a ten-thousandth.
    """
    whole, rest = divmod(round(abs(degrees) * 36_000_000), 36_000_000)
    minutes, seconds = divmod(rest, 600_000)
    return IFDRational(whole, 1), IFDRational(minutes, 1), IFDRational(seconds, 10_000)


def _exif_of_tags(tags: Image.Exif) -> bytes:
    """Return tags of a file without an EXIF block, as a TIFF."""
    tags.get_ifd(IFD.Exif)
    for tag in set(tags) - _OF_THE_PHOTO:
        del tags[tag]
    return tags.tobytes()


def _with_gps(exif: bytes, gps: Mapping[int, object], *, made_upright: bool) -> bytes:
    """Return EXIF with a GPS directory appended.

    A main directory that points to it is appended too. If the picture was ``made_upright``, the
    orientation becomes upright, and the preview, which was not turned, is dropped. EXIF without a
    main directory counts as empty.
    """
    order = ">" if exif.startswith(b"MM") else "<"
    try:
        (at,) = struct.unpack_from(f"{order}I", exif, 4)
        (count,) = struct.unpack_from(f"{order}H", exif, at)
        entries = {
            struct.unpack_from(f"{order}H", exif, first)[0]: exif[first : first + 12]
            for first in range(at + 2, at + 2 + 12 * count, 12)
        }
        (preview_at,) = struct.unpack_from(f"{order}I", exif, at + 2 + 12 * count)
        directory = ImageFileDirectory_v2(exif[:8], group=IFD.GPSInfo)
    except (struct.error, SyntaxError):
        return _with_gps(_NO_EXIF, gps, made_upright=made_upright)
    entries.pop(XMP_TAG, None)  # Another pose may be in it.
    if made_upright:
        preview_at = 0
        entries[Base.Orientation] = struct.pack(f"{order}HHIHxx", Base.Orientation, _SHORT, 1, 1)
    exif += bytes(len(exif) % 2)
    at = len(exif)
    count = len(entries.keys() | {IFD.GPSInfo})
    gps_at = at + 2 + 12 * count + 4
    entries[IFD.GPSInfo] = struct.pack(f"{order}HHII", IFD.GPSInfo, _LONG, 1, gps_at)
    for tag, value in gps.items():
        directory[tag] = value
    return b"".join(
        [
            exif[:4],
            struct.pack(f"{order}I", at),
            exif[8:],
            struct.pack(f"{order}H", count),
            *(entries[tag] for tag in sorted(entries)),
            struct.pack(f"{order}I", preview_at),
            directory.tobytes(gps_at),
        ]
    )


def _with_exif(jpeg: bytes, exif: bytes) -> bytes:
    """Return a JPEG with new EXIF, without a pose in XMP."""
    kept = list[_Segment]()
    start = 0
    for marker, body, end in _segments(jpeg):
        start = end
        if not (marker == _APP1 and body.startswith(_EXIF)):
            kept.append((marker, body))
    kept = _without_pose(kept)
    kept.insert(1 if kept and kept[0][0] == _APP0 else 0, (_APP1, exif))
    for _, body in kept:
        if len(body) > _LONGEST:
            is_exif = body is exif
            kind = "EXIF" if is_exif else "XMP"
            part = "its preview picture" if is_exif else "some of it"
            raise InputError(
                f"the photo's {kind} would have {len(body)} bytes; expected at most {_LONGEST}: "
                f"remove {part}"
            )
    segments = (struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body for marker, body in kept)
    return jpeg[:2] + b"".join(segments) + jpeg[start:]


def _without_pose(segments: Sequence[_Segment]) -> list[_Segment]:
    """Return a JPEG's segments without the place and the attitude in XMP.

    An extended packet that notes either is left out, and so is a packet that cannot be parsed:
    nobody knows what it notes.
    """
    extended = [segment for segment in segments if segment[1].startswith(EXTENDED)]
    dropped = list[_Segment]()
    is_unwanted = _is_pose
    if not all(map(_is_free, joined([body for _, body in extended]))):
        dropped = extended
        is_unwanted = _is_pose_or_extended
    kept = list[_Segment]()
    for marker, body in segments:
        if (marker, body) in dropped:
            continue
        if marker == _APP1 and body.startswith(IN_JPEG):
            with suppress(BrokenXmpError):
                packet = without(body.removeprefix(IN_JPEG), is_unwanted)
                kept.append((marker, IN_JPEG + packet))
            continue
        kept.append((marker, body))
    return kept


def _is_free(packet: bytes) -> bool:
    """Return whether a packet of XMP notes no place and no attitude."""
    try:
        return without(packet, _is_pose) == packet
    except BrokenXmpError:
        return False


def _is_pose(name: Name) -> bool:
    """Return whether a property of XMP is a place or an attitude."""
    namespace, local = name
    if namespace == GPANO and _PANORAMA_POSE.fullmatch(local):
        return True
    return _POSE.fullmatch(local) is not None


def _is_pose_or_extended(name: Name) -> bool:
    """Return whether a property notes a pose or an extended packet."""
    return name == HAS_EXTENDED or _is_pose(name)


def _segments(jpeg: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Yield marker, body and end of each segment before the pixels."""
    at = 2
    while at + 4 <= len(jpeg) and jpeg[at] == 0xFF and jpeg[at + 1] != _SCAN:
        if jpeg[at + 1] == 0xFF:
            at += 1  # a fill byte
            continue
        end = at + 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
        yield jpeg[at + 1], jpeg[at + 4 : end], end
        at = end
