"""Every OpenGL test must leave no OpenGL error behind."""

import pytest


@pytest.fixture(autouse=True)
def every_test(no_gl_error):
    """Fail a test during which OpenGL recorded an error."""
