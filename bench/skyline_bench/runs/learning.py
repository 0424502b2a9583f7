"""Learn the confidence on Sierra, Rofental and Everest, show its reliability on Davos.

From examples that were kept another model is learned in seconds.
"""

import json
import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from skyline import MatchConfig, read_dem
from skyline.arrays import Float64Array
from skyline.matching.confidence import DISTANCES_M, Logistic, model_name
from skyline.matching.full import FullMatcher
from skyline.matching.retrieval import Retriever
from skyline.pipeline.build import build_places
from skyline.pipeline.jobs import Progress
from skyline.pipeline.scene import RenderedScene
from skyline.store import open_store
from skyline.terrain.dem import DemOptions
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.workers import crew
from skyline_bench.queries.other_dems import perturbed, resampled
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, make_queries
from skyline_bench.runs.calibration import (
    STAGES,
    Example,
    Reliability,
    calibration_error,
    examples,
    learn,
    probabilities,
)

SIDE_M = 6_000.0
OUTSIDE = 1.35
"""Queries come from an area this much wider than the store: nearly half from outside it."""

LEARNED = {
    "sierra": ("sierra/sierra_ansel_adams_30m_albers.tif", DemOptions(reproject=True)),
    "rofental": ("rofental/dem_rofental_50.asc", DemOptions(crs="EPSG:32632")),
    "everest": ("everest/mt_everest_90m.tif", DemOptions()),
}
HELD_OUT = {"davos": ("davos/davos_srtm1_30m.tif", DemOptions())}

STRANGERS = {"sierra": "rofental", "rofental": "sierra", "everest": "rofental", "davos": "sierra"}
"""Terrain -> one whose skylines its store must refuse."""
STRANGERS_SHARE = 5
"""One stranger to so many queries of a kind."""

Told = dict[str, dict[str, list[Example]]]
"""Examples by terrain and model."""

KINDS = (
    QueryConfig(fov_deg=(40.0, 90.0), noise_deg=(0.05, 0.3)),
    QueryConfig(fov_deg=(40.0, 90.0), noise_deg=(0.05, 0.3), occluded_share=(0.0, 0.4)),
)


COARSE_M = 100.0
"""Spacing of the coarse models of the same terrain."""
COARSE_KINDS = (KINDS[0], replace(KINDS[0], eye_height_m=20.0))
"""What is looked for in those: eyes on the ground, and on what a coarse model cuts off."""


def _told_by(
    terrain: HeightField, strange: HeightField, folder: Path, queries: int, seed: int
) -> dict[str, list[Example]]:
    """Match queries of all kinds in the terrain's middle, and some of another; by model.

    Half of the kinds are searched in the terrain itself, and the rest in a coarse model of it.
    """
    middle, half = _middle_of(terrain)
    area = (*(middle - OUTSIDE * half), *(middle + OUTSIDE * half))
    own = [(seen, kind) for seen in (terrain, perturbed(terrain, seed=seed)) for kind in KINDS]
    coarse = [(terrain, kind) for kind in COARSE_KINDS]
    strangers = _strangers(strange, max(queries // STRANGERS_SHARE, 1), seed)
    told: dict[str, list[Example]] = {name: [] for name in STAGES}
    for model, kinds in ((terrain, own), (resampled(terrain, COARSE_M), coarse)):
        with _matcher(model, folder) as matcher:
            for seen, kind in kinds:
                seed += 1
                made = make_queries(seen, area, queries, seed, replace(kind, fov_error=0.05))
                _tell(told, matcher, made)
            for made in strangers:
                _tell(told, matcher, made, strange=True)
    return told


def _tell(
    told: dict[str, list[Example]],
    matcher: FullMatcher,
    queries: tuple[SyntheticQuery, ...],
    strange: bool = False,
) -> None:
    """Add examples of queries; strangers are never right."""
    for example in examples(matcher, queries):
        for name, one in example.items():
            told[name].append(replace(one, error_m=math.inf) if strange else one)


@contextmanager
def _matcher(terrain: HeightField, folder: Path) -> Iterator[FullMatcher]:
    """Open a matcher on places in a terrain's middle for the block."""
    middle, half = _middle_of(terrain)
    store = folder / f"{terrain.digest[:12]}.h5"
    lon, lat = terrain.frame.to_lonlat(*(middle[:, np.newaxis] + [[-half, half], [-half, half]]))
    bounds_deg = float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])
    build_places(terrain, store, bounds_deg=bounds_deg)
    with open_store(store) as opened:
        scene = RenderedScene.of_store(terrain, opened.header, MatchConfig())
        places = opened.places()
        yield FullMatcher(Retriever(places, terrain.height_at, edge=scene.edge), scene)
        scene.release()


def _middle_of(terrain: HeightField) -> tuple[Float64Array, float]:
    """Return the middle of a terrain and half the side of the square that is built there."""
    west, south, east, north = terrain.bounds_m
    middle = np.array([(west + east) / 2.0, (south + north) / 2.0])
    return middle, 0.5 * min(SIDE_M, 0.7 * (east - west), 0.7 * (north - south))


def _strangers(terrain: HeightField, queries: int, seed: int) -> list[tuple[SyntheticQuery, ...]]:
    """Make queries of every kind, and plain ones, in a terrain's middle."""
    middle, half = _middle_of(terrain)
    area = (*(middle - half), *(middle + half))
    return [
        make_queries(terrain, area, queries, seed + number, replace(kind, fov_error=0.05))
        for number, kind in enumerate((*KINDS, QueryConfig()), start=100)
    ]


def matched(data: Path, queries: int, seed: int, progress: Progress) -> Told:
    """Match queries on every terrain, each in a process; examples by terrain and model."""
    terrains = LEARNED | HELD_OUT
    told: Told = {}
    with crew((data, queries, seed), os.cpu_count() or 1) as work:
        for name, one in work(_matched_on, list(terrains)):
            told[name] = one
            progress(len(told), len(terrains))
    return {name: told[name] for name in terrains}


def _matched_on(asked: tuple[Path, int, int], name: str) -> dict[str, list[Example]]:
    """Match as many queries as asked of a kind, by a seed, on one terrain; examples by model."""
    data, queries, seed = asked
    terrain, strange = (
        read_dem([data / path], options)
        for path, options in ((LEARNED | HELD_OUT)[one] for one in (name, STRANGERS[name]))
    )
    with tempfile.TemporaryDirectory() as folder:
        return _told_by(terrain, strange, Path(folder), queries, seed)


def kept(path: Path) -> Told:
    """Read examples that `keep` wrote."""
    return {
        terrain: {model: [Example(**one) for one in some] for model, some in models.items()}
        for terrain, models in json.loads(path.read_text()).items()
    }


def keep(told: Told, path: Path) -> None:
    """Write examples, so that another model can be learned from the same matches."""
    written = {
        terrain: {model: [asdict(one) for one in some] for model, some in models.items()}
        for terrain, models in told.items()
    }
    path.write_text(json.dumps(written))


@dataclass(frozen=True, slots=True, eq=False)
class Learned:
    """What examples teach.

    Attributes
    ----------
    models : dict of str to Logistic
    about : dict
        What they were learned from.
    rows : list of dict
        How well each does on each terrain.
    shown : list of (str, (N,) float64, (N,) bool)
        On the terrains held out: a label, probabilities, and whether the answers were right.
    """

    models: dict[str, Logistic]
    about: dict[str, object]
    rows: list[Row]
    shown: list[Reliability]


def learned(told: Told) -> Learned:
    """Learn a model of each kind, and hold it to every terrain."""
    learned_from = {
        stage: [one for name in LEARNED for one in told[name][stage]] for stage in STAGES
    }
    models = {
        model_name(stage, within_m): learn(some, within_m)
        for stage, some in learned_from.items()
        for within_m in DISTANCES_M
    }
    rows: list[Row] = []
    shown: list[Reliability] = []
    for stage, within_m in product(STAGES, DISTANCES_M):
        model = model_name(stage, within_m)
        for name, one in told.items():
            sure = probabilities(models[model], one[stage])
            right = np.array([example.error_m <= within_m for example in one[stage]])
            answered = sure >= MatchConfig().min_confidence
            rows.append(
                {
                    "model": model,
                    "terrain": name,
                    "held_out": name in HELD_OUT,
                    "n": len(right),
                    "right": float(right.mean()),
                    "calibration_error": calibration_error(sure, right),
                    "answered": float(answered.mean()),
                    "precision": float(right[answered].mean()) if answered.any() else None,
                }
            )
            if name in HELD_OUT:
                shown.append((f"{model}, {name}", sure, right))
    counts = {stage: len(some) for stage, some in learned_from.items()}
    return Learned(models, {"terrain": list(LEARNED), "examples": counts}, rows, shown)
