"""Learning the confidence of a match from examples, and testing its reliability.

A pose is right if it lies near the truth and looks the same way. A logistic model is fitted to the
examples of Sierra, Rofental and Everest with a small ridge, and its reliability is shown on Davos.
If the examples are kept, another model is learned in seconds.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import minimize

from skyline import MatchConfig
from skyline.arrays import BoolArray, Float64Array
from skyline.errors import InputError
from skyline.files.disk import write_whole
from skyline.match.confidence import Logistic, model_name
from skyline.pose.pose import DISTANCES_M
from skyline_bench.measuring import Row
from skyline_training.examples import HELD_OUT, LEARNED, STAGES, Example, Examples

Reliability = tuple[str, Float64Array, BoolArray]
"""A label, probabilities (N,), and whether the answers were right (N,)."""

_RIDGE = 1e-3
"""Examples of terrain and of kinds left out are equally likely with ridges of 3e-4 to 3e-3. A
larger ridge pulls all probabilities to the middle."""
_BETTER_HIGH = {
    "inlier_share", "log_columns", "log_skyline", "log_odds", "log_far_margin", "margin",
    "log_margin", "lead", "far_lead",
}  # fmt: skip
_BETTER_LOW = {
    "cost", "log_residual", "log_position_sd", "log_height_sd", "log_heading_sd", "log_moved",
    "lens_deviations", "roll_deg", "warp_deviations",
}  # fmt: skip
"""Figures that never make a pose less likely to be right when they rise, or when they fall. The
others describe the photo, and may act either way."""
_OUTSIDE_WEIGHT = 0.5
"""Weight of queries that were taken outside the area searched, strangers among them. More than half
of the examples are such queries, so that there are enough to learn from; among real photos they are
rarer."""
_BINS = 10


def learn(examples: Sequence[Example], within_m: float) -> Logistic:
    """Return the logistic model that most likely gave the examples.

    An example is right if its error is at most ``within_m``. Raises `InputError` for examples that
    are all right, or all wrong.
    """
    right = np.array([example.error <= within_m for example in examples])
    if not right.any() or right.all():
        raise InputError(
            f"{int(right.sum())} of {len(examples)} examples are right; a confidence is "
            "learned from both kinds"
        )
    names = list(examples[0].figures)
    figures = _figures(names, examples)
    mean = [float(figures[name].mean()) for name in names]
    scale = [max(float(figures[name].std()), 1e-9) for name in names]
    parts = Logistic(names, mean, scale, (), 0.0).segments(figures)
    _, count, segments = parts.shape
    terms, sign = parts.reshape(len(examples), -1), np.where(right, 1.0, -1.0)
    weight = np.where([one.is_outside for one in examples], _OUTSIDE_WEIGHT, 1.0)
    weight /= weight.sum()

    def loss_of(parameters: Float64Array) -> tuple[float, Float64Array]:
        logit = sign * (terms @ parameters[:-1] + parameters[-1])
        pull = -sign * weight / (1.0 + np.exp(logit))
        ridge = _RIDGE * parameters[:-1]
        gradient = np.append(terms.T @ pull + ridge, pull.sum())
        loss = weight @ np.logaddexp(0.0, -logit) + 0.5 * ridge @ parameters[:-1]
        return float(loss), gradient

    limits = [_limits_of_slope(name) for name in names for _ in range(segments)]
    best = minimize(
        loss_of,
        np.zeros(terms.shape[1] + 1),
        jac=True,
        method="L-BFGS-B",
        bounds=[*limits, (None, None)],
    ).x
    return Logistic(
        names, mean, scale, best[:-1].reshape(count, segments).tolist(), float(best[-1])
    )


def _limits_of_slope(name: str) -> tuple[float | None, float | None]:
    """Return the least and the greatest slope of a figure, or None."""
    return 0.0 if name in _BETTER_HIGH else None, 0.0 if name in _BETTER_LOW else None


def probabilities(model: Logistic, examples: Sequence[Example]) -> Float64Array:
    """Return the probability that a model gives each example, (N,)."""
    return model.probability(_figures(model.names, examples))


def _figures(names: Iterable[str], examples: Sequence[Example]) -> dict[str, Float64Array]:
    return {name: np.array([one.figures[name] for one in examples]) for name in names}


def write_models(path: Path, models: Mapping[str, Logistic], about: Mapping[str, object]) -> None:
    """Write models for `skyline.match.confidence`, and what they were learned from."""
    written = {"about": about, "models": models}
    write_whole(path, json.dumps(written, default=asdict) + "\n")


def calibration_error(sure: Float64Array, right: BoolArray) -> float:
    """Return the expected calibration error: mean |share right - mean probability| over bins."""
    return float(sum(share * abs(hit - mean) for mean, hit, share, _ in reliability(sure, right)))


def reliability(sure: Float64Array, right: BoolArray) -> list[tuple[float, float, float, float]]:
    """Return the reliability of probabilities in bins.

    Each filled bin has its mean probability, share right, share of all and standard error.
    """
    bin_ = np.minimum((sure * _BINS).astype(int), _BINS - 1)
    rows = []
    for index in np.unique(bin_):
        here = bin_ == index
        hit, count = float(right[here].mean()), int(here.sum())
        spread = np.sqrt(max(hit * (1.0 - hit), 0.25 / count) / count)
        rows.append((float(sure[here].mean()), hit, count / len(sure), float(spread)))
    return rows


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
        rows.append(_left_out(model, examples, stage, within_m))
        for name, one in examples.items():
            sure = probabilities(models[model], one[stage])
            right = np.array([example.error <= within_m for example in one[stage]])
            turn_deg = np.array([example.turn_deg for example in one[stage]])
            kinds = np.array([example.kind for example in one[stage]])
            rows.append(_rated_kind(model, name, "all", sure, right, turn_deg))
            if name in HELD_OUT:
                shown.append((f"{model}, {name}", sure, right))
                for kind in np.unique(kinds).tolist():
                    here = kinds == kind
                    rows.append(
                        _rated_kind(model, name, kind, sure[here], right[here], turn_deg[here])
                    )
    counts = {stage: len(some) for stage, some in learned_from.items()}
    return Learned(models, {"terrain": list(LEARNED), "examples": counts}, rows, shown)


def _left_out(model: str, examples: Examples, stage: str, within_m: float) -> Row:
    """Return how well probabilities hold on each terrain.

    They are learned from all other terrains.
    """
    sure, right, turn_deg = [], [], []
    for name, some in examples.items():
        others = [one for other in examples if other != name for one in examples[other][stage]]
        learned = learn(others, within_m)
        sure.append(probabilities(learned, some[stage]))
        right += [example.error <= within_m for example in some[stage]]
        turn_deg += [example.turn_deg for example in some[stage]]
    found = np.concatenate(sure), np.array(right), np.array(turn_deg)
    return {**_rated_kind(model, "each, left out", "all", *found), "held_out": True}


def _rated_kind(
    model: str,
    terrain: str,
    kind: str,
    sure: Float64Array,
    right: BoolArray,
    turn_deg: Float64Array,
) -> Row:
    """Return how well a kind's probabilities hold, and its worst answered heading."""
    row = rated(model, terrain, sure, right)
    answered = turn_deg[(sure >= MatchConfig().min_confidence) & np.isfinite(turn_deg)]
    return {**row, "kind": kind, "worst_turn_deg": float(answered.max()) if len(answered) else None}


def rated(
    model: str,
    terrain: str,
    sure: Float64Array,
    right: BoolArray,
    least: float = MatchConfig().min_confidence,
) -> Row:
    """Return how well a model's probabilities (N,) hold on a terrain."""
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
    """Save a diagram of how often answers are right, by confidence."""
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
