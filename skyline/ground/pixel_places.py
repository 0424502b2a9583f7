"""The terrain in each pixel of a photo, as arrays and files."""

from __future__ import annotations

import io
import json
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pyproj import CRS

from skyline.arrays import Float32Array, Float64Array, ShortRepr
from skyline.errors import library, suffix_of
from skyline.files.cf import LAT, LON, METRES
from skyline.files.disk import write_whole
from skyline.geodesy.crs import WGS84
from skyline.pose.pose import Pose

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from pandas import DataFrame
    from xarray import Dataset

PIXEL_FILES = (".npz", ".tif")
_BANDS = ("distance_m", "lon", "lat", "elevation_m")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class PixelPlaces(ShortRepr):
    """The terrain that each pixel of a photo shows.

    NaN for sky.

    Attributes
    ----------
    distance_m : (H, W) float32
        Horizontal distance from the camera.
    lon, lat : (H, W) float64
        Degrees, WGS 84.
    elevation_m : (H, W) float32
        Metres above the DEM's datum.
    step : int
        Row r and column c are pixel ``step * r`` and ``step * c`` of the photo.
    crs : pyproj.CRS
        Of the longitudes and latitudes: WGS 84, or degrees on another world than the Earth.
    """

    distance_m: Float32Array
    lon: Float64Array
    lat: Float64Array
    elevation_m: Float32Array
    step: int = 1
    crs: CRS = field(default_factory=lambda: WGS84, repr=False)

    def to_xarray(self) -> Dataset:
        """Return the places as a dataset; NaN for sky.

        Returns
        -------
        xarray.Dataset
            ``distance_m`` and ``elevation_m`` by ``row_px`` and ``column_px``, with the coordinates
            ``lon`` and ``lat``.

        Raises
        ------
        InputError
            Xarray is not installed.
        """
        row_px, column_px = (self.step * np.arange(count) for count in self.lon.shape)
        dims = "row_px", "column_px"
        data: Dataset = library("xarray", "a Dataset").Dataset(
            {
                "distance_m": (dims, self.distance_m, METRES),
                "elevation_m": (dims, self.elevation_m, METRES),
            },
            {
                "lon": (dims, self.lon, LON),
                "lat": (dims, self.lat, LAT),
                "row_px": ("row_px", row_px, {"units": "px"}),
                "column_px": ("column_px", column_px, {"units": "px"}),
            },
        )
        return data

    def to_dataframe(self) -> DataFrame:
        """Return a row for each pixel that shows terrain.

        Returns
        -------
        pandas.DataFrame
            ``column_px``, ``row_px``, ``lon``, ``lat``, ``elevation_m`` and ``distance_m``.

        Raises
        ------
        InputError
            Pandas is not installed.
        """
        row, column = np.nonzero(np.isfinite(self.distance_m))
        columns = {"column_px": self.step * column, "row_px": self.step * row}
        names = "lon", "lat", "elevation_m", "distance_m"
        columns |= {name: getattr(self, name)[row, column] for name in names}
        return library("pandas", "a DataFrame").DataFrame(columns)

    def to_geodataframe(self) -> GeoDataFrame:
        """Return a point for each pixel that shows terrain.

        Returns
        -------
        geopandas.GeoDataFrame
            Points in `crs`, WGS 84 on the Earth, with the columns of `to_dataframe`.

        Raises
        ------
        InputError
            GeoPandas is not installed.
        """
        geopandas = library("geopandas", "a GeoDataFrame")
        table = self.to_dataframe()
        points = geopandas.points_from_xy(table["lon"], table["lat"])
        return geopandas.GeoDataFrame(table, geometry=points, crs=self.crs)

    def save(self, path: str | Path, pose: Pose) -> None:
        """Write the places, and the pose from which they are seen.

        Parameters
        ----------
        path : str or Path
            ``.npz`` holds the arrays by name and ``pose``, JSON as ``skyline match --json`` prints
            a candidate. ``.tif`` holds four float64 bands by name, without a georeference; the pose
            is its tag ``pose``.

        Raises
        ------
        InputError
            The suffix is a different one, or the file cannot be written.
        """
        content_of = {".npz": self._npz, ".tif": self._tiff}[suffix_of(path, PIXEL_FILES)]
        write_whole(Path(path), content_of(json.dumps(pose.to_dict())))

    def _npz(self, pose: str) -> bytes:
        """Return the arrays, and a pose as JSON, in NumPy's format."""
        file = io.BytesIO()
        arrays = {name: getattr(self, name) for name in _BANDS}
        np.savez(file, **arrays, step=self.step, pose=pose)
        return file.getvalue()

    def _tiff(self, pose: str) -> bytes:
        """Return the arrays as bands, and a pose as JSON in a tag."""
        from rasterio.errors import NotGeoreferencedWarning  # noqa: PLC0415  (slow to load)
        from rasterio.io import MemoryFile  # noqa: PLC0415

        height, width = self.lon.shape
        size = {"width": width, "height": height, "count": len(_BANDS), "dtype": "float64"}
        with MemoryFile() as memory, warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with memory.open(
                driver="GTiff", **size, nodata=np.nan, compress="deflate", BIGTIFF="IF_SAFER"
            ) as raster:
                for band, name in enumerate(_BANDS, start=1):
                    raster.write(getattr(self, name).astype(np.float64), band)
                    raster.set_band_description(band, name)
                raster.update_tags(pose=pose, step=self.step)
            return bytes(memory.read())
