"""The paper's simulation (section 5.1): a square of candidates before a parametric mountain.

Lengths are in candidates (the pitch of the grid). The eyes look north, over flat ground, at a
mountain whose skyline is a curve in space: over the width of the mountain stand ``peaks`` equal
peaks; a point higher on the mountain also stands further back, since a mountain has a slope. At
rotation 0 the mountain's foot is parallel to the camera plane; a rotation turns the mountain about
its near end, so that it recedes to the right.

A rendering is the upper envelope of that curve in the columns of a view. What is known without
rendering is what the views rendered so far have seen: their 3-D skyline points, from elsewhere.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Int64Array
from skyline.camera import DEFAULT_WIDTH, columns_u, pixel_size
from skyline.paper.coverage import CandidateGrid, Coverage, Problem, Strategy

_CURVE_POINTS = 513
_FEWEST_POINTS = 3
_SOURCES = 8
"""How many rendered views, the nearest, a prediction is made from."""
_NEAREST_DEPTH_SHARE = 0.05
"""A skyline point this much nearer than it was is taken to be passed: no warp reaches it."""


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the paper's Table 1."""

    peaks: int
    rotation_deg: float
    threshold_px: float
    coverage: float
    affine: bool  # Whether the reprojection error is taken after the affine warp of Equation 4


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


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Skylines of N eyes in Q columns: ordinates and forward depths, NaN where there is none."""

    v: Float32Array
    depth: Float32Array


class Simulation:
    """Renders, measures and predicts for one row of Table 1."""

    def __init__(self, row: Row) -> None:
        self.row = row
        self.mountain = Mountain()
        size = self.mountain.size
        self.grid = CandidateGrid(np.ones((size, size), dtype=bool), self.mountain.reach)
        stride = DEFAULT_WIDTH / self.mountain.columns
        columns = (np.arange(self.mountain.columns) + 0.5) * stride
        self._u = columns_u(DEFAULT_WIDTH)[columns.astype(np.int64)].astype(np.float32)
        self._curve = self.mountain.curve(row)

    def corners(self) -> Int64Array:
        """Return the four corners of the square, which are rendered to begin with."""
        rows, cols = self.grid.shape
        return np.array([0, cols - 1, (rows - 1) * cols, rows * cols - 1])

    def render(self, candidates: Int64Array) -> Seen:
        """Render the skyline from candidates (N)."""
        return self.see(
            candidates, np.broadcast_to(self._curve, (len(candidates), *self._curve.shape))
        )

    def see(self, candidates: Int64Array, points: Float32Array) -> Seen:
        """See curves (N, P, 3) in the simulation's own frame from candidates (N)."""
        return envelope(points - self._eyes(candidates)[:, None, :], self._u)

    def points(self, candidates: Int64Array, seen: Seen) -> Float32Array:
        """Return the 3-D skyline points of views in the simulation's own frame, (N, Q, 3)."""
        points = np.stack([self._u * seen.depth, seen.v * seen.depth, seen.depth], axis=2)
        return np.asarray(points + self._eyes(candidates)[:, None, :], dtype=np.float32)

    def measure(self, seen: Seen) -> Float32Array:
        """Return reprojection errors over the windows of views, (N, K, K) px (paper 4.2)."""
        return np.stack(
            [
                reprojection_errors(self._u, v, depth, self.mountain.reach, self.row.affine)
                for v, depth in zip(seen.v, seen.depth, strict=True)
            ]
        )

    def _eyes(self, candidates: Int64Array) -> Float32Array:
        """Return right, up, forward of eyes; row 0 is the front, the square is centred."""
        row, col = self.grid.row_col(candidates)
        half = (self.mountain.size - 1) / 2.0
        return np.stack([col - half, np.zeros(len(row)), -row], axis=1).astype(np.float32)


class SimulatedModel:
    """Predicts tolerance areas from the 3-D skyline points of the views rendered so far.

    A predicted view is the upper envelope, seen from the candidate, of what the nearest rendered
    views saw. Nothing that no view has seen enters.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._viewpoints = np.zeros(0, dtype=np.int64)
        columns = simulation.mountain.columns
        self._points = np.zeros((0, columns + 1, 3), dtype=np.float32)

    def learn(self, candidates: Int64Array, seen: Seen) -> None:
        """Add rendered views."""
        points = self._simulation.points(candidates, seen)
        # A row of NaN ends each view's curve, so that curves are not joined to one another.
        ends = np.full((len(points), 1, 3), np.nan, dtype=np.float32)
        self._points = np.concatenate([self._points, np.concatenate([points, ends], axis=1)])
        self._viewpoints = np.concatenate([self._viewpoints, candidates])

    def predict_errors(self, candidates: Int64Array) -> Float32Array:
        """Return predicted reprojection errors of views at candidates (N), (N, K, K) px."""
        simulation = self._simulation
        nearest, _ = simulation.grid.nearest(candidates, self._viewpoints, _SOURCES)
        points = self._points[nearest].reshape(len(candidates), -1, 3)
        return simulation.measure(simulation.see(candidates, points))


def envelope(points: Float32Array, u: Float32Array) -> Seen:
    """Return the upper envelope of curves in space as views see it.

    Points (N, P, 3) are right, up and forward of each view's curve; NaN breaks a curve. Abscissas
    ``u`` (Q,) of the columns are evenly spaced.
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
    return Seen(v.reshape(views, columns), depth.reshape(views, columns))


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


def reprojection_errors(
    u: Float32Array, v: Float32Array, depth: Float32Array, reach: int, affine: bool
) -> Float32Array:
    """Return the mean reprojection error of one view at its neighbours over flat ground, px.

    With t the displacement (right, forward), a point at (u, v, z) moves by (u tz - tx, v tz) /
    (z - tz); the warp of Equation 4 moves it by (u tz - tx, v tz) / (Z - tz), Z the mean depth.
    So the error is the length of that vector times the difference of the inverses, and without a
    warp times 1 / (z - tz).

    The view's skyline is ``u``, ``v`` and ``depth`` (Q,), NaN where there is none; depth in
    candidates. Return (K, K), rows southward (away from the mountain) and columns eastward; ``inf``
    where no warp reaches or fewer than three points stay in front and in frame.
    """
    there = np.isfinite(v)
    u, v, depth = u[there], v[there], depth[there]
    step = np.arange(-reach, reach + 1, dtype=np.float32)
    errors = np.full((len(step), len(step)), np.inf, dtype=np.float32)
    errors[reach, reach] = 0.0
    if len(u) < _FEWEST_POINTS:
        return errors
    forward = -step[:, None]
    left = depth - forward
    front = left > _NEAREST_DEPTH_SHARE * depth
    inverse = np.float32(1.0) / np.where(front, left, np.float32(1.0))
    common: Float32Array = np.zeros_like(forward)
    if affine:
        mean_left = depth.mean() - forward
        front &= mean_left > 0.0
        common = (1.0 / np.where(mean_left > 0.0, mean_left, 1.0)).astype(np.float32)
    front &= np.abs(v * depth * inverse) < 1.0
    factor = np.abs(inverse - common) / np.float32(pixel_size(DEFAULT_WIDTH))
    # |u + (u tz - tx) / (z - tz)| < 1 is |u z - tx| < z - tz.
    right = step[:, None]
    in_frame = (right > (u * depth - left)[:, None, :]) & (right < (u * depth + left)[:, None, :])
    in_frame &= front[:, None, :]
    along = (u * forward)[:, None, :] - right
    along *= along
    along += np.square(v * forward)[:, None, :]
    distance = np.sqrt(along, out=along)
    distance *= factor[:, None, :]
    distance *= in_frame
    points = np.count_nonzero(in_frame, axis=2)
    enough = points >= _FEWEST_POINTS
    errors[enough] = distance.sum(axis=2)[enough] / points[enough]
    errors[reach, reach] = 0.0
    return errors


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A strategy run on a simulation; viewpoints in the order rendered, corners first."""

    coverage: Coverage
    progress: NDArray[np.float64]  # Coverage after the corners and after each rendering
    # Processor time of the strategy with all it asked for: renderings, areas, predictions.
    seconds: float


def simulate(simulation: Simulation, strategy: Strategy, seed: int) -> Run:
    """Run a strategy on a simulation until the row's coverage is reached."""
    started = time.process_time()
    row = simulation.row
    model, coverage = SimulatedModel(simulation), Coverage(simulation.grid)
    everywhere = simulation.grid.valid
    problem = Problem(coverage, model.predict_errors, row.threshold_px, row.coverage, everywhere)

    def rendered(candidates: Int64Array) -> Float32Array:
        seen = simulation.render(candidates)
        model.learn(candidates, seen)
        errors = simulation.measure(seen)
        for one, area in zip(candidates, errors <= row.threshold_px, strict=True):
            coverage.add(one[None], area[None])
            progress.append(coverage.fraction())
        return errors

    progress: list[float] = []
    rendered(simulation.corners())
    requests = strategy(problem, np.random.default_rng(seed))
    asked = next(requests, None)
    while asked is not None:
        try:
            asked = requests.send(rendered(asked))
        except StopIteration:
            asked = None
    return Run(coverage, np.array(progress), time.process_time() - started)
