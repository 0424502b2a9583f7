"""A driver's error names the shader and is one line."""

import moderngl
import pytest

from skyline.errors import ContextError
from skyline.render import shaders


def test_a_refused_shader_is_one_line_with_the_file_and_the_drivers_words(tmp_path, monkeypatch):
    monkeypatch.setattr(shaders, "SHADER_FOLDERS", (tmp_path,))
    (tmp_path / "a.comp").write_text("#version 430\nbad\n")

    class RefusingDriver:
        def compute_shader(self, _):
            raise moderngl.Error("Compiler failed\n\ncompute_shader\n===\n0:2(9): error: `bad'\n")

    with pytest.raises(ContextError, match=r"refuses a\.comp: .*0:2\(9\): error: `bad'") as caught:
        shaders.compile_compute(RefusingDriver(), "a.comp")
    assert "\n" not in str(caught.value)
