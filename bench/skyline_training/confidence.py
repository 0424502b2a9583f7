"""Learning how far a match can be believed, and showing that it can.

Synthetic queries of many kinds, some taken outside the mapped area, are matched on Sierra, Rofental
and Everest. For each query the figures of the best pose (`skyline.match.confidence`) and whether
that pose is right are an example. A logistic model is fitted to the examples with a small ridge,
and its reliability is shown on Davos. From examples that were kept another model is learned in
seconds.
"""

import json
import math
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import minimize

from skyline import MatchConfig, Matcher, build_places, read_dem
from skyline.arrays import BoolArray, Float64Array, Progress
from skyline.errors import InputError
from skyline.geodesy import Rectangle
from skyline.match import confidence
from skyline.match.candidate import DISTANCES_M, Hypotheses
from skyline.match.confidence import Logistic, model_name
from skyline.match.full import FullMatcher
from skyline.terrain.dem import DemOptions
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import Row
from skyline_bench.queries.kinds import perturbed, resampled
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, make_queries
from skyline_training.workers import over_processes

Reliability = tuple[str, Float64Array, BoolArray]
"""A label, probabilities (N,), and whether the answers were right (N,)."""

STAGES = ("refined", "retrieved")

_RIDGE = 1e-2
_BINS = 10


@dataclass(frozen=True, slots=True)
class Example:
    """The figures of the best pose of one query, and how far off it is."""

    figures: Mapping[str, float]
    error: float  # Of a place, metres; of a heading, degrees; infinite for a query of other terrain


def examples_from(
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


def learn(examples: Sequence[Example], within_m: float) -> Logistic:
    """Return the logistic model most likely to have given the examples, right within a distance.

    Examples that are all right, or all wrong, raise `InputError`.
    """
    right = np.array([example.error <= within_m for example in examples])
    if not right.any() or right.all():
        raise InputError(
            f"{int(right.sum())} of {len(examples)} examples are right; a confidence is "
            "learned from both kinds"
        )
    names = tuple(examples[0].figures)
    figures = np.array([[example.figures[name] for name in names] for example in examples])
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


def probabilities(model: Logistic, examples: Sequence[Example]) -> Float64Array:
    """Return the probability that a model gives each example, (N,)."""
    figures = {
        name: np.array([example.figures[name] for example in examples]) for name in model.names
    }
    return model.probability(figures)


def write_models(path: Path, models: Mapping[str, Logistic], about: Mapping[str, object]) -> None:
    """Write models for `matching.confidence.models`, and what they were learned from."""
    written = {"about": about, "models": models}
    path.write_text(json.dumps(written, indent=1, default=asdict) + "\n")


def calibration_error(sure: Float64Array, right: BoolArray) -> float:
    """Return the expected calibration error: mean |share right - mean probability| over bins."""
    return float(sum(share * abs(hit - mean) for mean, hit, share, _ in reliability(sure, right)))


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

Examples = dict[str, dict[str, list[Example]]]
"""Examples by terrain and stage."""

KINDS = (
    QueryConfig(fov_deg=(40.0, 90.0), noise_deg=(0.05, 0.3)),
    QueryConfig(fov_deg=(40.0, 90.0), noise_deg=(0.05, 0.3), occluded_share=(0.0, 0.4)),
)


COARSE_M = 100.0
"""Spacing of the coarse models of the same terrain."""
COARSE_KINDS = (KINDS[0], replace(KINDS[0], eye_height_m=20.0))
"""Queries in those: eyes on the ground, and on what a coarse model cuts off."""


def _examples_on(
    terrain: HeightField, strange: HeightField, folder: Path, queries: int, seed: int
) -> dict[str, list[Example]]:
    """Match queries of all kinds in the terrain's middle, and some of another; by model.

    Half of the kinds are searched in the terrain itself, and the rest in a coarse model of it.
    """
    area = middle_of(terrain, OUTSIDE)
    own = [(seen, kind) for seen in (terrain, perturbed(terrain, seed=seed)) for kind in KINDS]
    coarse = [(terrain, kind) for kind in COARSE_KINDS]
    strangers = _strangers(strange, max(queries // STRANGERS_SHARE, 1), seed)
    found: dict[str, list[Example]] = {name: [] for name in STAGES}
    for model, kinds in ((terrain, own), (resampled(terrain, COARSE_M), coarse)):
        with _matcher(model, folder) as matcher:
            for seen, kind in kinds:
                seed += 1
                made = make_queries(seen, area, queries, seed, kind)
                for name, example in examples_from(matcher, made):
                    found[name].append(example)
            for name, example in examples_from(matcher, strangers):
                found[name].append(replace(example, error=math.inf))
    return found


@contextmanager
def _matcher(terrain: HeightField, folder: Path) -> Iterator[FullMatcher]:
    """Open a matcher on places in a terrain's middle for the block."""
    west, south, east, north = middle_of(terrain)
    store = folder / f"{terrain.digest[:12]}.h5"
    lon, lat = terrain.frame.to_lonlat([west, east], [south, north])
    bounds_deg = float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])
    build_places(terrain, store, bounds_deg=bounds_deg)
    with Matcher(store, terrain) as matcher:
        ranker = matcher._ranker
        assert isinstance(ranker, FullMatcher)
        yield ranker


def middle_of(terrain: HeightField, wider: float = 1.0) -> Rectangle:
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
        for query in make_queries(terrain, middle_of(terrain), queries, seed + number, kind)
    ]


def gather(data: Path, queries: int, seed: int, progress: Progress) -> Examples:
    """Match queries on every terrain, each in a process; return the examples."""
    terrains = list(LEARNED | HELD_OUT)
    found: Examples = {}
    gathered = over_processes(partial(_gathered_on, data, queries, seed), terrains)
    for name, examples_of in zip(terrains, gathered, strict=True):
        found[name] = examples_of
        progress(len(found), len(terrains))
    return found


def _gathered_on(data: Path, queries: int, seed: int, name: str) -> dict[str, list[Example]]:
    """Match so many queries of each kind, drawn by a seed, on one terrain; examples by stage."""
    terrain, strange = (
        read_dem([data / path], options)
        for path, options in ((LEARNED | HELD_OUT)[one] for one in (name, STRANGERS[name]))
    )
    with tempfile.TemporaryDirectory() as folder:
        return _examples_on(terrain, strange, Path(folder), queries, seed)


def read_examples(path: Path) -> Examples:
    """Read what `write_examples` wrote."""
    return {
        terrain: {stage: [Example(**one) for one in some] for stage, some in stages.items()}
        for terrain, stages in json.loads(path.read_text()).items()
    }


def write_examples(examples: Examples, path: Path) -> None:
    """Write examples, so that another model can be learned from the same matches."""
    path.write_text(json.dumps(examples, default=asdict))


@dataclass(frozen=True, slots=True, eq=False)
class Learned:
    """The models that examples teach, and how well they do."""

    models: dict[str, Logistic]
    about: dict[str, object]  # The origin of the examples
    rows: list[Row]  # How well each does on each terrain
    shown: list[Reliability]  # On the terrains held out


def learn_all(examples: Examples) -> Learned:
    """Learn a model of each kind, and measure it on every terrain."""
    learned_from = {
        stage: [one for name in LEARNED for one in examples[name][stage]] for stage in STAGES
    }
    models: dict[str, Logistic] = {}
    rows: list[Row] = []
    shown: list[Reliability] = []
    for stage, within_m in product(STAGES, DISTANCES_M):
        model = model_name(stage, within_m)
        models[model] = learn(learned_from[stage], within_m)
        for name, one in examples.items():
            sure = probabilities(models[model], one[stage])
            right = np.array([example.error <= within_m for example in one[stage]])
            rows.append(rated(model, name, sure, right))
            if name in HELD_OUT:
                shown.append((f"{model}, {name}", sure, right))
    counts = {stage: len(some) for stage, some in learned_from.items()}
    return Learned(models, {"terrain": list(LEARNED), "examples": counts}, rows, shown)


def rated(
    model: str,
    terrain: str,
    sure: Float64Array,
    right: BoolArray,
    least: float = MatchConfig().min_confidence,
) -> Row:
    """Return how well the probabilities (N,) of a model hold on a terrain."""
    answered = sure >= least
    return {
        "model": model,
        "terrain": terrain,
        "held_out": terrain in HELD_OUT,
        "n": len(right),
        "right": float(right.mean()),
        "calibration_error": calibration_error(sure, right),
        "answered": float(answered.mean()),
        "precision": float(right[answered].mean()) if answered.any() else None,
    }


def save_reliability(path: Path, shown: Iterable[Reliability]) -> None:
    """Save the reliability diagram: how often answers are right against their confidence."""
    figure = Figure(figsize=(6.4, 6.6), layout="constrained")
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], ":", color="black", linewidth=0.8)
    for name, sure, right in shown:
        mean, hit, share, spread = np.array(reliability(sure, right)).T
        error = calibration_error(sure, right)
        label = f"{name}: {len(sure)} queries, calibration error {error:.3f}"
        bars = axis.errorbar(mean, hit, spread, marker="o", capsize=2, label=label)
        colour = bars.lines[0].get_color()
        for x, y, part in zip(mean, hit, share, strict=True):
            count = f"{part * len(sure):.0f}"
            axis.annotate(
                count, (x, y), (4, -10), textcoords="offset points", fontsize=8, color=colour
            )
    axis.set(xlim=(0, 1), ylim=(0, 1.02), xlabel="confidence", ylabel="share right")
    axis.set_title("Learned on Sierra, Rofental and Everest")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.1))
    figure.savefig(path, dpi=110)
