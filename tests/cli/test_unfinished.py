"""A store whose build was not finished: every command says so, and how much of it is there."""

import json
import shutil

import numpy as np
import pytest
from rasterio.transform import Affine
from scenes import fractal, write_dem

from skyline.pipeline import row_renderers
from skyline.store import StoreWriter, open_store

NOTE = "its build is not finished: "
TWO_BLOCKS = Affine(90.0, 0.0, 601_000.0, 0.0, -90.0, 5_180_000.0)
"""Of a DEM that blocks of the adaptive plan meet in, at easting 604,160."""

BUILDS = {
    "planned places": ("--loss", 0.3),
    "a grid of places": ("--spacing", 100),
    "a grid of renderings": ("--planner", "uniform", "--spacing", 900, "--width", 64),
    "a plan of renderings": (
        *("--planner", "lpov", "--spacing", 1500, "--candidate-spacing", 300, "--width", 64),
    ),
    "a plan of so many renderings": (
        *("--planner", "rov", "--spacing", 1500, "--candidate-spacing", 300, "--width", 64),
        *("--budget", 100),
    ),
}


@pytest.fixture(scope="module")
def ridge(tmp_path_factory):
    """A DEM of 6.3 by 3.2 km."""
    path = tmp_path_factory.mktemp("ridge") / "dem.tif"
    return write_dem(path, fractal(36, 70, 400.0, seed=4), transform=TWO_BLOCKS)


@pytest.fixture
def trace(tmp_path):
    rows = [f"{q},{40 + 10 * np.sin(q / 7.0):.2f}" for q in range(160)]
    head = ["# width=160 height=120 fov_deg=60", "column_px,row_px"]
    path = tmp_path / "trace.csv"
    path.write_text("\n".join(head + rows) + "\n")
    return path


@pytest.fixture
def stop_once(monkeypatch):
    """Return a function that lets a build fail once some of it is there, and copies its store."""
    monkeypatch.setattr(row_renderers, "VIEWPOINTS_AT_A_TIME", 4)
    monkeypatch.setattr(row_renderers, "PLACES_AT_A_TIME", 500)
    note_built = StoreWriter.note_built

    def stop_at(path, killed):
        noted = []

        def note(writer, built):
            note_built(writer, built)
            with open_store(path) as store:
                held = store.built.done
            if held and not noted:
                noted.append(built)
                # A killed writer leaves the bytes that are in the file at that instant.
                shutil.copy(path, killed)
                raise MemoryError

        monkeypatch.setattr(StoreWriter, "note_built", note)

    return stop_at


@pytest.mark.parametrize("kind", BUILDS)
def test_a_store_knows_whether_its_build_was_finished(run, ridge, tmp_path, stop_once, kind):
    store, killed = tmp_path / "s.h5", tmp_path / "killed.h5"
    command = "build", ridge, "-o", store, *BUILDS[kind]
    stop_once(store, killed)
    assert run(*command).code == 1
    for path in (store, killed):
        with open_store(path) as opened:
            assert opened.built.finished is False
            assert 0.0 < opened.built.share < 1.0
            assert NOTE in repr(opened)
    killed.replace(store)
    assert run(*command).code == 0
    with open_store(store) as opened:
        assert opened.built.finished is True
        assert NOTE not in repr(opened)


def test_every_command_says_so(run, ridge, trace, tmp_path, stop_once, caplog):
    store, killed = tmp_path / "s.h5", tmp_path / "killed.h5"
    command = "build", ridge, "-o", store, *BUILDS["a grid of places"]
    stop_once(store, killed)
    assert run(*command).code == 1
    match = "match", store, trace, "--dem", ridge, "--no-refine", "--json"

    assert NOTE in run("info", store).out
    facts = json.loads(run("info", store, "--json").out)
    share = facts["built_share"]
    assert 0.0 < share < 1.0
    assert facts["finished"] is False
    assert NOTE in run("store", "check", killed).out
    report = json.loads(run("store", "check", store, "--json").out)
    assert (report["whole"], report["finished"], report["built_share"]) == (True, False, share)
    for how in ("merge", "compact", "repair"):
        assert NOTE in run("store", how, store, "-o", tmp_path / f"{how}.h5").out
        with open_store(tmp_path / f"{how}.h5") as copied:
            assert copied.built.share == share
    assert NOTE in run("store", "export", store, "-o", tmp_path / "s.gpkg").out
    said = json.loads(run(*match).out)["unfinished"]
    assert NOTE in said
    assert "W,S,E,N" in said
    assert caplog.messages == [said]

    assert run(*command).code == 0
    facts = json.loads(run("info", store, "--json").out)
    assert (facts["finished"], facts["built_share"]) == (True, 1.0)
    assert NOTE not in run("store", "check", store).out
    caplog.clear()
    assert "unfinished" not in json.loads(run(*match).out)
    assert not caplog.messages


@pytest.mark.parametrize("kind", ["planned places", "a grid of renderings"])
def test_tiles(run, ridge, trace, tmp_path, kind):
    """There is no store before all tiles are built, and each tile's is a part of it."""
    store, folder = tmp_path / "s.h5", tmp_path / "s.h5.shards"
    command = "build", ridge, "-o", store, *BUILDS[kind], "--shard-km", 5
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("skyline.pipeline.shards.merge_stores", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            run(*command)
    tiles = sorted(folder.glob("*.h5"))
    assert len(tiles) == 2
    for asked in (("info", store), ("store", "check", store), ("match", store, trace)):
        done = run(*asked)
        assert done.code == 2
        assert "its build is not finished" in done.err
        assert f"{folder} holds the tiles done so far, 2" in done.err
    shares = []
    for tile in tiles:
        assert NOTE in run("info", tile).out
        shares.append(json.loads(run("info", tile, "--json").out)["built_share"])
    assert sum(shares) == 1.0
    assert NOTE in run("store", "merge", tiles[0], tiles[0], "-o", tmp_path / "one.h5").out
    assert NOTE not in run("store", "merge", *tiles, "-o", tmp_path / "both.h5").out
    assert run(*command).code == 0
    assert json.loads(run("info", store, "--json").out)["finished"] is True
    assert (tmp_path / "both.h5").read_bytes() == store.read_bytes()
