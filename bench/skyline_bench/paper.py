"""The paper's tables: its simulation, and predictors compared with renderings.

The simulation (section 5.1, Table 1) compares the strategies by (A), the viewpoints rendered,
corners included, and (B), the overlap: all inclusions in tolerance areas minus the locations
covered. The least number of viewpoints of a strategy, ``bound``, is the number of locations to
cover divided by the mean area of its views.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
from scipy.stats import spearmanr
from typer import Option

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.errors import InputError
from skyline.paper import tolerance_areas
from skyline.paper.plan_check import true_errors_px
from skyline.paper.planners import PLANNERS, Coverage, Planner, Problem, Sites
from skyline.plugins import load
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.skylines import DEFAULT_WIDTH, columns_u
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline_bench import options
from skyline_bench.measuring import Row, square_km, timed

PAPER_SIDE = 100
"""Rows and columns of the paper's square of sites."""


def table1(
    seeds: Annotated[int, Option(min=1, help="How many seeds, from 0 on.")] = 10,
    side: Annotated[int, Option(min=10, help="Rows, and columns, of sites.")] = PAPER_SIDE,
    row: Annotated[
        list[int] | None, Option(min=1, max=3, help="Rows of the table, by default all.")
    ] = None,
    record: options.Record = None,
    quick: Annotated[bool, options.quick_with(seeds=1)] = False,
) -> None:
    """The paper's Table 1: viewpoints (A) and overlap (B) of each strategy.

    A, B, the area and the seconds are means over n seeds. The paper's A and B belong to its square
    of 100 sites a side, and are left out for a square of another size.
    """
    rows = measure_table1(seeds, side, row or [1, 2, 3])
    columns = "row strategy n paper_A A A_std paper_B B mean_area bound seconds"
    options.report(record, rows, columns)


def measure_table1(seeds: int, side: int, numbers: Sequence[int]) -> list[dict[str, Any]]:
    """Run the strategies on rows of the table.

    Each is run with the seeds 0, 1, and so on. The rows have, for each row of the table and
    strategy, the paper's figures, if its square is as large, and the means and standard deviations
    over seeds of ``A``, ``B``, ``mean_area`` (of the views rendered) and ``seconds`` (processor
    time, with the renderings and areas that a planner asks for), the mean ``coverage`` that is
    reached, and ``bound``, the sites to cover divided by ``mean_area``.
    """
    rows = []
    for number in numbers:
        row = TABLE_1[number - 1]
        simulation = Simulation(row, side)
        for name in row.papers:
            planner = load(PLANNERS, name)
            runs, timings = zip(
                *(timed(partial(simulate, simulation, planner, seed)) for seed in range(seeds)),
                strict=True,
            )
            figures: dict[str, list[float]] = {
                "A": [len(coverage.viewpoints) for coverage in runs],
                "B": [coverage.overlap for coverage in runs],
                "mean_area": [np.count_nonzero(one.areas) / len(one.areas) for one in runs],
                "seconds": [timing.cpu_seconds for timing in timings],
            }
            measured = {key: float(np.mean(values)) for key, values in figures.items()}
            measured |= {f"{key}_std": float(np.std(values)) for key, values in figures.items()}
            measured["coverage"] = float(np.mean([one.fraction() for one in runs]))
            bound = row.coverage * simulation.sites.valid.size / measured["mean_area"]
            papers = {}
            if side == PAPER_SIDE:
                papers = dict(zip(("paper_A", "paper_B"), row.papers[name], strict=True))
            about = {"row": number, "strategy": name, "n": seeds}
            rows.append({**about, **papers, **measured, "bound": bound})
    return rows


@dataclass(frozen=True, slots=True)
class Setup:
    """One row of the paper's Table 1."""

    peaks: int
    rotation_deg: float
    threshold_px: float
    coverage: float
    affine: bool  # Whether the reprojection error is taken after the affine warp of Equation 4
    papers: dict[str, tuple[int, int]]  # The paper's (A) and (B) of each strategy


TABLE_1 = (
    Setup(1, 0.0, 15.0, 0.90, False, {
        "rov": (240, 1545), "arov": (286, 1636), "hov": (324, 1210), "sov": (275, 1941),
        "lpov": (325, 1515),
    }),
    Setup(1, 0.0, 3.0, 0.98, True, {
        "rov": (81, 6664), "arov": (80, 5824), "hov": (98, 6723), "sov": (100, 10043),
        "lpov": (86, 5489),
    }),
    Setup(2, 30.0, 3.0, 0.98, True, {
        "rov": (239, 9028), "arov": (217, 6991), "hov": (252, 7226), "sov": (245, 9148),
        "lpov": (191, 5943),
    }),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Mountain:
    """The mountain of all rows and strategies; lengths are in sites."""

    distance: float = 9.0
    """Distance from the front row of sites to the mountain's near end."""
    breadth: float = 150.0
    """Length of the mountain from end to end."""
    height: float = 17.0
    """Height of the peaks above the eyes."""
    setback: float = 18.0
    """How far the peaks stand behind the foot."""


_MOUNTAIN = _Mountain()


def mountain_curve(row: Setup, side: int) -> Float32Array:
    """Return the mountain's skyline in space (P, 3): right, up, forward.

    The mountain stands in front of the middle of a square of ``side`` rows and columns of sites.
    Over its width stand equal peaks; a point higher on the mountain also stands further back, since
    a mountain has a slope. At rotation 0 the foot is parallel to the camera plane; a rotation turns
    the mountain about its near end, so that it recedes to the right.
    """
    along = np.linspace(0.0, _MOUNTAIN.breadth, 513)
    one_peak = _MOUNTAIN.breadth / row.peaks
    rise = 1.0 - np.abs(2.0 * (along % one_peak) / one_peak - 1.0)
    across = along - _MOUNTAIN.breadth / 2.0 + side / 2.0
    back = _MOUNTAIN.setback * rise
    turn = np.radians(row.rotation_deg)
    right = across * np.cos(turn) - back * np.sin(turn) - side / 2.0
    forward = across * np.sin(turn) + back * np.cos(turn) + _MOUNTAIN.distance
    return np.stack([right, _MOUNTAIN.height * rise, forward], axis=1).astype(np.float32)


class Simulation:
    """A square of sites in front of a parametric mountain.

    It stands for one row of Table 1. Lengths are in sites (the pitch of the grid), and stand for
    metres in `skyline.paper`. The eyes look north, over flat ground. A rendering is the upper
    envelope of the mountain's skyline in the columns of a view. Tolerance areas, and ROV's
    knowledge of a site, are taken from the package: `skyline.paper.tolerance_areas`.
    """

    def __init__(self, row: Setup, side: int = PAPER_SIDE) -> None:
        self.row = row
        self.side = side
        steps = np.arange(side, dtype=np.float64)
        # Row 0 is the front, and the square is centred before the mountain.
        east = steps - (side - 1) / 2.0
        north = -steps
        reach = 15
        self.sites = Sites(np.ones((side, side), dtype=bool), east, north, reach)
        # Of a view's 640 columns 64 are looked at, evenly spread.
        columns = (np.arange(64) + 0.5) * (DEFAULT_WIDTH / 64)
        self._u = columns_u(DEFAULT_WIDTH)[columns.astype(np.int64)].astype(np.float32)
        self._curve = mountain_curve(row, side)
        step = np.arange(-reach, reach + 1, dtype=np.float64)
        right, back = np.meshgrid(step, step)
        self._around = np.stack([right, np.zeros_like(right), -back], axis=-1).reshape(1, -1, 3)

    def render(self, sites: Int64Array) -> Float64Array:
        """Return the skyline points (N, Q, 3) of views at sites (N).

        A point is right, up, forward.
        """
        v, depth = envelope(self._curve - self.eyes(sites)[:, None, :], self._u)
        return np.stack([self._u * depth, v * depth, depth], axis=2).astype(np.float64)

    def areas(self, points: Float64Array) -> BoolArray:
        """Return the tolerance areas (N, K, K) of views.

        The views have skyline points (N, P, 3).
        """
        window = self.sites.window
        around = np.broadcast_to(self._around, (len(points), window**2, 3))
        warp = tolerance_areas.affine_mean if self.row.affine else tolerance_areas.non_affine
        errors = tolerance_areas.errors_px(points, around, DEFAULT_WIDTH, warp)
        areas = (errors <= self.row.threshold_px).reshape(-1, window, window)
        areas[:, window // 2, window // 2] = True
        return np.asarray(areas)

    def eyes(self, sites: Int64Array) -> Float32Array:
        """Return right, up, forward (N, 3) of eyes."""
        row, col = self.sites.row_col(sites)
        east = self.sites.easting_m[col]
        north = self.sites.northing_m[row]
        return np.stack([east, np.zeros(len(row)), north], axis=1).astype(np.float32)


def envelope(points: Float32Array, u: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return the upper envelope of curves in space as views see it.

    Points (N, P, 3) are right, up and forward of each view's curve; abscissas ``u`` (Q,) of the
    columns are evenly spaced. The results are ordinates and depths (N, Q), NaN where there are
    none.
    """
    views = len(points)
    columns = len(u)
    v = np.full(views * columns, -np.inf, dtype=np.float32)
    inverse_depth = np.full(views * columns, np.nan, dtype=np.float32)
    crossings = list(_crossings(points, u))
    for place, ordinate, _ in crossings:
        np.maximum.at(v, place, ordinate)
    for place, ordinate, inverse in crossings:
        top = ordinate == v[place]
        inverse_depth[place[top]] = inverse[top]
    v = np.where(np.abs(v) < 1.0, v, np.float32(np.nan))
    depth = np.where(np.isnan(v), v, np.float32(1.0) / inverse_depth)
    return v.reshape(views, columns), depth.reshape(views, columns)


def _crossings(
    points: Float32Array, u: Float32Array
) -> Iterator[tuple[Int64Array, Float32Array, Float32Array]]:
    """Yield where curves cross columns.

    These are flat indices of (view, column), ordinates and inverse depths.

    Each edge meets its first column in the first arrays, its second in the second, and so on.
    """
    depth = points[..., 2]
    inverse = np.float32(1.0) / np.where(depth > 0.0, depth, np.float32(np.nan))
    abscissa = points[..., 0] * inverse
    ordinate = points[..., 1] * inverse
    position = (abscissa - u[0]) / (u[1] - u[0])
    one = position[:, :-1]
    other = position[:, 1:]
    # Clipped to the frame; an edge with a NaN end never starts before it stops.
    start = np.clip(np.nan_to_num(np.ceil(np.minimum(one, other)), nan=1e6), 0, 1e6)
    stop = np.clip(np.nan_to_num(np.floor(np.maximum(one, other)), nan=-1.0), -1, len(u) - 1)
    view, edge = np.nonzero(start <= stop)
    column = start[view, edge].astype(np.int64)
    last = stop[view, edge].astype(np.int64)
    while len(view):
        share = (column - one[view, edge]) / (other[view, edge] - one[view, edge])
        share = np.nan_to_num(share).astype(np.float32)
        yield (
            view * len(u) + column,
            ordinate[view, edge] * (1 - share) + ordinate[view, edge + 1] * share,
            # Along an edge 1 / z is linear in u.
            inverse[view, edge] * (1 - share) + inverse[view, edge + 1] * share,
        )
        more = column < last
        view = view[more]
        edge = edge[more]
        column = column[more] + 1
        last = last[more]


def simulate(simulation: Simulation, planner: Planner, seed: int) -> Coverage:
    """Run a planner on a simulation until the row's coverage is reached.

    Return the coverage, whose viewpoints are in the order rendered, the corners first.
    """
    coverage = Coverage(simulation.sites)
    known: list[Float64Array] = []

    def render(sites: Int64Array) -> None:
        points = simulation.render(sites)
        known.extend(points)
        for one, area in zip(sites, simulation.areas(points), strict=True):
            coverage.add(one[None], area[None])

    def projected_areas(sites: Int64Array) -> BoolArray:
        nearest, _ = simulation.sites.nearest(sites, coverage.viewpoints, 1)
        source = coverage.viewpoints[nearest[:, 0]]
        move = (simulation.eyes(sites) - simulation.eyes(source)).astype(np.float64)
        points = np.stack([known[row] for row in nearest[:, 0].tolist()])
        return simulation.areas(tolerance_areas.moved(points, move[:, None])[:, 0])

    side = simulation.side
    render(np.array([0, side - 1, (side - 1) * side, side * side - 1]))
    everywhere = simulation.sites.valid
    problem = Problem(coverage, everywhere, simulation.row.coverage, projected_areas)
    for asked in planner(problem, np.random.default_rng(seed)):
        render(asked)
    return coverage


# --- predictors on real terrain -------------------------------------------------------------


_DISPLACEMENTS = 12
"""Number of other eyes around each viewpoint."""
_AWAY_M = 300.0
"""Radius of the disc in which they are drawn evenly."""
_THRESHOLD_PX = 3.0
"""Two skylines are alike within this."""


def prediction_quality(
    dem: options.Dems,
    record: options.Record = None,
    seed: options.Seed = 41,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Reprojection errors against renderings: which displaced views look alike.

    The views are displaced from n viewpoints.
    """
    terrain = read_dem(dem, DemOptions(crs=crs))
    rows = measure_quality(terrain, 8 if quick else 200, seed)
    columns = "predictor km2 n precision recall rank_correlation answered"
    options.report(record, rows, columns, terrain=terrain)


def measure_quality(field: HeightField, viewpoints: int, seed: int) -> list[Row]:
    """Compare every predictor with renderings around random viewpoints.

    Return ``precision`` and ``recall`` of "alike within the threshold", with 95 % intervals over
    viewpoints (precision is NaN where nothing was predicted alike); Spearman's
    ``rank_correlation`` of predicted and true errors; and ``answered``, the share of displacements
    with a finite predicted error.
    """
    eyes, others = _choose_eyes(field, viewpoints, seed)
    with HorizonRenderer(field, RenderConfig()) as renderer:
        views = renderer.render(eyes)
        rendered = renderer.render(others)
    shape = len(views), _DISPLACEMENTS
    # Rows of `rendered` run over eyes, moves, headings; pairs over eyes, headings, moves.
    order = np.arange(len(rendered)).reshape(viewpoints, _DISPLACEMENTS, 4).swapaxes(1, 2).ravel()
    there = rendered[order]
    true_px = true_errors_px(views[np.repeat(np.arange(len(views)), _DISPLACEMENTS)], there)
    true_px = true_px.reshape(shape)
    eyes_m = (there.easting_m, there.northing_m, there.eye_elevation_m)
    eyes_there_m = (part.reshape(shape) for part in eyes_m)
    moved_m = tolerance_areas.displacements_m(views, views.heading, *eyes_there_m)
    points_m = tolerance_areas.skyline_points_m(views)
    alike = true_px <= _THRESHOLD_PX
    rows = list[Row]()
    for name, warp in tolerance_areas.WARPS.items():
        errors = tolerance_areas.errors_px(points_m, moved_m, views.width, warp)
        claimed = errors <= _THRESHOLD_PX
        precision, precision_interval = _share(claimed & alike, claimed, seed)
        recall, recall_interval = _share(claimed & alike, alike, seed)
        rows.append(
            {
                "predictor": name,
                "km2": square_km(field.bounds_m),
                "n": viewpoints,
                "precision": precision,
                "precision_interval": precision_interval,
                "recall": recall,
                "recall_interval": recall_interval,
                "rank_correlation": float(spearmanr(errors.ravel(), true_px.ravel()).statistic),
                "answered": float(np.isfinite(errors).mean()),
            }
        )
    return rows


def _choose_eyes(field: HeightField, viewpoints: int, seed: int) -> tuple[Viewpoints, Viewpoints]:
    """Return the viewpoints, and all displaced ones, grouped by viewpoint."""
    generator = np.random.default_rng(seed)
    west, south, east, north = field.bounds_m
    margin = 3000.0 + _AWAY_M  # Least distance of a viewpoint from the map's border
    if not (east - west > 2.0 * margin and north - south > 2.0 * margin):
        raise InputError(
            f"the map is {(east - west) / 1e3:.1f} x {(north - south) / 1e3:.1f} km; expected more "
            f"than {2e-3 * margin:.1f} km either way: choose a larger DEM"
        )
    tried = 10 * viewpoints
    easting = generator.uniform(west + margin, east - margin, tried)[:, np.newaxis]
    northing = generator.uniform(south + margin, north - margin, tried)[:, np.newaxis]
    radius = _AWAY_M * np.sqrt(generator.random((tried, _DISPLACEMENTS)))
    bearing = generator.uniform(0.0, 2.0 * np.pi, radius.shape)
    eyes_m = np.stack([easting, northing])
    others_m = eyes_m + radius * np.stack([np.sin(bearing), np.cos(bearing)])
    every_m = np.concatenate([eyes_m, others_m], axis=2)
    heights_m = field.height_at(easting_m=every_m[0], northing_m=every_m[1])
    chosen = np.flatnonzero(np.isfinite(heights_m).all(axis=1))[:viewpoints]
    if len(chosen) < viewpoints:
        raise InputError(
            f"only {len(chosen)} of {tried} random viewpoints have ground all around; the map is "
            "mostly holes: choose another"
        )
    eyes_m, others_m = (some[:, chosen].reshape(2, -1) for some in (eyes_m, others_m))
    eyes = stand_on(field, easting_m=eyes_m[0], northing_m=eyes_m[1])
    return eyes, stand_on(field, easting_m=others_m[0], northing_m=others_m[1])


def _share(right: BoolArray, among: BoolArray, seed: int) -> tuple[float, tuple[float, float]]:
    """Return the share of right pairs, and its 95 % interval.

    The interval is over viewpoints.
    """
    eyes = len(right) // 4
    hits, all_ = (np.count_nonzero(part.reshape(eyes, -1), axis=1) for part in (right, among))
    drawn = np.random.default_rng(seed).integers(0, eyes, (1000, eyes))
    shares = hits[drawn].sum(axis=1) / np.maximum(all_[drawn].sum(axis=1), 1)
    low, high = np.quantile(shares, [0.025, 0.975])
    return hits.sum() / all_.sum() if all_.any() else np.nan, (float(low), float(high))
