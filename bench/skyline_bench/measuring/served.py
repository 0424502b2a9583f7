"""The page in a process of its own, and a browser without a screen to look at it."""

import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from skyline.errors import BuildError, InputError
from skyline_bench.measuring.timing import own_bytes

_SERVE = "from skyline.cli import main; main()"
_WINDOW = {"width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": False}


@dataclass(frozen=True, slots=True)
class ServedPage:
    """A page that is being served."""

    address: str
    ready_s: float  # From the command to the page's first answer
    process: int  # Its number

    def own_bytes(self) -> int:
        """Return the memory of the server that lies in no file."""
        return own_bytes(self.process) or 0


@contextmanager
def served_page(arguments: Sequence[str | Path]) -> Iterator[ServedPage]:
    """Run ``skyline serve`` with some arguments, on any free port."""
    command = [sys.executable, "-c", _SERVE, "serve", *map(str, arguments), "--port", "0"]
    began = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        try:
            line = "" if run.stdout is None else run.stdout.readline()
            found = re.search(r"http://\S+", line)
            if found is None:
                raise BuildError("the page was not served; `skyline serve` says why")
            with urlopen(found[0]) as answer:
                answer.read()
            yield ServedPage(found[0], time.perf_counter() - began, run.pid)
        finally:
            run.terminate()


@contextmanager
def browser() -> Iterator[Any]:
    """Start Chromium as `headless` has it; raises likewise."""
    options, service = headless()
    from selenium import webdriver  # noqa: PLC0415  (an extra)

    with webdriver.Chrome(options=options, service=service) as running:
        running.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", _WINDOW)
        yield running


def headless() -> tuple[Any, Any]:
    """Return Chromium's options and driver, without a screen or a network beyond this machine."""
    program, driver = shutil.which("chromium"), shutil.which("chromedriver")
    try:
        from selenium import webdriver  # noqa: PLC0415  (an extra)
        from selenium.webdriver.chrome.service import Service  # noqa: PLC0415
    except ImportError:
        program = None
    if program is None or driver is None:
        raise InputError(
            "the page is measured in a browser; install chromium, chromium-driver and selenium"
        )
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--disable-background-networking",
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    ):
        options.add_argument(flag)
    return options, Service(driver)
