"""Compiles GLSL programs from shader files; an error names the files."""

import re
from collections.abc import Mapping
from pathlib import Path

import moderngl

from skyline.errors import ContextError, MissingFileError

_PACKAGE = Path(__file__).resolve().parents[1]
SHADER_FOLDERS = (_PACKAGE / "shaders", _PACKAGE.parent / "shaders")
"""The folder of shader files in the wheel, and the one in the repository."""

_VERSION = re.compile(r"^[ \t]*#[ \t]*version\b[^\n]*\n", re.MULTILINE)


def compile_program(
    ctx: moderngl.Context, vertex: str, fragment: str, defines: Mapping[str, str] | None = None
) -> moderngl.Program:
    """Compile and link a program from two shader files, named without their folder.

    ``defines`` are macros of both shaders. Raises `ContextError` if the driver refuses a shader,
    with the driver's words, and `MissingFileError` if there is no such shader.
    """
    texts = load_shader(vertex, defines), load_shader(fragment, defines)
    try:
        return ctx.program(vertex_shader=texts[0], fragment_shader=texts[1])
    except moderngl.Error as error:
        raise _refusal(error, vertex, fragment) from error


def compile_compute(
    ctx: moderngl.Context, name: str, defines: Mapping[str, str] | None = None
) -> moderngl.ComputeShader:
    """Compile a compute shader file; parameters and errors as of `compile_program`."""
    text = load_shader(name, defines)
    try:
        return ctx.compute_shader(text)
    except moderngl.Error as error:
        raise _refusal(error, name) from error


def _refusal(error: moderngl.Error, *names: str) -> ContextError:
    """Return an error with the driver's log on one line; its line numbers are the file's."""
    log = "; ".join(line.strip() for line in str(error).splitlines() if line.strip())
    return ContextError(f"the driver refuses {' + '.join(names)}: {log}")


def load_shader(name: str, defines: Mapping[str, str] | None = None) -> str:
    """Return the text of a shader file with macros defined after ``#version``.

    Raises `MissingFileError` where there is no such shader.
    """
    paths = [folder / name for folder in SHADER_FOLDERS if (folder / name).is_file()]
    if not paths:
        raise MissingFileError(
            f"shader {name!r} is in neither {SHADER_FOLDERS[0]} nor {SHADER_FOLDERS[1]}; "
            "reinstall skyline, or run it from a whole checkout"
        )
    text = paths[0].read_text(encoding="utf-8")
    if defines and (version := _VERSION.search(text)):
        end = version.end()
        macros = "".join(f"#define {name} {value}\n" for name, value in defines.items())
        # The driver goes on counting lines as in the file.
        text = f"{text[:end]}{macros}#line {text.count(chr(10), 0, end) + 1}\n{text[end:]}"
    return text
