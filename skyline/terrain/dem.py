"""DEM files to a `HeightField`: one grid, cleaned, in a metric frame."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from skyline.arrays import BoolArray, Float32Array
from skyline.errors import InputError
from skyline.geodesy import (
    Frame,
    degrees_in_words,
    is_metric,
    is_upright,
    off_area_deg,
    parse_crs,
    to_wgs84,
)
from skyline.terrain.blocks import TerrainBlocks
from skyline.terrain.cleaning import STEEPEST, fill_voids, remove_spikes, strips, void_undeclared
from skyline.terrain.from_arrays import read_array
from skyline.terrain.heightfield import HeightField, Provenance
from skyline.terrain.tiles import Grid, Tile, read_dataset, read_tiles
from skyline.terrain.warp import Warp, ground_spacing_m, local_frame, square_spacing_m

CONFORMAL_DEG = 0.01
"""A metric CRS that bends no angle by more than this is used without a word."""

TRUE_SCALE = 0.01
"""A metric CRS whose metres are within this fraction of metres on the ground is, likewise."""

FAR_DEG = 10.0
"""A DEM farther off the area of its CRS than this has coordinates of something else, likely."""

_PROBES = 9


_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class DemOptions:
    """How DEM files are read.

    Attributes
    ----------
    crs : str or None
        Coordinate reference system of files that name none: an EPSG code or WKT. Its vertical part
        also counts for files in the same CRS that name none, such as ``EPSG:2263+6360``.
    reproject : bool
        Warp a metric DEM too to the local conformal frame, for one that is not conformal.
    max_void_samples : int
        Voids of up to so many connected samples are filled; larger ones stay holes. Voids of the
        Everest tile cut into the High Sierra at 90 m and filled again were off by 14 m rms up to
        10 samples, 31 m at 50 to 100, 51 m at 200 to 500 and 295 m above 10,000.
    spike_m : float
        Least height of a spike over (or under) its surroundings, metres; infinity keeps all but
        absurd heights. See `skyline.terrain.cleaning.remove_spikes`.
    """

    crs: str | None = None
    reproject: bool = False
    max_void_samples: int = 100
    spike_m: float = 100.0

    def __post_init__(self) -> None:
        if self.max_void_samples < 0:
            raise InputError(
                f"largest void to fill is {self.max_void_samples} samples; expected 0 (fill none) "
                "or more"
            )
        if not self.spike_m > 0.0:
            raise InputError(
                f"least spike is {self.spike_m} m; expected a positive number of metres"
            )

    def to_json(self) -> dict[str, object]:
        """Return the options by name, as JSON can hold them: an infinite spike is null."""
        return asdict(self) | ({"spike_m": None} if math.isinf(self.spike_m) else {})

    @classmethod
    def from_json(cls, options: object) -> "DemOptions":
        """Return the options that `to_json` gave; the defaults for None.

        Raises
        ------
        InputError
            Not such a mapping.
        """
        if options is None:
            return cls()
        names = [field.name for field in fields(cls)]
        if not isinstance(options, Mapping) or not set(options) <= set(names):
            raise InputError(
                f"DEM options are {options!r}; expected names among {', '.join(names)}"
            )
        given = dict(options)
        if given.get("spike_m", 0.0) is None:
            given["spike_m"] = math.inf
        try:
            return cls(**given)
        except TypeError as error:
            raise InputError(f"DEM options are {options!r}; {error}") from error


def read_dem(
    paths: str | Path | Sequence[str | Path], options: DemOptions = DemOptions()
) -> HeightField:
    """Read one DEM, or several tiles of one, as a metric height field.

    Samples stand at pixel centres, as GDAL places the pixels. Spikes are removed and small voids
    filled on the files' own grid, before anything is resampled. A DEM in a metric CRS keeps that
    grid. One in degrees or feet, or whose axes point south or west, is warped once to the
    transverse Mercator frame centred on it, with every summit as high as it was
    (`skyline.terrain.warp.Warp`); samples of the box around it that lie outside the DEM are NaN and
    counted nowhere. Heights are converted from the unit of the band, or of the CRS's vertical axis.

    Parameters
    ----------
    paths : path or sequence of paths
        Rasters of one band, virtual rasters and STAC items among them; ``https://`` addresses of
        the same; or GDAL names such as ``netcdf:topo.nc:dem``. Tiles share a CRS and a grid; where
        they overlap the first named gives the height, what none covers is a hole.

    Returns
    -------
    HeightField
        float32 heights. Its provenance counts samples of the files: filled and hollow are what
        the files' voids and the spikes became.

    Raises
    ------
    MissingFileError
        A path at which there is no file.
    InputError
        Not a raster, not one band, damaged, no (understood) CRS, a CRS that PROJ cannot transform,
        a unit that is no length, a rotated grid, tiles that do not fit together, no height at all.
    FetchError
        A server that does not have it, or does not answer.
    """
    return _height_field(*read_tiles(paths, _parse_crs(options.crs)), options)


def read_blocks(
    paths: str | Path | Sequence[str | Path], options: DemOptions = DemOptions()
) -> TerrainBlocks:
    """Read a DEM as blocks of the field of `read_dem`; one that is warped is so where it is wanted.

    All samples are those of `read_dem`, to the bit. Parameters and errors are its too.
    """
    tile, heights = read_tiles(paths, _parse_crs(options.crs))
    if _is_kept(tile, options):
        return TerrainBlocks.of(_height_field(tile, heights, options))
    warp, frame, provenance = _warp(tile, heights, options)

    def field(wanted: BoolArray) -> HeightField:
        return _field(*warp.blocks_m(wanted), frame, provenance)

    return TerrainBlocks(frame, warp.target, warp.highest_m(), field)


def dem_of_dataset(dataset: Any, options: DemOptions) -> HeightField:
    """Return an open dataset as a height field; see `HeightField.from_rasterio`."""
    return _height_field(*read_dataset(dataset, _parse_crs(options.crs)), options)


def dem_of_array(data_array: Any, options: DemOptions) -> HeightField:
    """Return a DataArray as a height field; see `HeightField.from_xarray`."""
    return _height_field(*read_array(data_array, _parse_crs(options.crs)), options)


def _is_kept(tile: Tile, options: DemOptions) -> bool:
    """Whether the heights stay on their tile's own grid."""
    return is_metric(tile.crs) and not options.reproject


def _height_field(tile: Tile, heights: Float32Array, options: DemOptions) -> HeightField:
    """Clean heights on their tile's own grid, and warp them if they need a metric frame."""
    if _is_kept(tile, options):
        grid, frame, conventions = tile.grid, Frame.from_crs(tile.crs), _placed(tile)
        _warn_of_distortion(grid, frame)
        counts = clean(heights, tile.source, max(grid.step_east, grid.step_north), options)
        provenance = Provenance(tile.files, "none", *counts, options.to_json(), conventions)
        return _field(heights, grid, frame, provenance)
    warp, frame, provenance = _warp(tile, heights, options)
    return _field(warp.heights_m(), warp.target, frame, provenance)


def _warp(tile: Tile, heights: Float32Array, options: DemOptions) -> tuple[Warp, Frame, Provenance]:
    """Clean heights on their tile's own grid, to be warped to the frame centred on it."""
    crs, grid, conventions = tile.crs, tile.grid, _placed(tile)
    if crs.is_projected and not is_upright(crs):
        _log.warning(
            "%s: the axes of %s point %s; the DEM is warped to the local conformal frame",
            tile.source,
            crs.name,
            " and ".join(axis.direction for axis in crs.axis_info),
        )
    frame = local_frame(grid, crs)
    ground_spacing = ground_spacing_m(grid, crs, frame)
    counts = clean(heights, tile.source, max(ground_spacing), options)
    spacing_m = square_spacing_m(ground_spacing)
    resampling = (
        f"cubic, once, all summits kept, from {crs.name} ({ground_spacing[0]:.2f} x "
        f"{ground_spacing[1]:.2f} m at the centre) to {spacing_m:g} m in the local conformal frame"
    )
    provenance = Provenance(tile.files, resampling, *counts, options.to_json(), conventions)
    return Warp(heights, grid, crs, frame, spacing_m), frame, provenance


def _placed(tile: Tile) -> dict[str, str]:
    """Return a tile's conventions with the transformation to WGS 84 and its accuracy.

    Raises `InputError` for a place that is none on Earth, and warns of one far off the CRS's area.
    """
    crs = tile.crs
    lon, lat, how = to_wgs84(crs, *tile.grid.centre)
    if not (abs(lat) <= 90.0 and abs(lon) <= 540.0):
        x, y = tile.grid.centre
        raise InputError(
            f"{tile.source} has its middle at {x:.9g}, {y:.9g}, which is no place in {crs.name}; "
            "check its georeference and its coordinate reference system"
        )
    if off_area_deg(crs, lon, lat) > FAR_DEG:
        _log.warning(
            "%s: its middle lies at %s, %s, far off the area for which %s is made; check its "
            "coordinate reference system, and the signs and the order of its coordinates",
            tile.source,
            degrees_in_words(lat, "NS", 2),
            degrees_in_words((lon + 180.0) % 360.0 - 180.0, "EW", 2),
            crs.name,
        )
    return {**tile.conventions, "to_wgs84": how}


def _parse_crs(text: str | None) -> CRS | None:
    return None if text is None else parse_crs(text)


def clean(
    heights: Float32Array, source: str, spacing_m: float, options: DemOptions
) -> tuple[int, int, int, int]:
    """Void what is fill, remove spikes and fill small voids, in place, as `read_dem` does.

    Returns how many are filled, hollow, despiked and undeclared, as `Provenance` counts them.
    Raises `InputError` where there is no height at all.

    Parameters
    ----------
    heights : (rows, cols) float32
        As `skyline.terrain.tiles.read_mosaic` returns them; after this NaN marks every hole.
    source : str
        What errors and warnings call it.
    spacing_m : float
        The coarser of the two sample spacings, metres on the ground.
    """
    if not any(np.isfinite(heights[rows]).any() for rows in strips(heights)):
        raise InputError(
            f"{source} holds no height: all samples are nodata; check the file and its nodata value"
        )
    threshold_m = max(options.spike_m, STEEPEST * spacing_m)
    undeclared, values_m = void_undeclared(heights, threshold_m)
    if values_m:
        _log.warning(
            "%s: samples of exactly %s m with walls round them are taken as voids, since no shore "
            "is so steep; declare them to be nodata (gdal_edit.py -a_nodata)",
            source,
            " and ".join(f"{value:g}" for value in values_m),
        )
    despiked = remove_spikes(heights, spacing_m, options.spike_m)
    filled = fill_voids(heights, options.max_void_samples)
    hollow = 0
    for rows in strips(heights):
        strip = heights[rows]
        hollow += int(np.count_nonzero(np.isnan(strip)))
        strip[np.isinf(strip)] = np.nan
    return filled, hollow, despiked, undeclared


def _field(heights: Float32Array, grid: Grid, frame: Frame, provenance: Provenance) -> HeightField:
    heights.setflags(write=False)  # handed over, so that the field need not copy it
    steps = grid.step_east, grid.step_north
    return HeightField(heights, grid.west, grid.north, *steps, frame, provenance)


def _warn_of_distortion(grid: Grid, frame: Frame) -> None:
    easting, northing = np.meshgrid(
        np.linspace(grid.west, grid.east, _PROBES), np.linspace(grid.south, grid.north, _PROBES)
    )
    angle_deg = float(
        np.nanmax(frame.angular_distortion_deg(easting_m=easting, northing_m=northing))
    )
    if angle_deg > CONFORMAL_DEG:
        _log.warning(
            "%s is not conformal: over this DEM it bends angles by up to %.2f degrees; "
            "--reproject warps the DEM to a local conformal frame",
            frame.name,
            angle_deg,
        )
    scale = frame.scale(easting_m=easting, northing_m=northing)
    worst = float(scale.flat[np.nanargmax(np.abs(np.log(scale)))])
    if not math.isclose(worst, 1.0, abs_tol=TRUE_SCALE):
        _log.warning(
            "a metre on the map of %s is %.3f m on the ground in this DEM, so slopes come out "
            "wrong; --reproject warps the DEM to a local frame of true scale",
            frame.name,
            1.0 / worst,
        )
