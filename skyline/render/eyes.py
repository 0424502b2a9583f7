"""The eyes of a batch of views as the shader reads them, and bounds on the skylines they see."""

from collections.abc import Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Float64Array
from skyline.camera import HEADINGS, rotation
from skyline.render.windows import Window
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_Scalar = TypeVar("_Scalar", bound=np.generic)

_EYE_DTYPE = np.dtype(
    [
        ("nearest", "<i4", 2),
        ("offset", "<f4", 2),
        ("offset_low", "<f4", 2),
        ("elevation_m", "<f4", 2),
        ("turn_tan", "<f4", 2),
    ]
)
"""The layout of struct Eye in `horizon.comp`; ``nearest`` is relative to the window.

``turn_tan`` is the tangent of an angle by which all of an eye's columns are turned clockwise; none
may leave the view of 90 degrees.
"""

_ROUNDING = 3.0 * 2.0**-24
"""Relative rounding error of a crossing's height in float32."""


class Eyes:
    """The eyes of N views, sorted so that marches of one kind lie together.

    ``turn_rad`` (N,) is the angle by which all columns of an eye are turned clockwise.
    """

    def __init__(
        self,
        field: HeightField,
        viewpoints: Viewpoints,
        heading: NDArray[np.uint8],
        near_error: float,
        turn_rad: Float64Array,
    ) -> None:
        self._spacing_m = np.array([field.spacing_north_m, field.spacing_east_m])
        row, col = field.to_grid(easting_m=viewpoints.easting_m, northing_m=viewpoints.northing_m)
        double = _needs_double(field, viewpoints, row, col, near_error)
        self._order = np.lexsort((double, heading))
        self._double, self._heading = double[self._order], heading[self._order]
        self._place = np.stack([row, col], axis=-1)[self._order]
        self._elevation_m = viewpoints.eye_elevation_m[self._order]
        self._turn_tan = np.tan(turn_rad)[self._order]

    def __len__(self) -> int:
        return len(self._order)

    def groups(self) -> Iterator[tuple[slice, int, bool]]:
        """Yield the sorted rows of each heading and precision that occurs; True is float64."""
        kind = 2 * self._heading.astype(np.int64) + self._double
        for value in np.unique(kind):
            rows = np.flatnonzero(kind == value)
            yield slice(int(rows[0]), int(rows[-1]) + 1), int(value) // 2, bool(value % 2)

    def in_order(self, values: NDArray[_Scalar]) -> NDArray[_Scalar]:
        """Put (N, ...) results of sorted views back into the order given."""
        return values[np.argsort(self._order)]

    def relative_to(self, window: Window) -> NDArray[np.void]:
        """Return the sorted eyes (N,) as the shader reads them, placed in a window."""
        eyes = np.zeros(len(self), dtype=_EYE_DTYPE)
        nearest = np.rint(self._place)
        eyes["nearest"] = nearest.astype(np.int64) - (window.row, window.col)
        eyes["offset"], eyes["offset_low"] = split_float(self._place - nearest)
        eyes["elevation_m"] = np.stack(split_float(self._elevation_m), axis=-1)
        eyes["turn_tan"] = np.stack(split_float(self._turn_tan), axis=-1)
        return eyes

    def nearest_first(self, windows: list[Window]) -> list[Window]:
        """Sort windows by their distance from the eyes' middle."""
        if not len(self) or len(windows) == 1:
            return windows
        middle = np.median(self._place, axis=0)
        return sorted(windows, key=lambda window: float(np.hypot(*self._gap(window, middle))))

    def greatest_tan(self, window: Window, highest_m: float, drop_per_m2: float) -> Float64Array:
        """Return an upper bound of v over a window no higher than ``highest_m``, (N,), sorted.

        -inf where the window lies outside the view.
        """
        corners = np.array(
            [[row, col] for row in (0, window.rows - 1) for col in (0, window.cols - 1)],
            dtype=np.float64,
        )
        offset = np.array([window.row, window.col]) + corners - self._place[:, np.newaxis]
        south, east = np.moveaxis(offset * self._spacing_m, -1, 0)
        turn = np.stack([rotation(heading)[[0, 2]][:, [0, 2]] for heading in HEADINGS])
        ground = np.stack([east, -south], axis=-1)
        camera = np.einsum("ncg,nkg->nkc", ground, turn[self._heading])
        right, forward = camera[:, 0], camera[:, 1]
        one_side = np.sign(right).min(axis=1) == np.sign(right).max(axis=1)
        aside = np.where(one_side, np.abs(right).min(axis=1), 0.0)
        # In a wedge of 90 degrees the depth is at least the distance over the root of 2.
        gap = self._gap(window, self._place)
        nearest = np.maximum(forward.min(axis=1), np.hypot(gap[:, 0], gap[:, 1]) / np.sqrt(2.0))
        farthest = forward.max(axis=1)
        # A metre covers all rounding.
        up = highest_m - self._elevation_m + 1.0 - drop_per_m2 * (gap[:, 0] ** 2 + gap[:, 1] ** 2)
        bound = up / np.maximum(np.where(up > 0.0, nearest, farthest), 1e-3)
        return np.where(farthest < aside, -np.inf, bound)

    def _gap(self, window: Window, place: Float64Array) -> Float64Array:
        """Return the distances of places (..., 2) from a window, north-south and east-west."""
        first = np.array([window.row, window.col])
        last = first + np.array([window.rows, window.cols]) - 1
        outside = np.maximum(np.maximum(first - place, place - last), 0.0)
        return np.asarray(outside * self._spacing_m, dtype=np.float64)


def in_four_views(viewpoints: Viewpoints) -> tuple[Viewpoints, NDArray[np.uint8]]:
    """Return every eye four times and the headings (4 N,) of its views, north to west."""
    count = len(viewpoints)
    heading = np.tile(np.array(HEADINGS, dtype=np.uint8), count)
    return viewpoints[np.repeat(np.arange(count), len(HEADINGS))], heading


def split_float(values: Float64Array) -> tuple[Float32Array, Float32Array]:
    """Return the nearest float32 and the remainder."""
    high = values.astype(np.float32)
    return high, (values - high).astype(np.float32)


def _needs_double(
    field: HeightField,
    viewpoints: Viewpoints,
    row: Float64Array,
    col: Float64Array,
    near_error: float,
) -> BoolArray:
    """Return which eyes see edges so near that float32 blurs v by more than ``near_error``, (N,).

    A crossing at depth z among heights up to H above or below the eye has v to within
    ``_ROUNDING`` H / z. An edge nearer than c / (G + 2 H / s) is below what follows it (c the
    eye's height over ground, G the steepest slope around, s the spacing), so that its error
    cannot show. The edges between these two depths are computed in float64.
    """
    steps = np.arange(-1, 3)
    rows = np.clip(np.floor(row).astype(np.int64)[:, None] + steps, 0, field.rows - 1)
    cols = np.clip(np.floor(col).astype(np.int64)[:, None] + steps, 0, field.cols - 1)
    heights = field.heights_m[rows[:, :, None], cols[:, None, :]].astype(np.float64)
    around = heights - viewpoints.eye_elevation_m[:, None, None]
    relief_m = np.fmax.reduce(np.abs(around), axis=(1, 2))
    slopes = [np.abs(np.diff(around, axis=axis)) for axis in (1, 2)]
    steepest_m = np.fmax(*(np.fmax.reduce(slope, axis=(1, 2)) for slope in slopes))
    spacing_m = field.spacing_m
    ground_m = field.height_at(easting_m=viewpoints.easting_m, northing_m=viewpoints.northing_m)
    clearance_m = viewpoints.eye_elevation_m - ground_m
    shows_from_m = clearance_m / (2.0 * (steepest_m + relief_m) / spacing_m + 1e-9)
    blurred_to_m = _ROUNDING * relief_m / near_error
    lines = np.stack([row, col, col - row])
    offset = np.abs(lines - np.rint(lines))
    # An eye exactly on a line does not cross it.
    nearest_m = np.where(offset > 0.0, offset, 1.0).min(axis=0) * spacing_m / np.sqrt(2.0)
    return np.asarray(np.fmax(nearest_m, shows_from_m) < blurred_to_m, dtype=bool)
