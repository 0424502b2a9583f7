"""OpenGL without a display: contexts made through ctypes by EGL and by OSMesa.

Both kinds of context are what ``moderngl.create_context(context=...)`` takes: an object that
finds OpenGL functions by name, is made current by ``with`` and can be released. Libraries are
opened by their sonames, since the ``.so`` links come only with development packages, and OpenGL
functions are asked of EGL itself, so that libGL need not be installed.
"""

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from ctypes import POINTER, c_char_p, c_int, c_ubyte, c_uint, c_void_p
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

from skyline.errors import ContextError

EGL_LIBRARIES = ("libEGL.so.1",)
OSMESA_LIBRARIES = ("libOSMesa.so.8", "libOSMesa.so.6")

CORE_VERSIONS = ((4, 6), (4, 5), (4, 3), (3, 3))
"""OpenGL versions asked for in turn: some drivers give exactly what was asked, others the best."""

GL_RENDERER = 0x1F01
GL_VERSION = 0x1F02

_GL_RGBA = 0x1908
_GL_UNSIGNED_BYTE = 0x1401

# EGL 1.5 and its extensions EXT_device_query, EXT_platform_device, MESA_platform_surfaceless.
_EGL_SURFACE_TYPE = 0x3033
_EGL_PBUFFER_BIT = 0x0001
_EGL_RENDERABLE_TYPE = 0x3040
_EGL_OPENGL_BIT = 0x0008
_EGL_NONE = 0x3038
_EGL_EXTENSIONS = 0x3055
_EGL_OPENGL_API = 0x30A2
_EGL_CONTEXT_MAJOR_VERSION = 0x3098
_EGL_CONTEXT_MINOR_VERSION = 0x30FB
_EGL_CONTEXT_OPENGL_PROFILE_MASK = 0x30FD
_EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT = 0x0001
_EGL_PLATFORM_DEVICE = 0x313F
_EGL_PLATFORM_SURFACELESS = 0x31DD
_EGL_DRM_DEVICE_FILE = 0x3233
_EGL_ERRORS = {
    0x3001: "EGL_NOT_INITIALIZED",
    0x3002: "EGL_BAD_ACCESS",
    0x3003: "EGL_BAD_ALLOC",
    0x3004: "EGL_BAD_ATTRIBUTE",
    0x3005: "EGL_BAD_CONFIG",
    0x3006: "EGL_BAD_CONTEXT",
    0x3008: "EGL_BAD_DISPLAY",
    0x3009: "EGL_BAD_MATCH",
    0x300C: "EGL_BAD_PARAMETER",
}

# GL/osmesa.h of Mesa 12 and later.
_OSMESA_FORMAT = 0x22
_OSMESA_PROFILE = 0x33
_OSMESA_CORE_PROFILE = 0x34
_OSMESA_CONTEXT_MAJOR_VERSION = 0x36
_OSMESA_CONTEXT_MINOR_VERSION = 0x37


@dataclass(frozen=True, slots=True)
class EglDisplay:
    """A place where EGL may make contexts."""

    name: str
    """For people."""
    handle: Callable[[], int | None]
    """Returns the ``EGLDisplay``, or None where EGL has none."""


class Egl:
    """The EGL library.

    Raises `ContextError` where the library cannot be loaded.
    """

    def __init__(self) -> None:
        library = _load(EGL_LIBRARIES)
        self._get_error = _bind(library.eglGetError, c_int)
        self._query_string = _bind(library.eglQueryString, c_char_p, c_void_p, c_int)
        self._get_display = _bind(library.eglGetDisplay, c_void_p, c_void_p)
        self.proc_address = _bind(library.eglGetProcAddress, c_void_p, c_char_p)
        self.initialize = _bind(library.eglInitialize, c_uint, c_void_p, c_void_p, c_void_p)
        self.bind_api = _bind(library.eglBindAPI, c_uint, c_uint)
        self.choose_config = _bind(
            library.eglChooseConfig,
            *(c_uint, c_void_p, POINTER(c_int), POINTER(c_void_p), c_int, POINTER(c_int)),
        )
        self.create_context = _bind(
            library.eglCreateContext, c_void_p, c_void_p, c_void_p, c_void_p, POINTER(c_int)
        )
        self.make_current = _bind(library.eglMakeCurrent, c_uint, *(4 * [c_void_p]))
        self.current_context = _bind(library.eglGetCurrentContext, c_void_p)
        self.destroy_context = _bind(library.eglDestroyContext, c_uint, c_void_p, c_void_p)

    def device_displays(self) -> Iterator[EglDisplay]:
        """Yield one display a device (EGL_EXT_device_enumeration); none without the extension."""
        extensions = self._client_extensions()
        if not {"EGL_EXT_platform_device", "EGL_EXT_platform_base"} <= extensions:
            return
        if not extensions & {"EGL_EXT_device_enumeration", "EGL_EXT_device_base"}:
            return
        for index, device in enumerate(self._devices()):
            yield EglDisplay(
                f"device {index} ({self._device_name(device)})",
                partial(self._platform_display, _EGL_PLATFORM_DEVICE, device),
            )

    def plain_displays(self) -> Iterator[EglDisplay]:
        """Yield the displays that need no device: Mesa's surfaceless one, then the default."""
        if "EGL_MESA_platform_surfaceless" in self._client_extensions():
            yield EglDisplay(
                "surfaceless display",
                partial(self._platform_display, _EGL_PLATFORM_SURFACELESS, None),
            )
        yield EglDisplay("default display", partial(self._get_display, None))

    def checked(self, step: str, result: Any) -> Any:
        """Return what an EGL call has returned; raises `ContextError` where it failed."""
        if not result:
            code = self._get_error()
            error = _EGL_ERRORS.get(code, f"EGL error {code:#x}")
            raise ContextError(f"{step} failed with {error}")
        return result

    def _client_extensions(self) -> set[str]:
        return set((self._query_string(None, _EGL_EXTENSIONS) or b"").decode().split())

    def _extension(self, name: str, result: Any, *arguments: Any) -> Any:
        """Return a function that EGL alone knows of, with its C signature."""
        return ctypes.CFUNCTYPE(result, *arguments)(self.proc_address(name.encode()) or 0)

    def _devices(self) -> list[int | None]:
        query = self._extension(
            "eglQueryDevicesEXT", c_uint, c_int, POINTER(c_void_p), POINTER(c_int)
        )
        count = c_int()
        query(0, None, count)
        devices = (c_void_p * count.value)()
        query(count.value, devices, count)
        return list(devices)[: count.value]

    def _device_name(self, device: int | None) -> str:
        query = self._extension("eglQueryDeviceStringEXT", c_char_p, c_void_p, c_int)
        extensions = (query(device, _EGL_EXTENSIONS) or b"").decode().split()
        if "EGL_MESA_device_software" in extensions:
            return "Mesa software"
        if "EGL_EXT_device_drm" in extensions:
            return (query(device, _EGL_DRM_DEVICE_FILE) or b"no device file").decode()
        return "no device file"

    def _platform_display(self, platform: int, native: int | None) -> int | None:
        get = self._extension(
            "eglGetPlatformDisplayEXT", c_void_p, c_uint, c_void_p, POINTER(c_int)
        )
        handle: int | None = get(platform, native, None)
        return handle


class OffscreenContext(ABC):
    """A native context of a core profile as moderngl takes it; current once made."""

    device: str
    """For people."""
    _context: int | None
    _proc_address: Callable[[bytes], int | None]
    _current: Callable[[], int | None]
    _let_go: Callable[[], object]
    _destroy: Callable[[int], object]

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an OpenGL function, 0 where there is none."""
        return self._proc_address(name.encode()) or 0

    @abstractmethod
    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None:
        self._let_go()

    def release(self) -> None:
        """Destroy the context; harmless when repeated."""
        if self._context:
            if self._current() == self._context:
                self._let_go()
            self._destroy(self._context)
            self._context = None


class EglContext(OffscreenContext):
    """A context without a surface.

    The display is never terminated: EGL shares it with every other user in the process.

    Raises `ContextError` where the display, or a context of OpenGL 3.3 or newer on it, cannot be
    had.
    """

    def __init__(self, egl: Egl, display: EglDisplay) -> None:
        self.device = f"EGL {display.name}"
        self._egl, self._proc_address, self._current = egl, egl.proc_address, egl.current_context
        self._display = egl.checked("eglGetDisplay", display.handle())
        self._let_go = partial(egl.make_current, self._display, None, None, None)
        self._destroy = partial(egl.destroy_context, self._display)
        egl.checked("eglInitialize", egl.initialize(self._display, None, None))
        wanted = _attributes(
            *(_EGL_SURFACE_TYPE, _EGL_PBUFFER_BIT),
            *(_EGL_RENDERABLE_TYPE, _EGL_OPENGL_BIT, _EGL_NONE),
        )
        config, count = c_void_p(), c_int()
        chosen = egl.choose_config(self._display, wanted, config, 1, count)
        egl.checked("eglChooseConfig", chosen)
        if count.value == 0:
            raise ContextError("eglChooseConfig found no configuration for desktop OpenGL")
        egl.checked("eglBindAPI(EGL_OPENGL_API)", egl.bind_api(_EGL_OPENGL_API))
        for major, minor in CORE_VERSIONS:
            wanted = _attributes(
                *(_EGL_CONTEXT_MAJOR_VERSION, major, _EGL_CONTEXT_MINOR_VERSION, minor),
                *(_EGL_CONTEXT_OPENGL_PROFILE_MASK, _EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT),
                _EGL_NONE,
            )
            self._context = egl.create_context(self._display, config, None, wanted)
            if self._context:
                break
        egl.checked("eglCreateContext for OpenGL 3.3 core", self._context)
        try:
            self.__enter__()
        except ContextError:
            self.release()
            raise

    def __enter__(self) -> Self:
        # The bound API is kept per thread and decides what a later unbinding unbinds.
        self._egl.bind_api(_EGL_OPENGL_API)
        current = self._egl.make_current(self._display, None, None, self._context)
        self._egl.checked("eglMakeCurrent without a surface", current)
        return self


class OsMesaContext(OffscreenContext):
    """A context of Mesa's off-screen library.

    Raises `ContextError` where the library cannot be loaded, or has no core profile of OpenGL 3.3
    or newer.
    """

    def __init__(self) -> None:
        library = _load(OSMESA_LIBRARIES)
        self.device = "Mesa off-screen library"
        self._proc_address = _bind(library.OSMesaGetProcAddress, c_void_p, c_char_p)
        self._make_current = _bind(
            library.OSMesaMakeCurrent, c_ubyte, c_void_p, c_void_p, c_uint, c_int, c_int
        )
        self._current = _bind(library.OSMesaGetCurrentContext, c_void_p)
        self._destroy = _bind(library.OSMesaDestroyContext, None, c_void_p)
        self._let_go = partial(self._make_current, None, None, _GL_UNSIGNED_BYTE, 0, 0)
        # OSMesa is current only with a default framebuffer, though nothing is drawn there.
        self._pixel = (c_ubyte * 4)()
        try:
            create = _bind(library.OSMesaCreateContextAttribs, c_void_p, POINTER(c_int), c_void_p)
        except AttributeError as error:
            raise ContextError("this libOSMesa is older than Mesa 12: no core profile") from error
        for major, minor in CORE_VERSIONS:
            wanted = _attributes(
                *(_OSMESA_FORMAT, _GL_RGBA, _OSMESA_PROFILE, _OSMESA_CORE_PROFILE),
                *(_OSMESA_CONTEXT_MAJOR_VERSION, major, _OSMESA_CONTEXT_MINOR_VERSION, minor, 0),
            )
            self._context = create(wanted, None)
            if self._context:
                break
        else:
            raise ContextError("OSMesaCreateContextAttribs gave no core profile of OpenGL 3.3")
        self.__enter__()

    def __enter__(self) -> Self:
        if not self._make_current(self._context, self._pixel, _GL_UNSIGNED_BYTE, 1, 1):
            raise ContextError("OSMesaMakeCurrent failed")
        return self


def gl_string(context: OffscreenContext, name: int) -> str:
    """Return ``glGetString(name)`` of a current context, empty where the driver has none."""
    get_string = ctypes.CFUNCTYPE(c_char_p, c_uint)(context.load_opengl_function("glGetString"))
    return (get_string(name) or b"").decode(errors="replace")


def _load(names: tuple[str, ...]) -> ctypes.CDLL:
    said = []
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError as error:
            said.append(str(error))
    raise ContextError("; ".join(said))


def _bind(function: Any, result: Any, *arguments: Any) -> Any:
    """Give a foreign function its C signature."""
    function.restype = result
    function.argtypes = arguments
    return function


def _attributes(*values: int) -> "ctypes.Array[c_int]":
    return (c_int * len(values))(*values)
