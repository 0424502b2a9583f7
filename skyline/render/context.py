"""The OpenGL context without a display, its programs, and a rendering thread.

OpenGL 4.3 is required, for its compute shaders. Contexts are tried in this order: EGL on a GPU, EGL
on Mesa's software rasterizer, OSMesa; ``SKYLINE_GL=egl`` or ``SKYLINE_GL=osmesa`` allows only one
of them.

Threads take turns with the one context of a process: it is current in a thread while that thread
holds it, and in none otherwise. A child that is forked afterwards cannot use it: a fork does not
copy the threads of a driver (measured: Mesa hangs there).
"""

import atexit
import itertools
import os
import queue
import re
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache, partial, wraps
from pathlib import Path
from typing import Any, NoReturn, ParamSpec, Self, TypeVar
from weakref import WeakValueDictionary

import moderngl

from skyline.errors import ContextError, InputError
from skyline.render.osmesa import OsMesaContext

T = TypeVar("T")
Parameters = ParamSpec("Parameters")

ENVIRONMENT_VARIABLE = "SKYLINE_GL"
BACKENDS = {"egl": "libegl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}
"""The backends in the order of attempts, with the Debian packages for each."""

_VERSION = (4, 3)
"""The version of OpenGL that is required, for its compute shaders."""

_VERSION_CODE = 100 * _VERSION[0] + 10 * _VERSION[1]
"""That version as glcontext and moderngl write it."""

_PACKAGE = Path(__file__).parents[1]
_SHADERS = next(
    folder for folder in (_PACKAGE / "shaders", _PACKAGE.parent / "shaders") if folder.is_dir()
)
"""The folder of shaders in the wheel, or the one in the repository."""


@dataclass(frozen=True, slots=True)
class GlLibraries:
    """Names of the shared libraries in which OpenGL is searched."""

    egl: str = "libEGL.so.1"
    osmesa: tuple[str, ...] = ("libOSMesa.so.8", "libOSMesa.so.6")
    """The first that loads is used."""


@dataclass(frozen=True, slots=True, eq=False)
class GlContext:
    """An OpenGL context, and the reason for its choice."""

    ctx: moderngl.Context
    native: Any
    """The context of glcontext, or OSMesa's, under ``ctx``."""
    backend: str
    """``egl`` or ``osmesa``."""
    device: str
    """Name of the backend's device."""
    vendor: str
    """The driver's GL_VENDOR."""
    renderer: str
    """The driver's GL_RENDERER."""
    version: str
    """The driver's GL_VERSION."""
    attempts: list[str]
    """All attempts in order: backend, device, and its OpenGL or its error."""
    shared: WeakValueDictionary[Hashable, Any] = field(default_factory=WeakValueDictionary)
    """What renderers of this context share, as long as one of them holds it."""

    @property
    def software(self) -> bool:
        """True if the CPU does the rendering."""
        names = r"llvmpipe|softpipe|swrast|\bSWR\b|lavapipe|swiftshader|software"
        return re.search(names, self.renderer, re.IGNORECASE) is not None

    @property
    def reason(self) -> str:
        """Why this context was chosen, in one phrase."""
        if os.environ.get(ENVIRONMENT_VARIABLE):
            return f"{ENVIRONMENT_VARIABLE}={self.backend} allows no other backend"
        if not self.software:
            return "a GPU comes first"
        if self.backend == "egl":
            return "no GPU found through EGL; its software rasterizer comes next"
        return "EGL gave no context; OSMesa comes last"

    def facts(self) -> dict[str, str | bool | list[str]]:
        """Return the facts of the context, for JSON."""
        names = ("backend", "device", "vendor", "renderer", "version", "software", "reason")
        return {**{name: getattr(self, name) for name in names}, "tried": self.attempts}


class SharedContext:
    """One context for a process's renderers; threads hold it in turn."""

    def __init__(self, libraries: GlLibraries = GlLibraries()) -> None:
        self._libraries = libraries
        self._turn = threading.RLock()
        self._holds = 0
        self._context: GlContext | None = None
        self._process: int | None = None

    @contextmanager
    def held(self) -> Iterator[GlContext]:
        """Hold the context for the block, current in this thread.

        The first use makes it. Other threads wait until the block ends. Blocks may be nested; the
        outermost one also frees what nothing holds any more. Raises `ContextError` if no backend
        gives OpenGL 4.3, or if the context belongs to the process that this one was forked from,
        and `InputError` if ``SKYLINE_GL`` names no backend.
        """
        # This comes before the turn, which another thread of the parent may have had at the fork.
        if self._process not in (None, os.getpid()):
            raise ContextError(
                f"process {os.getpid()} was forked from process {self._process}, which had an "
                "OpenGL context, and no context survives a fork; start workers with "
                'multiprocessing\'s "spawn" method, or fork before rendering'
            )
        with self._turn:
            context = self._context
            if context is None:
                self._context = context = _choose_context(self._libraries)
                self._process = os.getpid()
            elif not self._holds:
                context.native.__enter__()
                context.ctx.gc()
            self._holds += 1
            try:
                yield context
            finally:
                self._holds -= 1
                if not self._holds:
                    context.native.__exit__(None, None, None)

    def release(self, is_patient: bool = True) -> None:
        """Release the context and all that renderers made in it.

        Does nothing without a context, or, unless ``is_patient``, while a thread renders.
        """
        # Only the process that made the context may release it.
        if self._process != os.getpid() or not self._turn.acquire(blocking=is_patient):
            return
        try:
            if self._context is not None:
                _destroy(self._context)
            self._context = None
        finally:
            self._turn.release()


@cache
def process_context() -> SharedContext:
    """Return the context that all renderers of this process share.

    It is released when the process exits, unless a thread that outlives the interpreter is
    rendering; then the system frees the context.
    """
    shared = SharedContext()
    atexit.register(shared.release, is_patient=False)
    return shared


def held_context() -> AbstractContextManager[GlContext]:
    """Hold the process's context; see `SharedContext.held`."""
    return process_context().held()


def in_context(method: Callable[Parameters, T]) -> Callable[Parameters, T]:
    """Let a function hold the process's context while it runs."""

    @wraps(method)
    def holding(*arguments: Parameters.args, **named: Parameters.kwargs) -> T:
        with held_context():
            return method(*arguments, **named)

    return holding


def _choose_context(libraries: GlLibraries) -> GlContext:
    """Return a context of the first backend that gives one.

    It is on that backend's best device.
    """
    forced = os.environ.get(ENVIRONMENT_VARIABLE, "")
    if forced and forced not in BACKENDS:
        raise InputError(
            f"{ENVIRONMENT_VARIABLE} is {forced!r}; expected {' or '.join(BACKENDS)}, or unset it "
            "to take the best there is"
        )
    backends = [forced] if forced else [*BACKENDS]
    attempts: list[str] = []
    # EGL's warnings about failing devices stay off stderr; the attempts hold the errors.
    os.environ.setdefault("EGL_LOG_LEVEL", "fatal")
    for backend in backends:
        devices = _devices(backend, libraries)
        if (found := best_device(backend, devices, attempts)) is not None:
            return found
    packages = " ".join(BACKENDS[backend] for backend in backends)
    raise ContextError(
        f"no OpenGL context of version 4.3 or newer; tried {'; '.join(attempts)}; on Debian or "
        f"Ubuntu: sudo apt-get install {packages}"
    )


def best_device(
    backend: str, devices: Sequence[tuple[str, Callable[[], Any]]], attempts: list[str]
) -> GlContext | None:
    """Return a context on the first GPU, else on the first device.

    Devices are names, each with a function that makes a native context there. Every attempt is
    appended to ``attempts``. Contexts on other devices are destroyed.
    """
    fallback: GlContext | None = None
    for device, make in devices:
        try:
            found = _wrap(make(), backend, device, attempts)
        except ContextError as error:
            attempts.append(f"{backend}, {device}: {error}")
            continue
        attempts.append(f"{backend}, {device}: OpenGL {found.version} on {found.renderer}")
        if not found.software:
            if fallback is not None:
                _destroy(fallback)
                found.native.__enter__()
            return found
        if fallback is None:
            fallback = found
        else:
            _destroy(found)
    if fallback is not None:
        fallback.native.__enter__()
    return fallback


def _devices(backend: str, libraries: GlLibraries) -> list[tuple[str, Callable[[], Any]]]:
    """Return a backend's devices, each with a function that makes a context."""
    if backend == "osmesa":
        return [("Mesa off-screen library", partial(OsMesaContext, libraries.osmesa, _VERSION))]
    count = 1
    try:
        _egl_context(libraries.egl, 1 << 30)
    except ContextError as error:
        # glcontext gives the number of devices only in its error for an index that is too large.
        if found := re.search(r"found (\d+) devices", str(error)):
            count = max(int(found[1]), 1)
    return [
        (f"device {index}", partial(_egl_context, libraries.egl, index)) for index in range(count)
    ]


def _egl_context(library: str, device_index: int) -> Any:
    """Return glcontext's context on an EGL device, or raise `ContextError`."""
    try:
        from glcontext import egl  # noqa: PLC0415  (glcontext has it on Linux alone)

        return egl.create_context(
            mode="standalone",
            # EGL finds all functions of OpenGL, so that libGL need not be installed.
            libgl=library,
            libegl=library,
            glversion=_VERSION_CODE,
            device_index=device_index,
        )
    except Exception as error:  # glcontext raises plain exceptions.
        raise ContextError(str(error)) from error


def _wrap(native: Any, backend: str, device: str, attempts: list[str]) -> GlContext:
    try:
        # Standalone: moderngl must not look for a default framebuffer.
        ctx = moderngl.create_context(require=_VERSION_CODE, standalone=True, context=native)
    except (moderngl.Error, ValueError) as error:
        native.__exit__(None, None, None)
        native.release()
        raise ContextError(f"moderngl refuses it: {error}") from error
    # Objects without a holder are freed by `gc`, in the context's own thread.
    ctx.gc_mode = "context_gc"
    vendor, renderer, version = (ctx.info[f"GL_{key}"] for key in ("VENDOR", "RENDERER", "VERSION"))
    return GlContext(ctx, native, backend, device, vendor, renderer, version, attempts)


def _destroy(context: GlContext) -> None:
    """Destroy a context; none is current afterwards."""
    # EGL keeps a context alive while it is current.
    context.native.__exit__(None, None, None)
    context.ctx.release()


def compile_shaders(ctx: moderngl.Context, *names: str, defines: Mapping[str, str]) -> Any:
    """Compile a compute shader, or link a vertex and a fragment shader.

    Each shader has the name of its file. ``defines`` are macros of all shaders. Raises
    `ContextError` with the words of a driver that refuses a shader.
    """
    macros = "".join(f"#define {name} {value}\n" for name, value in defines.items())
    texts = []
    for name in names:
        notes, version, rest = (_SHADERS / name).read_text("utf-8").partition("#version")
        number, _, code = rest.partition("\n")
        # The driver counts lines as in the file.
        line = f"#line {notes.count(chr(10)) + 2}\n"
        texts.append(f"{notes}{version}{number}\n{macros}{line}{code}")
    try:
        if len(texts) == 1:
            return ctx.compute_shader(texts[0])
        return ctx.program(vertex_shader=texts[0], fragment_shader=texts[1])
    except moderngl.Error as error:
        log = "; ".join(line.strip() for line in str(error).splitlines() if line.strip())
        raise ContextError(f"the driver refuses {' + '.join(names)}: {log}") from error


class Closeable(ABC):
    """Base of objects with memory on the GPU.

    Leaving their ``with`` block frees the memory.
    """

    @abstractmethod
    def close(self) -> None:
        """Free the memory on the GPU; closing twice is fine."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __reduce__(self) -> NoReturn:
        name = type(self).__name__
        raise InputError(
            f"a {name} holds memory on the GPU, and cannot be copied or sent to another process; "
            "make one there"
        )


class Renderer(Closeable):
    """Holds objects of the OpenGL context until nothing needs them."""

    def __init__(self, name: str) -> None:
        with held_context() as context:
            self._context = context
        self.description = f"{name}; {self._context.renderer}"
        """Name of this rasterizer and of the OpenGL renderer under it, for records."""

    @in_context
    def close(self) -> None:
        """Free this renderer's buffers, textures and programs; the context stays for others."""
        ctx = self._context.ctx
        # A framebuffer must not be bound after its release.
        ctx.detect_framebuffer(0).use()
        for name, held in list(vars(self).items()):
            if hasattr(held, "mglo"):
                delattr(self, name)
        ctx.gc()


class _Rank(IntEnum):
    """Ranks of a render thread's tasks; the last one ends it."""

    URGENT = 0
    USUAL = 1
    LAST = 2


class RenderThread:
    """Runs tasks one after another on one thread, the urgent ones first."""

    def __init__(self) -> None:
        # Numbers keep the order within a rank, and futures from being compared.
        self._tasks: queue.PriorityQueue[tuple[int, int, Future[Any], Callable[[], Any] | None]] = (
            queue.PriorityQueue()
        )
        self._numbers = itertools.count()
        self._closing = threading.Lock()
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="rendering", daemon=True)
        self._thread.start()

    def run(self, task: Callable[[], T], urgent: bool = False) -> T:
        """Run a task and return its result.

        Raises the task's errors, and `ContextError` once the thread is closed.
        """
        if threading.current_thread() is self._thread:
            return task()
        future: Future[T] = Future()
        with self._closing:
            if self._closed:
                raise ContextError("the render thread is closed; make another")
            rank = _Rank.URGENT if urgent else _Rank.USUAL
            self._tasks.put((rank, next(self._numbers), future, task))
        return future.result()

    def close(self) -> None:
        """Finish waiting tasks, and end the thread; closing twice is fine."""
        with self._closing:
            if not self._closed:
                self._closed = True
                self._tasks.put((_Rank.LAST, next(self._numbers), Future(), None))
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _work(self) -> None:
        while True:
            _, _, future, task = self._tasks.get()
            if task is None:
                return
            try:
                future.set_result(task())
            except BaseException as error:  # The caller of `run` handles it.
                future.set_exception(error)
            # The result must not live on until the next task.
            del future, task
