"""Results kept in a file: found again where nothing they depend on has changed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import candidate_at

from skyline.photo.query import QuerySkyline
from skyline.pipeline.results import MatchResult
from skyline_bench.queries.synthetic import SyntheticQuery, Truth
from skyline_bench.trials.kept import MEASURED_CODE, Kept, measured_code_digest, measured_files
from skyline_bench.trials.trials import Trial, summarize, trial_of

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
    return [trial_of(QUERIES[i], found[i], 0.25, 5000.0) for i in range(3)]


@pytest.fixture
def path(trials, tmp_path):
    """The file that the trials are kept in."""
    kept = Kept(tmp_path / "trials" / "store.full", KEY, Trial)
    for number, trial in enumerate(trials):
        kept.keep(str(number), trial)
    (path,) = (tmp_path / "trials").iterdir()
    return path


def again(path, key=KEY):
    return Kept(path.with_name("store.full"), key, Trial).found


def test_what_was_kept_is_found_again(trials, path):
    found = again(path)
    assert list(found) == ["0", "1", "2"]
    assert found["0"] == trials[0]
    assert [one.error_m for one in found.values()] == [0.0, 5000.0, 5000.0]
    assert np.isnan(found["1"].heading_error_deg)
    assert summarize(list(found.values()), 0) == summarize(trials, 0)


@pytest.mark.parametrize("other", [{"seed": 4}, {"store": "xyz"}, {"matcher": "paper"}])
def test_what_has_changed_is_measured_again(path, other):
    assert not again(path, KEY | other)
    assert len(again(path)) == 3


def test_a_line_that_cannot_be_read_is_measured_again(trials, path):
    whole = path.read_text()
    for damaged in ("[]\n", "{}\n", "1\n", whole.replace("error_m", "error")):
        path.write_text(damaged)
        assert not again(path)
    # A kill in the middle of a line loses that line alone.
    path.write_text(whole[:-20])
    assert list(again(path)) == ["0", "1"]
    other = replace(trials[2], error_m=7.0)
    Kept(path.with_name("store.full"), KEY, Trial).keep("2", other)
    assert [one.error_m for one in again(path).values()] == [0.0, 5000.0, 7.0]


def test_answers_depend_on_code_learned_models_and_shaders():
    for package, names in MEASURED_CODE.items():
        assert all((Path(package.__file__).parent / name).exists() for name in names)
    assert len(measured_code_digest()) == 64
    names = {file.name for file in measured_files()}
    assert {"retrieval.py", "confidence.json", "horizon.comp", "synthetic.py"} <= names
    assert not {"adaptive.py", "uniform_adaptive.py"} & names
