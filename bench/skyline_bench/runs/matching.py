"""Matchers compared: how often, how far off and how fast they find synthetic queries in stores.

Stores are uniform grids, what the paper's planners choose (paper 5.2), or files that are there.
Stores and answers are kept, so that a comparison that was stopped goes on.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from skyline.build.cluster import Progress
from skyline.build.grid import map_bounds
from skyline.build.plans import PlacePlan
from skyline.errors import InputError
from skyline.geodesy import Bounds
from skyline.paper.planning.candidates import lay_out
from skyline.paper.planning.plan import PlanConfig
from skyline.pipeline.match import Matcher
from skyline.render.horizon import RenderConfig
from skyline.store.format import PLACES, RENDERINGS
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import unseen
from skyline_bench.measuring.workers import Crew, crew
from skyline_bench.queries.other_dems import perturbed, resampled
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, make_queries
from skyline_bench.runs.cost_summary import UNIFORM
from skyline_bench.stores.reference import (
    ReferenceStore,
    check_spacing,
    given_store,
    laid_out_store,
    planned_places,
    planned_store,
    uniform_renderings,
)
from skyline_bench.trials.kept import Kept, file_digest
from skyline_bench.trials.trials import (
    PAPER,
    WHAT,
    DistanceGroup,
    Trial,
    distance_groups,
    open_matcher,
    run_trials,
    searched_by,
    summarize,
)

Grid = tuple[str, float | None]
"""What a store holds, and its spacing in metres; None for places as they are planned by default."""

DEFAULT_AREA_M = (5_000.0, 10_000.0)
"""East by north, in the DEM's middle."""

PLAIN, WHITE, OTHER_DEM, OCCLUDED = "plain", "white", "other-dem", "occluded"
ALIGNED = "aligned"
KINDS: Mapping[str, str] = MappingProxyType(
    {
        PLAIN: "a tenth of the columns masked, 0.1 degrees of noise, half of it smooth",
        WHITE: "the same with noise drawn anew in each column",
        OTHER_DEM: "plain from a DEM of another spacing and phase, 10 m rms off",
        OCCLUDED: "plain with 30 % of the columns hidden, half of it unnoticed",
        ALIGNED: "level, 90 degrees, to grid north, east, south or west, 0.03 degrees of noise",
    }
)
"""Kinds of queries. Those of one number have one place in every kind, and one pose but where they
are aligned."""

_OTHER_SPACING, _OTHER_PHASE = 1.3, (0.37, 0.61)
_HIDDEN_SHARE = 0.3
_DEFAULT = "planned"
"""The planner of a store as `skyline build` makes it by default."""
_GIVEN = "given"
"""The planner of a store that was there already."""
_COARSE_M = 512.0
_QUICK_M = 3000.0


@dataclass(frozen=True, slots=True)
class MatchingConfig:
    """What is compared."""

    # West, south, east, north of the area; by default 5 x 10 km in the DEM's middle.
    bounds_deg: Bounds | None = None
    # Of the uniform stores of renderings, built where a matcher searches such.
    spacings_m: tuple[float, ...] = (1024.0, 512.0, 256.0, 128.0)
    # Of the uniform stores of places, likewise; None for places as they are planned by default.
    place_spacings_m: tuple[float | None, ...] = (None, 160.0, 120.0, 80.0, 60.0, 40.0)
    # What the paper's planners are asked for: a store of the renderings of each, and one of whole
    # places at their eyes, likewise.
    plans: tuple[PlanConfig, ...] = ()
    stores: tuple[Path, ...] = ()  # Stores that are there already, measured after the others
    # Names of `skyline_bench.trials.trials.WHAT`; each is run on the stores it can search.
    matchers: tuple[str, ...] = tuple(WHAT)
    kinds: tuple[str, ...] = tuple(KINDS)  # Names of `KINDS`
    queries: int = 300  # Of each kind
    # Whether queries are told apart by how far their skyline is; takes three at least.
    grouped: bool = False
    seed: int = 0  # Of the queries and the intervals
    top: int = 5  # Candidates asked for; the first one counts
    # Processes at work, each with one thread; by default this process with all of them.
    workers: int | None = None

    def __post_init__(self) -> None:
        for name, value, least in (
            ("the number of queries", self.queries, 3 if self.grouped else 1),
            ("seed", self.seed, 0),
            ("workers", 1 if self.workers is None else self.workers, 1),
        ):
            if value < least:
                raise InputError(f"{name} is {value}; expected {least} or more")
        for name in ("spacings_m", "place_spacings_m", "plans", "matchers", "kinds"):
            # Asked for twice is asked for once: two processes must not build the same store.
            object.__setattr__(self, name, tuple(dict.fromkeys(getattr(self, name))))
        known = {"matcher": (self.matchers, WHAT), "kind of queries": (self.kinds, KINDS)}
        for what, (names, these) in known.items():
            for name in names:
                if name not in these:
                    raise InputError(f"{what} is {name!r}; expected one of {', '.join(these)}")
        if not (self.grids() or self.plans or self.stores):
            raise InputError("there is no store to match; give a spacing or a store")

    def searched(self) -> set[str]:
        """Return what the matchers search: places, renderings or both."""
        return {searched_by(name) for name in self.matchers}

    def grids(self) -> list[Grid]:
        """Return the stores of grids, and of planned places, that a matcher searches."""
        grids: list[Grid] = [(RENDERINGS, spacing_m) for spacing_m in self.spacings_m]
        grids += [(PLACES, spacing_m) for spacing_m in self.place_spacings_m]
        return [grid for grid in grids if grid[0] in self.searched()]

    def quick(self, terrain: HeightField) -> "MatchingConfig":
        """Return a version that takes a minute or two: few queries, no fine grids.

        With planners, the area is its middle, and the threshold the greatest one.
        """
        coarse = tuple(one for one in self.spacings_m if one >= _COARSE_M)
        coarse = coarse or self.spacings_m[:1]
        places = tuple(one for one in self.place_spacings_m if one is None or one >= _COARSE_M)
        places = places or self.place_spacings_m[:1]
        queries = min(self.queries, 12 if self.plans else 20)
        small = replace(self, queries=queries, spacings_m=coarse, place_spacings_m=places)
        if not self.plans:
            return small
        bounds_deg = self.bounds_deg or middle_deg(terrain)
        west, south, east, north = map_bounds(terrain, bounds_deg)
        size_m = min(east - west, _QUICK_M), min(north - south, _QUICK_M)
        greatest_px = max(plan.threshold_px for plan in self.plans)
        plans = tuple(replace(plan, threshold_px=greatest_px) for plan in self.plans)
        return replace(small, bounds_deg=middle_deg(terrain, size_m, bounds_deg), plans=plans)


def middle_deg(
    terrain: HeightField,
    size_m: tuple[float, float] = DEFAULT_AREA_M,
    bounds_deg: Bounds | None = None,
) -> Bounds:
    """Return the middle of bounds, by default of the DEM: so far east and north at most."""
    west, south, east, north = map_bounds(terrain, bounds_deg)
    half_east, half_north = min(size_m[0], east - west) / 2.0, min(size_m[1], north - south) / 2.0
    middle = np.array([(west + east) / 2.0, (south + north) / 2.0])
    ends = [[-half_east, half_east, 0.0, 0.0], [0.0, 0.0, -half_north, half_north]]
    lon, lat = terrain.frame.to_lonlat(*(middle[:, np.newaxis] + ends))
    return float(lon[0]), float(lat[2]), float(lon[1]), float(lat[3])


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """What every worker holds."""

    terrain: HeightField
    config: MatchingConfig
    bounds_deg: Bounds
    queries: Mapping[str, Sequence[SyntheticQuery]]
    miss_m: float
    folder: Path


_Planned = tuple[str, ReferenceStore]
"""A store, and what chose its viewpoints."""
_Job = tuple[ReferenceStore, str]
"""A store, and a matcher that searches it."""


def check(terrain: HeightField, config: MatchingConfig) -> Bounds:
    """Return the bounds of the area, if everything asked for fits into it."""
    bounds_deg = config.bounds_deg or middle_deg(terrain)
    area = map_bounds(terrain, bounds_deg)
    for _, spacing_m in config.grids():
        check_spacing(terrain, spacing_m, bounds_deg)
    for plan in config.plans:
        lay_out(terrain, plan.spacing, area)
    for store in (given_store(terrain, path) for path in config.stores):
        if store.holds not in config.searched():
            raise InputError(
                f"{store.path} holds {store.holds}, which none of {', '.join(config.matchers)} "
                "searches; name another matcher"
            )
    return bounds_deg


def measure(
    terrain: HeightField, config: MatchingConfig, folder: Path, progress: Progress = unseen
) -> tuple[list[Row], tuple[DistanceGroup, ...]]:
    """Match the same queries to every store with every matcher that can search it.

    The stores and the plain queries are rendered from the terrain. Stores and trials are kept in a
    folder: what is there already is not done again. Progress is of stores and matchers.

    Return a row for each store, matcher, kind and group, and the groups, none where they were not
    asked for. Position errors are those of the best candidate, whether or not the matcher stands by
    it; a query without any counts as wrong by half of the area's diagonal. Heading errors are those
    of the right answers.
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
            progress(len(stores) + len(found), len(stores) + len(jobs))
    rows: list[Row] = [
        {
            "store": store.name,
            "planner": planner,
            "matcher": name,
            "queries": kind,
            **_figures(trials, group, config.seed),
            "renderings": store.renderings,
            "places": store.places,
            "bytes": store.size_bytes,
            "build_s": store.build_s,
            "build_cpu_s": store.build_cpu_s,
        }
        for planner, store, name in pairs
        for kind, trials in found[store, name].items()
        for group in groups or (None,)
    ]
    return rows, groups


def _figures(trials: Sequence[Trial], group: DistanceGroup | None, seed: int) -> Row:
    """Return what a group of trials comes to, by default all."""
    if group is None:
        return summarize(trials, seed)
    told = {"group": group.name, "group_from_m": group.from_m, "group_to_m": group.to_m}
    return told | summarize([trials[index] for index in group.queries], seed)


@contextmanager
def _at_work(bench: _Bench) -> Iterator[Crew]:
    """Give what does jobs: this process, or so many of its own."""
    if bench.config.workers is not None:
        with crew(bench, bench.config.workers) as run:
            yield run
        return
    yield lambda work, items: ((item, work(bench, item)) for item in items)


def _stores(bench: _Bench, run: Crew, progress: Progress) -> list[_Planned]:
    """Build what is asked for, the planned first, since they take longest; return all in order."""
    asked: list[Grid | PlanConfig] = [*bench.config.grids(), *bench.config.plans]
    built: dict[Grid | PlanConfig, list[_Planned]] = {}
    for one, stores in run(_build, sorted(asked, key=lambda one: isinstance(one, tuple))):
        built[one] = stores
        progress(len(built), len(asked))
    given = [(_GIVEN, given_store(bench.terrain, path)) for path in bench.config.stores]
    return [store for one in asked for store in built[one]] + given


def _build(bench: _Bench, asked: Grid | PlanConfig) -> list[_Planned]:
    """Build the stores of one grid or plan that a matcher searches."""
    where = bench.terrain, bench.folder
    if not isinstance(asked, PlanConfig):
        holds, spacing_m = asked
        if holds == PLACES:
            store = laid_out_store(*where, PlacePlan(spacing_m, bench.bounds_deg))
        else:
            store = uniform_renderings(*where, spacing_m or 0.0, bench.bounds_deg)
        return [(_DEFAULT if spacing_m is None else UNIFORM, store)]
    planned = planned_store(*where, asked, bench.bounds_deg, RenderConfig())
    stores = [planned]
    if PLACES in bench.config.searched():
        stores.append(planned_places(*where, planned))
    return [(asked.strategy, store) for store in stores]


def _match(bench: _Bench, job: _Job) -> dict[str, tuple[Trial, ...]]:
    """Return a job's trials by kind of queries: those kept, and new ones, which are kept then."""
    store, name = job
    config, digest = bench.config, file_digest(store.path)
    found: dict[str, tuple[Trial, ...]] = {}
    with ExitStack() as held:
        matcher: Matcher | None = None
        for kind, queries in bench.queries.items():
            asked = [kind, config.seed, asdict(QueryConfig()), name, config.top]
            depends = [bench.terrain.digest, digest, bench.bounds_deg, asked]
            kept = Kept(bench.folder / "trials" / f"{store.name}.{name}.{kind}", depends, Trial)
            keys = [str(index) for index in range(len(queries))]
            missing = [index for index, key in enumerate(keys) if key not in kept.found]
            if missing:
                matcher = matcher or held.enter_context(
                    open_matcher(name, store.path, bench.terrain)
                )
                some = [queries[index] for index in missing]
                trials = run_trials(matcher, some, bench.miss_m, config.top)
                for index, trial in zip(missing, trials, strict=True):
                    kept.keep(keys[index], trial)
            found[kind] = tuple(kept.found[key] for key in keys)
    return found


def _queries(
    terrain: HeightField, config: MatchingConfig, bounds_deg: Bounds, kind: str
) -> Sequence[SyntheticQuery]:
    seen, query = terrain, QueryConfig()
    if kind == OTHER_DEM:
        other = resampled(terrain, _OTHER_SPACING * terrain.spacing_m, _OTHER_PHASE)
        seen = perturbed(other, seed=config.seed)
    elif kind == WHITE:
        query = replace(query, smooth_share=0.0)
    elif kind == OCCLUDED:
        query = replace(query, occluded_share=(_HIDDEN_SHARE, _HIDDEN_SHARE))
    elif kind == ALIGNED:
        query = QueryConfig(
            fov_deg=(90.0, 90.0),
            fov_error=0.0,
            max_tilt_deg=0.0,
            is_aligned=True,
            noise_deg=(0.03, 0.03),
            masked_share=0.0,
        )
    return make_queries(seen, map_bounds(terrain, bounds_deg), config.queries, config.seed, query)
