"""Makes labelled panoramas of what is seen from a place."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyline import report
from skyline.errors import InputError
from skyline.files import write_whole
from skyline.geodesy import Curvature
from skyline.pipeline.horizon_at import horizons_of
from skyline.report.peaks import Peaks, visible_peaks
from skyline.terrain.blocks import TerrainBlocks
from skyline.terrain.heightfield import HeightField
from skyline.terrain.surface import Dem, read_surface
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M

PANORAMA_SUFFIXES = (".png", ".svg", ".pdf")
_LEAST_FOV_DEG = 5.0
_SURFACE_STEP_DEG = 0.1


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
    surface: Dem | None = None,
) -> int:
    """Draw what is seen from a place, with the names of the peaks that are seen.

    Parameters
    ----------
    lon, lat : float
        Degrees (WGS 84).
    path : str or Path
        ``.png``, ``.svg`` or ``.pdf``.
    peaks : Peaks, optional
        `skyline.read_peaks`.
    surface : path, paths or HeightField, optional
        A surface or canopy model: how far trees and houses may rise is drawn as a green line.

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
        Another suffix, a file that cannot be written, or a surface that is not over the DEM.
    ContextError
        No OpenGL context can be made, which a surface needs.
    """
    over = None if surface is None else read_surface(surface, terrain)
    config = config or PanoramaConfig()
    return save_panorama_of(TerrainBlocks.of(terrain), (lon, lat), path, peaks, config, over)


def save_panorama_of(
    blocks: TerrainBlocks,
    lonlat: tuple[float, float],
    path: str | Path,
    peaks: Peaks | None,
    config: PanoramaConfig,
    surface: HeightField | None = None,
) -> int:
    """Draw what is seen of blocks; without a surface, hidden ones are not made.

    As `save_panorama` otherwise; the surface is one that is read.
    """
    path = Path(path)
    if path.suffix.lower() not in PANORAMA_SUFFIXES:
        raise InputError(f"{path} is no picture; expected {', '.join(PANORAMA_SUFFIXES)}")
    view = panorama_view(blocks, lonlat, peaks, config, surface)
    write_whole(path, report.encode_panorama(report.draw_panorama(view), path.suffix[1:].lower()))
    return len(view.sightings)


def panorama_view(
    blocks: TerrainBlocks,
    lonlat: tuple[float, float],
    peaks: Peaks | None,
    config: PanoramaConfig,
    surface: HeightField | None = None,
) -> "report.PanoramaView":
    """Look at what one eye sees and find its peaks; see `save_panorama_of`."""
    start_deg, fov_deg = config.start_deg, config.fov_deg
    easting_m, northing_m = (float(at) for at in blocks.frame.from_lonlat(*lonlat))
    landscape = report.Landscape.of(
        blocks,
        (easting_m, northing_m),
        config.eye_height_m,
        report.picture_azimuths_deg(start_deg, fov_deg),
    )
    terrain, eye = landscape.terrain, landscape.eye
    seen = [] if peaks is None else visible_peaks(terrain, eye, peaks, Curvature())
    convergence_deg = float(blocks.frame.convergence_deg(easting_m, northing_m))
    inside = [
        one for one in seen if (one.azimuth_deg + convergence_deg - start_deg) % 360.0 < fov_deg
    ]
    surface_deg = None
    if surface is not None:
        both = horizons_of(terrain, eye, _SURFACE_STEP_DEG, surface=surface)
        surface_deg = np.interp(
            landscape.azimuth_deg, both.azimuth_deg[0], both.surface_deg[0], period=360.0
        )
    return report.PanoramaView(landscape, inside, start_deg, fov_deg, surface_deg)
