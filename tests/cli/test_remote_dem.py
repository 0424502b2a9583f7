"""DEMs that are no file here, wherever a DEM is named: addresses, virtual rasters, STAC items."""

import json

import numpy as np
import pytest
from range_server import serve_apart
from remote_scenes import SIGNATURE, SIZE, files_beside, on_server

from skyline import FetchError, InputError, Matcher, read_dem


@pytest.fixture(scope="module")
def server():
    with serve_apart(on_server) as apart:
        yield apart


@pytest.fixture(scope="module")
def folder(server, tmp_path_factory):
    return files_beside(server.address, tmp_path_factory.mktemp("dems"))


@pytest.fixture(scope="module")
def plain(folder):
    return read_dem([folder / "a.tif", folder / "b.tif"])


def test_every_name_of_both_tiles_gives_both_tiles(server, folder, plain):
    names = "{folder}/here.vrt", "{server}/both.vrt", "{folder}/items.json"
    for name in (*names, 'STACIT:"{server}/items.json"'):
        terrain = read_dem(name.format(server=server.address, folder=folder))
        assert terrain.digest == plain.digest


@pytest.mark.parametrize("prefix", ["", "/vsicurl/"])
def test_addresses_are_tiles_like_files(server, plain, prefix):
    paths = [f"{prefix}{server.address}/{name}.tif" for name in "ab"]
    terrain = read_dem(paths)
    assert terrain.digest == plain.digest
    assert terrain.provenance.files == tuple(paths)


def test_nothing_but_the_dem_is_asked_for(server):
    server.asked()
    read_dem(f"{server.address}/a.tif{SIGNATURE}")
    requests = server.asked()
    assert {path for _, path, _ in requests} == {f"/a.tif{SIGNATURE}"}
    assert any(ranges for _, _, ranges in requests)


def test_one_asset_of_several_is_named(folder, plain):
    with pytest.raises(InputError):
        read_dem(folder / "two.json")
    terrain = read_dem(f'STACIT:"{folder / "two.json"}":asset=data')
    np.testing.assert_array_equal(terrain.heights_m, plain.heights_m[:, :SIZE])


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("{server}/gone.tif", FetchError),
        ("{folder}/gone.json", FetchError),
        ("{server}/page.tif", InputError),
        ("{folder}/none.json", InputError),
    ],
)
def test_a_dem_that_is_not_there_is_told_from_one_that_is_none(server, folder, name, error):
    with pytest.raises(error):
        read_dem(name.format(server=server.address, folder=folder))


def test_commands_take_addresses(server, folder, plain, run, tmp_path):
    address, place = f"{server.address}/both.vrt", "10.345,46.755"
    facts = json.loads(run("info", address, "--json").out)
    assert (facts["digest"], facts["files"]) == (plain.digest, [address])
    here = run("horizon", folder / "here.vrt", "--at", place).ok()
    assert run("horizon", address, "--at", place).out == here.out
    store = tmp_path / "store.h5"
    assert run("build", address, "-o", store, "--spacing", "300").code == 0
    with Matcher(store, dem=address) as matcher:
        assert matcher.terrain.digest == plain.digest
    assert run("info", f"{server.address}/gone.tif{SIGNATURE}").code == 1


def test_a_store_contacts_no_server_that_the_user_has_not_named(server, tmp_path, run, caplog):
    store, address = tmp_path / "store.h5", f"{server.address}/a.tif{SIGNATURE}"
    assert run("build", address, "-o", store, "--spacing", "300").code == 0
    server.asked()
    with Matcher(store) as matcher:
        assert matcher.terrain is None
    assert server.asked() == []
    assert len(caplog.records) == 1
