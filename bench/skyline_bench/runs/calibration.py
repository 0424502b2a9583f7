"""Learning how far a match can be believed, and showing that it can.

Synthetic queries of many kinds, some taken outside the mapped area, are matched on Sierra, Rofental
and Everest. For each the figures of the best pose (`matching.confidence`) and whether it is right
are an example; a logistic model is fitted to them with a small ridge, and its reliability is shown
on Davos. From examples that were kept another model is learned in seconds.
"""

import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from skyline import MatchConfig, read_dem
from skyline.arrays import BoolArray, Float64Array
from skyline.build.cluster import Progress
from skyline.build.parts import build_places
from skyline.errors import InputError
from skyline.geodesy import Rectangle
from skyline.matching import confidence
from skyline.matching.confidence import DISTANCES_M, Logistic, model_name
from skyline.matching.full import FullMatcher
from skyline.matching.hypotheses import Hypotheses
from skyline.matching.retrieval import Retriever
from skyline.pipeline.rendered_scene import RenderedScene
from skyline.store import open_store
from skyline.terrain.dem import DemOptions
from skyline.terrain.heightfield import HeightField, ground_of
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.workers import crew
from skyline_bench.queries.other_dems import perturbed, resampled
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, make_queries

Reliability = tuple[str, Float64Array, BoolArray]
"""A label, probabilities (N,), and whether the answers were right."""

STAGES = ("refined", "retrieved")

_RIDGE = 1e-2
_BINS = 10


@dataclass(frozen=True, slots=True)
class Example:
    """The best pose of one query: what the match left behind, and how far off it is."""

    figures: Mapping[str, float]
    error_m: float  # Infinite for a query from elsewhere


def examples(
    matcher: FullMatcher, queries: Sequence[SyntheticQuery]
) -> Iterator[tuple[str, Example]]:
    """Yield stages and examples of each query; queries that nothing fits give none."""
    for query in queries:
        try:
            rays = query.rays()
        except InputError:
            continue
        found = matcher.retrieve(rays)
        poses = matcher.refine(found, rays)
        if len(found):
            yield "retrieved", _example(confidence.retrieved_figures(found, rays), found, query)
        if poses is not None and len(poses):
            figures = confidence.refined_figures(poses, found, rays)
            yield "refined", _example(figures, poses.hypotheses, query)


def _example(figures: dict[str, Float64Array], poses: Hypotheses, query: SyntheticQuery) -> Example:
    best = int(np.argmin(poses.score))
    return Example(
        {name: float(values[best]) for name, values in figures.items()},
        float(query.truth.off_m(poses.easting_m[best], poses.northing_m[best])),
    )


def learn(told: Sequence[Example], within_m: float) -> Logistic:
    """Return the logistic model most likely to have given the examples, right within a distance.

    Examples that are all right, or all wrong, raise `InputError`.
    """
    right = np.array([example.error_m <= within_m for example in told])
    if not right.any() or right.all():
        raise InputError(
            f"{int(right.sum())} of {len(told)} examples are right; a confidence is learned from "
            "both kinds"
        )
    names = tuple(told[0].figures)
    figures = np.array([[example.figures[name] for name in names] for example in told])
    mean, scale = figures.mean(axis=0), np.maximum(figures.std(axis=0), 1e-9)
    unit = (figures - mean) / scale
    sign = np.where(right, 1.0, -1.0)

    def loss(parameters: Float64Array) -> tuple[float, Float64Array]:
        logit = sign * (unit @ parameters[:-1] + parameters[-1])
        pull = -sign / (1.0 + np.exp(logit)) / len(sign)
        ridge = _RIDGE * parameters[:-1]
        gradient = np.append(unit.T @ pull + ridge, pull.sum())
        return float(np.logaddexp(0.0, -logit).mean() + 0.5 * ridge @ parameters[:-1]), gradient

    best = minimize(loss, np.zeros(len(names) + 1), jac=True, method="L-BFGS-B").x
    return Logistic(
        names, tuple(mean.tolist()), tuple(scale.tolist()), tuple(best[:-1]), float(best[-1])
    )


def probabilities(model: Logistic, told: Sequence[Example]) -> Float64Array:
    """Return what a model says of examples, (N,)."""
    figures = {name: np.array([example.figures[name] for example in told]) for name in model.names}
    return model.probability(figures)


def write_models(path: Path, models: Mapping[str, Logistic], about: Mapping[str, object]) -> None:
    """Write models for `matching.confidence.models`, and what they were learned from."""
    written = {"about": about, "models": models}
    path.write_text(json.dumps(written, indent=1, default=asdict) + "\n")


def calibration_error(sure: Float64Array, right: BoolArray) -> float:
    """Return the expected calibration error: mean |share right - mean probability| over bins."""
    return float(sum(share * abs(hit - said) for said, hit, share, _ in reliability(sure, right)))


def reliability(sure: Float64Array, right: BoolArray) -> list[tuple[float, float, float, float]]:
    """Return mean probability, share right, share of all and standard error of filled bins."""
    bin_ = np.minimum((sure * _BINS).astype(int), _BINS - 1)
    rows = []
    for index in np.unique(bin_):
        here = bin_ == index
        hit, count = float(right[here].mean()), int(here.sum())
        spread = np.sqrt(max(hit * (1.0 - hit), 0.25 / count) / count)
        rows.append((float(sure[here].mean()), hit, count / len(sure), float(spread)))
    return rows


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
    area = _middle_of(terrain, OUTSIDE)
    own = [(seen, kind) for seen in (terrain, perturbed(terrain, seed=seed)) for kind in KINDS]
    coarse = [(terrain, kind) for kind in COARSE_KINDS]
    strangers = _strangers(strange, max(queries // STRANGERS_SHARE, 1), seed)
    told: dict[str, list[Example]] = {name: [] for name in STAGES}
    for model, kinds in ((terrain, own), (resampled(terrain, COARSE_M), coarse)):
        with _matcher(model, folder) as matcher:
            for seen, kind in kinds:
                seed += 1
                made = make_queries(seen, area, queries, seed, kind)
                for name, example in examples(matcher, made):
                    told[name].append(example)
            for name, example in examples(matcher, strangers):
                told[name].append(replace(example, error_m=math.inf))
    return told


@contextmanager
def _matcher(terrain: HeightField, folder: Path) -> Iterator[FullMatcher]:
    """Open a matcher on places in a terrain's middle for the block."""
    west, south, east, north = _middle_of(terrain)
    store = folder / f"{terrain.digest[:12]}.h5"
    lon, lat = terrain.frame.to_lonlat([west, east], [south, north])
    bounds_deg = float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])
    build_places(terrain, store, bounds_deg=bounds_deg)
    with open_store(store) as opened:
        scene = RenderedScene.of_store(terrain, opened.header, MatchConfig())
        places = opened.places()
        yield FullMatcher(Retriever(places, ground_of(terrain), edge=scene.edge), scene)
        scene.release()


def _middle_of(terrain: HeightField, wider: float = 1.0) -> Rectangle:
    """Return the square in a terrain's middle that is built, or one so much wider."""
    west, south, east, north = terrain.bounds_m
    half = 0.5 * min(SIDE_M, 0.7 * (east - west), 0.7 * (north - south))
    middle = np.array([(west + east) / 2.0, (south + north) / 2.0])
    return (*(middle - wider * half), *(middle + wider * half))


def _strangers(terrain: HeightField, queries: int, seed: int) -> list[SyntheticQuery]:
    """Make queries of every kind, and plain ones, in a terrain's middle."""
    return [
        query
        for number, kind in enumerate((*KINDS, QueryConfig()), start=100)
        for query in make_queries(terrain, _middle_of(terrain), queries, seed + number, kind)
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
    path.write_text(json.dumps(told, default=asdict))


@dataclass(frozen=True, slots=True, eq=False)
class Learned:
    """What examples teach."""

    models: dict[str, Logistic]
    about: dict[str, object]  # What they were learned from
    rows: list[Row]  # How well each does on each terrain
    shown: list[Reliability]  # On the terrains held out


def learned(told: Told) -> Learned:
    """Learn a model of each kind, and hold it to every terrain."""
    learned_from = {
        stage: [one for name in LEARNED for one in told[name][stage]] for stage in STAGES
    }
    models: dict[str, Logistic] = {}
    rows: list[Row] = []
    shown: list[Reliability] = []
    for stage, within_m in product(STAGES, DISTANCES_M):
        model = model_name(stage, within_m)
        models[model] = learn(learned_from[stage], within_m)
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
