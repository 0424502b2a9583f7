"""A training photograph: what its pixels are labelled, and the drawing that it is made of."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float32Array, UInt8Array

SKY, GROUND, COVER, UNKNOWN = 0, 1, 2, 255
"""Labels of pixels; a cover is whatever stands in front: a tree, a person, a window's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingPhoto:
    """A photograph and what is true of it."""

    image: UInt8Array  # (H, W, 3)
    label: UInt8Array  # (H, W)
    row_px: Float32Array  # (W,); the skyline, in rows; NaN where none is to be seen


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

    def paint(self, opacity: ArrayLike, rgb: ArrayLike, mark: int) -> None:
        """Paint a colour (H, W, 3), and label what it hides."""
        share = np.asarray(opacity, dtype=np.float32)
        self.picture += share[..., np.newaxis] * (np.asarray(rgb, np.float32) - self.picture)
        self.label[share > 0.5] = mark
