"""Candidates as cameras in UTM, in plain JSON: what monoplotting and photogrammetry start from."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skyline.arrays import Float64Array
from skyline.files import write_with_folders
from skyline.geodesy import Frame
from skyline.matching.ranking import Candidate
from skyline.photo.projection import Projection
from skyline.photo.query import QuerySkyline
from skyline.report.matched import Matched


def write_cameras(path: Path, matches: Sequence[Matched]) -> None:
    """Write the candidates of matches as cameras, best first.

    A point X (easting, northing, elevation) is seen at the pixel ``matrix @ rotation @ (X -
    position)``, divided by its third component: columns to the right and rows down, the middle of
    the first pixel at 0.5, 0.5. A panorama has no matrix. A wide lens may bend what it shows by
    `Candidate.distortion`.

    Raises `InputError` where the file cannot be written.
    """
    photos = [
        {
            "photo": matched.name,
            "width_px": matched.query.width_px,
            "height_px": matched.query.height_px,
            "cameras": [_camera(matched.query, one) for one in matched.candidates],
        }
        for matched in matches
    ]
    write_with_folders(path, json.dumps({"photos": photos}, indent=1).encode())


def _camera(query: QuerySkyline, candidate: Candidate) -> dict[str, object]:
    zone = int((candidate.lon + 180.0) % 360.0 // 6.0) + 1
    crs = f"EPSG:{(32600 if candidate.lat >= 0.0 else 32700) + zone}"
    utm = Frame.from_crs(crs)
    easting_m, northing_m = (float(at) for at in utm.from_lonlat(candidate.lon, candidate.lat))
    grid_deg = candidate.heading_deg - float(utm.convergence_deg(easting_m, northing_m))
    return {
        "crs": crs,
        "position_m": [easting_m, northing_m, candidate.eye_elevation_m],
        "rotation": _rotation(grid_deg, candidate.pitch_deg, candidate.roll_deg).tolist(),
        "matrix": _matrix(query, candidate.fov_deg),
        "distortion": candidate.distortion,
        "confidence": candidate.confidence,
    }


def _rotation(heading_deg: float, pitch_deg: float, roll_deg: float) -> Float64Array:
    """Return the camera's axes, right, down and forward, as rows in easting, northing and up."""
    heading, pitch, roll = np.radians((heading_deg, pitch_deg, roll_deg))
    ahead = np.array([np.sin(heading), np.cos(heading), 0.0])
    zenith = np.array([0.0, 0.0, 1.0])
    level = np.array([np.cos(heading), -np.sin(heading), 0.0])
    forward = ahead * np.cos(pitch) + zenith * np.sin(pitch)
    upright = zenith * np.cos(pitch) - ahead * np.sin(pitch)
    right = level * np.cos(roll) - upright * np.sin(roll)
    return np.stack([right, np.cross(forward, right), forward])


def _matrix(query: QuerySkyline, fov_deg: float) -> list[list[float]] | None:
    if query.projection is not Projection.PERSPECTIVE:
        return None
    focal_px = 0.5 * query.width_px / math.tan(math.radians(0.5 * fov_deg))
    middle = 0.5 * query.width_px, 0.5 * query.height_px
    return [[focal_px, 0.0, middle[0]], [0.0, focal_px, middle[1]], [0.0, 0.0, 1.0]]
