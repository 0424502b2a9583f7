"""Poses in files, as commands print them and people write them."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from skyline.camera.projection import Projection
from skyline.errors import InputError, printable
from skyline.files.disk import is_name_of, read_bytes
from skyline.files.tables import is_table
from skyline.photo.frame import Size, is_whole
from skyline.photo.photo import Photo, read_photo
from skyline.photo.skyline import PhotoForm
from skyline.photo.tags import positive
from skyline.pose.noted_pose import EXPECTED_RECORD, NotedPose, noted_projection
from skyline.store.read import is_store

_FORM = ("projection", "width_px", "height_px")
"""The keys of `skyline.photo.skyline.PhotoSkyline.form`."""


@dataclass(frozen=True, slots=True)
class PoseRecord:
    """The record of a photo's pose in a file."""

    path: Path
    content: Any
    """Names and values, as JSON has them."""
    doubt: str = ""
    """Why the pose is not to be trusted; empty where its file does not doubt it."""

    @property
    def projection(self) -> Projection | None:
        """The photo's projection; None where the record has none.

        Raises `InputError` for an unknown projection.
        """
        if not isinstance(self.content, dict):
            return None
        return noted_projection(self.content, f"pose {self.path}")

    def pose(self, photo: PhotoForm) -> NotedPose:
        """Return the pose of a photo.

        Raises `InputError` if the record names the size of a photo of another shape, and as
        `NotedPose.from_dict`.
        """
        noted = NotedPose.from_dict(self.content, photo.projection, f"pose {self.path}")
        width, height = (positive(self.content.get(name)) for name in ("width_px", "height_px"))
        if width and height:
            self._check_shape((photo.width_px, photo.height_px), (width, height))
        return replace(noted, doubt=self.doubt)

    def _check_shape(self, size_px: tuple[int, int], noted: Size) -> None:
        """Raise `InputError` for a photo of another shape.

        It may be larger or smaller.
        """
        # Scaling rounds each side to a pixel.
        rounding = sum(1.0 / min(sides) for sides in zip(size_px, noted, strict=True))
        if not is_whole(size_px, noted, rounding):
            raise InputError(
                f"pose {self.path} is of a photo of {noted[0]:g} x {noted[1]:g} px, and this one "
                f"has {size_px[0]:g} x {size_px[1]:g}: it was cropped or turned; give the photo as "
                "it was, or find its pose anew"
            )


def read_pose(path: Path, photo: Path) -> PoseRecord:
    """Read the pose of a photo from a file.

    In a file of several photos, the line that names the photo counts. The pose of a match is its
    answer, else its best candidate. Raises `MissingFileError` if there is no file, and `InputError`
    if it has no such pose, or the pose of a photo with another name.
    """
    record = _record_of(_records_in(path), path, photo)
    if not isinstance(record, dict):
        return PoseRecord(path, record)
    if record.get("type") in {"FeatureCollection", "Feature"}:
        raise InputError(f"pose {path} is GeoJSON, which draws poses on maps; {EXPECTED_RECORD}")
    _check_name(record, path, photo)
    if isinstance(record.get("candidates"), list):
        return _best_of_match(record, path)
    doubt = ""
    if record.get("refusal"):
        doubt = f"the pose in {path} is not trusted: {printable(str(record['refusal']))}"
    if "trusted" in record:
        # An orientation has its eye's elevation, and also the height that follows from it.
        record = {**record, "eye_height_m": None}
    return PoseRecord(path, record, doubt)


def _best_of_match(match: Mapping[str, Any], path: Path) -> PoseRecord:
    """Return the record of a match's answer, else of its best candidate.

    Raises `InputError` for a match without candidates.
    """
    candidates = match["candidates"]
    if not candidates:
        raise InputError(f"pose {path} is of a match that found no place; give another pose")
    best = match.get("answer") or candidates[0]
    if isinstance(best, dict):
        best = {name: match.get(name) for name in _FORM} | best
    is_answer = match.get("answer") is not None
    doubt = "" if is_answer else f"{path} has no answer, so the best candidate is taken"
    return PoseRecord(path, best, doubt)


def read_posed(
    photo: Path, pose: Path, projection: Projection | None = None
) -> tuple[Photo, NotedPose]:
    """Read a photo and its pose.

    Without a ``projection``, the photo has the projection in the pose's record, or else its own.
    Raises as `read_photo`, `read_pose` and `NotedPose.from_dict`.
    """
    record = read_pose(pose, photo)
    read = read_photo(photo, projection=projection or record.projection)
    return read, record.pose(read)


def _check_name(record: Mapping[str, Any], path: Path, photo: Path) -> None:
    """Raise `InputError` for the record of a photo with another name."""
    named = record.get("photo")
    if named and not is_name_of(str(named), photo):
        raise InputError(
            f"pose {path} is of {printable(str(named))}, not of {photo}; give the pose of this "
            "photo, or remove `photo` from the record if a fixed camera took both"
        )


def _records_in(path: Path) -> list[Any]:
    """Return the records of a file of JSON or JSON lines."""
    content = read_bytes(path, EXPECTED_RECORD)
    if not content.strip():
        raise InputError(f"pose {path} is empty; {EXPECTED_RECORD}")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        kind = "a store" if is_store(path) else "a binary file, as photos are"
        raise InputError(f"pose {path} is {kind}; {EXPECTED_RECORD}") from None
    try:
        return [json.loads(text)]
    except (ValueError, RecursionError) as error:
        if is_table(path):
            raise InputError(f"pose {path} is a table; {EXPECTED_RECORD}") from None
        with suppress(ValueError, RecursionError):
            return [json.loads(line) for line in filter(str.strip, text.splitlines())]
        raise InputError(f"pose {path} is not JSON ({error}); {EXPECTED_RECORD}") from None


def _record_of(records: list[Any], path: Path, photo: Path) -> Any:
    """Return the record of a photo; None in a file without records.

    Raises `InputError` unless one of several records is of the photo.
    """
    if len(records) <= 1:
        return records[0] if records else None
    named = {"photo": printable(photo)}
    of_photo = [one for one in records if isinstance(one, dict) and named.items() <= one.items()]
    if len(of_photo) != 1:
        raise InputError(
            f"pose {path} has {len(of_photo)} lines whose `photo` is {photo}; expected one: "
            "give a file of this photo alone"
        )
    return of_photo[0]
