"""What one area costs: its store built on a uniform grid, opened, and matched by made queries."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from skyline.errors import InputError
from skyline.experiments.queries import MadeQuery
from skyline.experiments.trials import run_trials
from skyline.pipeline import MatchConfig, Matcher, RenderConfig, render_to_store
from skyline.planning.uniform import MapBounds, uniform_grid
from skyline.prediction import shell_edges_m
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

MATCHING = MatchConfig(fov_slack=0.05)
"""The field of view of made queries is known to 5 %."""

_M2_IN_KM2 = 1e6
_TOP = 5


@dataclass(frozen=True, slots=True)
class Area:
    """What is built: a uniform grid over a rectangle in the middle of a DEM.

    Attributes
    ----------
    km2 : float
        The rectangle has the DEM's proportions.
    spacing_m : float
    shells : int
        Distance shells kept, 0 for none.
    """

    km2: float
    spacing_m: float
    shells: int

    def bounds_m(self, terrain: HeightField) -> MapBounds:
        """Return west, south, east, north."""
        west, south, east, north = terrain.bounds_m
        half = 0.5 * np.sqrt(self.km2 / extent_km2(terrain))
        middle_east, middle_north = (west + east) / 2.0, (south + north) / 2.0
        half_east, half_north = half * (east - west), half * (north - south)
        return (
            float(middle_east - half_east),
            float(middle_north - half_north),
            float(middle_east + half_east),
            float(middle_north + half_north),
        )

    def viewpoints(self, terrain: HeightField) -> Viewpoints:
        """Return the grid.

        Raises
        ------
        InputError
            The rectangle is narrower than the spacing, or has no surface.
        """
        west, south, east, north = bounds = self.bounds_m(terrain)
        if min(east - west, north - south) < self.spacing_m:
            raise InputError(
                f"{self.km2:g} km2, {east - west:.0f} x {north - south:.0f} m, is too small for a "
                f"grid of {self.spacing_m:g} m; choose a larger area or a smaller spacing"
            )
        return uniform_grid(terrain, self.spacing_m, bounds)


def extent_km2(terrain: HeightField) -> float:
    """Return the area of a terrain's bounds."""
    west, south, east, north = terrain.bounds_m
    return (east - west) * (north - south) / _M2_IN_KM2


@dataclass(frozen=True, slots=True)
class BuildCost:
    """What a build took.

    Attributes
    ----------
    renderings : int
    build_s : float
        From the terrain's preparation to the closed store.
    build_cpu_s : float
        Processor time of the same.
    bytes : int
        Of the store.
    """

    renderings: int
    build_s: float
    build_cpu_s: float
    bytes: int

    @property
    def seconds_a_rendering(self) -> float:
        """Seconds over renderings."""
        return self.build_s / self.renderings

    @property
    def cpu_seconds_a_rendering(self) -> float:
        """Processor time over renderings."""
        return self.build_cpu_s / self.renderings

    @property
    def bytes_a_rendering(self) -> float:
        """Bytes over renderings."""
        return self.bytes / self.renderings


@dataclass(frozen=True, slots=True)
class MatchCost:
    """What matching took, and how well it went.

    Attributes
    ----------
    places : int
        About so many are predicted from the store and compared with each query.
    open_s : float
        Reading the store and predicting them.
    queries : int
    query_ms, query_cpu_ms : float
        Median time of a query, mean processor time.
    within_200m, median_m : float
        Share of the queries found within 200 m, median error.
    """

    places: int
    open_s: float
    queries: int
    query_ms: float
    query_cpu_ms: float
    within_200m: float
    median_m: float


@dataclass(frozen=True, slots=True)
class AreaCost:
    """An area, what it cost, and why it was not matched where it was not.

    Attributes
    ----------
    area : Area
    build : BuildCost
    match : MatchCost or str
    peak_bytes : int or None
        Greatest resident memory, the terrain's included; None where the system does not say.
    """

    area: Area
    build: BuildCost
    match: MatchCost | str
    peak_bytes: int | None

    def row(self) -> dict[str, object]:
        """Return the table's row."""
        row: dict[str, object] = {
            "area_km2": self.area.km2,
            "spacing_m": self.area.spacing_m,
            "shells": self.area.shells,
            **asdict(self.build),
            "ms_a_rendering": 1e3 * self.build.seconds_a_rendering,
            "cpu_ms_a_rendering": 1e3 * self.build.cpu_seconds_a_rendering,
            "bytes_a_rendering": self.build.bytes_a_rendering,
            "query_ms": None,
            "not_matched": None,
            "peak_bytes": self.peak_bytes,
        }
        if isinstance(self.match, str):
            return row | {"not_matched": self.match}
        return row | asdict(self.match)


def measure_build(
    terrain: HeightField, viewpoints: Viewpoints, shells: int, path: Path
) -> BuildCost:
    """Build a store at a path and say what it took."""
    edges = shell_edges_m(shells) if shells else ()
    wall, cpu = time.perf_counter(), time.process_time()
    built = render_to_store(terrain, viewpoints, path, RenderConfig(shell_edges_m=edges))
    wall_s, cpu_s = time.perf_counter() - wall, time.process_time() - cpu
    return BuildCost(built.renderings, wall_s, cpu_s, path.stat().st_size)


def measure_match(
    terrain: HeightField, path: Path, area: Area, queries: Sequence[MadeQuery]
) -> MatchCost:
    """Match queries to an area's store by the full matcher and say what it took."""
    west, south, east, north = area.bounds_m(terrain)
    miss_m = float(np.hypot(east - west, north - south)) / 2.0
    started = time.perf_counter()
    with Matcher(path, terrain, config=MATCHING) as matcher:
        open_s = time.perf_counter() - started
        places = predicted_places(area.km2, len(matcher.viewpoints))
        cpu = time.process_time()
        trials = list(run_trials(matcher, queries, miss_m, _TOP))
        cpu_s = time.process_time() - cpu
    return MatchCost(
        places,
        open_s,
        len(trials),
        1e3 * float(np.median([trial.seconds for trial in trials])),
        1e3 * cpu_s / len(trials),
        float(np.mean([trial.right for trial in trials])),
        float(np.median([trial.error_m for trial in trials])),
    )


def predicted_places(km2: float, viewpoints: int) -> int:
    """Return about how many places a store is matched by: its own and a lattice's."""
    return viewpoints + round(km2 * _M2_IN_KM2 / MATCHING.densify.pitch_m**2)


def opening_bytes(places: int, viewpoints: int, shells: int) -> int:
    """Return about how much memory an open store takes: `densify`'s arrays and its phases."""
    config = MATCHING.densify
    place = 3 * config.bins + 32 + MATCHING.retrieval.coarse_bins
    return places * place + viewpoints * 32 * config.columns * max(shells, 1)
