"""OpenGL without a display: contexts made through ctypes by EGL and by OSMesa.

Both kinds of context are what ``moderngl.create_context(context=...)`` takes: an object that
finds OpenGL functions by name, is made current by ``with`` and can be released. Libraries are
opened by their sonames, since the ``.so`` links come only with development packages, and OpenGL
functions are asked of EGL itself, so that libGL need not be installed.
"""

import ctypes
from collections.abc import Callable, Iterator
from ctypes import POINTER, c_char_p, c_int, c_ubyte, c_uint, c_void_p
from dataclasses import dataclass
from functools import partial
from typing import Any

from skyline.errors import ContextError

EGL_LIBRARIES = ("libEGL.so.1",)
OSMESA_LIBRARIES = ("libOSMesa.so.8", "libOSMesa.so.6")

CORE_VERSIONS = ((4, 6), (4, 5), (4, 3), (3, 3))
"""OpenGL versions asked for in turn: some drivers give exactly what was asked, others the best."""

GL_VENDOR = 0x1F00
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
        self._proc_address = _bind(library.eglGetProcAddress, c_void_p, c_char_p)
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

    def function_address(self, name: str) -> int:
        """Return the address of an EGL or OpenGL function, 0 where there is none."""
        return self._proc_address(name.encode()) or 0

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

    def failure(self, step: str) -> ContextError:
        """Return the error for an EGL call that has just failed."""
        code = self._get_error()
        return ContextError(f"{step} failed with {_EGL_ERRORS.get(code, f'EGL error {code:#x}')}")

    def _client_extensions(self) -> set[str]:
        return set((self._query_string(None, _EGL_EXTENSIONS) or b"").decode().split())

    def _devices(self) -> list[int | None]:
        query = ctypes.CFUNCTYPE(c_uint, c_int, POINTER(c_void_p), POINTER(c_int))(
            self.function_address("eglQueryDevicesEXT")
        )
        count = c_int()
        query(0, None, count)
        devices = (c_void_p * count.value)()
        query(count.value, devices, count)
        return list(devices)[: count.value]

    def _device_name(self, device: int | None) -> str:
        query = ctypes.CFUNCTYPE(c_char_p, c_void_p, c_int)(
            self.function_address("eglQueryDeviceStringEXT")
        )
        extensions = (query(device, _EGL_EXTENSIONS) or b"").decode().split()
        if "EGL_MESA_device_software" in extensions:
            return "Mesa software"
        if "EGL_EXT_device_drm" in extensions:
            return (query(device, _EGL_DRM_DEVICE_FILE) or b"no device file").decode()
        return "no device file"

    def _platform_display(self, platform: int, native: int | None) -> int | None:
        get = ctypes.CFUNCTYPE(c_void_p, c_uint, c_void_p, POINTER(c_int))(
            self.function_address("eglGetPlatformDisplayEXT")
        )
        handle: int | None = get(platform, native, None)
        return handle


class EglContext:
    """A core-profile context without a surface, current once made.

    The display is never terminated: EGL shares it with every other user in the process.

    Raises `ContextError` where the display, or a context of OpenGL 3.3 or newer on it, cannot be
    had.
    """

    def __init__(self, egl: Egl, display: EglDisplay) -> None:
        self.device = f"EGL {display.name}"
        self._egl = egl
        self._display = display.handle()
        if not self._display:
            raise egl.failure("eglGetDisplay")
        if not egl.initialize(self._display, None, None):
            raise egl.failure("eglInitialize")
        self._context = self._create(self._config())
        try:
            self.__enter__()
        except ContextError:
            self.release()
            raise

    def _config(self) -> c_void_p:
        wanted = _attributes(
            *(_EGL_SURFACE_TYPE, _EGL_PBUFFER_BIT),
            *(_EGL_RENDERABLE_TYPE, _EGL_OPENGL_BIT, _EGL_NONE),
        )
        config, count = c_void_p(), c_int()
        if not self._egl.choose_config(self._display, wanted, config, 1, count):
            raise self._egl.failure("eglChooseConfig")
        if count.value == 0:
            raise ContextError("eglChooseConfig found no configuration for desktop OpenGL")
        return config

    def _create(self, config: c_void_p) -> int | None:
        if not self._egl.bind_api(_EGL_OPENGL_API):
            raise self._egl.failure("eglBindAPI(EGL_OPENGL_API)")
        for major, minor in CORE_VERSIONS:
            wanted = _attributes(
                *(_EGL_CONTEXT_MAJOR_VERSION, major, _EGL_CONTEXT_MINOR_VERSION, minor),
                *(_EGL_CONTEXT_OPENGL_PROFILE_MASK, _EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT),
                _EGL_NONE,
            )
            context: int | None = self._egl.create_context(self._display, config, None, wanted)
            if context:
                return context
        raise self._egl.failure("eglCreateContext for OpenGL 3.3 core")

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an OpenGL function, 0 where there is none."""
        return self._egl.function_address(name)

    def __enter__(self) -> "EglContext":
        # The bound API is kept per thread and decides what a later unbinding unbinds.
        self._egl.bind_api(_EGL_OPENGL_API)
        if not self._egl.make_current(self._display, None, None, self._context):
            raise self._egl.failure("eglMakeCurrent without a surface")
        return self

    def __exit__(self, *_: object) -> None:
        self._egl.make_current(self._display, None, None, None)

    def release(self) -> None:
        """Destroy the context; harmless when repeated."""
        if self._context:
            if self._egl.current_context() == self._context:
                self._egl.make_current(self._display, None, None, None)
            self._egl.destroy_context(self._display, self._context)
            self._context = None


class OsMesaContext:
    """A core-profile context of Mesa's off-screen library, current once made.

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
        # OSMesa is current only with a default framebuffer, though nothing is drawn there.
        self._pixel = (c_ubyte * 4)()
        self._context = self._create(library)
        self.__enter__()

    @staticmethod
    def _create(library: ctypes.CDLL) -> int | None:
        try:
            create = _bind(library.OSMesaCreateContextAttribs, c_void_p, POINTER(c_int), c_void_p)
        except AttributeError as error:
            raise ContextError("this libOSMesa is older than Mesa 12: no core profile") from error
        for major, minor in CORE_VERSIONS:
            wanted = _attributes(
                *(_OSMESA_FORMAT, _GL_RGBA, _OSMESA_PROFILE, _OSMESA_CORE_PROFILE),
                *(_OSMESA_CONTEXT_MAJOR_VERSION, major, _OSMESA_CONTEXT_MINOR_VERSION, minor, 0),
            )
            context: int | None = create(wanted, None)
            if context:
                return context
        raise ContextError("OSMesaCreateContextAttribs gave no core profile of OpenGL 3.3")

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an OpenGL function, 0 where there is none."""
        return self._proc_address(name.encode()) or 0

    def __enter__(self) -> "OsMesaContext":
        if not self._make_current(self._context, self._pixel, _GL_UNSIGNED_BYTE, 1, 1):
            raise ContextError("OSMesaMakeCurrent failed")
        return self

    def __exit__(self, *_: object) -> None:
        self._make_current(None, None, _GL_UNSIGNED_BYTE, 0, 0)

    def release(self) -> None:
        """Destroy the context; harmless when repeated."""
        if self._context:
            if self._current() == self._context:
                self._make_current(None, None, _GL_UNSIGNED_BYTE, 0, 0)
            self._destroy(self._context)
            self._context = None


OffscreenContext = EglContext | OsMesaContext
"""A native context as moderngl takes it; current once made."""


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
