"""Learning how far a match can be believed, and showing that it can.

Synthetic queries of many kinds, some taken outside the mapped area, are matched on terrain that no
result is reported on. For each the figures of the best pose (`matching.confidence`) and whether
it is right are an example; a logistic model is fitted to them with a small ridge.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from skyline.arrays import BoolArray, Float64Array
from skyline.errors import InputError
from skyline.matching import confidence
from skyline.matching.confidence import Logistic
from skyline.matching.full import FullMatcher
from skyline.matching.hypotheses import Hypotheses
from skyline_bench.queries.synthetic import SyntheticQuery

Reliability = tuple[str, Float64Array, BoolArray]
"""A label, probabilities (N,), and whether the answers were right."""

STAGES = ("refined", "retrieved")

_RIDGE = 1e-2
_BINS = 10


@dataclass(frozen=True, slots=True)
class Example:
    """The best pose of one query: what the match left behind, and how far off it is.

    Attributes
    ----------
    figures : mapping of str to float
    error_m : float
        Infinite for a query from elsewhere.
    """

    figures: Mapping[str, float]
    error_m: float


def examples(
    matcher: FullMatcher, queries: Sequence[SyntheticQuery]
) -> Iterator[dict[str, Example]]:
    """Yield an example for each stage and query; queries that nothing fits give none."""
    for query in queries:
        try:
            rays = query.rays()
        except InputError:
            continue
        found = matcher.retrieve(rays)
        poses = matcher.refine(found, rays)
        told: dict[str, Example] = {}
        if len(found):
            figures = confidence.retrieved_figures(found, rays)
            told["retrieved"] = _example(figures, found, query)
        if poses is not None and len(poses):
            figures = confidence.refined_figures(poses, found, rays)
            told["refined"] = _example(figures, poses.hypotheses, query)
        yield told


def _example(figures: dict[str, Float64Array], poses: Hypotheses, query: SyntheticQuery) -> Example:
    best = int(np.argmin(poses.score))
    east_m = poses.easting_m[best] - query.truth.easting_m
    north_m = poses.northing_m[best] - query.truth.northing_m
    return Example(
        {name: float(values[best]) for name, values in figures.items()},
        float(np.hypot(east_m, north_m)),
    )


def learn(told: Sequence[Example], within_m: float) -> Logistic:
    """Return the logistic model most likely to have given the examples, right within a distance.

    Raises
    ------
    InputError
        All examples are right, or all wrong.
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
    written = {name: asdict(model) for name, model in models.items()}
    path.write_text(json.dumps({"about": about, "models": written}, indent=1) + "\n")


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
