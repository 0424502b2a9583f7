"""Reading elevation models, from files or memory, as a `HeightField`.

Their samples are put on one grid, repaired, and warped to a metric frame if necessary.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from skyline.errors import InputError
from skyline.terrain.dem_files import Paths, dem_names
from skyline.terrain.field_files import SUFFIX, read_field
from skyline.terrain.heightfield import HeightField, field_of
from skyline.terrain.kept_models import keep_model, kept_model, noted_warnings, path_of
from skyline.terrain.metric_dem import metric_dem
from skyline.terrain.provenance import DemOptions

if TYPE_CHECKING:
    from rasterio import DatasetReader
    from xarray import DataArray

    from skyline.terrain.mosaic import Mosaic
    from skyline.terrain.raster_tiles import Tile

    Dem: TypeAlias = Paths | HeightField | DataArray | DatasetReader
else:  # Neither library is loaded for those who give files.
    Dem = Paths | HeightField


def read_dem(dem: Dem, options: DemOptions | None = None) -> HeightField:
    """Read a DEM, or several tiles of one, as a height field.

    Everything in Skyline that takes a DEM takes what this function takes.

    Samples stand at pixel centres, as GDAL places the pixels. Spikes are removed and small voids
    filled on the files' own grid, before anything is resampled. A DEM in a metric CRS whose map is
    true here (`skyline.geodesy.map_frame.Frame.untrue_deg`) keeps that grid. Any other DEM, such as
    one in degrees or feet, or whose axes point south or west, is warped once to the transverse
    Mercator frame centred on it, with every summit as high as it was
    (`skyline.terrain.resampling.Warp`); samples of the box around it that lie outside the DEM are
    NaN and are not counted. Heights are converted from the unit of the band, or of the CRS's
    vertical axis.

    Parameters
    ----------
    dem : path, paths, DataArray, open dataset or HeightField
        Files: rasters of one band, and perhaps an alpha band, including virtual rasters and STAC
        items; folders and zip archives, which stand for the rasters in them; ``https://`` addresses
        of rasters; or GDAL names such as ``netcdf:topo.nc:dem``. Tiles share a CRS and a grid;
        where they overlap the first named gives the height; samples that none covers are holes.

        An `xarray.DataArray`: heights by two dimensions, ``y, x``, ``lat, lon``, ``latitude,
        longitude`` or ``northing, easting``, in any order, with even coordinates of the samples.
        Further dimensions have one entry. Its grid mapping (CF, as rioxarray writes it) gives the
        CRS, else ``options.crs``. Its attributes ``_FillValue``, ``missing_value``, ``nodata``,
        ``nodatavals``, ``scale_factor``, ``add_offset``, ``units`` and ``positive`` are applied. An
        array that rioxarray has opened gives the same heights as its file.

        A dataset of one band that rasterio has opened: a file, a `MemoryFile` or a `WarpedVRT`.

        A height field is returned unchanged, and so is one that
        `skyline.terrain.field_files.save_field` wrote.

    Returns
    -------
    HeightField
        float32 heights. Its provenance names the files, and counts their samples: filled and hollow
        samples were voids or spikes. A DataArray has no file, so a store that is built from it is
        opened with ``Matcher(store, dem=field)``.

    Raises
    ------
    MissingFileError
        There is no file at a path.
    InputError
        A file is not a raster of one band, is damaged, or has a rotated grid or no heights at all;
        a DataArray has other dimensions, or missing or uneven coordinates; a dataset is closed; a
        CRS is missing, not understood, or one that PROJ cannot transform; a unit is not one of
        length; or tiles do not fit together.
    FetchError
        A server has no such file, or does not answer.
    """
    options = options or DemOptions()
    in_memory = field_in_memory(dem, options)
    if in_memory is not None:
        return in_memory
    names = dem_names(dem)
    if len(names) == 1 and Path(names[0]).suffix == SUFFIX:
        return read_field(Path(names[0]))
    path = path_of(names, options)
    if path is None:
        return field_of(metric_dem(read_files(names, options), options))
    if kept := kept_model(path):
        return kept
    with noted_warnings() as warnings:
        dem = metric_dem(read_files(names, options), options)
    return keep_model(dem, path, warnings)


def field_in_memory(dem: Any, options: DemOptions | None = None) -> HeightField | None:
    """Return the height field of a DEM in memory; None for files.

    A DEM in memory is an array, an open dataset or a height field. Raises as `read_dem`.
    """
    if isinstance(dem, HeightField):
        return dem
    # The library that made an object is loaded; the other one need not be.
    packages = {kind.__module__.partition(".")[0] for kind in type(dem).__mro__}
    if not packages & {"xarray", "rasterio"}:
        return None
    from skyline.terrain.raster_tiles import array_tile, dataset_tile  # noqa: PLC0415  (slow)

    options = options or DemOptions()
    tile_of = array_tile if "xarray" in packages else dataset_tile
    tile = tile_of(dem, options.default_crs)
    return field_of(metric_dem(_mosaic_of([tile]), options))


def read_files(paths: Paths, options: DemOptions) -> Mosaic:
    """Read files onto their own common grid, not repaired; otherwise as `read_dem`."""
    from skyline.terrain.raster_tiles import open_tile  # noqa: PLC0415  (rasterio is slow to load)

    names = dem_names(paths)
    default_crs = options.default_crs
    if not names:
        raise InputError("no DEM file was given; name one or more")
    # A file that is named twice, in its folder and by itself, is read once.
    once = {Path(name).parent.resolve() / Path(name).name: name for name in names}
    return _mosaic_of([open_tile(name, default_crs) for name in once.values()])


def _mosaic_of(tiles: Sequence[Tile]) -> Mosaic:
    from skyline.terrain.mosaic import read_mosaic  # noqa: PLC0415  (rasterio is slow to load)

    return read_mosaic(tiles)
