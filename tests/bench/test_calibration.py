"""Learning how far a match can be believed, from examples whose odds are known."""

import numpy as np
import pytest

from skyline.errors import InputError
from skyline.matching import confidence
from skyline_bench.figures.plots import save_reliability
from skyline_bench.runs.calibration import (
    Example,
    calibration_error,
    learn,
    probabilities,
    write_models,
)

NEAR_M = confidence.RIGHT_WITHIN_M


def hits(examples: list[Example]) -> np.ndarray:
    return np.array([one.error_m <= NEAR_M for one in examples])


def told(count: int, seed: int) -> list[Example]:
    """Examples whose odds of being right are exp(2 a - 1), whatever b is."""
    generator = np.random.default_rng(seed)
    figures = generator.normal(size=(count, 2))
    right = generator.random(count) < 1.0 / (1.0 + np.exp(1.0 - 2.0 * figures[:, 0]))
    return [
        Example({"a": float(a), "b": float(b)}, 0.0 if hit else np.inf)
        for (a, b), hit in zip(figures, right, strict=True)
    ]


def test_what_decides_is_learned_and_what_does_not_is_ignored() -> None:
    model = learn(told(4000, seed=1), NEAR_M)
    weight = np.array(model.weight) / np.array(model.scale)
    assert weight[0] == pytest.approx(2.0, abs=0.35)
    assert weight[1] == pytest.approx(0.0, abs=0.15)


def test_a_learned_probability_is_a_frequency() -> None:
    model = learn(told(4000, seed=2), NEAR_M)
    others = told(4000, seed=3)
    sure, right = probabilities(model, others), hits(others)
    assert calibration_error(sure, right) < 0.03
    assert calibration_error(np.minimum(sure + 0.3, 1.0), right) > 0.15


@pytest.mark.parametrize("error_m", [10.0, 300.0])
def test_one_kind_of_examples_teaches_nothing(error_m: float) -> None:
    with pytest.raises(InputError, match="both"):
        learn([Example({"a": 0.0}, error_m), Example({"a": 1.0}, error_m)], NEAR_M)


def test_a_model_is_of_its_distance() -> None:
    examples = [
        Example({"a": float(far)}, 150.0 if far < 1 else 700.0 if far < 2 else 5000.0)
        for far in np.random.default_rng(6).uniform(0.0, 3.0, 900)
    ]
    near, roughly = (learn(examples, within_m) for within_m in confidence.DISTANCES_M)
    sure = {"a": np.array([0.2, 1.5, 2.8])}
    assert (near.probability(sure) > 0.5).tolist() == [True, False, False]
    assert (roughly.probability(sure) > 0.5).tolist() == [True, True, False]


def test_models_are_written_as_they_are_read(tmp_path, monkeypatch) -> None:
    model = learn(told(300, seed=4), NEAR_M)
    names = [confidence.model_name("refined", within_m) for within_m in confidence.DISTANCES_M]
    write_models(tmp_path / "confidence.json", dict.fromkeys(names, model), {"seed": 4})
    monkeypatch.setattr(confidence.resources, "files", lambda _: tmp_path)
    assert confidence.models() == dict.fromkeys(names, model)


def test_the_reliability_diagram_shows_its_points(tmp_path) -> None:
    examples = told(500, seed=5)
    right = hits(examples)
    path = tmp_path / "reliability.png"
    save_reliability(
        path, [("made", probabilities(learn(examples, NEAR_M), examples), right)], "title"
    )
    assert path.read_bytes().startswith(b"\x89PNG")
