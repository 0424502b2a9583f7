"""A planner of another package, as docs/howto/own-planner.md shows it."""

import tomllib

import pytest
from commands import assert_refused
from documents import ROOT, blocks_of
from packages import install

from skyline.store.read import open_store

OPTIONS = "--coarse-spacing", "1200", "--site-spacing", "300", "--coverage", "0.9", "--width", "64"


@pytest.fixture
def site(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.fixture
def page():
    """The blocks of the page, by language."""
    return {
        block.language: block.text
        for block in blocks_of(ROOT / "docs" / "howto" / "own-planner.md")
    }


def test_the_planner_of_the_page_covers_the_terrain(run, dem, site, page):
    project = tomllib.loads(page["toml"])["project"]
    entries = project["entry-points"]["skyline.planners"]
    install(site, project["name"], page["python"], "skyline.planners", **entries)
    done = run("render", dem, "-o", site / "own.h5", "--planner", "farthest", *OPTIONS)
    assert (done.code, done.err) == (0, "")
    covered = float(done.out.partition("coverage ")[2].split()[0])
    assert covered >= 90.0
    with open_store(site / "own.h5") as store:
        assert store.header.config["planner"] == "farthest"


@pytest.mark.parametrize("chosen", ["[-1]", "[10**9]", "[0.5]", "[[5]]", "['a']"])
def test_a_planner_that_chooses_no_site_is_refused(run, dem, site, chosen):
    name = f"wrong{abs(hash(chosen))}"
    code = f"def wrong(problem, generator):\n    yield {chosen}"
    install(site, name, code, "skyline.planners", wrong=f"{name}:wrong")
    done = run("render", dem, "-o", site / "s.h5", "--planner", "wrong", *OPTIONS)
    assert_refused(done)
    assert not (site / "s.h5").exists()
