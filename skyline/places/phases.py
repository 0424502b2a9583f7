r"""Rises of a skyline as phases: two of them are alike by a bounded kernel.

A skyline is reduced to the rises d between the means of neighbouring runs of bins. A pitch hardly
changes them, and a roll adds nearly the same to each. Two rises are alike by

.. math::

    k(d, d') = \cos(\omega (d - d')) = \mathrm{Re}\, e^{i \omega d} \overline{e^{i \omega d'}}

so what is far off counts no more than what is off, and the sum over many rises is a product of
matrices. A phase takes a byte.
"""

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, UInt8Array
from skyline.places.coding import PHASE_BINS, looked_up

Complex64Array = NDArray[np.complex64]

PHASES = 255
"""Phases are counted in so many steps of a turn; code 0 stands for an unknown rise."""

ALIKE_DEG = 0.75
"""Rises over 2 degrees of azimuth that differ by this much elevation count nothing."""


def rise_to_turn() -> float:
    """Return omega, radians per unit of tangent: `ALIKE_DEG` is a quarter turn."""
    return float(np.pi / 2.0 / np.radians(ALIKE_DEG))


def encode_phases(elevation_tan: Float32Array) -> UInt8Array:
    """Return the phases' codes (N, 180) of skylines (N, B): 1 + floor(255 phase / 2 pi).

    A rise is from the mean of a run of bins to that of the next, from the last to the first run.
    It is unknown, and its code 0, where either run has a bin without a skyline.
    """
    mean = elevation_tan.reshape(len(elevation_tan), PHASE_BINS, -1).mean(axis=2)
    turns = (np.roll(mean, -1, axis=1) - mean) * np.float32(rise_to_turn() / (2.0 * np.pi))
    turns -= np.floor(turns)
    known = np.isfinite(turns)
    steps = np.minimum(np.where(known, turns, 0.0) * PHASES, PHASES - 1)
    return np.where(known, steps.astype(np.uint8) + 1, 0).astype(np.uint8)


def decode_phases(codes: UInt8Array) -> Complex64Array:
    """Return exp(i phase) (N, 180) complex64 of codes; 0 where the rise is unknown."""
    return looked_up(codes, _WAVES)


def _waves() -> Complex64Array:
    phase = (np.arange(PHASES) + 0.5) * (2.0 * np.pi / PHASES)
    return np.concatenate([[0.0], np.exp(1j * phase)]).astype(np.complex64)


_WAVES = _waves()
