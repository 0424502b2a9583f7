"""The page's modules, read as text."""

import re
from graphlib import TopologicalSorter
from pathlib import Path

import skyline

PAGE = Path(skyline.__file__).parent / "web" / "page"


def test_modules_of_the_page_import_one_another_without_circles():
    imports = {
        path.name: set(re.findall(r'from "\./(\w+\.js)"', path.read_text()))
        for path in PAGE.glob("*.js")
    }
    assert imports["main.js"] >= {"map.js", "hand.js", "known.js"}
    order = list(TopologicalSorter(imports).static_order())  # raises CycleError for a circle
    assert order[-1] == "main.js"
