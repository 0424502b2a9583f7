"""What a comparison of matchers is asked for: stores, queries and matchers."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

from skyline.errors import InputError
from skyline.paper.planning.plan import PlanConfig
from skyline.planning.uniform import map_bounds
from skyline.store.header import PLACES, RENDERINGS
from skyline.terrain.heightfield import HeightField
from skyline_bench.queries.synthetic import QueryConfig
from skyline_bench.trials.matchers import WHAT, check_matchers, searched_by

BoundsDeg = tuple[float, float, float, float]
Grid = tuple[str, float | None]
"""What a store holds, and its spacing in metres; None for places as they are planned by default."""

DEFAULT_AREA_M = (5_000.0, 10_000.0)
"""East by north, in the DEM's middle."""

PLAIN, WHITE, OTHER_DEM, OCCLUDED = "plain", "white", "other-dem", "occluded"
KINDS: Mapping[str, str] = MappingProxyType(
    {
        PLAIN: "a tenth of the columns masked, 0.1 degrees of noise, half of it smooth",
        WHITE: "the same with noise drawn anew in each column",
        OTHER_DEM: "plain from a DEM of another spacing and phase, 10 m rms off",
        OCCLUDED: "plain with 30 % of the columns hidden, half of it unnoticed",
    }
)
"""Kinds of queries. Those of one number have one place and pose in every kind."""

_COARSE_M = 512.0
_QUICK_M = 3000.0


@dataclass(frozen=True, slots=True)
class MatchingConfig:
    """What is compared."""

    # West, south, east, north of the area; by default 5 x 10 km in the DEM's middle.
    bounds_deg: BoundsDeg | None = None
    # Of the uniform stores of renderings, built where a matcher searches such.
    spacings_m: tuple[float, ...] = (1024.0, 512.0, 256.0, 128.0)
    # Of the uniform stores of places, likewise; None for places as they are planned by default.
    place_spacings_m: tuple[float | None, ...] = (None, 160.0, 120.0, 80.0, 60.0, 40.0)
    # What the paper's planners are asked for: a store of the renderings of each, and one of whole
    # places at their eyes, likewise.
    plans: tuple[PlanConfig, ...] = ()
    stores: tuple[Path, ...] = ()  # Stores that are there already, measured after the others
    # Names of `skyline_bench.trials.matchers.WHAT`; each is run on the stores it can search.
    matchers: tuple[str, ...] = tuple(WHAT)
    kinds: tuple[str, ...] = tuple(KINDS)  # Names of `KINDS`
    queries: int = 300  # Of each kind
    # Whether queries are told apart by how far their skyline is; takes three at least.
    grouped: bool = False
    seed: int = 0  # Of the queries and the intervals
    top: int = 5  # Candidates asked for; the first one counts
    # Processes at work, each with one thread; by default this process with all of them.
    workers: int | None = None
    query: QueryConfig = field(default_factory=QueryConfig)  # Plain queries

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
        check_matchers(self.matchers)
        if not (self.grids() or self.plans or self.stores):
            raise InputError("there is no store to match; give a spacing or a store")
        for kind in self.kinds:
            if kind not in KINDS:
                raise InputError(f"kind of queries is {kind!r}; expected one of {', '.join(KINDS)}")

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

        With planners, the area is its middle, and the budget the least one, by as much as the area
        is smaller.
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
        share = size_m[0] * size_m[1] / ((east - west) * (north - south))
        budgets = [plan.budget for plan in self.plans if plan.budget is not None]
        budget = math.ceil(share * min(budgets)) if budgets else None
        plans = tuple(replace(plan, budget=budget) for plan in self.plans)
        return replace(small, bounds_deg=middle_deg(terrain, size_m, bounds_deg), plans=plans)


def middle_deg(
    terrain: HeightField,
    size_m: tuple[float, float] = DEFAULT_AREA_M,
    bounds_deg: BoundsDeg | None = None,
) -> BoundsDeg:
    """Return the middle of bounds, by default of the DEM: so far east and north at most."""
    west, south, east, north = map_bounds(terrain, bounds_deg)
    half_east = min(size_m[0], east - west) / 2.0
    half_north = min(size_m[1], north - south) / 2.0
    middle_east, middle_north = (west + east) / 2.0, (south + north) / 2.0
    lon, lat = terrain.frame.to_lonlat(
        [middle_east - half_east, middle_east + half_east, middle_east, middle_east],
        [middle_north, middle_north, middle_north - half_north, middle_north + half_north],
    )
    return float(lon[0]), float(lat[2]), float(lon[1]), float(lat[3])
