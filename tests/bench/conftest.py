"""The command line of benchmarks run in this process."""

import math
from dataclasses import replace
from functools import partial

import pytest

from skyline_bench import cli
from skyline_bench.search import trials


@pytest.fixture
def run_bench(run_main):
    """Return a function that runs ``skyline-bench ARGS...``."""
    return partial(run_main, cli.main, "skyline-bench")


@pytest.fixture(scope="module")
def refined_once():
    """Refine no query thoroughly: how answers are counted does not depend on how good they are."""
    once = replace(trials.MATCHING, full=replace(trials.MATCHING.full, sure_margin=-math.inf))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trials, "MATCHING", once)
        yield
