"""A server in a process of its own, and a browser whose network ends at this machine."""

import pytest
from pages import Page, serving
from PIL import Image
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


@pytest.fixture
def page(chromium, served):
    """The page, with nothing on it."""
    made = Page(chromium, served)
    yield made
    severe = (entry for entry in chromium.get_log("browser") if entry["level"] == "SEVERE")
    # The log also holds what the server refuses with words, and, some time after, that Chromium
    # left a page of an earlier test with its strokes unsaved.
    expected = ("status of 400", "'beforeunload' confirmation panel")
    messages = [entry["message"] for entry in severe]
    assert [said for said in messages if not any(one in said for one in expected)] == []


@pytest.fixture
def narrow(photo, tmp_path):
    """The middle half of the photo: other places resemble it more than the whole."""
    path = tmp_path / "narrow.jpg"
    with Image.open(photo) as image:
        width, height = image.size
        image.crop((width // 4, 0, 3 * width // 4, height)).save(path, quality=95)
    return path
