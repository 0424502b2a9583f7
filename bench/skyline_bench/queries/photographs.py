"""Photographs that nobody took: a pin-hole camera's view of the terrain, with a known pose.

They are the queries of demos and benchmarks. The terrain is looked up in depth images, shaded
by its slope, veiled by haze and put under a sky; nothing of the pose is left in the picture.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from skyline.arrays import Float64Array
from skyline.camera import HEADINGS, rotation
from skyline.render.depth import DepthRenderer
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.queries.pinhole import Camera
from skyline_bench.queries.scenery import Scenery, ground_rgb, put_in_front, sky_rgb
from skyline_bench.queries.synthetic import SyntheticQuery

_BLUR_PX = 0.6
_NOISE = 3.0


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
    eye = float(viewpoints.easting_m[index]), float(viewpoints.northing_m[index])
    ground = np.isfinite(distance)
    picture = _scene(renderer, eye, rays, distance, ground.astype(float), Scenery(), generator)
    return _exposed(picture, generator)


def draw_photo(
    renderer: DepthRenderer, query: SyntheticQuery, seed: int, scenery: Scenery
) -> NDArray[np.uint8]:
    """Return the RGB photograph (H, W, 3) of a synthetic query, its occluders in front.

    Sky and ground meet exactly at ``query.row_px``, the border pixels mixed from both; the depth
    images behind decide only what the ground looks like. ``renderer`` must draw the terrain the
    query was made from.
    """
    generator, truth = np.random.default_rng(seed), query.truth
    size = query.skyline.width_px, query.skyline.height_px
    camera = Camera(truth.heading_deg, truth.pitch_deg, truth.roll_deg, truth.fov_deg, *size)
    viewpoint = Viewpoints(
        *(np.array([x]) for x in (truth.easting_m, truth.northing_m, truth.eye_elevation_m))
    )
    rays = camera.rays()
    distance = _distance(renderer.depth_images(viewpoint, 0), rays)
    rows = np.arange(camera.height_px)[:, np.newaxis]
    # Pixel r spans r - 0.5 to r + 0.5.
    below = np.clip(rows + 0.5 - query.row_px, 0.0, 1.0)
    share = np.where(np.isfinite(query.row_px), below, np.isfinite(distance))
    eye = truth.easting_m, truth.northing_m
    picture = _scene(renderer, eye, rays, distance, share, scenery, generator)
    for occluder in query.occluders:
        put_in_front(picture, occluder, generator)
    return _exposed(picture, generator)


def _scene(
    renderer: DepthRenderer,
    eye_m: tuple[float, float],
    rays: Float64Array,
    distance: Float64Array,
    ground_share: Float64Array,
    scenery: Scenery,
    generator: np.random.Generator,
) -> Float64Array:
    """Return ground and sky (H, W, 3), mixed by the share of ground in each pixel."""
    shown = ground_share > 0.0
    distance = _carried_up(distance)
    ridge_row = np.where(shown.any(axis=0), np.argmax(shown, axis=0), len(shown) - 1)
    sky = sky_rgb(rays, ridge_row.astype(np.float64), scenery, generator)
    shown &= np.isfinite(distance)
    points = rays[shown] * distance[shown, np.newaxis]
    place = eye_m[0] + points[:, 0], eye_m[1] + points[:, 2]
    ground = sky.copy()
    ground[shown] = ground_rgb(
        renderer.field, place, np.linalg.norm(points, axis=1), scenery, generator
    )
    share = ground_share[..., np.newaxis]
    return np.asarray(sky * (1.0 - share) + ground * share, dtype=np.float64)


def _carried_up(distance: Float64Array) -> Float64Array:
    """Return distances (H, W) with those of the sky taken from the nearest ground below."""
    height, width = distance.shape
    rows = np.arange(height)[:, np.newaxis]
    found = np.where(np.isfinite(distance), rows, height - 1)
    nearest = np.minimum.accumulate(found[::-1], axis=0)[::-1]
    return np.asarray(distance[nearest, np.arange(width)], dtype=np.float64)


def _exposed(picture: Float64Array, generator: np.random.Generator) -> NDArray[np.uint8]:
    """Return 8 bits (H, W, 3) through a lens that blurs a little and a sensor that is noisy."""
    blurred = ndimage.gaussian_filter(picture, (_BLUR_PX, _BLUR_PX, 0.0))
    noisy = blurred + generator.normal(0.0, _NOISE, picture.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


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
