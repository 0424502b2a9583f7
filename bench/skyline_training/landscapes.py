"""Drawn landscapes with known skylines.

A fractal height field is seen in perspective, lit, and veiled. Columns of the picture march over
the height field together, nearest first; a point is seen if it rises above all nearer points.
Everything that differs between photographs is random.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from skyline.arrays import BoolArray, Float32Array, UInt8Array

SKY, GROUND, COVER, UNKNOWN = 0, 1, 2, 255
"""Labels of pixels; a cover is whatever stands in front: a tree, a person, a window's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingPhoto:
    """A photograph, with its pixels' true labels and true skyline."""

    image: UInt8Array  # (H, W, 3)
    label: UInt8Array  # (H, W)
    row_px: Float32Array  # (W,); the skyline, in rows; NaN where none is seen


@dataclass(slots=True, eq=False)
class Drawing:
    """A picture that is painted over, its labels and its skyline."""

    rng: np.random.Generator
    picture: Float32Array  # (H, W, 3)
    label: UInt8Array  # (H, W)
    row: Float32Array  # (W,); the skyline, NaN where none is to be seen
    haze: Float32Array  # The colour that haze gives

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        height, width = self.label.shape
        return height, width

    def cover(self, opacity: ArrayLike, rgb: ArrayLike) -> None:
        """Paint a colour (H, W, 3) over the picture, and label what it hides."""
        share = np.asarray(opacity, dtype=np.float32)
        self.picture += share[..., np.newaxis] * (np.asarray(rgb, np.float32) - self.picture)
        self.label[share > 0.5] = COVER


CELLS = 1024
CELL_M = 40.0
_STEPS = 420
_NEAREST_M, _FARTHEST_M = 40.0, 38_000.0


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLandscape:
    """Ground before any sky, (H, W)."""

    rgb: Float32Array  # (H, W, 3)
    is_ground: BoolArray  # (H, W); below the skyline
    # (W,); first row of the ground; below 0 where it lies above the picture, H where there is none.
    row_px: Float32Array


def fractal(
    rng: np.random.Generator,
    shape: tuple[int, int],
    slope: float,
    stretch: float = 1.0,
    longest: float = np.inf,
) -> Float32Array:
    """Return periodic noise with a power-law spectrum.

    It has a standard deviation of 1, and no waves longer than a limit.
    """
    down = np.fft.fftfreq(shape[0])[:, np.newaxis]
    across = np.fft.rfftfreq(shape[1])[np.newaxis, :] * stretch
    frequency = np.hypot(down, across).astype(np.float32)
    frequency = np.maximum(frequency, np.float32(1.0 / longest))
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal(shape, dtype=np.float32)) * frequency**-slope
    noise = np.fft.irfft2(spectrum, shape).astype(np.float32)
    return np.asarray((noise - noise.mean()) / noise.std(), dtype=np.float32)


@lru_cache(maxsize=1)
def _noises(seed: int) -> tuple[Float32Array, ...]:
    """Return periodic fields that a few photographs share.

    They are a relief, creases, crags and two textures.
    """
    rng = np.random.default_rng([7, seed])
    shape = (CELLS, CELLS)
    creased = -np.abs(fractal(rng, shape, rng.uniform(1.6, 1.9), 1.0, rng.uniform(80, 300)))
    return (
        fractal(rng, shape, rng.uniform(1.7, 2.1), 1.0, rng.uniform(80, 400)),
        np.asarray(creased / creased.std(), dtype=np.float32),
        fractal(rng, shape, rng.uniform(1.2, 1.5)),
        fractal(rng, shape, 1.0),
        rng.standard_normal(shape, dtype=np.float32),
    )


def draw_heights(rng: np.random.Generator, family: int) -> Float32Array:
    """Return a family's periodic height field, metres.

    It has anything from rolling hills to sharp ridges.
    """
    rolling, creased, rough = _noises(family)[:3]
    sharp = rng.uniform(0.0, 1.0)
    height = (1.0 - sharp) * rolling + sharp * creased + rng.uniform(0.0, 0.1) * rough
    return np.asarray(height * rng.uniform(250.0, 900.0), dtype=np.float32)


def _at(
    field: Float32Array, x_m: Float32Array, y_m: Float32Array, scale: float = 1.0
) -> Float32Array:
    """Return a periodic field at places, bilinear."""
    x, y = (
        np.mod(place * np.float32(scale / CELL_M), CELLS).astype(np.float32) for place in (x_m, y_m)
    )
    found = cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(found, dtype=np.float32)


def draw_landscape(
    rng: np.random.Generator,
    width: int,
    height: int,
    haze_rgb: NDArray[np.float32],
    family: int,
    fov_deg: tuple[float, float],
) -> DrawnLandscape:
    """Draw what lies below the skyline.

    A family of photographs shares the relief.
    """
    field, (texture, fine) = draw_heights(rng, family), _noises(family)[3:]
    fov = np.radians(rng.uniform(*fov_deg))
    azimuth = rng.uniform(0, 2 * np.pi) + np.linspace(-fov / 2, fov / 2, width, dtype=np.float32)
    distance = np.geomspace(
        _NEAREST_M, _FARTHEST_M * rng.uniform(0.2, 1.0), _STEPS, dtype=np.float32
    )[:, np.newaxis]
    x0, y0 = rng.uniform(0, CELLS * CELL_M, 2)
    x = (x0 + distance * np.sin(azimuth)).astype(np.float32)
    y = (y0 + distance * np.cos(azimuth)).astype(np.float32)
    ground = _at(field, x, y)
    low, high = np.percentile(field[::8, ::8], [2, 99.5])
    tree_line = low + (high - low) * rng.uniform(-0.3, 1.1)
    if rng.random() < 0.6:  # Trees roughen what is near.
        tall = rng.uniform(8.0, 30.0) * np.abs(_at(fine, x, y, rng.uniform(1.0, 3.0)))
        ground = ground + tall * (ground < tree_line) * (distance < rng.uniform(1e3, 1e4))
    if rng.random() < 0.6:  # A valley before the mountains.
        near = np.exp(rng.uniform(np.log(500.0), np.log(8000.0)))
        risen = np.clip((distance - near) / (1.5 * near), 0.0, 1.0)
        ground = low + (0.05 + 0.95 * risen * risen * (3.0 - 2.0 * risen)) * (ground - low)
    here = float(_at(field, np.full((1, 1), x0, np.float32), np.full((1, 1), y0, np.float32))[0, 0])
    eye = min(max(here, low), float(ground[:3].max()) + 5.0) + np.exp(
        rng.uniform(np.log(2.0), np.log(900.0))
    )
    steep = (ground - eye - distance**2 / 14.0e6) / distance
    skyline = steep.max(axis=0)
    span = np.percentile(skyline, 96) - np.percentile(skyline, 4) + 0.01
    focal = float(
        np.clip(rng.uniform(0.02, 0.4) * height / span, width / fov / 2.5, 4.0 * width / fov)
    )
    at = rng.uniform(0.12, 0.68) * height
    seen = np.maximum.accumulate(steep, axis=0)
    row_of = at - focal * (seen - np.median(skyline))
    step = np.full((height, width), -1, dtype=np.int32)
    rows = np.arange(height)
    for column in range(width):
        first = np.searchsorted(-row_of[:, column], -(rows + 0.5))
        step[:, column] = np.where(first < _STEPS, first, -1)
    is_ground = step >= 0
    row_px = row_of[-1].astype(np.float32)
    picked = np.maximum(step, 0)
    columns = np.arange(width)
    away = np.broadcast_to(distance, x.shape)[picked, columns]
    # Below the first step the ground goes on towards the eye's feet.
    drop = np.maximum(row_of[0] - at + 2.0 * focal, 1.0) / np.maximum(
        rows[:, np.newaxis] - at + 2.0 * focal, 1.0
    )
    nearer = np.where(picked == 0, np.minimum(drop, 1.0), 1.0).astype(np.float32)
    place = (
        np.asarray(x0 + away * nearer * np.sin(azimuth), np.float32),
        np.asarray(y0 + away * nearer * np.cos(azimuth), np.float32),
    )
    rgb = _surface(rng, field, (texture, fine), place, ground[picked, columns], tree_line)
    visibility = np.exp(rng.uniform(np.log(4e3), np.log(2.5e5)))
    left = np.exp(-away / visibility)
    if rng.random() < 0.25:  # Mist in the valleys.
        deep = np.clip(
            (low + (high - low) * rng.uniform(0.2, 0.6) - ground[picked, columns]) / 300.0, 0, 1
        )
        left = left * (1.0 - deep * np.clip(away / rng.uniform(3e3, 3e4), 0, 1))
    # What is farthest keeps a trace of itself, or there would be no skyline.
    left = np.maximum(left, rng.choice([0.04, 0.08, 0.15]))[:, :, np.newaxis]
    rgb = left * rgb + (1.0 - left) * haze_rgb
    return DrawnLandscape(np.asarray(rgb, dtype=np.float32), is_ground, row_px)


def _tint(rng: np.random.Generator, rgb: tuple[float, float, float], spread: float) -> Float32Array:
    return np.asarray(
        np.array(rgb) * rng.uniform(0.65, 1.3) + rng.normal(0.0, spread, 3), dtype=np.float32
    )


def _surface(
    rng: np.random.Generator,
    field: Float32Array,
    textures: tuple[Float32Array, Float32Array],
    place: tuple[Float32Array, Float32Array],
    ground: Float32Array,
    tree_line: float,
) -> Float32Array:
    """Return the colours of ground in the light, (H, W, 3)."""
    x, y = place
    east = (_at(field, x + CELL_M, y) - _at(field, x - CELL_M, y)) / (2.0 * CELL_M)
    north = (_at(field, x, y + CELL_M) - _at(field, x, y - CELL_M)) / (2.0 * CELL_M)
    texture, fine = textures
    patches = _at(texture, *place, 1.7)
    grain = _at(fine, *place, rng.uniform(2.0, 8.0))
    crag = rng.uniform(0.0, 0.5)
    bump = _at(texture, *place, 5.3), _at(texture, *place, 4.7)
    east, north = east + crag * bump[0], north + crag * bump[1]
    tilt = np.hypot(east, north)
    sun = rng.uniform(0.0, 2 * np.pi)
    rise = np.tan(np.radians(rng.uniform(5.0, 60.0)))
    direct = (rise - east * np.sin(sun) - north * np.cos(sun)) / np.sqrt(
        (1.0 + rise**2) * (1.0 + tilt**2)
    )
    ambient = rng.uniform(0.25, 0.9)
    light = ambient + (1.15 - ambient) * np.clip(direct, 0.0, 1.0)
    rock, meadow, forest, snow = (
        _tint(rng, rgb, spread)
        for rgb, spread in (
            ((118, 110, 102), 12),
            ((104, 116, 70), 14),
            ((44, 58, 42), 8),
            ((238, 241, 247), 4),
        )
    )
    low, high = np.percentile(field[::8, ::8], [5, 99])
    meadow_line = tree_line + rng.uniform(0.0, 0.5) * (high - low)
    relative = ground + 60.0 * patches
    rgb = np.where((relative < meadow_line)[..., np.newaxis], meadow, rock)
    wooded = (relative < tree_line) & (tilt < rng.uniform(0.8, 2.0))
    rgb = np.where(wooded[..., np.newaxis], forest, rgb)
    near = fractal(rng, (ground.shape[0], ground.shape[1]), rng.uniform(0.3, 1.0))
    light = light * (1.0 + rng.uniform(0.0, 0.15) * near)
    light = light * (1.0 + rng.uniform(0.02, 0.16) * grain + np.where(wooded, 0.18 * grain, 0.0))
    if rng.random() < 0.7:
        snow_line = low + (high - low) * rng.uniform(-0.5, 1.05)
        holds = rng.uniform(0.5, 1.6)
        cover = (
            (relative - snow_line) / (0.08 * (high - low))
            + 3.0 * (holds - tilt)
            - 0.8 * patches * rng.uniform(0, 2)
        )
        cover = np.clip(np.minimum(cover, (relative - snow_line) / 40.0), 0.0, 1.0)
        bright = rng.uniform(0.75, 1.0) * (0.55 + 0.45 * np.clip(light, 0, 1.1))[..., np.newaxis]
        shaded = light[..., np.newaxis] * rgb
        cover = cover[..., np.newaxis]
        return np.asarray((1.0 - cover) * shaded + cover * bright * snow, dtype=np.float32)
    return np.asarray(light[..., np.newaxis] * rgb, dtype=np.float32)


def draw_sky(
    rng: np.random.Generator, width: int, height: int, skyline_px: float
) -> tuple[Float32Array, NDArray[np.float32]]:
    """Draw a sky (H, W, 3) with clouds.

    The second result is the colour that haze takes from it.
    """
    kinds, shares = (
        ["blue", "grey", "white", "warm", "dark", "any"],
        [0.34, 0.2, 0.06, 0.14, 0.1, 0.16],
    )
    kind = rng.choice(kinds, p=shares)
    base = {
        "blue": ((55, 110, 190), (190, 212, 232)),
        "grey": ((150, 155, 162), (215, 218, 222)),
        "white": ((218, 222, 226), (228, 231, 234)),
        "warm": ((110, 105, 140), (246, 180, 110)),
        "dark": ((25, 35, 60), (95, 100, 125)),
        "any": (
            rng.uniform(30, 230) + rng.normal(0, 25, 3),
            rng.uniform(60, 240) + rng.normal(0, 25, 3),
        ),
    }[str(kind)]
    zenith, horizon = (np.array(rgb, np.float32) * rng.uniform(0.75, 1.2) for rgb in base)
    zenith = zenith + rng.normal(0, 12, 3)
    if rng.random() < 0.35:
        zenith = horizon + rng.uniform(0.0, 0.35) * (zenith - horizon)
    horizon = np.clip(horizon + rng.normal(0, 12, 3), 5, 252)
    scale = rng.uniform(0.6, 1.6) * max(skyline_px, 0.15 * height)
    down = np.clip(np.arange(height) / scale, 0, 1)[:, np.newaxis, np.newaxis] ** rng.uniform(
        0.6, 1.8
    )
    sky: NDArray[np.floating] = np.repeat(zenith + down * (horizon - zenith), width, axis=1)
    if rng.random() < 0.35:  # The sun's glow.
        column, row = rng.uniform(-0.2, 1.2) * width, rng.uniform(-0.2, 1.0) * skyline_px
        far = np.hypot(np.arange(width) - column, np.arange(height)[:, np.newaxis] - row)
        glow = rng.uniform(0.1, 0.9) * np.exp(-((far / (rng.uniform(0.1, 0.8) * width)) ** 1.3))
        sky += glow[..., np.newaxis] * (np.array([255, 248, rng.uniform(190, 250)]) - sky)
    for _ in range(rng.choice([0, 1, 2], p=[0.3, 0.45, 0.25])):
        sky = _clouded(rng, sky, horizon, skyline_px)
    haze = horizon + rng.normal(0, 8, 3) + rng.uniform(-0.25, 0.05) * horizon
    return np.asarray(sky, np.float32), np.asarray(np.clip(haze, 0, 255), np.float32)


def _clouded(
    rng: np.random.Generator,
    sky: NDArray[np.floating],
    horizon: NDArray[np.floating],
    skyline_px: float,
) -> NDArray[np.floating]:
    """Put clouds into a sky.

    They are wisps, heaps with hard edges, or a ceiling.
    """
    height, width = sky.shape[:2]
    density = fractal(rng, (height, width), rng.uniform(1.2, 2.0), rng.uniform(1.0, 5.0))
    if rng.random() < 0.4:  # They gather over the ridges.
        over = (skyline_px - np.arange(height)[:, np.newaxis]) / (0.2 * height)
        density = density + 1.3 * np.exp(-np.abs(over)) - 0.5
    threshold = np.quantile(density, 1.0 - rng.uniform(0.08, 1.0))
    soft = rng.choice([0.08, 0.3, 1.0, 2.0])
    opacity = rng.uniform(0.3, 1.0) * np.clip((density - threshold) / soft, 0, 1)
    relief = ndimage.gaussian_filter(density, rng.uniform(0.5, 4.0))
    lit = np.clip(0.5 + rng.uniform(0.0, 12.0) * np.gradient(relief, axis=0), 0, 1)
    thick = np.clip((density - threshold) / 2.5, 0, 1)
    shade = 1.0 - rng.uniform(0.0, 0.45) * thick - rng.uniform(0.0, 0.3) * (1.0 - lit)
    white = np.clip(rng.uniform(0.35, 1.1) * horizon + rng.uniform(0, 70), 10, 255)
    cloud = shade[..., np.newaxis] * white
    return np.asarray(sky + opacity[..., np.newaxis] * (cloud - sky))
