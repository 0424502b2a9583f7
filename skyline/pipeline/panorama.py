"""Makes labelled panoramas of what is seen from a place."""

import math
from dataclasses import dataclass
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
from skyline.report.peaks import Peaks
from skyline.report.sightings import visible_peaks
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, stand_on

PANORAMA_SUFFIXES = (".png", ".svg", ".pdf")
_WIDTH = 2048
_SHELL_DEPTH = 0.07
"""Of a shell, as a share of its distance."""
_LEAST_FOV_DEG = 5.0


@dataclass(frozen=True, slots=True)
class PanoramaConfig:
    """What a panorama shows; by default all the way round, from north to north.

    Attributes
    ----------
    heading_deg, fov_deg : float
        The picture's middle, from true north, and its angle, 5 to 360 degrees.
    eye_height_m : float
        Above ground.
    """

    heading_deg: float = 180.0
    fov_deg: float = 360.0
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M

    def __post_init__(self) -> None:
        if not (_LEAST_FOV_DEG <= self.fov_deg <= 360.0 and math.isfinite(self.heading_deg)):
            raise InputError(
                f"heading is {self.heading_deg:g} and field of view {self.fov_deg:g} degrees; "
                f"expected a field of view of {_LEAST_FOV_DEG:g} to 360"
            )

    @property
    def start_deg(self) -> float:
        """The picture's left border."""
        return (self.heading_deg - 0.5 * self.fov_deg) % 360.0


def save_panorama(
    terrain: HeightField,
    lon: float,
    lat: float,
    path: str | Path,
    peaks: Peaks | None = None,
    config: PanoramaConfig | None = None,
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
    config : PanoramaConfig, optional

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
        Another suffix, or a file that cannot be written.
    ContextError
        No OpenGL context can be made.
    """
    config = config or PanoramaConfig()
    path = Path(path)
    if path.suffix.lower() not in PANORAMA_SUFFIXES:
        raise InputError(f"{path} is no picture; expected {', '.join(PANORAMA_SUFFIXES)}")
    eye = stand_on(terrain, *terrain.frame.from_lonlat(lon, lat), config.eye_height_m)
    view = panorama_view(terrain, eye, peaks, config)
    write_whole(path, encode_panorama(draw_panorama(view), path.suffix[1:].lower()))
    return len(view.sightings)


def panorama_view(
    terrain: HeightField,
    eye: Viewpoints,
    peaks: Peaks | None,
    config: PanoramaConfig,
) -> PanoramaView:
    """Render what one eye sees and find its peaks; see `save_panorama`."""
    start_deg, fov_deg = config.start_deg, config.fov_deg
    convergence_deg = float(terrain.frame.convergence_deg(eye.easting_m[0], eye.northing_m[0]))
    off_deg = 90.0 * np.array(HEADINGS) + convergence_deg - config.heading_deg
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
