"""Matchers compared: how often, how far off and how fast they find synthetic queries in stores."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from skyline.errors import InputError
from skyline.pipeline import PlaceConfig, Progress, RenderConfig
from skyline.planning.uniform import map_bounds
from skyline.store.header import PLACES, RENDERINGS
from skyline.terrain.heightfield import HeightField
from skyline_bench.queries.other_dems import perturbed, resampled
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, make_queries
from skyline_bench.stores.reference import (
    ReferenceStore,
    check_spacing,
    given_store,
    place_store,
    uniform_store,
)
from skyline_bench.trials.matchers import WHAT, check_matchers, open_matcher, searched_by
from skyline_bench.trials.trials import Trial, run_trials, summarize

BoundsDeg = tuple[float, float, float, float]

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

_OTHER_SPACING, _OTHER_PHASE = 1.3, (0.37, 0.61)
_HIDDEN_SHARE = 0.3


@dataclass(frozen=True, slots=True)
class MatchingConfig:
    """What is compared.

    Attributes
    ----------
    bounds_deg : (float, float, float, float), optional
        West, south, east, north of the area; by default 5 x 10 km in the DEM's middle.
    spacings_m : tuple of float
        Of the uniform stores of renderings, built where a matcher searches such.
    place_spacings_m : tuple of float
        Of the uniform stores of places, likewise.
    stores : tuple of Path
        Stores that are there already, measured after the uniform ones.
    matchers : tuple of str
        Names of `skyline_bench.trials.matchers.WHAT`; each is run on the stores it can search.
    kinds : tuple of str
        Names of `KINDS`.
    queries : int
        Of each kind.
    seed : int
    top : int
        Candidates asked for; the first one counts.
    query : QueryConfig
        Plain queries.
    """

    bounds_deg: BoundsDeg | None = None
    spacings_m: tuple[float, ...] = (1024.0, 512.0, 256.0, 128.0)
    place_spacings_m: tuple[float, ...] = (160.0, 120.0, 80.0, 60.0, 40.0)
    stores: tuple[Path, ...] = ()
    matchers: tuple[str, ...] = tuple(WHAT)
    kinds: tuple[str, ...] = tuple(KINDS)
    queries: int = 300
    seed: int = 0
    top: int = 5
    query: QueryConfig = field(default_factory=QueryConfig)

    def __post_init__(self) -> None:
        if self.queries < 1:
            raise InputError(f"the number of queries is {self.queries}; expected at least 1")
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; expected 0 or more")
        check_matchers(self.matchers)
        if not self.grids() and not self.stores:
            raise InputError("there is no store to match; give a spacing or a store")
        for kind in self.kinds:
            if kind not in KINDS:
                raise InputError(f"kind of queries is {kind!r}; expected one of {', '.join(KINDS)}")

    def grids(self) -> list[tuple[str, float]]:
        """Return what the uniform stores hold that a matcher searches, and their spacing."""
        wanted = {searched_by(name) for name in self.matchers}
        grids = [(RENDERINGS, spacing_m) for spacing_m in self.spacings_m]
        grids += [(PLACES, spacing_m) for spacing_m in self.place_spacings_m]
        return [grid for grid in grids if grid[0] in wanted]

    def quick(self) -> "MatchingConfig":
        """Return a version that takes a minute: few queries, coarse stores."""
        coarse = tuple(spacing for spacing in self.spacings_m if spacing >= 512.0)
        return replace(
            self,
            queries=min(self.queries, 20),
            spacings_m=coarse or self.spacings_m[:1],
            place_spacings_m=self.place_spacings_m[:1],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One matcher's trials of one kind of queries on one store."""

    store: ReferenceStore
    matcher: str
    kind: str
    trials: tuple[Trial, ...]

    def row(self, seed: int) -> dict[str, object]:
        """Return the table's row: store, matcher, queries, figures of `summarize`, and costs."""
        return {
            "store": self.store.name,
            "matcher": self.matcher,
            "queries": self.kind,
            **summarize(self.trials, seed),
            "places": self.store.places,
            "bytes": self.store.size_bytes,
            "build_s": self.store.build_s,
            "build_cpu_s": self.store.build_cpu_s,
        }


def measure(
    terrain: HeightField,
    config: MatchingConfig,
    folder: Path,
    progress: Progress | None = None,
) -> list[Comparison]:
    """Match the same queries to every store with every matcher that can search it.

    Parameters
    ----------
    terrain : HeightField
        What the uniform stores are rendered from.
    config : MatchingConfig
    folder : Path
        Where these stores are, or will be: they are used again.
    progress : callable, optional

    Returns
    -------
    list of Comparison
        By store, then matcher, then kind. Position errors are those of the best candidate,
        whether or not the matcher stands by it; a query without any counts as wrong by half of
        the area's diagonal. Heading errors are those of the right answers.

    Raises
    ------
    InputError
        Bounds outside the DEM, an area too small for a spacing, or a store for no matcher.
    StoreMismatchError
        The folder has a store of another DEM, area or configuration.
    """
    bounds_deg = config.bounds_deg or middle_deg(terrain)
    for _, spacing_m in config.grids():
        check_spacing(terrain, spacing_m, bounds_deg)
    searched = {searched_by(name) for name in config.matchers}
    given = [given_store(terrain, path) for path in config.stores]
    for store in given:
        if store.holds not in searched:
            raise InputError(
                f"{store.path} holds {store.holds}, which none of {', '.join(config.matchers)} "
                "searches; name another matcher"
            )
    pairs = [
        (store, name)
        for store in (*_stores(terrain, config, bounds_deg, folder), *given)
        for name in config.matchers
        if searched_by(name) == store.holds
    ]
    queries = {kind: _queries(terrain, config, bounds_deg, kind) for kind in config.kinds}
    west, south, east, north = map_bounds(terrain, bounds_deg)
    miss_m = float(np.hypot(east - west, north - south)) / 2.0
    compared: list[Comparison] = []
    for store, name in pairs:
        with open_matcher(name, store.path, terrain) as matcher:
            for kind, made in queries.items():
                if progress:
                    progress(len(compared), len(pairs) * len(queries))
                trials = tuple(run_trials(matcher, made, miss_m, config.top))
                compared.append(Comparison(store, name, kind, trials))
    return compared


def _stores(
    terrain: HeightField, config: MatchingConfig, bounds_deg: BoundsDeg, folder: Path
) -> Iterator[ReferenceStore]:
    for holds, spacing_m in config.grids():
        if holds == PLACES:
            yield place_store(terrain, folder, spacing_m, bounds_deg, PlaceConfig())
        else:
            yield uniform_store(terrain, folder, spacing_m, bounds_deg, RenderConfig())


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
