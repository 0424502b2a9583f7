"""A server in a process of its own, and a browser whose network ends at this machine."""

import pytest
from pages import serving
from selenium import webdriver

from skyline.errors import InputError
from skyline_bench.page import headless


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
    try:
        options, service = headless()
    except InputError:
        pytest.skip("chromium and chromium-driver are not installed (.ci/system_packages.py)")
    options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    with webdriver.Chrome(options=options, service=service) as running:
        yield running
