"""Matchers compared: how often, how far off and how fast they find synthetic queries in stores.

Stores are uniform grids, what the paper's planners choose (paper 5.2), or files that are there.
Stores and answers are kept, so that a comparison that was stopped goes on.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from skyline import __version__
from skyline.errors import InputError
from skyline.paper.planning.budget import check_coarse, spaced_for
from skyline.paper.planning.candidates import lay_out
from skyline.paper.planning.plan import PlanConfig
from skyline.pipeline.config import PlaceConfig, RenderConfig
from skyline.pipeline.jobs import Progress
from skyline.pipeline.match import Matcher
from skyline.planning.uniform import map_bounds
from skyline.store.header import PLACES
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.digests import file_digest
from skyline_bench.measuring.workers import Crew, crew
from skyline_bench.queries.other_dems import perturbed, resampled
from skyline_bench.queries.synthetic import SyntheticQuery, make_queries
from skyline_bench.runs.cost_summary import UNIFORM
from skyline_bench.runs.matching import (
    OCCLUDED,
    OTHER_DEM,
    WHITE,
    BoundsDeg,
    Grid,
    MatchingConfig,
    middle_deg,
)
from skyline_bench.stores.reference import (
    ReferenceStore,
    check_spacing,
    given_store,
    place_store,
    planned_places,
    planned_store,
    uniform_store,
)
from skyline_bench.trials.distance_groups import DistanceGroup, distance_groups
from skyline_bench.trials.kept import Key, kept_trials, measured_code_digest, save_trials
from skyline_bench.trials.matchers import PAPER, open_matcher, searched_by
from skyline_bench.trials.trials import Trial, run_trials, summarize

_OTHER_SPACING, _OTHER_PHASE = 1.3, (0.37, 0.61)
_HIDDEN_SHARE = 0.3
_DEFAULT = "planned"
"""The planner of a store as `skyline build` makes it by default."""
_GIVEN = "given"
"""The planner of a store that was there already."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One matcher's trials of one kind of queries on one store.

    Attributes
    ----------
    planner : str
        What chose the store's viewpoints.
    store : ReferenceStore
    matcher, kind : str
    trials : tuple of Trial
        In the order of the queries.
    """

    planner: str
    store: ReferenceStore
    matcher: str
    kind: str
    trials: tuple[Trial, ...]

    def row(self, seed: int, group: DistanceGroup | None = None) -> dict[str, object]:
        """Return the table's row of a group: what was compared, `summarize`, and costs."""
        trials: Sequence[Trial] = self.trials
        row: dict[str, object] = {
            "store": self.store.name,
            "planner": self.planner,
            "matcher": self.matcher,
            "queries": self.kind,
        }
        if group is not None:
            trials = [self.trials[index] for index in group.queries]
            row |= {"group": group.name, "group_from_m": group.from_m, "group_to_m": group.to_m}
        return {
            **row,
            **summarize(trials, seed),
            "renderings": self.store.renderings,
            "places": self.store.places,
            "bytes": self.store.size_bytes,
            "build_s": self.store.build_s,
            "build_cpu_s": self.store.build_cpu_s,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """The whole comparison.

    Attributes
    ----------
    groups : tuple of DistanceGroup
        Close, medium, far and all; none where they were not asked for.
    comparisons : tuple of Comparison
        By store, then matcher, then kind.
    seed : int
    """

    groups: tuple[DistanceGroup, ...]
    comparisons: tuple[Comparison, ...]
    seed: int

    def rows(self) -> list[dict[str, object]]:
        """Return the table: a row for each store, matcher, kind and group."""
        groups = self.groups or (None,)
        return [one.row(self.seed, group) for one in self.comparisons for group in groups]


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """What every worker holds."""

    terrain: HeightField
    config: MatchingConfig
    bounds_deg: BoundsDeg
    queries: Mapping[str, Sequence[SyntheticQuery]]
    miss_m: float
    folder: Path


_Planned = tuple[str, ReferenceStore]
"""A store, and what chose its viewpoints."""
_Job = tuple[ReferenceStore, str]
"""A store, and a matcher that searches it."""


def check(terrain: HeightField, config: MatchingConfig) -> BoundsDeg:
    """Return the bounds of the area, if everything asked for fits into it.

    Raises
    ------
    InputError
        Bounds outside the DEM, an area too small for a spacing, a budget that is too small to
        begin with, or a store for no matcher.
    """
    bounds_deg = config.bounds_deg or middle_deg(terrain)
    area = map_bounds(terrain, bounds_deg)
    for _, spacing_m in config.grids():
        check_spacing(terrain, spacing_m, bounds_deg)
    for plan in config.plans:
        spacing = plan.spacing
        if plan.budget is not None:
            spacing = spaced_for(spacing, plan.budget, area)
        check_coarse(lay_out(terrain, spacing, area, plan.eye_height_m), plan.budget)
    for store in (given_store(terrain, path) for path in config.stores):
        if store.holds not in config.searched():
            raise InputError(
                f"{store.path} holds {store.holds}, which none of {', '.join(config.matchers)} "
                "searches; name another matcher"
            )
    return bounds_deg


def measure(
    terrain: HeightField,
    config: MatchingConfig,
    folder: Path,
    progress: Progress | None = None,
) -> Compared:
    """Match the same queries to every store with every matcher that can search it.

    Parameters
    ----------
    terrain : HeightField
        What the stores are rendered from, and the plain queries.
    config : MatchingConfig
    folder : Path
        Where stores and trials are kept: what is there already is not done again.
    progress : callable, optional
        Called with stores and matchers done and to do.

    Returns
    -------
    Compared
        Position errors are those of the best candidate, whether or not the matcher stands by it; a
        query without any counts as wrong by half of the area's diagonal. Heading errors are those
        of the right answers.

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
    west, south, east, north = map_bounds(terrain, bounds_deg)
    queries = {kind: _queries(terrain, config, bounds_deg, kind) for kind in config.kinds}
    first = next(iter(queries.values()))
    groups = distance_groups([one.distance_m for one in first]) if config.grouped else ()
    miss_m = float(np.hypot(east - west, north - south)) / 2.0
    bench = _Bench(terrain, config, bounds_deg, queries, miss_m, folder)
    with _at_work(bench) as run:
        stores = _stores(bench, run, progress)
        pairs = [
            (planner, store, name)
            for planner, store in stores
            for name in config.matchers
            if searched_by(name) == store.holds
        ]
        # What takes longest is begun first.
        jobs = sorted(
            ((store, name) for _, store, name in pairs),
            key=lambda job: (job[1] != PAPER, -job[0].renderings),
        )
        found = {}
        for job, trials in run(_match, jobs):
            found[job] = trials
            if progress:
                progress(len(stores) + len(found), len(stores) + len(jobs))
    comparisons = tuple(
        Comparison(planner, store, name, kind, trials)
        for planner, store, name in pairs
        for kind, trials in found[store, name].items()
    )
    return Compared(groups, comparisons, config.seed)


@contextmanager
def _at_work(bench: _Bench) -> Iterator[Crew]:
    """Give what does jobs: this process, or so many of its own."""
    if bench.config.workers is not None:
        with crew(bench, bench.config.workers) as run:
            yield run
        return
    yield lambda work, items: ((item, work(bench, item)) for item in items)


def _stores(bench: _Bench, run: Crew, progress: Progress | None) -> list[_Planned]:
    """Build what is asked for, the planned first, since they take longest; return all in order."""
    asked: list[Grid | PlanConfig] = [*bench.config.grids(), *bench.config.plans]
    built: dict[Grid | PlanConfig, list[_Planned]] = {}
    for one, stores in run(_build, sorted(asked, key=lambda one: isinstance(one, tuple))):
        built[one] = stores
        if progress:
            progress(len(built), len(asked))
    given = [(_GIVEN, given_store(bench.terrain, path)) for path in bench.config.stores]
    return [store for one in asked for store in built[one]] + given


def _build(bench: _Bench, asked: Grid | PlanConfig) -> list[_Planned]:
    """Build the stores of one grid or plan that a matcher searches."""
    where = bench.terrain, bench.folder
    if not isinstance(asked, PlanConfig):
        holds, spacing_m = asked
        if holds == PLACES or spacing_m is None:
            store = place_store(*where, spacing_m, bench.bounds_deg, PlaceConfig())
        else:
            store = uniform_store(*where, spacing_m, bench.bounds_deg, RenderConfig())
        return [(_DEFAULT if spacing_m is None else UNIFORM, store)]
    planned = planned_store(*where, asked, bench.bounds_deg, RenderConfig())
    stores = [planned]
    if PLACES in bench.config.searched():
        stores.append(planned_places(*where, planned))
    return [(asked.strategy, store) for store in stores]


def _match(bench: _Bench, job: _Job) -> dict[str, tuple[Trial, ...]]:
    """Return a job's trials by kind of queries: those kept, or new ones, which are kept then."""
    store, name = job
    found: dict[str, tuple[Trial, ...]] = {}
    with ExitStack() as held:
        matcher: Matcher | None = None
        for kind, queries in bench.queries.items():
            key, file = _key(bench, store, name, kind)
            trials = kept_trials(file, key, queries)
            if trials is None:
                if matcher is None:
                    matcher = held.enter_context(open_matcher(name, store.path, bench.terrain))
                trials = list(run_trials(matcher, queries, bench.miss_m, bench.config.top))
                save_trials(file, key, trials)
            found[kind] = tuple(trials)
    return found


def _key(bench: _Bench, store: ReferenceStore, matcher: str, kind: str) -> tuple[Key, Path]:
    """Return what a job's trials depend on, and where they are kept."""
    config = bench.config
    key: Key = {
        "package_version": __version__,
        "code": measured_code_digest(),
        "dem": bench.terrain.digest,
        "store": file_digest(store.path),
        "bounds_deg": bench.bounds_deg,
        "queries": [kind, config.queries, config.seed, asdict(config.query)],
        "matcher": [matcher, config.top],
    }
    return key, bench.folder / "trials" / f"{store.name}.{matcher}.{kind}.json"


def _queries(
    terrain: HeightField, config: MatchingConfig, bounds_deg: BoundsDeg, kind: str
) -> Sequence[SyntheticQuery]:
    seen, query = terrain, config.query
    if kind == OTHER_DEM:
        other = resampled(terrain, _OTHER_SPACING * terrain.spacing_m, _OTHER_PHASE)
        seen = perturbed(other, seed=config.seed)
    elif kind == WHITE:
        query = replace(query, smooth_share=0.0)
    elif kind == OCCLUDED:
        query = replace(query, occluded_share=(_HIDDEN_SHARE, _HIDDEN_SHARE))
    return make_queries(seen, map_bounds(terrain, bounds_deg), config.queries, config.seed, query)
