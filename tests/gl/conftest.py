"""Every OpenGL test must leave no OpenGL error behind."""

import pytest

from skyline.render.context import acquire_context


@pytest.fixture(autouse=True)
def no_gl_error():
    """Fail a test during which OpenGL recorded an error."""
    ctx = acquire_context().ctx
    assert ctx.error == "GL_NO_ERROR"
    yield
    assert acquire_context().ctx.error == "GL_NO_ERROR"
