"""Drawn mountain photos with known skylines, without terrain.

An extractor learns from them, so they are hard. They are drawn without a renderer, from fractal
ridges in front of one another, shaded rock, snow, haze, skies and clouds, things in front, and the
effects of camera and file. A `Recipe` says how much of each; `CONDITIONS` names the recipes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image
from scipy import ndimage

from skyline.arrays import BoolArray, Float32Array, Float64Array, UInt8Array

RIDGE_KNEE_SHARE = 0.43
"""Where the skylines lie on average, as a share of the rows from the top."""

_SKIES = {
    "blue": ((62, 112, 186), (196, 214, 232)),
    "deep": ((22, 58, 128), (110, 158, 214)),
    "overcast": ((150, 154, 160), (214, 217, 221)),
    "white": ((226, 228, 231), (236, 237, 239)),
    "sunset": ((70, 72, 120), (246, 168, 88)),
    "dusk": ((26, 32, 60), (92, 96, 122)),
}
"""Colours at the zenith and at the horizon."""
_ROCK, _MEADOW, _FOREST = (112.0, 104.0, 96.0), (96.0, 116.0, 66.0), (44.0, 60.0, 42.0)
_SNOW, _CLOUD = (240.0, 243.0, 249.0), (244.0, 245.0, 247.0)


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a photo is drawn. Pairs are the range a seed draws from."""

    sky: str = "blue"  # A name in ``_SKIES``
    light: float = 1.0  # Light on the ground: 1 is a clear day, 0.2 leaves silhouettes
    clouds: float = 0.0  # Share of the sky that clouds cover
    banks: int = 0  # Clouds that lie on the ridge and hide parts of it
    # What haze leaves of the farthest ridge's contrast to the sky.
    contrast: tuple[float, float] = (0.5, 0.9)
    snow: float = 0.15  # Share of the relief, from the top, that is under snow
    layers: int = 3  # Ridges one before another
    # How many of each stand in front.
    trees: int = 0
    people: int = 0
    poles: int = 0
    wires: int = 0
    lake: bool = False  # Mirror the mountains in the lower part
    blur_px: tuple[float, float] = (0.5, 0.9)  # Deviation of the blur; the photo is 1200 px wide
    noise: float = 2.0  # Levels of sensor noise
    jpeg_quality: tuple[int, int] | None = (80, 95)
    framed: bool = False  # A border and a caption bar, and a logo in the sky
    size_px: tuple[int, int] = (1200, 800)


CONDITIONS: Mapping[str, Recipe] = {
    "clear": Recipe(),
    "clouds": Recipe(clouds=0.5),
    "overcast": Recipe(sky="overcast", clouds=0.8, light=0.8),
    "clouds on the ridge": Recipe(clouds=0.35, banks=4),
    "haze": Recipe(contrast=(0.08, 0.25)),
    "haze, JPEG": Recipe(contrast=(0.12, 0.3), jpeg_quality=(25, 50)),
    "snow, blue sky": Recipe(sky="deep", snow=0.8),
    "snow, white sky": Recipe(sky="white", snow=0.6, light=0.9),
    "snow, clouds": Recipe(snow=0.7, clouds=0.6),
    "backlight": Recipe(sky="sunset", light=0.25, clouds=0.3),
    "dusk": Recipe(sky="dusk", light=0.2, noise=5.0),
    "trees": Recipe(trees=9, clouds=0.2),
    "people": Recipe(people=3, clouds=0.2),
    "poles and wires": Recipe(poles=4, wires=3),
    "lake": Recipe(lake=True, clouds=0.3),
    "caption and border": Recipe(framed=True, clouds=0.2),
    "noise": Recipe(noise=14.0),
    "blur": Recipe(blur_px=(2.5, 5.0), clouds=0.3),
    "small JPEG": Recipe(size_px=(480, 320), jpeg_quality=(30, 60), clouds=0.3),
    "panorama": Recipe(size_px=(2400, 480), layers=4, clouds=0.3),
}


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPhoto:
    """A photo and the truth about it."""

    image: UInt8Array  # (H, W, 3)
    row_px: Float64Array  # (W,); the terrain's skyline, also where it is hidden; NaN in borders
    visible: BoolArray  # (W,); where it is to be seen


def draw_recipe(rng: np.random.Generator, recipe: Recipe) -> DrawnPhoto:
    """Draw one photo of a recipe."""
    width, height = recipe.size_px
    sky = _sky(rng, recipe)
    picture, row_px = _mountains(rng, recipe, sky)
    if recipe.lake:
        _mirror(rng, picture)
    visible = np.ones(width, dtype=bool)
    at = np.clip(np.rint(row_px).astype(int), 0, height - 1)
    for opacity, rgb in _hidden_by(rng, recipe, row_px):
        picture += opacity[:, :, np.newaxis] * (np.array(rgb, np.float32) - picture)
        visible &= opacity[at, np.arange(width)] < 0.5
    if recipe.framed:
        _frame(rng, picture, row_px, visible)
    return DrawnPhoto(_expose(rng, recipe, picture), row_px, visible)


_Cover = tuple[Float32Array, ArrayLike]
"""Something in front: where it hides the picture, (H, W) 0 to 1, and its colour."""


def _fractal(
    rng: np.random.Generator, shape: tuple[int, int], slope: float, stretch: float = 1.0
) -> Float32Array:
    """Return noise with a power-law spectrum and a deviation of 1.

    It is stretched ``stretch`` times in width.
    """
    padded = (2 * ((shape[0] + 65) // 2), 2 * ((shape[1] + 65) // 2))
    down = np.fft.fftfreq(padded[0])[:, np.newaxis]
    across = np.fft.rfftfreq(padded[1])[np.newaxis, :] * stretch
    frequency = np.hypot(down, across)
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal(padded)) * frequency**-slope
    noise = np.fft.irfft2(spectrum, padded)[: shape[0], : shape[1]]
    return np.asarray((noise - noise.mean()) / noise.std(), dtype=np.float32)


def _ridge(rng: np.random.Generator, width: int, height: int, level: float) -> Float64Array:
    """Return rows of a ridge.

    It has a few peaks, and roughness at all scales.
    """
    columns = np.arange(width) / height
    row = np.full(width, level * height)
    for _ in range(max(3, round(4 * width / height))):
        at, slope = rng.uniform(0.0, width / height), rng.uniform(0.25, 0.8, 2)
        peak = (level - rng.uniform(0.04, 0.2)) * height
        fall = np.where(columns < at, slope[0] * (at - columns), slope[1] * (columns - at))
        row = np.minimum(row, peak + fall * height)
    rough = _fractal(rng, (1, width), 1.3)[0]
    return np.asarray(row + 0.018 * height * rough, dtype=np.float64)


def _sky(rng: np.random.Generator, recipe: Recipe) -> Float32Array:
    """Return the sky with its clouds, over the whole picture."""
    width, height = recipe.size_px
    zenith, horizon = (np.array(colour, dtype=np.float32) for colour in _SKIES[recipe.sky])
    down = np.clip(np.linspace(0.0, 2.0, height), 0.0, 1.0)[:, np.newaxis, np.newaxis]
    sky = np.repeat(zenith + down * (horizon - zenith), width, axis=1)
    if recipe.clouds > 0.0:
        density = _fractal(rng, (height, width), 1.6, stretch=0.45)
        threshold = np.quantile(density, 1.0 - recipe.clouds)
        softness = rng.uniform(0.15, 0.9)
        opacity = np.clip((density - threshold) / softness, 0.0, 1.0)[:, :, np.newaxis]
        thickness = np.clip((density - threshold) / 2.0, 0.0, 1.0)[:, :, np.newaxis]
        brightness = 0.35 + 0.65 * min(1.0, float(horizon.mean()) / 215.0)
        cloud = brightness * np.array(_CLOUD, np.float32) * (1.0 - 0.35 * thickness)
        sky += 0.92 * opacity * (cloud - sky)
    return np.asarray(sky, dtype=np.float32)


def _mountains(
    rng: np.random.Generator, recipe: Recipe, sky: Float32Array
) -> tuple[Float32Array, Float64Array]:
    """Return ridges in front of the sky, and their skyline.

    Ridges come in order from the farthest to the nearest.
    """
    height, width = sky.shape[:2]
    picture, skyline = sky.copy(), np.full(width, np.inf)
    horizon = np.array(_SKIES[recipe.sky][1], np.float32)
    farthest = rng.uniform(*recipe.contrast)
    for index, left in enumerate(np.linspace(farthest, 1.0, recipe.layers)):
        level = RIDGE_KNEE_SHARE + 0.13 * index + rng.uniform(-0.03, 0.03)
        row = _ridge(rng, width, height, level)
        ground = _ground(rng, recipe, row, height)
        veiled = left * ground + (1.0 - left) * horizon
        below = np.arange(height)[:, np.newaxis] + 0.5 - row
        share = np.clip(below, 0.0, 1.0).astype(np.float32)[:, :, np.newaxis]
        picture += share * (veiled - picture)
        skyline = np.minimum(skyline, row)
    return picture, skyline


def _ground(
    rng: np.random.Generator, recipe: Recipe, row: Float64Array, height: int
) -> Float32Array:
    """Return a mountainside that is lit from the left.

    It has rock above, meadow and forest below, and snow on top.
    """
    shape = (height, len(row))
    relief = _fractal(rng, shape, 1.7)
    light = np.clip(0.75 + 3.0 * np.gradient(relief, axis=1) * height / 100.0, 0.3, 1.25)
    depth = (np.arange(height)[:, np.newaxis] - row.min()) / (0.45 * height)
    patches = 0.12 * _fractal(rng, shape, 1.1)
    colour = np.where((depth + patches < 0.5)[:, :, np.newaxis], _ROCK, _MEADOW)
    colour = np.where((depth + patches > 0.8)[:, :, np.newaxis], _FOREST, colour)
    # Steep and shaded rock shows through the snow, the more the lower it lies.
    snowy = np.clip((recipe.snow - depth + 1.5 * patches) / 0.06, 0.0, 1.0) * (
        light > 0.36 + 0.4 * np.clip(depth / max(recipe.snow, 0.1), 0.0, 1.0)
    )
    snowy = ndimage.gaussian_filter(snowy.astype(np.float32), 0.8)[:, :, np.newaxis]
    shade = recipe.light * (light + 0.05 * rng.standard_normal(shape))[:, :, np.newaxis]
    snow_shade = recipe.light * (0.75 + 0.25 * np.clip(light, 0.3, 1.0))[:, :, np.newaxis]
    lit = (1.0 - snowy) * colour * shade + snowy * np.array(_SNOW) * snow_shade
    return np.asarray(lit, dtype=np.float32)


def _mirror(rng: np.random.Generator, picture: Float32Array) -> None:
    """Mirror what lies above a shore in the water below.

    The image is rippled and darkened.
    """
    shore = int(rng.uniform(0.68, 0.8) * len(picture))
    deep = len(picture) - shore
    mirrored = picture[shore - deep : shore][::-1]
    ripple = ndimage.gaussian_filter1d(rng.standard_normal(mirrored.shape[:2]), 12.0, axis=1)
    smooth = ndimage.gaussian_filter(mirrored, (2.0, 0.6, 0.0))
    picture[shore:] = 0.82 * smooth + 14.0 * ripple[:, :, np.newaxis].astype(np.float32)


def _hidden_by(rng: np.random.Generator, recipe: Recipe, row_px: Float64Array) -> list[_Cover]:
    width, height = recipe.size_px
    covers = [_bank(rng, recipe, row_px) for _ in range(recipe.banks)]
    covers += [(_tree(rng, width, height), _FOREST) for _ in range(recipe.trees)]
    for _ in range(recipe.people):
        covers.append((_person(rng, width, height), rng.uniform(20.0, 220.0, 3)))
    covers += [(_pole(rng, width, height), (70.0, 66.0, 60.0)) for _ in range(recipe.poles)]
    covers += [(_wire(rng, width, height), (50.0, 50.0, 52.0)) for _ in range(recipe.wires)]
    return covers


def _bank(rng: np.random.Generator, recipe: Recipe, row_px: Float64Array) -> _Cover:
    """Return a cloud on the ridge.

    Its colour is the horizon's, or nearly white.
    """
    width, height = recipe.size_px
    column = rng.uniform(0.0, width)
    at = row_px[int(column)] - rng.uniform(-0.03, 0.05) * height
    across = (np.arange(width) - column) / (rng.uniform(0.05, 0.14) * width)
    down = (np.arange(height)[:, np.newaxis] - at) / (rng.uniform(0.02, 0.06) * height)
    density = 1.2 - np.hypot(across, down) + 0.35 * _fractal(rng, (height, width), 1.5, 0.6)
    opacity = np.clip(density / rng.uniform(0.2, 0.6), 0.0, 1.0)
    rgb = _CLOUD if rng.random() < 0.6 else _SKIES[recipe.sky][1]
    return np.asarray(0.97 * opacity, dtype=np.float32), rgb


def _tree(rng: np.random.Generator, width: int, height: int) -> Float32Array:
    """Return a conifer, a ragged cone.

    Most stand near the photo's sides.
    """
    side = rng.choice([0.0, 1.0])
    centre = (side + (1.0 - 2.0 * side) * rng.exponential(0.12)) * width
    top, half = rng.uniform(0.02, 0.45) * height, rng.uniform(0.03, 0.08) * width
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
    reach = half * np.clip((rows - top) / (0.75 * height), 0.0, 1.0) ** 0.8
    ragged = (
        1.0
        + 0.35 * np.sin(rows / height * rng.uniform(70.0, 140.0))
        + 0.3 * _fractal(rng, (height, width), 0.6)
    )
    return np.asarray(np.clip(reach * ragged - np.abs(columns - centre), 0.0, 1.0))


def _person(rng: np.random.Generator, width: int, height: int) -> Float32Array:
    """Return a head on shoulders, about as high as the ridge.

    It may rise above the ridge.
    """
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
    size = rng.uniform(0.05, 0.12) * height
    at, top = rng.uniform(0.1, 0.9) * width, rng.uniform(0.1, 0.45) * height
    head = 1.0 - np.hypot((columns - at) / (0.75 * size), (rows - top - size) / size)
    shoulder = top + 2.0 * size + 0.4 * ((columns - at) / size) ** 2 * size / 3.0
    body = np.minimum(rows - shoulder, 2.2 * size - np.abs(columns - at)) / size
    return np.asarray(np.clip(size * np.maximum(head, body), 0.0, 1.0), dtype=np.float32)


def _pole(rng: np.random.Generator, width: int, height: int) -> Float32Array:
    at, top = rng.uniform(0.05, 0.95) * width, rng.uniform(0.0, 0.35) * height
    columns, rows = np.arange(width), np.arange(height)[:, np.newaxis]
    across = np.clip(rng.uniform(1.5, 5.0) - np.abs(columns - at), 0.0, 1.0)
    return np.asarray(across * (rows > top), dtype=np.float32)


def _wire(rng: np.random.Generator, width: int, height: int) -> Float32Array:
    """Return a wire that sags through the sky."""
    x = np.linspace(-1.0, 1.0, width)
    row = (rng.uniform(0.1, 0.35) + 0.05 * x**2 + rng.uniform(-0.08, 0.08) * x) * height
    away = np.abs(np.arange(height)[:, np.newaxis] - row)
    return np.asarray(np.clip(rng.uniform(1.0, 1.8) - away, 0.0, 1.0), dtype=np.float32)


def _frame(
    rng: np.random.Generator, picture: Float32Array, row_px: Float64Array, visible: BoolArray
) -> None:
    """Draw a border, a caption bar and a logo.

    The bar with text is below, and the logo in the sky.
    """
    height, width = picture.shape[:2]
    border, bar = int(rng.uniform(0.01, 0.04) * width), int(rng.uniform(0.05, 0.12) * height)
    colour = 255.0 if rng.random() < 0.5 else 0.0
    picture[:border] = picture[:, :border] = picture[:, -border:] = colour
    picture[-bar:] = colour
    text = rng.random((12, width // 3)) < 0.4
    picture[-bar // 2 - 6 : -bar // 2 + 6, 60 : 60 + text.shape[1]][text] = 255.0 - colour
    logo = rng.random((30, 90)) < 0.5
    top = border + 12
    picture[top : top + 30, -border - 110 : -border - 20][logo] = 250.0
    outside = np.ones(width, dtype=bool)
    outside[border:-border] = False
    row_px[outside], visible[outside] = np.nan, False


def _expose(rng: np.random.Generator, recipe: Recipe, picture: Float32Array) -> UInt8Array:
    """Return a picture after the camera and the file."""
    sigma = rng.uniform(*recipe.blur_px) * recipe.size_px[0] / 1200.0
    blurred = ndimage.gaussian_filter(picture, (sigma, sigma, 0.0))
    noisy = blurred + recipe.noise * rng.standard_normal(picture.shape)
    image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    if recipe.jpeg_quality is None:
        return image
    file = BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=int(rng.integers(*recipe.jpeg_quality)))
    return np.asarray(Image.open(file), dtype=np.uint8)
