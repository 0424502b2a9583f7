"""See to it that the system has what Skyline needs and pip cannot bring.

Asks whether things work, not whether packages are installed, so that machines other than Debian's
pass too. What is missing is installed where that is possible (root and apt-get); otherwise one
line says what to install. Runs on any Python 3, so as to tell an old one from a missing package.
"""

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys

OLDEST_PYTHON = (3, 11)


def load(*names):
    """Return the first of these shared libraries that loads, else None."""
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


def venv_works():
    """Whether ``python3 -m venv`` can make an environment with pip in it."""
    return importlib.util.find_spec("ensurepip") is not None


def egl_loads():
    """Whether there is an EGL library."""
    return load("libEGL.so.1") is not None


def egl_has_driver():
    """Whether EGL can start a device, be it a GPU or Mesa's software rasterizer."""
    egl = load("libEGL.so.1")
    if egl is None:
        return False
    pointer = ctypes.c_void_p
    egl.eglGetProcAddress.restype = pointer
    query = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    display_of = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not query or not display_of:
        return False
    query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, pointer, pointer)(query)
    display_of = ctypes.CFUNCTYPE(pointer, ctypes.c_uint, pointer, pointer)(display_of)
    devices, count = (pointer * 16)(), ctypes.c_int(0)
    query(len(devices), devices, ctypes.byref(count))
    egl_platform_device = 0x313F
    displays = [display_of(egl_platform_device, d, None) for d in devices[: count.value]]
    egl.eglInitialize.argtypes = [pointer, pointer, pointer]
    return any(egl.eglInitialize(display, None, None) for display in displays if display)


def osmesa_loads():
    """Whether there is Mesa's off-screen library."""
    return load("libOSMesa.so.8", "libOSMesa.so.6") is not None


def browser_starts():
    """Whether there is a browser that tests of the page can drive."""
    return shutil.which("chromium") is not None and shutil.which("chromedriver") is not None


def exiftool_starts():
    """Whether there is a program by which tests read what was written into photos."""
    return shutil.which("exiftool") is not None


NEEDS = {
    "python3-venv": venv_works,
    "chromium": browser_starts,
    "chromium-driver": browser_starts,
    "libimage-exiftool-perl": exiftool_starts,
    "libegl1": egl_loads,
    "libgl1-mesa-dri": egl_has_driver,
    "libosmesa6": osmesa_loads,
}


def missing_packages():
    """Return the packages whose work is not being done."""
    return [package for package, works in NEEDS.items() if not answer_in_child(works)]


def answer_in_child(works):
    """Ask in a process of its own: what a process has loaded, or failed to, it remembers."""
    child = os.fork()
    if child == 0:
        os.environ["EGL_LOG_LEVEL"] = "fatal"
        os._exit(0 if works() else 1)
    return os.waitpid(child, 0)[1] == 0


def can_do_without(missing):
    """Whether Skyline runs all the same: one way to OpenGL of the two is enough."""
    egl = not {"libegl1", "libgl1-mesa-dri"}.intersection(missing)
    return "python3-venv" not in missing and (egl or "libosmesa6" not in missing)


def install(packages):
    """Install those of the packages that apt knows; newer Debians have no libosmesa6."""
    environment = dict(os.environ, DEBIAN_FRONTEND="noninteractive")

    def apt(*command):
        return subprocess.run(command, env=environment, check=False, stdout=subprocess.DEVNULL)

    print("installing", *packages, flush=True)
    apt("apt-get", "-qq", "update")
    known = [p for p in packages if apt("apt-cache", "show", "-q", p).returncode == 0]
    apt("apt-get", "-qq", "install", "--no-install-recommends", "-y", *known)


def main():
    """Return None, or the line to end with."""
    if sys.version_info < OLDEST_PYTHON:
        found, wanted = sys.version.split()[0], ".".join(map(str, OLDEST_PYTHON))
        return (
            f"{sys.executable} is Python {found}; Skyline needs {wanted} or newer: "
            f"install one and name it, for example make PYTHON=python{wanted}"
        )
    missing = missing_packages()
    if missing and os.geteuid() == 0 and shutil.which("apt-get"):
        install(missing)
        missing = missing_packages()
    if not missing:
        return None
    line = "system packages are missing: sudo apt-get install " + " ".join(missing)
    if can_do_without(missing):
        print(line, "(not needed to go on)", file=sys.stderr)
        return None
    return line


if __name__ == "__main__":
    sys.exit(main())
