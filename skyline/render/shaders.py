"""GLSL programs from files.

A shader file may hold lines ``#include "other.glsl"``: the other file's text stands there
instead. One level: an included file includes nothing. GLSL's own ``#line`` directives keep count
of file and line, so that a driver's message can be given back in those terms.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import moderngl

from skyline.errors import ContextError, MissingFileError

_PACKAGE = Path(__file__).resolve().parents[1]
SHADER_FOLDERS = (_PACKAGE / "shaders", _PACKAGE.parent / "shaders")
"""Where shaders are looked for: in the wheel, then in the repository."""

_INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]+"(?P<name>[^"]+)"[^\n]*$', re.MULTILINE)
_VERSION = re.compile(r"^[ \t]*#[ \t]*version\b[^\n]*\n", re.MULTILINE)
# Mesa and Intel "0:12(3): error", NVIDIA "0(12) : error", AMD "ERROR: 0:12: ".
_PLACE = re.compile(r"\b(?P<file>\d+)(?::(?P<line>\d+)\b(?:\(\d+\))?|\((?P<nvidia_line>\d+)\))")
# moderngl heads the driver's log with the stage and a ruler.
_STAGE = re.compile(r"^(?P<stage>\w+_shader)\n=+\n", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class ShaderSource:
    """GLSL text, and the names of the files that its ``#line`` directives number."""

    text: str
    files: tuple[str, ...]


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
        The driver refuses a shader: the message has file, line and the driver's words.
    MissingFileError
        No such shader.
    """
    first, second = load_shader(vertex, defines), load_shader(fragment, defines)
    try:
        return ctx.program(vertex_shader=first.text, fragment_shader=second.text)
    except moderngl.Error as error:
        stages = {"vertex_shader": first, "fragment_shader": second}
        raise ContextError(_explain(str(error), stages)) from error


def compile_compute(
    ctx: moderngl.Context, name: str, defines: Mapping[str, str] | None = None
) -> moderngl.ComputeShader:
    """Compile a compute shader file (OpenGL 4.3); as `compile_program` otherwise."""
    source = load_shader(name, defines)
    try:
        return ctx.compute_shader(source.text)
    except moderngl.Error as error:
        raise ContextError(_explain(str(error), {"compute_shader": source})) from error


def _explain(log: str, stages: Mapping[str, ShaderSource]) -> str:
    """Return one line: the driver's message with file names for numbers."""
    names = " + ".join(source.files[0] for source in stages.values())
    found = _STAGE.search(log)
    if found is None:
        return f"shaders {names} do not link: {_one_line(log)}"
    source = stages[found["stage"]]

    def name_place(place: re.Match[str]) -> str:
        number = int(place["file"])
        if number >= len(source.files):
            return place[0]
        return f"{source.files[number]}:{place['line'] or place['nvidia_line']}"

    message = _one_line(_PLACE.sub(name_place, log[found.end() :]))
    return f"shader {source.files[0]} does not compile: {message}"


def _one_line(log: str) -> str:
    return "; ".join(line.strip() for line in log.splitlines() if line.strip())


def load_shader(name: str, defines: Mapping[str, str] | None = None) -> ShaderSource:
    """Return a shader file with what it includes put in place; raises `MissingFileError`."""
    text, files = _find(name).read_text(encoding="utf-8"), [name]

    def insert(include: re.Match[str]) -> str:
        included = include["name"]
        files.append(included)
        body = _find(included).read_text(encoding="utf-8").rstrip("\n")
        next_line = text.count("\n", 0, include.end()) + 2
        return f"#line 1 {len(files) - 1}\n{body}\n#line {next_line} 0"

    text = _INCLUDE.sub(insert, text)
    if defines and (version := _VERSION.search(text)):
        end = version.end()
        macros = "".join(f"#define {name} {value}\n" for name, value in defines.items())
        text = f"{text[:end]}{macros}#line {text.count(chr(10), 0, end) + 1} 0\n{text[end:]}"
    return ShaderSource(text, tuple(files))


def _find(name: str) -> Path:
    for folder in SHADER_FOLDERS:
        if (path := folder / name).is_file():
            return path
    raise MissingFileError(
        f"shader {name!r} is in neither {SHADER_FOLDERS[0]} nor {SHADER_FOLDERS[1]}; reinstall "
        "skyline, or run it from a whole checkout"
    )
