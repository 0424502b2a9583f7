"""The OpenGL context: one a process, made on first use, shared by every renderer, no display.

The order is EGL on a GPU, EGL on Mesa's software rasterizer, OSMesa; ``SKYLINE_GL=egl`` or
``SKYLINE_GL=osmesa`` allows one of them alone.

Threads: the context belongs to the thread that first acquired it, and any other is refused.
Processes: drivers keep threads of their own, which a fork does not copy, so a child forked after
the context was made is refused as well (measured: Mesa hangs there). Start workers with
multiprocessing's "spawn" method, or fork before anything is rendered.
"""

import atexit
import logging
import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import moderngl

from skyline.errors import ContextError, InputError
from skyline.render.offscreen import (
    GL_RENDERER,
    GL_VERSION,
    Egl,
    EglContext,
    EglDisplay,
    OffscreenContext,
    OsMesaContext,
    gl_string,
)

ENVIRONMENT_VARIABLE = "SKYLINE_GL"
BACKENDS = ("egl", "osmesa")
"""In the order they are tried."""

_DEBIAN_PACKAGES = {"egl": "libegl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}
_DRIVER_SAYS = ("VENDOR", "RENDERER", "VERSION")
_MINIMUM_VERSION = 330
_COMPUTE_VERSION = 430
_SOFTWARE = re.compile(
    r"llvmpipe|softpipe|swrast|\bSWR\b|lavapipe|swiftshader|software", re.IGNORECASE
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class GlContext:
    """The process's OpenGL context, and how it came to be."""

    ctx: moderngl.Context
    native: OffscreenContext
    """What ``ctx`` was made of."""
    backend: str
    """``egl`` or ``osmesa``."""
    vendor: str
    renderer: str
    version: str
    """``vendor``, ``renderer``, ``version``: the driver's GL_VENDOR, GL_RENDERER and GL_VERSION."""
    attempts: tuple[str, ...]
    """All that was tried, in order: backend, device, and what it said."""
    forced: bool
    """Whether ``SKYLINE_GL`` named the backend."""

    @property
    def version_code(self) -> int:
        """OpenGL version, 100 * major + 10 * minor."""
        return int(self.ctx.version_code)

    @property
    def software(self) -> bool:
        """Whether the CPU does the rendering."""
        return is_software(self.renderer)

    @property
    def has_compute(self) -> bool:
        """Whether there are compute shaders (OpenGL 4.3)."""
        return self.version_code >= _COMPUTE_VERSION

    @property
    def reason(self) -> str:
        """Why this context and no other, in words."""
        if self.forced:
            return f"{ENVIRONMENT_VARIABLE}={self.backend} allows no other backend"
        if not self.software:
            return "a GPU comes first"
        if self.backend == "egl":
            return "no GPU found through EGL; its software rasterizer comes next"
        return "EGL gave no context; OSMesa comes last"


class _SharedContext:
    """Holds the one context, and the process and thread it belongs to."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._context: GlContext | None = None
        self._process: int | None = None
        self._thread = threading.current_thread()

    def acquire(self) -> GlContext:
        """Return the process's OpenGL context, current in this thread; make it on first use.

        Calling again is cheap, and makes the context current again where other code has put its
        own in place.

        Raises
        ------
        ContextError
            Nothing works (the message names what was tried and the packages that mend it), or the
            context belongs to another thread or to the process that this one was forked from.
        InputError
            ``SKYLINE_GL`` names no backend.
        """
        # Before the lock: another thread of the parent may have held it during the fork.
        if self._process not in (None, os.getpid()):
            raise ContextError(
                f"process {os.getpid()} was forked from {self._process} after that made its OpenGL "
                "context, which a fork does not survive; start workers with multiprocessing's \""
                'spawn" method or fork before rendering'
            )
        with self._lock:
            if self._context is None:
                self._context = _choose_context()
                self._process = os.getpid()
                self._thread = threading.current_thread()
                _log.info("OpenGL context: %s (%s)", self._context.renderer, self._context.reason)
            elif self._thread is not threading.current_thread():
                raise self._refuse_thread()
            else:
                self._context.native.__enter__()
            return self._context

    def _refuse_thread(self) -> ContextError:
        owner, caller = self._thread, threading.current_thread()
        remedy = (
            "render in that thread, or in a process of its own"
            if owner.is_alive()
            else "that one has ended: call release_context() and make new renderers"
        )
        return ContextError(
            f"thread {caller.name!r} asked for the OpenGL context of thread {owner.name!r}; "
            f"{remedy}"
        )

    def release(self) -> None:
        """Release the context if there is one; whatever was made in it is gone.

        Runs by itself when the process exits. A later `acquire_context` makes a new context.
        Raises `ContextError` where the context belongs to another thread that still lives.
        """
        # What a forked child inherited is the parent's to release.
        if self._process != os.getpid():
            return
        with self._lock:
            if self._context is not None:
                if self._thread.is_alive() and self._thread is not threading.current_thread():
                    raise self._refuse_thread()
                self._context.ctx.release()
                self._context.native.release()
            self._context = None


_shared = _SharedContext()


acquire_context, release_context = _shared.acquire, _shared.release


@atexit.register
def _release_at_exit() -> None:
    # A thread that outlives the interpreter may be rendering: the system cleans up after it.
    with suppress(ContextError):
        _shared.release()


def describe_context() -> dict[str, str | bool | list[str]]:
    """Return what was chosen and why, ready to print or for JSON; makes the context if needed.

    Raises as `acquire_context`.
    """
    context = acquire_context()
    return {
        "backend": context.backend,
        "device": context.native.device,
        "vendor": context.vendor,
        "renderer": context.renderer,
        "version": context.version,
        "software": context.software,
        "compute": context.has_compute,
        "reason": context.reason,
        "tried": list(context.attempts),
    }


def is_software(renderer: str) -> bool:
    """Return whether a GL_RENDERER is a rasterizer on the CPU."""
    return _SOFTWARE.search(renderer) is not None


def _choose_context() -> GlContext:
    forced = os.environ.get(ENVIRONMENT_VARIABLE, "")
    if forced and forced not in BACKENDS:
        raise InputError(
            f"{ENVIRONMENT_VARIABLE} is {forced!r}; expected {' or '.join(BACKENDS)}, or unset it "
            "to take the best there is"
        )
    backends = (forced,) if forced else BACKENDS
    attempts: list[str] = []
    with _quiet_drivers():
        for backend in backends:
            native = _try_egl(attempts) if backend == "egl" else _try_osmesa(attempts)
            if native is not None:
                return _wrap(native, backend, tuple(attempts), bool(forced))
    packages = " ".join(_DEBIAN_PACKAGES[backend] for backend in backends)
    raise ContextError(
        f"no OpenGL context of version 3.3 or newer; tried {'; '.join(attempts)}; on Debian or "
        f"Ubuntu: sudo apt-get install {packages}"
    )


def _try_egl(attempts: list[str]) -> OffscreenContext | None:
    """Return a context on the first GPU, else on the first software rasterizer, else None."""
    try:
        egl = Egl()
    except ContextError as error:
        attempts.append(f"egl, the library: {error}")
        return None
    best = _best_display(egl, egl.device_displays(), attempts)
    return best or _best_display(egl, egl.plain_displays(), attempts)


def _best_display(
    egl: Egl, displays: Iterator[EglDisplay], attempts: list[str]
) -> OffscreenContext | None:
    fallback: OffscreenContext | None = None
    for display in displays:
        try:
            native = EglContext(egl, display)
        except ContextError as error:
            attempts.append(f"egl, {display.name}: {error}")
            continue
        attempts.append(f"egl, {display.name}: {_introduce(native)}")
        if not is_software(gl_string(native, GL_RENDERER)):
            if fallback is not None:
                fallback.release()
                native.__enter__()
            return native
        if fallback is None:
            fallback = native
        else:
            native.release()
    if fallback is not None:
        fallback.__enter__()
    return fallback


def _try_osmesa(attempts: list[str]) -> OffscreenContext | None:
    try:
        native = OsMesaContext()
    except ContextError as error:
        attempts.append(f"osmesa, the library: {error}")
        return None
    attempts.append(f"osmesa, {native.device}: {_introduce(native)}")
    return native


def _introduce(native: OffscreenContext) -> str:
    return f"OpenGL {gl_string(native, GL_VERSION)} on {gl_string(native, GL_RENDERER)}"


def _wrap(
    native: OffscreenContext, backend: str, attempts: tuple[str, ...], forced: bool
) -> GlContext:
    settings: dict[str, Any] = {"context": native}
    try:
        # standalone: there is no default framebuffer for moderngl to look at.
        ctx = moderngl.create_context(require=_MINIMUM_VERSION, standalone=True, **settings)
    except (moderngl.Error, ValueError) as error:
        native.release()
        raise ContextError(
            f"moderngl refuses {attempts[-1]}: {error}; try "
            f"{ENVIRONMENT_VARIABLE}={' or '.join(set(BACKENDS) - {backend})}"
        ) from error
    vendor, renderer, version = (ctx.info[f"GL_{what}"] for what in _DRIVER_SAYS)
    return GlContext(ctx, native, backend, vendor, renderer, version, attempts, forced)


@contextmanager
def _quiet_drivers() -> Iterator[None]:
    """Keep EGL's warnings about the devices that fail off stderr: the attempts say them."""
    before = os.environ.get("EGL_LOG_LEVEL")
    os.environ.setdefault("EGL_LOG_LEVEL", "fatal")
    try:
        yield
    finally:
        if before is None:
            del os.environ["EGL_LOG_LEVEL"]
