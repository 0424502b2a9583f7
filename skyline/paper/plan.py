"""Sections 4 and 4.3 on real terrain: a strategy chooses viewpoints.

A coarse grid is rendered first. Each heading and each square of the coarse grid is then a planning
problem of its own. All run in step, so that all views requested in a round are rendered as one
batch. All random choices follow from the seed.
"""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array, UInt8Array
from skyline.errors import InputError
from skyline.geodesy.map_frame import Rectangle
from skyline.paper.planners import PLANNERS, Coverage, Planner, Problem, Sites
from skyline.paper.tolerance_areas import (
    displacements_m,
    moved,
    skyline_points_m,
    tolerance_errors_px,
)
from skyline.plugins import load
from skyline.progress import Progress
from skyline.skylines import HEADINGS, Views
from skyline.survey.plans import lattice_m
from skyline.terrain.heightfield import HeightField, ground_of
from skyline.terrain.viewpoints import Viewpoints, stand_on

_log = logging.getLogger(__name__)

_REACH_M = 300.0
"""Greatest extent of a tolerance area from its view."""

Render = Callable[[Viewpoints, UInt8Array], Views]
"""Renders N viewpoints along N headings; returns N views in the same order."""


@dataclass(frozen=True, slots=True)
class PlanConfig:
    """Settings of a plan.

    Raises `InputError` for an unknown planner, a coverage outside (0, 1], a threshold or a spacing
    that is not positive, and spacings that do not fit each other.
    """

    strategy: str = "lpov"
    """The name of a planner: an entry point of `skyline.paper.planners.PLANNERS`."""
    coarse_m: float = 1000.0
    """Distance between viewpoints of the coarse grid; a whole multiple of ``site_spacing_m``."""
    site_spacing_m: float = 50.0
    """Distance between sites; at most 300."""
    threshold_px: float = 3.0
    """A location is covered where the reprojection error of some view is at most this."""
    coverage: float = 0.98
    """Share of the sites to cover in each heading, in (0, 1]."""
    seed: int = 0
    """Seed of all random choices."""

    def __post_init__(self) -> None:
        load(PLANNERS, self.strategy)
        for name, value, unit, most in (
            ("coverage", self.coverage, "", 1.0),
            ("threshold", self.threshold_px, " px", np.inf),
            ("site spacing", self.site_spacing_m, " m", _REACH_M),
            ("coarse spacing", self.coarse_m, " m", np.inf),
        ):
            if not 0.0 < value <= most or np.isinf(value):
                limit = "" if np.isinf(most) else f", at most {most:g}{unit}"
                raise InputError(f"{name} is {value}{unit}; expected a number above 0{limit}")
        if abs(self.coarse_m / self.site_spacing_m - self.stride) > 1e-9 * self.stride:
            raise InputError(
                f"coarse spacing is {self.coarse_m} m, not a whole multiple of the site spacing of "
                f"{self.site_spacing_m} m; choose one that is, for example "
                f"{self.stride * self.site_spacing_m} m"
            )

    @property
    def stride(self) -> int:
        """Number of sites between neighbouring viewpoints of the coarse grid."""
        return max(1, round(self.coarse_m / self.site_spacing_m))

    def to_dict(self) -> dict[str, Any]:
        """Return the settings for the header of a store."""
        # The header's name for the spacing of sites is older than the name here.
        names = {"site_spacing_m": "candidate_m"}
        return {names.get(name, name): value for name, value in asdict(self).items()}


@dataclass(frozen=True, slots=True, eq=False)
class CoveragePlan:
    """The viewpoints that were chosen and rendered."""

    field: HeightField
    config: PlanConfig
    sites: Sites
    coverages: tuple[Coverage, ...]
    """One for each heading: its viewpoints and their tolerance areas."""
    views: Views
    """All renderings, in the order they were made."""
    batches: int
    """Rounds of rendering."""
    render_s: float
    """Seconds of rendering."""
    plan_s: float
    """Seconds of everything else."""

    @property
    def coverage(self) -> float:
        """Predicted share of the sites that is covered, over all headings."""
        return float(np.mean([one.fraction() for one in self.coverages]))

    @property
    def overlap(self) -> int:
        """Inclusions in tolerance areas minus covered sites, over all headings."""
        return sum(one.overlap for one in self.coverages)

    def viewpoints(self, chosen: Int64Array) -> Viewpoints:
        """Return viewpoints at sites (N)."""
        return _viewpoints(self.field, self.sites, chosen)


def plan(
    terrain: HeightField,
    render: Render,
    config: PlanConfig,
    bounds_m: Rectangle | None = None,
    progress: Progress | None = None,
) -> CoveragePlan:
    """Choose viewpoints and render them until the configured coverage is reached.

    The area is west, south, east, north, by default all of the terrain. Raises `InputError` for a
    spacing larger than the area, or an area wholly in holes.
    """
    started = time.perf_counter()
    sites = lay_out(terrain, config, bounds_m)
    coarse, squares = _coarse_grid(sites, config)
    headings = [_Heading(terrain, config, sites, squares, heading) for heading in HEADINGS]
    requests = [coarse for _ in headings]
    views: list[Views] = []
    render_s = 0.0
    while any(map(len, requests)):
        rendering = time.perf_counter()
        eyes = _viewpoints(terrain, sites, np.concatenate(requests))
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
    return CoveragePlan(terrain, config, sites, coverages, joined, len(views), render_s, plan_s)


class _Heading:
    """The views along one heading, with a planner for each square."""

    def __init__(
        self,
        field: HeightField,
        config: PlanConfig,
        sites: Sites,
        squares: Int64Array,
        heading: int,
    ) -> None:
        self.heading = heading
        self.coverage = Coverage(sites)
        self._field = field
        self._config = config
        self._points: list[Float64Array] = []
        self._width = 0
        self._planned: list[tuple[Problem, Iterator[Int64Array]]] = []
        planner: Planner = load(PLANNERS, config.strategy)
        for number, square in enumerate(np.unique(squares[sites.valid])):
            region = sites.valid & (squares == square)
            problem = Problem(self.coverage, region, config.coverage, self.projected_areas)
            generator = np.random.default_rng([config.seed, heading, number])
            self._planned.append((problem, planner(problem, generator)))

    def requests(self) -> Int64Array:
        """Return the sites that planners choose next; none at the end."""
        asked = [np.zeros(0, dtype=np.int64)]
        if self.coverage.fraction() < self._config.coverage:
            for problem, chosen in self._planned:
                some = next(chosen, None)
                if some is not None:
                    asked.append(self._checked(problem, some))
        return np.concatenate(asked)

    def _checked(self, problem: Problem, chosen: Int64Array) -> Int64Array:
        """Return the sites that a planner chose.

        Raises `InputError` unless they lie in the region.
        """
        given = np.asarray(chosen)
        if given.ndim != 1 or not np.isin(given, np.flatnonzero(problem.region)).all():
            raise InputError(
                f"planner {self._config.strategy!r} chose {chosen}; expected indices (n,) of "
                "sites in the problem's region"
            )
        return given.astype(np.int64, copy=False)

    def add(self, viewpoints: Int64Array, views: Views) -> None:
        """Add views (N) rendered at sites (N)."""
        points = skyline_points_m(views)
        self._width = views.width
        self._points.extend(points)
        self.coverage.add(viewpoints, self._areas(points, views))

    def projected_areas(self, chosen: Int64Array) -> BoolArray:
        """Return the tolerance areas (N, K, K) of sites without a rendering.

        Each has the skyline points of the nearest rendered view, moved by Equation 1.
        """
        coverage = self.coverage
        nearest, _ = coverage.sites.nearest(chosen, coverage.viewpoints, 1)
        source, there = (
            _viewpoints(self._field, coverage.sites, some)
            for some in (coverage.viewpoints[nearest[:, 0]], chosen)
        )
        move = displacements_m(
            source,
            np.full(len(chosen), self.heading),
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
            size=self.coverage.sites.window,
            spacing_m=self._config.site_spacing_m,
            width=self._width,
        )
        return np.asarray(errors <= self._config.threshold_px)


def lay_out(field: HeightField, config: PlanConfig, bounds_m: Rectangle | None = None) -> Sites:
    """Lay sites over an area, at whole multiples of their spacing.

    A site is valid where an eye can stand, off the holes and off the map's border. Raises
    `InputError` for a spacing larger than the area, or more than 20 million sites.
    """
    bounds_m = bounds_m or field.bounds_m
    west, south, east, north = bounds_m
    if config.coarse_m > max(east - west, north - south):
        raise InputError(
            f"spacing of {config.coarse_m:g} m is larger than the area of {east - west:.0f} x "
            f"{north - south:.0f} m; choose a smaller spacing or a larger area"
        )
    easting_m, northing_m = lattice_m(bounds_m, config.site_spacing_m, most=20_000_000)
    valid = _can_stand(field, *np.meshgrid(easting_m, northing_m))
    return Sites(valid, easting_m, northing_m, int(_REACH_M // config.site_spacing_m))


def _can_stand(field: HeightField, easting_m: Float64Array, northing_m: Float64Array) -> BoolArray:
    """Return where the surface is known up to a sample around."""
    ground_m = field.height_at(easting_m=easting_m, northing_m=northing_m)
    for east, north in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        ground_m = ground_m + field.height_at(
            easting_m=easting_m + east * field.spacing_east_m,
            northing_m=northing_m + north * field.spacing_north_m,
        )
    return ~np.isnan(ground_m)


def _coarse_grid(sites: Sites, config: PlanConfig) -> tuple[Int64Array, Int64Array]:
    """Return the valid sites of the coarse grid, and each site's square.

    Squares (rows, cols) are numbered from south to north, and in a row from west to east. Raises
    `InputError` where the coarse grid has no valid site.
    """
    row, col = (
        np.rint(axis / config.site_spacing_m).astype(np.int64)
        for axis in (sites.northing_m, sites.easting_m)
    )
    stride = config.stride
    coarse = (row[:, None] % stride == 0) & (col % stride == 0) & sites.valid
    if not coarse.any():
        raise InputError(
            f"no viewpoint of the {config.coarse_m:g} m grid falls on the surface in easting "
            f"{col[0] * config.site_spacing_m:.0f} to {col[-1] * config.site_spacing_m:.0f}, "
            f"northing {row[-1] * config.site_spacing_m:.0f} to "
            f"{row[0] * config.site_spacing_m:.0f}; choose a smaller spacing or a larger area"
        )
    return np.flatnonzero(coarse), (row // stride)[:, None] * len(col) + col // stride


def _viewpoints(field: HeightField, sites: Sites, chosen: Int64Array) -> Viewpoints:
    row, col = sites.row_col(chosen)
    return stand_on(field, easting_m=sites.easting_m[col], northing_m=sites.northing_m[row])
