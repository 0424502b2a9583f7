"""Horizons as files: CSV, JSON, the horizon file of PVGIS, and a polar plot."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from skyline.errors import InputError, named
from skyline.files import write_whole
from skyline.geodesy import degrees_in_words
from skyline.solar.local_horizons import LocalHorizons


def write_horizons(horizons: LocalHorizons, path: Path) -> None:
    """Write horizons to a file in the format of its suffix.

    Raises `InputError` if the suffix is unknown, the format holds one place and there are several,
    or the file cannot be written.

    Parameters
    ----------
    path : Path
        ``.csv`` and ``.json`` hold any number of places; ``.txt`` (the horizon file of PVGIS:
        elevation angles clockwise from north, one per line, none below 0) and ``.png``, ``.svg``
        and ``.pdf`` (a polar plot) hold one.
    """
    write_whole(path, named("the kind of file", path.suffix.lower(), _KINDS)(horizons, path))


def horizon_csv(horizons: LocalHorizons) -> str:
    """Return horizons as CSV: one row per place and azimuth; unknown values are empty."""
    written, bins = _columns(horizons), horizons.azimuth_deg.shape[1]
    columns = [np.repeat(horizons.lon, bins), np.repeat(horizons.lat, bins)]
    columns += [getattr(horizons, name).ravel() for name in ("azimuth_deg", *written)]
    digits = ["%.7f", "%.7f", "%.9g", *(f"%.{digits}f" for digits in written.values())]
    text, header = io.StringIO(), ",".join(["lon", "lat", "azimuth_deg", *written])
    np.savetxt(text, np.column_stack(columns), ",".join(digits), header=header, comments="")
    return text.getvalue().replace("nan", "")


def _columns(horizons: LocalHorizons) -> dict[str, int]:
    """Return the columns written for each azimuth, with their number of decimals."""
    return {"elevation_deg": 5, "distance_m": 1} | (
        {"surface_deg": 5} if horizons.has_surface else {}
    )


def _json(horizons: LocalHorizons, _: Path) -> str:
    factors = horizons.sky_view_factor()
    places = [
        {
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


def _known(value: Any, digits: int) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None


def _pvgis(horizons: LocalHorizons, path: Path) -> str:
    _check_single(horizons, path)
    if horizons.has_surface:
        raise InputError(
            f"{path} would hold two horizons, but a PVGIS file holds one; leave --surface out, or "
            "write .csv or .json"
        )
    elevation_deg = np.maximum(horizons.elevation_deg[0], 0.0)
    if not np.isfinite(elevation_deg).all():
        raise InputError(
            f"{path} cannot be written: the horizon is unknown at some azimuths; choose a place "
            "farther from the border of the DEM"
        )
    return "".join(f"{value:.2f}\n" for value in elevation_deg)


def _plot(horizons: LocalHorizons, path: Path) -> bytes:
    """Return a polar plot: north up, the sky white, the zenith in the middle."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  (slow to load)
    from matplotlib.figure import Figure  # noqa: PLC0415

    _check_single(horizons, path)
    figure = Figure(figsize=(7.0, 7.4), layout="constrained")
    FigureCanvasAgg(figure)
    axis: Any = figure.add_subplot(projection="polar")
    axis.set(theta_zero_location="N", theta_direction=-1)
    elevation_deg = horizons.elevation_deg[0]
    azimuth = np.radians(np.append(horizons.azimuth_deg[0], 360.0))
    zenith = 90.0 - np.append(elevation_deg, elevation_deg[0])
    rim = max(90.0, float(np.nanmax(zenith, initial=90.0)))
    if horizons.has_surface:
        free = 90.0 - np.append(horizons.surface_deg[0], horizons.surface_deg[0, 0])
        axis.fill_between(
            azimuth, free, zenith, color="#8fae7c", linewidth=0, label="trees, houses"
        )
        axis.legend(loc="lower left", bbox_to_anchor=(-0.12, -0.08), fontsize=9)
    axis.fill_between(azimuth, zenith, rim, color="#b9b0a2", linewidth=0)
    axis.plot(azimuth, zenith, color="#4d4438", linewidth=1.0)
    axis.set_rlim(0.0, rim)
    rings = np.arange(15, 91, 15)
    axis.set_rgrids(rings, [f"{90 - ring}°" for ring in rings], angle=22.5, fontsize=8)
    names = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
    axis.set_thetagrids(np.arange(0, 360, 45), names)
    axis.set_title(
        f"Horizon at {degrees_in_words(horizons.lat[0], 'NS')}, "
        f"{degrees_in_words(horizons.lon[0], 'EW')}\n"
        f"eye at {horizons.eye_elevation_m[0]:.0f} m, "
        f"sky view factor {horizons.sky_view_factor()[0]:.3f}",
        fontsize=11,
    )
    picture = io.BytesIO()
    figure.savefig(picture, format=path.suffix[1:].lower(), dpi=150)
    return picture.getvalue()


def _check_single(horizons: LocalHorizons, path: Path) -> None:
    if len(horizons) != 1:
        raise InputError(
            f"{path} would hold {len(horizons)} horizons, but {path.suffix} holds one; give one "
            "place, or write .csv or .json"
        )


_KINDS: dict[str, Callable[[LocalHorizons, Path], str | bytes]] = {
    ".csv": lambda horizons, _: horizon_csv(horizons),
    ".json": _json,
    ".txt": _pvgis,
    ".png": _plot,
    ".svg": _plot,
    ".pdf": _plot,
}
SUFFIXES = tuple(_KINDS)
"""Suffixes of the files that `write_horizons` writes."""
