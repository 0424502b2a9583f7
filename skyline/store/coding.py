"""Compact rows: skylines and depths as small integers that pack well, to a stated error.

A row of W values becomes W unsigned 32-bit codes::

    q = round(elevation_tan / tan_step)      or    q = round(log(depth_m) / depth_log_step)
    code = 0 where the value is NaN, else 1 + zigzag(k-th difference of q along the finite columns)

with k = 2 for `elevation_tan` (a skyline is made of straight pieces, whose second difference is
near 0) and k = 1 for `depth_m` (it jumps from ridge to ridge and stays); zigzag(d) is 2 d for
d >= 0 and -2 d - 1 below. To decode, undo the zigzag, put 0 where the code is 0 and sum k times,
setting the first sum to 0 again where the code is 0. HDF5's own shuffle and gzip do the rest, so
any HDF5 program reads the codes and a few lines of NumPy make values of them.
"""

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from skyline.camera import pixel_size
from skyline.errors import InputError

Codes = NDArray[np.uint32]

TAN_DIFFERENCES = 2
DEPTH_DIFFERENCES = 1

_LARGEST = 1 << 28
"""Of a quantized value, so that a second difference fits the code."""

_NEAREST_M = 1e-3
"""Depths below a millimetre are stored as a millimetre."""


@dataclass(frozen=True, slots=True)
class RowCoding:
    """The steps to which compact rows are rounded.

    Attributes
    ----------
    tan_step : float
        Of `elevation_tan`; it is off by half a step at most.
    depth_log_step : float
        Of the natural logarithm of `depth_m`.

    Raises
    ------
    InputError
        A step that is not a positive number, or is too small for the codes.
    """

    tan_step: float
    depth_log_step: float

    def __post_init__(self) -> None:
        for name in ("tan_step", "depth_log_step"):
            step = getattr(self, name)
            if not (isinstance(step, float) and 1e-7 <= step <= 1.0):
                raise InputError(f"{name} is {step!r}; expected a number from 1e-7 to 1")

    @classmethod
    def within(cls, width: int, tan_error_px: float = 0.005, depth_error: float = 0.001) -> Self:
        """Return the coding of rows of ``width`` columns with these greatest errors.

        The defaults are a tenth of the renderer's own tolerance (0.05 px), and a thousandth of
        the depth: seen from 100 m beside the eye, terrain 1 km away moves by 0.03 px.

        Parameters
        ----------
        width : int
            Columns W of a view.
        tan_error_px : float
            Of `elevation_tan`, in px (1 px = 2 / W).
        depth_error : float
            Of `depth_m`, relative.
        """
        return cls(2.0 * tan_error_px * pixel_size(width), 2.0 * math.log1p(depth_error))

    def tan_error_px(self, width: int) -> float:
        """Return the greatest error of `elevation_tan`, px."""
        return self.tan_step / 2.0 / pixel_size(width)

    @property
    def depth_error(self) -> float:
        """The greatest relative error of `depth_m`."""
        return math.expm1(self.depth_log_step / 2.0)

    def tan_codes(self, elevation_tan: NDArray[Any]) -> Codes:
        """Return the codes of image-plane ordinates, (..., W); raises `InputError` if too large."""
        return _codes(elevation_tan / np.float64(self.tan_step), TAN_DIFFERENCES, "elevation_tan")

    def depth_codes(self, depth_m: NDArray[Any]) -> Codes:
        """Return the codes of depths, (..., W) metres; raises `InputError` if negative."""
        if (depth_m < 0.0).any():
            raise InputError(
                f"a depth to store is {np.nanmin(depth_m)} m; compact rows hold depths in front "
                "of the eye: keep exact rows"
            )
        logarithm = np.log(np.maximum(depth_m, _NEAREST_M, dtype=np.float64))
        return _codes(logarithm / self.depth_log_step, DEPTH_DIFFERENCES, "depth_m")

    def elevation_tan(self, codes: Codes) -> NDArray[np.float32]:
        """Return the image-plane ordinates of codes; NaN where there is none."""
        held = codes != 0
        values = _sums(codes, held, TAN_DIFFERENCES) * self.tan_step
        return _where(held, values)

    def depth_m(self, codes: Codes) -> NDArray[np.float32]:
        """Return the depths of codes, metres; NaN where there is none."""
        held = codes != 0
        # Codes that no skyline wrote may say any number.
        with np.errstate(over="ignore"):
            values = np.exp(_sums(codes, held, DEPTH_DIFFERENCES) * self.depth_log_step)
            return _where(held, values)


def _codes(steps: NDArray[np.float64], differences: int, name: str) -> Codes:
    held = ~np.isnan(steps)
    if not (np.abs(steps[held]) < _LARGEST).all():
        raise InputError(
            f"{name} to store is {np.abs(steps[held]).max():.3g} steps, beyond what compact rows "
            "hold; keep exact rows"
        )
    values = np.rint(np.where(held, steps, 0.0)).astype(np.int32)
    before = _column_before(held)
    for _ in range(differences):
        values = _difference(values, before)
    zigzag = (values << 1 ^ values >> 31).view(np.uint32)
    return np.where(held, zigzag + np.uint32(1), np.uint32(0))


def _column_before(held: NDArray[np.bool_]) -> NDArray[np.intp] | None:
    """Return for each column the last one before it that holds a value, -1 for none.

    None stands for the plain case of no gaps.
    """
    if held.all():
        return None
    column = np.where(held, np.arange(held.shape[-1]), -1)
    latest = np.maximum.accumulate(column, axis=-1)
    before = np.full_like(latest, -1)
    before[..., 1:] = latest[..., :-1]
    return before


def _difference(values: NDArray[np.int32], before: NDArray[np.intp] | None) -> NDArray[np.int32]:
    if before is None:
        return np.diff(values, axis=-1, prepend=np.int32(0))
    previous = np.take_along_axis(values, np.maximum(before, 0), axis=-1)
    return values - np.where(before < 0, np.int32(0), previous)


def _sums(codes: Codes, held: NDArray[np.bool_], differences: int) -> NDArray[np.int32]:
    zigzag = codes - held
    values = (zigzag >> 1).view(np.int32) ^ -(zigzag & 1).view(np.int32)
    for turn in range(differences):
        if turn:
            values *= held
        values = np.cumsum(values, axis=-1, dtype=np.int32)
    return values


def _where(held: NDArray[np.bool_], values: NDArray[np.floating]) -> NDArray[np.float32]:
    # In place: a copy of the array costs as much as its decoding.
    single = values.astype(np.float32)
    single[~held] = np.nan
    return single
