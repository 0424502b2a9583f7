"""The network that gives the odds of the skyline in each pixel.

Its weights are in ``sky.onnx.gz``, written by ``python -m skyline_training sky-model``. Its encoder
was trained on real photographs (ImageNet), and then all of it on drawn mountains, clouds, trees and
windows.
"""

import gzip
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from math import sqrt
from threading import Lock

import cv2
import numpy as np

from skyline.arrays import Float32Array, UInt8Array


@dataclass(frozen=True, slots=True)
class _Input:
    """The picture that the network is shown."""

    pixels: int = 230_000
    """Its size for photos of the shape 3:2."""
    aspect_scale: tuple[float, float] = (0.7, 2.6)
    """Least and greatest factor on the size for other shapes: a panorama must be as tall as a
    photo, and an upright photo as detailed as a landscape one."""
    least_pixels: int = 110_000
    """Smaller photos are enlarged to this size, others never."""
    multiple_px: int = 32
    """The sides are multiples of this."""
    levels: tuple[float, float] = (1.0, 99.0)
    """Percentiles of a channel that become its darkest and its brightest value."""


_INPUT = _Input()
_network_lock = Lock()
"""Held while the network runs: it keeps its input."""


def network_odds(photo: UInt8Array) -> Float32Array:
    """Return log-odds (h', w') of the skyline in each pixel.

    They are the odds of a skyline there against none in the column.
    """
    height, width = photo.shape[:2]
    wanted = _INPUT.pixels * aspect_scale(height, width)
    shrink = sqrt(min(wanted, max(height * width, _INPUT.least_pixels)) / (height * width))
    multiple_px = _INPUT.multiple_px
    h, w = (max(1, round(side * shrink / multiple_px)) * multiple_px for side in (height, width))
    small = np.asarray(cv2.resize(photo, (w, h), interpolation=cv2.INTER_AREA), np.uint8)
    picture = np.empty((1, 4, h, w), dtype=np.float32)
    picture[0, :3] = levelled(small).transpose(2, 0, 1)
    picture[0, 3] = np.linspace(-1.0, 1.0, h, dtype=np.float32)[:, np.newaxis]
    with _network_lock:
        _network().setInput(picture)
        scores = _network().forward()
    return np.asarray(scores[0, 0], dtype=np.float32)


def aspect_scale(height: int, width: int) -> float:
    """Return the factor on the network's input for a photo's aspect."""
    return float(np.clip(max(width / height, height / width) / 1.5, *_INPUT.aspect_scale))


def levelled(rgb: UInt8Array) -> Float32Array:
    """Return pixels (H, W, 3) from -1 to 1, without a tint.

    Each channel is scaled to its own range.
    """
    low, high = np.percentile(rgb.reshape(-1, 3), _INPUT.levels, axis=0).astype(np.float32)
    share = (rgb - low) / np.maximum(high - low, np.float32(1.0))
    return np.asarray(2.0 * np.clip(share, 0.0, 1.0) - 1.0, dtype=np.float32)


@lru_cache(maxsize=1)
def _network() -> cv2.dnn.Net:
    packed = files("skyline.photo").joinpath("sky.onnx.gz").read_bytes()
    return cv2.dnn.readNetFromONNX(np.frombuffer(gzip.decompress(packed), dtype=np.uint8))
