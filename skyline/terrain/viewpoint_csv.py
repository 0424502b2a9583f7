"""Viewpoints from a CSV file: the batch renderer's input."""

import csv
from pathlib import Path

import numpy as np

from skyline.errors import InputError, MissingFileError
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, at_elevation, stand_on

_PLACES = (("easting", "northing"), ("lon", "lat"))
_EYES = ("eye_height_m", "eye_elevation_m")
_EXPECTED = (
    "expected a header `easting,northing` or `lon,lat`, and at most one of `eye_height_m` (above "
    "ground) and `eye_elevation_m` (above the datum)"
)


def read_viewpoints(
    path: str | Path, field: HeightField, eye_height_m: float = DEFAULT_EYE_HEIGHT_M
) -> Viewpoints:
    """Read viewpoints and place their eyes on a height field.

    Parameters
    ----------
    path : str or Path
        CSV with a header: ``easting,northing`` in the field's frame or ``lon,lat`` in degrees
        (WGS 84), and optionally ``eye_height_m`` or ``eye_elevation_m``.
    eye_height_m : float
        Metres above ground where the file does not say.

    Raises
    ------
    MissingFileError, InputError
        No such file; wrong columns; a value that is not a number; no rows.
    OffMapError
        A viewpoint off the map, on a hole, or with its eye below the ground.
    """
    columns = _read_columns(Path(path))
    places = next((pair for pair in _PLACES if set(pair) <= columns.keys()), None)
    eyes = [name for name in _EYES if name in columns]
    unknown = columns.keys() - set(places or ()) - set(eyes)
    if places is None or unknown or len(eyes) > 1:
        raise InputError(f"{path}: columns are `{','.join(columns)}`; {_EXPECTED}")
    first, second = columns[places[0]], columns[places[1]]
    if places == ("lon", "lat"):
        first, second = field.frame.from_lonlat(first, second)
    if eyes == ["eye_elevation_m"]:
        return at_elevation(field, first, second, columns["eye_elevation_m"])
    return stand_on(field, first, second, columns.get("eye_height_m", eye_height_m))


def _read_columns(path: Path) -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Return the file's columns of numbers by name."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if row and any(cell.strip() for cell in row)]
    except FileNotFoundError as error:
        raise MissingFileError(f"viewpoint file {path} does not exist; check the path") from error
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} cannot be read as CSV ({error}); {_EXPECTED}") from error
    if not rows:
        raise InputError(f"{path} is empty; {_EXPECTED} and one row a viewpoint")
    header = [name.strip() for name in rows[0]]
    if len(rows) == 1:
        raise InputError(f"{path} has a header but no viewpoints; give one row a viewpoint")
    values = np.empty((len(rows) - 1, len(header)))
    for number, row in enumerate(rows[1:]):
        try:
            values[number] = [float(cell) for _, cell in zip(header, row, strict=True)]
        except ValueError as error:
            raise InputError(
                f"{path}, row {number + 1} after the header is `{','.join(row)[:80]}`; expected "
                f"{len(header)} numbers for `{','.join(header)}`"
            ) from error
    return dict(zip(header, values.T, strict=True))
