"""A small DEM on disk, and the command line run in this process."""

from dataclasses import dataclass

import pytest
from scenes import fractal, write_dem

from skyline import build_uniform, cli, read_dem


@dataclass(frozen=True)
class Result:
    """What a command ended with and printed."""

    code: int
    out: str
    err: str


@pytest.fixture
def run(monkeypatch, capsys):
    """Return a function that runs ``skyline ARGS...``."""

    def run_command(*arguments):
        monkeypatch.setattr("sys.argv", ["skyline", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            cli.main()
        printed = capsys.readouterr()
        return Result(int(stop.value.code or 0), printed.out, printed.err)

    return run_command


@pytest.fixture(scope="session")
def dem(tmp_path_factory):
    """A GeoTIFF of rough terrain, 120 x 110 samples."""
    return write_dem(tmp_path_factory.mktemp("dem") / "dem.tif", fractal(110, 120, 250.0, seed=11))


@pytest.fixture(scope="session")
def store(dem, tmp_path_factory):
    """A store over that DEM."""
    path = tmp_path_factory.mktemp("store") / "store.h5"
    build_uniform(read_dem([dem]), path, 600.0)
    return path
