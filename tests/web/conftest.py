"""A server in a process of its own, and a browser whose network ends at this machine."""

import shutil
import subprocess
import sys
from contextlib import contextmanager

import pytest
from pages import Served
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

_SERVE = "from skyline.cli import main; main()"
SIZES = {"wide": (1280, 800), "tall": (800, 1100)}


@contextmanager
def serving(*arguments):
    """Run ``skyline serve`` on any free port."""
    command = [sys.executable, "-c", _SERVE, "serve", *map(str, arguments), "--port", "0"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        try:
            line = run.stdout.readline()
            assert "http://" in line, run.stderr.read()
            yield Served(line.split("http://")[1].split("/")[0], run)
        finally:
            run.terminate()
            run.wait(20)


@pytest.fixture(scope="session")
def served(store, tmp_path_factory):
    """The page over a small store, with a gazetteer."""
    peaks = tmp_path_factory.mktemp("peaks") / "peaks.csv"
    peaks.write_text("name,easting,northing\nGrat,601900,5177000\nTop,602300,5177200\n")
    with serving(store, "--peaks", peaks) as server:
        yield server


@pytest.fixture(scope="session")
def downloads(tmp_path_factory):
    """Where the browser puts what is saved."""
    return tmp_path_factory.mktemp("downloads")


@pytest.fixture(scope="session")
def chromium(downloads):
    """Debian's Chromium without a screen; skips where it is not installed."""
    browser, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (browser and driver):
        pytest.skip("chromium and chromium-driver are not installed (.ci/system_packages.py)")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for flag in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--disable-background-networking",
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    ):
        options.add_argument(flag)
    options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    with webdriver.Chrome(options=options, service=Service(driver)) as running:
        yield running
