"""The page's modules, read as text."""

import re
from graphlib import TopologicalSorter
from pathlib import Path

import skyline
from skyline.report import html, overlay

COLOUR = re.compile(r"--(\w+): (#[0-9a-f]{6})")
PAGE = Path(skyline.__file__).parent / "web" / "page"


def test_modules_of_the_page_import_one_another_without_circles():
    imports = {
        path.name: set(re.findall(r'from "\./(\w+\.js)"', path.read_text()))
        for path in PAGE.glob("*.js")
    }
    assert imports["main.js"] >= {"map.js", "hand.js", "known.js"}
    order = list(TopologicalSorter(imports).static_order())  # raises CycleError for a circle
    assert order[-1] == "main.js"


def test_the_page_and_the_report_have_the_same_colours():
    style = (PAGE / "page.css").read_text()
    report = vars(html)["_STYLE"]
    dark = "prefers-color-scheme: dark"
    for ours, theirs in zip(style.split(dark)[:2], report.split(dark)[:2], strict=True):
        colours = dict(COLOUR.findall(ours))
        shared = dict(COLOUR.findall(theirs))
        assert len(shared) >= 7
        assert {name: colours[name] for name in shared} == shared
    source = Path(overlay.__file__).read_text()
    for name in ("found", "rendered"):
        assert dict(COLOUR.findall(style))[name] in source
