"""Summits of a DEM in degrees: as high on the surface as in the file, and nothing else raised."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from dem_files import AnyArray, write
from rasterio.transform import from_origin
from scipy.ndimage import gaussian_filter, map_coordinates

from skyline.terrain import cleaning
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.warp import local_maxima

STEP_DEG = 1.0 / 1200.0


def peaks(seed: int, shape: tuple[int, int] = (150, 180)) -> AnyArray:
    """Cones of 30 degrees at random places of a rough plateau, sharp to the sample."""
    rng = np.random.default_rng(seed)
    rough = gaussian_filter(rng.normal(size=shape), 2.0)
    heights = 800.0 + 40.0 * rough / rough.std()
    row, col = np.mgrid[: shape[0], : shape[1]]
    for top_row, top_col, height in zip(
        rng.integers(8, shape[0] - 8, 60),
        rng.integers(8, shape[1] - 8, 60),
        rng.uniform(900.0, 1500.0, 60),
        strict=True,
    ):
        away_m = np.hypot(92.7 * (row - top_row), 63.0 * (col - top_col))
        heights = np.maximum(heights, height - np.tan(np.radians(30.0)) * away_m)
    rounded: AnyArray = np.rint(heights).astype(np.float32)
    return rounded


@dataclass(frozen=True)
class Country:
    """A file of degrees and the surface made of it."""

    heights: AnyArray
    field: HeightField

    @classmethod
    def written(cls, folder: Path, heights: AnyArray, north: float) -> "Country":
        transform = from_origin(9.0, north, STEP_DEG, STEP_DEG)
        return cls(heights, read_dem(write(folder / "dem.tif", heights, transform, "EPSG:4326")))

    def place(self, row: AnyArray, col: AnyArray, north: float) -> tuple[AnyArray, AnyArray]:
        return self.field.frame.from_lonlat(
            9.0 + (col + 0.5) * STEP_DEG, north - (row + 0.5) * STEP_DEG
        )

    def bilinear(self, north: float) -> AnyArray:
        """Return the file's heights between its samples, at the surface's samples."""
        row, col = np.indices(self.field.heights_m.shape)
        lon, lat = self.field.frame.to_lonlat(*self.field.to_map(row, col))
        at = [(north - lat) / STEP_DEG - 0.5, (lon - 9.0) / STEP_DEG - 0.5]
        heights: AnyArray = map_coordinates(
            self.heights.astype(np.float64), at, order=1, cval=np.nan
        )
        return heights


@pytest.mark.parametrize("north", [0.05, 47.0, 69.0, -45.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_every_local_maximum_is_as_high_within_a_cell(
    tmp_path: Path, north: float, seed: int
) -> None:
    country = Country.written(tmp_path, peaks(seed), north)
    field, (row, col) = country.field, local_maxima(country.heights)
    assert row.size > 100
    at_row, at_col = field.to_grid(*country.place(row, col, north))
    top, left = np.floor(at_row).astype(int), np.floor(at_col).astype(int)
    corners = np.stack([field.heights_m[top + i, left + j] for i in (0, 1) for j in (0, 1)])
    off = corners.max(axis=0) - country.heights[row, col]
    assert off.min() >= 0.0
    # Higher only where the cell reaches towards another, higher maximum.
    assert np.quantile(off, 0.9) == 0.0
    cones = country.heights[row, col] > 950.0
    assert np.abs(off[cones]).max() <= 1.0


@pytest.mark.parametrize("north", [47.0, 69.0])
def test_the_rest_is_neither_raised_nor_filled(tmp_path: Path, north: float) -> None:
    country = Country.written(tmp_path, peaks(2), north)
    bilinear, surface = country.bilinear(north), country.field.heights_m
    both = np.isfinite(bilinear) & np.isfinite(surface)
    off = (surface - bilinear)[both]
    # A cubic follows what is rough, by 40 m rms here, and bilinear interpolation cuts it.
    assert abs(off.mean()) < 0.5
    assert abs(np.median(off)) < 0.5
    assert np.mean(off > 10.0) < 0.01
    lowest, highest = country.heights.min(), country.heights.max()
    assert surface[both].min() >= lowest
    assert surface[both].max() == highest
    # The lowest twentieth stays as low as the file has it, or lower: a cubic cuts no hollow.
    valley = bilinear[both] < np.quantile(bilinear[both], 0.05)
    assert np.median(off[valley]) < 0.0


def test_samples_of_the_surface_lie_between_those_of_the_file_around(tmp_path: Path) -> None:
    # Two samples as high as each other: a cubic alone overshoots between them by 5 m.
    heights = np.full((20, 20), 1000.0, dtype=np.float32)
    heights[9:11, 9:11] = 1040.0
    country = Country.written(tmp_path, heights, 47.0)
    assert np.nanmax(country.field.heights_m) == 1040.0
    assert np.nanmin(country.field.heights_m) == 1000.0


def test_maxima_are_those_of_a_plain_search(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    heights = rng.integers(0, 12, (60, 50)).astype(np.float32)
    heights[rng.uniform(size=heights.shape) < 0.02] = np.nan
    heights[20:26, 30:36] = 5.0
    expected = []
    for row in range(1, 59):
        for col in range(1, 49):
            around = heights[row - 1 : row + 2, col - 1 : col + 2]
            own = heights[row, col]
            if np.isfinite(around).all() and own == around.max() and own > around.min():
                expected.append((row, col))
    assert list(zip(*local_maxima(heights), strict=True)) == expected
    monkeypatch.setattr(cleaning, "_STRIP_SAMPLES", 100)
    assert list(zip(*local_maxima(heights), strict=True)) == expected
