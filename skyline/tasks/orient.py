"""Orienting photos: finding how cameras were held at known positions."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skyline.errors import InputError, SkylineError, check_suffix, printable
from skyline.files.disk import STANDARD, check_outputs, write_whole
from skyline.files.tables import csv_lines
from skyline.match.photo_lists import Entry, usable_entries
from skyline.orientation.orienter import KnownPosition, known_position, orienters
from skyline.orientation.result import Orientation
from skyline.photo.noted_place import NotedPlace
from skyline.tasks.listener import Listener
from skyline.tasks.terrain import read_terrain
from skyline.terrain.heightfield import HeightField


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraAt:
    """The known position and heading of cameras."""

    lonlat_deg: tuple[float, float] | None = None
    """By default each photo's own GPS position."""
    elevation_m: float | None = None
    """Elevation of the eye above the DEM's datum; only with a position."""
    position_sd_m: float | None = None
    """Standard deviation of the position; by default 50 m, or `noted_position_scale_m` for a
    photo's own position."""
    heading_deg: tuple[float, float] | None = None
    """Heading from true north, and its greatest error; by default any heading is possible."""

    def __post_init__(self) -> None:
        if self.elevation_m is not None and self.lonlat_deg is None:
            raise InputError(f"--elevation {self.elevation_m:g} needs a position; give --at too")

    def position_of(self, noted: NotedPlace, name: str) -> KnownPosition:
        """Return where a photo was taken that notes a place.

        Raises `InputError` if neither the photo nor the user gives a position.
        """
        return known_position(noted, name, self.lonlat_deg, self.elevation_m, self.position_sd_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class OrientTask:
    """Photos of cameras at known positions, and the table to write."""

    entries: Sequence[Entry]
    inputs: Sequence[Path]
    """Files that the user has named as photos: the table does not replace them."""
    dem: Sequence[str]
    """Elevation files, or folders of them."""
    crs: str | None = None
    """CRS of elevation files that name none."""
    at: CameraAt
    output: Path | None = None
    """CSV with a row for each photo."""


def orient_photos(task: OrientTask, listener: Listener) -> int:
    """Show how each photo's camera was held, and write the table.

    Returns the exit code of the last error, or 0. Raises `InputError` for a wrong output, and if no
    photo can be used.
    """
    entries = task.entries
    check_outputs([task.output], [*task.inputs, *(Path(one.path) for one in entries)])
    if task.output is not None:
        check_suffix(task.output, [".csv"])
    usable_entries(entries)  # Refused before the DEM is read
    terrain = read_terrain(listener, task.dem, task.crs)
    rows: list[dict[str, Any]] = []
    exit_code = 0
    oriented = 0
    doing = f"orienting {entries[0].path}" if len(entries) == 1 else "orienting photos"
    with listener.progress(doing) as progress:
        progress(0, len(entries))
        for entry, found in zip(entries, _each(terrain, entries, task.at), strict=True):
            if isinstance(found, SkylineError):
                listener.error(str(found))
                exit_code = found.exit_code
            else:
                oriented += 1
                _show(task, entry, found, listener)
            rows.append(_row(entry, found))
            progress(len(rows), len(entries))
    if task.output is not None and oriented:
        write_whole(task.output, _csv(rows))
    return exit_code


def _show(task: OrientTask, entry: Entry, found: Orientation, listener: Listener) -> None:
    """Show an orientation, unless the table goes to standard output.

    If nobody reads it, the task goes on only if it writes a table.
    """
    if str(task.output) == STANDARD:
        return
    try:
        listener.result(found.to_dict() | _label(entry), found.to_text())
    except BrokenPipeError:
        if task.output is None:
            raise


def _row(entry: Entry, found: Orientation | SkylineError) -> dict[str, Any]:
    if isinstance(found, SkylineError):
        failed = {"photo": printable(entry.path), "trusted": 0, "refusal": str(found)}
        return failed | _label(entry)
    return found.to_row() | _label(entry)


def _label(entry: Entry) -> dict[str, str]:
    return {"id": printable(entry.label)} if entry.label else {}


def _csv(rows: list[dict[str, Any]]) -> str:
    names = dict.fromkeys(name for row in sorted(rows, key=len, reverse=True) for name in row)
    return csv_lines([names, *([row.get(name) for name in names] for row in rows)])


def _each(
    terrain: HeightField, entries: Iterable[Entry], at: CameraAt
) -> Iterator[Orientation | SkylineError]:
    """Yield how each photo's camera was held, or the photo's error."""
    with orienters(terrain) as orienter_at:
        for entry in entries:
            try:
                skyline = entry.read()
                orienter = orienter_at(at.position_of(skyline.noted, entry.path))
                found: Orientation | SkylineError = orienter.orient(
                    skyline,
                    name=entry.path,
                    heading_deg=entry.narrowing.heading_deg or at.heading_deg,
                )
            except SkylineError as error:
                found = error
            yield found
