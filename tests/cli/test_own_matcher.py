"""A matcher of another package, as docs/howto/own-matcher.md shows it."""

import json
import tomllib

import pytest
from documents import ROOT, blocks_of
from packages import install


@pytest.fixture
def page():
    """The blocks of the page, by language."""
    blocks = blocks_of(ROOT / "docs" / "howto" / "own-matcher.md")
    return {block.language: block.text for block in blocks}


def test_the_matcher_of_the_page_finds_the_photo(run, store, photo, tmp_path, monkeypatch, page):
    monkeypatch.syspath_prepend(tmp_path)
    project = tomllib.loads(page["toml"])["project"]
    entries = project["entry-points"]["skyline.matchers"]
    install(tmp_path, project["name"], page["python"], "skyline.matchers", **entries)

    def best(matcher):
        options = ("--fov-deg", 60, "--matcher", matcher, "--json")
        return json.loads(run("match", store, photo, *options).ok().out)["candidates"][0]

    plain, full = best("plain"), best("full")
    apart_m = abs(
        complex(plain["easting_m"], plain["northing_m"])
        - complex(full["easting_m"], full["northing_m"])
    )
    assert apart_m < 200.0
    assert plain["heading_deg"] == pytest.approx(full["heading_deg"], abs=2.0)
