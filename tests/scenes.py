"""Small terrains for tests."""

from dataclasses import replace

import numpy as np
import rasterio
from PIL import Image
from rasterio.io import MemoryFile
from rasterio.transform import Affine, from_origin

from skyline.geodesy.map_frame import Frame
from skyline.pose.pose import Pose
from skyline.pose.poses import Poses
from skyline.render.depth import DepthRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import stand_on
from skyline_bench.queries.made_photos import photograph
from skyline_bench.queries.pinhole import Camera
from skyline_bench.truth import closed_forms

FRAME = Frame.local(lon=9.8, lat=46.8)

UTM = "EPSG:32632"
WEST_M, NORTH_M, SPACING_M = 600_000.0, 5_180_000.0, 30.0


def candidate_at(
    easting_m, northing_m, grid_heading_deg=0.0, pitch_deg=0.0, roll_deg=0.0, fov_deg=60.0,
    *, cost=0.1, eye_elevation_m=1000.0, confidence=None, covariance_m2=None,
    confidence_1km=None, frame=FRAME, rank=1,
) -> Pose:  # fmt: skip
    """Return the candidate of one pose."""
    values = {
        "easting_m": easting_m, "northing_m": northing_m, "eye_elevation_m": eye_elevation_m,
        "grid_heading_deg": grid_heading_deg, "pitch_deg": pitch_deg, "roll_deg": roll_deg,
        "fov_deg": fov_deg, "cost": cost,
    }  # fmt: skip
    poses = Poses(**{name: np.array([float(value)]) for name, value in values.items()})
    return replace(
        poses.on_map(frame)[0], rank=rank, confidence=confidence,
        confidence_1km=confidence_1km, refined=covariance_m2 is not None,
        covariance_m2=covariance_m2,
    )  # fmt: skip


def perturbed(pose, off):
    """Return a pose of a lens that is off by the unknowns (8,) of its covariance."""
    half = np.tan(np.radians(pose.fov_deg / 2.0)) * np.exp(off[6])
    return replace(
        pose,
        easting_m=pose.easting_m + off[0],
        northing_m=pose.northing_m + off[1],
        eye_elevation_m=pose.eye_elevation_m + off[2],
        heading_deg=pose.heading_deg + np.degrees(off[3]),
        pitch_deg=pose.pitch_deg + np.degrees(off[4]),
        roll_deg=pose.roll_deg + np.degrees(off[5]),
        fov_deg=2.0 * np.degrees(np.arctan(half)),
        distortion=pose.distortion + off[7],
    )


def at_m(place):
    """Return a pair of eastings and northings as arguments."""
    return dict(zip(("easting_m", "northing_m"), place, strict=True))


def at_deg(place):
    """Return a pair of longitudes and latitudes as arguments."""
    return dict(zip(("lon", "lat"), place, strict=True))


def field_of(heights_m, spacing_m=30.0, spacing_north_m=None, west_m=0.0, north_m=0.0):
    """Make a height field of an array, row 0 north."""
    heights_m = np.asarray(heights_m)
    return HeightField(heights_m, west_m, north_m, spacing_m, spacing_north_m or spacing_m, FRAME)


def scattered(field, count, seed, bounds_m=None, eye_height_m=2.0):
    """Return eyes at random places of a field, or of a part of it, that are on no hole."""
    generator = np.random.default_rng(seed)
    west, south, east, north = bounds_m or field.bounds_m
    easting = generator.uniform(west, east, 4 * count)
    northing = generator.uniform(south, north, 4 * count)
    standing = ~np.isnan(field.height_at(easting_m=easting, northing_m=northing))
    places = easting[standing][:count], northing[standing][:count]
    return stand_on(field, **at_m(places), eye_height_m=eye_height_m)


def field_from(function, size, spacing_m):
    """Sample height = function(east, north) on a square grid centred on the origin."""
    half = (size - 1) / 2.0 * spacing_m
    east = np.arange(size) * spacing_m - half
    heights = function(east[np.newaxis, :], -east[:, np.newaxis]) + np.zeros((size, size))
    return field_of(heights, spacing_m, west_m=-half, north_m=half)


def fractal(rows, cols, relief_m=800.0, seed=0, exponent=2.2):
    """Return rough terrain with a power-law spectrum, float32."""
    return (relief_m * closed_forms.fractal(rows, cols, seed, exponent)).astype(np.float32)


def write_dem(path, heights, crs=UTM, tags=None, **options):
    """Write heights (rows, cols) or (rows, cols, bands) as a GeoTIFF; return its path."""
    heights = np.atleast_3d(heights).transpose(2, 0, 1)
    given = {"transform": Affine(SPACING_M, 0.0, WEST_M, 0.0, -SPACING_M, NORTH_M)} | options
    given |= dict(zip(("count", "height", "width"), heights.shape, strict=True))
    with rasterio.open(path, "w", driver="GTiff", dtype=heights.dtype, crs=crs, **given) as raster:
        raster.update_tags(**(tags or {}))
        raster.write(heights)
    return path


def across_antimeridian(path):
    """Write a DEM of which UTM 60 S has the antimeridian at easting 819,450; return its path."""
    grid = Affine(SPACING_M, 0.0, 817_650.0, 0.0, -SPACING_M, 8_119_650.0)
    return write_dem(path, fractal(110, 120), "EPSG:32760", transform=grid)


def geotiff_of(heights, *given, **options):
    """Return the bytes of a GeoTIFF; see `write_dem`."""
    with MemoryFile() as memory:
        write_dem(memory.name, heights, *given, **options)
        return memory.read()


def degree_tile(heights, lon, lat):
    """Return the bytes of a GeoTIFF over a degree, whose south-western corner is given."""
    step = 1 / len(heights)
    return geotiff_of(heights, "EPSG:4326", transform=from_origin(lon, lat + 1, step, step))


def take_photo(path, terrain, eye, heading_deg=140.0, width_px=1024, **options):
    """Photograph terrain from an eye, 60 degrees wide; return the picture's path."""
    with DepthRenderer(terrain, width_px) as renderer:
        picture = photograph(renderer, eye, 0, Camera(heading_deg, fov_deg=60.0), seed=3)
    Image.fromarray(picture).save(path, quality=92, **options)
    return path
