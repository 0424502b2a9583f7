"""The paper's simulation (section 5.1): a square of candidates before a parametric mountain.

Lengths are in candidates (the pitch of the grid), and stand for metres in `skyline.paper`. The eyes
look north, over flat ground, at a mountain whose skyline is a curve in space: over the width of the
mountain stand ``peaks`` equal peaks; a point higher on the mountain also stands further back, since
a mountain has a slope. At rotation 0 the mountain's foot is parallel to the camera plane; a
rotation turns the mountain about its near end, so that it recedes to the right.

A rendering is the upper envelope of that curve in the columns of a view. Tolerance areas, and what
ROV knows of a candidate, are those of the package: `skyline.paper.reprojection`.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.camera import DEFAULT_WIDTH, columns_u
from skyline.paper.reprojection import affine_mean, errors_px, moved, non_affine
from skyline.paper.strategies import Candidates, Coverage, Problem, Strategy

_CURVE_POINTS = 513


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the paper's Table 1."""

    peaks: int
    rotation_deg: float
    threshold_px: float
    coverage: float
    affine: bool  # Whether the reprojection error is taken after the affine warp of Equation 4


PAPERS_FIGURES = (
    {"rov": (240, 1545), "arov": (286, 1636), "hov": (324, 1210), "sov": (275, 1941),
     "lpov": (325, 1515)},
    {"rov": (81, 6664), "arov": (80, 5824), "hov": (98, 6723), "sov": (100, 10043),
     "lpov": (86, 5489)},
    {"rov": (239, 9028), "arov": (217, 6991), "hov": (252, 7226), "sov": (245, 9148),
     "lpov": (191, 5943)},
)  # fmt: skip
"""(A) and (B) of the paper's Table 1, by row and strategy."""

TABLE_1 = (
    Row(peaks=1, rotation_deg=0.0, threshold_px=15.0, coverage=0.90, affine=False),
    Row(peaks=1, rotation_deg=0.0, threshold_px=3.0, coverage=0.98, affine=True),
    Row(peaks=2, rotation_deg=30.0, threshold_px=3.0, coverage=0.98, affine=True),
)


@dataclass(frozen=True, slots=True)
class Mountain:
    """The model's free parameters, in candidates; one set for all rows and strategies."""

    distance: float = 9.0  # From the front row of candidates to the mountain's near end
    width: float = 150.0  # Of the mountain, end to end
    height: float = 17.0  # Of the peaks above the eyes
    setback: float = 18.0  # How far behind the foot the peaks stand
    size: int = 100  # Rows and columns of candidates
    reach: int = 15  # Of a tolerance area, to either side
    columns: int = 64  # Of the view's 640 columns, how many are looked at, evenly spread

    def curve(self, row: Row) -> Float32Array:
        """Return the skyline of the mountain in space, (P, 3): right, up, forward."""
        along = np.linspace(0.0, self.width, _CURVE_POINTS)
        one_peak = self.width / row.peaks
        rise = 1.0 - np.abs(2.0 * (along % one_peak) / one_peak - 1.0)
        across = along - self.width / 2.0 + self.size / 2.0
        back = self.setback * rise
        turn = np.radians(row.rotation_deg)
        right = across * np.cos(turn) - back * np.sin(turn) - self.size / 2.0
        forward = across * np.sin(turn) + back * np.cos(turn)
        return np.stack([right, self.height * rise, forward + self.distance], axis=1).astype(
            np.float32
        )


class Simulation:
    """Renders and measures for one row of Table 1."""

    def __init__(self, row: Row) -> None:
        self.row = row
        self.mountain = Mountain()
        size, reach = self.mountain.size, self.mountain.reach
        steps = np.arange(size, dtype=np.float64)
        # Row 0 is the front, and the square is centred before the mountain.
        east, north = steps - (size - 1) / 2.0, -steps
        self.candidates = Candidates(np.ones((size, size), dtype=bool), east, north, reach)
        stride = DEFAULT_WIDTH / self.mountain.columns
        columns = (np.arange(self.mountain.columns) + 0.5) * stride
        self._u = columns_u(DEFAULT_WIDTH)[columns.astype(np.int64)].astype(np.float32)
        self._curve = self.mountain.curve(row)
        step = np.arange(-reach, reach + 1, dtype=np.float64)
        right, back = np.meshgrid(step, step)
        self._around = np.stack([right, np.zeros_like(right), -back], axis=-1).reshape(1, -1, 3)

    def corners(self) -> Int64Array:
        """Return the four corners of the square, which are rendered to begin with."""
        rows, cols = self.candidates.valid.shape
        return np.array([0, cols - 1, (rows - 1) * cols, rows * cols - 1])

    def render(self, candidates: Int64Array) -> Float64Array:
        """Return the skyline points (N, Q, 3) of views at candidates (N): right, up, forward."""
        v, depth = envelope(self._curve - self.eyes(candidates)[:, None, :], self._u)
        return np.stack([self._u * depth, v * depth, depth], axis=2).astype(np.float64)

    def areas(self, points: Float64Array) -> BoolArray:
        """Return the tolerance areas (N, K, K) of views with skyline points (N, P, 3)."""
        window = self.candidates.window
        around = np.broadcast_to(self._around, (len(points), window**2, 3))
        warp = affine_mean if self.row.affine else non_affine
        errors = errors_px(points, around, DEFAULT_WIDTH, warp).reshape(-1, window, window)
        areas = errors <= self.row.threshold_px
        areas[:, window // 2, window // 2] = True
        return np.asarray(areas)

    def eyes(self, candidates: Int64Array) -> Float32Array:
        """Return right, up, forward (N, 3) of eyes."""
        row, col = self.candidates.row_col(candidates)
        east, north = self.candidates.easting_m[col], self.candidates.northing_m[row]
        return np.stack([east, np.zeros(len(row)), north], axis=1).astype(np.float32)


def envelope(points: Float32Array, u: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return the upper envelope of curves in space as views see it.

    Points (N, P, 3) are right, up and forward of each view's curve; abscissas ``u`` (Q,) of the
    columns are evenly spaced. Returned are ordinates and depths (N, Q), NaN where there are none.
    """
    views, columns = len(points), len(u)
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
    """Yield where curves cross columns: flat (view, column) places, ordinates, inverse depths.

    Each edge meets its first column in the first arrays, its second in the second, and so on.
    """
    depth = points[..., 2]
    inverse = np.float32(1.0) / np.where(depth > 0.0, depth, np.float32(np.nan))
    abscissa, ordinate = points[..., 0] * inverse, points[..., 1] * inverse
    position = (abscissa - u[0]) / (u[1] - u[0])
    one, other = position[:, :-1], position[:, 1:]
    # Clipped to the frame; an edge with a NaN end never starts before it stops.
    start = np.clip(np.nan_to_num(np.ceil(np.minimum(one, other)), nan=1e6), 0, 1e6)
    stop = np.clip(np.nan_to_num(np.floor(np.maximum(one, other)), nan=-1.0), -1, len(u) - 1)
    view, edge = np.nonzero(start <= stop)
    column, last = start[view, edge].astype(np.int64), stop[view, edge].astype(np.int64)
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
        view, edge, column, last = view[more], edge[more], column[more] + 1, last[more]


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A strategy run on a simulation; viewpoints in the order rendered, corners first."""

    coverage: Coverage
    # Processor time of the strategy with all it asked for: renderings and areas.
    seconds: float


def simulate(simulation: Simulation, strategy: Strategy, seed: int) -> Run:
    """Run a strategy on a simulation until the row's coverage is reached."""
    started = time.process_time()
    coverage = Coverage(simulation.candidates)
    known: list[Float64Array] = []

    def render(candidates: Int64Array) -> None:
        points = simulation.render(candidates)
        known.extend(points)
        for one, area in zip(candidates, simulation.areas(points), strict=True):
            coverage.add(one[None], area[None])

    def projected_areas(candidates: Int64Array) -> BoolArray:
        nearest, _ = simulation.candidates.nearest(candidates, coverage.viewpoints, 1)
        source = coverage.viewpoints[nearest[:, 0]]
        move = (simulation.eyes(candidates) - simulation.eyes(source)).astype(np.float64)
        points = np.stack([known[row] for row in nearest[:, 0].tolist()])
        return simulation.areas(moved(points, move[:, None])[:, 0])

    render(simulation.corners())
    everywhere = simulation.candidates.valid
    problem = Problem(coverage, everywhere, simulation.row.coverage, projected_areas)
    for asked in strategy(problem, np.random.default_rng(seed)):
        render(asked)
    return Run(coverage, time.process_time() - started)
