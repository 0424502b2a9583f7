"""Kinds of synthetic queries.

They differ in the camera's view, its errors and its elevation model. A query is one photo, or
several photos of one place that are matched together.
"""

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import ndimage

from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.geodesy.map_frame import Rectangle
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import Provenance
from skyline_bench.measuring import middle_of
from skyline_bench.queries.pinhole import CYLINDER, FISHEYES
from skyline_bench.queries.synthetic import (
    QueryConfig,
    SyntheticQuery,
    make_queries,
    make_queries_together,
)

Query = tuple[SyntheticQuery, ...]
"""The photos of one place."""

HEIGHT_SD_M = 10.0
"""Root mean square of the errors of another model of the terrain."""
PHOTOS = 3
"""Photos of one place, where there are several."""
_CORRELATION_M = 300.0
"""Distance at which the correlation of errors of a model, exp(-(d / L)^2), has dropped to 1/e."""


OTHER_DEM = "other-dem"
"""Queries that see another model of the terrain."""
STRANGERS = "strangers"
"""Queries of terrain outside the store."""

UNMARKED = ("unmarked panoramas", "unmarked fisheyes")
"""Queries that do not come from a pin-hole camera, although nothing says so: none should be
trusted."""

KINDS: Mapping[str, QueryConfig] = {
    "plain": QueryConfig(),
    "white": QueryConfig(smooth_share=0.0),  # Noise drawn anew in each column
    OTHER_DEM: QueryConfig(),
    "occluded": QueryConfig(occluded_share=(0.3, 0.3)),
    "bent": QueryConfig(distortion_sd=0.03),  # By lenses that are not corrected
    UNMARKED[0]: QueryConfig(fov_deg=(80.0, 180.0), mappings=(CYLINDER,)),
    UNMARKED[1]: QueryConfig(fov_deg=(80.0, 150.0), mappings=FISHEYES),
    # The photos of the kind before, matched with their projection and field of view.
    "fisheyes": QueryConfig(
        fov_deg=(80.0, 150.0), mappings=FISHEYES, projection=Projection.FISHEYE
    ),
    "aligned": QueryConfig(
        fov_deg=(90.0, 90.0), fov_error=0.0, max_tilt_deg=0.0, is_aligned=True,
        noise_deg=(0.03, 0.03), masked_share=0.0,
    ),
    "alone": QueryConfig(),  # Photos of each place, one by one
    "together": QueryConfig(),  # The same photos matched together
    "with a stranger": QueryConfig(),  # Together, the last photo of another place
    STRANGERS: QueryConfig(),
}  # fmt: skip
"""Kinds of queries, and how they are drawn. Query k of the kinds of `OF_ONE_AREA` has one place,
and one pose unless it is aligned; the kinds of `SAME_PLACE` have the same places and photos."""

OF_ONE_AREA = ("plain", "white", OTHER_DEM, "occluded", "bent", "aligned")
SAME_PLACE = ("alone", "together", "with a stranger")
SEARCHED_WHOLE = ("together", "with a stranger", STRANGERS)
"""Kinds whose queries have no single place about which a search could be narrowed."""


def make_kind(
    name: str,
    terrain: HeightField,
    area_m: Rectangle,
    count: int,
    seed: int,
    strange: HeightField | None = None,
) -> list[Query]:
    """Make queries of a kind at random places of an area.

    Strangers are made of strange terrain.
    """
    config = KINDS[name]
    if name in SAME_PLACE:
        # One place more, for the stranger of the last.
        places = make_queries_together(terrain, area_m, count + 1, PHOTOS, seed, config)
        if name == "alone":
            return [(photo,) for photos in places[:-1] for photo in photos]
        if name == "together":
            return list(places[:-1])
        return [(*photos[:-1], others[-1]) for photos, others in itertools.pairwise(places)]
    seen = terrain
    if name == STRANGERS:
        if strange is None:
            raise InputError("strangers need a DEM of terrain off the store; give --strange")
        seen = strange
        area_m = middle_of(strange.bounds_m, (8_000.0, 8_000.0))
    elif name == OTHER_DEM:
        other = resampled(terrain, 1.3 * terrain.spacing_m, (0.37, 0.61))
        seen = perturbed(other, seed=seed)
    return [(query,) for query in make_queries(seen, area_m, count, seed, config)]


def distance_m(query: Query) -> float:
    """Return the mean distance of the photos' skylines; 0 without any.

    Whatever fills an image without a skyline stands right in front of it.
    """
    return float(np.mean(np.nan_to_num([photo.distance_m for photo in query])))


def perturbed(
    terrain: HeightField, height_rms_m: float = HEIGHT_SD_M, seed: int = 0
) -> HeightField:
    """Add smooth random errors to the heights.

    The errors have the given root mean square over the whole field.
    """
    noise = np.random.default_rng(seed).standard_normal(terrain.heights_m.shape)
    # White noise under a Gaussian of deviation s has the correlation exp(-d^2 / (4 s^2)).
    deviation_m = _CORRELATION_M / 2.0
    deviation = deviation_m / terrain.spacing_north_m, deviation_m / terrain.spacing_east_m
    smooth = ndimage.gaussian_filter(noise, deviation, mode="wrap")
    error_m = smooth * (height_rms_m / np.sqrt(np.mean(smooth**2)))
    heights = (terrain.heights_m + error_m).astype(terrain.heights_m.dtype)
    made = f"errors of {height_rms_m:g} m rms over {_CORRELATION_M:g} m added, seed {seed}"
    return replace(terrain, heights_m=heights, provenance=Provenance(resampling=made))


def resampled(
    terrain: HeightField, spacing_m: float, phase: tuple[float, float] = (0.5, 0.5)
) -> HeightField:
    """Sample the surface on another grid of the same frame.

    The new grid has one spacing east and north. ``phase`` shifts the new grid's north-western
    sample east and south of the old one's, in new spacings, 0 to below 1.
    """
    west, south, east, north = terrain.bounds_m
    new_west = west + phase[0] * spacing_m
    new_north = north - phase[1] * spacing_m
    cols = int((east - new_west) // spacing_m) + 1
    rows = int((new_north - south) // spacing_m) + 1
    easting = new_west + spacing_m * np.arange(cols)
    northing = new_north - spacing_m * np.arange(rows)[:, np.newaxis]
    heights = terrain.height_at(easting_m=easting, northing_m=northing)
    heights = heights.astype(terrain.heights_m.dtype)
    made = Provenance(resampling=f"sampled again at {spacing_m:g} m, phase {phase}")
    grid = new_west, new_north, spacing_m, spacing_m
    return HeightField(heights, *grid, terrain.frame, made)
