"""Sections 4 and 4.3 on real terrain: a strategy chooses viewpoints, which are rendered and stored.

A coarse grid is rendered first. Each heading and each square of the coarse grid is then a planning
problem of its own. All run in step, so that all views requested in a round are rendered as one
batch. All random choices follow from the seed.
"""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array, Progress, UInt8Array
from skyline.errors import InputError, StoreMismatchError
from skyline.geodesy import Bounds, Rectangle
from skyline.paper.reprojection import displacements_m, moved, skyline_points_m, tolerance_errors_px
from skyline.paper.strategies import PLANNERS, Candidates, Coverage, Planner, Problem
from skyline.paper.verify import Verification, verify_coverage
from skyline.plugins import load
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.skylines import HEADINGS, Views
from skyline.store.header import StoreHeader
from skyline.store.merge import sorted_once
from skyline.store.write import check_store_path, write_store
from skyline.survey.build import BuildResult, finished_store
from skyline.survey.plans import lattice_m, map_bounds, rendering_columns, rendering_header
from skyline.terrain.heightfield import HeightField, ground_of
from skyline.terrain.viewpoints import Viewpoints, stand_on

_log = logging.getLogger(__name__)

_REACH_M = 300.0
"""Greatest extent of a tolerance area from its view."""

_MOST_CANDIDATES = 20_000_000

Render = Callable[[Viewpoints, UInt8Array], Views]
"""Renders N viewpoints along N headings; returns N views in the same order."""


@dataclass(frozen=True, slots=True)
class PlanConfig:
    """Settings of a plan.

    Raises `InputError` for a planner that is not known, a coverage outside (0, 1], a threshold or
    a spacing that is not positive, and spacings that do not fit each other.
    """

    strategy: str = "lpov"
    """The name of a planner: an entry point of `skyline.paper.strategies.PLANNERS`."""
    coarse_m: float = 1000.0
    """Distance between viewpoints of the coarse grid; a whole multiple of ``candidate_m``."""
    candidate_m: float = 50.0
    """Distance between candidates; at most 300."""
    threshold_px: float = 3.0
    """A location is covered where the reprojection error of some view is at most this."""
    coverage: float = 0.98
    """Share of the candidates to cover in each heading, in (0, 1]."""
    seed: int = 0

    def __post_init__(self) -> None:
        load(PLANNERS, self.strategy)
        for name, value, unit, most in (
            ("coverage", self.coverage, "", 1.0),
            ("threshold", self.threshold_px, " px", np.inf),
            ("candidate spacing", self.candidate_m, " m", _REACH_M),
            ("coarse spacing", self.coarse_m, " m", np.inf),
        ):
            if not 0.0 < value <= most or np.isinf(value):
                limit = "" if np.isinf(most) else f", at most {most:g}{unit}"
                raise InputError(f"{name} is {value}{unit}; expected a number above 0{limit}")
        if abs(self.coarse_m / self.candidate_m - self.stride) > 1e-9 * self.stride:
            raise InputError(
                f"spacing of {self.coarse_m} m is no whole multiple of the candidates' "
                f"{self.candidate_m} m; choose one that is, for example "
                f"{self.stride * self.candidate_m} m"
            )

    @property
    def stride(self) -> int:
        """Candidates from one viewpoint of the coarse grid to the next."""
        return max(1, round(self.coarse_m / self.candidate_m))


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """The viewpoints that were chosen and rendered."""

    field: HeightField
    config: PlanConfig
    candidates: Candidates
    coverages: tuple[Coverage, ...]
    """One for each heading: its viewpoints and their tolerance areas."""
    views: Views
    """All renderings, in the order they were made."""
    batches: int
    """Rounds of rendering."""
    render_s: float
    plan_s: float
    """Seconds on everything but rendering."""

    @property
    def coverage(self) -> float:
        """Predicted share of the candidates that is covered, over all headings."""
        return float(np.mean([one.fraction() for one in self.coverages]))

    @property
    def overlap(self) -> int:
        """Inclusions in tolerance areas less covered candidates, over all headings."""
        return sum(one.overlap for one in self.coverages)

    def viewpoints(self, candidates: Int64Array) -> Viewpoints:
        """Return viewpoints at candidates (N)."""
        return _viewpoints(self.field, self.candidates, candidates)


def build_planned(
    terrain: HeightField,
    path: str | Path,
    planned: PlanConfig,
    bounds_deg: Bounds | None = None,
    config: RenderConfig | None = None,
    progress: Progress | None = None,
) -> tuple[BuildResult, Plan, Verification] | None:
    """Let a strategy choose viewpoints until the area is covered, and store their renderings.

    The store is written at the end of the plan. Returns the build, the plan, and the share of its
    coverage that renderings confirm; None if the store already exists with the same settings.

    Bounds are W, S, E, N in degrees, by default all of the terrain. ``progress`` is called after
    each batch with the share that is covered, of 100.

    Raises `InputError` where the area cannot be planned, and `StoreMismatchError` where the store
    at ``path`` was built from another DEM or with other settings.
    """
    started = time.perf_counter()
    path, config = Path(path).resolve(), config or RenderConfig()
    settings: dict[str, object] = {
        "planner": planned.strategy,
        "plan": asdict(planned),
        "bounds_deg": bounds_deg,
    }
    header = rendering_header(terrain, settings, config)
    check_store_path(path)
    if _is_planned(path, header):
        return None
    with HorizonRenderer(terrain, config) as renderer:
        area = map_bounds(terrain, bounds_deg)
        done = plan(terrain, renderer.render, planned, area, progress)
        header = replace(header, renderer=renderer.description)
        columns = rendering_columns(header, done.views)
        order = sorted_once(header, columns)
        # A plan takes long, and another store may have been written meanwhile.
        if not _is_planned(path, header):
            write_store(path, header, columns, order)
        built = BuildResult(len(order), len(order), time.perf_counter() - started)
        return built, done, verify_coverage(done, renderer.render)


def _is_planned(path: Path, header: StoreHeader) -> bool:
    """Return whether a store is finished; raises `StoreMismatchError` for any other store."""
    if not path.exists():
        return False
    if finished_store(path, header) is None:
        raise StoreMismatchError(
            f"store {path} was planned for other bounds; write to another file, and join the "
            "two with `skyline store merge`"
        )
    return True


def plan(
    terrain: HeightField,
    render: Render,
    config: PlanConfig,
    bounds_m: Rectangle | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Choose viewpoints and render them until the coverage asked for is reached.

    The area is west, south, east, north, by default all of the terrain. Raises `InputError` for a
    spacing larger than the area, or an area wholly in holes.
    """
    started = time.perf_counter()
    candidates = lay_out(terrain, config, bounds_m)
    coarse, squares = _coarse_grid(candidates, config)
    headings = [_Heading(terrain, config, candidates, squares, heading) for heading in HEADINGS]
    requests = [coarse for _ in headings]
    views: list[Views] = []
    render_s = 0.0
    while any(map(len, requests)):
        rendering = time.perf_counter()
        eyes = _viewpoints(terrain, candidates, np.concatenate(requests))
        asked = [len(some) for some in requests]
        views.append(render(eyes, np.repeat(np.array(HEADINGS, np.uint8), asked)))
        render_s += time.perf_counter() - rendering
        for one, some in zip(headings, requests, strict=True):
            if len(some):
                one.add(some, views[-1][views[-1].heading == one.heading])
        share = float(np.mean([one.coverage.fraction() for one in headings]))
        _log.info("batch %d: coverage %.4f, %d renderings", len(views), share, sum(map(len, views)))
        if progress:
            progress(int(100 * share), 100)
        requests = [one.requests() for one in headings]
    plan_s = time.perf_counter() - started - render_s
    coverages = tuple(one.coverage for one in headings)
    joined = Views.concatenate(views)
    return Plan(terrain, config, candidates, coverages, joined, len(views), render_s, plan_s)


class _Heading:
    """The views rendered along one heading, and a planner at work in each square of it."""

    def __init__(
        self,
        field: HeightField,
        config: PlanConfig,
        candidates: Candidates,
        squares: Int64Array,
        heading: int,
    ) -> None:
        self.heading = heading
        self.coverage = Coverage(candidates)
        self._field, self._config = field, config
        self._points: list[Float64Array] = []
        self._width = 0
        self._planned: list[tuple[Problem, Iterator[Int64Array]]] = []
        planner: Planner = load(PLANNERS, config.strategy)
        for number, square in enumerate(np.unique(squares[candidates.valid])):
            region = candidates.valid & (squares == square)
            problem = Problem(self.coverage, region, config.coverage, self.projected_areas)
            generator = np.random.default_rng([config.seed, heading, number])
            self._planned.append((problem, planner(problem, generator)))

    def requests(self) -> Int64Array:
        """Return the candidates that planners ask for; none where the heading is covered."""
        asked = [np.zeros(0, dtype=np.int64)]
        if self.coverage.fraction() < self._config.coverage:
            for problem, chosen in self._planned:
                some = next(chosen, None)
                if some is not None:
                    asked.append(self._checked(problem, some))
        return np.concatenate(asked)

    def _checked(self, problem: Problem, chosen: Int64Array) -> Int64Array:
        """Return what a planner chose; raises `InputError` unless it lies in the region."""
        given = np.asarray(chosen)
        if given.ndim != 1 or not np.isin(given, np.flatnonzero(problem.region)).all():
            raise InputError(
                f"planner {self._config.strategy!r} chose {chosen}; expected indices (n,) of "
                "candidates in the problem's region"
            )
        return given.astype(np.int64, copy=False)

    def add(self, viewpoints: Int64Array, views: Views) -> None:
        """Add views (N) rendered at candidates (N)."""
        points, self._width = skyline_points_m(views), views.width
        self._points.extend(points)
        self.coverage.add(viewpoints, self._areas(points, views))

    def projected_areas(self, candidates: Int64Array) -> BoolArray:
        """Return the tolerance areas (N, K, K) of N candidates that have not been rendered.

        Each has the skyline points of the nearest rendered view, moved by Equation 1.
        """
        coverage = self.coverage
        nearest, _ = coverage.candidates.nearest(candidates, coverage.viewpoints, 1)
        source, there = (
            _viewpoints(self._field, coverage.candidates, some)
            for some in (coverage.viewpoints[nearest[:, 0]], candidates)
        )
        move = displacements_m(
            source,
            np.full(len(candidates), self.heading),
            there.easting_m[:, np.newaxis],
            there.northing_m[:, np.newaxis],
            there.eye_elevation_m[:, np.newaxis],
        )
        points = np.stack([self._points[row] for row in nearest[:, 0].tolist()])
        return self._areas(moved(points, move)[:, 0], there)

    def _areas(self, points_m: Float64Array, eyes: Views | Viewpoints) -> BoolArray:
        errors: Float32Array = tolerance_errors_px(
            points_m,
            eyes,
            np.full(len(eyes), self.heading),
            ground_of(self._field),
            size=self.coverage.candidates.window,
            spacing_m=self._config.candidate_m,
            width=self._width,
        )
        return np.asarray(errors <= self._config.threshold_px)


def lay_out(
    field: HeightField, config: PlanConfig, bounds_m: Rectangle | None = None
) -> Candidates:
    """Lay candidates over an area, at whole multiples of their spacing.

    A candidate is valid where an eye can stand off the holes and off the map's border. Raises
    `InputError` for a spacing larger than the area, or an area wholly in holes.
    """
    bounds_m = bounds_m or field.bounds_m
    west, south, east, north = bounds_m
    if config.coarse_m > max(east - west, north - south):
        raise InputError(
            f"spacing of {config.coarse_m:g} m is larger than the area of {east - west:.0f} x "
            f"{north - south:.0f} m; choose a smaller spacing or a larger area"
        )
    easting_m, northing_m = lattice_m(bounds_m, config.candidate_m, _MOST_CANDIDATES)
    valid = _can_stand(field, *np.meshgrid(easting_m, northing_m))
    return Candidates(valid, easting_m, northing_m, int(_REACH_M // config.candidate_m))


def _can_stand(field: HeightField, easting: Float64Array, northing: Float64Array) -> BoolArray:
    """Return the places around which the surface is known for a sample to every side."""
    ground = field.height_at(easting_m=easting, northing_m=northing)
    for east, north in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        ground = ground + field.height_at(
            easting_m=easting + east * field.spacing_east_m,
            northing_m=northing + north * field.spacing_north_m,
        )
    return ~np.isnan(ground)


def _coarse_grid(candidates: Candidates, config: PlanConfig) -> tuple[Int64Array, Int64Array]:
    """Return the valid candidates of the coarse grid, and each candidate's square of it.

    Squares (rows, cols) are numbered from south to north, and in a row from west to east. Raises
    `InputError` where the coarse grid has no valid candidate.
    """
    row, col = (
        np.rint(axis / config.candidate_m).astype(np.int64)
        for axis in (candidates.northing_m, candidates.easting_m)
    )
    stride = config.stride
    coarse = (row[:, None] % stride == 0) & (col % stride == 0) & candidates.valid
    if not coarse.any():
        raise InputError(
            f"no viewpoint of the {config.coarse_m:g} m grid falls on the surface in easting "
            f"{col[0] * config.candidate_m:.0f} to {col[-1] * config.candidate_m:.0f}, northing "
            f"{row[-1] * config.candidate_m:.0f} to {row[0] * config.candidate_m:.0f}; choose a "
            "smaller spacing or a larger area"
        )
    return np.flatnonzero(coarse), (row // stride)[:, None] * len(col) + col // stride


def _viewpoints(field: HeightField, at: Candidates, candidates: Int64Array) -> Viewpoints:
    row, col = at.row_col(candidates)
    return stand_on(field, easting_m=at.easting_m[col], northing_m=at.northing_m[row])
