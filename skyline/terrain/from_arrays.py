"""xarray's DataArrays as rasters: their grid, their CRS, their voids.

What rioxarray writes of a file it has read is taken as it stands, so that a file read with it gives
the same heights. Neither xarray nor rioxarray is imported here.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.transform import Affine

from skyline.arrays import Float32Array
from skyline.errors import InputError
from skyline.terrain.conventions import vertical_of
from skyline.terrain.tiles import (
    Tile,
    check_heights,
    crs_of,
    grid_of,
    heights_of,
    mosaic_grid,
    tile_in,
)

EVEN = 0.05
"""How far a coordinate may lie off even steps, in samples: float32 degrees do."""

_DIMS = (("y", "x"), ("lat", "lon"), ("latitude", "longitude"), ("northing", "easting"))


def read_array(array: Any, default_crs: CRS | None) -> tuple[Tile, Float32Array]:
    """Read a DataArray.

    Raises `InputError` for more than one band, dimensions that are not understood, coordinates that
    are missing or not even, no (understood) CRS.

    Returns
    -------
    tile : Tile
    heights_m : (rows, cols) float32
        On the tile's grid, north up; NaN marks voids, -inf undeclared ones.
    """
    source = "the DataArray" if array.name is None else f"the DataArray {array.name!r}"
    y, x = _dims_of(source, array)
    # The coordinate that says the CRS.
    name = array.encoding.get("grid_mapping", array.attrs.get("grid_mapping", "spatial_ref"))
    mapping: Mapping[str, Any] = array.coords[name].attrs if name in array.coords else {}
    shape = array.sizes[y], array.sizes[x]
    transform = _transform(source, array, (y, x), mapping.get("GeoTransform"))
    attrs = array.attrs
    crs = crs_of(source, _wkt(source, mapping), default_crs)
    unit, positive = (str(attrs.get(name, "")) for name in ("units", "positive"))
    vertical = vertical_of(source, crs, unit, positive)
    tile = tile_in(source, crs, grid_of(source, transform, shape), vertical, {})
    check_heights([tile])
    band = np.asarray(array.transpose(y, x, ...).values).reshape(shape)
    if band.dtype.kind not in "iuf":
        raise InputError(f"{source} holds {band.dtype} numbers; expected real heights")
    mosaic_grid([tile])  # It refuses what is too large.
    # What xarray has decoded already it notes in the encoding, not among the attributes.
    voids = np.zeros(shape, dtype=bool)
    for name in ("_FillValue", "missing_value"):
        if name in attrs:
            voids |= band == attrs[name]
    scale, offset = float(attrs.get("scale_factor", 1.0)), float(attrs.get("add_offset", 0.0))
    heights = heights_of(band, voids, scale, offset, vertical.metres)
    return tile, np.ascontiguousarray(heights[tile.north_up])


def _dims_of(source: str, array: Any) -> tuple[str, str]:
    for y, x in _DIMS:
        if y in array.dims and x in array.dims:
            bands = array.size // max(array.sizes[y] * array.sizes[x], 1)
            if bands != 1:
                raise InputError(
                    f"{source} has {bands} bands; a DEM has one band of heights: select it"
                )
            return y, x
    raise InputError(
        f"{source} has dimensions {', '.join(map(str, array.dims)) or 'none'}; expected "
        f"{' or '.join(f'{y}, {x}' for y, x in _DIMS)}: rename them"
    )


def _wkt(source: str, mapping: Mapping[str, Any]) -> str | None:
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
            f"({' '.join(str(error).split())}); give one by DemOptions(crs=...)"
        ) from error


def _transform(source: str, array: Any, dims: tuple[str, str], exact: object) -> Affine:
    """Return where pixels lie: as the file said, if the coordinates still agree."""
    axes = []
    for dim in dims:
        if dim not in array.coords:
            raise InputError(
                f"{source} has no coordinates along {dim}, so its place on the map is unknown; "
                "assign them"
            )
        axes.append(np.asarray(array.coords[dim].values, dtype=np.float64))
    y, x = axes
    said = _said_transform(exact)
    if said is not None:
        at_x = said.c + (np.arange(x.size) + 0.5) * said.a
        at_y = said.f + (np.arange(y.size) + 0.5) * said.e
        off_x, off_y = np.abs(x - at_x).max() / abs(said.a), np.abs(y - at_y).max() / abs(said.e)
        if max(off_x, off_y) < EVEN:
            return said
    step_x, step_y = _step(source, dims[1], x), _step(source, dims[0], y)
    return Affine(step_x, 0.0, x[0] - 0.5 * step_x, 0.0, step_y, y[0] - 0.5 * step_y)


def _said_transform(geotransform: object) -> Affine | None:
    """Return GDAL's six numbers, as rioxarray notes them, of a grid that is not rotated."""
    try:
        numbers = [float(number) for number in str(geotransform).split()]
    except ValueError:
        return None
    if len(numbers) != 6 or numbers[2] or numbers[4] or not (numbers[1] and numbers[5]):
        return None
    return Affine.from_gdal(*numbers)


def _step(source: str, dim: str, at: NDArray[np.float64]) -> float:
    if at.size < 2:
        raise InputError(f"{source} has {at.size} samples along {dim}; expected 2 or more")
    step = float(at[-1] - at[0]) / (at.size - 1)
    even = at[0] + step * np.arange(at.size)
    if not (step and np.abs(at - even).max() < EVEN * abs(step)):
        raise InputError(
            f"{source} has coordinates along {dim} that are not even; resample it to a regular grid"
        )
    return step
