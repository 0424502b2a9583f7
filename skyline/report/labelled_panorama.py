"""Makes labelled panoramas of what is seen from a place."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyline import report
from skyline.errors import InputError
from skyline.files import write_whole
from skyline.geodesy import Curvature
from skyline.report.peaks import Peaks, Sighting, most_prominent_first, visible_peaks
from skyline.solar.horizon_at import horizons_of
from skyline.terrain.heightfield import BLOCK, HeightField, TerrainBlocks
from skyline.terrain.summits import PROMINENCE_REACH
from skyline.terrain.surface import Dem, read_surface
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, place_on

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
    summit_within_m : float, optional
        As of `skyline.horizon`.
    """

    heading_deg: float = 180.0
    fov_deg: float = 360.0
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    summit_within_m: float | None = None

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
    path: str | Path,
    *,
    lon: float,
    lat: float,
    peaks: Peaks | None = None,
    config: PanoramaConfig | None = None,
    surface: Dem | None = None,
) -> int:
    """Draw what is seen from a place, with the names of the peaks that are seen.

    Parameters
    ----------
    path : str or Path
        ``.png``, ``.svg`` or ``.pdf``.
    lon, lat : float
        Degrees (WGS 84).
    peaks : Peaks, optional
        `skyline.read_peaks`.
    surface : path, paths or HeightField, optional
        A surface or canopy model: how far trees and houses may rise is drawn as a green line.

    Returns
    -------
    int
        How many of the peaks are seen in the picture. Of two whose names would overlap, the less
        prominent goes without its name; the picture says how many do.

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
    drawn = save_panorama_of(TerrainBlocks.of(terrain), (lon, lat), path, peaks, config, over)
    return len(drawn.view.sightings)


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPanorama:
    """A panorama that has been drawn.

    Attributes
    ----------
    unnamed : int
        How many of the peaks that are seen have no room for their names.
    """

    view: "report.PanoramaView"
    unnamed: int


def save_panorama_of(
    blocks: TerrainBlocks,
    lonlat: tuple[float, float],
    path: str | Path,
    peaks: Peaks | None,
    config: PanoramaConfig,
    surface: HeightField | None = None,
) -> DrawnPanorama:
    """Draw what is seen of blocks; without a surface, hidden ones are not made.

    As `save_panorama` otherwise; the surface is one that is read.
    """
    path = Path(path)
    if path.suffix.lower() not in PANORAMA_SUFFIXES:
        raise InputError(f"{path} is no picture; expected {', '.join(PANORAMA_SUFFIXES)}")
    view = panorama_view(blocks, lonlat, peaks, config, surface)
    figure = report.draw_panorama(view)
    write_whole(path, report.encode_panorama(figure, path.suffix[1:].lower()))
    return DrawnPanorama(view, len(view.sightings) - report.count_names(figure))


def panorama_view(
    blocks: TerrainBlocks,
    lonlat: tuple[float, float],
    peaks: Peaks | None,
    config: PanoramaConfig,
    surface: HeightField | None = None,
) -> "report.PanoramaView":
    """Look at what one eye sees and find its peaks; see `save_panorama_of`."""
    start_deg, fov_deg = config.start_deg, config.fov_deg
    place_m = place_on(blocks.frame, blocks.grid.bounds, *lonlat)
    landscape = report.Landscape.of(
        blocks,
        (float(place_m[0][0]), float(place_m[1][0])),
        config.eye_height_m,
        report.picture_azimuths_deg(start_deg, fov_deg),
        config.summit_within_m,
    )
    terrain, eye = landscape.terrain, landscape.eye
    seen = [] if peaks is None else visible_peaks(terrain, eye, peaks, Curvature())
    convergence_deg = float(
        blocks.frame.convergence_deg(easting_m=eye.easting_m[0], northing_m=eye.northing_m[0])
    )
    inside = [
        one for one in seen if (one.azimuth_deg + convergence_deg - start_deg) % 360.0 < fov_deg
    ]
    if inside:
        inside = most_prominent_first(_around(blocks, inside), inside)
    surface_deg = None
    if surface is not None:
        both = horizons_of(terrain, eye, _SURFACE_STEP_DEG, surface=surface)
        surface_deg = np.interp(
            landscape.azimuth_deg, both.azimuth_deg[0], both.surface_deg[0], period=360.0
        )
    return report.PanoramaView(landscape, inside, start_deg, fov_deg, surface_deg)


def _around(blocks: TerrainBlocks, sightings: Sequence[Sighting]) -> HeightField:
    """Return the terrain around summits, of which some is hidden from the eye that sees them."""
    wanted = np.zeros(blocks.highest_m.shape, np.bool_)
    for one in sightings:
        east_m, north_m = np.abs(blocks.around_m(one.easting_m, one.northing_m))
        grid, reach = blocks.grid, PROMINENCE_REACH + 0.5 * BLOCK
        wanted |= (east_m <= reach * grid.step_east) & (north_m <= reach * grid.step_north)
    return blocks.field(wanted)
