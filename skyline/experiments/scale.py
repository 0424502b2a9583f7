"""Cost against size: areas of real terrain built and matched, and what larger ones would take.

The paper says that skylines of 10,000 km2, 50 to 100 m apart, can take months. Here areas that
grow are built on a uniform grid and matched by the full matcher, and the cost of the paper's area
is extrapolated from them: seconds and bytes by a fit to the areas, held against a patch that is
built at the very spacing the extrapolation is for. What it assumes is said beside it.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skyline.camera import HEADINGS
from skyline.errors import InputError
from skyline.experiments.area_cost import (
    Area,
    AreaCost,
    BuildCost,
    MatchCost,
    extent_km2,
    measure_build,
    measure_match,
    opening_bytes,
    predicted_places,
)
from skyline.experiments.extrapolation import extrapolate
from skyline.experiments.memory import available_bytes, peak_bytes, reset_peak
from skyline.experiments.queries import make_queries
from skyline.pipeline import Progress
from skyline.prediction import shell_edges_m
from skyline.terrain.heightfield import HeightField

_log = logging.getLogger(__name__)

Row = dict[str, object]

MEASURED, PROBE, EXTRAPOLATED = "measured", "probe", "extrapolated"

_MEMORY_SHARE = 0.8
"""Of the memory at hand, that opening a store may take."""


@dataclass(frozen=True, slots=True)
class ScaleConfig:
    """What is measured, and what is extrapolated to.

    Attributes
    ----------
    areas_km2 : tuple of float
        Rectangles of the DEM's proportions in its middle.
    spacing_m : float
        Of the uniform grids.
    shells : tuple of int
        Every area is built with each of these numbers of distance shells; 0 for skylines alone.
    queries : int
        Matched to each store.
    seed : int
        Of the queries.
    open_limit_s : float
        A store that would take longer to open, by what smaller ones took, is not matched.
    target_km2, target_spacing_m : float
        What is extrapolated to; the paper's by default.
    probe_km2 : float
        Patch that is built at the target's spacing.
    """

    areas_km2: tuple[float, ...] = (50.0, 200.0, 800.0, 3000.0)
    spacing_m: float = 500.0
    shells: tuple[int, ...] = (0, 12)
    queries: int = 20
    seed: int = 0
    open_limit_s: float = 1200.0
    target_km2: float = 10_000.0
    target_spacing_m: float = 50.0
    probe_km2: float = 4.0

    def __post_init__(self) -> None:
        if not self.areas_km2 or not self.shells:
            raise InputError("there is nothing to build; give an area and a number of shells")
        for what, values, unit in (
            ("area", self.areas_km2, "km2"),
            ("area to extrapolate to", (self.target_km2, self.probe_km2), "km2"),
            ("spacing", (self.spacing_m, self.target_spacing_m), "m"),
        ):
            for value in values:
                if not 0.0 < value < np.inf:
                    raise InputError(f"{what} is {value} {unit}; expected more than 0")
        if self.queries < 1:
            raise InputError(f"the number of queries is {self.queries}; expected at least 1")
        if not self.open_limit_s >= 0.0:
            raise InputError(
                f"the limit of opening a store is {self.open_limit_s} s; expected 0 or more"
            )
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; expected 0 or more")
        for shells in filter(None, self.shells):
            shell_edges_m(shells)

    def quick(self) -> "ScaleConfig":
        """Return a version in seconds: a tenth of the two smallest areas, one kind of store."""
        return replace(
            self,
            areas_km2=tuple(area / 10.0 for area in sorted(set(self.areas_km2))[:2]),
            shells=self.shells[:1],
            queries=min(self.queries, 3),
            probe_km2=self.probe_km2 / 10.0,
        )


def measure(
    terrain: HeightField, config: ScaleConfig, folder: Path, progress: Progress | None = None
) -> list[Row]:
    """Build and match areas of a terrain, and extrapolate.

    Parameters
    ----------
    terrain : HeightField
        Everything is rendered over all of it, whatever the area.
    config : ScaleConfig
    folder : Path
        Where stores are made, and removed once measured.
    progress : callable, optional

    Returns
    -------
    list of dict
        For each number of shells the areas that fit into the DEM, smallest first (`kind` is
        "measured"), the patch at the target's spacing ("probe") and the target ("extrapolated",
        with its `assumptions`). Areas that do not fit are left out, which is logged.

    Raises
    ------
    InputError
        No area fits, or one is too small for its spacing.
    """
    fitting = _fitting(terrain, config)
    probe_km2 = min(config.probe_km2, fitting[0])
    plan = [
        (
            [Area(km2, config.spacing_m, shells) for km2 in fitting],
            Area(probe_km2, config.target_spacing_m, shells),
        )
        for shells in config.shells
    ]
    for areas, probe in plan:
        for area in (*areas, probe):
            area.viewpoints(terrain)
    rows: list[Row] = []
    total = len(plan) * (len(fitting) + 1)
    for index, (areas, probe) in enumerate(plan):
        one = _one_viewpoint(terrain, areas[0], folder)
        costs: list[AreaCost] = []
        for cost in _costs(terrain, config, areas, probe, folder):
            costs.append(cost)
            if progress:
                progress(index * (len(fitting) + 1) + len(costs), total)
        rows += [{"kind": MEASURED, **cost.row()} for cost in costs[:-1]]
        rows += [
            {"kind": PROBE, **costs[-1].row()},
            {"kind": EXTRAPOLATED, **extrapolate(one, costs[:-1], costs[-1], config.target_km2)},
        ]
    return rows


def _fitting(terrain: HeightField, config: ScaleConfig) -> list[float]:
    """Return the areas that the DEM has, smallest first."""
    extent = extent_km2(terrain)
    areas_km2 = sorted(set(config.areas_km2))
    fitting = [km2 for km2 in areas_km2 if km2 <= extent]
    larger = ", ".join(f"{km2:g}" for km2 in areas_km2[len(fitting) :])
    if not fitting:
        raise InputError(
            f"no area fits: {larger} km2 were asked for, the DEM covers {extent:.4g}; choose a "
            "smaller --area, or give more tiles"
        )
    if larger:
        _log.warning("left out, since the DEM covers %.0f km2: %s km2", extent, larger)
    return fitting


def _one_viewpoint(terrain: HeightField, area: Area, folder: Path) -> BuildCost:
    """Return what a store of one viewpoint costs, the second time: drivers compile at the first."""
    path = folder / "one.h5"
    viewpoint = area.viewpoints(terrain)[:1]
    for _ in range(2):
        cost = measure_build(terrain, viewpoint, area.shells, path)
        path.unlink()
    return cost


def _costs(
    terrain: HeightField,
    config: ScaleConfig,
    areas: Sequence[Area],
    probe: Area,
    folder: Path,
) -> Iterator[AreaCost]:
    """Yield the cost of every area, then the probe's."""
    opened: MatchCost | None = None
    path = folder / "scale.h5"
    for area in (*areas, probe):
        reset_peak()
        build = measure_build(terrain, area.viewpoints(terrain), area.shells, path)
        match: MatchCost | str
        if area is probe:
            match = "a patch that tells what renderings cost at this spacing"
        else:
            match = _refusal(config, area, build.renderings // len(HEADINGS), opened) or _match(
                terrain, config, area, path
            )
        if isinstance(match, MatchCost):
            opened = match
        path.unlink()
        yield AreaCost(area, build, match, peak_bytes())


def _match(terrain: HeightField, config: ScaleConfig, area: Area, path: Path) -> MatchCost:
    queries = make_queries(terrain, area.bounds_m(terrain), config.queries, config.seed)
    return measure_match(terrain, path, area, queries)


def _refusal(
    config: ScaleConfig, area: Area, viewpoints: int, opened: MatchCost | None
) -> str | None:
    """Say why an area's store is not matched, if so; ``opened`` is what a smaller one took."""
    places = predicted_places(area.km2, viewpoints)
    needed, there = opening_bytes(places, viewpoints, area.shells), available_bytes()
    if there is not None and needed > _MEMORY_SHARE * there:
        return (
            f"{places:,} predicted places take {needed / 1e9:.1f} GB, {there / 1e9:.1f} GB of "
            "memory are at hand"
        )
    if opened is None:
        return None
    open_s = opened.open_s * places / opened.places
    if open_s <= config.open_limit_s:
        return None
    return (
        f"{places:,} predicted places would take {open_s:.0f} s, by the {opened.places:,} of the "
        f"area before; the limit is {config.open_limit_s:.0f} s"
    )
