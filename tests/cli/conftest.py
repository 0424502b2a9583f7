"""Commands refine quickly; files that several tests of commands read."""

import json
from functools import partial

import pytest
from range_server import Behaviour, serve
from scenes import candidate_at, degree_tile, fractal, take_photo

from skyline import read_dem, stand_at
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


@pytest.fixture(scope="session")
def one_degree(tmp_path_factory):
    """A folder with the tile of the degree 9 E, 46 N, and a photo from its middle."""
    folder = tmp_path_factory.mktemp("degree")
    heights = 1500.0 + fractal(240, 240, 1200.0, seed=5)
    (folder / "dem.tif").write_bytes(degree_tile(heights, 9, 46))
    terrain = read_dem(folder / "dem.tif")
    take_photo(folder / "photo.jpg", terrain, stand_at(terrain, lon=9.5, lat=46.5))
    return folder


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """The folder of an empty cache, in the working folder; fetches repeat without delay."""
    monkeypatch.setenv("SKYLINE_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    hasty = partial(fetch_dem, patience=Patience(first_delay_s=0.0))
    monkeypatch.setattr("skyline.cache.fetch_dem", hasty)
    return tmp_path / "cache"


@pytest.fixture
def tile_server(one_degree, monkeypatch):
    """The behaviour of a server that has the one tile and is the source by default."""
    behaviour = Behaviour(files={"/N46E009.tif": (one_degree / "dem.tif").read_bytes()})
    with serve(behaviour) as address:
        monkeypatch.setenv("SKYLINE_DEM_SOURCE", address + "/{ns}{lat:02d}{ew}{lon:03d}.tif")
        yield behaviour
