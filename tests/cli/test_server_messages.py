"""Messages of commands that ask servers, and of `locate`, whose tiles come from one."""

import os
import re
import shutil
from collections import namedtuple
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from commands import assert_refused, csv_of, gps_of, noting
from range_server import Behaviour, serve, serve_apart
from refusals import assert_says
from remote_scenes import SIGNATURE, files_beside, on_server
from scenes import degree_tile

from skyline import Matcher, Narrowing, read_dem
from skyline.cache import cached_areas
from skyline.errors import FetchError, InputError
from skyline.fetch.overpass import fetch_peaks
from skyline.fetch.remote import Patience
from skyline.location import area_of

GAVE_UP = b'{"elements": [], "remark": "runtime error: timed out"}'


@pytest.mark.parametrize(
    ("server", "said"),
    [
        ({"status": {"/api": 500}}, "the server answers HTTP 500, not tried again"),
        ({"delay_s": 30.0}, "no whole answer (timed out)"),
        ({"drip_s": 0.2}, "incomplete after 1 s"),
        ({"files": {"/api": b"<html>Welcome</html>"}}, "not one of Overpass (it begins `<html>"),
        ({"files": {"/api": b"[" * 100_000}}, "not one of Overpass"),
        ({"files": {"/api": b'{"elements": []}'}}, "knows no named peak in the bounds"),
        ({"files": {"/api": GAVE_UP}}, "the server gave up (runtime error: timed out)"),
    ],
)
def test_a_server_of_peaks_that_fails_lies_or_hangs(run, tmp_path, monkeypatch, server, said):
    hasty = partial(fetch_peaks, patience=Patience(retries=0, timeout_s=1))
    monkeypatch.setattr("skyline.cli.peaks.fetch_peaks", hasty)
    behaviour = Behaviour(**{"files": {"/api": b'{"elements": [1, 2, 3]}'}} | server)
    with serve(behaviour) as address:
        fetch = "peaks", "--bounds", "9.6,46.5,9.8,46.7", "--server", f"{address}/api"
        done = run(*fetch, "-o", tmp_path / "peaks.geojson")
    assert done.code == 1, done
    assert_refused(replace(done, code=2), said)


NEAR = "9.5,46.5,1.5"


class TestLocate:
    @pytest.mark.parametrize(
        ("arguments", "said"),
        [
            ("{photo}", "notes no position; say where to search: --near LON,LAT,KM"),
            (f"{{none}} --near {NEAR}", "does not exist"),
            (
                "{photo} --near 7.5,46.5,1 --dem {dem}",
                "not the place 7.5000,46.5000; give",
            ),
            ("{photo} --near 46.5,9.5,1 --dem {dem}", "to be swapped: give 9.5,46.5"),
            ("{photo} --near 8.99,46.5,2 --dem {dem}", "not the place 8.99"),
            (f"{{photo}} --near {NEAR} --dem {{sea}}", "nothing but sea or holes"),
            ("{photo} --near 9.5,46.5,1 --dem {empty}", "no elevation files"),
            ("{photo} --near Davos", "with --peaks FILE a name in that file"),
            ("{photo} --near Nan,5", "with --peaks FILE a name in that file"),
            ("{photo} --bounds 9.5,46.5,1e-9,1", "bounds are 9.5,46.5,1e-09,1.0"),
            ("{photo} --near Davo,2 --peaks {places}", "no place named Davo: Davos?"),
            ("{photo} --near sella --peaks {places}", "sella, at 9.4000,46.4000 and 9.6"),
        ],
    )
    def test_a_mistake_is_one_line_after_the_notes(
        self, run, one_degree, cache, tmp_path, arguments, said
    ):
        (tmp_path / "empty").mkdir()
        sea = np.zeros((240, 240), np.float32)
        (tmp_path / "sea.tif").write_bytes(degree_tile(sea, 9, 46))
        names = {"sea": "sea.tif", "none": "none.jpg", "empty": "empty", "places": "places.csv"}
        given = {name: tmp_path / file for name, file in names.items()}
        given |= {"photo": one_degree / "photo.jpg", "dem": one_degree / "dem.tif"}
        rows = ["Davos,46.5,9.5", "Sella,46.4,9.4", "Sella,46.6,9.6"]
        csv_of(given["places"], rows, "name,lat,lon")
        done = run("locate", *(word.format(**given) for word in arguments.split()))
        notes, _, error = done.err.rstrip("\n").rpartition("\n")
        assert "error" not in notes
        assert_refused(replace(done, err=f"{error}\n"), said)
        assert not list(cache.rglob("*.h5"))
        assert cached_areas() == []

    @pytest.fixture
    def locate(self, run, one_degree, cache):
        """Return a function that locates the photo with options."""
        return lambda *options: run("locate", one_degree / "photo.jpg", "--fov-deg", 60, *options)

    @pytest.mark.usefixtures("tile_server")
    def test_what_is_kept_and_where_the_report_is(self, locate, cache):
        done = locate("--near", NEAR, "--report", "page").ok()
        assert f"{cache}" in done.err
        assert "report: page/index.html" in done.out + done.err
        again = locate("--near", NEAR).ok()
        assert "in the cache already" in again.err
        assert "reading the elevation model" not in again.err

    @pytest.mark.parametrize(
        ("tile", "status", "said"),
        [
            ("N46E009", 503, "503.* --dem"),
            ("N46E009", 404, "usual in the sea"),
            ("N46E010", 403, "1 of 2 tiles could not be fetched, N46E010: "),
        ],
    )
    def test_a_server_that_fails(self, locate, tile_server, tile, status, said):
        tile_server.status[f"/{tile}.tif"] = status
        done = locate("--near", "9.95,46.5,1.5" if tile == "N46E010" else NEAR)
        assert re.search(said, done.err.splitlines()[-1])

    def test_a_tile_that_a_server_does_not_have(self, locate, tile_server):
        tile_server.status["/N46E010.tif"] = 404
        said = "no tile (usually sea) for N46E010"
        assert said in locate("--near", "9.95,46.5,1.5").ok().err

    @pytest.mark.usefixtures("tile_server")
    def test_a_cache_without_room_or_rights(self, locate, tmp_path, monkeypatch):
        usage = namedtuple("usage", "total used free")
        with monkeypatch.context() as patch:
            patch.setattr(shutil, "disk_usage", lambda _: usage(9, 9, 0))
            assert "0 MB are free" in locate("--near", NEAR).err.splitlines()[-1]
        (tmp_path / "file").write_text("")
        monkeypatch.setenv("SKYLINE_CACHE", str(tmp_path / "file"))
        assert_refused(locate("--near", NEAR), "name another folder with SKYLINE_CACHE")

    def test_photos_that_are_far_apart(self, run, one_degree, tmp_path):
        photos = [
            noting(one_degree / "photo.jpg", tmp_path / f"{lon}.jpg", gps=gps_of(lon, 46.5))
            for lon in (9.5, 109.5)
        ]
        assert_says("more than 50 km apart", lambda: area_of(photos, Narrowing()))


def test_a_fetch_with_a_tile_that_is_refused(run, tile_server, tmp_path):
    tile_server.status["/N46E010.tif"] = 403
    source = os.environ["SKYLINE_DEM_SOURCE"]
    fetch = "dem", "fetch", "--bounds", "9.9,46.4,10.1,46.6", "-o", tmp_path, "--source", source
    assert "1 of 2 tiles could not be fetched, N46E010: " in run(*fetch).err


class TestRemoteDems:
    @pytest.fixture(scope="class")
    def server(self):
        with serve_apart(on_server) as apart:
            yield apart

    @pytest.fixture(scope="class")
    def folder(self, server, tmp_path_factory):
        return files_beside(server.address, tmp_path_factory.mktemp("dems"))

    @pytest.mark.parametrize(
        ("name", "error", "said"),
        [
            ("{server}/gone.tif", FetchError, "404.*check the address"),
            ("http://127.0.0.1:9/a.tif", FetchError, "[Cc]onnect.*whether the server is up"),
            ("{folder}/gone.json", FetchError, "gone.tif"),
            (
                "http://me:secret@127.0.0.1:9/a.tif?key=secret",
                FetchError,
                "^http://127.0.0.1:9/a.tif (?!.*secret)",
            ),
            ("{server}/page.tif", InputError, "cannot be read as a raster"),
            ("{folder}/none.json", InputError, "No compatible asset"),
            (
                "{folder}/two.json",
                InputError,
                "name one of them: STACIT.*asset=data, .*asset=slope",
            ),
        ],
    )
    def test_that_cannot_be_read(self, server, folder, name, error, said):
        path = name.format(server=server.address, folder=folder)
        assert_says(said, lambda: read_dem(path), error)

    def test_whose_address_is_signed(self, server, run):
        refused = run("info", f"{server.address}/gone.tif{SIGNATURE}")
        assert refused.err.count("\n") == 1
        assert "404" in refused.err
        assert "signature" not in refused.err

    def test_of_a_store_that_contacts_no_server(self, server, run, tmp_path, caplog):
        build = "build", f"{server.address}/a.tif", "-o", tmp_path / "store.h5", "--spacing", "300"
        run(*build).ok()
        with Matcher(tmp_path / "store.h5"):
            pass
        assert "--dem" in caplog.text
