"""Files of horizons: CSV, JSON, and formats for solar energy and astronomy."""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from skyline.angles import wrapped_deg
from skyline.arrays import Float64Array, IntArray
from skyline.errors import InputError, suffix_of
from skyline.files.disk import write_whole
from skyline.files.tables import csv_lines
from skyline.geodesy.crs import is_of_earth, other_world_in_words
from skyline.horizons.local_horizons import LocalHorizons


def kind_of_horizons(path: Path) -> str:
    """Return the ending in `KINDS` of a file's name.

    Raises `InputError` where the ending is unknown.
    """
    name = path.name.lower()
    known = [kind for kind in KINDS if name.endswith(kind)]
    return max(known, key=len) if known else suffix_of(path, KINDS)


def write_horizons(horizons: LocalHorizons, path: Path) -> None:
    """Write horizons to a file in the format of its name's ending.

    ``.csv`` and ``.json`` hold any number of places, the others one. ``.txt`` is the horizon file
    of PVGIS, ``.hor`` of PVsyst, Meteonorm and PV*SOL, ``.sam.csv`` a table of shading for SAM,
    ``.hrz`` the horizon of N.I.N.A. and other observers' programs, and ``.zip`` a landscape of
    Stellarium.

    Raises `InputError` where the ending is unknown, the file cannot be written, or a file of one
    place would hold several, a surface, an unknown value, or a horizon of another world.
    """
    kind = kind_of_horizons(path)
    check_can_hold(path, horizons.size, horizons.has_surface, horizons.crs)
    if kind not in _OF_MANY and not np.isfinite(horizons.elevation_deg).all():
        raise InputError(
            "the horizon is unknown at some azimuths; choose a place farther from the border of "
            "the DEM, or write .csv or .json"
        )
    write_whole(path, KINDS[kind](horizons.ravel()))


def check_can_hold(path: Path, places: int, has_surface: bool, crs: CRS) -> None:
    """Raise `InputError` unless a file can hold the horizons of some places.

    So a command refuses them before it renders. Only ``.csv`` and ``.json`` hold several places, a
    surface, and other worlds than the Earth.
    """
    kind = kind_of_horizons(path)
    if kind in _OF_MANY:
        return
    if not is_of_earth(crs):
        raise InputError(
            f"{kind} is read by programs for the Earth, and the DEM is of "
            f"{other_world_in_words(crs)}; write .csv or .json"
        )
    if places != 1:
        raise InputError(
            f"the file would hold {places} horizons, but {kind} holds one; give one place, "
            "or write .csv or .json"
        )
    if has_surface:
        raise InputError(
            f"the file would hold two horizons, but {kind} holds one; leave --surface out, or "
            "write .csv or .json"
        )


def horizon_csv(horizons: LocalHorizons) -> str:
    """Return horizons as CSV: a row per place and azimuth.

    Unknown values are empty.
    """
    written = _columns(horizons)
    bins = horizons.azimuth_deg.shape[1]
    columns = [np.repeat(horizons.lon, bins), np.repeat(horizons.lat, bins)]
    columns += [getattr(horizons, name).ravel() for name in ("azimuth_deg", *written)]
    digits = ["%.7f", "%.7f", "%.9g", *(f"%.{digits}f" for digits in written.values())]
    header = ",".join(["lon", "lat", "azimuth_deg", *written])
    text = io.StringIO()
    np.savetxt(text, np.column_stack(columns), ",".join(digits), header=header, comments="")
    lines = text.getvalue().replace("nan", "").splitlines(keepends=True)
    if horizons.has_ids:
        cells = [csv_lines([[one]]).rstrip("\n") for one in horizons.id.tolist()]
        ids = ["id", *np.repeat(cells, bins)]
        lines = [f"{one},{line}" for one, line in zip(ids, lines, strict=True)]
    return "".join(lines)


def _columns(horizons: LocalHorizons) -> dict[str, int]:
    """Return the columns written for each azimuth, with their number of decimals."""
    return {"elevation_deg": 5, "distance_m": 1} | (
        {"surface_deg": 5} if horizons.has_surface else {}
    )


def _json(horizons: LocalHorizons) -> str:
    factors = horizons.sky_view_factor()
    places = [
        {
            **({"id": str(horizons.id[index])} if horizons.has_ids else {}),
            "lon": round(float(horizons.lon[index]), 7),
            "lat": round(float(horizons.lat[index]), 7),
            "eye_elevation_m": round(float(horizons.eye_elevation_m[index]), 2),
            "sky_view_factor": _known(factors[index], 5),
            "azimuth_deg": [round(value, 9) for value in horizons.azimuth_deg[index].tolist()],
            **{
                name: [_known(value, digits) for value in getattr(horizons, name)[index]]
                for name, digits in _columns(horizons).items()
            },
        }
        for index in range(len(horizons))
    ]
    return json.dumps({"places": places}, allow_nan=False) + "\n"


def _known(value: np.floating[Any], digits: int) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None


def _pvgis(horizons: LocalHorizons) -> str:
    """Return lines of elevation angles, in equal steps clockwise from north.

    No angle is below 0.
    """
    return "".join(f"{value:.2f}\n" for value in np.maximum(horizons.elevation_deg[0], 0.0))


def _at_degrees(horizons: LocalHorizons, azimuth_deg: IntArray) -> Float64Array:
    """Return the elevation angles at whole degrees of azimuth, none below 0."""
    angles = horizons.azimuth_deg[0], horizons.elevation_deg[0]
    return np.asarray(np.maximum(np.interp(azimuth_deg, *angles, period=360.0), 0.0))


def _hor(horizons: LocalHorizons) -> str:
    """Return 360 lines of azimuth and elevation, from -180 on.

    Azimuth 0 is south, -90 east.

    PV*SOL's help (Shading, "*.hor-Format") has two columns with a space between them, azimuths from
    -180 to 179 and elevations from 0 to 90; Meteonorm's files are the same, without a header. The
    import of PVsyst (help, "Importing an Horizon profile") takes azimuth and height from each line,
    and asks in which direction azimuths turn and which of them is north.
    """
    azimuth_deg = np.arange(-180, 180)
    up_deg = _at_degrees(horizons, azimuth_deg + 180)
    return "".join(f"{at} {up:.1f}\n" for at, up in zip(azimuth_deg, up_deg, strict=True))


def _sam(horizons: LocalHorizons) -> str:
    """Return the sun's lost beam in per cent, by altitude and azimuth.

    SAM (Shading, "Azimuth by Altitude"): the first row has azimuths from 0 to 360, where 0 is north
    and 90 east; the first column has altitudes from 0 to 90; 100 is full shade.
    """
    azimuth_deg = np.arange(361)
    up_deg = _at_degrees(horizons, azimuth_deg)
    rows = [[0, *azimuth_deg]]
    rows += [[up, *np.where(up < up_deg, 100, 0)] for up in range(91)]
    return "".join(",".join(map(str, row)) + "\n" for row in rows)


def _observers(horizons: LocalHorizons) -> str:
    """Return lines of azimuth and altitude, clockwise from north to 360.

    N.I.N.A.'s `CustomHorizon`: pairs with a space between them; lines that start with # are
    comments.
    """
    place = f"lat {horizons.lat[0]:.6f}, lon {horizons.lon[0]:.6f}"
    return f"# azimuth altitude, degrees; {place}\n" + _pairs(horizons, closed=True)


def _pairs(horizons: LocalHorizons, closed: bool) -> str:
    azimuth_deg = np.append(horizons.azimuth_deg[0], 360.0)
    up_deg = np.append(horizons.elevation_deg[0], horizons.elevation_deg[0, 0])
    count = len(azimuth_deg) if closed else len(azimuth_deg) - 1
    return "".join(
        f"{at:.9g} {up:.3f}\n" for at, up in zip(azimuth_deg[:count], up_deg[:count], strict=True)
    )


def _stellarium(horizons: LocalHorizons) -> bytes:
    """Return a zip of a polygonal landscape: landscape.ini and its horizon list.

    Stellarium's user guide, chapter Landscapes, "Polygonal landscapes"; azimuths count from north
    over east (``azDeg_altDeg``). Stellarium knows an installed landscape by its folder, and
    refuses a second one of that name (`LandscapeMgr::installLandscapeFromArchive`).
    """
    lon_deg, lat_deg = float(wrapped_deg(horizons.lon[0])), float(horizons.lat[0])
    name = str(horizons.id[0]) or f"Skyline {lat_deg:.4f} {lon_deg:.4f}"
    folder = f"skyline_{lat_deg:.5f}_{lon_deg:.5f}"
    lowest_deg = np.floor(min(float(horizons.elevation_deg.min()), 0.0)) - 1.0
    lines = {
        "landscape": {
            "name": name,
            "author": "Skyline",
            "description": "Horizon of an elevation model",
            "type": "polygonal",
            "polygonal_horizon_list": "horizon.txt",
            "polygonal_horizon_list_mode": "azDeg_altDeg",
            "polygonal_angle_rotatez": "0",
            "ground_color": ".15,.25,.15",
            "minimal_altitude": f"{lowest_deg:.0f}",
        },
        "location": {
            "planet": "Earth",
            "latitude": _sexagesimal(lat_deg),
            "longitude": _sexagesimal(lon_deg),
            "altitude": f"{horizons.eye_elevation_m[0]:.0f}",
        },
    }
    ini = "\n".join(
        f"[{section}]\n" + "".join(f"{key} = {value}\n" for key, value in pairs.items())
        for section, pairs in lines.items()
    )
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        # A fixed time, so that the same horizon makes the same file.
        for file, text in (("landscape.ini", ini), ("horizon.txt", _pairs(horizons, closed=False))):
            archive.writestr(zipfile.ZipInfo(f"{folder}/{file}"), text)
    return made.getvalue()


def _sexagesimal(angle_deg: float) -> str:
    """Return an angle as Stellarium writes it: +46d45'00.0"."""
    tenths = round(abs(angle_deg) * 36000.0)
    minutes, second_tenths = divmod(tenths, 600)
    degrees, minutes = divmod(minutes, 60)
    sign = "-" if angle_deg < 0.0 else "+"
    return f"{sign}{degrees}d{minutes:02d}'{second_tenths / 10.0:04.1f}\""


_OF_MANY = {".csv": horizon_csv, ".json": _json}
"""Formats of any number of places."""
KINDS: dict[str, Callable[[LocalHorizons], str | bytes]] = {
    **_OF_MANY,
    ".txt": _pvgis,
    ".hor": _hor,
    ".sam.csv": _sam,
    ".hrz": _observers,
    ".zip": _stellarium,
}
"""The formats of `write_horizons`, by the endings of names."""
