"""Matchers compared: how often, how far off and how fast they find made queries in stores."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from skyline.errors import InputError
from skyline.experiments.other_dems import perturbed, resampled
from skyline.experiments.queries import MadeQuery, QueryConfig, make_queries
from skyline.experiments.reference_stores import (
    ReferenceStore,
    check_spacing,
    given_store,
    uniform_store,
)
from skyline.experiments.trials import Trial, run_trials, summarize
from skyline.matching import MATCHERS
from skyline.matching.dense import DensifyConfig
from skyline.pipeline import FULL, MatchConfig, Matcher, Progress, RenderConfig
from skyline.planning.uniform import map_bounds
from skyline.prediction import shell_edges_m
from skyline.terrain.heightfield import HeightField

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

_SPARSE = DensifyConfig(pitch_m=np.inf)

Opener = Callable[[Path, HeightField], Matcher]


def _open(name: str, config: MatchConfig, store: Path, terrain: HeightField) -> Matcher:
    return Matcher(store, terrain, name, config)


OPENERS: Mapping[str, Opener] = MappingProxyType(
    {name: partial(_open, name, MatchConfig(fov_slack=0.05)) for name in MATCHERS}
    | {
        "stored": partial(_open, FULL, MatchConfig(fov_slack=0.05, refine=False, densify=_SPARSE)),
        "retrieved": partial(_open, FULL, MatchConfig(fov_slack=0.05, refine=False)),
        FULL: partial(_open, FULL, MatchConfig(fov_slack=0.05)),
    }
)
"""How each matcher is made from a store's path and the terrain it was rendered from: the
baselines, and ours on stored skylines alone, on predictions, and refined. The field of view of
made queries is known to 5 %."""


@dataclass(frozen=True, slots=True)
class MatchingConfig:
    """What is compared.

    Attributes
    ----------
    bounds_deg : (float, float, float, float), optional
        West, south, east, north of the area; by default 5 x 10 km in the DEM's middle.
    spacings_m : tuple of float
        Of the uniform stores.
    shells : int
        Distance shells they keep, 0 for none; what they cost is in their bytes.
    stores : tuple of Path
        Stores that are there already, measured after the uniform ones.
    matchers : tuple of str
        Names of `OPENERS`.
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
    shells: int = 12
    stores: tuple[Path, ...] = ()
    matchers: tuple[str, ...] = tuple(OPENERS)
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
        if not self.spacings_m and not self.stores:
            raise InputError("there is no store to match; give a spacing or a store")
        for what, names, known in (
            ("matcher", self.matchers, OPENERS),
            ("kind of queries", self.kinds, KINDS),
        ):
            unknown = [name for name in names if name not in known]
            if unknown or not names:
                raise InputError(
                    f"{what} is {unknown[0] if unknown else 'none'!r}; expected one of "
                    f"{', '.join(known)}"
                )

    def quick(self) -> "MatchingConfig":
        """Return a version that takes a minute: few queries, coarse stores."""
        coarse = tuple(spacing for spacing in self.spacings_m if spacing >= 512.0)
        return replace(
            self, queries=min(self.queries, 20), spacings_m=coarse or self.spacings_m[:1]
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
            "renderings": self.store.renderings,
            "bytes": self.store.size_bytes,
            "build_s": self.store.build_s,
        }


def measure(
    terrain: HeightField,
    config: MatchingConfig,
    folder: Path,
    progress: Progress | None = None,
) -> list[Comparison]:
    """Match the same queries to every store with every matcher.

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
        Bounds outside the DEM, an area too small for a spacing, or unknown names.
    StoreMismatchError
        The folder has a store of another DEM, area or configuration.
    """
    bounds_deg = config.bounds_deg or middle_deg(terrain)
    for spacing_m in config.spacings_m:
        check_spacing(terrain, spacing_m, bounds_deg)
    stores = list(_stores(terrain, config, bounds_deg, folder))
    queries = {kind: _queries(terrain, config, bounds_deg, kind) for kind in config.kinds}
    west, south, east, north = map_bounds(terrain, bounds_deg)
    miss_m = float(np.hypot(east - west, north - south)) / 2.0
    compared: list[Comparison] = []
    total = len(stores) * len(config.matchers) * len(config.kinds)
    for store in stores:
        for name in config.matchers:
            with OPENERS[name](store.path, terrain) as matcher:
                for kind, made in queries.items():
                    if progress:
                        progress(len(compared), total)
                    trials = tuple(run_trials(matcher, made, miss_m, config.top))
                    compared.append(Comparison(store, name, kind, trials))
    return compared


def _stores(
    terrain: HeightField, config: MatchingConfig, bounds_deg: BoundsDeg, folder: Path
) -> Iterator[ReferenceStore]:
    edges = shell_edges_m(config.shells) if config.shells else ()
    given = [given_store(terrain, path) for path in config.stores]
    for spacing_m in config.spacings_m:
        render = RenderConfig(shell_edges_m=edges)
        yield uniform_store(terrain, folder, spacing_m, bounds_deg, render)
    yield from given


def _queries(
    terrain: HeightField, config: MatchingConfig, bounds_deg: BoundsDeg, kind: str
) -> Sequence[MadeQuery]:
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
