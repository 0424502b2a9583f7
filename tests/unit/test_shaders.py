"""A driver's error names the shader and is one line."""

import moderngl
import pytest

from skyline.errors import ContextError
from skyline.render import context


def test_a_refused_shader_is_one_line_with_the_file_and_the_drivers_words(tmp_path, monkeypatch):
    monkeypatch.setattr(context, "_SHADERS", tmp_path)
    (tmp_path / "a.comp").write_text("#version 430\nbad\n")

    class RefusingDriver:
        def compute_shader(self, _):
            raise moderngl.Error("Compiler failed\n\ncompute_shader\n===\n0:2(9): error: `bad'\n")

    with pytest.raises(ContextError, match=r"refuses a\.comp: .*0:2\(9\): error: `bad'") as caught:
        context.compile_shaders(RefusingDriver(), "a.comp", defines={})
    assert "\n" not in str(caught.value)
