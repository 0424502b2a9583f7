"""A small DEM on disk, and the command line run in this process."""

from dataclasses import dataclass
from functools import partial

import pytest
from scenes import fractal, write_dem

from skyline import bench, build_places, build_uniform, cli, read_dem


@dataclass(frozen=True)
class Result:
    """What a command ended with and printed."""

    code: int
    out: str
    err: str


@pytest.fixture
def run(run_main):
    """Return a function that runs ``skyline ARGS...``."""
    return partial(run_main, cli.main, "skyline")


@pytest.fixture
def run_bench(run_main):
    """Return a function that runs ``skyline-bench ARGS...``."""
    return partial(run_main, bench.main, "skyline-bench")


@pytest.fixture
def run_main(monkeypatch, capsys):
    """Return a function that runs a command's main with arguments."""

    def run_command(main, name, *arguments):
        monkeypatch.setattr("sys.argv", [name, *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main()
        printed = capsys.readouterr()
        return Result(int(stop.value.code or 0), printed.out, printed.err)

    return run_command


@pytest.fixture(scope="session")
def dem(tmp_path_factory):
    """A GeoTIFF of rough terrain, 120 x 110 samples."""
    return write_dem(tmp_path_factory.mktemp("dem") / "dem.tif", fractal(110, 120, 250.0, seed=11))


@pytest.fixture(scope="session")
def store(dem, tmp_path_factory):
    """A store of places over that DEM."""
    path = tmp_path_factory.mktemp("store") / "store.h5"
    build_places(read_dem([dem]), path)
    return path


@pytest.fixture(scope="session")
def renderings(dem, tmp_path_factory):
    """A store of renderings over that DEM."""
    path = tmp_path_factory.mktemp("renderings") / "renderings.h5"
    build_uniform(read_dem([dem]), path, 600.0)
    return path
