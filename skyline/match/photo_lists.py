"""Lists of photos, as files, folders, tables and standard input name them."""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import Any

from skyline.camera.projection import Projection
from skyline.errors import InputError, SkylineError
from skyline.files.disk import REPORT_PAGE, STANDARD, is_own_page, read_bytes
from skyline.files.tables import Row, Table, is_table, read_table
from skyline.match.narrowing import Narrowing
from skyline.photo.image import opened_image, photos_in
from skyline.photo.photo import check_fov, read_noted_time
from skyline.photo.read import read_skyline
from skyline.photo.skyline import Lens, PhotoSkyline

_TOGETHER = {
    "near": ("lon", "lat", "radius_km"),
    "heading_deg": ("heading_deg", "heading_slack_deg"),
    "elevation_m": ("lowest_m", "highest_m"),
}
"""The columns of each field of a narrowing; a row fills all columns of a field or none."""

_NUMBERS = ("fov_deg", "fov_sd_share", "eye_height_m", *chain.from_iterable(_TOGETHER.values()))

_EXPECTED = "expected a list with a column `path`, or a trace of a skyline"


@dataclass(frozen=True, slots=True)
class Entry:
    """A photo, what is known of its camera, and where to search.

    The photo may be a sky mask or a trace.
    """

    path: str
    fov_deg: float | None = None
    """By default from the file."""
    fov_sd_share: float | None = None
    """Standard deviation of the field of view, as a share of it; by default the file's or the
    matcher's."""
    projection: Projection | None = None
    """By default from the file."""
    narrowing: Narrowing = Narrowing()  # noqa: RUF009  (it is frozen)
    label: str = ""
    """The ``id`` or ``name`` that a list gives it."""
    time: datetime | None = field(default=None, repr=False)
    """When it was taken, as a list gives it; by default as its file notes it. Neither an answer nor
    the digest of an entry's text depends on it."""

    def taken(self) -> datetime:
        """Return when the photo was taken.

        Raises `InputError` if neither the list nor the file says so.
        """
        taken = self.time or read_noted_time(self.path)
        if taken is None:
            raise InputError(
                f"{self.path} does not note when it was taken; name the photos in a list that has "
                "a column `time` beside `path`, such as 2026-07-14T15:04"
            )
        return taken

    def check(self) -> None:
        """Check what can be checked without decoding a picture.

        Raises as `read`.
        """
        check_fov(self.fov_deg, self.projection)
        if self.fov_sd_share is not None and not 0.0 <= self.fov_sd_share < 1.0:
            raise InputError(
                f"{self.path}: fov_sd_share is {self.fov_sd_share:g}; expected a share from 0 to 1"
            )
        if is_table(self.path):
            self.read()
        else:
            with opened_image(self.path):
                pass  # Only its header is read

    def read(self) -> PhotoSkyline:
        """Return the skyline; raises as `skyline.photo.read.read_skyline`."""
        photo = read_skyline(self.path, self.fov_deg, projection=self.projection)
        if photo.fov_deg is None or self.fov_sd_share is None:
            return photo
        lens = photo.lens if self.fov_deg is None and photo.lens else Lens(photo.fov_deg)
        return replace(
            photo, lens=replace(lens, fov_sd_deg=self.fov_sd_share * photo.fov_deg, crop_share=0.0)
        )


def entries_of(paths: Iterable[Path], common: Entry) -> Iterator[Entry]:
    """Yield an entry per photo: files, pictures in folders, rows of lists.

    ``-`` is standard input: a photo, a list, or names of files, one a line. A list is a CSV file
    with a column ``path``, whose paths count from the list's folder. Fields that a row leaves empty
    are filled from ``common``, except the path.

    A path with a wildcard that does not exist stands for the files that it matches. Pictures in a
    folder come in natural order; pictures of reports are left out.

    Raises `InputError` for a list with an unknown column, a bad value or no rows, for a folder
    without pictures, and for a wildcard that matches nothing.
    """
    for path in _files_in(paths):
        table = None
        if is_table(path):
            with suppress(SkylineError):  # Reading the entry itself raises it.
                table = read_table(path, _EXPECTED)
        if table is None or "path" not in table.header:
            yield replace(common, path=str(path))
            continue
        table.refuse_other("path", *_NUMBERS, "projection", "time", "id", "name")
        if not table.rows:
            raise InputError(f"{path} is a list without photos; add a row for each")
        for row in table.rows:
            yield _entry(table, row, common)


def usable_entries(entries: Sequence[Entry]) -> list[Entry]:
    """Return the photos that can be read.

    Raises the error of the first photo if none can be read.
    """
    usable: list[Entry] = []
    errors: list[SkylineError] = []
    for one in entries:
        try:
            one.check()
            usable.append(one)
        except SkylineError as error:
            errors.append(error)
    if not usable:
        raise errors[0]
    return usable


def _files_in(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield paths, with folders, wildcards and standard input's names replaced by files."""
    for path in paths:
        named = _names_on_input() if str(path) == STANDARD else []
        for one in named or [path]:
            yield from _expanded(one)


def _names_on_input() -> list[Path]:
    """Return the names of files on standard input, as `find` prints them.

    A photo, a list or a trace has none. Raises `InputError` for empty input, and if no file
    has the first name.
    """
    expected = "expected a photo, or names of files, one a line, a list or a trace"
    lines = os.fsdecode(read_bytes(STANDARD, expected)).split("\n")
    names = [name for name in (line.removesuffix("\r") for line in lines) if name]
    if not names:
        raise InputError(f"standard input is empty; {expected}")
    # A list with the one column `path` is a list, although a file may have this name.
    if names[0] != "path" and os.path.lexists(names[0]):
        return list(map(Path, names))
    if is_table(STANDARD) and names[0] != "path" and not set(",;\t#") & set(names[0]):
        raise InputError(f"standard input names {names[0][:80]}, which is not a file; {expected}")
    return []


def _expanded(path: Path) -> Iterator[Path]:
    """Yield a path, or the files of a folder or wildcard."""
    if path.is_dir():
        pictures = photos_in(path, lambda folder: is_own_page(folder / REPORT_PAGE))
        yield from sorted(pictures, key=_in_order)
    elif not path.exists() and any(mark in path.name for mark in "*?["):
        some = sorted(path.parent.glob(path.name), key=_in_order)
        if not some:
            raise InputError(f"there is no file {path}; check the path of the photos")
        for one in some:
            yield from _expanded(one)
    else:
        yield path


def _in_order(path: Path) -> tuple[list[str | int], str]:
    """Return a key that sorts frame-2 before frame-10."""
    parts = re.split("([0-9]+)", str(path))
    return [int(part) if number % 2 else part for number, part in enumerate(parts)], str(path)


def _entry(table: Table, row: Row, common: Entry) -> Entry:
    """Return a row's entry; raises `InputError` for a bad value."""
    if not row["path"]:
        raise InputError(f"{row.where} has no path; {_EXPECTED}")
    given = {column: row.number(column) for column in _NUMBERS if row[column]}
    known: dict[str, Any] = {}
    for name, group in _TOGETHER.items():
        if all(column in given for column in group):
            known[name] = tuple(given[column] for column in group)
        elif any(column in given for column in group):
            raise InputError(f"{row.where} has some of {', '.join(group)}; expected all or none")
    if "eye_height_m" in given:
        known["eye_height_m"] = given["eye_height_m"]
    try:
        projection = Projection(row["projection"]) if row["projection"] else common.projection
        narrowing = replace(common.narrowing, **known)
    except InputError as error:
        raise InputError(f"{row.where}: {error}") from error
    return replace(
        common,
        path=str(Path(table.path).parent / row["path"]),
        fov_deg=given.get("fov_deg", common.fov_deg),
        fov_sd_share=given.get("fov_sd_share", common.fov_sd_share),
        projection=projection,
        narrowing=narrowing,
        label=row.label,
        time=_time_in(row) if row["time"] else None,
    )


def _time_in(row: Row) -> datetime:
    """Return a row's time; raises `InputError` for any other text."""
    text = row["time"]
    with suppress(ValueError):
        if "T" in text or " " in text:
            return datetime.fromisoformat(text)
    raise InputError(
        f"{row.where}: the time is `{text[:80]}`; expected a day and a time such as "
        "2026-07-14T15:04"
    )
