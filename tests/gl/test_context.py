"""The OpenGL context on whatever this machine has, and the error where it has nothing."""

import ctypes
import json
import os
import subprocess
import sys
import textwrap
import threading
from functools import partial
from pathlib import Path

import moderngl
import pytest

from skyline.errors import ContextError, InputError
from skyline.render import context as context_module
from skyline.render.context import (
    _OSMESA_LIBRARIES,
    acquire_context,
    describe_context,
    release_context,
)

REPOSITORY = Path(__file__).resolve().parents[2]
TRIANGLE = """
    #version 330 core
    void main() {
        gl_Position = vec4(gl_VertexID % 2 * 4 - 1, gl_VertexID / 2 * 4 - 1, 0.0, 1.0);
    }
"""
COLOUR = """
    #version 330 core
    uniform float green;
    out vec4 colour;
    void main() { colour = vec4(1.0, green, 0.0, 1.0); }
"""


def loadable(names: tuple[str, ...]) -> bool:
    for name in names:
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False


needs_osmesa = pytest.mark.skipif(not loadable(_OSMESA_LIBRARIES), reason="no libOSMesa here")


def draw(ctx: moderngl.Context, green: float) -> tuple[int, ...]:
    """Return the pixel that a triangle over a whole 2 x 2 image leaves."""
    program = ctx.program(vertex_shader=TRIANGLE, fragment_shader=COLOUR)
    program["green"] = green
    target = ctx.simple_framebuffer((2, 2), components=4)
    target.use()
    ctx.vertex_array(program, []).render(vertices=3)
    assert ctx.error == "GL_NO_ERROR"
    return tuple(target.read(components=4)[-4:])


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process of its own, without a display."""
    inherited = {
        name: value
        for name, value in os.environ.items()
        if name not in {"DISPLAY", "WAYLAND_DISPLAY", "SKYLINE_GL", "EGL_LOG_LEVEL"}
    }
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(code)],
        env={**inherited, **environment},
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


DESCRIBE = """
    import json
    from skyline.render.context import acquire_context, describe_context
    target = acquire_context().ctx.simple_framebuffer((1, 1), components=4)
    target.clear(0.0, 1.0, 0.0, 1.0)
    print(json.dumps({**describe_context(), "pixel": list(target.read(components=4))}))
"""


def test_one_context_is_shared_and_draws() -> None:
    first, second = acquire_context(), acquire_context()
    assert first is second
    assert first.ctx.version_code >= 430
    assert draw(first.ctx, 0.0) == (255, 0, 0, 255)
    assert draw(second.ctx, 1.0) == (255, 255, 0, 255)


def test_a_released_context_is_made_anew() -> None:
    before = acquire_context()
    release_context()
    release_context()
    after = acquire_context()
    assert after is not before
    assert draw(after.ctx, 1.0) == (255, 255, 0, 255)


def test_the_description_has_all_attempts_and_the_reason() -> None:
    described = describe_context()
    assert json.loads(json.dumps(described)) == described
    assert described["renderer"] == acquire_context().ctx.info["GL_RENDERER"]
    assert described["reason"]
    assert str(described["renderer"]) in described["tried"][-1]


def test_another_thread_is_refused() -> None:
    acquire_context()
    refusals: list[ContextError] = []

    def intrude() -> None:
        for function in (acquire_context, release_context):
            try:
                function()
            except ContextError as error:
                refusals.append(error)

    thread = threading.Thread(target=intrude, name="intruder")
    thread.start()
    thread.join()
    assert ["'intruder'" in str(refusal) for refusal in refusals] == [True, True]
    assert draw(acquire_context().ctx, 0.0) == (255, 0, 0, 255)


def test_the_context_of_an_ended_thread_can_be_replaced() -> None:
    result = run_python("""
        import threading
        from skyline.errors import ContextError
        from skyline.render.context import acquire_context, release_context
        thread = threading.Thread(target=acquire_context, name="ended")
        thread.start()
        thread.join()
        try:
            acquire_context()
        except ContextError as error:
            print(error)
        release_context()
        target = acquire_context().ctx.simple_framebuffer((1, 1), components=4)
        target.clear(0.0, 1.0, 0.0, 1.0)
        print(list(target.read(components=4)))
    """)
    refusal, pixel = result.stdout.splitlines()
    assert "'ended'" in refusal
    assert "release_context()" in refusal
    assert pixel == "[0, 255, 0, 255]"
    assert result.stderr == ""


def test_a_fork_after_the_context_is_refused_and_leaves_the_parent_alone() -> None:
    result = run_python("""
        import os, sys
        from skyline.errors import ContextError
        from skyline.render.context import acquire_context
        texture = acquire_context().ctx.texture((1, 1), 4, bytes([9, 8, 7, 6]))
        if os.fork() == 0:
            try:
                acquire_context()
            except ContextError as error:
                print(error, flush=True)
            sys.exit()  # runs the child's exit handlers
        os.wait()
        print(list(texture.read()))
    """)
    refusal, pixel = result.stdout.splitlines()
    assert "was forked from" in refusal
    assert '"spawn"' in refusal
    assert pixel == "[9, 8, 7, 6]"
    assert result.stderr == ""


def test_an_unknown_backend_names_those_known(monkeypatch: pytest.MonkeyPatch) -> None:
    release_context()
    monkeypatch.setenv("SKYLINE_GL", "metal")
    with pytest.raises(InputError, match=r"SKYLINE_GL is 'metal'; expected egl or osmesa"):
        acquire_context()


@needs_osmesa
def test_osmesa_can_be_forced() -> None:
    result = run_python(DESCRIBE, SKYLINE_GL="osmesa")
    described = json.loads(result.stdout)
    assert described["backend"] == "osmesa"
    assert "SKYLINE_GL=osmesa" in described["reason"]
    assert described["pixel"] == [0, 255, 0, 255]
    assert result.stderr == ""


@needs_osmesa
def test_osmesa_comes_after_an_egl_that_fails() -> None:
    hide_egl = 'from skyline.render import context\ncontext._EGL_LIBRARY = "libNo.so.1"\n'
    described = json.loads(run_python(hide_egl + textwrap.dedent(DESCRIBE)).stdout)
    assert described["backend"] == "osmesa"
    assert "libNo.so.1" in described["tried"][0]
    assert "EGL gave no context" in described["reason"]


def test_without_opengl_the_error_has_all_attempts_and_the_packages() -> None:
    result = run_python("""
        from skyline.errors import ContextError
        from skyline.render import context
        context._EGL_LIBRARY = "libNoEGL.so.1"
        context._OSMESA_LIBRARIES = ("libNoOSMesa.so.8", "libNoOSMesa.so.6")
        try:
            context.acquire_context()
        except ContextError as error:
            print(error)
    """)
    lines = result.stdout.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("no OpenGL context of version 4.3 or newer; tried egl, ")
    assert "libNoEGL.so.1 not loaded" in lines[0]
    for name in ("libNoOSMesa.so.8", "libNoOSMesa.so.6"):
        assert f"{name}: cannot open shared object file" in lines[0]
    assert lines[0].endswith("sudo apt-get install libegl1 libgl1-mesa-dri libosmesa6")
    assert result.stderr == ""


def test_drivers_that_fail_stay_off_stderr() -> None:
    result = run_python(
        """
        from skyline.errors import ContextError
        from skyline.render.context import acquire_context
        try:
            acquire_context()
        except ContextError as error:
            print(error)
        """,
        SKYLINE_GL="egl",
        __EGL_VENDOR_LIBRARY_FILENAMES="/nonexistent.json",
    )
    assert result.stderr == ""
    assert len(result.stdout.splitlines()) == 1
    assert "libegl1 libgl1-mesa-dri" in result.stdout
    assert "libosmesa6" not in result.stdout


class StandIn:
    """A native context by name; notes which one is current and which are released."""

    current = ""

    def __init__(self, name: str) -> None:
        if name == "broken":
            raise ContextError("eglInitialize failed (0x3001)")
        self.name = name
        self.released = False
        self.info = {"GL_VENDOR": "", "GL_RENDERER": name, "GL_VERSION": "4.5"}
        self.__enter__()

    def __enter__(self) -> None:
        StandIn.current = self.name

    def __exit__(self, *_: object) -> None:
        StandIn.current = ""

    def release(self) -> None:
        self.released = True


@pytest.mark.parametrize(
    ("devices", "chosen"),
    [
        (["broken", "llvmpipe", "GeForce"], "GeForce"),
        (["too old", "llvmpipe"], "llvmpipe"),
        (["llvmpipe", "softpipe", "broken"], "llvmpipe"),
        (["broken"], None),
    ],
)
def test_a_gpu_is_preferred_among_devices(
    monkeypatch: pytest.MonkeyPatch, devices: list[str], chosen: str | None
) -> None:
    made: list[StandIn] = []
    monkeypatch.setattr(StandIn, "current", "")

    def make(name: str) -> StandIn:
        made.append(StandIn(name))
        return made[-1]

    def wrap(require: int, standalone: bool, context: StandIn) -> StandIn:
        if context.name == "too old":
            raise ValueError(f"Requested OpenGL version {require}, got version 420")
        return context

    monkeypatch.setattr(
        context_module, "_devices", lambda _: [(name, partial(make, name)) for name in devices]
    )
    monkeypatch.setattr(context_module.moderngl, "create_context", wrap)
    best = context_module._best_device("egl", [], False)
    assert (best and best.device) == chosen
    assert StandIn.current == (chosen or "")
    assert [native.name for native in made if not native.released] == [chosen] * bool(chosen)
