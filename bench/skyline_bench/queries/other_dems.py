"""Elevation models that differ from a given one as two surveys of one place do."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from skyline.errors import InputError
from skyline.terrain.heightfield import HeightField, Provenance


def perturbed(
    terrain: HeightField, height_rms_m: float = 10.0, correlation_m: float = 300.0, seed: int = 0
) -> HeightField:
    """Add smooth random errors to the heights, of a root mean square over the whole field.

    ``correlation_m`` is where their correlation, exp(-(d / L)^2), has dropped to 1/e.
    """
    if not (0.0 <= height_rms_m < np.inf and 0.0 < correlation_m < np.inf and seed >= 0):
        raise InputError(
            f"height error {height_rms_m} m over {correlation_m} m, seed {seed}; expected at least "
            "0 m over more than 0 m, and a seed of 0 or more"
        )
    noise = np.random.default_rng(seed).standard_normal(terrain.heights_m.shape)
    # White noise under a Gaussian of deviation s has the correlation exp(-d^2 / (4 s^2)).
    deviation_m = correlation_m / 2.0
    smooth = ndimage.gaussian_filter(
        noise,
        (deviation_m / terrain.spacing_north_m, deviation_m / terrain.spacing_east_m),
        mode="wrap",
    )
    error_m = smooth * (height_rms_m / np.sqrt(np.mean(smooth**2)))
    heights = (terrain.heights_m + error_m).astype(terrain.heights_m.dtype)
    made = f"errors of {height_rms_m:g} m rms over {correlation_m:g} m added, seed {seed}"
    return replace(terrain, heights_m=heights, provenance=Provenance(resampling=made))


def resampled(
    terrain: HeightField, spacing_m: float, phase: tuple[float, float] = (0.5, 0.5)
) -> HeightField:
    """Sample the surface on another grid of the same frame, of one spacing east and north.

    ``phase`` shifts the new grid's north-western sample east and south of the old one's, in new
    spacings, 0 to below 1.
    """
    if not (0.0 < spacing_m < np.inf and all(0.0 <= shift < 1.0 for shift in phase)):
        raise InputError(
            f"spacing {spacing_m} m at phase {phase}; expected a positive number of metres and "
            "two phases of 0 to below 1"
        )
    west, south, east, north = terrain.bounds_m
    new_west, new_north = west + phase[0] * spacing_m, north - phase[1] * spacing_m
    cols = int((east - new_west) // spacing_m) + 1
    rows = int((new_north - south) // spacing_m) + 1
    if min(cols, rows) < 2:
        raise InputError(
            f"a spacing of {spacing_m} m leaves {cols} x {rows} samples of the DEM; expected at "
            "least 2 x 2: choose a smaller spacing"
        )
    easting = new_west + spacing_m * np.arange(cols)
    northing = new_north - spacing_m * np.arange(rows)
    heights = terrain.height_at(
        easting_m=easting[np.newaxis, :], northing_m=northing[:, np.newaxis]
    )
    return HeightField(
        heights.astype(terrain.heights_m.dtype),
        new_west,
        new_north,
        spacing_m,
        spacing_m,
        terrain.frame,
        Provenance(resampling=f"sampled again at {spacing_m:g} m, phase {phase}"),
    )
