"""A training photograph, and what its pixels are labelled."""

from dataclasses import dataclass

from skyline.arrays import Float32Array, UInt8Array

SKY, GROUND, COVER, UNKNOWN = 0, 1, 2, 255
"""Labels of pixels; a cover is whatever stands in front: a tree, a person, a window's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingPhoto:
    """A photograph and what is true of it."""

    image: UInt8Array  # (H, W, 3)
    label: UInt8Array  # (H, W)
    row_px: Float32Array  # (W,); the skyline, in rows; NaN where none is to be seen
