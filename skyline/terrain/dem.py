"""Reading DEM files as a `HeightField`: on one grid, cleaned, in a metric frame.

A second model may give the surface of trees and houses over a terrain (`read_surface`).
"""

import io
import json
import logging
import math
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
from pyproj import CRS

from skyline.arrays import Float32Array, Float64Array, FloatArray
from skyline.errors import InputError, MissingFileError
from skyline.files import write_whole
from skyline.geodesy import (
    Frame,
    degrees_in_words,
    is_metric,
    is_upright,
    off_area_deg,
    parse_crs,
    to_wgs84,
)
from skyline.terrain.cleaning import clean, strips
from skyline.terrain.conventions import ELLIPSOID, GEOID
from skyline.terrain.folders import Paths, dem_names
from skyline.terrain.heightfield import HeightField, Provenance
from skyline.terrain.rasters import open_tile
from skyline.terrain.tiles import Grid, Mosaic, Tile, read_mosaic
from skyline.terrain.warp import ground_spacing_m, local_frame, square_spacing_m, warp

FAR_DEG = 10.0
"""A DEM farther than this from the area of its CRS likely has the coordinates of another CRS."""

UNKNOWN_M = 40.0
"""Height above ground assumed where a surface model has no height: that of tall trees."""

_CANOPY_MOST_M = 120.0
"""The greatest height in a canopy model; a surface model of high ground has greater ones."""
_LEAST_FOLLOW_SHARE = 0.5
"""A model that rises by less than this share of the ground's rise is a canopy model."""
_FLAT_M = 20.0
"""Standard deviation of ground that is too flat to tell by: it varies less than trees do."""
_OFFSET_M = (-10.0, 60.0)
"""Lowest and highest plausible median of a surface above the ground."""
_LOW_QUANTILE = 0.1
"""Share of an area that is taken to be open ground, where a surface is as high as the ground."""
_MUCH_UNKNOWN = 0.2
"""Share of a DEM over which a surface model may have no height without a warning."""

Dem = Paths | HeightField
"""A model: its file, its tiles, or the height field read from them."""

SUFFIX = ".terrain"
"""The suffix of files of `save_field`."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class DemOptions:
    """Options for reading DEM files.

    Attributes
    ----------
    crs : str or None
        Coordinate reference system of files that name none: an EPSG code or WKT. Its vertical part
        also counts for files in the same CRS that name none, such as ``EPSG:2263+6360``.
    """

    crs: str | None = None

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


def read_dem(paths: Dem, options: DemOptions = DemOptions()) -> HeightField:
    """Read one DEM, or several tiles of one, as a metric height field.

    Samples stand at pixel centres, as GDAL places the pixels. Spikes are removed and small voids
    filled on the files' own grid, before anything is resampled. A DEM in a metric CRS whose map is
    true here (`skyline.geodesy.Frame.untrue_deg`) keeps that grid. Any other, and one in degrees or
    feet, or whose axes point south or west, is warped once to the transverse Mercator frame centred
    on it, with every summit as high as it was (`skyline.terrain.warp.warp`); samples of the box
    around it that lie outside the DEM are NaN and counted nowhere. Heights are converted from the
    unit of the band, or of the CRS's vertical axis.

    Parameters
    ----------
    paths : path, sequence of paths or HeightField
        Rasters of one band, and perhaps an alpha band, virtual rasters and STAC items among them;
        folders and zip archives, which stand for the rasters in them; ``https://`` addresses of
        rasters; or GDAL names such as ``netcdf:topo.nc:dem``. Tiles share a CRS and a grid; where
        they overlap the first named gives the height; samples that none covers are holes. A height
        field is returned as it is, and read as it was from `save_field`.

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
    if isinstance(paths, HeightField):
        return paths
    names = dem_names(paths)
    if len(names) == 1 and Path(names[0]).suffix == SUFFIX:
        return _read_saved(Path(names[0]))
    return _height_field(read_files(names, options), options)


def read_files(paths: Paths, options: DemOptions = DemOptions()) -> Mosaic:
    """Read files onto their own common grid, not cleaned; otherwise as `read_dem`."""
    default_crs = options.default_crs
    names = dem_names(paths)
    if not names:
        raise InputError("no DEM file was given; name one or more")
    # A file that is named twice, in its folder and by itself, is read once.
    once = {Path(name).parent.resolve() / Path(name).name: name for name in names}
    return read_mosaic([open_tile(name, default_crs) for name in once.values()])


def dem_of(tile: Tile, options: DemOptions) -> HeightField:
    """Return a tile as a height field, as `read_dem` returns that of a file."""
    return _height_field(read_mosaic([tile]), options)


def _height_field(mosaic: Mosaic, options: DemOptions) -> HeightField:
    """Clean heights on their files' own grid, and warp them if they need a metric frame."""
    crs, grid, heights_m, conventions = mosaic.crs, mosaic.grid, mosaic.heights_m, _placed(mosaic)
    if not _is_warped(mosaic):
        frame, resampling = Frame.from_crs(crs), "none"
        counts = clean(heights_m, mosaic.source, max(grid.step_east, grid.step_north))
    else:
        frame = local_frame(grid, crs)
        ground_spacing = ground_spacing_m(grid, crs, frame)
        counts = clean(heights_m, mosaic.source, max(ground_spacing))
        spacing_m = square_spacing_m(ground_spacing)
        resampling = (
            f"cubic, once, all summits kept, from {crs.name} ({ground_spacing[0]:.2f} x "
            f"{ground_spacing[1]:.2f} m at the centre) to {spacing_m:g} m in the local conformal "
            "frame"
        )
        heights_m, grid = warp(heights_m, grid, crs, frame, spacing_m)
    provenance = Provenance(mosaic.files, resampling, *counts, asdict(options), conventions)
    return _field(heights_m, grid, frame, provenance)


def _is_warped(mosaic: Mosaic) -> bool:
    """Return whether a DEM needs another frame than its map; log why unless it is in degrees."""
    crs = mosaic.crs
    if not crs.is_projected:
        return True
    why = ""
    if not is_upright(crs):
        why = f"the axes of {crs.name} point {' and '.join(a.direction for a in crs.axis_info)}"
    elif is_metric(crs):
        error_deg = Frame.from_crs(crs).untrue_deg(mosaic.grid.box)
        if not error_deg:
            return False
        why = (
            f"on the map of {crs.name} slopes and directions are wrong by up to {error_deg:.2f} "
            "degrees in this DEM"
        )
    if why:
        _log.warning("%s: %s; the DEM is warped to the local conformal frame", mosaic.source, why)
    return True


def _placed(mosaic: Mosaic) -> dict[str, str]:
    """Return conventions with the transformation to WGS 84; check that the place is likely."""
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


def save_field(field: HeightField, path: Path) -> None:
    """Write a cleaned and warped field to a file that is read in a tenth of the time.

    Raises `InputError` as `write_whole`.
    """
    about = {"frame": field.frame.wkt, "provenance": asdict(field.provenance)}
    grid = (field.west_m, field.north_m, field.spacing_east_m, field.spacing_north_m)
    content = io.BytesIO()
    np.savez(content, heights_m=field.heights_m, grid=np.array(grid), about=json.dumps(about))
    write_whole(path, content.getvalue())


def _read_saved(path: Path) -> HeightField:
    """Return the height field that `save_field` wrote, else raise as `read_dem`."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as held:
            heights_m, about = held["heights_m"], json.loads(str(held["about"]))
            grid = Grid(*held["grid"].tolist(), *heights_m.shape)
        made = Provenance(**about["provenance"])
        made = replace(made, files=tuple(made.files))
        return _field(heights_m, grid, Frame(about["frame"]), made)
    except FileNotFoundError as error:
        raise MissingFileError(f"{path} does not exist; name the elevation files") from error
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path} holds no elevation model that skyline saved; remove it, or name the files"
        ) from error


def read_surface(paths: Dem, terrain: HeightField) -> HeightField:
    """Read a surface or canopy model as an upper bound for trees and houses on a terrain.

    The heights of a surface model have the terrain's datum, those of a canopy model are above the
    ground: a model that lies far below the ground, or does not rise and fall with it, is taken for
    a canopy model. Its grid and CRS may be others; files that name none have the CRS that was given
    for the terrain's.

    The field returned is on the terrain's samples, nowhere lower: the ground, plus the model's
    greatest height above it within a sample's distance, or plus `UNKNOWN_M` where the model has no
    height.

    Raises `InputError` where the model does not cover the terrain or its heights have another
    datum, and as `read_dem`.
    """
    if not isinstance(paths, HeightField):
        crs = DemOptions.from_json(terrain.provenance.options).crs
        paths = read_dem(paths, DemOptions(crs=crs))
    above_m = _above_ground_m(paths, terrain)
    wide = [
        max(1, 2 * math.ceil(coarse / fine - 1e-6) - 1)
        for coarse, fine in (
            (terrain.spacing_north_m, paths.spacing_north_m),
            (terrain.spacing_east_m, paths.spacing_east_m),
        )
    ]
    if max(wide) > 1:
        from scipy.ndimage import maximum_filter  # noqa: PLC0415  (slow to load, seldom needed)

        highest = maximum_filter(np.nan_to_num(above_m, nan=-np.inf), wide)
        above_m = np.where(np.isinf(highest), np.nan, highest)
    rise = replace(paths, heights_m=above_m)
    heights_m, unknown = np.empty_like(terrain.heights_m), 0
    for rows in strips(heights_m):
        easting, northing = _samples(terrain, rows, paths)
        over_m = rise.height_at(easting_m=easting, northing_m=northing)
        unknown += int(np.count_nonzero(np.isnan(over_m)))
        over_m = np.where(np.isnan(over_m), UNKNOWN_M, np.maximum(over_m, 0.0))
        heights_m[rows] = terrain.heights_m[rows] + over_m
    if unknown > _MUCH_UNKNOWN * heights_m.size:
        _log.warning(
            "%s has no height over %.0f %% of the DEM, where trees of %.0f m are assumed; if "
            "nothing stands there, set its voids to the height of the ground, in a canopy model "
            "to 0",
            _name_of(paths),
            100.0 * unknown / heights_m.size,
            UNKNOWN_M,
        )
    heights_m.setflags(write=False)
    return replace(terrain, heights_m=heights_m, provenance=paths.provenance)


def _above_ground_m(model: HeightField, terrain: HeightField) -> Float64Array:
    """Return the heights of a model's samples above the ground, NaN where not known."""
    above_m = np.empty(model.heights_m.shape)
    west, south, east, north = terrain.bounds_m
    reach_m = max(model.spacing_east_m, model.spacing_north_m)
    for rows in strips(model.heights_m):
        easting, northing = _samples(model, rows, terrain)
        # Samples just outside are needed for the heights between them and the border.
        for at, least, most in ((easting, west, east), (northing, south, north)):
            beside = np.clip(at, least, most)
            np.copyto(at, beside, where=np.abs(at - beside) <= reach_m)
        above_m[rows] = model.heights_m[rows] - terrain.height_at(
            easting_m=easting, northing_m=northing
        )
    known = np.isfinite(above_m)
    name = _name_of(model)
    if not known.any():
        raise InputError(
            f"{name} has no height over the DEM; give a surface model of the same area"
        )
    offset_m = float(np.median(above_m[known]))
    is_far_below = offset_m < _OFFSET_M[0]
    if model.height_range_m[1] <= _CANOPY_MOST_M and (
        is_far_below or _follow_share(model.heights_m[known], above_m[known]) < _LEAST_FOLLOW_SHARE
    ):
        return np.where(known, model.heights_m, np.nan)
    if {GEOID, ELLIPSOID} == {_surface_of(model), _surface_of(terrain)}:
        raise InputError(
            f"{name} has heights above the {_surface_of(model)}, and the DEM above the "
            f"{_surface_of(terrain)}, tens of metres apart; convert one of them (gdalwarp)"
        )
    if not _OFFSET_M[0] <= offset_m <= _OFFSET_M[1]:
        raise InputError(
            f"{name} is {offset_m:+.0f} m above the DEM in the median; expected {_OFFSET_M[0]:+g} "
            f"to {_OFFSET_M[1]:+g}: give a surface model of the DEM's vertical datum, or a canopy "
            "model in metres above ground"
        )
    lowest_m = float(np.quantile(above_m[known], _LOW_QUANTILE))
    if lowest_m > -_OFFSET_M[0]:
        _log.warning(
            "%s lies at least %.0f m above the DEM in %.0f %% of the area; unless that is forest, "
            "its heights have another vertical datum",
            name,
            lowest_m,
            100.0 * (1.0 - _LOW_QUANTILE),
        )
    return above_m


def _name_of(model: HeightField) -> str:
    return ", ".join(model.provenance.files) or "the surface"


def _surface_of(model: HeightField) -> str:
    """Return `GEOID` or `ELLIPSOID` where a model names its datum, else an empty text."""
    datum = model.provenance.conventions.get("vertical_datum", "")
    return next((one for one in (GEOID, ELLIPSOID) if datum.endswith(f"({one})")), "")


def _follow_share(heights_m: FloatArray, above_m: Float64Array) -> float:
    """Return by how much heights (N,) rise in the mean where the ground rises by a metre.

    1 for a surface model, 0 for a canopy model; 1 where the ground is flat.
    """
    ground_m = heights_m - above_m
    rise_m = ground_m - ground_m.mean()
    squared = float(rise_m @ rise_m)
    if squared <= _FLAT_M**2 * len(rise_m):
        return 1.0
    return float(rise_m @ heights_m) / squared


def _samples(field: HeightField, rows: slice, other: HeightField) -> tuple[Float64Array, ...]:
    """Return easting and northing of the samples of some rows, in the frame of another field."""
    row = np.arange(field.rows)[rows, np.newaxis]
    place = field.to_map(*np.broadcast_arrays(row, np.arange(field.cols)))
    if field.frame == other.frame:
        return place
    return other.frame.from_lonlat(*field.frame.to_lonlat(*place))
