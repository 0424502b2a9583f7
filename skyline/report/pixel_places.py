"""The places on the terrain that the pixels of a photo show, and files of them."""

import io
import json
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile

from skyline.arrays import Float32Array, Float64Array
from skyline.errors import InputError
from skyline.files import write_whole
from skyline.match.candidate import Candidate

PIXEL_FILES = (".npz", ".tif")
_BANDS = ("distance_m", "lon", "lat", "elevation_m")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PixelPlaces:
    """The place on the terrain that each pixel of a photo shows; NaN for sky.

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
    """

    distance_m: Float32Array
    lon: Float64Array
    lat: Float64Array
    elevation_m: Float32Array
    step: int = 1

    def save(self, path: str | Path, pose: Candidate) -> None:
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
            The suffix is another, or the file cannot be written.
        """
        path = Path(path)
        suffix = check_pixel_file(path)
        about = json.dumps(pose.to_dict())
        arrays = [getattr(self, name) for name in _BANDS]
        if suffix == ".npz":
            file = io.BytesIO()
            np.savez(file, **dict(zip(_BANDS, arrays, strict=True)), step=self.step, pose=about)
            write_whole(path, file.getvalue())
            return
        height, width = self.lon.shape
        size = {"width": width, "height": height, "count": len(_BANDS), "dtype": "float64"}
        with MemoryFile() as memory, warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with memory.open(
                driver="GTiff", **size, nodata=np.nan, compress="deflate", BIGTIFF="IF_SAFER"
            ) as raster:
                for band, (name, values) in enumerate(zip(_BANDS, arrays, strict=True), start=1):
                    raster.write(values.astype(np.float64), band)
                    raster.set_band_description(band, name)
                raster.update_tags(pose=about, step=self.step)
            write_whole(path, memory.read())


def check_pixel_file(path: Path) -> str:
    """Return the suffix of a file of places; `InputError` where it is of another kind."""
    suffix = path.suffix.lower()
    if suffix not in PIXEL_FILES:
        raise InputError(
            f"output is {path}; expected a name that ends in {' or '.join(PIXEL_FILES)}"
        )
    return suffix
