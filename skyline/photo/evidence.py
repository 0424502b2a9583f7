"""What speaks for sky and for ground, pixel by pixel: edges and colours."""

from dataclasses import dataclass
from math import sqrt

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from skyline.arrays import BoolArray, Float32Array, UInt8Array

FINE_PIXELS = 2_800_000
"""Photos are reduced to this for their edges, and to a quarter of it for everything else."""

SKY_SEED_SHARE = 0.15
"""Share of the rows, from the top, that are taken for sky before any path is known."""

_NOISE_CEILING = 2.0
"""Noise units below which there is no edge: summed over a hundred rows of sky, little is much."""
_HALF_EDGE = 2.0
"""Noise units above that at which an edge counts half."""
_MIN_NOISE = (1.0, 2.5, 2.5)
"""Smallest edge noise of L*, a* and b*: 8-bit rounding, and the steps between JPEG's blocks, which
are coarse in colour and would be taken for edges in smooth sky."""

_SHARPNESS_REACH = (6, 2, 2)
"""Pixels at the fine size, up, down and aside, over which an edge's whole contrast is taken."""
_SOFT_TO_SHARP = (0.4, 0.75)
"""Share of that contrast within two pixels: clouds' edges have about 0.5, ridges 0.7 to 0.95."""
_SOFT_WEIGHT = 0.3
"""What a soft edge still counts: a photo may be out of focus."""

_THIN_PX = 11
"""Width, at the fine size, of the median that takes thin things away: wires, twigs, lettering."""
_THIN_REACH = 5
"""Working pixels square in which an edge is looked for in what is left: a median rounds corners."""
_THIN_CONTRAST = 10.0
"""L*a*b* distance of a thin thing from what surrounds it."""
_THIN_TO_SOLID = (0.25, 0.5)
"""Share of an edge's steepness that is left: a wire's is next to nothing."""

_CLEARLY_DARKER = 15.0
"""L* - b* below the threshold at which a pixel is surely ground."""

_LAB_ORIGIN = np.array([0.0, -64.0, -64.0], dtype=np.float32)
_LAB_BINS = (26, 32, 32)
_BIN_WIDTH = 4.0
_BLUR_BINS = 1.0
_RARE = 1e-4
"""Density that every colour has in both classes: unseen colours say nothing."""
_MAX_LOG_RATIO = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """A photo at working size, (h, w).

    Attributes
    ----------
    lab : (h, w, 3) float32
        CIE L*a*b*.
    edges : (h, w) float32
        0 where smooth, 1 on an edge that is clear of the noise and sharp at twice this size:
        clouds have soft edges, mountains have sharp ones.
    thin : (h, w) bool
        Where something narrow, a pole or a wire, differs from what surrounds it.
    row_scale : float
        Working rows per photo row, about 0.5 at most.
    """

    lab: Float32Array
    edges: Float32Array
    thin: BoolArray
    row_scale: float


def gather_evidence(photo: UInt8Array) -> Evidence:
    """Reduce a photo (H, W, 3) uint8 RGB to working size and find its edges."""
    height, width = photo.shape[:2]
    shrink = min(1.0, sqrt(FINE_PIXELS / (height * width)))
    h, w = round(height * shrink / 2.0), round(width * shrink / 2.0)
    fine = _resized(photo, 2 * w, 2 * h)
    solid = np.asarray(cv2.medianBlur(fine, _THIN_PX), dtype=np.uint8)
    lab = to_lab(_resized(fine, w, h))
    thin = np.linalg.norm(lab - to_lab(_resized(solid, w, h)), axis=2) > _THIN_CONTRAST
    return Evidence(lab, _sharp_edges(to_lab(fine), to_lab(solid)), thin, h / height)


def _resized(rgb: UInt8Array, width: int, height: int) -> UInt8Array:
    return np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def to_lab(rgb: UInt8Array) -> Float32Array:
    """Convert (..., 3) uint8 RGB, three axes, to float32 CIE L*a*b*."""
    scaled = np.ascontiguousarray(rgb, dtype=np.float32) / np.float32(255.0)
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_RGB2LAB), dtype=np.float32)


def _sharp_edges(lab: Float32Array, solid_lab: Float32Array) -> Float32Array:
    """Return edges of a (2h, 2w, 3) photo on the grid of half its size, 0 to 1.

    ``solid_lab`` is the photo without what is thin: an edge that it lacks is a wire's, which has
    the same sky on both sides.

    Each channel is measured in units of its own noise in the sky: JPEG keeps colour less well
    than lightness, and its colour noise would otherwise pass for edges.
    """
    steepness = np.zeros((lab.shape[0] // 2, lab.shape[1] // 2), dtype=np.float32)
    contrast, solid = np.zeros_like(steepness), np.zeros_like(steepness)
    for index in range(3):
        channel = np.ascontiguousarray(lab[:, :, index])
        steepest = _halved(_squared_gradient(channel))
        in_sky = steepest[: max(1, int(SKY_SEED_SHARE * len(steepest)))]
        noise = max(_MIN_NOISE[index], _noise(in_sky))
        steepness += steepest / np.float32(noise**2)
        contrast += _halved(_local_range(channel) ** 2) / np.float32(noise**2)
        solid_channel = np.ascontiguousarray(solid_lab[:, :, index])
        solid += _halved(_squared_gradient(solid_channel)) / np.float32(noise**2)
    steepness, contrast, solid = np.sqrt(steepness), np.sqrt(contrast), np.sqrt(solid)
    clear = np.square(np.maximum(steepness - np.float32(_NOISE_CEILING), 0.0))
    clear /= clear + np.float32(_HALF_EDGE**2)
    sharpness = steepness / np.maximum(contrast, 2.0 * _NOISE_CEILING)
    soft, sharp = _SOFT_TO_SHARP
    weight = np.clip((sharpness - soft) / (sharp - soft), _SOFT_WEIGHT, 1.0)
    near = cv2.dilate(solid, np.ones((_THIN_REACH, _THIN_REACH), dtype=np.uint8))
    left = near / np.maximum(steepness - _NOISE_CEILING, _NOISE_CEILING)
    thin, thick = _THIN_TO_SOLID
    solidity = np.clip((left - thin) / (thick - thin), 0.0, 1.0)
    return np.asarray(clear * weight * solidity, dtype=np.float32)


def _squared_gradient(channel: Float32Array) -> Float32Array:
    across = cv2.Sobel(channel, cv2.CV_32F, 1, 0, ksize=3, scale=0.25)
    down = cv2.Sobel(channel, cv2.CV_32F, 0, 1, ksize=3, scale=0.25)
    return np.asarray(across**2 + down**2, dtype=np.float32)


def _noise(squares: Float32Array) -> float:
    """Return the 90th percentile of what is mostly noise, given squared.

    Where captions, logos or a peak reach up there, the median says it better.
    """
    middle, high = np.sqrt(np.percentile(squares, [50.0, 90.0]))
    return float(min(high, 1.7 * middle))


def _local_range(channel: Float32Array) -> Float32Array:
    """Return greatest minus least value from above each pixel to just below it.

    Looking upwards only, a ridge is not measured against the snow and rock beneath it. Single
    noisy pixels are smoothed away.
    """
    smooth = cv2.blur(channel, (3, 3))
    reach_up, reach_down, reach_aside = _SHARPNESS_REACH
    window = np.ones((reach_up + reach_down + 1, 2 * reach_aside + 1), dtype=np.uint8)
    anchor = (reach_aside, reach_up)
    greatest = cv2.dilate(smooth, window, anchor=anchor)
    least = cv2.erode(smooth, window, anchor=anchor)
    return np.asarray(greatest - least, dtype=np.float32)


def _halved(values: Float32Array) -> Float32Array:
    """Return the greatest of each 2 x 2 block."""
    h, w = values.shape[0] // 2, values.shape[1] // 2
    return np.asarray(values.reshape(h, 2, w, 2).max(axis=(1, 3)))


def daylight_groundness(lab: Float32Array) -> Float32Array:
    """Return 0 to 1, (h, w): how sure a pixel is too dark or too yellow for this photo's sky.

    By day the sky is among what is brightest or bluest. Otsu's threshold parts that from the
    rest; snow falls on the sky's side, so this tells ground only, never sky.
    """
    brightness = np.clip(lab[:, :, 0] - lab[:, :, 2], 0.0, 255.0)
    middle, _ = cv2.threshold(
        brightness.astype(np.uint8), 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU
    )
    return np.asarray(np.clip((middle - brightness) / _CLEARLY_DARKER, 0.0, 1.0), np.float32)


class ColourModel:
    """Colours of sky and ground as smoothed histograms, learnt from a labelling of the photo."""

    def __init__(self, lab: Float32Array) -> None:
        index = ((lab - _LAB_ORIGIN) / np.float32(_BIN_WIDTH)).astype(np.intp)
        index = np.clip(index, 0, np.array(_LAB_BINS) - 1)
        self._bin = np.ravel_multi_index(tuple(np.moveaxis(index, -1, 0)), _LAB_BINS)

    def groundness(self, is_sky: BoolArray, is_ground: BoolArray) -> Float32Array:
        """Return the clipped log-likelihood ratio of ground to sky, (h, w), -1 to 1."""
        ratio = np.log(self._density(is_ground) / self._density(is_sky))
        table = np.clip(ratio / _MAX_LOG_RATIO, -1.0, 1.0).astype(np.float32)
        return np.asarray(table[self._bin])

    def _density(self, members: BoolArray) -> NDArray[np.float64]:
        counts = np.bincount(self._bin[members], minlength=int(np.prod(_LAB_BINS)))
        smooth = ndimage.gaussian_filter(counts.reshape(_LAB_BINS).astype(np.float64), _BLUR_BINS)
        return np.asarray(smooth.ravel() / max(smooth.sum(), 1.0) + _RARE)
