"""Size measured: one store of places, searched in squares that grow to all of it.

Each synthetic query is looked for in squares that hold its place anywhere, so that the same queries
tell what a larger area costs and how much of the accuracy it takes. Results are kept after each
search, so that a run that was killed goes on.
"""

import logging
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from skyline.build.cluster import Progress
from skyline.build.grid import map_bounds
from skyline.build.plans import DEFAULT_LOSS, PlacePlan
from skyline.errors import InputError
from skyline.geodesy import Bounds, Frame, Rectangle
from skyline.matching.narrowing import Narrowed, Narrowing
from skyline.pipeline.match import Matcher
from skyline.pipeline.rendered_scene import RenderedScene
from skyline.store import open_store
from skyline.terrain.heightfield import HeightField, ground_of
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import own_bytes, peak_bytes, reset_peak, unseen
from skyline_bench.queries.synthetic import QueryConfig, Truth, make_queries
from skyline_bench.runs.matching import middle_deg
from skyline_bench.stores.reference import (
    check_spacing,
    given_store,
    laid_out_store,
    mapped_area_m,
)
from skyline_bench.trials.kept import Kept
from skyline_bench.trials.traced import STAGES, Outcome, Traced
from skyline_bench.trials.trials import MATCHING, accuracy

_log = logging.getLogger(__name__)

GROUPS = {
    "all": (-math.inf, math.inf),
    "< 1 km": (-math.inf, 1000.0),
    "1-5 km": (1000.0, 5000.0),
    "> 5 km": (5000.0, math.inf),
}
"""Queries by the distance of their skyline, metres."""
WHOLE = "all"
"""The name of the search of everything."""
_KILOMETRE_M = 1000.0
_NOWHERE_M = 20_000.0
"""The error of a query without a candidate, and of one that is farther off."""
_QUICK_QUERIES, _QUICK_KM2 = 5, 10.0


@dataclass(frozen=True, slots=True)
class ScaleConfig:
    """What is measured."""

    # Of a uniform store of places that is built; by default they are planned.
    spacing_m: float | None = None
    loss: float = DEFAULT_LOSS  # What they are planned for
    # West, south, east, north of what is built; by default all of the DEM.
    bounds_deg: Bounds | None = None
    store: Path | None = None  # A store of places that is there already, instead
    # Squares that are searched; all of the store is searched as well.
    areas_km2: tuple[float, ...] = (50.0, 1000.0, 10_000.0)
    near_km: tuple[float, ...] = (30.0,)  # Radii of circles that are searched
    queries: int = 200
    seed: int = 0  # Of the queries, and of where squares and circles lie about them
    query: QueryConfig = field(default_factory=QueryConfig)

    def __post_init__(self) -> None:
        given = [(f"area is {km2} km2", km2) for km2 in self.areas_km2]
        for said, value in given + [(f"radius is {km} km", km) for km in self.near_km]:
            if not 0.0 < value < np.inf:
                raise InputError(f"{said}; expected more than 0")
        if self.queries < 1:
            raise InputError(f"the number of queries is {self.queries}; expected at least 1")
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; expected 0 or more")

    def quick(self, terrain: HeightField) -> "ScaleConfig":
        """Return a version of a minute: five queries, and 5 x 10 km where a store is built."""
        bounds_deg = middle_deg(terrain, bounds_deg=self.bounds_deg)
        return replace(
            self,
            bounds_deg=bounds_deg,
            areas_km2=(min(_QUICK_KM2, *self.areas_km2),),
            near_km=(),
            queries=min(self.queries, _QUICK_QUERIES),
        )


@dataclass(frozen=True, slots=True)
class Search:
    """A square or a circle that holds a query's place, or everything."""

    name: str
    km2: float
    side_m: float | None = None
    radius_m: float | None = None

    def about(
        self, truth: Truth, area: Rectangle, frame: Frame, entropy: Sequence[int]
    ) -> Narrowed | None:
        """Return the search with the truth anywhere inside, squares within the area."""
        generator = np.random.default_rng([*entropy, round(1e6 * self.km2)])
        place = np.array([truth.easting_m, truth.northing_m])
        if self.side_m is not None:
            low, high = np.array(area).reshape(2, 2)
            side_m = np.minimum(self.side_m, high - low)
            corner = generator.uniform(
                np.maximum(low, place - side_m), np.minimum(high - side_m, place)
            )
            (west, south), (east, north) = corner, corner + side_m
            rectangle = float(west), float(south), float(east), float(north)
            return Narrowed(Narrowing(), frame, (), rectangle, None)
        if self.radius_m is not None:
            off_m = self.radius_m * math.sqrt(generator.uniform())
            turn = generator.uniform(0.0, 2.0 * np.pi)
            lon, lat = frame.to_lonlat(
                place[0] + off_m * math.sin(turn), place[1] + off_m * math.cos(turn)
            )
            near = float(lon), float(lat), self.radius_m / _KILOMETRE_M
            return Narrowing(near=near).within(frame)
        return None


@dataclass(frozen=True, slots=True)
class Found:
    """The outcome of one query in one search."""

    query: int  # Its number
    search: str  # The name of the search
    # Median distance of the query's skyline; 0 where it has none: what fills its image stands right
    # before it.
    distance_m: float
    outcome: Outcome


def measure(
    terrain: HeightField, config: ScaleConfig, folder: Path, progress: Progress = unseen
) -> tuple[Row, list[Row]]:
    """Build or open a store of places, match queries in squares of it, and sum up."""
    cost, searches, found = outcomes(terrain, config, folder, progress)
    rows: list[Row] = []
    for search in searches:
        for group, (low, high) in GROUPS.items():
            mine = [one for one in found if one.search == search.name]
            some = [one.outcome for one in mine if low <= one.distance_m < high]
            if some:
                about = {"search": search.name, "km2": search.km2, "group": group}
                rows.append({**about, **summary(some)})
    return cost, rows


def outcomes(
    terrain: HeightField, config: ScaleConfig, folder: Path, progress: Progress = unseen
) -> tuple[Row, list[Search], list[Found]]:
    """Build or open a store of places, and match queries in squares of it.

    The store that is built and the results are kept in ``folder``: what is there is not done again.
    Return what the store cost, what was searched, and what became of each query in each search.
    """
    if config.store is not None:
        store = given_store(terrain, config.store)
    else:
        check_spacing(terrain, config.spacing_m, config.bounds_deg)
        plan = PlacePlan(config.spacing_m, config.bounds_deg, config.loss)
        store = laid_out_store(terrain, folder, plan, progress)
    reset_peak()
    started = time.perf_counter()
    with Matcher(store.path, terrain, config=MATCHING) as matcher:
        open_s = time.perf_counter() - started
        area = mapped_area_m(matcher.header, terrain) or map_bounds(terrain, None)
        settings = dict(matcher.header.config)
    searches = _searches(config, area)
    # The same queries in the same store.
    depends = terrain.digest, settings, store.rows, config.seed, asdict(config.query)
    kept: Kept[Found] = Kept(
        folder / "scale", depends, lambda outcome, **held: Found(**held, outcome=Outcome(**outcome))
    )
    wanted = {
        f"{query} {search.name}": (query, search)
        for query in range(config.queries)
        for search in searches
    }
    missing = [key for key in wanted if key not in kept.found]
    if missing:
        queries = make_queries(terrain, area, config.queries, config.seed, config.query)
        with open_store(store.path) as opened:
            places, header = opened.places(), opened.header
        scene = RenderedScene.of_store(terrain, header, MATCHING)
        traced = Traced(places, ground_of(terrain), scene, terrain.frame)
        traced.match(queries[0])  # The first compiles shaders.
        for key in missing:
            progress(len(kept.found), len(wanted))
            number, search = wanted[key]
            query = queries[number]
            narrowed = search.about(query.truth, area, terrain.frame, [config.seed, number])
            distance_m, outcome = np.nan_to_num(query.distance_m), traced.match(query, narrowed)
            kept.keep(key, Found(number, search.name, float(distance_m), outcome))
        scene.release()
    cost = {
        "store": store.name,
        "places": store.rows,
        "km2": searches[-1].km2,
        "build_s": store.build_s,
        "build_cpu_s": store.build_cpu_s,
        "bytes": store.size_bytes,
        "open_s": open_s,
        "own_bytes": own_bytes(),
        "peak_bytes": peak_bytes(),
    }
    return cost, searches, [kept.found[key] for key in wanted]


def _searches(config: ScaleConfig, area: Rectangle) -> list[Search]:
    """Return what is searched for each query, all of the area last."""
    west, south, east, north = area
    extent_km2 = (east - west) * (north - south) / _KILOMETRE_M**2
    searches = [
        Search(f"near {km:g} km", np.pi * km**2, radius_m=_KILOMETRE_M * km)
        for km in config.near_km
    ]
    searches += [
        Search(f"{km2:g} km2", km2, side_m=_KILOMETRE_M * math.sqrt(km2))
        for km2 in config.areas_km2
    ]
    fitting = [one for one in searches if one.km2 < extent_km2]
    larger = [one.name for one in searches if one.km2 >= extent_km2]
    if larger:
        _log.warning("left out, since the store covers %.0f km2: %s", extent_km2, ", ".join(larger))
    fitting.sort(key=lambda one: (one.km2, one.name))
    return [*fitting, Search(WHOLE, extent_km2)]


def summary(outcomes: Sequence[Outcome]) -> Row:
    """Return what became of queries; one without any candidate is nowhere near."""
    columns = {
        name.name: np.array([getattr(one, name.name) for one in outcomes], dtype=np.float64)
        for name in fields(Outcome)
    }
    error_m = np.where(np.isnan(columns["error_m"]), np.inf, columns["error_m"])
    return {
        **accuracy(error_m, [one.answered_within_m for one in outcomes]),
        "within_1km": float((error_m <= _KILOMETRE_M).mean()),
        "mean_m": float(np.minimum(error_m, _NOWHERE_M).mean()),
        "query_s": float(np.median(columns["seconds"])),
        "query_cpu_s": float(columns["cpu_s"].mean()),
        **{stage: float(columns[stage].mean()) for stage in STAGES},
    }
