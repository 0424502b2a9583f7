"""A labelled panorama of what is seen from a place."""

import math
from pathlib import Path

import numpy as np

from skyline.arrays import Float64Array
from skyline.camera import HEADINGS
from skyline.errors import InputError
from skyline.files import write_whole
from skyline.geodesy import Curvature
from skyline.render.horizon import HorizonRenderer
from skyline.report.landscape import Landscape
from skyline.report.panorama import PanoramaView, draw_panorama, encode_panorama
from skyline.report.peaks import Peaks, visible_peaks
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, stand_on

PANORAMA_SUFFIXES = (".png", ".svg", ".pdf")
_WIDTH = 2048
_SHELL_DEPTH = 0.07
"""Of a shell, as a share of its distance."""
_LEAST_FOV_DEG = 5.0


def save_panorama(
    terrain: HeightField,
    lon: float,
    lat: float,
    path: str | Path,
    peaks: Peaks | None = None,
    heading_deg: float = 180.0,
    fov_deg: float = 360.0,
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M,
) -> int:
    """Draw what is seen from a place, with the names of the peaks that are seen.

    Parameters
    ----------
    terrain : HeightField
    lon, lat : float
        Degrees (WGS 84).
    path : str or Path
        ``.png``, ``.svg`` or ``.pdf``.
    peaks : Peaks, optional
        `skyline.read_peaks`.
    heading_deg, fov_deg : float
        The picture's middle, from true north, and its angle, 5 to 360 degrees; by default all the
        way round from north to north.
    eye_height_m : float
        Above ground.

    Returns
    -------
    int
        How many of the peaks are seen in the picture. The lower of two whose names would overlap
        goes without its name.

    Raises
    ------
    OffMapError
        The place is off the map or on a hole.
    InputError
        Another suffix, an angle out of range, or a file that cannot be written.
    ContextError
        No OpenGL context can be made.
    """
    path = Path(path)
    if path.suffix.lower() not in PANORAMA_SUFFIXES:
        raise InputError(f"{path} is no picture; expected {', '.join(PANORAMA_SUFFIXES)}")
    if not (_LEAST_FOV_DEG <= fov_deg <= 360.0 and math.isfinite(heading_deg)):
        raise InputError(
            f"heading is {heading_deg:g} and field of view {fov_deg:g} degrees; expected a field "
            f"of view of {_LEAST_FOV_DEG:g} to 360"
        )
    eye = stand_on(terrain, *terrain.frame.from_lonlat(lon, lat), eye_height_m)
    view = panorama_view(terrain, eye, peaks, heading_deg, fov_deg)
    write_whole(path, encode_panorama(draw_panorama(view), path.suffix[1:].lower()))
    return len(view.sightings)


def panorama_view(
    terrain: HeightField,
    eye: Viewpoints,
    peaks: Peaks | None,
    heading_deg: float,
    fov_deg: float,
) -> PanoramaView:
    """Render what one eye sees and find its peaks; see `save_panorama`."""
    start_deg = (heading_deg - 0.5 * fov_deg) % 360.0
    convergence_deg = float(terrain.frame.convergence_deg(eye.easting_m[0], eye.northing_m[0]))
    off_deg = 90.0 * np.array(HEADINGS) + convergence_deg - heading_deg
    away_deg = np.abs((off_deg + 180.0) % 360.0 - 180.0)
    headings = np.flatnonzero(away_deg <= 45.0 + 0.5 * fov_deg + 1.0)
    curvature = Curvature()
    with HorizonRenderer(terrain, _WIDTH, curvature, shell_edges_m=_edges_m(terrain)) as renderer:
        views = renderer.render(eye[np.zeros(len(headings), np.intp)], headings)
    # What is a little left of the picture must not be sorted to its right.
    begin = start_deg if fov_deg == 360.0 else start_deg - 0.5 * (360.0 - fov_deg)
    landscape = Landscape.of(views, convergence_deg, begin)
    seen = [] if peaks is None else visible_peaks(terrain, eye, peaks, curvature)
    inside = [
        one for one in seen if (one.azimuth_deg + convergence_deg - start_deg) % 360.0 < fov_deg
    ]
    return PanoramaView(terrain, eye, landscape, inside, start_deg, fov_deg)


def _edges_m(terrain: HeightField) -> Float64Array:
    """Return shells from underfoot to the farthest corner, none narrower than two samples."""
    west, south, east, north = terrain.bounds_m
    reach_m = math.hypot(east - west, north - south)
    edges = [0.0]
    while edges[-1] < reach_m:
        edges.append(edges[-1] + max(2.0 * terrain.spacing_m, _SHELL_DEPTH * edges[-1]))
    return np.array(edges)
