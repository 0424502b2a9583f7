"""The place in a shader's file that a driver's error means."""

import moderngl
import pytest

from skyline.errors import ContextError
from skyline.render import shaders

VERTEX = "#version 330 core\nvoid main() { gl_Position = vec4(0.0); }\n"


class RefusingDriver:
    """Refuses every program with a log of the given words, as moderngl hands it on."""

    def __init__(self, stage, words):
        self.log = f"GLSL Compiler failed\n\n{stage}\n{'=' * len(stage)}\n{words}\n"

    def program(self, **_):
        raise moderngl.Error(self.log)

    def compute_shader(self, _):
        raise moderngl.Error(self.log)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A shader folder that stands before the repository's."""
    monkeypatch.setattr(shaders, "SHADER_FOLDERS", (tmp_path, tmp_path / "second"))
    (tmp_path / "point.vert").write_text(VERTEX)
    return tmp_path


@pytest.mark.parametrize(
    "words",
    [
        "0:2(9): error: `bad' undeclared",
        "0(2) : error C1008: undefined variable `bad'",
        "ERROR: 0:2: `bad' : undeclared",
    ],
    ids=["mesa", "nvidia", "amd"],
)
def test_messages_of_each_driver_name_file_and_line(folder, words):
    (folder / "a.frag").write_text("#version 330 core\nbad\n")
    driver = RefusingDriver("fragment_shader", words)
    with pytest.raises(ContextError, match=r"^shader a\.frag does not compile: .*a\.frag:2\b.*bad"):
        shaders.compile_program(driver, "point.vert", "a.frag")
