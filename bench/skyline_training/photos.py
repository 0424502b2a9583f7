"""Training photographs: landscapes with things in front, as a camera records them.

Some are views of made terrain, as demos and tests draw them: their sky is smooth, with clouds that
gather about the ridge.
"""

import itertools
from collections.abc import Generator
from dataclasses import replace
from functools import lru_cache, partial

import cv2
import numpy as np
from scipy import ndimage

from skyline.arrays import Float32Array, Float64Array, UInt8Array
from skyline.camera.warps import undistorted
from skyline.geodesy.map_frame import Frame
from skyline.render.depth import DepthRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.queries.made_photos import (
    Scenery,
    distance_along,
    drawn_scenery,
    exposed,
    mixed,
    scene_rgb,
)
from skyline_bench.queries.synthetic import Occluder, QueryConfig, SyntheticQuery, make_queries
from skyline_training.covers import dark, put_in_front
from skyline_training.landscapes import (
    CELL_M,
    COVER,
    GROUND,
    SKY,
    UNKNOWN,
    Drawing,
    TrainingPhoto,
    draw_heights,
    draw_landscape,
    draw_sky,
    fractal,
)
from skyline_training.plain_photos import CONDITIONS, draw_recipe
from skyline_training.workers import over_processes

_SIZE_PX = (560, 416)
_PANORAMA_PX = (1232, 280)
_WAYS = 8
"""One photograph in this many is drawn plainly, one is a view and one is a panorama: no single way
of drawing is like the world."""
_FAMILY = 64
"""Photographs in a row whose views are of the same terrain."""
_FAR_RIDGES_CHANCE = 0.5
"""Chance of pale ridges behind the mountains."""
_LOW_SUN_CHANCE = 0.2
"""Chance of mountains against the light, or lit by a sun at the horizon."""
_NEAR_SLOPE_CHANCE = 0.5
"""Chance of a dark slope in front of the mountains, which must not be taken for the skyline."""
_CUT_SKY_CHANCE = 0.15
"""Chance of a sky of one colour: burnt out, or cut away by a program."""
_PANORAMA_DEG = 90.0
_LEAST_CONTRAST = 2.5
"""Levels between sky and ground below which no eye would see a skyline."""


def draw_training_photos(seed: int) -> Generator[TrainingPhoto]:
    """Draw photographs without end, in as many processes as there are cores."""
    return over_processes(partial(_drawn, seed), itertools.count())


def _drawn(seed: int, index: int) -> TrainingPhoto:
    way = index % _WAYS
    if way == 0:
        return _plain_photo((seed, index))
    if way == 1:
        return draw_view((seed, index), index // _FAMILY, _SIZE_PX)
    size_px, fov_deg = (_PANORAMA_PX, (90.0, 330.0)) if way == 2 else (_SIZE_PX, (22.0, 85.0))
    return draw_training_photo((seed, index), *size_px, fov_deg)


def _plain_photo(seed: tuple[int, ...]) -> TrainingPhoto:
    """Draw one photograph in the other, plainer way.

    Its pixels have no labels.
    """
    rng = np.random.default_rng([11, *seed])
    recipe = CONDITIONS[str(rng.choice(list(CONDITIONS)))]
    photo = draw_recipe(rng, replace(recipe, size_px=_SIZE_PX))
    label = np.full(photo.image.shape[:2], UNKNOWN, dtype=np.uint8)
    # Rows of drawn photos count pixel centres.
    row = np.where(photo.visible, photo.row_px + 0.5, np.nan)
    return TrainingPhoto(photo.image, label, np.asarray(row, dtype=np.float32))


def draw_training_photo(
    seed: tuple[int, ...], width: int, height: int, fov_deg: tuple[float, float] = (22.0, 85.0)
) -> TrainingPhoto:
    """Draw one photograph.

    Photographs whose last seeds lie in one eighth share their relief. A photograph of more than 90
    degrees is a panorama: its horizon sags, and it is stitched.
    """
    rng = np.random.default_rng(seed)
    skyline_px = rng.uniform(0.15, 0.7) * height
    sky, haze = draw_sky(rng, width, height, skyline_px)
    land = draw_landscape(rng, width, height, haze, seed[-1] // 8, fov_deg)
    if rng.random() < _LOW_SUN_CHANCE:
        red = np.array([1.15, rng.uniform(0.75, 1.0), 0.85])
        land = replace(land, rgb=np.asarray(land.rgb * rng.uniform(0.05, 0.9) * red, np.float32))
    row = np.full(width, np.nan, dtype=np.float32)
    kind = rng.choice(["landscape", "sky", "ground"], p=[0.95, 0.025, 0.025])
    if kind == "sky":
        picture, label = sky, np.full((height, width), SKY, dtype=np.uint8)
    elif kind == "ground":
        top = min(height - 2, max(0, int(land.row_px.max()) + 1))
        picture = np.asarray(cv2.resize(land.rgb[top:], (width, height)), dtype=np.float32)
        label = np.full((height, width), GROUND, dtype=np.uint8)
    else:
        below = np.clip(np.arange(height)[:, np.newaxis] + 0.5 - land.row_px, 0.0, 1.0)
        share = np.where(land.is_ground, np.maximum(below, 0.5), np.minimum(below, 0.5))
        picture = np.asarray(sky + share[..., np.newaxis] * (land.rgb - sky), dtype=np.float32)
        label = land.is_ground.astype(np.uint8)
        inside = (land.row_px > 1) & (land.row_px < height - 1)
        row = np.where(inside, land.row_px, row)
    drawing = Drawing(rng, picture, label, row, haze)
    if kind != "ground" and rng.random() < _FAR_RIDGES_CHANCE:
        _far_ridges(drawing)
    if rng.random() < _NEAR_SLOPE_CHANCE:
        _near_slope(drawing)
    if rng.random() < 0.12:
        _mirror(drawing)
    if rng.random() < 0.2:
        _banks(drawing)
    put_in_front(drawing)
    if fov_deg[1] > _PANORAMA_DEG:
        stitch(drawing)
    image = developed(rng, drawing.picture)
    if rng.random() < _CUT_SKY_CHANCE:
        image[drawing.label == SKY] = 255 if rng.random() < 0.5 else rng.integers(0, 256, 3)
    _written(rng, image)
    return TrainingPhoto(image, drawing.label, _seen(drawing.row, drawing.label, image))


def _seen(row: Float32Array, label: UInt8Array, image: UInt8Array) -> Float32Array:
    """Drop the skyline where it does not separate sky from ground."""
    height, width = label.shape
    smooth = cv2.blur(image.astype(np.float32), (5, 3))
    at = np.nan_to_num(row, nan=0.0)
    columns = np.arange(width)
    above = label[np.clip(np.floor(at - 1.0).astype(int), 0, height - 1), columns]
    below = label[np.clip(np.ceil(at + 1.0).astype(int), 0, height - 1), columns]
    step = smooth[np.clip(np.rint(at + 3).astype(int), 0, height - 1), columns]
    step = step - smooth[np.clip(np.rint(at - 3).astype(int), 0, height - 1), columns]
    apart = ndimage.median_filter(np.abs(step).max(axis=1), 9) > _LEAST_CONTRAST
    free = apart & (above == SKY) & (below == GROUND)
    return np.asarray(np.where(free, row, np.nan), dtype=np.float32)


def _far_ridges(drawing: Drawing) -> None:
    """Put pale ridges behind the mountains, one in front of another."""
    rng, (height, width), row, haze = drawing.rng, drawing.size, drawing.row, drawing.haze
    known = row[np.isfinite(row)]
    line = float(np.median(known)) if known.size else 0.5 * height
    rows = np.arange(height)[:, np.newaxis] + 0.5
    free = drawing.label == SKY
    line -= rng.uniform(0.0, 0.12) * height
    texture = fractal(rng, (height, width), rng.uniform(1.0, 1.7))
    # Haze leaves most far ridges flat.
    lit = 1.0 + rng.choice([0.0, rng.uniform(0.0, 0.3)]) * texture[..., np.newaxis]
    rock = (haze * rng.uniform(0.2, 0.8) + rng.normal(0.0, 6.0, 3)) * lit
    if rng.random() < 0.5:
        snowy = np.clip(rng.normal(0.5, 1.0) + 2.0 * texture, 0.0, 1.0)[..., np.newaxis]
        rock += snowy * (np.minimum(rng.uniform(200.0, 250.0) * lit, 255.0) - rock)
    for left in np.sort(rng.uniform(0.04, rng.uniform(0.2, 0.9), rng.integers(1, 4))):
        swing = rng.uniform(0.01, 0.1) * height
        ridge = line + swing * fractal(rng, (1, width), rng.uniform(1.3, 2.0), 1.0, width / 2)[0]
        share = np.clip(rows - ridge, 0.0, 1.0) * free
        pale = haze + left * (rock - haze)
        drawing.picture += share[..., np.newaxis] * (pale - drawing.picture)
        drawing.label[share > 0.5] = GROUND
        row = np.fmin(row, np.where((ridge > 1) & (ridge < height - 1), ridge, np.nan))
        line += rng.uniform(0.0, 0.08) * height
    drawing.row = np.asarray(row, dtype=np.float32)


def _near_slope(drawing: Drawing) -> None:
    """Put a slope or a knoll in front of mountains.

    It is often veiled; it is dark or bare, or has its own trees.
    """
    rng, (height, width), row, label = drawing.rng, drawing.size, drawing.row, drawing.label
    veil = rng.choice([0.0, rng.uniform(0.2, 0.88)])
    drawing.picture += (veil * (label == GROUND))[..., np.newaxis] * (
        drawing.haze - drawing.picture
    )
    across = np.linspace(0.0, 1.0, width)
    known = row[np.isfinite(row)]
    line = float(known.mean()) if known.size else 0.4 * height
    foot = line + rng.uniform(0.02, 0.3) * height
    rise = rng.uniform(-0.2, 0.5) * height * np.abs(across - rng.random()) ** rng.uniform(0.7, 2.0)
    if rng.random() < 0.4:  # A knoll.
        away = (across - rng.random()) / rng.uniform(0.05, 0.3)
        rise += rng.uniform(0.05, 0.35) * height * np.exp(-(np.abs(away) ** rng.uniform(1.2, 3.0)))
    rough = rng.uniform(0.0, 0.02) * height * fractal(rng, (1, width), 1.3)[0]
    near = foot - rise + rough
    trees = np.zeros(width)
    cover = rng.choice(["bare", "wood", "trees"], p=[0.35, 0.35, 0.3])
    if cover == "wood":
        near -= rng.uniform(0.005, 0.03) * height * np.abs(fractal(rng, (1, width), 0.3)[0])
    elif cover == "trees":
        tall = rng.uniform(0.03, 0.2) * height
        for _ in range(rng.integers(2, 50)):
            half = tall * rng.uniform(0.12, 0.3)
            away = np.abs(np.arange(width) - rng.uniform(0.0, width)) / half
            trees = np.maximum(trees, tall * rng.uniform(0.4, 1.0) * (1.0 - away))
        trees *= 1.0 + 0.15 * fractal(rng, (1, width), 0.3)[0]
    rows = np.arange(height)[:, np.newaxis] + 0.5
    share = np.clip(rows - near + trees, 0.0, 1.0)[..., np.newaxis]
    texture = fractal(rng, (height, width), rng.uniform(0.4, 1.2))
    shade = 1.0 + rng.uniform(0.1, 0.45) * texture[..., np.newaxis]
    colour = dark(rng, 85.0 if cover != "bare" or rng.random() < 0.4 else 210.0)
    drawing.picture += share * (np.minimum(colour * np.maximum(shade, 0.1), 255) - drawing.picture)
    label[share[..., 0] > 0.5] = GROUND
    label[(share[..., 0] > 0.5) & (rows < near)] = COVER
    higher = np.where(np.isfinite(row), np.minimum(row, near), np.where(label[0] == SKY, near, row))
    inside = (higher > 1) & (higher < height - 1) & (near - trees > higher - 1.0)
    drawing.row = np.asarray(np.where(inside, higher, np.nan), np.float32)


def _mirror(drawing: Drawing) -> None:
    rng, (height, _), picture = drawing.rng, drawing.size, drawing.picture
    deepest = int((drawing.label == GROUND).argmax(axis=0).max())
    shore = max(int(rng.uniform(0.55, 0.85) * height), min(deepest + 4, height - 2))
    deep = min(height - shore, shore)
    water = ndimage.gaussian_filter(picture[shore - deep : shore][::-1], (2.0, 0.5, 0.0))
    picture[shore : shore + deep] = rng.uniform(0.6, 0.98) * water
    drawing.label[shore:] = GROUND


def _banks(drawing: Drawing) -> None:
    """Lay clouds on the ridge.

    They hide it, and their edge is not a skyline.
    """
    rng, (height, width), row = drawing.rng, drawing.size, drawing.row
    known = np.flatnonzero(np.isfinite(row))
    if not known.size:
        return
    for _ in range(rng.integers(1, 4)):
        column = rng.choice(known)
        at = row[column] + rng.uniform(-0.04, 0.06) * height
        across = (np.arange(width) - column) / (rng.uniform(0.06, 0.3) * width)
        down = (np.arange(height)[:, np.newaxis] - at) / (rng.uniform(0.02, 0.1) * height)
        rough = rng.uniform(0.3, 0.8) * fractal(rng, (height, width), 1.5, 1.7)
        density = 1.0 - np.hypot(across, down) + rough
        opacity = rng.uniform(0.85, 1.0) * np.clip(density / rng.uniform(0.1, 0.8), 0, 1)
        white = np.clip(drawing.haze * rng.uniform(0.8, 1.2) + rng.uniform(0, 60), 0, 255)
        shade = 1.0 + 0.06 * fractal(rng, (height, width), 1.3)[..., np.newaxis]
        drawing.picture += opacity[..., np.newaxis] * (white * shade - drawing.picture)
        drawing.label[opacity > 0.5] = SKY


def stitch(drawing: Drawing) -> None:
    """Make a panorama of a picture as phones do.

    Its horizon sags, and it has seams in tone and row.
    """
    rng, (height, width) = drawing.rng, drawing.size
    across = np.linspace(-1.0, 1.0, width, dtype=np.float32)
    sag = rng.normal(0.0, 0.04) * across**2 + rng.normal(0.0, 0.02) * np.sin(
        rng.uniform(1.0, 7.0) * across + rng.uniform(0.0, 6.0)
    )
    gain = np.ones((width, 3))
    for column in rng.integers(0, width, rng.integers(2, 12)):
        sag[column:] += rng.normal(0.0, 0.003)
        step = 0.5 + 0.5 * np.tanh((np.arange(width) - column) / rng.uniform(1.0, 40.0))
        tone = rng.normal(0.0, 0.06) + rng.normal(0.0, 0.015, 3)
        gain *= np.exp(tone * step[:, np.newaxis])
    sag *= height
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height))
    at = (columns, (rows - sag).astype(np.float32))
    moved = cv2.remap(drawing.picture, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    drawing.picture = np.asarray(moved * gain, dtype=np.float32)
    drawing.label = np.asarray(
        cv2.remap(drawing.label, *at, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )
    row = drawing.row + sag
    drawing.row = np.asarray(np.where((row > 1) & (row < height - 1), row, np.nan), np.float32)


def developed(rng: np.random.Generator, picture: Float32Array) -> UInt8Array:
    """Return a picture after lens, sensor, processing and JPEG."""
    height, width = picture.shape[:2]
    light = np.clip(picture / 255.0, 0.0, 1.3)
    if rng.random() < 0.3:
        far = np.hypot(np.linspace(-1, 1, width), np.linspace(-1, 1, height)[:, np.newaxis])
        light *= (1.0 - rng.uniform(0, 0.5) * np.clip(far - 0.3, 0, 1) ** 2)[..., np.newaxis]
    light = np.clip(light * np.exp(rng.normal(0.0, 0.25)), 0, 1) ** np.exp(rng.normal(0.0, 0.3))
    grey = light.mean(axis=2, keepdims=True)
    light = grey + rng.choice([0.0, rng.uniform(0.2, 1.5)], p=[0.07, 0.93]) * (light - grey)
    if rng.random() < 0.4:  # A look: shadows and highlights toned apart.
        dark, bright = rng.normal(0, 0.05, 3), rng.normal(0, 0.05, 3)
        light = light + (1.0 - grey) ** 2 * dark + grey**2 * bright
    if rng.random() < 0.2:
        light = np.clip(light, 0, 1)
        light = light + rng.uniform(-0.3, 0.8) * (light * light * (3 - 2 * light) - light)
    if rng.random() < 0.2:
        light = rng.uniform(0.0, 0.2) + rng.uniform(0.65, 0.95) * light
    sigma = rng.choice([0.3, 0.6, 1.0, 2.0], p=[0.45, 0.35, 0.15, 0.05])
    light = ndimage.gaussian_filter(light, (sigma, sigma, 0))
    noise = rng.choice([0.0, 0.004, 0.012, 0.03], p=[0.3, 0.35, 0.27, 0.08])
    if noise > 0.0:  # Phones and programs remove theirs.
        light += noise * rng.standard_normal(light.shape)
    image = np.clip(np.rint(255.0 * light), 0, 255).astype(np.uint8)
    if rng.random() < 0.5:
        kept = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(30, 95))])[1]
        image = np.asarray(cv2.imdecode(kept, cv2.IMREAD_COLOR), np.uint8)
    return image


def _written(rng: np.random.Generator, image: UInt8Array) -> None:
    """Put a watermark, a title or a date over a photograph."""
    height, width = image.shape[:2]
    kind = rng.choice(["none", "rows", "title"], p=[0.78, 0.12, 0.1])
    if kind == "none":
        return
    over = image.copy()
    words = "".join(rng.choice(list("abcdefghijklmnop +AEIOU"), rng.integers(5, 14)))
    ink = (255, 255, 255) if rng.random() < 0.8 else (0, 0, 0)
    size = rng.uniform(0.25, 0.5) if kind == "rows" else rng.uniform(0.4, 2.0)
    spots = [(int(rng.uniform(0, 0.7) * width), int(rng.uniform(0.03, 0.97) * height))]
    if kind == "rows":
        spots = [
            (x + (y // 40 % 2) * 60, y) for y in range(10, height, 40) for x in range(0, width, 120)
        ]
    for spot in spots:
        thick = 1 if kind == "rows" else 2
        cv2.putText(over, words, spot, cv2.FONT_HERSHEY_SIMPLEX, size, ink, thick, cv2.LINE_AA)
    share = rng.uniform(0.08, 0.3) if kind == "rows" else rng.uniform(0.5, 1.0)
    image[:] = cv2.addWeighted(over, share, image, 1.0 - share, 0.0)


_OCCLUDER_RGB = {
    "tree": np.array([38.0, 52.0, 30.0]),
    "building": np.array([168.0, 150.0, 128.0]),
    "person": np.array([150.0, 50.0, 45.0]),
}


def put_before(picture: Float64Array, occluder: Occluder, generator: np.random.Generator) -> None:
    """Paint something near over a picture (H, W, 3).

    It is painted from its top down.
    """
    start, stop = occluder.columns
    rows = np.arange(len(picture))[:, np.newaxis]
    covered = np.clip(rows + 0.5 - occluder.row_px, 0.0, 1.0)
    colour = _OCCLUDER_RGB[occluder.kind] * generator.uniform(0.8, 1.2)
    # Foliage lets light through; walls and coats do not.
    rough = 0.35 if occluder.kind == "tree" else 0.05
    shade = 1.0 + rough * generator.standard_normal((len(picture), stop - start))
    part = picture[:, start:stop]
    picture[:, start:stop] = mixed(part, colour * np.maximum(shade, 0.2)[..., np.newaxis], covered)


def draw_photo(
    renderer: DepthRenderer, query: SyntheticQuery, seed: int, scenery: Scenery
) -> UInt8Array:
    """Return the RGB photograph (H, W, 3) of a synthetic query.

    Its occluders are in front. Sky and ground meet exactly at ``query.row_px``, the border pixels
    mixed from both; the depth images behind decide only what the ground looks like. ``renderer``
    must draw the terrain the query was made from.
    """
    generator, truth = np.random.default_rng(seed), query.truth
    camera = truth.camera(query.skyline.width_px, query.skyline.height_px)
    viewpoint = Viewpoints(
        easting_m=np.array([truth.easting_m]),
        northing_m=np.array([truth.northing_m]),
        eye_elevation_m=np.array([truth.eye_elevation_m]),
    )
    rays = camera.rays()
    distance = distance_along(renderer.depth_images(viewpoint, 0), rays)
    rows = np.arange(camera.height_px)[:, np.newaxis]
    # Pixel r spans r - 0.5 to r + 0.5.
    below = np.clip(rows + 0.5 - query.row_px, 0.0, 1.0)
    share = np.where(np.isfinite(query.row_px), below, np.isfinite(distance))
    eye = truth.easting_m, truth.northing_m
    picture = scene_rgb(renderer, eye, rays, distance, share, scenery, generator)
    for occluder in query.occluders:
        put_before(picture, occluder, generator)
    return _bent(exposed(picture, generator), truth.distortion)


def _bent(image: UInt8Array, distortion: float) -> UInt8Array:
    """Return a pin-hole's photo (H, W, 3) through a lens with distortion."""
    height, width = image.shape[:2]
    across = np.tile((2.0 * np.arange(width) + 1.0) / width - 1.0, (height, 1))
    above = np.tile(((height - 1.0 - 2.0 * np.arange(height)) / width)[:, np.newaxis], (1, width))
    across, above = undistorted(across, above, distortion)
    columns = (across + 1.0) * width / 2.0 - 0.5
    rows = (height - 1.0 - above * width) / 2.0
    at = columns.astype(np.float32), rows.astype(np.float32)
    bent = cv2.remap(image, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(bent, dtype=np.uint8)


_CELLS = 400
_FRAME = Frame.from_crs("EPSG:32632")
_WEST_M, _NORTH_M = 600_000.0, 5_180_000.0
_RENDERED_PX = 1024
"""Columns of the depth images of a heading, of 90 degrees."""
_POSES = 4
"""Poses that are tried for a photo. The pose that shows most skyline is drawn, since most others
show a slope alone."""
_PLACES_SHARE = 0.3
"""Share of the terrain, at its middle, in which eyes stand."""


def draw_view(seed: tuple[int, ...], terrain_seed: int, size_px: tuple[int, int]) -> TrainingPhoto:
    """Draw one photograph from a random place, in random weather.

    The terrain is made.
    """
    rng = np.random.default_rng([13, *seed])
    terrain = _terrain(terrain_seed)
    bottom, top = terrain.height_range_m
    tree_line_m = bottom - 0.3 * (top - bottom), top + 0.5 * (top - bottom)
    scenery = drawn_scenery(rng, (8e3, 300e3), (bottom, top), tree_line_m)
    width, height = size_px
    config = QueryConfig(
        fov_deg=(30.0, 90.0),
        occluded_share=(0.0, 0.3),
        width_px=width,
        height_px=height,
        eye_height_m=float(np.exp(rng.uniform(np.log(2.0), np.log(300.0)))),
        azimuths=16 * width,
    )
    west, south, east, north = terrain.bounds_m
    margin = 0.5 * (1.0 - _PLACES_SHARE)
    aside, along = margin * (east - west), margin * (north - south)
    area = west + aside, south + along, east - aside, north - along
    queries = make_queries(terrain, area, _POSES, int(rng.integers(1 << 31)), config)
    query = max(queries, key=lambda one: np.count_nonzero(np.isfinite(one.row_px)))
    with DepthRenderer(terrain, _RENDERED_PX) as renderer:
        image = draw_photo(renderer, query, int(rng.integers(1 << 31)), scenery)
    # Rows of queries count pixel centres.
    row = query.row_px + 0.5
    row = np.where((row > 1.0) & (row < height - 1.0), row, np.nan)
    rows = np.arange(height)[:, np.newaxis] + 0.5
    label = np.where(rows < row, SKY, GROUND).astype(np.uint8)
    label[:, np.isnan(row)] = UNKNOWN
    for occluder in query.occluders:
        columns = slice(*occluder.columns)
        hidden = rows > occluder.row_px + 0.5
        label[:, columns][hidden] = COVER
        row[columns][occluder.row_px < row[columns] - 0.5] = np.nan
    return TrainingPhoto(image, label, np.asarray(row, dtype=np.float32))


@lru_cache(maxsize=1)
def _terrain(seed: int) -> HeightField:
    """Return terrain of a random spacing, kept for the photographs after."""
    rng = np.random.default_rng([17, seed])
    heights = draw_heights(rng, seed)[:_CELLS, :_CELLS]
    spacing_m = float(np.exp(rng.uniform(np.log(20.0), np.log(90.0))))
    heights = heights * np.float32(spacing_m / CELL_M)
    return HeightField(heights, _WEST_M, _NORTH_M, spacing_m, spacing_m, _FRAME)
