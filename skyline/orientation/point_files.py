"""Control points in files: places on the map, and their pixels.

They are CSV tables, or the ``.points`` of QGIS's georeferencer.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyline.arrays import BoolArray, Float64Array
from skyline.camera.pixels import in_picture
from skyline.errors import InputError, check_suffix, printable
from skyline.files.disk import write_whole
from skyline.files.tables import Table, csv_lines, read_table
from skyline.geodesy.bounds import are_degrees
from skyline.geodesy.crs import WGS84, crs_of_positions, transformer

POINT_FILES = (".csv", ".points")
"""Suffixes of files of control points."""
_COLUMNS = ("column_px", "row_px", "lon", "lat")
_EXPECTED = (
    "expected a header `column_px,row_px,lon,lat`, and optionally `elevation_m` and `name`, or "
    "QGIS's `.points`"
)
_QGIS = (("mapx", "mapy", "sourcex", "sourcey"), ("mapx", "mapy", "pixelx", "pixely"))
"""Columns of QGIS from 3.26 on, and before. Its pixels count from the photo's upper left corner,
and its rows upwards."""
_QGIS_CRS = re.compile(r"#\s*CRS:\s*(.+)")
_CORNER = 0.5


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlPoints:
    """N points whose pixel and place are known."""

    path: Path
    names: tuple[str, ...]
    """By default their numbers."""
    column_px: Float64Array
    """(N,) float64."""
    row_px: Float64Array
    """(N,) float64."""
    lon: Float64Array
    """(N,) float64. Degrees, WGS 84."""
    lat: Float64Array
    """(N,) float64."""
    elevation_m: Float64Array
    """(N,) float64. Above the DEM's datum; NaN for a point on the ground of the DEM."""
    of_qgis: bool = False
    """Whether they were marked in QGIS."""

    def __len__(self) -> int:
        return len(self.names)

    def check_inside(self, photo: Path, width_px: int, height_px: int) -> None:
        """Raise `InputError` for points outside a photo."""
        off = ~in_picture(self.column_px, self.row_px, width_px, height_px)
        if off.any():
            first = int(off.argmax())
            raise InputError(
                f"{self.path}: point {self.names[first]} at column {self.column_px[first]:g}, row "
                f"{self.row_px[first]:g} is outside {photo}, which has {width_px} x {height_px} "
                "px; give the points of this photo"
            )


def read_control_points(path: Path) -> ControlPoints:
    """Read control points; those that QGIS has disabled are left out.

    Raises `MissingFileError` or `InputError` where there is no such file, it has other columns, or
    its places are neither in degrees nor in a CRS that it names.
    """
    check_suffix(path, POINT_FILES)
    table = read_table(path, _EXPECTED)
    named = table.first_in(_COLUMNS, *_QGIS, expected=_EXPECTED)
    if named != _COLUMNS:
        return _of_qgis(path, table, named)
    table.refuse_other(*_COLUMNS, "elevation_m", "name", "id", *_WRITTEN)
    column, row, lon, lat = (
        np.array([one.number(name) for one in table.rows], dtype=np.float64) for name in _COLUMNS
    )
    elevation_m = [
        one.number("elevation_m") if one["elevation_m"] else np.nan for one in table.rows
    ]
    names = tuple(
        printable(one.label) or str(number) for number, one in enumerate(table.rows, start=1)
    )
    return ControlPoints(
        path=path,
        names=names,
        column_px=column,
        row_px=row,
        lon=lon,
        lat=lat,
        elevation_m=np.array(elevation_m, dtype=np.float64),
    )


def _of_qgis(path: Path, table: Table, named: Sequence[str]) -> ControlPoints:
    rows = [one for one in table.rows if not one["enable"] or one.number("enable", 0.0, 1.0)]
    x, y, column, row = (
        np.array([one.number(name) for one in rows], dtype=np.float64) for name in named
    )
    crs = next(filter(None, map(_QGIS_CRS.match, table.notes)), None)
    if crs is not None:
        to_wgs84 = transformer(crs_of_positions(path, crs[1]), WGS84)
        x, y = (np.asarray(part) for part in to_wgs84.transform(x, y))
    off = [k for k, place in enumerate(zip(x, y, strict=True)) if not are_degrees(*place)]
    if off:
        raise InputError(
            f"{path}: the place {x[off[0]]:g},{y[off[0]]:g} is not in degrees, and the file names "
            "no CRS; save the points with a recent QGIS, or put `#CRS: EPSG:...` before the header"
        )
    return ControlPoints(
        path=path,
        names=tuple(str(number) for number in range(1, len(rows) + 1)),
        column_px=column - _CORNER,
        row_px=-row - _CORNER,
        lon=x,
        lat=y,
        elevation_m=np.full(len(rows), np.nan),
        of_qgis=True,
    )


_WRITTEN = ("across_px", "down_px", "residual_px", "used")
"""Further columns of points with residuals."""


def is_of_qgis(path: Path) -> bool:
    """Return whether a file of points is written for QGIS."""
    return path.suffix.lower() == ".points"


def write_control_points(
    path: Path, points: ControlPoints, residual_px: Float64Array, is_used: BoolArray
) -> None:
    """Write control points with their residuals.

    ``residual_px`` (N, 2) is where a point appears from the pose minus where it was marked: right,
    and down. A point that is not used is disabled in QGIS. Raises `InputError` for another suffix,
    and where the file cannot be written.
    """
    check_suffix(path, POINT_FILES)
    size_px = np.round(np.linalg.norm(residual_px, axis=1), 3)
    if is_of_qgis(path):
        columns: dict[str, Sequence[object]] = {
            "mapX": [f"{lon:.8f}" for lon in points.lon],
            "mapY": [f"{lat:.8f}" for lat in points.lat],
            "sourceX": (points.column_px + _CORNER).tolist(),
            "sourceY": (-points.row_px - _CORNER).tolist(),
            "enable": is_used.astype(int).tolist(),
            "dX": np.round(residual_px[:, 0], 3).tolist(),
            "dY": np.round(-residual_px[:, 1], 3).tolist(),
            "residual": size_px.tolist(),
        }
        note = "#CRS: EPSG:4326\n"
    else:
        columns = {
            "name": points.names,
            "column_px": points.column_px.tolist(),
            "row_px": points.row_px.tolist(),
            "lon": [f"{lon:.8f}" for lon in points.lon],
            "lat": [f"{lat:.8f}" for lat in points.lat],
            "elevation_m": ["" if np.isnan(one) else one for one in points.elevation_m.tolist()],
            "across_px": np.round(residual_px[:, 0], 3).tolist(),
            "down_px": np.round(residual_px[:, 1], 3).tolist(),
            "residual_px": size_px.tolist(),
            "used": is_used.astype(int).tolist(),
        }
        note = ""
    rows = zip(*columns.values(), strict=True)
    write_whole(path, note + csv_lines([columns, *rows]))
