"""The page measured in a browser: loading, strokes, and the live skyline."""

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any
from urllib.request import urlopen

import cv2
import numpy as np
from PIL import Image
from typer import Option

from skyline import build_places, read_dem, stand_at
from skyline.cli.terminal import Terminal
from skyline.errors import BuildError, InputError
from skyline.render.depth import DepthRenderer
from skyline_bench import options
from skyline_bench.figures import SAMPLE_BOUNDS_DEG
from skyline_bench.geotiff import write_sample_dem
from skyline_bench.measuring import Row
from skyline_bench.queries.made_photos import photograph
from skyline_bench.queries.pinhole import Camera

_PROMISED: dict[str, Row] = {
    "server ready": {"at most": 3},
    "stroke to new skyline, median": {"at most": 300},
    "renderings shown a second": {"at least": 10},
    "hand to skyline, 95 %": {"at most": 150},
}

_Figure = tuple[str, float, str, int]
"""A name, a value, its unit, and the number of measurements."""

_MEASURED = "return performance.getEntriesByName('{}').map((one) => one.duration)"
_STATE = "const done = arguments[0]; import('/page/{}.js').then((it) => done({}));"


# A process that a shell starts in the background has children that ignore Ctrl-C.
_SERVE = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from skyline.cli import main
main()
"""
_WINDOW = {"width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": False}


@contextmanager
def serving(*arguments: object, port: int = 0) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run ``skyline serve``, by default on any free port.

    Yields the line that it prints, see `address_in`, and the process.
    """
    command = [sys.executable, "-c", _SERVE, "serve", *map(str, arguments), "--port", str(port)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as run:
        try:
            line = run.stdout.readline() if run.stdout else ""
            if not line:
                said = run.stderr.read().strip() if run.stderr else ""
                raise BuildError(f"the page was not served ({said}); run `skyline serve` yourself")
            yield line, run
        finally:
            run.terminate()


def address_in(line: str) -> str:
    """Return the address that opens the page on this machine.

    It is the first address in the printed line.
    """
    return next(word for word in line.split() if word.startswith("http://"))


def headless() -> tuple[Any, Any]:
    """Return the options and the driver of a headless Chromium.

    It has no screen, and no network beyond this machine.
    """
    program = shutil.which("chromium")
    driver = shutil.which("chromedriver")
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


def page(
    spacing: Annotated[float, Option(min=10.0, help="Of the places searched, metres.")] = 120.0,
    photo_width: Annotated[int, Option(min=400, help="Columns of the photo, 4:3.")] = 4000,
    record: options.Record = None,
    quick: options.Quick = False,
) -> None:
    """Waiting times of the page: its start, strokes, the live skyline.

    The page is in a browser, and the strokes are on a photo of 12 megapixels.
    """
    chrome, driver = headless()
    from selenium.webdriver import Chrome  # noqa: PLC0415  (an extra)

    with tempfile.TemporaryDirectory() as folder, Terminal().progress("page") as progress:
        store, photos = _made(Path(folder), spacing, photo_width)
        progress(1, 3)
        began = time.perf_counter()
        with serving(store) as (line, _):
            address = address_in(line)
            with urlopen(address) as answer:
                answer.read()
            figures: list[_Figure] = [("server ready", time.perf_counter() - began, "s", 1)]
            progress(2, 3)
            with Chrome(options=chrome, service=driver) as chromium:
                chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", _WINDOW)
                figures += _in_browser(chromium, address, photos, 2.0 if quick else 10.0)
        progress(3, 3)
    rows = [
        {"figure": name, "n": n, "value": float(value), "unit": unit, **_PROMISED.get(name, {})}
        for name, value, unit, n in figures
    ]
    options.report(record, rows)


def _made(folder: Path, spacing_m: float, width_px: int) -> tuple[Path, list[Path]]:
    """Return a store of the sample terrain, and two photos of one place."""
    terrain = read_dem([write_sample_dem(folder / "sample.tif")])
    store = folder / "places.h5"
    build_places(terrain, store, spacing_m, SAMPLE_BOUNDS_DEG)
    eye = stand_at(terrain, lon=-84.25, lat=36.58, summit_within_m=0.0)
    focal_length_mm = 31  # As of a full frame, whose half is 18 mm wide
    fov_deg = float(2.0 * np.degrees(np.arctan(18.0 / focal_length_mm)))
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = focal_length_mm
    photos = []
    with DepthRenderer(terrain, 2048) as renderer:
        for heading_deg in (60.0, 330.0):
            picture = photograph(renderer, eye, 0, Camera(heading_deg, fov_deg=fov_deg), seed=1)
            size_px = width_px, width_px * 3 // 4
            large = cv2.resize(picture, size_px, interpolation=cv2.INTER_CUBIC)
            photos.append(folder / f"looking_{heading_deg:.0f}.jpg")
            Image.fromarray(large).save(photos[-1], quality=92, exif=exif)
    return store, photos


def _in_browser(
    chromium: Any, address: str, photos: Sequence[Path], drag_s: float
) -> list[_Figure]:
    """Measure the waiting times of a person at the page."""
    chromium.get(address)
    _until(lambda: chromium.execute_script("return document.documentElement.dataset.ready"))
    figures: list[_Figure] = []
    for order, photo in zip(("first", "second"), photos, strict=True):
        shown_s, found_s = _found(chromium, photo)
        figures += [
            (f"{order} photo shown with its skyline", shown_s, "s", 1),
            (f"{order} place found", found_s, "s", 1),
        ]
    strokes = _strokes(chromium)
    return [
        *figures,
        ("stroke to new skyline, median", np.median(strokes), "ms", len(strokes)),
        ("stroke to new skyline, slowest", max(strokes), "ms", len(strokes)),
        *_drag(chromium, drag_s),
    ]


def _found(chromium: Any, photo: Path) -> tuple[float, float]:
    """Return the seconds until a photo is shown, and from then until it is found."""
    began = time.perf_counter()
    chromium.find_element("id", "files").send_keys(str(photo))
    _until(
        lambda: _ask(chromium, "state", f"it.state.photo?.name === '{photo.name}' && it.state.rows")
    )
    shown_s = time.perf_counter() - began
    began = time.perf_counter()
    chromium.execute_script("document.getElementById('find').click()")
    _until(lambda: _ask(chromium, "state", "Boolean(it.state.sight)"))
    return shown_s, time.perf_counter() - began


def _strokes(chromium: Any) -> list[float]:
    """Paint over the skyline at ten places; return each time, ms."""
    chromium.execute_script("document.querySelector('input[value=sky]').click()")
    box = chromium.find_element("id", "photo").rect
    for count in range(10):
        column = box["x"] + box["width"] * (0.3 + 0.04 * count)
        row = box["y"] + box["height"] * 0.55
        _mouse(chromium, "mousePressed", column, row)
        for step in range(8):
            _mouse(chromium, "mouseMoved", column + 3.0 * step, row)
        _mouse(chromium, "mouseReleased", column + 24.0, row)
        _until(lambda: len(chromium.execute_script(_MEASURED.format("stroke"))) > count)  # noqa: B023  (called here)
    return [float(duration) for duration in chromium.execute_script(_MEASURED.format("stroke"))]


def _drag(chromium: Any, drag_s: float) -> list[_Figure]:
    """Drag the camera about the map, and return how the skyline follows."""
    box = chromium.find_element("css selector", ".camera").rect
    column = box["x"] + box["width"] / 2.0
    row = box["y"] + box["height"] / 2.0
    _mouse(chromium, "mousePressed", column, row)
    _mouse(chromium, "mouseMoved", column + 6.0, row)
    time.sleep(0.5)
    chromium.execute_script("performance.clearMeasures('look')")
    a_second = 60.0  # Moves of the mouse
    began = time.perf_counter()
    moves = 0
    while time.perf_counter() - began < drag_s:
        moves += 1
        turn = moves / a_second
        _mouse(chromium, "mouseMoved", column + 25 * np.cos(turn), row + 20 * np.sin(turn))
        time.sleep(max(0.0, began + moves / a_second - time.perf_counter()))
    seconds = time.perf_counter() - began
    latency = chromium.execute_script(_MEASURED.format("look"))
    _mouse(chromium, "mouseReleased", column, row)
    return [
        ("renderings shown a second", len(latency) / seconds, "1/s", len(latency)),
        ("moves of the mouse a second", moves / seconds, "1/s", moves),
        ("hand to skyline, median", np.median(latency), "ms", len(latency)),
        ("hand to skyline, 95 %", np.percentile(latency, 95), "ms", len(latency)),
    ]


def _ask(chromium: Any, module: str, code: str) -> Any:
    return chromium.execute_async_script(_STATE.format(module, code))


def _mouse(chromium: Any, kind: str, column: float, row: float) -> None:
    event = {"type": kind, "x": column, "y": row, "button": "left", "buttons": 1, "clickCount": 1}
    chromium.execute_cdp_cmd("Input.dispatchMouseEvent", event)


def _until(true: Callable[[], object]) -> None:
    began = time.perf_counter()
    while not true():
        if time.perf_counter() - began > 120.0:
            raise BuildError(
                "the page did not get ready within 2 minutes; open it in a browser, see its console"
            )
        time.sleep(0.01)
