"""Size measured: one store of places, searched in squares that grow to all of it.

Each synthetic query is looked for in squares that hold its place anywhere, so that the same queries
tell what a larger area costs and how much of the accuracy it takes. Results are kept after each
search, so that a run that was killed goes on.
"""

import hashlib
import json
import logging
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from skyline import __version__
from skyline.errors import InputError
from skyline.geodesy import Frame
from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline.matching.narrowing import Narrowed, Narrowing
from skyline.pipeline.config import PlaceConfig
from skyline.pipeline.jobs import Progress
from skyline.pipeline.layout import DEFAULT_LOSS
from skyline.pipeline.match import Matcher
from skyline.pipeline.scene import RenderedScene
from skyline.planning.uniform import MapBounds, map_bounds
from skyline.store import open_store
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.memory import own_bytes, peak_bytes, reset_peak
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, Truth, make_queries
from skyline_bench.runs.matching import BoundsDeg, middle_deg
from skyline_bench.stores.area import mapped_area_m
from skyline_bench.stores.reference import (
    ReferenceStore,
    check_spacing,
    given_store,
    place_store,
)
from skyline_bench.trials.kept import measured_code_digest
from skyline_bench.trials.matchers import MATCHING
from skyline_bench.trials.traced import STAGES, Outcome, Traced

_log = logging.getLogger(__name__)

Row = dict[str, object]

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
    """What is measured.

    Attributes
    ----------
    spacing_m : float, optional
        Of a uniform store of places that is built; by default they are planned.
    loss : float
        What they are planned for.
    bounds_deg : (float, float, float, float), optional
        West, south, east, north of what is built; by default all of the DEM.
    store : Path, optional
        A store of places that is there already, instead.
    areas_km2 : tuple of float
        Squares that are searched; all of the store is searched as well.
    near_km : tuple of float
        Radii of circles that are searched.
    queries : int
    seed : int
        Of the queries, and of where squares and circles lie about them.
    query : QueryConfig
    """

    spacing_m: float | None = None
    loss: float = DEFAULT_LOSS
    bounds_deg: BoundsDeg | None = None
    store: Path | None = None
    areas_km2: tuple[float, ...] = (50.0, 1000.0, 10_000.0)
    near_km: tuple[float, ...] = (30.0,)
    queries: int = 200
    seed: int = 0
    query: QueryConfig = field(default_factory=QueryConfig)

    def __post_init__(self) -> None:
        for what, values in (("area", self.areas_km2), ("radius", self.near_km)):
            for value in values:
                if not 0.0 < value < np.inf:
                    unit = "km2" if what == "area" else "km"
                    raise InputError(f"{what} is {value} {unit}; expected more than 0")
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
    """A square or a circle that holds a query's place, or everything.

    Attributes
    ----------
    name : str
    km2 : float
    side_m, radius_m : float or None
    """

    name: str
    km2: float
    side_m: float | None = None
    radius_m: float | None = None

    def about(
        self, truth: Truth, area: MapBounds, frame: Frame, entropy: Sequence[int]
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
            return Narrowed(Narrowing(), frame.wkt, (), rectangle, None)
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
    """The outcome of one query in one search.

    Attributes
    ----------
    query : int
        Its number.
    search : str
        The name of the search.
    distance_m : float
        Median distance of the query's skyline; 0 where it has none: what fills its image stands
        right before it.
    outcome : Outcome
    """

    query: int
    search: str
    distance_m: float
    outcome: Outcome


def measure(
    terrain: HeightField, config: ScaleConfig, folder: Path, progress: Progress | None = None
) -> tuple[Row, list[Row]]:
    """Build or open a store of places, match queries in squares of it, and sum up."""
    cost, searches, found = outcomes(terrain, config, folder, progress)
    return cost, list(_rows(searches, found))


def outcomes(
    terrain: HeightField, config: ScaleConfig, folder: Path, progress: Progress | None = None
) -> tuple[Row, list[Search], list[Found]]:
    """Build or open a store of places, and match queries in squares of it.

    Parameters
    ----------
    terrain : HeightField
    config : ScaleConfig
    folder : Path
        Where the store that is built and the results are kept: what is there is not done again.
    progress : callable, optional

    Returns
    -------
    (dict, list of Search, list of Found)
        What the store cost, what was searched, and what became of each query in each search.

    Raises
    ------
    InputError
        Bounds outside the DEM, a spacing that does not fit them, or a store of renderings.
    StoreMismatchError
        The store is of another DEM, or the folder has one of another area.
    """
    if config.store is not None:
        store = given_store(terrain, config.store)
    else:
        check_spacing(terrain, config.spacing_m, config.bounds_deg)
        store = place_store(
            terrain,
            folder,
            config.spacing_m,
            config.bounds_deg,
            PlaceConfig(),
            progress,
            config.loss,
        )
    reset_peak()
    started = time.perf_counter()
    with Matcher(store.path, terrain, config=MATCHING) as matcher:
        open_s = time.perf_counter() - started
        area = mapped_area_m(matcher.header, terrain) or map_bounds(terrain, None)
    searches = _searches(config, area)
    results = Results(folder / f"scale-{_digest(terrain, config, store)}.jsonl")
    wanted = [(query, search) for query in range(config.queries) for search in searches]
    missing = [one for one in wanted if (one[0], one[1].name) not in results.found]
    if missing:
        queries = make_queries(terrain, area, config.queries, config.seed, config.query)
        with open_store(store.path) as opened:
            places, header = opened.places(), opened.header
        scene = RenderedScene.of_store(terrain, header, MATCHING)
        traced = Traced(places, terrain.height_at, scene, terrain.frame)
        traced.match(queries[0])  # The first compiles shaders.
        for number, search in missing:
            if progress:
                progress(len(results.found), len(wanted))
            query = queries[number]
            narrowed = search.about(query.truth, area, terrain.frame, [config.seed, number])
            results.keep(
                Found(number, search.name, _distance_m(query), traced.match(query, narrowed))
            )
        scene.release()
    cost: Row = {
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
    return cost, searches, [results.found[query, search.name] for query, search in wanted]


class Results:
    """Outcomes kept in a file, a line each as they come; those of an earlier run are read.

    Parameters
    ----------
    path : Path
        A line that a kill cut short is left out.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.found: dict[tuple[int, str], Found] = {}
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        for line in text.splitlines():
            try:
                held: dict[str, Any] = json.loads(line)
                one = Found(**{**held, "outcome": Outcome(**held["outcome"])})
            except (ValueError, KeyError, TypeError):
                continue
            self.found[one.query, one.search] = one
        if text and not text.endswith("\n"):
            self._append("")

    def keep(self, found: Found) -> None:
        """Add an outcome, also to the file."""
        self.found[found.query, found.search] = found
        self._append(json.dumps(asdict(found)))

    def _append(self, line: str) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")


def _searches(config: ScaleConfig, area: MapBounds) -> list[Search]:
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
    fitting = sorted(
        (one for one in searches if one.km2 < extent_km2), key=lambda one: (one.km2, one.name)
    )
    larger = [one.name for one in searches if one not in fitting]
    if larger:
        _log.warning("left out, since the store covers %.0f km2: %s", extent_km2, ", ".join(larger))
    return [*fitting, Search(WHOLE, extent_km2)]


def _digest(terrain: HeightField, config: ScaleConfig, store: ReferenceStore) -> str:
    """Return a name for all that an outcome depends on but its query's number and search."""
    with open_store(store.path) as opened:
        settings = dict(opened.header.config)
    depends = {
        "package_version": __version__,
        "code": measured_code_digest(),
        "dem": terrain.digest,
        "store": settings,
        "places": store.rows,
        "seed": config.seed,
        "query": asdict(config.query),
    }
    text = json.dumps(depends, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _distance_m(query: SyntheticQuery) -> float:
    return query.distance_m if np.isfinite(query.distance_m) else 0.0


def _rows(searches: Sequence[Search], found: Sequence[Found]) -> Iterator[Row]:
    """Yield the table's rows: by search, then group."""
    for search in searches:
        for group, (low, high) in GROUPS.items():
            some = [
                one.outcome
                for one in found
                if one.search == search.name and low <= one.distance_m < high
            ]
            if some:
                yield {"search": search.name, "km2": search.km2, "group": group, **summary(some)}


def summary(outcomes: Sequence[Outcome]) -> Row:
    """Return what became of queries; one without any candidate is nowhere near."""
    columns = {
        name.name: np.array([getattr(one, name.name) for one in outcomes], dtype=np.float64)
        for name in fields(Outcome)
    }
    error_m = np.where(np.isnan(columns["error_m"]), np.inf, columns["error_m"])
    right, within_m = error_m <= RIGHT_WITHIN_M, columns["answered_within_m"]
    answered = np.isfinite(within_m)
    return {
        "n": len(outcomes),
        "within_200m": float(right.mean()),
        "within_1km": float((error_m <= _KILOMETRE_M).mean()),
        "median_m": float(np.median(error_m)),
        "mean_m": float(np.minimum(error_m, _NOWHERE_M).mean()),
        "answered": float(answered.mean()),
        "answered_200m": float((within_m <= RIGHT_WITHIN_M).mean()),
        "precision": float((error_m <= within_m)[answered].mean()) if answered.any() else None,
        "query_s": float(np.median(columns["seconds"])),
        "query_cpu_s": float(columns["cpu_s"].mean()),
        **{stage: float(columns[stage].mean()) for stage in STAGES},
    }
