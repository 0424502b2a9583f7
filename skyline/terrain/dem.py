"""Reading of DEM files as a `HeightField`.

Their samples are put on one grid, repaired, and warped to a metric frame if need be.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from skyline.errors import InputError
from skyline.terrain.dem_files import Paths, dem_names
from skyline.terrain.field_files import SUFFIX, read_field
from skyline.terrain.heightfield import HeightField, field_of
from skyline.terrain.kept_models import keep_model, kept_model, noted_warnings, place_of
from skyline.terrain.metric_dem import metric_dem
from skyline.terrain.provenance import DemOptions

if TYPE_CHECKING:
    from skyline.terrain.mosaic import Mosaic

Dem = Paths | HeightField
"""A model: its file, its tiles, or the height field read from them."""


def read_dem(paths: Dem, options: DemOptions | None = None) -> HeightField:
    """Read a DEM, or several tiles of one, as a height field.

    Samples stand at pixel centres, as GDAL places the pixels. Spikes are removed and small voids
    filled on the files' own grid, before anything is resampled. A DEM in a metric CRS whose map is
    true here (`skyline.geodesy.map_frame.Frame.untrue_deg`) keeps that grid. Any other, and one in
    degrees or feet, or whose axes point south or west, is warped once to the transverse Mercator
    frame centred on it, with every summit as high as it was (`skyline.terrain.resampling.Warp`);
    samples of the box around it that lie outside the DEM are NaN and counted nowhere. Heights are
    converted from the unit of the band, or of the CRS's vertical axis.

    Parameters
    ----------
    paths : path, sequence of paths or HeightField
        Rasters of one band, and perhaps an alpha band, virtual rasters and STAC items among them;
        folders and zip archives, which stand for the rasters in them; ``https://`` addresses of
        rasters; or GDAL names such as ``netcdf:topo.nc:dem``. Tiles share a CRS and a grid; where
        they overlap the first named gives the height; samples that none covers are holes. A height
        field is returned unchanged, and so is one that `skyline.terrain.field_files.save_field`
        wrote.

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
    options = options or DemOptions()
    names = dem_names(paths)
    if len(names) == 1 and Path(names[0]).suffix == SUFFIX:
        return read_field(Path(names[0]))
    place = place_of(names, options)
    if place is None:
        return field_of(metric_dem(_read(names, options), options))
    if kept := kept_model(place):
        return kept
    with noted_warnings() as warnings:
        dem = metric_dem(_read(names, options), options)
    return keep_model(dem, place, warnings)


def read_files(paths: Paths, options: DemOptions | None = None) -> "Mosaic":
    """Read files onto their own common grid, not repaired; otherwise as `read_dem`."""
    return _read(dem_names(paths), options or DemOptions())


def _read(names: Sequence[str], options: DemOptions) -> "Mosaic":
    from skyline.terrain.mosaic import read_mosaic  # noqa: PLC0415  (rasterio is slow to load)
    from skyline.terrain.raster_tiles import open_tile  # noqa: PLC0415

    default_crs = options.default_crs
    if not names:
        raise InputError("no DEM file was given; name one or more")
    # A file that is named twice, in its folder and by itself, is read once.
    once = {Path(name).parent.resolve() / Path(name).name: name for name in names}
    return read_mosaic([open_tile(name, default_crs) for name in once.values()])
