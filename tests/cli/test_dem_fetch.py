"""``skyline dem fetch`` as a user meets it."""

import json

import pytest
from range_server import Behaviour, serve
from rasterio.io import MemoryFile
from rasterio.transform import from_origin
from scenes import fractal


@pytest.fixture
def server():
    heights = fractal(240, 240, 900.0, seed=5)
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=240, height=240, count=1, dtype="float32", crs="EPSG:4326",
            transform=from_origin(9.0, 47.0, 1 / 240, 1 / 240),
        ) as file:  # fmt: skip
            file.write(heights, 1)
        return Behaviour(files={"/46_9.tif": bytes(memory.getbuffer())})


def test_fetched_tiles_are_built(run, server, tmp_path):
    folder, store = tmp_path / "dem", tmp_path / "store.h5"
    with serve(server) as address:
        arguments = (
            "dem", "fetch", "--bbox", "9.4,46.4,9.6,47.1", "-o", folder,
            "--source", address + "/{lat}_{lon}.tif",
        )  # fmt: skip
        done = run(*arguments)
        assert done.code == 0, done.err
        assert "1 tiles, 1 of them new" in done.out
        assert "the source has no tile (usually sea) for: N47E009" in done.out
        assert "0 of them new" in run(*arguments).out
    built = run("build", folder / "N46E009.tif", "-o", store, "--spacing", "9000")
    assert built.code == 0, built.err
    assert json.loads(run("info", store, "--json").out)["places"] > 0


def test_a_failing_server_is_one_line(run, server, tmp_path):
    server.failures = 1000
    with serve(server) as address:
        done = run(
            "dem", "fetch", "--bbox", "9.4,46.4,9.6,46.6", "-o", tmp_path / "dem",
            "--source", address + "/{lat}_{lon}.tif", "--retries", "0",
        )  # fmt: skip
    assert done.code == 1
    assert done.err.count("\n") == 1
    assert f"error: {address}/46_9.tif: the server answers HTTP 500" in done.err
    assert not (tmp_path / "dem").exists()


def test_bounds_that_are_no_bounds(run, tmp_path):
    done = run("dem", "fetch", "--bbox", "9.4,46.4", "-o", tmp_path)
    assert done.code == 2
    assert "expected four numbers" in done.err
    done = run("dem", "fetch", "--bbox", "-180,80,180,90", "-o", tmp_path)
    assert done.code == 2
    assert "need 3600 tiles" in done.err
