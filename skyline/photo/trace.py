"""Skyline traces: CSV files that are written here or by hand."""

import math
import re
from pathlib import Path

import numpy as np

from skyline.arrays import Float64Array
from skyline.camera.projection import Projection
from skyline.errors import InputError, check_suffix
from skyline.files.disk import write_whole
from skyline.files.tables import Row, Table, read_table
from skyline.photo.skyline import Lens, PhotoSkyline

TRACES = (".csv",)
"""The suffix of traces; files with other suffixes are photos."""
_MAX_GAP_SHARE = 0.1
"""Points farther apart than this share of the width are not joined."""
_MAX_SIDE_PX = 100_000
"""Longest side of a photo: a longer one is a mistake, and would fill the memory."""
_COLUMNS = ("column_px", "row_px")
_NOTE = re.compile(r"(\w+)\s*=\s*(\S+?)(?=[,;]*\s|[,;]*$|[,;]\w+\s*=)")
_NOTES = ("width", "height", "fov_deg", "fov_sd_share", "eye_height_m", "projection")
_FORM = "expected a first line '# width=W height=H', then the header 'column_px,row_px'"


def write_trace(skyline: PhotoSkyline, path: str | Path) -> None:
    """Write a skyline as CSV, with a row per trusted column.

    Each run of masked columns becomes a break, a row whose ``row_px`` is ``nan``: the points on its
    two sides are not joined. `read_trace` returns the same rows, bit for bit, and the same field of
    view and projection. Raises `InputError` if the suffix is not .csv, or the file cannot be
    written.
    """
    check_suffix(path, TRACES)
    lines = [f"# width={skyline.width_px} height={skyline.height_px}"]
    if skyline.projection.spreads_angles:
        lines.append(f"# projection={skyline.projection}")
    if skyline.fov_deg is not None:
        lines.append(f"# fov_deg={skyline.fov_deg!r}")
        if skyline.lens is not None and skyline.lens.fov_sd_deg is not None:
            lines[-1] += f" fov_sd_share={skyline.lens.fov_sd_deg / skyline.fov_deg!r}"
    if skyline.eye_height_m is not None:
        lines.append(f"# eye_height_m={skyline.eye_height_m!r}")
    lines.append(",".join(_COLUMNS))
    trusted = skyline.trusted
    starts_gap = ~trusted
    starts_gap[1:] &= trusted[:-1]
    for column in np.flatnonzero(trusted | starts_gap):
        lines.append(f"{column},{float(skyline.row_px[column])!r}")
    write_whole(Path(path), "\n".join(lines) + "\n")


def read_trace(
    path: str | Path, fov_deg: float | None = None, projection: Projection | None = None
) -> PhotoSkyline:
    """Read a trace: points of a skyline, joined by straight lines.

    They may be sparse or fractional. The first line is ``# width=W height=H``, the header
    ``column_px,row_px``; pixel centres are at whole numbers. Lines that begin with # may also note
    ``fov_deg=``, with ``fov_sd_share=`` (its deviation as a share of it), ``eye_height_m=`` and
    ``projection=``; the arguments override a field of view and a projection noted in the file.
    Consecutive points are joined unless they are more than a tenth of the width apart or a row with
    an empty or ``nan`` ``row_px`` stands between them. Drawn columns have trust 1.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The file is not a trace, a point lies outside the image, or a column has two rows.
    """
    table = read_table(path, _FORM)
    notes, noted_projection = _notes(table)
    if not {"width", "height"} <= notes.keys():
        start = (table.notes or [",".join(table.header)])[0].strip()
        raise InputError(f"{path} starts with {start[:60]!r}; {_FORM}")
    sides = notes["width"], notes["height"]
    if not all(side.is_integer() and 1 <= side <= _MAX_SIDE_PX for side in sides):
        raise InputError(
            f"{path} is {sides[0]:.12g} x {sides[1]:.12g} px; expected whole numbers from 1 to "
            f"{_MAX_SIDE_PX}"
        )
    width, height = map(int, sides)
    column, row = _points(table, width, height)
    row_px = _joined(column, row, width)
    if np.isnan(row_px).all():
        raise InputError(f"{path} draws no column of the skyline; add points to it")
    lens = None
    if fov_deg is None and "fov_deg" in notes:
        fov_deg = notes["fov_deg"]
        if "fov_sd_share" in notes:
            lens = Lens(fov_deg, notes["fov_sd_share"] * fov_deg)
    try:
        return PhotoSkyline(
            row_px, np.isfinite(row_px).astype(float), width, height, fov_deg,
            projection or noted_projection, lens=lens, eye_height_m=notes.get("eye_height_m"),
        )  # fmt: skip
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _notes(table: Table) -> tuple[dict[str, float], Projection]:
    """Return the numbers and the projection noted before the header."""
    notes: dict[str, float] = {}
    projection = Projection.PERSPECTIVE
    for number, line in enumerate(table.notes, start=1):
        where = f"{table.path}, line {number}"
        for name, text in _NOTE.findall(line):
            if name not in _NOTES:
                raise InputError(f"{where} notes {name!r}; expected some of {', '.join(_NOTES)}")
            if name == "projection":
                if text not in set(Projection):
                    known = ", ".join(Projection)
                    raise InputError(f"{where}: projection is {text}; expected {known}")
                projection = Projection(text)
                continue
            most = 1.0 if name == "fov_sd_share" else math.inf
            notes[name] = Row(where, {name: text}).number(name, 0.0, most)
    return notes, projection


def _points(table: Table, width: int, height: int) -> tuple[Float64Array, Float64Array]:
    """Return columns and rows of the points, in order of the columns.

    A row of NaN is a break.
    """
    table.first_in(_COLUMNS, expected=_FORM)
    points = [
        (
            row.number("column_px", -0.5, width - 0.5),
            math.nan
            if row["row_px"].lower() in {"", "nan"}
            else row.number("row_px", -0.5, height - 0.5),
        )
        for row in table.rows
    ]
    column, row_px = np.array(sorted(points), dtype=np.float64).reshape(-1, 2).T
    twice = np.flatnonzero(np.diff(column) == 0.0)
    if twice.size:
        raise InputError(
            f"{table.path} has two rows for column {column[twice[0]]:g}; expected one: remove the "
            "other"
        )
    return column, row_px


def _joined(column: Float64Array, row: Float64Array, width: int) -> Float64Array:
    """Interpolate between neighbouring points; NaN over gaps, breaks and beyond the ends."""
    column = np.concatenate([[-2.0 * width], column, [3.0 * width]])
    row = np.concatenate([[np.nan], row, [np.nan]])
    whole = np.arange(width)
    left = np.searchsorted(column, whole, side="right") - 1
    is_far = np.diff(column)[left] > max(_MAX_GAP_SHARE * width, 1.0)
    return np.where(is_far & (column[left] != whole), np.nan, np.interp(whole, column, row))
