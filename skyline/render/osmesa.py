"""A context of Mesa's off-screen library, which glcontext does not make."""

import ctypes
from collections.abc import Sequence
from ctypes import POINTER, c_int, c_ubyte, c_uint, c_void_p
from typing import Any, Self

from skyline.errors import ContextError

# GL/gl.h and GL/osmesa.h of Mesa 12 and later.
_GL_RGBA = 0x1908
_GL_UNSIGNED_BYTE = 0x1401
_OSMESA_FORMAT = 0x22
_OSMESA_PROFILE = 0x33
_OSMESA_CORE_PROFILE = 0x34
_OSMESA_CONTEXT_MAJOR_VERSION = 0x36
_OSMESA_CONTEXT_MINOR_VERSION = 0x37


class OsMesaContext:
    """A native OpenGL context for moderngl, by Mesa's off-screen library.

    It is current once made.
    """

    def __init__(self, names: Sequence[str], version: tuple[int, int]) -> None:
        """Make a core profile of an OpenGL version.

        The first library that loads makes it. Raises `ContextError` if none loads, or if it lacks
        the version.
        """
        library = _loaded(names)
        self._proc_address = _bind(library.OSMesaGetProcAddress, c_void_p, ctypes.c_char_p)
        self._make_current = _bind(
            library.OSMesaMakeCurrent, c_ubyte, c_void_p, c_void_p, c_uint, c_int, c_int
        )
        self._destroy = _bind(library.OSMesaDestroyContext, None, c_void_p)
        # OSMesa makes a context current only with a framebuffer, though nothing is drawn there.
        self._pixel = (c_ubyte * 4)()
        major, minor = version
        wanted = (
            *(_OSMESA_FORMAT, _GL_RGBA, _OSMESA_PROFILE, _OSMESA_CORE_PROFILE),
            *(_OSMESA_CONTEXT_MAJOR_VERSION, major, _OSMESA_CONTEXT_MINOR_VERSION, minor, 0),
        )
        create = _bind(library.OSMesaCreateContextAttribs, c_void_p, POINTER(c_int), c_void_p)
        self._context: int | None = create((c_int * len(wanted))(*wanted), None)
        if not self._context:
            raise ContextError(
                f"OSMesaCreateContextAttribs gave no core profile of OpenGL {major}.{minor}"
            )
        self.__enter__()

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an OpenGL function; 0 if there is none."""
        return self._proc_address(name.encode()) or 0

    def __enter__(self) -> Self:
        if not self._make_current(self._context, self._pixel, _GL_UNSIGNED_BYTE, 1, 1):
            raise ContextError("OSMesaMakeCurrent failed")
        return self

    def __exit__(self, *_: object) -> None:
        self._make_current(None, None, _GL_UNSIGNED_BYTE, 0, 0)

    def release(self) -> None:
        """Destroy the context, which must not be current; harmless when repeated."""
        if self._context:
            self._destroy(self._context)
            self._context = None


def _loaded(names: Sequence[str]) -> ctypes.CDLL:
    """Return the first library that loads."""
    errors = []
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError as error:
            errors.append(str(error))
    raise ContextError("; ".join(errors))


def _bind(function: Any, result: Any, *arguments: Any) -> Any:
    """Give a foreign function its C signature."""
    function.restype = result
    function.argtypes = arguments
    return function
