"""Commands refine quickly; files that several tests of commands read."""

import json
from functools import partial

import pytest
from scenes import candidate_at

from skyline import read_dem
from skyline.fetch.dem_tiles import fetch_dem
from skyline.fetch.remote import Patience


@pytest.fixture(scope="module", autouse=True)
def quickly(refined_quickly):
    """Refine quickly in all tests of commands."""


@pytest.fixture(scope="module")
def pose(dem, tmp_path_factory):
    """The true pose of the photo as a person writes it; its heading is from true north."""
    true = candidate_at(601_800.0, 5_178_000.0, 140.0, frame=read_dem([dem]).frame)
    names = ("lon", "lat", "heading_deg", "pitch_deg", "roll_deg", "fov_deg")
    path = tmp_path_factory.mktemp("pose") / "pose.json"
    path.write_text(json.dumps({name: getattr(true, name) for name in names}))
    return path


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """The folder of an empty cache, in the working folder; fetches repeat without delay."""
    monkeypatch.setenv("SKYLINE_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    hasty = partial(fetch_dem, patience=Patience(first_delay_s=0.0))
    monkeypatch.setattr("skyline.cache.fetch_dem", hasty)
    return tmp_path / "cache"
