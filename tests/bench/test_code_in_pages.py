"""Constants and equations of the code in pages: written anew, refused where they are not."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest
from mkdocs.exceptions import PluginError

from skyline.errors import InputError
from skyline_bench.documents.constants import with_constants
from skyline_bench.documents.equations import with_equations

HOOKS = Path(__file__).parents[2] / ".ci" / "site_pages.py"


@pytest.mark.parametrize(
    ("page", "written"),
    [
        ("7<!-- skyline.skylines.DEFAULT_WIDTH -->", "640<!-- skyline.skylines.DEFAULT_WIDTH -->"),
        ("1,0<!-- skyline.skylines.MAX_WIDTH -->", "16,384<!-- skyline.skylines.MAX_WIDTH -->"),
        (
            "1<!-- skyline.geodesy.map_frame.TRUE_DEG -->",
            "0.05<!-- skyline.geodesy.map_frame.TRUE_DEG -->",
        ),
        ("7<!-- skyline.skylines.HEADINGS.3 -->", "3<!-- skyline.skylines.HEADINGS.3 -->"),
        (
            "9 %<!-- skyline.MatchConfig.fov_sd_share:.1% -->",
            "2.0 %<!-- skyline.MatchConfig.fov_sd_share:.1% -->",
        ),
    ],
    ids=["integer", "thousands", "fraction", "item of a tuple", "default of a field, as a share"],
)
def test_a_number_before_the_path_of_a_constant_becomes_its_value(page, written):
    assert with_constants(f"At most {page} m.", "page.md") == f"At most {written} m."


@pytest.mark.parametrize(
    "path",
    ["skyline.nowhere.NUMBER", "skyline.skylines.NOTHING", "skyline.geodesy.map_frame.Frame"],
)
def test_a_path_to_no_number_is_refused_with_its_page_and_line(path):
    with pytest.raises(InputError, match=rf"^docs/page\.md names .*`{path}` in line 3"):
        with_constants(f"# Page\n\n5<!-- {path} --> m\n", "docs/page.md")


def test_all_wrong_paths_of_a_page_are_named_at_once():
    with pytest.raises(InputError, match=r"NOTHING` in line 1 .*, `skyline\.NOWHERE` in line 2"):
        with_constants("1<!-- skyline.NOTHING -->\n2<!-- skyline.NOWHERE -->", "page.md")


def test_a_path_without_a_number_before_it_is_refused():
    with pytest.raises(InputError, match=r"DEFAULT_WIDTH` in line 1 .no number"):
        with_constants("some <!-- skyline.skylines.DEFAULT_WIDTH --> columns", "page.md")


@pytest.fixture
def documented(tmp_path, monkeypatch):
    """The name of a module with two equations in its docstring."""
    (tmp_path / "documented.py").write_text(
        'r"""Areas.\n\nA square has\n\n.. math:: a^2\n\nand a circle, with its radius r,\n\n'
        '.. math::\n\n    \\pi\n    r^2\n\nof area.\n"""\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    return "documented"


@pytest.mark.parametrize(("number", "latex"), [(1, "a^2"), (2, r"\pi r^2")])
def test_an_equation_after_its_comment_becomes_the_one_of_the_docstring(documented, number, latex):
    page = f"It has\n\n<!-- equation {number} of {documented} -->\n\n$$old$$\n\nand so on.\n"
    assert with_equations(page, "page.md") == page.replace("old", latex)


@pytest.mark.parametrize("equation", ["equation 3 of documented", "equation 1 of nothing"])
def test_an_equation_that_no_docstring_has_is_refused_with_its_page(documented, equation):
    with pytest.raises(InputError, match=rf"^page\.md names {equation}, which the code"):
        with_equations(f"<!-- {equation} -->\n\n$$x$$\n", "page.md")


@pytest.fixture
def built():
    """Return a function that returns a page's Markdown as the site has it."""
    on_page_markdown = runpy.run_path(str(HOOKS))["on_page_markdown"]
    page = SimpleNamespace(file=SimpleNamespace(src_uri="method.md"))
    return lambda markdown: on_page_markdown(markdown, page, None, None)


def test_the_site_has_the_value_without_its_path(built):
    assert built("7<!-- skyline.skylines.DEFAULT_WIDTH --> columns") == "640 columns"


def test_a_path_to_no_constant_stops_the_site(built):
    with pytest.raises(PluginError, match=r"^method\.md names .*`skyline\.skylines\.NOTHING`"):
        built("7<!-- skyline.skylines.NOTHING --> columns")
