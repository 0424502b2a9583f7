"""Builds cut into tiles: the result is the same whoever rendered what, when and how often."""

import os
import resource
import signal
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scenes import fractal, write_dem

from skyline import RenderConfig, build_uniform, read_dem
from skyline.camera import HEADINGS
from skyline.errors import BuildError, InputError, StoreError, StoreMismatchError
from skyline.pipeline import build, cluster, layout
from skyline.pipeline.cluster import remote_runner
from skyline.pipeline.jobs import run_here
from skyline.pipeline.layout import Layout
from skyline.pipeline.shards import build_sharded, cut_into_shards
from skyline.planning.uniform import map_bounds, uniform_grid
from skyline.store import StoreWriter, compact_store
from skyline.terrain.viewpoints import Viewpoints

CONFIG = RenderConfig(width=80)
PLAN = Layout(spacing_m=250.0, tile_m=1500.0)


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    return read_dem([write_dem(path, fractal(110, 120, 250.0, seed=11))])


@pytest.fixture(scope="module")
def unbroken(terrain, tmp_path_factory):
    """The bytes of a build in one go, tile after tile in this process."""
    path = tmp_path_factory.mktemp("unbroken") / "store.h5"
    build_sharded(terrain, path, PLAN, CONFIG)
    return path.read_bytes()


@pytest.fixture(scope="module")
def two_workers(dask_cluster):
    with remote_runner(dask_cluster.scheduler_address) as runner:
        yield runner


def backwards(work, items, names):
    for index, done in run_here(work, items[::-1], names):
        yield len(items) - 1 - index, done


def test_every_viewpoint_is_in_one_tile():
    # On tile borders, a rounding error beside them, and west and south of the origin.
    values = np.array([-2000.0, -1000.0, -1e-9, 0.0, 1e-9, 999.9999999999, 1000.0, 1500.0])
    east, north = (grid.ravel() for grid in np.meshgrid(values, values))
    shards = cut_into_shards(
        Viewpoints(
            easting_m=east, northing_m=north, eye_elevation_m=np.arange(east.size, dtype=float)
        ),
        1000.0,
    )
    members = np.concatenate([shard.work.eye_elevation_m for shard in shards])
    assert sorted(members) == list(range(east.size))
    for shard in shards:
        _, col, row = shard.name.split("_")
        assert (np.floor(shard.work.easting_m / 1000.0) == int(col)).all()
        assert (np.floor(shard.work.northing_m / 1000.0) == int(row)).all()
    assert len({shard.name for shard in shards}) == len(shards) == 16
    assert [shard.name for shard in shards[:5]] == [
        "1000m_-2_1", "1000m_-1_1", "1000m_0_1", "1000m_1_1", "1000m_-2_0",
    ]  # fmt: skip
    with pytest.raises(InputError, match="tile size is -1"):
        cut_into_shards(shards[0].work, -1.0)


def test_tiles_leave_no_trace(terrain, unbroken, tmp_path):
    build_uniform(terrain, tmp_path / "whole.h5", PLAN.spacing_m, config=CONFIG)
    compact_store(tmp_path / "whole.h5", tmp_path / "compact.h5")
    assert (tmp_path / "compact.h5").read_bytes() == unbroken
    build_sharded(terrain, tmp_path / "other.h5", Layout(PLAN.spacing_m, 2345.0), CONFIG)
    assert (tmp_path / "other.h5").read_bytes() == unbroken


def test_more_tiles_than_files_that_may_be_open(terrain, unbroken, tmp_path):
    plan = Layout(PLAN.spacing_m, 500.0)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    open_now = len(list(Path("/proc/self/fd").iterdir()))
    resource.setrlimit(resource.RLIMIT_NOFILE, (open_now + 20, hard))
    try:
        build_sharded(terrain, tmp_path / "s.h5", plan, CONFIG)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert len(cut_into_shards(uniform_grid(terrain, plan.spacing_m), plan.tile_m)) > 30
    assert (tmp_path / "s.h5").read_bytes() == unbroken


def test_progress_and_a_clean_folder(terrain, unbroken, tmp_path):
    told = []
    done = build_sharded(
        terrain, tmp_path / "s.h5", PLAN, CONFIG, progress=lambda *now: told.append(now)
    )
    points = len(uniform_grid(terrain, PLAN.spacing_m))
    assert done.rows == done.rendered == len(HEADINGS) * points
    tiles = len(cut_into_shards(uniform_grid(terrain, PLAN.spacing_m), PLAN.tile_m))
    assert told == [(finished, tiles) for finished in range(tiles + 1)]
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5"]
    assert (tmp_path / "s.h5").read_bytes() == unbroken


def test_a_store_that_is_whole_is_left_alone(terrain, unbroken, tmp_path):
    path = tmp_path / "s.h5"
    build_sharded(terrain, path, PLAN, CONFIG)
    # As if the process had been killed after it merged the shards.
    left = tmp_path / "s.h5.shards"
    left.mkdir()
    area_m = map_bounds(terrain, PLAN.bounds_deg)
    grid = uniform_grid(terrain, PLAN.spacing_m, area_m, CONFIG.eye_height_m)
    for shard in cut_into_shards(grid, PLAN.tile_m):
        (left / f"{shard.name}.h5").touch()
    again = build_sharded(terrain, path, PLAN, CONFIG)
    assert not left.exists()
    assert again.rendered == 0
    assert again.rows > 0
    assert path.read_bytes() == unbroken
    with pytest.raises(StoreMismatchError, match="width is 80 there, 160 here"):
        build_sharded(terrain, path, PLAN, RenderConfig(width=160))


def test_a_store_that_is_not_whole_is_refused(terrain, tmp_path):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(layout, "uniform_grid", lambda *given: uniform_grid(*given)[:3])
        build_uniform(terrain, tmp_path / "s.h5", PLAN.spacing_m, config=CONFIG)
    with pytest.raises(StoreError, match="lacks some of"):
        build_sharded(terrain, tmp_path / "s.h5", PLAN, CONFIG)


def test_the_order_of_tiles_changes_nothing(terrain, unbroken, tmp_path):
    build_sharded(terrain, tmp_path / "s.h5", PLAN, CONFIG, backwards)
    assert (tmp_path / "s.h5").read_bytes() == unbroken


def stop_after(jobs):
    def runner(work, items, names):
        for index, done in run_here(work, items, names):
            if index == jobs:
                raise KeyboardInterrupt
            yield index, done

    return runner


def test_a_stopped_build_goes_on(terrain, unbroken, tmp_path):
    path = tmp_path / "s.h5"
    with pytest.raises(KeyboardInterrupt):
        build_sharded(terrain, path, PLAN, CONFIG, stop_after(2))
    assert not path.exists()
    assert len(list((tmp_path / "s.h5.shards").glob("*.h5"))) == 3
    done = build_sharded(terrain, path, PLAN, CONFIG)
    assert 0 < done.rendered < done.rows
    assert path.read_bytes() == unbroken


def fail_on(name, work, shard):
    if shard.name == name:
        raise ValueError("no such luck")
    return work(shard)


def test_failed_tiles_are_named_and_the_others_kept(terrain, unbroken, two_workers, tmp_path):
    name = cut_into_shards(uniform_grid(terrain, PLAN.spacing_m), PLAN.tile_m)[2].name

    def runner(work, items, names):
        return two_workers(partial(fail_on, name, work), items, names)

    path = tmp_path / "s.h5"
    with pytest.raises(BuildError, match=rf"1 of \d+ failed: {name} \(ValueError: no such luck"):
        build_sharded(terrain, path, PLAN, CONFIG, runner)
    assert not path.exists()
    done = build_sharded(terrain, path, PLAN, CONFIG, two_workers)
    assert 0 < done.rendered < done.rows / 2
    assert path.read_bytes() == unbroken


def test_two_workers_make_the_same_bytes(terrain, unbroken, two_workers, tmp_path):
    build_sharded(terrain, tmp_path / "s.h5", PLAN, CONFIG, two_workers)
    assert (tmp_path / "s.h5").read_bytes() == unbroken


def die_once(flag, work, shard):
    """Be killed after the second commit, the first time; commits are small, to have two."""
    if Path(flag).exists():
        return work(shard)
    append, appended = StoreWriter.append, []

    def append_and_die(writer, *rows):
        append(writer, *rows)
        appended.append(writer.committed)
        if len(appended) == 2 and not Path(flag).exists():  # or the other worker died already
            Path(flag).write_text(str(writer.committed))
            os.kill(os.getpid(), signal.SIGKILL)

    build.VIEWPOINTS_AT_A_TIME = 9
    StoreWriter.append = append_and_die
    return work(shard)


def test_a_killed_worker_changes_nothing(terrain, unbroken, two_workers, tmp_path):
    flag = tmp_path / "died"

    def runner(work, items, names):
        return two_workers(partial(die_once, str(flag), work), items, names)

    build_sharded(terrain, tmp_path / "s.h5", PLAN, CONFIG, runner)
    assert int(flag.read_text()) > 0
    assert (tmp_path / "s.h5").read_bytes() == unbroken
    assert not (tmp_path / "s.h5.shards").exists()


def die(_shard):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_tile_that_kills_every_worker_is_named(
    terrain, dask_cluster, two_workers, monkeypatch, tmp_path
):
    monkeypatch.setattr(dask_cluster.scheduler, "allowed_failures", 0)
    one_tile = Layout(PLAN.spacing_m, 1e6)
    with pytest.raises(BuildError, match="its worker died"):
        build_sharded(
            terrain, tmp_path / "s.h5", one_tile, CONFIG,
            lambda _work, items, names: two_workers(die, items, names),
        )  # fmt: skip


def test_workers_need_the_same_dem(terrain, two_workers, tmp_path):
    path = write_dem(tmp_path / "dem.tif", fractal(60, 60, 250.0, seed=1))
    mine = read_dem([path])
    write_dem(path, fractal(60, 60, 250.0, seed=2))
    with pytest.raises(BuildError, match=r"workers need the same files"):
        build_sharded(mine, tmp_path / "s.h5", Layout(200.0, 500.0), CONFIG, two_workers)


def test_nobody_schedules(monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECT_S", 0.5)
    with (
        pytest.raises(InputError, match=r"no dask scheduler answers at 'tcp://127\.0\.0\.1:1'"),
        remote_runner("tcp://127.0.0.1:1"),
    ):
        pass
