"""The command line of benchmarks run in this process."""

from functools import partial

import pytest

from skyline_bench import cli


@pytest.fixture
def run_bench(run_main):
    """Return a function that runs ``skyline-bench ARGS...``."""
    return partial(run_main, cli.main, "skyline-bench")
