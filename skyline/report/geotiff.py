"""Square cells on the map as Cloud-Optimized GeoTIFFs."""

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from skyline.geodesy.cell_grid import CellGrid
from skyline.geodesy.map_frame import Frame

GEOTIFFS = (".tif", ".tiff")
"""Suffixes of the files."""


def geotiff(
    bands: NDArray[Any],
    grid: CellGrid,
    frame: Frame,
    *,
    colours: Sequence[str] = (),
    names: Sequence[str] = (),
    **options: Any,
) -> bytes:
    """Return bands (B, rows, cols) of cells as a GeoTIFF.

    ``colours`` and ``names`` describe each band; ``options`` are GDAL's for the file.
    """
    from rasterio.enums import ColorInterp  # noqa: PLC0415  (slow to load)
    from rasterio.io import MemoryFile  # noqa: PLC0415
    from rasterio.transform import from_origin  # noqa: PLC0415

    about = {
        "count": len(bands),
        "height": grid.rows,
        "width": grid.cols,
        "dtype": bands.dtype.name,
        "crs": frame.wkt,
        "transform": from_origin(grid.west_m, grid.north_m, grid.cell_m, grid.cell_m),
    }
    with MemoryFile() as memory:
        with memory.open(driver="COG", compress="deflate", **about, **options) as raster:
            if colours:
                raster.colorinterp = [ColorInterp[one] for one in colours]
            raster.write(bands)
            for number, name in enumerate(names, start=1):
                raster.set_band_description(number, name)
        return bytes(memory.read())
