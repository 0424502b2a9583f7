"""Learning the confidence of a heading at a known place.

Synthetic queries, and photographs drawn of the terrain, are oriented from places that are off by
their stated error; strangers, photos of other terrain, from any place. Lenses are known in three
ways, as in the examples of matches. The figures of a best pose
(`skyline.match.confidence.oriented_figures`) and the error of its heading are an example.
"""

import math
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from skyline import Orienter
from skyline.angles import angle_between_deg
from skyline.errors import SkylineError
from skyline.match import confidence
from skyline.match.confidence import ORIENTED, Logistic
from skyline.match.narrowing import Narrowing
from skyline.orientation.orienter import KnownPosition, orienters
from skyline.orientation.result import LEAST_CONFIDENCE, RIGHT_DEG
from skyline.progress import Progress
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring import Row
from skyline_bench.queries.kinds import perturbed, resampled
from skyline_bench.queries.synthetic import SyntheticQuery, make_queries
from skyline_training.confidence import learn, probabilities, rated
from skyline_training.examples import (
    COARSE_M,
    KINDS,
    LEARNED,
    PHOTO,
    Example,
    built_of,
    on_each_terrain,
    photographed,
    read_terrains,
    strangers_of,
    with_lenses,
)

POSITION_SDS_M = (15.0, 50.0, 100.0)
"""Standard deviations of the positions, drawn in turn."""


def gather_headings(
    data: Path, queries: int, seed: int, progress: Progress
) -> dict[str, list[Example]]:
    """Orient queries of each kind on every terrain; return the examples.

    Each terrain has a process of its own.
    """
    return on_each_terrain(partial(_gathered_on, data, queries, seed), progress)


def _gathered_on(data: Path, queries: int, seed: int, name: str) -> list[Example]:
    """Orient queries of one terrain; return the examples.

    There are queries of the terrain, of others like it and of a coarse model, and strangers.
    """
    terrain, strange = read_terrains(data, name)
    area = built_of(terrain)
    other, coarse = perturbed(terrain, seed=seed), resampled(terrain, COARSE_M)
    own = [(terrain, terrain, kind) for kind in KINDS] + [(terrain, other, kind) for kind in KINDS]
    examples = list[Example]()
    for number, (model, seen, kind) in enumerate([*own, (coarse, terrain, KINDS[0])], seed):
        made = with_lenses(make_queries(seen, area, queries, number, kind), number)
        examples += _oriented(model, made, number, is_strange=False)
    taken = with_lenses(make_queries(terrain, area, queries, seed + 9, PHOTO), seed + 9)
    examples += _oriented(terrain, photographed(terrain, taken, seed), seed + 9, is_strange=False)
    strangers = strangers_of(strange, queries, seed)
    return [*examples, *_oriented(terrain, strangers, seed + 100, is_strange=True)]


def _oriented(
    model: HeightField, queries: Iterable[SyntheticQuery], seed: int, *, is_strange: bool
) -> Iterator[Example]:
    """Orient queries on a model.

    Places are drawn about the true ones; strangers have any place.
    """
    rng = np.random.default_rng([seed, 1])
    west, south, east, north = built_of(model)
    with orienters(model) as orienter_at:
        for number, query in enumerate(queries):
            position_sd_m, truth = POSITION_SDS_M[number % len(POSITION_SDS_M)], query.truth
            off = position_sd_m / math.sqrt(2.0) * rng.standard_normal(2)
            place = truth.easting_m + off[0], truth.northing_m + off[1]
            if is_strange:
                place = rng.uniform(west, east), rng.uniform(south, north)
            lon, lat = map(float, model.frame.to_lonlat(*place))
            try:
                found = _figures_of(
                    orienter_at(KnownPosition(lon, lat, None, position_sd_m)), query
                )
            except SkylineError:  # The place is on a hole.
                continue
            if found is not None:
                figures, heading_deg = found
                off_deg = float(angle_between_deg(heading_deg, truth.grid_heading_deg))
                yield Example(figures, math.inf if is_strange else off_deg)


def _figures_of(orienter: Orienter, query: SyntheticQuery) -> tuple[dict[str, float], float] | None:
    """Return the figures of the best pose, and its grid heading.

    None if nothing fits.
    """
    if not query.skyline.trusted.any():
        return None
    rays = query.rays()
    poses = orienter._refined(rays, query.skyline, Narrowing())
    if not len(poses):
        return None
    figures = confidence.oriented_figures(poses, rays, orienter._moved_m(poses))
    first = {name: float(values[0]) for name, values in figures.items()}
    return first, float(poses.grid_heading_deg[0])


def learn_orientation(
    examples: dict[str, list[Example]],
) -> tuple[Logistic, list[Row]]:
    """Learn the model, and test it on every terrain."""
    model = learn([one for name in LEARNED for one in examples[name]], RIGHT_DEG)
    rows = [
        rated(
            ORIENTED,
            name,
            probabilities(model, some),
            np.array([example.error <= RIGHT_DEG for example in some]),
            LEAST_CONFIDENCE,
        )
        for name, some in examples.items()
    ]
    return model, rows
