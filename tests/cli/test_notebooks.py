"""The notebooks in docs/notebooks/: they run, their claims hold, and their pages show them."""

import re
import runpy

import nbformat
import pytest
from documents import ROOT

import skyline

page_of = runpy.run_path(str(ROOT / ".ci" / "notebook_pages.py"))["page_of"]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))

SHOWN = {
    "first-photo": ("m off, turned by", "_files/first-photo"),
    "solar-horizon": ("sunrise at", "_files/solar-horizon"),
    "store-accuracy": ("of these right", "_files/store-accuracy"),
}
"""Notebook -> text that its page has only if it was run."""


def code_of(path):
    cells = nbformat.read(path, as_version=4).cells
    return [cell for cell in cells if cell.cell_type == "code"]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_its_page_shows_its_results(path):
    """`make check` builds the site of all pages, where links are held to what there is."""
    text, _ = page_of(path, run=True)
    for shown in SHOWN[path.stem]:
        assert shown in text


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_holds_no_outputs_makes_claims_and_uses_public_names(path):
    cells = code_of(path)
    code = "\n".join(cell.source for cell in cells)
    assert not any(cell.outputs or cell.execution_count for cell in cells)
    assert re.search(r"^ *assert ", code, re.M)
    imported = re.findall(r"^from skyline import (.+)$", code, re.M)
    names = {name for line in imported for name in line.split(", ")}
    assert names
    assert names <= set(skyline.__all__)
    assert not re.search(r"skyline\.|skyline_bench", code)
