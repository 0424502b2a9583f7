"""Poses in files, as commands print them and people write them."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from skyline.camera import Projection
from skyline.errors import InputError, printable
from skyline.files import read_bytes
from skyline.pose import EXPECTED_RECORD, NotedPose
from skyline.store.read import is_store

ANGLE_SDS = ("heading_sd_deg", "pitch_sd_deg", "roll_sd_deg", "fov_sd_deg")
"""Names of the standard errors of a pose's angles, as `skyline orient` writes them."""


def read_pose(path: Path, photo: Path, projection: Projection) -> NotedPose:
    """Read the pose of a photo from a file.

    A file of several photos has the pose in the line that names the photo. Of a match it is the
    answer, else the best candidate. Raises `MissingFileError` where there is no file, and
    `InputError` where it has no such pose, or values that no camera of the projection has.
    """
    record = _record_of(_records_in(path), path, photo)
    doubt = ""
    if isinstance(record, dict) and isinstance(record.get("candidates"), list):
        candidates = record["candidates"]
        if not candidates:
            raise InputError(f"pose {path} is of a match that found no place; give another pose")
        if record.get("answer") is None:
            doubt = f"{path} has no answer, so the best candidate is taken"
        record = record.get("answer") or candidates[0]
    elif isinstance(record, dict) and record.get("refusal"):
        doubt = f"the pose in {path} is not trusted: {printable(str(record['refusal']))}"
    if isinstance(record, dict) and "trusted" in record:
        # An orientation has its eye's elevation, and also the height that follows from it.
        record = {**record, "eye_height_m": None}
    return replace(NotedPose.from_dict(record, projection, f"pose {path}"), doubt=doubt)


def angle_sds_in(path: Path, photo: Path) -> dict[str, float]:
    """Return the standard errors of a pose's angles that its file has, by their names.

    The file is one that `read_pose` reads; `skyline orient --json` writes standard errors.
    """
    record = _record_of(_records_in(path), path, photo)
    given = record if isinstance(record, dict) else {}
    sds = {name: given.get(name) for name in ANGLE_SDS}
    return {name: float(sd) for name, sd in sds.items() if isinstance(sd, int | float) and sd > 0}


def lacking_sds(sds: Mapping[str, float], usual: object) -> str:
    """Return the standard errors that a pose's file lacks, with the usual ones, in words."""
    lacking = [name for name in ANGLE_SDS if name not in sds]
    return ", ".join(f"{name} {getattr(usual, name):g}" for name in lacking)


def _records_in(path: Path) -> list[Any]:
    """Return the records of a file of JSON, or of lines of JSON."""
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
