"""Hard cases, and the terrain that they stand on.

Positions are whole multiples of powers of two, so that an eye that is to be on a sample, an edge or
a diagonal is there exactly.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array
from skyline.camera import pixel_size
from skyline.geodesy import Curvature, Frame
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline_bench.truth.agreement import (
    Agreement,
    RenderPath,
    SkylineScene,
    SkylineTruth,
    oracle_truth,
)

FLAT = Curvature(enabled=False)
FRAME = Frame.local(lon=9.8, lat=46.8)
WEST_M, NORTH_M = 2.0**19, 2.0**22
SPACING_M = 32.0

HORIZON_ONLY = ("horizon",)
"""For cases in which a depth image shows too little to promise anything."""

_QUICK_VIEWPOINTS = 2


@dataclass(frozen=True, slots=True)
class ClosedForm:
    """Skylines known without looking at any edge."""

    elevation_tan: Float64Array  # (N, W)
    # How far the surface between samples may be from the form that gave the skylines.
    slack_tan: float = 0.0


@dataclass(frozen=True, slots=True)
class SceneCase:
    """A scene whose skylines are compared with the truth."""

    name: str
    breaks: str  # What a renderer could get wrong, one phrase
    scene: Callable[[], SkylineScene]  # Makes the scene
    # Gives the skylines of a scene; without it the oracle does.
    closed_form: Callable[[SkylineScene], ClosedForm] | None = None
    paths: tuple[str, ...] = ("horizon", "depth")  # Names of the paths that promise something here

    def agreement(self, path: RenderPath, quick: bool) -> Agreement:
        """Render the scene along a path and compare it with the truth."""
        scene, truth = _posed(self, quick)
        return path.agreement(scene, path.render(scene), truth)

    def truth(self, scene: SkylineScene) -> SkylineTruth:
        """Return the truth: flags and depth are the oracle's in any case."""
        truth = oracle_truth(scene)
        if self.closed_form is None:
            return truth
        form = self.closed_form(scene)
        missing = np.isnan(truth.views.elevation_tan)
        tan = np.where(missing, np.nan, form.elevation_tan)
        return SkylineTruth(
            replace(truth.views, elevation_tan=tan), form.slack_tan / pixel_size(scene.width)
        )


@lru_cache(maxsize=1)
def _posed(case: SceneCase, quick: bool) -> tuple[SkylineScene, SkylineTruth]:
    """Return a case's scene and truth; kept, since several paths look at one case in turn."""
    scene = case.scene()
    if quick:
        scene = scene.first(_QUICK_VIEWPOINTS)
    return scene, case.truth(scene)


def rough_heights(rows: int, cols: int, relief_m: float = 800.0, seed: int = 0) -> Float64Array:
    """Return rough heights with a power-law spectrum, slopes of 45 degrees and more at 32 m."""
    return 1500.0 + relief_m * fractal(rows, cols, seed, 1.8)


def fractal(rows: int, cols: int, seed: int, exponent: float) -> Float64Array:
    """Return noise (rows, cols) from -1 to 1 with a power-law spectrum."""
    generator = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(rows)[:, np.newaxis], np.fft.rfftfreq(cols))
    frequency[0, 0] = np.inf
    spectrum = generator.normal(size=frequency.shape) + 1j * generator.normal(size=frequency.shape)
    noise = np.fft.irfft2(spectrum * frequency**-exponent, s=(rows, cols))
    return np.asarray(noise / np.abs(noise).max(), dtype=np.float64)


def field_of(
    heights_m: ArrayLike,
    spacing_m: float = SPACING_M,
    spacing_north_m: float | None = None,
    west_m: float = WEST_M,
    north_m: float = NORTH_M,
) -> HeightField:
    """Make a field of 32-bit heights, row 0 north."""
    heights = np.array(heights_m, dtype=np.float32)
    return HeightField(heights, west_m, north_m, spacing_m, spacing_north_m or spacing_m, FRAME)


def eyes_at(
    field: HeightField, row: ArrayLike, col: ArrayLike, eye_height_m: ArrayLike
) -> Viewpoints:
    """Stand at fractional rows and columns of a field."""
    east_m, north_m = field.to_map(row, col)
    return stand_on(field, easting_m=east_m, northing_m=north_m, eye_height_m=eye_height_m)


def spots(field: HeightField, count: int) -> tuple[Float64Array, Float64Array]:
    """Return rows and columns of samples away from the border."""
    generator = np.random.default_rng(7)
    row = generator.integers(field.rows // 8, field.rows - field.rows // 8 - 1, count)
    col = generator.integers(field.cols // 8, field.cols - field.cols // 8 - 1, count)
    return row.astype(np.float64), col.astype(np.float64)


def rough_field(seed: int = 1) -> HeightField:
    """Return 96 x 96 rough samples at 32 m."""
    return field_of(rough_heights(96, 96, seed=seed))


def eyes_anywhere(field: HeightField, count: int, eye_height_m: ArrayLike) -> Viewpoints:
    """Stand at random places away from the border."""
    row, col = spots(field, count)
    row_share, col_share = np.random.default_rng(3).uniform(0.0, 1.0, (2, count))
    return eyes_at(field, row + row_share, col + col_share, eye_height_m)
