"""Surface models: how high trees and houses may rise above a DEM."""

import logging
import math
from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import Float64Array, FloatArray
from skyline.errors import InputError
from skyline.terrain.datums import ELLIPSOID, GEOID
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.grid import row_strips
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline.terrain.repair import TALLEST_CANOPY_M

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SurfaceRules:
    """Limits of a surface model's heights above a DEM."""

    unknown_m: float = 40.0
    """Height above ground that is assumed where a surface model has no height: tall trees."""
    most_canopy_m: float = TALLEST_CANOPY_M
    """Greatest height in a canopy model; a surface model of high ground has greater ones."""
    least_follow_share: float = 0.5
    """A model that rises by less than this share of the ground's rise is a canopy model."""
    flat_sd_m: float = 20.0
    """Standard deviation of ground that is too flat to decide by: it varies less than trees do."""
    lowest_median_m: float = -10.0
    """Lowest plausible median of a surface above the ground: errors of both models. A surface that
    is as far above open ground has another datum."""
    highest_median_m: float = 60.0
    """Highest plausible median of a surface above the ground: a forest of the tallest trees."""
    open_share: float = 0.1
    """Share of an area that is assumed to be open ground, where a surface is as high as the
    ground."""
    much_unknown_share: float = 0.2
    """Share of a DEM over which a surface model may have no height without a warning."""


def read_surface(
    surface: Dem, terrain: HeightField, rules: SurfaceRules = SurfaceRules()
) -> HeightField:
    """Read an upper bound of the trees and houses on a terrain.

    ``surface`` is a surface model, whose heights have the terrain's datum, or a canopy model, whose
    heights are above the ground. A model that lies far below the ground, or does not rise and fall
    with it, is taken for a canopy model. Its grid and CRS may differ from the terrain's; files that
    name no CRS have the one that was given for the terrain.

    The returned field has the terrain's samples, raised: each is the ground plus the model's
    greatest height above it within a sample's distance, or plus ``rules.unknown_m`` where the model
    has no height.

    Raises `InputError` if the model does not cover the terrain or its heights have another datum,
    and as `read_dem`.
    """
    if isinstance(surface, HeightField):
        model = surface
    else:
        model = read_dem(surface, DemOptions.from_json(terrain.provenance.options))
    above_m = _highest_within(_above_ground_m(model, terrain, rules), model, terrain)
    above_ground = replace(model, heights_m=above_m)
    heights_m = np.empty_like(terrain.heights_m)
    unknown = 0
    for rows in row_strips(heights_m):
        easting, northing = _positions(terrain, rows, model)
        over_m = above_ground.height_at(easting_m=easting, northing_m=northing)
        is_unknown = np.isnan(over_m)
        unknown += int(np.count_nonzero(is_unknown))
        over_m = np.where(is_unknown, rules.unknown_m, np.maximum(over_m, 0.0))
        heights_m[rows] = terrain.heights_m[rows] + over_m
    if unknown > rules.much_unknown_share * heights_m.size:
        _log.warning(
            "%s has no height over %.0f %% of the DEM, where trees of %.0f m are assumed; if "
            "nothing stands there, set its voids to the height of the ground, in a canopy model "
            "to 0",
            _name_of(model),
            100.0 * unknown / heights_m.size,
            rules.unknown_m,
        )
    heights_m.setflags(write=False)
    return replace(terrain, heights_m=heights_m, provenance=model.provenance)


def _highest_within(
    above_m: Float64Array, model: HeightField, terrain: HeightField
) -> Float64Array:
    """Return the greatest height above ground within a sample of the terrain."""
    wide = [
        max(1, 2 * math.ceil(coarse / fine - 1e-6) - 1)
        for coarse, fine in (
            (terrain.spacing_north_m, model.spacing_north_m),
            (terrain.spacing_east_m, model.spacing_east_m),
        )
    ]
    if max(wide) == 1:
        return above_m
    from scipy.ndimage import maximum_filter  # noqa: PLC0415  (slow to load, seldom needed)

    highest_m = maximum_filter(np.nan_to_num(above_m, nan=-np.inf), wide)
    return np.where(np.isinf(highest_m), np.nan, highest_m)


def _above_ground_m(model: HeightField, terrain: HeightField, rules: SurfaceRules) -> Float64Array:
    """Return a model's heights above ground, NaN where unknown."""
    above_m = _above_terrain_m(model, terrain)
    known = np.isfinite(above_m)
    if not known.any():
        raise InputError(
            f"{_name_of(model)} has no height over the DEM; give a surface model of the same area"
        )
    median_m = float(np.median(above_m[known]))
    is_far_below = median_m < rules.lowest_median_m
    if model.height_range_m[1] <= rules.most_canopy_m and (
        is_far_below
        or _follow_share(model.heights_m[known], above_m[known], rules) < rules.least_follow_share
    ):
        return np.where(known, model.heights_m, np.nan)
    _check_datum(model, terrain, median_m, rules)
    lowest_m = float(np.quantile(above_m[known], rules.open_share))
    if lowest_m > rules.unknown_m:
        raise InputError(
            f"{_name_of(model)} lies at least {lowest_m:.0f} m above the DEM in "
            f"{100.0 * (1.0 - rules.open_share):.0f} % of the area, and no forest is so tall; give "
            "a surface model of the DEM's vertical datum, or a canopy model in metres above ground"
        )
    if lowest_m > -rules.lowest_median_m:
        _log.warning(
            "%s lies at least %.0f m above the DEM in %.0f %% of the area; unless that is forest, "
            "its heights have another vertical datum",
            _name_of(model),
            lowest_m,
            100.0 * (1.0 - rules.open_share),
        )
    return above_m


def _above_terrain_m(model: HeightField, terrain: HeightField) -> Float64Array:
    """Return a model's heights above the terrain; NaN where unknown."""
    above_m = np.empty(model.heights_m.shape)
    west, south, east, north = terrain.bounds_m
    reach_m = max(model.spacing_east_m, model.spacing_north_m)
    for rows in row_strips(model.heights_m):
        easting, northing = _positions(model, rows, terrain)
        # Samples just outside are needed for the heights between them and the border.
        for at, least, most in ((easting, west, east), (northing, south, north)):
            beside = np.clip(at, least, most)
            np.copyto(at, beside, where=np.abs(at - beside) <= reach_m)
        above_m[rows] = model.heights_m[rows] - terrain.height_at(
            easting_m=easting, northing_m=northing
        )
    return above_m


def _check_datum(
    model: HeightField, terrain: HeightField, median_m: float, rules: SurfaceRules
) -> None:
    """Raise `InputError` where a surface model has another datum.

    ``median_m`` is the median of the surface above the terrain.
    """
    reference = _reference_of(model)
    terrain_reference = _reference_of(terrain)
    if {GEOID, ELLIPSOID} == {reference, terrain_reference}:
        raise InputError(
            f"{_name_of(model)} has heights above the {reference}, and the DEM above the "
            f"{terrain_reference}, tens of metres apart; convert one of them (gdalwarp)"
        )
    if not rules.lowest_median_m <= median_m <= rules.highest_median_m:
        raise InputError(
            f"{_name_of(model)} is {median_m:+.0f} m above the DEM in the median; expected "
            f"{rules.lowest_median_m:+g} to {rules.highest_median_m:+g}: give a surface model of "
            "the DEM's vertical datum, or a canopy model in metres above ground"
        )


def _name_of(model: HeightField) -> str:
    return ", ".join(model.provenance.files) or "the surface"


def _reference_of(model: HeightField) -> str:
    """Return `GEOID`, `ELLIPSOID`, or "" if a model names no datum."""
    datum = model.provenance.conventions.get("vertical_datum", "")
    return next((one for one in (GEOID, ELLIPSOID) if datum.endswith(f"({one})")), "")


def _follow_share(heights_m: FloatArray, above_m: Float64Array, rules: SurfaceRules) -> float:
    """Return the mean rise of heights (N,) per metre of ground rise.

    It is 1 for a surface model and 0 for a canopy model; 1 where the ground is flat.
    """
    ground_m = heights_m - above_m
    rise_m = ground_m - ground_m.mean()
    squared = float(rise_m @ rise_m)
    if squared <= rules.flat_sd_m**2 * len(rise_m):
        return 1.0
    return float(rise_m @ heights_m) / squared


def _positions(field: HeightField, rows: slice, other: HeightField) -> tuple[Float64Array, ...]:
    """Return easting and northing of some rows' samples in another field's frame."""
    row = np.arange(field.rows)[rows, np.newaxis]
    position = field.to_map(*np.broadcast_arrays(row, np.arange(field.cols)))
    if field.frame == other.frame:
        return position
    return other.frame.from_lonlat(*field.frame.to_lonlat(*position))
