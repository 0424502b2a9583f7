"""Trials kept in a folder: found again where nothing they depend on has changed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import candidate_at

from skyline.photo import QuerySkyline
from skyline.pipeline.results import MatchResult
from skyline_bench.queries.synthetic import SyntheticQuery, Truth
from skyline_bench.trials.kept import (
    MEASURED_CODE,
    kept_trials,
    measured_code_digest,
    measured_files,
    save_trials,
)
from skyline_bench.trials.trials import summarize, trial_of

SKYLINE = QuerySkyline(np.full(8, 3.0), np.ones(8), 8, 8, 60.0)
QUERIES = [
    SyntheticQuery(
        SKYLINE, 60.0, (57.0, 63.0), Truth(100.0 * i, 0.0, 1e3, 10.0, 0, 0, 60.0),
        SKYLINE.row_px, 4000.0, (),
    )
    for i in range(3)
]  # fmt: skip
BEST = candidate_at(0.0, 0.0, 5.0, confidence=0.8, covariance_m2=((1.0, 0.0), (0.0, 2.0)))
KEY = {"seed": 3, "query": {"fov_deg": (60.0, 60.0)}, "store": "abc"}


@pytest.fixture
def trials():
    found = [MatchResult(SKYLINE, (BEST,), 0.2), MatchResult(SKYLINE, (), 0.1, "none"), None]
    return [trial_of(i, QUERIES[i], found[i], 0.25, 5000.0) for i in range(3)]


def test_what_was_kept_is_found_again(trials, tmp_path):
    path = tmp_path / "trials" / "store.full.json"
    save_trials(path, KEY, trials)
    again = kept_trials(path, KEY, QUERIES)
    assert again is not None
    assert again[0] == trials[0]
    assert [one.error_m for one in again] == [0.0, 5000.0, 5000.0]
    assert np.isnan(again[1].heading_error_deg)
    assert summarize(again, 0) == summarize(trials, 0)
    assert [each.name for each in path.parent.iterdir()] == ["store.full.json"]


@pytest.mark.parametrize("other", [{"seed": 4}, {"store": "xyz"}, {"matcher": "paper"}])
def test_what_has_changed_is_measured_again(trials, tmp_path, other):
    path = tmp_path / "store.full.json"
    save_trials(path, KEY, trials)
    assert kept_trials(path, KEY | other, QUERIES) is None


def test_what_cannot_be_read_is_measured_again(trials, tmp_path):
    path = tmp_path / "store.full.json"
    assert kept_trials(path, KEY, QUERIES) is None
    save_trials(path, KEY, trials)
    whole = path.read_text()
    for damaged in (whole[: len(whole) // 2], "[]", "{}", whole.replace("error_m", "error")):
        path.write_text(damaged)
        assert kept_trials(path, KEY, QUERIES) is None
    save_trials(path, KEY, trials[:2])
    assert kept_trials(path, KEY, QUERIES) is None


def test_answers_depend_on_code_learned_models_and_shaders():
    for package, names in MEASURED_CODE.items():
        assert all((Path(package.__file__).parent / name).exists() for name in names)
    assert len(measured_code_digest()) == 64
    names = {file.name for file in measured_files()}
    assert {"retrieval.py", "confidence.json", "horizon_march.glsl", "synthetic.py"} <= names
    assert not {"adaptive.py", "uniform_adaptive.py"} & names


def test_the_best_candidate_alone_is_kept(trials, tmp_path):
    several = replace(trials[0], candidates=(BEST, BEST))
    save_trials(tmp_path / "x.json", KEY, [several, *trials[1:]])
    again = kept_trials(tmp_path / "x.json", KEY, QUERIES)
    assert again is not None
    assert again[0].candidates == (BEST,)
