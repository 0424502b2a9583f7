"""Placing compared: what uniform grids and planned places find for what they cost.

All layouts are searched with the same queries. What the planner expected to be lost is held
against what was, over the area and query by query.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from skyline.arrays import BoolArray, Float64Array
from skyline.pipeline.jobs import Progress
from skyline.places import BINS, Places
from skyline.planning.loss import lost_shares, window_losses
from skyline.planning.uniform import map_bounds
from skyline.render.panorama import PanoramaRenderer
from skyline.store import open_store
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.queries.synthetic import SyntheticQuery, make_queries
from skyline_bench.runs.matching import BoundsDeg, middle_deg
from skyline_bench.runs.scale import GROUPS, Found, Row, ScaleConfig, outcomes, summary

_FOUND_WITHIN_M = 1000.0
"""What the planner calls found."""
_WINDOW_DEG = 60.0
_STEP_DEG = 10.0


@dataclass(frozen=True, slots=True)
class PlacingConfig:
    """What is measured.

    Attributes
    ----------
    spacings_m : tuple of float
        Of uniform grids.
    losses : tuple of float
        Of planned places.
    bounds_deg : (float, float, float, float), optional
    queries : int
    seed : int
    """

    spacings_m: tuple[float, ...] = (320.0, 160.0, 80.0)
    losses: tuple[float, ...] = (0.35, 0.27, 0.2)
    bounds_deg: BoundsDeg | None = None
    queries: int = 150
    seed: int = 0

    def layouts(self) -> list[ScaleConfig]:
        """Return what is built and searched, one layout after the other."""
        common = ScaleConfig(
            bounds_deg=self.bounds_deg,
            areas_km2=(),
            near_km=(),
            queries=self.queries,
            seed=self.seed,
        )
        uniform = [replace(common, spacing_m=spacing) for spacing in self.spacings_m]
        return uniform + [replace(common, loss=loss) for loss in self.losses]

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
    terrain: HeightField, config: PlacingConfig, folder: Path, progress: Progress | None = None
) -> list[Row]:
    """Build each layout's store and search it; one row for each layout and group of queries.

    Stores and outcomes are kept in ``folder``: what is there is not done again.

    Raises
    ------
    InputError
        Bounds outside the DEM, a spacing or a loss that does not fit them.
    """
    area = map_bounds(terrain, config.bounds_deg)
    rows = list[Row]()
    for layout in config.layouts():
        cost, _, found = outcomes(terrain, layout, folder, progress)
        with open_store(folder / f"{cost['store']}.h5") as store:
            places = Places.concatenate(list(store.places().blocks()))
        queries = make_queries(terrain, area, layout.queries, layout.seed, layout.query)
        expected = _expected(terrain, places, queries)
        lost = np.array([not _found(one) for one in found])
        shared = {
            "layout": cost["store"],
            "places": cost["places"],
            "km2": cost["km2"],
            "bytes": cost["bytes"],
            "build_cpu_s": cost["build_cpu_s"],
            "claimed_loss": claimed_loss(places),
        }
        for group, (low, high) in GROUPS.items():
            mine = np.array([low <= one.distance_m < high for one in found])
            if mine.any():
                some = [one.outcome for one, chosen in zip(found, mine, strict=True) if chosen]
                rows.append(
                    {**shared, "group": group, **summary(some)}
                    | model_quality(expected[mine], lost[mine])
                )
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


def _found(one: Found) -> bool:
    return one.outcome.error_m is not None and one.outcome.error_m <= _FOUND_WITHIN_M


def _expected(
    terrain: HeightField, places: Places, queries: tuple[SyntheticQuery, ...]
) -> Float64Array:
    """Return how likely queries are lost, by the spacing where they were taken."""
    truths = [query.truth for query in queries]
    eyes = Viewpoints(
        *(
            np.array([getattr(truth, name) for truth in truths])
            for name in ("easting_m", "northing_m", "eye_elevation_m")
        )
    )
    there = cKDTree(np.stack([places.easting_m, places.northing_m], axis=1))
    _, nearest = there.query(np.stack([eyes.easting_m, eyes.northing_m], axis=1))
    with PanoramaRenderer(terrain, BINS) as renderer:
        distance_m = renderer.render(eyes).distance_m
    start_deg = np.array([truth.heading_deg for truth in truths]) - _WINDOW_DEG / 2.0
    window = np.rint(start_deg / _STEP_DEG).astype(np.int64) % round(360.0 / _STEP_DEG)
    return np.array(
        [
            window_losses(distance_m[[one]], np.array([2.0 * places.tolerance_m[place]]))[
                0, 0, window[one]
            ]
            for one, place in enumerate(np.asarray(nearest))
        ]
    )
