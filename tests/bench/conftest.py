"""The command line of benchmarks run in this process."""

import math
from functools import partial

import pytest

from skyline.match import full
from skyline_bench import cli


@pytest.fixture
def run_bench(run_main):
    """Return a function that runs ``skyline-bench ARGS...``."""
    return partial(run_main, cli.main, "skyline-bench")


@pytest.fixture(scope="module")
def refined_once():
    """Refine no query thoroughly: how answers are counted does not depend on how good they are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(full, "_SURE_MARGIN", -math.inf)
        yield
