"""Reading DEM files as a `HeightField`: on one grid, cleaned, in a metric frame."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

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
from skyline.terrain.cleaning import clean
from skyline.terrain.heightfield import HeightField, Provenance, TerrainBlocks
from skyline.terrain.rasters import open_tile
from skyline.terrain.tiles import Grid, Mosaic, Tile, read_mosaic
from skyline.terrain.warp import Warp, ground_spacing_m, local_frame, square_spacing_m

CONFORMAL_DEG = 0.01
"""Greatest error of angles in a metric CRS that is used without a warning."""

TRUE_SCALE = 0.01
"""Greatest error of lengths in such a CRS, as a share."""

FAR_DEG = 10.0
"""A DEM farther than this from the area of its CRS likely has the coordinates of another CRS."""

_PROBES = 9
"""Rows and columns of places at which distortion is computed."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class DemOptions:
    """Options for reading DEM files.

    Attributes
    ----------
    crs : str or None
        Coordinate reference system of files that name none: an EPSG code or WKT. Its vertical part
        also counts for files in the same CRS that name none, such as ``EPSG:2263+6360``.
    reproject : bool
        Warp even a metric DEM to the local conformal frame, as is needed if its own CRS is not
        conformal.
    """

    crs: str | None = None
    reproject: bool = False

    def to_json(self) -> dict[str, object]:
        """Return the options by name, as JSON can hold them."""
        return asdict(self)

    @classmethod
    def from_json(cls, options: object) -> "DemOptions":
        """Return the options that a store holds; the defaults for None.

        Unknown names are left out, since other releases may write more options. Raises `InputError`
        for anything but a mapping.
        """
        if not isinstance(options, Mapping | None):
            raise InputError(f"DEM options are {options!r}; expected names and values")
        names = {field.name for field in fields(cls)}
        return cls(**{name: one for name, one in (options or {}).items() if name in names})

    @property
    def default_crs(self) -> CRS | None:
        """The CRS of files that name none, parsed; raises `InputError` if it is not understood."""
        return None if self.crs is None else parse_crs(self.crs)


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
        they overlap the first named gives the height; samples that none covers are holes.

    Returns
    -------
    HeightField
        float32 heights. Its provenance counts samples of the files: filled and hollow samples were
        voids or spikes.

    Raises
    ------
    MissingFileError
        There is no file at a path.
    InputError
        A file is not a raster of one band, is damaged, or has a rotated grid or no height at all; a
        CRS is missing, not understood, or one that PROJ cannot transform; a unit is not one of
        length; or tiles do not fit together.
    FetchError
        A server has no such file, or does not answer.
    """
    return _height_field(read_files(paths, options), options)


def read_blocks(
    paths: str | Path | Sequence[str | Path], options: DemOptions = DemOptions()
) -> TerrainBlocks:
    """Read a DEM as blocks of the field of `read_dem`, warped only where asked for.

    All samples are those of `read_dem`, to the bit. Parameters and errors are the same too.
    """
    mosaic = read_files(paths, options)
    if _is_kept(mosaic, options):
        return TerrainBlocks.of(_height_field(mosaic, options))
    warp, frame, provenance = _warp(mosaic, options)

    def field(wanted: BoolArray) -> HeightField:
        return _field(*warp.blocks_m(wanted), frame, provenance)

    return TerrainBlocks(frame, warp.target, warp.highest_m(), field)


def read_files(
    paths: str | Path | Sequence[str | Path], options: DemOptions = DemOptions()
) -> Mosaic:
    """Read files onto their own common grid, not cleaned; otherwise as `read_dem`."""
    if isinstance(paths, str | Path):
        paths = [paths]
    if not paths:
        raise InputError("no DEM file was given; name one or more")
    default_crs = options.default_crs
    return read_mosaic([open_tile(path, default_crs) for path in paths])


def dem_of(tile: Tile, options: DemOptions) -> HeightField:
    """Return a tile as a height field, as `read_dem` returns that of a file."""
    return _height_field(read_mosaic([tile]), options)


def _is_kept(mosaic: Mosaic, options: DemOptions) -> bool:
    """Return whether the heights stay on their files' own grid."""
    return is_metric(mosaic.crs) and not options.reproject


def _height_field(mosaic: Mosaic, options: DemOptions) -> HeightField:
    """Clean heights on their files' own grid, and warp them if they need a metric frame."""
    if not _is_kept(mosaic, options):
        warp, frame, provenance = _warp(mosaic, options)
        return _field(warp.heights_m(), warp.target, frame, provenance)
    grid, frame, conventions = mosaic.grid, Frame.from_crs(mosaic.crs), _placed(mosaic)
    _warn_of_distortion(grid, frame)
    counts = clean(mosaic.heights_m, mosaic.source, max(grid.step_east, grid.step_north))
    provenance = Provenance(mosaic.files, "none", *counts, options.to_json(), conventions)
    return _field(mosaic.heights_m, grid, frame, provenance)


def _warp(mosaic: Mosaic, options: DemOptions) -> tuple[Warp, Frame, Provenance]:
    """Clean heights on their files' own grid, to be warped to the frame centred on it."""
    crs, grid, conventions = mosaic.crs, mosaic.grid, _placed(mosaic)
    if crs.is_projected and not is_upright(crs):
        _log.warning(
            "%s: the axes of %s point %s; the DEM is warped to the local conformal frame",
            mosaic.source,
            crs.name,
            " and ".join(axis.direction for axis in crs.axis_info),
        )
    frame = local_frame(grid, crs)
    ground_spacing = ground_spacing_m(grid, crs, frame)
    counts = clean(mosaic.heights_m, mosaic.source, max(ground_spacing))
    spacing_m = square_spacing_m(ground_spacing)
    resampling = (
        f"cubic, once, all summits kept, from {crs.name} ({ground_spacing[0]:.2f} x "
        f"{ground_spacing[1]:.2f} m at the centre) to {spacing_m:g} m in the local conformal frame"
    )
    provenance = Provenance(mosaic.files, resampling, *counts, options.to_json(), conventions)
    return Warp(mosaic.heights_m, grid, crs, frame, spacing_m), frame, provenance


def _placed(mosaic: Mosaic) -> dict[str, str]:
    """Return conventions with the transformation to WGS 84 and its accuracy.

    Raises `InputError` for a place that is not on Earth, and warns of one far off the area for
    which the CRS is made.
    """
    crs = mosaic.crs
    lon, lat, how = to_wgs84(crs, *mosaic.grid.centre)
    if not (abs(lat) <= 90.0 and abs(lon) <= 540.0):
        x, y = mosaic.grid.centre
        raise InputError(
            f"{mosaic.source} has its middle at {x:.9g}, {y:.9g}, which is no place in {crs.name}; "
            "check its georeference and its coordinate reference system"
        )
    if off_area_deg(crs, lon, lat) > FAR_DEG:
        _log.warning(
            "%s: its middle lies at %s, %s, far off the area for which %s is made; check its "
            "coordinate reference system, and the signs and the order of its coordinates",
            mosaic.source,
            degrees_in_words(lat, "NS", 2),
            degrees_in_words(lon, "EW", 2),
            crs.name,
        )
    return {**mosaic.conventions, "to_wgs84": how}


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
