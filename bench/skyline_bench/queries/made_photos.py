"""Made photographs: pin-hole views of terrain, with known poses.

Demos and benchmarks match them. The terrain is looked up in depth images, shaded by its slope,
veiled by haze and put under a sky. The file does not contain the pose.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from skyline.arrays import Float32Array, Float64Array
from skyline.render.depth import DepthRenderer
from skyline.skylines import HEADINGS, rotation
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.queries.pinhole import Camera

_SUN = np.array([-0.55, 0.62, 0.55]) / np.linalg.norm([-0.55, 0.62, 0.55])
_MEADOW_RGB = np.array([92.0, 112.0, 62.0])
_FOREST_RGB = np.array([44.0, 60.0, 40.0])
_ROCK_RGB = np.array([128.0, 120.0, 110.0])
_SNOW_RGB = np.array([240.0, 242.0, 248.0])
_HAZE_RGB = np.array([188.0, 203.0, 220.0])
_ZENITH_RGB = np.array([84.0, 134.0, 205.0])
_CLOUD_RGB = np.array([240.0, 241.0, 243.0])

_KOSCHMIEDER = 3.912
"""At the visibility, 2 % of a dark object's contrast is left (Koschmieder 1924)."""


@dataclass(frozen=True, slots=True)
class Scenery:
    """Weather and season of a drawn photograph."""

    visibility_m: float = 80_000.0  # Distance at which 2 % of the contrast are left
    snow_line_m: float = np.inf  # Height above which ground that is not too steep is white
    tree_line_m: float = 1900.0  # Height below which there is forest
    clouds: float = 0.3  # How much of the sky is covered, 0 to 1; they gather about the ridge
    fog_m: float = np.inf  # Distance at which fog leaves 2 % of the contrast; it hides the sky too


_Range = tuple[float, float]


def drawn_scenery(
    rng: np.random.Generator,
    visibility_m: _Range,
    snow_line_m: _Range,
    tree_line_m: _Range,
    clouds: _Range = (0.0, 1.0),
) -> Scenery:
    """Draw weather and season from ranges; there is no snow in half of them."""
    return Scenery(
        visibility_m=float(np.exp(rng.uniform(*np.log(visibility_m)))),
        snow_line_m=float(rng.choice([np.inf, rng.uniform(*snow_line_m)])),
        tree_line_m=float(rng.uniform(*tree_line_m)),
        clouds=float(rng.uniform(*clouds)),
    )


def ground_rgb(
    field: HeightField,
    place_m: tuple[Float64Array, Float64Array],
    distance_m: Float64Array,
    scenery: Scenery,
    generator: np.random.Generator,
) -> Float64Array:
    """Return the RGB (M, 3) of ground at map coordinates.

    Coordinates are easting and northing, (M,) each. Distances (M,) are from the camera. The
    generator draws where meadows and forests are.
    """
    height_m, slope_east, slope_north = _sampled(field, *place_m)
    normal = np.stack([-slope_east, np.ones_like(slope_east), -slope_north], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = 0.4 + 0.75 * np.clip(normal @ _SUN, 0.0, 1.0)
    rough = _texture(place_m, distance_m, generator)
    steep = np.hypot(slope_east, slope_north)
    colour = mixed(_MEADOW_RGB, _ROCK_RGB, np.clip(2.2 * steep - 0.9 + 0.5 * rough, 0.0, 1.0))
    forest = np.clip((scenery.tree_line_m - height_m) / 150.0 + 1.2 * rough, 0.0, 1.0)
    colour = mixed(colour, _FOREST_RGB, forest)
    snow = np.clip((height_m - scenery.snow_line_m) / 120.0 + 1.5 * rough, 0.0, 1.0)
    colour = mixed(colour, _SNOW_RGB, snow * np.clip(2.6 - 1.6 * steep, 0.0, 1.0))
    colour = colour * (light * (1.0 + 0.2 * rough))[:, np.newaxis]
    veil = 1.0 - np.exp(-_KOSCHMIEDER * distance_m / scenery.visibility_m)
    return mixed(colour, _HAZE_RGB, veil)


def sky_rgb(
    rays: Float64Array, ridge_row: Float64Array, scenery: Scenery, generator: np.random.Generator
) -> Float64Array:
    """Return a sky (H, W, 3) along rays (H, W, 3).

    Clouds lie about the ridge's rows (W,).
    """
    height, width = rays.shape[:2]
    up = rays[..., 1] / np.hypot(rays[..., 0], rays[..., 2])
    sky = mixed(_HAZE_RGB * 1.04, _ZENITH_RGB, np.clip(up / 0.6, 0.0, 1.0))
    if scenery.clouds == 0.0:
        return sky
    cloud = np.zeros_like(up)
    # Sizes of clouds as shares of the image's width, and how much each counts.
    for scale, weight in ((0.25, 0.5), (0.09, 0.3), (0.03, 0.2)):
        cloud += weight * _image_noise(generator, (height, width), width * scale)
    columns = np.arange(width)
    ridge = np.clip(np.nan_to_num(ridge_row), 0, height - 1).astype(np.intp)
    over_ridge = up - up[ridge, columns]
    near = np.exp(-((over_ridge / 0.12) ** 2))
    cover = np.clip(2.0 * (cloud + scenery.clouds * (0.4 + 1.2 * near) - 0.5), 0.0, 1.0)
    return mixed(sky, _CLOUD_RGB * (0.97 + 0.03 * cloud[..., np.newaxis]), cover)


def mixed(first: Float64Array, second: Float64Array, share: Float64Array) -> Float64Array:
    """Return the first colour with a share (...) of the second."""
    part = share[..., np.newaxis]
    return np.asarray(first * (1.0 - part) + second * part, dtype=np.float64)


def _sampled(
    field: HeightField, easting_m: Float64Array, northing_m: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return heights and slopes towards east and north, smooth between samples."""
    row, col = field.to_grid(easting_m=easting_m, northing_m=northing_m)
    top = int(np.clip(np.floor(row.min()) - 1, 0, field.rows - 2))
    left = int(np.clip(np.floor(col.min()) - 1, 0, field.cols - 2))
    bottom = int(np.clip(np.ceil(row.max()) + 2, top + 2, field.rows))
    right = int(np.clip(np.ceil(col.max()) + 2, left + 2, field.cols))
    part = np.nan_to_num(field.heights_m[top:bottom, left:right].astype(np.float32))
    south, east = np.gradient(part, field.spacing_north_m, field.spacing_east_m)
    at = (col - left).astype(np.float32), (row - top).astype(np.float32)
    grids = map(np.asarray, (part, east, south))
    heights, slope_east, slope_south = (_looked_up(grid, *at) for grid in grids)
    return heights, slope_east, -slope_south


def _looked_up(grid: Float32Array, col: Float32Array, row: Float32Array) -> Float64Array:
    """Return bilinear values (M,) of a grid, its border continued."""
    found = ndimage.map_coordinates(grid, [row, col], np.float64, order=1, mode="nearest")
    return np.asarray(found)


def _texture(
    place_m: tuple[Float64Array, Float64Array],
    distance_m: Float64Array,
    generator: np.random.Generator,
) -> Float64Array:
    """Return patches (M,) about 0, fixed to the ground.

    The finest patches are only nearby.
    """
    total = np.zeros_like(distance_m)
    count = 128  # Cells of a pattern, which repeats
    for scale_m in (900.0, 160.0, 35.0, 8.0, 2.0):
        cells = generator.uniform(-1.0, 1.0, (count, count))
        tiled = np.pad(cells, (0, 1), mode="wrap").astype(np.float32)
        col, row = (np.mod(part / scale_m, count) for part in place_m)
        fades = np.clip(300.0 * scale_m / np.maximum(distance_m, 1.0), 0.0, 1.0)
        total += fades * _looked_up(tiled, col.astype(np.float32), row.astype(np.float32)) / 2.0
    return total


def _image_noise(
    generator: np.random.Generator, shape: tuple[int, int], scale_px: float
) -> Float64Array:
    """Return smooth noise (H, W) of deviation about 1, stretched sideways."""
    cells = [max(round(2.0 * shape[0] / scale_px), 2), max(round(shape[1] / scale_px), 2)]
    coarse = generator.standard_normal((cells[0] + 3, cells[1] + 3)).astype(np.float32)
    smooth = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(smooth, dtype=np.float64)


def photograph(
    renderer: DepthRenderer,
    viewpoints: Viewpoints,
    index: int,
    camera: Camera,
    seed: int,
    scenery: Scenery = Scenery(),
) -> NDArray[np.uint8]:
    """Return an RGB photograph (H, W, 3) taken from one viewpoint.

    ``renderer`` should be at least twice as fine as the photograph's own pixels, since the skyline
    in the picture is only as good as its depth images.
    """
    generator = np.random.default_rng(seed)
    rays = camera.rays()
    distance = distance_along(renderer.depth_images(viewpoints, index), rays)
    eye = float(viewpoints.easting_m[index]), float(viewpoints.northing_m[index])
    ground = np.isfinite(distance)
    picture = scene_rgb(renderer, eye, rays, distance, ground.astype(float), scenery, generator)
    if np.isfinite(scenery.fog_m):
        away_m = distance * np.linalg.norm(rays, axis=-1)
        picture = mixed(picture, _HAZE_RGB, 1.0 - np.exp(-_KOSCHMIEDER * away_m / scenery.fog_m))
    return exposed(picture, generator)


def scene_rgb(
    renderer: DepthRenderer,
    eye_m: tuple[float, float],
    rays: Float64Array,
    distance: Float64Array,
    ground_share: Float64Array,
    scenery: Scenery,
    generator: np.random.Generator,
) -> Float64Array:
    """Return a picture (H, W, 3) of ground and sky.

    They are mixed by the share of ground in each pixel.
    """
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
    return mixed(sky, ground, ground_share)


def _carried_up(distance: Float64Array) -> Float64Array:
    """Return distances (H, W) that go on into the sky.

    A pixel of sky has the distance of the nearest ground below it.
    """
    height, width = distance.shape
    rows = np.arange(height)[:, np.newaxis]
    found = np.where(np.isfinite(distance), rows, height - 1)
    nearest = np.minimum.accumulate(found[::-1], axis=0)[::-1]
    return np.asarray(distance[nearest, np.arange(width)], dtype=np.float64)


def exposed(picture: Float64Array, generator: np.random.Generator) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) as a camera takes it, uint8.

    The lens blurs a little, and the sensor is noisy.
    """
    blurred = ndimage.gaussian_filter(picture, (0.6, 0.6, 0.0))
    noisy = blurred + generator.normal(0.0, 3.0, picture.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def distance_along(depth_m: NDArray[np.float32], rays: Float64Array) -> Float64Array:
    """Return the distance along each ray; inf for sky.

    It is in lengths of that ray.
    """
    size = depth_m.shape[-1]
    heading = np.rint(np.degrees(np.arctan2(rays[..., 0], rays[..., 2])) / 90.0).astype(int) % 4
    turns = np.stack([rotation(turn) for turn in HEADINGS])[heading]
    right, up, forward = np.moveaxis(np.einsum("hwij,hwj->hwi", turns, rays), -1, 0)
    column = np.floor((right / forward + 1.0) * size / 2.0).astype(int)
    row = np.floor((1.0 - up / forward) * size / 2.0).astype(int)
    inside = (row >= 0) & (row < size)
    depth = depth_m[heading, row.clip(0, size - 1), column.clip(0, size - 1)]
    return np.where(inside, depth / forward, np.inf)
