"""Photographs that nobody took: a pin-hole camera's view of the terrain, with a known pose.

They are the queries of demos and benchmarks. The terrain is looked up in depth images, shaded
by its slope, veiled by haze and put under a sky; nothing of the pose is left in the picture.
"""

import numpy as np
from numpy.typing import NDArray

from skyline.camera import HEADINGS, rotation
from skyline.experiments.pinhole import Camera
from skyline.render.depth import DepthRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

Float64Array = NDArray[np.float64]

_SUN = np.array([-0.55, 0.62, 0.55]) / np.linalg.norm([-0.55, 0.62, 0.55])
_GROUND_RGB = np.array([[74.0, 96.0, 58.0], [120.0, 112.0, 96.0], [150.0, 146.0, 142.0]])
_HAZE_RGB = np.array([176.0, 196.0, 219.0])
_ZENITH_RGB = np.array([84.0, 134.0, 205.0])


def photograph(
    renderer: DepthRenderer, viewpoints: Viewpoints, index: int, camera: Camera, seed: int
) -> NDArray[np.uint8]:
    """Return an RGB photograph (H, W, 3) taken from one viewpoint.

    ``renderer`` should be at least twice as fine as the photograph's own pixels, since the
    skyline in the picture is as good as its depth images.
    """
    generator = np.random.default_rng(seed)
    rays = camera.rays()
    distance = _distance(renderer.depth_images(viewpoints, index), rays)
    ground = np.isfinite(distance)
    picture = _sky(rays, generator)
    points = rays[ground] * distance[ground, np.newaxis]
    easting = viewpoints.easting_m[index] + points[:, 0]
    northing = viewpoints.northing_m[index] + points[:, 2]
    colour = _shaded(renderer.field, easting, northing)
    veil = np.exp(-np.linalg.norm(points, axis=1) / 25_000.0)[:, np.newaxis]
    picture[ground] = colour * veil + _HAZE_RGB * (1.0 - veil)
    picture += generator.normal(0.0, 4.0, picture.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _distance(depth_m: NDArray[np.float32], rays: Float64Array) -> Float64Array:
    """Return the distance along each ray, in lengths of that ray; inf for sky."""
    size = depth_m.shape[-1]
    heading = np.rint(np.degrees(np.arctan2(rays[..., 0], rays[..., 2])) / 90.0).astype(int) % 4
    turns = np.stack([rotation(turn) for turn in HEADINGS])[heading]
    right, up, forward = np.moveaxis(np.einsum("hwij,hwj->hwi", turns, rays), -1, 0)
    column = np.floor((right / forward + 1.0) * size / 2.0).astype(int)
    row = np.floor((1.0 - up / forward) * size / 2.0).astype(int)
    inside = (row >= 0) & (row < size)
    depth = depth_m[heading, row.clip(0, size - 1), column.clip(0, size - 1)]
    return np.where(inside, depth / forward, np.inf)


def _shaded(field: HeightField, easting_m: Float64Array, northing_m: Float64Array) -> Float64Array:
    """Return RGB (M, 3) of the ground at map coordinates, lit by the sun."""
    row, col = field.to_grid(easting_m, northing_m)
    near_row = np.rint(row).astype(int).clip(1, max(field.rows - 2, 1))
    near_col = np.rint(col).astype(int).clip(1, max(field.cols - 2, 1))
    heights = field.heights_m
    slope_east = (heights[near_row, near_col + 1] - heights[near_row, near_col - 1]) / (
        2.0 * field.spacing_east_m
    )
    slope_north = (heights[near_row - 1, near_col] - heights[near_row + 1, near_col]) / (
        2.0 * field.spacing_north_m
    )
    normal = np.stack([-slope_east, np.ones_like(slope_east), -slope_north], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = 0.45 + 0.65 * np.clip(np.nan_to_num(normal) @ _SUN, 0.0, 1.0)
    low, high = field.height_range_m
    share = (np.nan_to_num(heights[near_row, near_col], nan=low) - low) / max(high - low, 1.0)
    steep = np.hypot(slope_east, slope_north)
    rank = np.clip(1.2 * share + 0.8 * np.nan_to_num(steep), 0.0, 2.0)
    colour = np.stack(
        [np.interp(rank, [0.0, 1.0, 2.0], _GROUND_RGB[:, band]) for band in range(3)], axis=-1
    )
    return np.asarray(colour * light[:, np.newaxis], dtype=np.float64)


def _sky(rays: Float64Array, generator: np.random.Generator) -> Float64Array:
    """Return a sky (H, W, 3), paler towards the horizon, with soft clouds."""
    up = rays[..., 1] / np.linalg.norm(rays, axis=-1)
    share = np.clip(up * 2.2, 0.0, 1.0)[..., np.newaxis]
    sky = _HAZE_RGB * 1.08 * (1.0 - share) + _ZENITH_RGB * share
    along = (rays[..., 0] + 0.7 * rays[..., 2]) / np.linalg.norm(rays, axis=-1)
    cloud = np.zeros(up.shape)
    for octave in range(1, 5):
        phase = generator.uniform(0.0, 2.0 * np.pi, 2)
        frequency = 3.0 * 1.9**octave
        cloud += (
            np.sin(along * frequency + phase[0] + 2.0 * up)
            * np.sin(up * frequency * 4.0 + phase[1])
            / 1.5**octave
        )
    cover = np.clip(cloud - 0.25, 0.0, 0.5)[..., np.newaxis]
    return np.asarray(sky + cover * (np.array([248.0, 248.0, 250.0]) - sky), dtype=np.float64)
