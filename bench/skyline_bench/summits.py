"""The summits of a DEM's file against the summits of its surface.

The surface, from which skylines are rendered, is the field that `read_dem` returns. If that was
warped, it is compared with plain bilinear interpolation at the same samples, which does not keep
summits.

On the surface as it is read, horizons are rendered too: from places beside the most prominent
summits, as far from them as true coordinates are, and from places anywhere.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import typer
from numpy.typing import ArrayLike
from pyproj import Transformer
from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

from skyline.arrays import Float32Array, Float64Array, Int64Array
from skyline.errors import InputError, some_of
from skyline.geodesy.earth import Curvature
from skyline.horizons.horizon import horizon, horizons_of
from skyline.render.horizon import PanoramaRenderer
from skyline.store.places import BINS
from skyline.terrain.dem import read_dem, read_files
from skyline.terrain.grid import Grid
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline.terrain.repair import repair
from skyline.terrain.resampling import ground_spacing_m
from skyline.terrain.viewpoints import stand_on
from skyline_bench import options
from skyline_bench.measuring import Row, central_viewpoints, in_turns, square_km, window_of
from skyline_bench.records import write_record

EXACT_M = 1.0
"""How far a summit may be off."""

STOOD = {"slope": 0.0, "summit_height": None, "within_100_m": 100.0}
"""Where an eye beside a summit stands: ``summit_within_m`` of `skyline.horizon`."""

LOW_DEG = 3.0
"""Upper bound of the elevation angles that a summit's horizon should have."""

_APART_M = 1000.0
"""A summit is the highest sample within this distance."""


@dataclass(frozen=True, slots=True)
class SummitsConfig:
    """How much is measured."""

    summits: int = 200  # The highest so many
    eyes: int = 8  # Eyes drawn about each summit
    places: int = 400  # Places rendered, for the cost
    beside: int = 5  # Places beside each prominent summit
    anywhere: int = 1000  # Places on the surface


QUICK = SummitsConfig(summits=40, eyes=2, places=40, beside=2, anywhere=100)


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    """The repaired samples of a DEM in the surface's frame."""

    heights_m: Float32Array
    grid: Grid
    spacing_m: tuple[float, float]
    to_frame: Transformer
    from_frame: Transformer

    @classmethod
    def read(cls, dem: Sequence[str | Path], options: DemOptions, field: HeightField) -> "_File":
        mosaic = read_files(dem, options)
        heights_m = mosaic.heights_m
        grid = mosaic.grid
        crs = mosaic.crs
        spacing_m = (
            (grid.step_east, grid.step_north)
            if field.provenance.resampling == "none"
            else ground_spacing_m(grid, crs, field.frame)
        )
        repair(heights_m, str(dem[0]), max(spacing_m))
        return cls(
            heights_m,
            grid,
            spacing_m,
            Transformer.from_crs(crs, field.frame.crs, always_xy=True),
            Transformer.from_crs(field.frame.crs, crs, always_xy=True),
        )

    def place(self, row: ArrayLike, col: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Return easting and northing of fractional rows and columns."""
        easting, northing = self.to_frame.transform(*self.grid.at(row, col))
        return np.asarray(easting), np.asarray(northing)

    def height_m(self, easting: Float64Array, northing: Float64Array) -> Float64Array:
        """Return heights between samples, bilinear; NaN off the map and beside holes."""
        at = self.grid.index(*self.from_frame.transform(easting, northing))
        return np.asarray(
            map_coordinates(self.heights_m, at, output=np.float64, order=1, cval=np.nan)
        )

    def summits(self, count: int) -> tuple[Int64Array, Int64Array]:
        """Return row and column of the highest summits that known samples surround."""
        known = ~np.isnan(self.heights_m)
        heights = np.where(known, self.heights_m, -np.inf)
        window = [2 * max(round(_APART_M / step), 2) + 1 for step in self.spacing_m[::-1]]
        inner = minimum_filter(known, 5, mode="constant", cval=False)
        row, col = np.nonzero((heights == maximum_filter(heights, window)) & inner)
        highest = np.argsort(-heights[row, col], kind="stable")[:count]
        if highest.size == 0:
            raise InputError("the DEM has no summit that known samples surround; give another")
        return row[highest], col[highest]


_Places = tuple[Float64Array, Float64Array, Float64Array]
"""Easting, northing and height (P,) of places."""


def summits(
    dem: options.Dems,
    record: options.Record = None,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Summits of a DEM's surface: heights, sights and horizons.

    The surface is compared with the file, and with a plain bilinear one.
    """
    terrain = read_dem(dem, DemOptions(crs=crs))
    rows = measure(dem, terrain, crs, QUICK if quick else SummitsConfig())
    columns = """surface spacing_m km2 summits=n lowest_m highest_m summits_off sights
        median_sight_m p90_sight_m bias_m rms_off_m place_cpu_ms"""
    options.print_rows(rows, columns)
    for name, value in rows[0].items():
        if name.startswith(("summit_below", "prominent", "anywhere", *STOOD)):
            typer.echo(f"{name:<24} {value:g}")
    write_record(record, rows, terrain=terrain)


def measure(
    dem: Sequence[str | Path],
    field: HeightField,
    crs: str | None = None,
    config: SummitsConfig = SummitsConfig(),
) -> list[Row]:
    """Return a row for each surface of a DEM's files.

    ``field`` is the surface as it is read.
    """
    file = _File.read(dem, DemOptions(crs=crs), field)
    row, col = file.summits(config.summits)
    surfaces = {"as read": field}
    if field.provenance.resampling != "none":
        surfaces["bilinear"] = _bilinear(file, field)
    rows: list[Row] = []
    for name, surface in surfaces.items():
        rows.append(
            {
                "dem": some_of([Path(one).name for one in dem], 1),
                "file_spacing_m": f"{file.spacing_m[0]:.3g} x {file.spacing_m[1]:.3g}",
                "surface": name,
                "spacing_m": surface.spacing_m,
                "km2": square_km(surface.bounds_m),
                **_summit_errors(surface, file, row, col, config),
                **_sample_errors(surface, file),
                "samples": surface.heights_m.size,
                "place_cpu_ms": _place_cpu_ms(surface, config.places),
            }
        )
    seen = {**_horizons_beside(field, file, config), **_horizons_anywhere(field, config)}
    return [{**rows[0], **seen}, *rows[1:]]


def _horizons_beside(field: HeightField, file: _File, config: SummitsConfig) -> Row:
    """Return how high horizons beside summits are, by where the eye stands.

    These are shares of azimuths: with a horizon below 3 degrees, with a horizon more than 1 degree
    off the horizon of the summit itself, and with a horizon nearer than a sample. The first is
    given from the summit itself, too.
    """
    row, col = _prominent(field)
    if not row.size:
        return {"prominent": 0}
    beside = np.random.default_rng(0).uniform(-0.5, 0.5, (2, config.beside, row.size))
    east_m, north_m = (beside.T * np.array(file.spacing_m)).T
    easting, northing = field.to_map(row, col)
    seen = horizons_of(field, stand_on(field, easting_m=easting, northing_m=northing)).elevation_deg
    found: dict[str, float] = {
        "prominent": row.size,
        "summit_below": float(np.mean(seen < LOW_DEG)),
    }
    lon, lat = field.frame.to_lonlat(easting + east_m, northing + north_m)
    for name, within_m in STOOD.items():
        stood = horizon(field, lon=lon.ravel(), lat=lat.ravel(), summit_within_m=within_m)
        off_deg = np.abs(stood.elevation_deg - np.tile(seen, (config.beside, 1)))
        found |= {
            f"{name}_below": float(np.mean(stood.elevation_deg < LOW_DEG)),
            f"{name}_off": float(np.mean(off_deg > 1.0)),
            f"{name}_near": float(np.mean(stood.distance_m < field.spacing_m)),
        }
    return found


def _prominent(field: HeightField) -> tuple[Int64Array, Int64Array]:
    """Return row and column of the ten most prominent summits.

    Known samples surround them.
    """
    # Of a large field, the highest samples of squares: their passes are a little too high.
    side = math.ceil(math.sqrt(field.heights_m.size / 2_000_000))
    rows = field.rows // side
    cols = field.cols // side
    squares = field.heights_m[: rows * side, : cols * side].reshape(rows, side, cols, side)
    row, col, _ = prominences(np.fmax.reduce(np.fmax.reduce(squares, axis=3), axis=1))
    for index, (top, left) in enumerate(zip(side * row, side * col, strict=True)):
        square = field.heights_m[top : top + side, left : left + side]
        at = np.unravel_index(np.nanargmax(square), square.shape)
        row[index] = top + at[0]
        col[index] = left + at[1]
    window = window_of(_APART_M, field.spacing_north_m, field.spacing_east_m)
    inner = minimum_filter(~np.isnan(field.heights_m), window, mode="constant", cval=False)
    kept = np.flatnonzero(inner[row, col])[:10]
    return row[kept], col[kept]


def _horizons_anywhere(field: HeightField, config: SummitsConfig) -> Row:
    """Return how many places are on summits, and how many others change."""
    rng = np.random.default_rng(0)
    west, south, east, north = field.bounds_m
    drawn = rng.uniform((west, south), (east, north), (4 * config.anywhere, 2))
    on_ground = np.isfinite(field.height_at(easting_m=drawn[:, 0], northing_m=drawn[:, 1]))
    easting, northing = drawn[on_ground][: config.anywhere].T
    before = stand_on(field, easting_m=easting, northing_m=northing)
    after = stand_on(field, easting_m=easting, northing_m=northing, summit_within_m=None)
    lifted = after.eye_elevation_m > before.eye_elevation_m
    was, now = (horizons_of(field, eyes[~lifted], 1.0) for eyes in (before, after))
    changed = (was.elevation_deg != now.elevation_deg) | (was.distance_m != now.distance_m)
    known = np.isfinite(was.elevation_deg) | np.isfinite(now.elevation_deg)
    return {
        "anywhere": easting.size,
        "anywhere_on_summits": int(lifted.sum()),
        "anywhere_else_changed": int((changed & known).any(axis=1).sum()),
    }


def _bilinear(file: _File, field: HeightField) -> HeightField:
    """Return the file resampled plainly to the samples of a field."""
    heights = np.empty_like(field.heights_m)
    col = np.arange(field.cols)
    for row in range(field.rows):
        heights[row] = file.height_m(*field.to_map(np.full(field.cols, row), col))
    return replace(field, heights_m=heights)


def _surface_around(surface: HeightField, easting: Float64Array, northing: Float64Array) -> _Places:
    """Return places and heights of the surface around a summit.

    The surface's samples are among them.
    """
    sides = surface.to_grid(
        easting_m=[easting.min(), easting.max()], northing_m=[northing.max(), northing.min()]
    )
    rows, cols = np.meshgrid(
        *(
            np.arange(max(np.ceil(first), 0.0), min(np.floor(last) + 1.0, count))
            for (first, last), count in zip(sides, (surface.rows, surface.cols), strict=True)
        ),
        indexing="ij",
    )
    nodes = surface.to_map(rows.reshape(-1), cols.reshape(-1))
    easting = np.append(easting, nodes[0])
    northing = np.append(northing, nodes[1])
    return easting, northing, surface.height_at(easting_m=easting, northing_m=northing)


def _summit_errors(
    surface: HeightField, file: _File, row: Int64Array, col: Int64Array, config: SummitsConfig
) -> Row:
    """Return how far summits are off, also as eyes see them."""
    summit, eyes = _sights(file, row, col, config)
    error_m = []
    seen_m = []
    # Of a fine lattice that reaches one sample from a summit.
    steps = np.linspace(-1.0, 1.0, 17)
    south, east = (side.ravel() for side in np.meshgrid(steps, steps, indexing="ij"))
    for index, (r, c) in enumerate(zip(row.tolist(), col.tolist(), strict=True)):
        lattice = file.place(r + south, c + east)
        mine = eyes[:, summit == index]
        around = _surface_around(surface, *lattice)
        error_m.append(np.nanmax(around[2]) - file.heights_m[r, c])
        true = *lattice, file.height_m(*lattice)
        east_m, north_m = np.array(file.place([r], [c])) - mine[:2]
        off = _greatest_tan(around, mine) - _greatest_tan(true, mine)
        seen_m += np.abs(off * np.hypot(east_m, north_m)).tolist()
    off_m = np.array(seen_m or [math.nan])
    return {
        "summits": row.size,
        "lowest_m": float(min(error_m)),
        "mean_m": float(np.mean(error_m)),
        "highest_m": float(max(error_m)),
        "summits_off": int(np.count_nonzero(np.abs(error_m) > EXACT_M)),
        "sights": len(seen_m),
        "median_sight_m": float(np.median(off_m)),
        "p90_sight_m": float(np.quantile(off_m, 0.9)),
        "sights_within": float(np.mean(off_m <= EXACT_M)),
    }


def _greatest_tan(places: _Places, eyes: Float64Array) -> Float64Array:
    """Return the greatest tangent (S,) of places, seen from eyes (3, S)."""
    easting, northing, height_m = places
    east, north, up = eyes[:, :, np.newaxis]
    away = np.hypot(easting - east, northing - north)
    tan = (height_m - up) / away - Curvature().drop_per_m2 * away
    return np.asarray(np.nanmax(tan, axis=1), dtype=np.float64)


def _sample_errors(surface: HeightField, file: _File) -> Row:
    """Return how far the surface is from some of the samples.

    A tenth of the file's samples is compared.
    """
    row, col = np.meshgrid(
        np.arange(0, file.grid.rows, 10), np.arange(file.grid.cols), indexing="ij"
    )
    east, north = file.place(row, col)
    off = surface.height_at(easting_m=east, northing_m=north) - file.heights_m[row, col]
    return {
        "bias_m": float(np.nanmean(off)),
        "median_off_m": float(np.nanmedian(np.abs(off))),
        "rms_off_m": float(np.sqrt(np.nanmean(off**2))),
    }


def _sights(
    file: _File, row: Int64Array, col: Int64Array, config: SummitsConfig
) -> tuple[Int64Array, Float64Array]:
    """Draw eyes about each summit that see it from below.

    The results are the summits (S,) and the eyes (3, S) that see them: easting, northing,
    elevation.
    """
    rng = np.random.default_rng(0)
    shape = row.size * config.eyes
    away_m = rng.uniform(2000.0, 20_000.0, shape)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, shape)
    summit = np.repeat(np.arange(row.size), config.eyes)
    east = away_m * np.sin(azimuth)
    north = away_m * np.cos(azimuth)
    easting, northing = np.array(file.place(row, col))[:, summit] + [east, north]
    elevation = file.height_m(easting, northing) + 2.0
    drop = Curvature().drop_per_m2
    share = (np.arange(200) + 0.5) / 200
    # The last stretch is the summit's own cap.
    share = share[:, np.newaxis] * (1.0 - 2.0 * max(file.spacing_m) / away_m)
    between_m = file.height_m(easting - share * east, northing - share * north)
    tan = (between_m - elevation) / (share * away_m) - drop * share * away_m
    to_summit = (file.heights_m[row, col][summit] - elevation) / away_m - drop * away_m
    with np.errstate(invalid="ignore"):
        seen = (tan.max(axis=0) < to_summit) & (to_summit > 0.0)
    return summit[seen], np.stack([easting, northing, elevation])[:, seen]


def _place_cpu_ms(surface: HeightField, count: int) -> float:
    """Return the processor milliseconds of rendering a place."""
    eyes = central_viewpoints(surface, count, 80.0)
    with PanoramaRenderer(surface, BINS) as renderer:
        (timing,) = in_turns([lambda: renderer.render(eyes)], 3)
    return 1e3 * timing.cpu_seconds / len(eyes)


def prominences(heights_m: ArrayLike) -> tuple[Int64Array, Int64Array, Float64Array]:
    """Return the summits of heights, the most prominent first.

    They are given as rows, columns and prominences (S,). Samples (rows, cols) rise out of a falling
    flood, the highest first. A sample that touches no land is a summit. One that joins two lands is
    the pass between them: the lower of their summits has the height above it for its prominence.
    The prominence of a land that never joins a higher one is its height above the lowest sample.
    Holes (NaN) stay under water.
    """
    padded = np.pad(np.asarray(heights_m, np.float64), 1, constant_values=np.nan)
    height_m = padded.ravel().tolist()
    width = padded.shape[1]
    falling = np.argsort(padded, axis=None, kind="stable")[: np.isfinite(padded).sum()][::-1]
    around = [down * width + right for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right]
    top = [-1] * padded.size
    rank = dict[int, int]()
    found = dict[int, float]()

    def summit_of(place: int) -> int:
        while top[place] != place:
            top[place] = place = top[top[place]]
        return place

    for place in falling.tolist():
        summits = {summit_of(place + step) for step in around if top[place + step] >= 0}
        if not summits:
            rank[place] = len(rank)
        highest = min(summits, key=rank.__getitem__, default=place)
        top[place] = highest
        for lower in summits - {highest}:
            top[lower] = highest
            found[lower] = height_m[lower] - height_m[place]
    last = height_m[falling[-1]]
    place = np.sort(list(rank))
    prominence_m = np.array([found.get(one, height_m[one] - last) for one in place.tolist()])
    first = np.argsort(-prominence_m, kind="stable")
    # Of equally high samples side by side, all but one have none.
    first = first[prominence_m[first] > 0.0]
    row, col = np.divmod(place[first], width)
    return row - 1, col - 1, prominence_m[first]
