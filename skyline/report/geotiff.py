"""Square cells on the map as Cloud-Optimized GeoTIFFs."""

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

GEOTIFFS = (".tif", ".tiff")
"""Suffixes of the files."""


def geotiff(
    bands: NDArray[Any],
    north_west_m: tuple[float, float],
    cell_m: float,
    wkt: str,
    *,
    colours: Sequence[str] = (),
    names: Sequence[str] = (),
    **options: Any,
) -> bytes:
    """Return bands (B, rows, cols) of cells as a GeoTIFF.

    The north-western corner is an easting and a northing of the frame ``wkt``. ``colours`` and
    ``names`` describe each band; ``options`` are GDAL's for the file.
    """
    from rasterio.enums import ColorInterp  # noqa: PLC0415  (slow to load)
    from rasterio.io import MemoryFile  # noqa: PLC0415
    from rasterio.transform import from_origin  # noqa: PLC0415

    count, height, width = bands.shape
    about = {
        "count": count,
        "height": height,
        "width": width,
        "dtype": bands.dtype.name,
        "crs": wkt,
        "transform": from_origin(*north_west_m, cell_m, cell_m),
    }
    with MemoryFile() as memory:
        with memory.open(driver="COG", compress="deflate", **about, **options) as raster:
            if colours:
                raster.colorinterp = [ColorInterp[one] for one in colours]
            raster.write(bands)
            for number, name in enumerate(names, start=1):
                raster.set_band_description(number, name)
        return bytes(memory.read())
