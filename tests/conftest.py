"""Fixtures that several kinds of tests share."""

import math
import os
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from font_scenes import font_of
from hypothesis import settings
from matplotlib.font_manager import fontManager
from range_server import Behaviour, serve
from scenes import degree_tile, fractal, take_photo, write_dem

import skyline_bench.cli
from skyline import build_places, build_uniform, cli, read_dem, stand_at, stand_on
from skyline.cli.terminal import Terminal
from skyline.match.refine import QUICK
from skyline.match.search import FullMatcher, SearchEffort
from skyline.render.context import ENVIRONMENT_VARIABLE, held_context
from skyline.survey import plans
from skyline.survey.cluster import local_cluster

# How long an example takes says how busy the machine is, not what is wrong.
settings.register_profile("skyline", deadline=None)
settings.load_profile("skyline")


@dataclass(frozen=True)
class Result:
    """Exit code and output of a command."""

    code: int
    out: str
    err: str

    def ok(self):
        """Return it, if the command has succeeded."""
        assert self.code == 0, self.err
        return self


@pytest.fixture(scope="session", autouse=True)
def cache_of_tests(tmp_path_factory):
    """Let no test read or write the user's own cache, nor read the user's own settings."""
    with pytest.MonkeyPatch.context() as patch:
        for name in [*os.environ]:
            if name.startswith("SKYLINE_") and name != ENVIRONMENT_VARIABLE:
                patch.delenv(name)
        patch.setenv("SKYLINE_CACHE", str(tmp_path_factory.mktemp("cache") / "skyline"))
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real DEMs and photos beside the checkout; skips where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"real data not at {folder}")
    return folder


@pytest.fixture(scope="module")
def dask_cluster():
    """Two workers on this machine, for the tests of a module."""
    with local_cluster(2) as cluster:
        yield cluster


@pytest.fixture
def install_font(tmp_path_factory, monkeypatch):
    """Return a function that makes a font and installs it for one test."""
    monkeypatch.setattr(fontManager, "ttflist", [*fontManager.ttflist])
    folder = tmp_path_factory.mktemp("fonts")

    def installed(family, letters, **options):
        path = folder / f"{family}.ttf"
        fontManager.addfont(font_of(path, family, letters, **options))

    return installed


@pytest.fixture
def no_gl_error():
    """Fail a test during which OpenGL recorded an error."""
    with held_context() as context:
        assert context.ctx.error == "GL_NO_ERROR"
    yield
    with held_context() as context:
        assert context.ctx.error == "GL_NO_ERROR"


@pytest.fixture(scope="module")
def refined_quickly():
    """Refine no photo thoroughly: commands are to run here, other tests hold their answers."""
    with pytest.MonkeyPatch.context() as patch:
        quickly = SearchEffort(whole=QUICK, sure_margin=-math.inf)
        patch.setattr(FullMatcher, "effort", quickly)
        yield


@pytest.fixture(scope="session", autouse=True)
def small_plans():
    """Plan by default as few places as lose a fifth of the views, not a minute of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plans, "DEFAULT_PLACES", 1)
        yield


@pytest.fixture
def run_main(monkeypatch, capsys):
    """Return a function that runs a command's main with arguments."""
    # A command's name is its script's, also where pytest was started as a module.
    monkeypatch.setattr(sys.modules["__main__"], "__package__", None)

    def run_command(main, name, *arguments, slow_s=1e6, every_s=1e6):
        monkeypatch.setattr("sys.argv", [name, *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            # How long a command takes here must not change its output.
            main(terminal=Terminal(slow_s=slow_s, every_s=every_s))
        printed = capsys.readouterr()
        return Result(int(stop.value.code or 0), printed.out, printed.err)

    return run_command


@pytest.fixture
def run(run_main):
    """Return a function that runs ``skyline ARGS...``."""
    return partial(run_main, cli.main, "skyline")


@pytest.fixture
def run_bench(run_main):
    """Return a function that runs ``skyline-bench ARGS...``."""
    return partial(run_main, skyline_bench.cli.main, "skyline-bench")


@pytest.fixture(scope="session")
def one_degree(tmp_path_factory):
    """A folder with the tile of the degree 9 E, 46 N, and a photo from its middle."""
    folder = tmp_path_factory.mktemp("degree")
    # Samples are 460 m apart, so only high mountains are told apart for sure.
    heights = 2700.0 + fractal(240, 240, 2400.0, seed=5)
    (folder / "dem.tif").write_bytes(degree_tile(heights, 9, 46))
    terrain = read_dem(folder / "dem.tif")
    take_photo(folder / "photo.jpg", terrain, stand_at(terrain, lon=9.5, lat=46.5))
    return folder


@pytest.fixture
def tile_server(one_degree, monkeypatch):
    """The behaviour of a server that has the one tile and is the source by default."""
    behaviour = Behaviour(files={"/N46E009.tif": (one_degree / "dem.tif").read_bytes()})
    with serve(behaviour) as address:
        monkeypatch.setenv("SKYLINE_DEM_SOURCE", address + "/{ns}{lat:02d}{ew}{lon:03d}.tif")
        yield behaviour


@pytest.fixture(scope="session")
def dem(tmp_path_factory):
    """A GeoTIFF of rough terrain, 120 x 110 samples."""
    return write_dem(tmp_path_factory.mktemp("dem") / "dem.tif", fractal(110, 120, 250.0, seed=11))


@pytest.fixture(scope="session")
def store(dem, tmp_path_factory):
    """A store of places over that DEM."""
    path = tmp_path_factory.mktemp("store") / "store.h5"
    build_places(read_dem([dem]), path, 80.0)
    return path


@pytest.fixture(scope="session")
def renderings(dem, tmp_path_factory):
    """A store of renderings over that DEM."""
    path = tmp_path_factory.mktemp("renderings") / "renderings.h5"
    build_uniform(read_dem([dem]), path, 600.0)
    return path


@pytest.fixture(scope="session")
def photo(dem, tmp_path_factory):
    """A photograph from a stored viewpoint, heading 140 degrees."""
    terrain = read_dem([dem])
    eye = stand_on(terrain, easting_m=601_800.0, northing_m=5_178_000.0)
    return take_photo(tmp_path_factory.mktemp("photo") / "photo.jpg", terrain, eye, width_px=1600)
