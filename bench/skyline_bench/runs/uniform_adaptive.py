"""Uniform against adaptive stores: which accuracy renderings, bytes and time buy (paper 5.2)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from skyline import __version__
from skyline.errors import InputError
from skyline.paper.planning.budget import check_coarse, spaced_for
from skyline.paper.planning.candidates import Spacing, lay_out
from skyline.paper.planning.plan import PlanConfig
from skyline.pipeline import FULL, PlaceConfig, Progress, RenderConfig
from skyline.planning.uniform import MapBounds, map_bounds
from skyline.store.header import PLACES, RENDERINGS
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.digests import file_digest
from skyline_bench.measuring.timing import core_count
from skyline_bench.measuring.workers import Crew, crew
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, make_queries
from skyline_bench.runs.cost_summary import UNIFORM
from skyline_bench.runs.matching import BoundsDeg, middle_deg
from skyline_bench.stores.reference import (
    ReferenceStore,
    check_spacing,
    place_store,
    planned_places,
    planned_store,
    uniform_store,
)
from skyline_bench.trials.distance_groups import DistanceGroup, distance_groups
from skyline_bench.trials.kept import (
    Key,
    kept_trials,
    measured_code_digest,
    save_trials,
)
from skyline_bench.trials.matchers import (
    PAPER,
    RETRIEVED,
    check_matchers,
    open_matcher,
    searched_by,
)
from skyline_bench.trials.trials import Trial, run_trials, summarize

_TOP = 1
"""Candidates asked for: the best is what counts."""
_QUICK_QUERIES = 12
_QUICK_M = 3000.0


@dataclass(frozen=True, slots=True)
class AdaptiveConfig:
    """What is compared.

    Attributes
    ----------
    bounds_deg : (float, float, float, float), optional
        West, south, east, north of the area; by default 5 x 10 km in the DEM's middle.
    spacings_m : tuple of float
        Of the uniform stores.
    strategies : tuple of str
        Planners of the adaptive stores.
    budgets : tuple of int
        Renderings each of them may make: a store for each.
    spacing : Spacing
        Of the viewpoints that a planner chooses from.
    matchers : tuple of str
        Names of `skyline_bench.trials.matchers.WHAT`.
    queries : int
        At least 3: one a group.
    seed : int
        Of the queries, the plans and the intervals.
    workers : int
        Processes at work; makes no difference but to the time.
    query : QueryConfig
    """

    bounds_deg: BoundsDeg | None = None
    spacings_m: tuple[float, ...] = (1024.0, 512.0, 256.0, 128.0)
    strategies: tuple[str, ...] = ("lpov",)
    budgets: tuple[int, ...] = (800, 1600, 2800)
    spacing: Spacing = field(default_factory=Spacing)
    matchers: tuple[str, ...] = (PAPER, RETRIEVED, FULL)
    queries: int = 300
    seed: int = 0
    workers: int = field(default_factory=core_count)
    query: QueryConfig = field(default_factory=QueryConfig)

    def __post_init__(self) -> None:
        if self.queries < 3:
            raise InputError(
                f"the number of queries is {self.queries}; expected at least 3, one for each "
                "group of distances"
            )
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; expected 0 or more")
        if not all((self.spacings_m, self.strategies, self.budgets, self.matchers)):
            raise InputError(
                "nothing to compare; give a spacing, a strategy, a budget and a matcher"
            )
        for name in ("spacings_m", "strategies", "budgets", "matchers"):
            # Asked for twice is asked for once: two processes must not build the same store.
            object.__setattr__(self, name, tuple(dict.fromkeys(getattr(self, name))))
        check_matchers(self.matchers)
        if self.workers < 1:
            raise InputError(f"workers is {self.workers}; expected 1 or more")

    def quick(self, terrain: HeightField) -> "AdaptiveConfig":
        """Return a version that takes a minute or two: few queries in the area's middle.

        There are no fine grids, and the least budget, by as much as the area is smaller.
        """
        west, south, east, north = map_bounds(terrain, self.bounds_deg or middle_deg(terrain))
        width_m, height_m = (min(side, _QUICK_M) for side in (east - west, north - south))
        share = width_m * height_m / ((east - west) * (north - south))
        coarse = tuple(spacing for spacing in self.spacings_m if spacing >= 512.0)
        return replace(
            self,
            bounds_deg=middle_deg(
                terrain, (width_m, height_m), self.bounds_deg or middle_deg(terrain)
            ),
            queries=min(self.queries, _QUICK_QUERIES),
            spacings_m=coarse or self.spacings_m[:1],
            budgets=(math.ceil(share * min(self.budgets)),),
        )

    def plans(self) -> list[PlanConfig]:
        """Return what the planners are asked for, by strategy, then budget."""
        return [
            PlanConfig(strategy, self.spacing, seed=self.seed, budget=budget)
            for strategy in self.strategies
            for budget in sorted(self.budgets)
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """One matcher's trials on one store.

    Attributes
    ----------
    planner : str
        What chose the store's viewpoints.
    store : ReferenceStore
    matcher : str
    trials : tuple of Trial
        In the order of the queries.
    """

    planner: str
    store: ReferenceStore
    matcher: str
    trials: tuple[Trial, ...]

    def row(self, group: DistanceGroup, seed: int) -> dict[str, object]:
        """Return the table's row of a group."""
        store = self.store
        return {
            "store": store.name,
            "planner": self.planner,
            "matcher": self.matcher,
            "group": group.name,
            "group_from_m": group.from_m,
            "group_to_m": group.to_m,
            **summarize([self.trials[index] for index in group.queries], seed),
            "renderings": store.renderings,
            "bytes": store.size_bytes,
            "build_s": store.build_s,
            "build_cpu_s": store.build_cpu_s,
        }


@dataclass(frozen=True, slots=True, eq=False)
class UniformAdaptive:
    """The whole comparison.

    Attributes
    ----------
    groups : tuple of DistanceGroup
        Close, medium, far and all.
    measured : tuple of Measured
        By store, then matcher.
    seed : int
    """

    groups: tuple[DistanceGroup, ...]
    measured: tuple[Measured, ...]
    seed: int

    def rows(self) -> list[dict[str, object]]:
        """Return the table: a row for each store, matcher and group."""
        return [one.row(group, self.seed) for one in self.measured for group in self.groups]


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """What every worker holds."""

    terrain: HeightField
    bounds_deg: BoundsDeg
    queries: tuple[SyntheticQuery, ...]
    miss_m: float
    holds: frozenset[str]
    folder: Path


@dataclass(frozen=True, slots=True)
class _Job:
    """A matcher on one store, and where its trials are kept."""

    store: ReferenceStore
    matcher: str
    key: Key
    file: Path


def check(terrain: HeightField, config: AdaptiveConfig) -> BoundsDeg:
    """Return the bounds of the area, if everything asked for fits into it.

    Raises
    ------
    InputError
        Bounds outside the DEM, an area too small for a spacing, an unknown strategy, or a budget
        that is too small to begin with.
    """
    bounds_deg = config.bounds_deg or middle_deg(terrain)
    for spacing_m in config.spacings_m:
        check_spacing(terrain, spacing_m, bounds_deg)
    area = map_bounds(terrain, bounds_deg)
    for planned in config.plans():
        spacing = _spacing(planned, area)
        check_coarse(lay_out(terrain, spacing, area, planned.eye_height_m), planned.budget)
    return bounds_deg


def _spacing(planned: PlanConfig, area: MapBounds) -> Spacing:
    """Return the distances that a plan's budget makes of those asked for."""
    return (
        planned.spacing
        if planned.budget is None
        else spaced_for(planned.spacing, planned.budget, area)
    )


def measure(
    terrain: HeightField,
    config: AdaptiveConfig,
    folder: Path,
    progress: Progress | None = None,
) -> UniformAdaptive:
    """Match the same queries to uniform and to adaptive stores, with every matcher.

    Parameters
    ----------
    terrain : HeightField
        What the stores are rendered from, and the queries.
    config : AdaptiveConfig
    folder : Path
        Where stores and trials are kept: what is there already is not done again.
    progress : callable, optional
        Called with stores and matchers done and to do.

    Returns
    -------
    UniformAdaptive
        Position errors are those of the best candidate, whether or not the matcher stands by it;
        a query without any counts as wrong by half of the area's diagonal.

    Raises
    ------
    InputError
        As `check`.
    StoreMismatchError
        The folder has a store of another DEM, area or configuration.
    BuildError
        A worker died.
    """
    bounds_deg = check(terrain, config)
    west, south, east, north = area = map_bounds(terrain, bounds_deg)
    queries = make_queries(terrain, area, config.queries, config.seed, config.query)
    groups = distance_groups([query.distance_m for query in queries])
    miss_m = float(np.hypot(east - west, north - south)) / 2.0
    holds = frozenset(searched_by(name) for name in config.matchers)
    bench = _Bench(terrain, bounds_deg, queries, miss_m, holds, folder)
    asked: list[float | PlanConfig] = [*config.spacings_m, *config.plans()]
    count = _Counter(progress, len(asked) * (1 + len(config.matchers)))
    with crew(bench, config.workers) as run:
        stores = _stores(run, asked, count)
        jobs = [
            _job(bench, config, stores[index][searched_by(name)], name)
            for name in sorted(config.matchers, key=lambda name: name != PAPER)
            for index in sorted(range(len(asked)), key=lambda i: -_renderings(stores[i]))
        ]
        found: dict[tuple[str, str], tuple[Trial, ...]] = {}
        for job, trials in run(_match, jobs):
            count()
            found[job.store.name, job.matcher] = trials
    measured = tuple(
        Measured(_planner(one), store, name, found[store.name, name])
        for one, held in zip(asked, stores, strict=True)
        for name in config.matchers
        for store in (held[searched_by(name)],)
    )
    return UniformAdaptive(groups, measured, config.seed)


class _Counter:
    """Tells a progress how many parts are done."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._done, self._total = progress, -1, total
        self()

    def __call__(self) -> None:
        self._done += 1
        if self._progress:
            self._progress(self._done, self._total)


def _planner(asked: float | PlanConfig) -> str:
    return asked.strategy if isinstance(asked, PlanConfig) else UNIFORM


def _stores(
    run: Crew, asked: Sequence[float | PlanConfig], count: _Counter
) -> list[Mapping[str, ReferenceStore]]:
    """Build the stores, the planned ones first, since they take longest.

    Returns them in order, each by what it holds.
    """
    built = {}
    for one, store in run(_build, sorted(asked, key=lambda one: not isinstance(one, PlanConfig))):
        count()
        built[one] = store
    return [built[one] for one in asked]


def _renderings(stores: Mapping[str, ReferenceStore]) -> int:
    return max(store.renderings for store in stores.values())


def _build(bench: _Bench, asked: float | PlanConfig) -> dict[str, ReferenceStore]:
    """Build the stores of one grid or plan that a matcher searches."""
    where = bench.terrain, bench.folder
    if isinstance(asked, PlanConfig):
        planned = planned_store(*where, asked, bench.bounds_deg, RenderConfig())
        stores = {RENDERINGS: planned}
        if PLACES in bench.holds:
            stores[PLACES] = planned_places(*where, planned)
        return stores
    name, stores = f"{UNIFORM}-{asked:g}", {}
    if RENDERINGS in bench.holds:
        stores[RENDERINGS] = uniform_store(*where, asked, bench.bounds_deg, RenderConfig())
    if PLACES in bench.holds:
        stores[PLACES] = place_store(*where, asked, bench.bounds_deg, PlaceConfig())
    return {held: replace(store, name=name) for held, store in stores.items()}


def _job(bench: _Bench, config: AdaptiveConfig, store: ReferenceStore, matcher: str) -> _Job:
    key: Key = {
        "package_version": __version__,
        "code": measured_code_digest(),
        "dem": bench.terrain.digest,
        "store": file_digest(store.path),
        "bounds_deg": bench.bounds_deg,
        "queries": config.queries,
        "seed": config.seed,
        "query": asdict(config.query),
        "matcher": matcher,
    }
    return _Job(store, matcher, key, bench.folder / "trials" / f"{store.name}.{matcher}.json")


def _match(bench: _Bench, job: _Job) -> tuple[Trial, ...]:
    """Return the trials of a job: those kept, or new ones, which are kept then."""
    trials = kept_trials(job.file, job.key, bench.queries)
    if trials is None:
        with open_matcher(job.matcher, job.store.path, bench.terrain) as matcher:
            trials = list(run_trials(matcher, bench.queries, bench.miss_m, _TOP))
        save_trials(job.file, job.key, trials)
    return tuple(trials)
