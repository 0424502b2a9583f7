"""The OpenGL context on whatever this machine has, and the error where it has nothing."""

import inspect
import json
import os
import subprocess
import sys
import textwrap
import threading
from concurrent.futures import ThreadPoolExecutor
from ctypes.util import find_library
from functools import partial
from unittest.mock import MagicMock

import pytest

from skyline.errors import ContextError, InputError
from skyline.render.context import (
    GlContext,
    best_device,
    held_context,
    process_context,
)


def cleared(context: GlContext) -> list[int]:
    """Return the pixel of an image that is cleared to green."""
    target = context.ctx.simple_framebuffer((1, 1), components=4)
    target.clear(0.0, 1.0, 0.0, 1.0)
    return list(target.read(components=4))


GREEN = [0, 255, 0, 255]

PRELUDE = f"""
import json, os, sys, threading
from skyline.errors import ContextError
from skyline.render.context import GlContext, GlLibraries, SharedContext, held_context

def refusal(held=held_context):
    try:
        with held():
            return
    except ContextError as error:
        return error

{inspect.getsource(cleared)}
"""


def run_python(code: str, **environment: str) -> list[str]:
    """Run code in a process of its own, without a display; return the lines that it prints."""
    hidden = "DISPLAY", "WAYLAND_DISPLAY", "SKYLINE_GL", "EGL_LOG_LEVEL"
    inherited = {name: value for name, value in os.environ.items() if name not in hidden}
    command = [sys.executable, "-W", "error", "-c", PRELUDE + textwrap.dedent(code)]
    options = {"env": inherited | environment, "timeout": 120, "text": True}
    done = subprocess.run(command, capture_output=True, check=True, **options)
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_one_context_is_shared_and_a_released_one_is_made_anew():
    with held_context() as before, held_context() as again:
        assert again is before
        assert before.ctx.version_code >= 430
    process_context().release()
    process_context().release()
    with held_context() as after:
        assert after is not before
        assert cleared(after) == GREEN


def test_threads_hold_it_in_turn():
    began, ends = threading.Event(), threading.Event()

    def hold():
        with held_context() as context:
            began.set()
            assert ends.wait(60.0)
            return context, cleared(context)

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(hold)
        assert began.wait(60.0)
        second = pool.submit(hold)
        # An exit in between does not wait for the thread.
        process_context().release(is_patient=False)
        assert not second.done()
        ends.set()
        assert first.result() == second.result()
    with held_context() as context:
        assert (context, cleared(context)) == first.result()


def test_a_fork_after_the_context_is_refused_and_leaves_the_parent_alone():
    refusal, pixel = run_python("""
        with held_context() as context:
            texture = context.ctx.texture((1, 1), 4, bytes([9, 8, 7, 6]))
        if os.fork() == 0:
            print(refusal(), flush=True)
            sys.exit()  # runs the child's exit handlers
        os.wait()
        with held_context():
            print(list(texture.read()))
    """)
    assert "was forked from" in refusal
    assert '"spawn"' in refusal
    assert pixel == "[9, 8, 7, 6]"


def test_an_unknown_backend_names_those_known(monkeypatch):
    process_context().release()
    monkeypatch.setenv("SKYLINE_GL", "metal")
    said = r"SKYLINE_GL is 'metal'; expected egl or osmesa"
    with pytest.raises(InputError, match=said), held_context():
        pass


@pytest.mark.skipif(find_library("OSMesa") is None, reason="no libOSMesa here")
@pytest.mark.parametrize(
    ("egl_library", "environment", "reason"),
    [
        ("libEGL.so.1", {"SKYLINE_GL": "osmesa"}, "SKYLINE_GL=osmesa"),
        ("libNo.so.1", {}, "EGL gave no context"),
    ],
)
def test_osmesa_can_be_forced_and_comes_after_a_failing_egl(egl_library, environment, reason):
    code = f"""
        with SharedContext(GlLibraries(egl={egl_library!r})).held() as context:
            print(json.dumps(context.facts()))
            print(cleared(context))
    """
    lines = run_python(code, **environment)
    described, pixel = map(json.loads, lines)
    assert described["backend"] == "osmesa"
    assert reason in described["reason"]
    assert pixel == GREEN


def test_without_opengl_the_error_has_all_attempts_and_the_packages():
    (line,) = run_python("""
        none = GlLibraries("libNoEGL.so.1", ("libNoOSMesa.so.8", "libNoOSMesa.so.6"))
        print(refusal(SharedContext(none).held))
    """)
    assert line.startswith("no OpenGL context of version 4.3 or newer; tried egl, ")
    assert "libNoEGL.so.1 not loaded" in line
    for name in ("libNoOSMesa.so.8", "libNoOSMesa.so.6"):
        assert f"{name}: cannot open shared object file" in line
    assert line.endswith("sudo apt-get install libegl1 libgl1-mesa-dri libosmesa6")


def test_drivers_that_fail_stay_off_stderr():
    (line,) = run_python(
        "print(refusal())", SKYLINE_GL="egl", __EGL_VENDOR_LIBRARY_FILENAMES="/nonexistent.json"
    )
    assert "libegl1 libgl1-mesa-dri" in line
    assert "libosmesa6" not in line


@pytest.mark.parametrize(
    ("devices", "chosen"),
    [
        (["broken", "llvmpipe", "GeForce"], "GeForce"),
        (["too old", "llvmpipe", "softpipe"], "llvmpipe"),
        (["broken"], None),
    ],
)
def test_a_gpu_is_preferred_among_devices(monkeypatch, devices, chosen):
    made, current = {}, []

    def make(name):
        if name == "broken":
            raise ContextError("eglInitialize failed (0x3001)")
        made[name] = MagicMock(info={"GL_VENDOR": "", "GL_RENDERER": name, "GL_VERSION": "4.5"})
        made[name].__enter__.side_effect = lambda: current.append(name)
        return made[name]

    def wrap(require, standalone, context):
        if context is made.get("too old"):
            raise ValueError(f"Requested OpenGL version {require}, got version 420")
        return context

    named = [(name, partial(make, name)) for name in devices]
    monkeypatch.setattr("moderngl.create_context", wrap)
    best = best_device("egl", named, [])
    assert (best and best.device) == chosen
    assert current[-1:] == [chosen] * bool(chosen)
    kept = [name for name, native in made.items() if not native.release.called]
    assert kept == [chosen] * bool(chosen)
