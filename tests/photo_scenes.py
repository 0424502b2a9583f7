"""Synthetic mountain photos whose skyline is known to a fraction of a pixel."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scenes import write_dem
from scipy import ndimage

from skyline.arrays import Float64Array

BLUE, PALE, WHITE = (70.0, 120.0, 190.0), (190.0, 210.0, 230.0), (236.0, 238.0, 240.0)
ROCK, SNOW, FOREST = (95.0, 85.0, 75.0), (238.0, 240.0, 245.0), (45.0, 60.0, 40.0)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A picture, the true border row per column, and where that border is visible at all."""

    image: NDArray[np.uint8]
    row_px: Float64Array
    visible: NDArray[np.bool_]


def ridge(rng: np.random.Generator, width: int, height: int, relief: float = 0.12) -> Float64Array:
    """Border rows: octaves of interpolated noise with peaks at the scale of mountains.

    The relief is a share of the height, or of two thirds of the width of an upright picture: the
    mountains in it are no steeper.
    """
    columns = np.arange(width) / width
    row = np.full(width, 0.42 * height)
    for octave in range(1, 7):
        knots = 3 * 2**octave
        noise = rng.uniform(-1.0, 1.0, knots + 1)
        size_px = min(height, width / 1.5) * relief * 2.0**-octave * 2
        row -= size_px * np.interp(columns * knots, np.arange(knots + 1), noise)
    return row


def texture(rng: np.random.Generator, shape: tuple[int, int], blur_px: float) -> Float64Array:
    """Noise of unit deviation, smooth over ``blur_px``."""
    noise = ndimage.gaussian_filter(rng.standard_normal(shape), blur_px)
    return noise / noise.std()


def sky(width: int, height: int, zenith=BLUE, horizon=PALE) -> Float64Array:
    """Vertical gradient, (H, W, 3)."""
    t = np.linspace(0.0, 1.0, height)[:, np.newaxis, np.newaxis] * 2.0
    t = np.broadcast_to(np.clip(t, 0.0, 1.0), (height, width, 1))
    return (1.0 - t) * np.array(zenith) + t * np.array(horizon)


def ground(rng: np.random.Generator, width: int, height: int, colour=ROCK) -> Float64Array:
    """Rough ground of one colour, (H, W, 3)."""
    rough = 10.0 * texture(rng, (height, width), 1.0) + 12.0 * texture(rng, (height, width), 8.0)
    return np.array(colour) + rough[:, :, np.newaxis]


def snow_cap(rng, base: Float64Array, row_px: Float64Array, depth_px: float) -> Float64Array:
    """Snow over the upper part of the ground, rock showing through lower down."""
    height, width = base.shape[:2]
    rows = np.arange(height)[:, np.newaxis]
    edge = row_px.min() + depth_px + 15.0 * texture(rng, (height, width), 12.0)
    is_snow = np.clip((edge - rows) / 3.0, 0.0, 1.0)[:, :, np.newaxis]
    white = np.array(SNOW) + 2.0 * texture(rng, (height, width), 3.0)[:, :, np.newaxis]
    return is_snow * white + (1.0 - is_snow) * base


def clouds(rng, above: Float64Array, row_px: Float64Array, count: int) -> Float64Array:
    """Smooth bright blobs in the sky, half of them touching the ridge."""
    height, width = above.shape[:2]
    rows, columns = np.mgrid[0:height, 0:width]
    cover = np.zeros((height, width))
    for index in range(count):
        column = rng.uniform(0.05, 0.95) * width
        at_ridge = row_px[int(column)]
        row = at_ridge - 0.02 * height if index % 2 == 0 else at_ridge * rng.uniform(0.3, 0.8)
        rx, ry = rng.uniform(0.04, 0.1) * width, rng.uniform(0.02, 0.05) * height
        cover += np.exp(-(((columns - column) / rx) ** 2) - ((rows - row) / ry) ** 2)
    wisps = 1.0 + 0.25 * texture(rng, (height, width), 0.012 * width)
    cover = np.clip(1.3 * cover * wisps, 0.0, 0.9)[:, :, np.newaxis]
    return (1.0 - cover) * above + cover * np.array(WHITE)


def compose(above: Float64Array, below: Float64Array, row_px: Float64Array) -> Float64Array:
    """Sky over ground, antialiased along the border: pixel r spans r - 0.5 to r + 0.5."""
    share = np.clip(np.arange(len(above))[:, np.newaxis] + 0.5 - row_px, 0.0, 1.0)[..., np.newaxis]
    return (1.0 - share) * above + share * below


def expose(rng: np.random.Generator, picture: Float64Array, noise: float) -> NDArray[np.uint8]:
    """A little lens blur, sensor noise, 8 bits."""
    blurred = ndimage.gaussian_filter(picture, (0.6, 0.6, 0.0))
    noisy = blurred + noise * rng.standard_normal(picture.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def make_scene(kind: str, seed: int, width: int = 960, height: int = 640) -> Scene:
    """Draw one of the kinds in ``KINDS``."""
    rng = np.random.default_rng([seed, 1 + sorted(KINDS).index(kind)])
    row_px = ridge(rng, width, height)
    visible = np.ones(width, dtype=bool)
    above, below, noise = sky(width, height), ground(rng, width, height), 2.0
    if kind == "haze":
        below = 0.2 * below + 0.8 * np.array(PALE)
    elif kind == "clouds":
        above = clouds(rng, above, row_px, 6)
    elif kind == "noise":
        noise = 10.0
    elif kind == "snow":
        below = snow_cap(rng, below, row_px, 0.2 * height)
    elif kind == "snow_white_sky":
        above = sky(width, height, (200.0, 204.0, 208.0), (222.0, 224.0, 226.0))
        below = snow_cap(rng, below, row_px, 0.25 * height)
    elif kind == "layers":
        near = ridge(rng, width, height) + 0.12 * height
        far = 0.45 * ground(rng, width, height) + 0.55 * np.array(PALE)
        below = compose(far, ground(rng, width, height, FOREST), near)
    picture = compose(above, below, row_px)
    if kind == "poles":
        for column in rng.uniform(0.05, 0.95, 5) * width:
            lo = int(column)
            hi = lo + int(rng.integers(3, 8))
            picture[int(rng.uniform(0.0, 0.15) * height) :, lo:hi] = FOREST
            visible[max(lo - 2, 0) : hi + 2] = False
    return Scene(expose(rng, picture, noise), row_px, visible)


KINDS = ("clear", "haze", "clouds", "noise", "snow", "snow_white_sky", "layers", "poles")


HEIC = b"\x00\x00\x00\x18ftypheic\x00\x00\x00\x00" + b"\x00" * 99
"""The first bytes of a photo that Pillow does not read."""


def photo_folder(folder):
    """Fill a folder with photos and nine other files; return the names of the photos."""
    picture = Image.new("RGB", (40, 30))
    photos = ["IMG_0001", "scan.tif", "pano.insp", "trip/day 2/b.JPG", "c.gif"]
    for name in photos:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        picture.save(folder / name, {"gif": "GIF", "tif": "TIFF"}.get(name[-3:], "JPEG"))
    (folder / "d.HIF").write_bytes(HEIC.replace(b"heic", b"heix"))
    (folder / "damaged.jpg").write_bytes(b"")
    picture.save(folder / "raw.cr2", format="TIFF")
    write_dem(folder / "map.tif", np.ones((30, 40), np.float32))
    picture.save(folder / "video.THM", format="JPEG")
    (folder / "video.mp4").write_bytes(b"\x00\x00\x00\x18ftypmp42" + bytes(99))
    for name in ("Thumbs.db", "a.json", "a.xmp", "b.xmp", "trace.csv"):
        (folder / name).write_text("<x:xmpmeta/>")
    for hidden in (".thumbnails", "__MACOSX", "@eaDir"):
        (folder / hidden).mkdir()
        picture.save(folder / hidden / "e.jpg")
    return [*photos, "d.HIF", "damaged.jpg"]


@dataclass
class BlueSky:
    """A sky model that takes what is bluer than red for sky, at a slope of the threshold."""

    size: tuple[object, object] = ("h", "w")
    form: str = "probability"
    seen: tuple[int, ...] = ()

    def get_inputs(self):
        return [SimpleNamespace(name="photo", shape=[1, 3, *self.size])]

    def run(self, names, feed):
        photo = feed["photo"]
        assert photo.dtype == np.float32
        assert 0.0 <= photo.min() <= photo.max() <= 1.0
        self.seen = photo.shape
        logit = 40.0 * (photo[:, 2:] - photo[:, :1] - 0.08)
        sky = 1.0 / (1.0 + np.exp(-logit))
        return {
            "probability": [sky],
            "flat": [sky[:, 0]],
            "two": [np.concatenate([1.0 - sky, sky], axis=1)],
            "logits": [logit],
            "two logits": [np.concatenate([-logit / 2.0, logit / 2.0], axis=1)],
        }[self.form]


def in_haze(skyline):
    """A photo of a skyline that is six levels darker than the sky, with rocks in front of it."""
    height, width = skyline.height_px, skyline.width_px
    trusted = np.flatnonzero(np.isfinite(skyline.row_px))
    far = np.interp(np.arange(width), trusted, skyline.row_px[trusted])
    rng = np.random.default_rng(1)
    rocks = ridge(rng, width, height, 0.10) + far.max() + 60.0 - 0.42 * height
    rows = np.arange(height)[:, np.newaxis]
    picture = sky(width, height) - np.array([7.0, 6.0, 4.0]) * (rows > far)[..., np.newaxis]
    picture = np.where((rows > rocks)[..., np.newaxis], ground(rng, width, height), picture)
    picture += rng.normal(0.0, 1.2, picture.shape)
    return np.clip(picture, 0.0, 255.0).astype(np.uint8)
