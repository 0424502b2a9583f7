"""The command line run in this process."""

from functools import partial

import pytest

from skyline import cli


@pytest.fixture
def run(run_main):
    """Return a function that runs ``skyline ARGS...``."""
    return partial(run_main, cli.main, "skyline")


@pytest.fixture(scope="module", autouse=True)
def quickly(refined_quickly):
    """Refine quickly in all tests of commands."""
