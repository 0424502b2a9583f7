"""Tiles: rasters of heights, described before they are read.

A tile comes from a file, an open dataset or an array.

To support a new kind of DEM, add a function here that returns a `Tile`; `open_tile` chooses it for
a path. `skyline.terrain.mosaic` then reads it, and all commands take it.
"""

import logging
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.io import DatasetReaderBase
from rasterio.transform import Affine
from rasterio.windows import Window

from skyline.arrays import BoolArray, Float32Array, Float64Array
from skyline.errors import InputError, SkylineError, library, one_line
from skyline.files.disk import STORE_SCHEMA, is_file
from skyline.files.gdal_names import archive_of, on_disk
from skyline.geodesy.crs import without_vertical
from skyline.terrain.datums import (
    SAME_UNIT,
    UNNAMED,
    Vertical,
    map_conventions,
    metres_per,
    vertical_of,
)
from skyline.terrain.dem_files import no_dem
from skyline.terrain.grid import Grid, row_strips
from skyline.terrain.raster_files import (
    bands_of,
    check_count,
    check_whole,
    filled_share,
    opened_raster,
    unpacked,
)
from skyline.terrain.repair import TALLEST_CANOPY_M

UNDECLARED_VOIDS = (-32768.0, -9999.0)
"""Values that mark a void in DEMs that do not declare them as nodata."""

EVEN = 0.05
"""Greatest distance of an array's coordinate from even steps, in samples: coordinates in float32
degrees are not exact."""

_DIMS = (("y", "x"), ("lat", "lon"), ("latitude", "longitude"), ("northing", "easting"))
"""Names of the dimensions of rows and columns."""

_EASTWARD = {"longitude", "degrees_east", "degree_east", "degrees_E", "degree_E"}
"""CF's names and units of longitudes."""

_UNIT_TAG = re.compile(r"(?:(?:vertical|elevation|height|z)[ _-]?)?unit(?:s|type)?", re.IGNORECASE)
"""Names of the tags or attributes in which programs note the unit of heights."""
_IN_BRACKETS = re.compile(r"[(\[]([^()\[\]]+)[)\]]\s*$")
"""Text in brackets at the end of a band's description, as in ``Elevation (ft)``."""

_DERIVED = re.compile(
    r"(?:(?:terrain|surface|ground)[ _-]*)?"
    r"(?:slope|aspect|hill[ _-]*shad(?:e|ing)|shaded[ _-]*relief|roughness|curvature)"
    r"(?:[ _-]*(?:angle|map))?"
    r"(?:[ _-]*(?:in )?[(\[]?(?:deg(?:ree)?s?|°|percent|%|rad(?:ian)?s?)[)\]]?)?",
    re.IGNORECASE,
)
"""Names that programs give to values derived from heights, such as slopes."""
_QUANTITY_TAGS = ("long_name", "standard_name", "NETCDF_VARNAME")
"""Tags or attributes that name what a raster's values are."""

_VOID_ATTRS = ("_FillValue", "missing_value", "nodata", "nodatavals")
"""Attributes of arrays that give the value of voids: CF's, and those of odc-geo and of xarray's
former reader of rasters."""
_NUMBER = re.compile(r"[^\s,{}]+")
_ZUNITS = re.compile(r"^\s*Zunits\s+(\S+)", re.IGNORECASE | re.MULTILINE)
"""The line of an ArcInfo ``.prj`` that names the unit of heights."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Tile:
    """One raster of heights, described but not yet read."""

    source: str
    """The name of the raster in messages."""
    crs: CRS
    """Geographic or projected, without a vertical part."""
    grid: Grid
    """North-up, whichever way the raster's rows and columns run."""
    north_up: tuple[slice, slice]
    """Index that turns an array from the raster's order into the grid's order, and back."""
    vertical: Vertical
    """The unit and the datum of its heights."""
    conventions: Mapping[str, str]
    """Units, datums, axes and marks of voids by name, in words."""
    read: Callable[[], Iterator[tuple[slice, Float32Array]]]
    """Yields slices of the raster's rows, which together cover it, and their heights: float32
    metres, NaN for voids, -inf for voids that the raster does not declare."""
    files: tuple[str, ...] = ()
    """Names from which `skyline.read_dem` reads the same heights again."""


def open_tile(source: str, default_crs: CRS | None) -> Tile:
    """Return the tile under a name that GDAL opens.

    See `skyline.terrain.dem_files.absolute_name`. Raises `InputError` or `FetchError` if it is not
    a usable DEM.
    """
    if archive_of(source):
        check_whole(source)
    return _tile_of(source, partial(opened_raster, source), default_crs, (source,))


def dataset_tile(dataset: Any, default_crs: CRS | None) -> Tile:
    """Return the tile in an open rasterio dataset; raises as `open_tile`."""
    if not isinstance(dataset, DatasetReaderBase) or dataset.closed:
        raise no_dem(dataset)
    source = str(dataset.name)
    # A warped or virtual dataset may have the name of a file, but not its heights.
    is_of_file = isinstance(dataset, rasterio.DatasetReader) and is_file(source)
    files = (str(Path(source).absolute()),) if is_of_file else ()
    return _tile_of(source, lambda **_: nullcontext(dataset), default_crs, files)


def array_tile(array: Any, default_crs: CRS | None) -> Tile:
    """Return the tile in an xarray.DataArray.

    The geotransform and the CRS are the ones that rioxarray notes, so an array that it opens has
    the same heights as the file. Raises `InputError` as `skyline.read_dem`.
    """
    if not isinstance(array, library("xarray", "a DataArray").DataArray):
        raise no_dem(array)
    source = "the DataArray" if array.name is None else f"the DataArray {array.name!r}"
    y, x = dims_of(source, array)
    # This coordinate holds the CRS.
    name = array.encoding.get("grid_mapping", array.attrs.get("grid_mapping", "spatial_ref"))
    mapping: Mapping[str, Any] = array.coords[name].attrs if name in array.coords else {}
    attrs = array.attrs
    crs = _crs_of(source, _wkt_of_mapping(source, mapping), default_crs)
    for dim in (y, x):
        if dim in array.coords:
            _check_unit(source, dim, str(array.coords[dim].attrs.get("units", "")), crs)
    transform = _transform_of_array(source, array, (y, x), mapping.get("GeoTransform"), crs)
    grid, north_up = _grid_of(source, transform, (array.sizes[y], array.sizes[x]))
    unit = str(attrs.get("units", "")) or _tagged_unit(attrs)
    vertical = vertical_of(source, crs, unit, str(attrs.get("positive", "")))
    _check_quantity(source, array.name or "", attrs, vertical)
    on_map = _on_map(source, crs)
    band = np.asarray(array.transpose(y, x, ...).values).reshape(grid.rows, grid.cols)
    # xarray moves attributes to the encoding once it has applied them.
    scale = float(attrs.get("scale_factor", 1.0))
    offset = float(attrs.get("add_offset", 0.0))
    metres = vertical.metres_per_unit
    named = (np.ravel(attrs[name]) for name in _VOID_ATTRS if name in attrs)
    void_values = [value for values in named for value in values.tolist() if value is not None]

    def read() -> Iterator[tuple[slice, Float32Array]]:
        for rows in row_strips(band):
            voids = np.zeros(band[rows].shape, dtype=np.bool_)
            for value in void_values:
                voids |= band[rows] == value
            _check_bits(source, band[rows], voids, vertical, scale)
            yield rows, _heights_of(source, band[rows], voids, scale, offset, metres)

    conventions = {**map_conventions(on_map), **vertical.conventions}
    return Tile(source, on_map, grid, north_up, vertical, conventions, read)


def _tile_of(
    source: str,
    opened: Callable[..., AbstractContextManager[Any]],
    default_crs: CRS | None,
    files: tuple[str, ...],
) -> Tile:
    """Return the tile in a dataset; reading opens the dataset again."""
    with opened(header_only=True) as dataset:
        band, alpha = _height_band(source, dataset)
        crs = _crs_of(source, None if dataset.crs is None else dataset.crs.to_wkt(), default_crs)
        transform = dataset.transform
        if dataset.driver == "AAIGrid":
            _check_corner(source, transform)
        if dataset.driver == "netCDF":
            _check_axes(source, dataset, crs)
        grid, north_up = _grid_of(source, transform, dataset.shape)
        for name, unit in dataset.tags().items():
            if name in {f"{dim}#units" for dims in _DIMS for dim in dims}:
                _check_unit(source, name.removesuffix("#units"), unit, crs)
        tags = dataset.tags() | dataset.tags(band)
        description = dataset.descriptions[band - 1] or ""
        unit = (
            dataset.units[band - 1]
            or _tagged_unit(tags)
            or _described_unit(description)
            or _unit_beside(dataset.files)
        )
        vertical = vertical_of(source, crs, unit, tags.get("positive", "up"))
        _check_quantity(source, description, tags, vertical)
        if dataset.driver == "VRT" and vertical.unit == UNNAMED:
            _check_parts(source, dataset.files[1:], default_crs)
        nodata_value = dataset.nodatavals[band - 1]
        nodata = "none declared" if nodata_value is None else f"{nodata_value:g}"
        if alpha is not None or MaskFlags.per_dataset in dataset.mask_flag_enums[band - 1]:
            nodata = "by a mask"
        on_map = _on_map(source, crs)
        conventions = {
            **map_conventions(on_map),
            **vertical.conventions,
            "pixel_is": dataset.tags().get("AREA_OR_POINT", "Area, assumed").lower(),
            "nodata": nodata,
        }

    def read() -> Iterator[tuple[slice, Float32Array]]:
        with opened() as dataset:
            scale = dataset.scales[band - 1]
            offset = dataset.offsets[band - 1]
            metres = vertical.metres_per_unit
            if dataset.driver == "AAIGrid" and is_file(on_disk(source)):
                check_count(source, dataset)
            for rows in row_strips(dataset):
                window = Window(0, rows.start, dataset.width, rows.stop - rows.start)
                values = dataset.read(band, window=window, masked=True)
                # Where a file has a mask, GDAL leaves its nodata value aside.
                voids = np.ma.getmaskarray(values) | (values.data == nodata_value)
                if alpha is not None:
                    # GDAL itself takes an alpha band for a mask only in some number types.
                    voids |= dataset.read(alpha, window=window) == 0
                _check_bits(source, values.data, voids, vertical, scale)
                yield rows, _heights_of(source, values.data, voids, scale, offset, metres)

    return Tile(source, on_map, grid, north_up, vertical, conventions, read, files)


def _check_corner(source: str, transform: Affine) -> None:
    """Raise `InputError` if the header of an ESRI ASCII grid may lack a corner."""
    if transform.c == transform.f == 0.0:
        raise InputError(
            f"{source} has its upper left corner at 0, 0, where GDAL also places a grid whose "
            "header lacks a corner; name xllcorner and yllcorner in it, or xllcenter and "
            "yllcenter, or convert the grid to GeoTIFF if it lies there"
        )


def _check_axes(source: str, dataset: Any, crs: CRS) -> None:
    """Raise `InputError` if a netCDF file's axes are not the ones that GDAL takes."""
    if crs.is_geographic:
        _check_longitudes(source, dataset)
    # GDAL takes uneven latitudes for even ones, and notes them here.
    noted = dataset.tags(ns="GEOLOCATION2").get("Y_VALUES", "")
    if latitudes := _NUMBER.findall(noted):
        _step(source, "lat", np.array(latitudes, dtype=np.float64))


def _check_longitudes(source: str, dataset: Any) -> None:
    """Raise `InputError` unless the columns of a netCDF file are longitudes.

    GDAL takes the last dimension for x, whatever its coordinates are.
    """
    named = (
        name.partition("#")[0]
        for name, text in dataset.tags().items()
        if name.endswith(("#units", "#standard_name")) and text in _EASTWARD
    )
    step_deg = dataset.transform.a
    first_deg = dataset.transform.c + 0.5 * step_deg
    for name in dict.fromkeys(named):
        with suppress(SkylineError), opened_raster(f"netcdf:{dataset.files[0]}:{name}") as axis:
            ends_deg = axis.read(1).ravel()[[0, -1]] - first_deg
            if np.abs((ends_deg + 180.0) % 360.0 - 180.0).min() > abs(step_deg):
                break
    else:
        return
    raise InputError(
        f"{source} has the dimension {name} before its latitudes, and GDAL reads it mirrored at "
        "the diagonal; expected latitude first: reorder the dimensions (ncpdq -a)"
    )


def _check_parts(source: str, parts: Sequence[str], default_crs: CRS | None) -> None:
    """Raise `InputError` if a virtual raster has lost its parts' unit.

    `gdalbuildvrt` copies neither a band's unit nor, often, the vertical part of a CRS. The first
    part that is a tile speaks for all.
    """
    for part in parts:
        with suppress(SkylineError):
            other = open_tile(part, default_crs).vertical
            break
    else:
        return
    if abs(other.metres_per_unit) != 1.0:
        raise InputError(
            f"{source} names no unit of heights, and its part {part} has heights in {other.unit}; "
            f"name the unit in both (rio edit-info --bidx 1 --units '{other.unit.split(',')[0]}' "
            f"{source}), or give the parts"
        )


def _tagged_unit(tags: Mapping[str, Any]) -> str:
    """Return the unit of length in tags, or "".

    rioxarray writes an array's attributes as tags of its file, and none as the band's unit. A tag
    that names anything else than a length is not about heights.
    """
    named = (str(tags[name]) for name in tags if _UNIT_TAG.fullmatch(str(name)))
    return next((unit for unit in named if metres_per(unit)), "")


def _described_unit(description: str) -> str:
    """Return the unit of length at the end of a band's description, or ""."""
    found = _IN_BRACKETS.search(description)
    return found[1] if found and metres_per(found[1]) else ""


def _check_quantity(source: str, name: object, tags: Mapping[str, Any], vertical: Vertical) -> None:
    """Raise `InputError` for values whose name says that they are no heights.

    Slopes and shaded reliefs of decimals may lie between the heights of flat land, so their values
    do not give them away. A unit says that values are heights, whatever their name.
    """
    if vertical.unit != UNNAMED:
        return
    for text in (str(name), *(str(tags.get(tag, "")) for tag in _QUANTITY_TAGS)):
        if _DERIVED.fullmatch(text.strip()):
            raise InputError(
                f"{source} names its values {text.strip()!r}; expected heights: give the elevation "
                "model that they were made from; if they are metres, say so (rio edit-info --bidx "
                "1 --units m)"
            )


def _unit_beside(files: Sequence[str]) -> str:
    """Return the unit of length in a raster's ``.prj``, or "".

    GDAL reads only the map from a ``.prj`` in ArcInfo's old form, which tiles of the USGS have.
    """
    for name in files:
        if name.lower().endswith(".prj") and (is_file(name) or archive_of(name)):
            with unpacked(name) as content:
                found = _ZUNITS.search(content.read().decode("latin-1"))
            if found and metres_per(found[1]):
                return found[1]
    return ""


def _height_band(source: str, dataset: Any) -> tuple[int, int | None]:
    """Return the numbers of the height band, and of the alpha band.

    Raises `InputError` unless the dataset has one band of samples on a grid.
    """
    if dataset.tags().get("schema") == STORE_SCHEMA:
        raise InputError(f"{source} is a store; name the elevation model from which it was built")
    if dataset.count == 0 and dataset.subdatasets:
        raise InputError(
            f"{source} holds several rasters; name one of them: {', '.join(dataset.subdatasets)}"
        )
    bands, alpha = bands_of(dataset)
    if len(bands) != 1:
        raise InputError(
            f"{source} has {dataset.count} bands; a DEM has one band of heights: extract it "
            "(gdal_translate -b N), and decode heights kept as colours"
        )
    band = bands[0]
    # Where values have more than 8 bits, a palette only colours the heights.
    is_indexed = dataset.colorinterp[band - 1] is ColorInterp.palette
    if is_indexed and dataset.dtypes[band - 1] == "uint8":
        raise InputError(
            f"{source} holds colours of a palette, as a picture, a scanned map or land cover does; "
            "expected heights: if its numbers are metres, say so (gdal_edit.py -colorinterp_1 gray)"
        )
    is_text = dataset.driver == "XYZ" and is_file(on_disk(source))
    # With less than a ninth of the grid filled, a sample may have no neighbour.
    if is_text and filled_share(source, dataset) < 1.0 / 9.0:
        raise InputError(
            f"{source} lists points that lie apart on a grid of {dataset.height} x "
            f"{dataset.width}; expected x, y and z row by row on a grid: interpolate them to a "
            "raster (gdal_grid)"
        )
    return band, alpha


def _check_bits(
    source: str, band: NDArray[Any], voids: BoolArray, vertical: Vertical, scale: float
) -> None:
    """Raise `InputError` for 8 bits that are no canopy and have no unit.

    Canopy models may have 8 bits. A unit or a scale says that other values are heights.
    """
    if band.dtype != np.uint8 or vertical.unit != UNNAMED or scale != 1.0:
        return
    most = band[~voids].max(initial=0)
    if most > TALLEST_CANOPY_M:
        raise InputError(
            f"{source} has 8 bits and values up to {most}, as a shaded relief, a mask or a picture "
            "has; expected heights: give the elevation model; if the values are metres, say so "
            f"(rio edit-info --bidx 1 --units m), and if {most} marks voids, declare that (rio "
            f"edit-info --nodata {most})"
        )


def _heights_of(
    source: str, band: NDArray[Any], voids: BoolArray, scale: float, offset: float, metres: float
) -> Float32Array:
    """Return heights in metres; NaN in voids, -inf in undeclared voids."""
    if not (np.isfinite([scale, offset]).all() and scale):
        raise InputError(
            f"{source} has the scale {scale:g} and the offset {offset:g}, which leave no heights; "
            "correct them (gdal_edit.py -scale 1 -offset 0)"
        )
    if band.dtype.kind not in "iuf":
        raise InputError(f"{source} holds {band.dtype} numbers; expected real heights")
    with np.errstate(over="ignore"):  # The nodata value of ArcGIS is -1.8e308.
        heights: Float32Array = band.astype(np.float32)
    heights[voids | ~np.isfinite(heights)] = np.nan
    undeclared = np.isin(heights, UNDECLARED_VOIDS)
    if (scale, offset, metres) != (1.0, 0.0, 1.0):
        heights = ((heights * scale + offset) * metres).astype(np.float32)
    heights[undeclared] = -np.inf
    return heights


def _on_map(source: str, crs: CRS) -> CRS:
    """Return a geographic or projected CRS without its vertical part.

    Raises `InputError` for any other.
    """
    if not (crs.is_geographic or crs.is_projected):
        raise InputError(
            f"{source} is in {crs.name!r}, a {crs.type_name}; expected a geographic or "
            "projected coordinate reference system: warp it first with gdalwarp"
        )
    return without_vertical(crs)


def _crs_of(source: str, wkt: str | None, default_crs: CRS | None) -> CRS:
    """Return the CRS that a raster names, else the default.

    Where the raster's CRS is the default without its vertical part, the default is returned.
    """
    if wkt is None:
        if default_crs is None:
            raise InputError(
                f"{source} has no coordinate reference system; name it with --crs, for example "
                "--crs EPSG:32632, or EPSG:4326 for degrees (in Python "
                "read_dem(files, DemOptions(crs=...)))"
            )
        return default_crs
    try:
        crs = CRS.from_wkt(wkt)
    except CRSError as error:
        raise InputError(
            f"the coordinate reference system of {source} is not understood ({error}); "
            "set a valid one in the file (gdal_edit.py -a_srs)"
        ) from error
    if default_crs is None:
        return crs
    same_map = without_vertical(crs).equals(without_vertical(default_crs), ignore_axis_order=True)
    if same_map and len(crs.axis_info) < len(default_crs.axis_info):
        return default_crs
    if not crs.equals(default_crs, ignore_axis_order=True):
        _log.warning(
            "%s names its own coordinate reference system, %s, which is used; --crs %s is only for "
            "files that name none",
            source,
            crs.name,
            default_crs.name,
        )
    return crs


def _grid_of(
    source: str, transform: Affine, shape: tuple[int, int]
) -> tuple[Grid, tuple[slice, slice]]:
    """Return the north-up grid of a raster, and `Tile.north_up`."""
    if transform.is_identity or not np.isfinite(transform).all():
        raise InputError(
            f"{source} has no georeference, so its place on the map is unknown; give a "
            "georeferenced DEM"
        )
    if abs(transform.b) > 1e-9 * abs(transform.a) or abs(transform.d) > 1e-9 * abs(transform.e):
        raise InputError(
            f"{source} has a rotated or sheared grid (geotransform {transform.to_gdal()}); "
            "expected rows along the easting and columns along the northing: straighten it first "
            "(gdalwarp)"
        )
    rows, cols = shape
    west = transform.c + 0.5 * transform.a
    north = transform.f + 0.5 * transform.e
    row_way = 1
    if transform.e > 0.0:
        row_way = -1
        north += (rows - 1) * transform.e
    col_way = 1
    if transform.a < 0.0:
        col_way = -1
        west += (cols - 1) * transform.a
    grid = Grid(west, north, abs(transform.a), abs(transform.e), rows, cols)
    return grid, (slice(None, None, row_way), slice(None, None, col_way))


def dims_of(source: str, array: Any) -> tuple[str, str]:
    """Return the dimensions of a DataArray's rows and columns.

    Raises `InputError` for unknown names.
    """
    for y, x in _DIMS:
        if y in array.dims and x in array.dims:
            if not array.size:
                raise InputError(f"{source} has no samples; check how it was cut out")
            bands = array.size // (array.sizes[y] * array.sizes[x])
            if bands != 1:
                raise InputError(
                    f"{source} has {bands} bands; a DEM has one band of heights: select it"
                )
            return y, x
    raise InputError(
        f"{source} has dimensions {', '.join(map(str, array.dims)) or 'none'}; expected "
        f"{' or '.join(f'{y}, {x}' for y, x in _DIMS)}: rename them"
    )


def _wkt_of_mapping(source: str, mapping: Mapping[str, Any]) -> str | None:
    """Return a grid mapping's CRS, as rioxarray or CF write it."""
    for name in ("crs_wkt", "spatial_ref"):
        if name in mapping:
            return str(mapping[name])
    if "grid_mapping_name" not in mapping:
        return None
    try:
        return str(CRS.from_cf(dict(mapping)).to_wkt())
    except (CRSError, KeyError) as error:
        raise InputError(
            f"the coordinate reference system of {source} is not understood "
            f"({one_line(error)}); give one by DemOptions(crs=...)"
        ) from error


def _transform_of_array(
    source: str, array: Any, dims: tuple[str, str], noted: object, crs: CRS
) -> Affine:
    """Return the geotransform of an array's coordinates.

    Where they agree with the geotransform that rioxarray ``noted``, that one is returned, since it
    is more exact. Longitudes may pass from 359.9 to 0, or from 179.9 to -180.
    """
    for dim in dims:
        if dim not in array.coords:
            raise InputError(
                f"{source} has no coordinates along {dim}, so its place on the map is unknown; "
                "assign them"
            )
    y, x = (np.asarray(array.coords[dim].values, dtype=np.float64) for dim in dims)
    if crs.is_geographic and crs.axis_info[0].unit_name == "degree":
        x = np.unwrap(x, period=360.0)
    with suppress(TypeError, ValueError):
        exact = Affine.from_gdal(*(float(number) for number in str(noted).split()))
        if all(
            np.abs(at - (start + (np.arange(at.size) + 0.5) * step)).max() < EVEN * abs(step)
            for at, start, step in ((x, exact.c, exact.a), (y, exact.f, exact.e))
        ):
            return exact
    step_y = _step(source, dims[0], y)
    step_x = _step(source, dims[1], x)
    return Affine(step_x, 0.0, x[0] - 0.5 * step_x, 0.0, step_y, y[0] - 0.5 * step_y)


def _check_unit(source: str, dim: str, unit: str, crs: CRS) -> None:
    """Raise `InputError` if coordinates and CRS differ in their length unit."""
    metres = metres_per(unit) if crs.is_projected else None
    axis = crs.axis_info[0]
    if metres and not math.isclose(metres, axis.unit_conversion_factor, rel_tol=SAME_UNIT):
        raise InputError(
            f"{source} has coordinates along {dim} in {unit!r}, and its coordinate reference "
            f"system is in {axis.unit_name}; convert the coordinates"
        )


def _step(source: str, dim: str, at: Float64Array) -> float:
    """Return the step between coordinates; raise `InputError` if uneven."""
    if at.size < 2:
        raise InputError(f"{source} has {at.size} samples along {dim}; expected 2 or more")
    step = float(at[-1] - at[0]) / (at.size - 1)
    if not np.abs(at - (at[0] + step * np.arange(at.size))).max() < EVEN * abs(step):
        raise InputError(
            f"{source} has coordinates along {dim} that are not even; resample it to a regular grid"
        )
    return step
