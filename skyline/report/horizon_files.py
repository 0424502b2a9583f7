"""Files of horizons: CSV, JSON, and the horizon file of PVGIS."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from skyline.errors import InputError, entry_named
from skyline.files import write_whole
from skyline.horizons import LocalHorizons
from skyline.tables import csv_lines


def write_horizons(horizons: LocalHorizons, path: Path) -> None:
    """Write horizons to a file in the format of its suffix.

    ``.csv`` and ``.json`` hold any number of places; ``.txt`` (the horizon file of PVGIS: elevation
    angles clockwise from north, one per line, none below 0) holds one.

    Raises `InputError` where the suffix is unknown, the file cannot be written, or a ``.txt`` would
    hold several places, a surface, or an unknown value.
    """
    write_whole(path, entry_named("the suffix", path.suffix.lower(), KINDS)(horizons.ravel()))


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
    if len(horizons) != 1:
        raise InputError(
            f"the file would hold {len(horizons)} horizons, but .txt holds one; give one place, or "
            "write .csv or .json"
        )
    if horizons.has_surface:
        raise InputError(
            "the file would hold two horizons, but .txt holds one; leave --surface out, or write "
            ".csv or .json"
        )
    elevation_deg = np.maximum(horizons.elevation_deg[0], 0.0)
    if not np.isfinite(elevation_deg).all():
        raise InputError(
            "the horizon is unknown at some azimuths; choose a place farther from the border of "
            "the DEM, or write .csv or .json"
        )
    return "".join(f"{value:.2f}\n" for value in elevation_deg)


KINDS: dict[str, Callable[[LocalHorizons], str]] = {
    ".csv": horizon_csv,
    ".json": _json,
    ".txt": _pvgis,
}
"""The formats of `write_horizons`, by their suffixes."""
