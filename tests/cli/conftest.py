"""Commands refine quickly."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def quickly(refined_quickly):
    """Refine quickly in all tests of commands."""
