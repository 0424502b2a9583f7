"""The command line run in this process."""

from functools import partial

import pytest
from PIL import Image

from skyline import cli, read_dem, stand_on
from skyline.render.depth import DepthRenderer
from skyline_bench.queries.photographs import photograph
from skyline_bench.queries.pinhole import Camera


@pytest.fixture
def run(run_main):
    """Return a function that runs ``skyline ARGS...``."""
    return partial(run_main, cli.main, "skyline")


@pytest.fixture(scope="session")
def photo(dem, tmp_path_factory):
    """A photograph from a stored viewpoint, heading 140 degrees."""
    terrain = read_dem([dem])
    eye = stand_on(terrain, 601_800.0, 5_178_000.0)
    with DepthRenderer(terrain, 1600) as renderer:
        picture = photograph(renderer, eye, 0, Camera(140.0, fov_deg=60.0), seed=3)
    path = tmp_path_factory.mktemp("photo") / "photo.jpg"
    Image.fromarray(picture).save(path, quality=92)
    return path
