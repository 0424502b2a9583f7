"""Small elevation files with a flaw or a convention of their own."""

import json
import zipfile

import geopandas
import numpy as np
import rasterio
import xarray
from rasterio.transform import from_origin
from scenes import UTM, fractal, write_dem
from scipy.ndimage import gaussian_filter

from skyline.terrain.datums import metres_per

SIZE = 20
WHOLE = (1000.0 + np.random.default_rng(0).uniform(0.0, 20.0, (SIZE, 2 * SIZE))).astype(np.int16)
"""Two tiles side by side, the western one and the eastern one."""
TILE_WEST_M, TILE_NORTH_M, STEP_M = 500_000.0, 5_200_000.0, 30.0


def west_tile(folder):
    """Make a folder with the western tile, a.tif; return the folder."""
    folder.mkdir()
    transform = from_origin(TILE_WEST_M, TILE_NORTH_M, STEP_M, STEP_M)
    write_dem(folder / "a.tif", WHOLE[:, :SIZE], transform=transform)
    return folder


def east(path, heights=WHOLE[:, SIZE:], driver="GTiff", crs=UTM, **options):
    """Write the eastern tile, or another raster on its ground."""
    heights = np.atleast_3d(heights).transpose(2, 0, 1)
    transform = from_origin(TILE_WEST_M + SIZE * STEP_M, TILE_NORTH_M, STEP_M, STEP_M)
    path.parent.mkdir(exist_ok=True)
    with rasterio.open(
        path, "w", driver=driver, dtype=heights.dtype, count=len(heights), height=SIZE, width=SIZE,
        crs=crs, transform=transform, **options,
    ) as raster:  # fmt: skip
        raster.write(heights)
    return path


def packed(path, *files):
    """Put files into a zip archive and remove them."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            archive.write(file, f"inside/{file.name}")
            file.unlink()


def tile_at(folder, heights, row, col):
    """Write a tile whose first sample is at a row and a column of a grid of 30 m."""
    transform = from_origin(500_000.0 + 30.0 * col, 5_200_000.0 - 30.0 * row, 30.0, 30.0)
    return write_dem(folder / f"tile_{row}_{col}.tif", heights, transform=transform)


def in_unit(path, unit, values, crs=UTM, **profile):
    """Write values whose band names a unit; return the path."""
    write_dem(path, values, crs=crs, **profile)
    with rasterio.open(path, "r+") as dataset:
        dataset.units = [unit]
    return path


def side_by_side(folder, first, second):
    """Write two tiles that touch, each by its CRS and unit; return their paths."""
    paths = []
    for number, (crs, unit) in enumerate((first, second)):
        metres = metres_per(unit) or 1.0
        transform = from_origin(5e5 + 600.0 * number, 5.2e6, 30.0, 30.0)
        values = np.full((20, 20), 3000.0 / metres, np.float32)
        options = {"transform": transform, "GEOTIFF_VERSION": "1.1"}
        paths.append(in_unit(folder / f"{number}.tif", unit, values, crs, **options))
    return paths


def depths(path, depth_m=30):
    """Write a raster of one depth, positive downward; return its path."""
    write_dem(path, np.full((2, 2), depth_m, np.int16))
    with rasterio.open(path, "r+") as dataset:
        dataset.update_tags(1, positive="down")
    return path


def in_feet(path):
    """Write a raster on a map in feet that names no unit of its heights; return its path."""
    corner = from_origin(6_500_000.0, 2_300_000.0, 100.0, 100.0)
    return write_dem(path, np.full((60, 60), 1000.0, np.float32), "EPSG:2227", transform=corner)


def colours(path):
    """Write a picture with an alpha band as a raster; return its path."""
    return write_dem(path, np.ones((9, 9, 4), np.uint8), photometric="RGB", alpha="YES")


def mountains(shape=(160, 200), seed=0):
    """Return rough terrain about 1,500 m high."""
    rough = gaussian_filter(np.random.default_rng(seed).normal(size=shape), 5.0)
    return (1500.0 + 300.0 * rough / rough.std()).astype(np.float32)


def array_of(y="y", x="x"):
    """Return heights in UTM that name no CRS, as a data array."""
    heights = np.round(fractal(30, 40, seed=2) + 1000.0)
    north, east_m = 5_180_000.0 - 30.0 * np.arange(30), 6e5 + 30.0 * np.arange(40)
    return xarray.DataArray(heights, {y: north, x: east_m}, (y, x), name="height")


def clutter(folder):
    """Add the eastern tile to a folder, and eleven files that hold no heights."""
    picture = np.random.default_rng(1).integers(0, 255, (SIZE, SIZE, 3)).astype(np.uint8)
    east(folder / "b.tif")
    east(folder / "map.tif", picture)
    east(folder / "thumbnail.jpg", picture, driver="JPEG")
    east(folder / "b_hillshade.tif", picture[..., 0])
    (folder / "README.txt").write_text("tiles of the east")
    (folder / "peaks.csv").write_text("lon,lat,height\n9.1,46.2,3000\n9.25,46.9,20\n9.4,46.7,1\n")
    (folder / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0" + bytes(500))
    tracks = geopandas.GeoDataFrame(geometry=geopandas.points_from_xy([9.1], [46.2]), crs=4326)
    tracks.to_file(folder / "tracks.gpkg")
    (folder / "item.json").write_text(json.dumps({"stac_version": "1.0.0", "type": "Feature"}))
    for number in range(3):
        (folder / f"note{number}.md").write_text("#")


def ridges():
    """Return ridges from north to south that rise 15 m in 30: 27 degrees, and 59 in feet."""
    across_m = 15.0 * np.abs(np.arange(200) % 40 - 20)
    return np.tile(1000.0 + across_m, (200, 1)).astype(np.float32)


def rough_tiles(folder, row, col, raised_m):
    """Write two tiles of 80 x 80 of rough terrain, the second raised; return their paths."""
    rng, place = np.random.default_rng(4), np.arange(160)
    rough = 30.0 * place[:, np.newaxis] + 15.0 * place + rng.normal(0.0, 2.0, (160, 160))
    north, west = max(0, -row), max(0, -col)
    first = rough[north : north + 80, west : west + 80]
    second = rough[north + row :, west + col :][:80, :80] + raised_m
    return [tile_at(folder, first, 0, 0), tile_at(folder, second, row, col)]
