"""The notebooks in docs/notebooks/: they run, their claims hold, and the site shows them."""

import os
import re
import subprocess
import sys

import nbformat
import pytest
from documents import ROOT

import skyline

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
def test_make_docs_runs_the_notebooks_and_shows_their_results(tmp_path):
    line = re.search(r"^docs:.*\n\t(.*)\$\(IN_VENV\)/mkdocs (.*)$", makefile(), re.M)
    settings = dict(word.split("=") for word in line[1].split())
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", *line[2].split(), "--site-dir", str(tmp_path)],
        cwd=ROOT, env=os.environ | settings, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert {path.stem for path in NOTEBOOKS} == SHOWN.keys()
    for name, texts in SHOWN.items():
        page = (tmp_path / "notebooks" / f"{name}.html").read_text(encoding="utf-8")
        for text in texts:
            assert text in page, name
        assert not re.search(r'href="[^"]*\.md', page), name


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


def makefile():
    return (ROOT / "Makefile").read_text(encoding="utf-8")
