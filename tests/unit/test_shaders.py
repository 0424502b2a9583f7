"""Finding shaders, defining macros, and the errors of drivers."""

import moderngl
import pytest

from skyline.errors import ContextError, MissingFileError
from skyline.render import shaders


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A shader folder that stands before the repository's."""
    monkeypatch.setattr(shaders, "SHADER_FOLDERS", (tmp_path, tmp_path / "second"))
    return tmp_path


def test_a_missing_shader_names_both_folders(folder):
    with pytest.raises(MissingFileError) as caught:
        shaders.load_shader("none.vert")
    message = str(caught.value)
    assert "'none.vert'" in message
    assert f"neither {folder} nor {folder / 'second'}" in message


def test_macros_stand_after_the_version_and_lines_are_counted_on(folder):
    (folder / "a.comp").write_text("// Heading.\n#version 430\nend\n")
    assert shaders.load_shader("a.comp", {"ONE": "1", "BARE": ""}).splitlines() == [
        *("// Heading.", "#version 430", "#define ONE 1", "#define BARE ", "#line 3", "end"),
    ]


def test_a_refused_shader_is_one_line_with_the_file_and_the_drivers_words(folder):
    (folder / "a.comp").write_text("#version 430\nbad\n")

    class RefusingDriver:
        def compute_shader(self, _):
            raise moderngl.Error("Compiler failed\n\ncompute_shader\n===\n0:2(9): error: `bad'\n")

    with pytest.raises(ContextError, match=r"refuses a\.comp: .*0:2\(9\): error: `bad'") as caught:
        shaders.compile_compute(RefusingDriver(), "a.comp")
    assert "\n" not in str(caught.value)
