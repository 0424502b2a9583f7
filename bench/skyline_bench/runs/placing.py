"""Placing compared: what uniform grids and planned places find for what they cost.

All layouts are searched with the same queries. What the planner expected to be lost is held
against what was, over the area and query by query.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from skyline.arrays import BoolArray, Float64Array
from skyline.build.cluster import Progress
from skyline.build.grid import map_bounds
from skyline.build.spacing import lost_shares, window_losses
from skyline.geodesy import Bounds
from skyline.places import BINS, Places
from skyline.render.panorama import PanoramaRenderer
from skyline.store import open_store
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import unseen
from skyline_bench.queries.synthetic import SyntheticQuery, make_queries
from skyline_bench.runs.matching import middle_deg
from skyline_bench.runs.scale import GROUPS, ScaleConfig, outcomes, summary

_FOUND_WITHIN_M = 1000.0
"""What the planner calls found."""
_WINDOW_DEG = 60.0
_STEP_DEG = 10.0


@dataclass(frozen=True, slots=True)
class PlacingConfig:
    """What is measured."""

    spacings_m: tuple[float, ...] = (320.0, 160.0, 80.0)  # Of uniform grids
    losses: tuple[float, ...] = (0.35, 0.27, 0.2)  # Of planned places
    bounds_deg: Bounds | None = None
    queries: int = 150
    seed: int = 0

    def layouts(self) -> list[ScaleConfig]:
        """Return what is built and searched, one layout after the other."""
        whole = ScaleConfig(
            bounds_deg=self.bounds_deg, areas_km2=(), near_km=(), queries=self.queries,
            seed=self.seed,
        )  # fmt: skip
        uniform = [replace(whole, spacing_m=spacing) for spacing in self.spacings_m]
        return uniform + [replace(whole, loss=loss) for loss in self.losses]

    def quick(self, terrain: HeightField) -> "PlacingConfig":
        """Return a version of a minute: five queries, one layout of each kind, 5 x 10 km."""
        return replace(
            self,
            spacings_m=self.spacings_m[:1],
            losses=self.losses[:1],
            bounds_deg=middle_deg(terrain, bounds_deg=self.bounds_deg),
            queries=min(self.queries, 5),
        )


def measure(
    terrain: HeightField, config: PlacingConfig, folder: Path, progress: Progress = unseen
) -> list[Row]:
    """Build each layout's store and search it; one row for each layout and group of queries.

    Stores and outcomes are kept in ``folder``: what is there is not done again. Bounds outside the
    DEM, and a spacing or a loss that does not fit them, raise `InputError`.
    """
    area = map_bounds(terrain, config.bounds_deg)
    rows = list[Row]()
    for layout in config.layouts():
        cost, _, found = outcomes(terrain, layout, folder, progress)
        with open_store(folder / f"{cost['store']}.h5") as store:
            places = Places.concatenate(list(store.places().blocks()))
        queries = make_queries(terrain, area, layout.queries, layout.seed, layout.query)
        expected = _expected(terrain, places, queries)
        error_m = np.array([one.outcome.error_m for one in found], dtype=np.float64)
        lost = ~(error_m <= _FOUND_WITHIN_M)
        shared = {
            "layout": cost["store"],
            **{name: cost[name] for name in ("places", "km2", "bytes", "build_cpu_s")},
            "claimed_loss": claimed_loss(places),
        }
        for group, (low, high) in GROUPS.items():
            mine = np.array([low <= one.distance_m < high for one in found])
            if mine.any():
                some = [one.outcome for one, chosen in zip(found, mine, strict=True) if chosen]
                quality = model_quality(expected[mine], lost[mine])
                rows.append({**shared, "group": group, **summary(some), **quality})
    return rows


def claimed_loss(places: Places) -> float:
    """Return the share of views that is expected to be lost over the area that places stand for."""
    spacing_m = 2.0 * places.tolerance_m.astype(np.float64)
    lost = np.zeros(len(places))
    for one in np.unique(spacing_m):
        mine = spacing_m == one
        lost[mine] = lost_shares(places[mine].distance_m(), np.array([one]))[:, 0]
    return float(np.average(lost, weights=spacing_m**2))


def model_quality(expected: Float64Array, lost: BoolArray) -> Row:
    """Return how well expected losses (N,) foretell which queries are lost (N,).

    Precision and recall are of queries that are expected to be found.
    """
    foretold, found = expected < 0.5, ~lost
    hits = int(np.count_nonzero(foretold & found))
    return {
        "expected_loss": float(expected.mean()),
        "lost": float(lost.mean()),
        "model_precision": hits / max(int(np.count_nonzero(foretold)), 1),
        "model_recall": hits / max(int(np.count_nonzero(found)), 1),
    }


def _expected(
    terrain: HeightField, places: Places, queries: tuple[SyntheticQuery, ...]
) -> Float64Array:
    """Return how likely queries are lost, by the spacing where they were taken."""
    truths = [query.truth for query in queries]
    easting_m, northing_m, up_m, heading_deg = np.array(
        [(one.easting_m, one.northing_m, one.eye_elevation_m, one.heading_deg) for one in truths]
    ).T.copy()
    there = cKDTree(np.stack([places.easting_m, places.northing_m], axis=1))
    _, nearest = there.query(np.stack([easting_m, northing_m], axis=1))
    with PanoramaRenderer(terrain, BINS) as renderer:
        distance_m = renderer.render(
            Viewpoints(easting_m=easting_m, northing_m=northing_m, eye_elevation_m=up_m)
        ).distance_m
    start_deg = heading_deg - _WINDOW_DEG / 2.0
    window = np.rint(start_deg / _STEP_DEG).astype(np.int64) % round(360.0 / _STEP_DEG)
    spacing_m = 2.0 * places.tolerance_m[np.asarray(nearest)].astype(np.float64)
    return np.array(
        [
            window_losses(distance_m[[one]], spacing_m[[one]])[0, 0, window[one]]
            for one in range(len(queries))
        ]
    )
