"""A driver's error names the shader and is one line."""

from unittest.mock import MagicMock

import moderngl
import pytest

from skyline.errors import ContextError
from skyline.render import context


def test_a_refused_shader_is_one_line_with_the_file_and_the_drivers_words(tmp_path, monkeypatch):
    monkeypatch.setattr(context, "_SHADERS", tmp_path)
    (tmp_path / "a.comp").write_text("#version 430\nbad\n")

    said = "Compiler failed\n\ncompute_shader\n===\n0:2(9): error: `bad'\n"
    driver = MagicMock(compute_shader=MagicMock(side_effect=moderngl.Error(said)))
    with pytest.raises(ContextError, match=r"refuses a\.comp: .*0:2\(9\): error: `bad'") as caught:
        context.compile_shaders(driver, "a.comp", defines={})
    assert "\n" not in str(caught.value)
