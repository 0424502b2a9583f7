"""What speaks for the skyline, pixel by pixel: a network's odds, and edges.

The network says roughly where each column's skyline runs, and whether it has one: it has learnt
from drawn photographs what mountains, clouds, trees and windows look like together. Edges say where
in there the border is. ``sky.onnx.gz`` is made by ``python -m skyline_training sky-model``.
"""

import gzip
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from math import log, sqrt
from threading import Lock

import cv2
import numpy as np

from skyline.arrays import Float32Array, Float64Array, IntArray, UInt8Array

_NETWORK_PIXELS = 110_000
"""The network sees photos at about this size, at which it was trained..."""
_MULTIPLE_PX = 32
"""...with sides that are multiples of this."""
_WORK_PIXELS = 400_000
"""Photos are reduced to this for their edges and for the path along them."""

_LEVELS = (1.0, 99.0)
"""Percentiles of a channel that become its darkest and its brightest."""

_LEAST_LOG_SHARE = -10.0
"""Below it a row is as unlikely as any: what the network has never seen must not decide alone."""
_ODDS_WEIGHT = 0.25
"""What a factor e in the probability is worth, in units of a full edge."""
_EDGE_REACH_SHARE = 0.02
"""Rows, as a share of all, up and down among which the sharpest edge counts fully..."""
_FULL_SHARE = 0.5
"""...and so does one of this share of its sharpness: rock before sky must not lose to snow."""
_EDGE_FLOOR = 3.0
"""L*a*b* difference that halves an edge: JPEG and noise have such."""
_SAME_SHARE = 0.01
"""Share of the rows within which two rows are the same skyline."""

_network_lock = Lock()


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """A photo at working size, (h, w)."""

    share: Float32Array
    """(h, w) float32. Probability that the column's skyline runs through the pixel. A column's sum
    is the probability that it shows a skyline at all."""
    cost: Float32Array
    """(h, w) float32. Of a path through the pixel, in units of the reward for a full edge."""
    row_scale: float
    """Working rows per photo row."""

    def confidence(self, row: IntArray) -> Float64Array:
        """Return the probability, (w,), that the skyline is where a path (w,) runs."""
        height, width = self.share.shape
        summed = np.vstack([np.zeros((1, width)), np.cumsum(self.share, axis=0, dtype=np.float64)])
        near = max(2, round(_SAME_SHARE * height))
        columns = np.arange(width)
        above = summed[np.clip(row - near, 0, height), columns]
        inside = summed[np.clip(row + near + 1, 0, height), columns] - above
        # On the photo's edge, what is found there is the edge.
        return np.where((row <= 1) | (row >= height - 2), 0.0, inside)


def gather_evidence(photo: UInt8Array) -> Evidence:
    """Reduce a photo (H, W, 3) uint8 RGB to working size and look for its skyline."""
    height, width = photo.shape[:2]
    shrink = min(1.0, sqrt(_WORK_PIXELS / (height * width)))
    h, w = max(1, round(height * shrink)), max(1, round(width * shrink))
    small = cv2.resize(photo, (w, h), interpolation=cv2.INTER_AREA)
    odds = _network_odds(np.asarray(small, dtype=np.uint8))
    none = log(h / len(odds))
    odds = np.asarray(cv2.resize(odds, (w, h), interpolation=cv2.INTER_LINEAR), np.float32)
    greatest = np.maximum(odds.max(axis=0), none)
    share = np.exp(odds - greatest)
    share /= share.sum(axis=0) + np.exp(none - greatest)
    likely = np.maximum(np.log(share + np.float32(1e-12)), _LEAST_LOG_SHARE)
    cost = -_ODDS_WEIGHT * likely - _edges(to_lab(np.asarray(small, dtype=np.uint8)))
    return Evidence(share, np.asarray(cost, dtype=np.float32), h / height)


def to_lab(rgb: UInt8Array) -> Float32Array:
    """Convert (..., 3) uint8 RGB, three axes, to float32 CIE L*a*b*."""
    scaled = np.ascontiguousarray(rgb, dtype=np.float32) / np.float32(255.0)
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_RGB2LAB), dtype=np.float32)


@lru_cache(maxsize=1)
def _network() -> cv2.dnn.Net:
    packed = files("skyline.photo").joinpath("sky.onnx.gz").read_bytes()
    return cv2.dnn.readNetFromONNX(np.frombuffer(gzip.decompress(packed), dtype=np.uint8))


def levelled(rgb: UInt8Array) -> Float32Array:
    """Return (H, W, 3) from -1 to 1, each channel over its own range: without a photo's tint."""
    low, high = np.percentile(rgb.reshape(-1, 3), _LEVELS, axis=0).astype(np.float32)
    share = (rgb - low) / np.maximum(high - low, np.float32(1.0))
    return np.asarray(2.0 * np.clip(share, 0.0, 1.0) - 1.0, dtype=np.float32)


def _network_odds(photo: UInt8Array) -> Float32Array:
    """Return log-odds, (h', w'), of each column's skyline running there against it having none."""
    height, width = photo.shape[:2]
    shrink = sqrt(_NETWORK_PIXELS / (height * width))
    h, w = (max(1, round(side * shrink / _MULTIPLE_PX)) * _MULTIPLE_PX for side in (height, width))
    small = cv2.resize(photo, (w, h), interpolation=cv2.INTER_AREA)
    picture = np.empty((1, 4, h, w), dtype=np.float32)
    picture[0, :3] = levelled(np.asarray(small, dtype=np.uint8)).transpose(2, 0, 1)
    picture[0, 3] = np.linspace(-1.0, 1.0, h, dtype=np.float32)[:, np.newaxis]
    with _network_lock:
        _network().setInput(picture)
        scores = _network().forward()
    return np.asarray(scores[0, 0], dtype=np.float32)


def _edges(lab: Float32Array) -> Float32Array:
    """Return 0 where smooth, 1 on what is nearly the sharpest edge up and down from it, (h, w)."""
    across = cv2.Sobel(lab, cv2.CV_32F, 1, 0, ksize=3, scale=0.25)
    down = cv2.Sobel(lab, cv2.CV_32F, 0, 1, ksize=3, scale=0.25)
    steepness = np.sqrt((across**2 + down**2).sum(axis=2))
    reach = max(2, round(_EDGE_REACH_SHARE * len(lab)))
    sharpest = cv2.dilate(steepness, np.ones((2 * reach + 1, 1), dtype=np.uint8))
    edges = steepness / (_FULL_SHARE * sharpest + _EDGE_FLOOR)
    return np.asarray(np.minimum(edges, 1.0), dtype=np.float32)
