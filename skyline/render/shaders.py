"""Compiles GLSL programs from shader files; an error names the file and line."""

import re
from collections.abc import Mapping
from pathlib import Path

import moderngl

from skyline.errors import ContextError, MissingFileError

_PACKAGE = Path(__file__).resolve().parents[1]
SHADER_FOLDERS = (_PACKAGE / "shaders", _PACKAGE.parent / "shaders")
"""The folder of shader files in the wheel, and the one in the repository."""

_VERSION = re.compile(r"^[ \t]*#[ \t]*version\b[^\n]*\n", re.MULTILINE)
# Mesa and Intel write "0:12(3): error", NVIDIA "0(12) : error", AMD "ERROR: 0:12: "; 0 is the file.
_PLACE = re.compile(r"\b0(?::(?P<line>\d+)\b(?:\(\d+\))?|\((?P<nvidia_line>\d+)\))")
# moderngl puts the stage and a ruler above the driver's log.
_STAGE = re.compile(r"^(?P<stage>\w+_shader)\n=+\n", re.MULTILINE)


def compile_program(
    ctx: moderngl.Context,
    vertex: str,
    fragment: str,
    defines: Mapping[str, str] | None = None,
) -> moderngl.Program:
    """Compile and link a program from two shader files.

    Parameters
    ----------
    vertex, fragment : str
        Names of shader files.
    defines : mapping of str to str, optional
        Macros of both shaders, defined after ``#version``.

    Raises
    ------
    ContextError
        The driver refuses a shader; the message has the file, the line and the driver's words.
    MissingFileError
        There is no such shader.
    """
    texts = load_shader(vertex, defines), load_shader(fragment, defines)
    try:
        return ctx.program(vertex_shader=texts[0], fragment_shader=texts[1])
    except moderngl.Error as error:
        stages = {"vertex_shader": vertex, "fragment_shader": fragment}
        raise ContextError(_explain(str(error), stages)) from error


def compile_compute(
    ctx: moderngl.Context, name: str, defines: Mapping[str, str] | None = None
) -> moderngl.ComputeShader:
    """Compile a compute shader file; parameters and errors as of `compile_program`."""
    text = load_shader(name, defines)
    try:
        return ctx.compute_shader(text)
    except moderngl.Error as error:
        raise ContextError(_explain(str(error), {"compute_shader": name})) from error


def _explain(log: str, stages: Mapping[str, str]) -> str:
    """Return the driver's message on one line, with the shader's file name at each place."""
    found = _STAGE.search(log)
    if found is None:
        return f"shaders {' + '.join(stages.values())} do not link: {_one_line(log)}"
    name = stages[found["stage"]]

    def name_place(place: re.Match[str]) -> str:
        return f"{name}:{place['line'] or place['nvidia_line']}"

    message = _one_line(_PLACE.sub(name_place, log[found.end() :]))
    return f"shader {name} does not compile: {message}"


def _one_line(log: str) -> str:
    return "; ".join(line.strip() for line in log.splitlines() if line.strip())


def load_shader(name: str, defines: Mapping[str, str] | None = None) -> str:
    """Return the text of a shader file with macros defined after ``#version``.

    Raises `MissingFileError` where there is no such shader.
    """
    text = _find(name).read_text(encoding="utf-8")
    if defines and (version := _VERSION.search(text)):
        end = version.end()
        macros = "".join(f"#define {name} {value}\n" for name, value in defines.items())
        # The driver goes on counting lines as in the file.
        text = f"{text[:end]}{macros}#line {text.count(chr(10), 0, end) + 1}\n{text[end:]}"
    return text


def _find(name: str) -> Path:
    for folder in SHADER_FOLDERS:
        if (path := folder / name).is_file():
            return path
    raise MissingFileError(
        f"shader {name!r} is in neither {SHADER_FOLDERS[0]} nor {SHADER_FOLDERS[1]}; reinstall "
        "skyline, or run it from a whole checkout"
    )
