"""`skyline locate` and `skyline cache`: areas from EXIF or --near, tiles, stores, refusals."""

import json
import math
import os
import shutil
import threading
import time
from collections import namedtuple
from contextlib import nullcontext
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from commands import assert_refused, csv_of, gps_of, noting
from range_server import Behaviour, serve
from scenes import degree_tile, fractal, take_photo

import skyline
from skyline import cache as areas
from skyline import read_dem, stand_at
from skyline.cache import Area, prepare_area
from skyline.fetch.dem_tiles import fetch_dem
from skyline.fetch.remote import Patience
from skyline.geodesy.bounds import contains_box
from skyline.location import area_of

PLACE = 9.5, 46.5
NEAR = "9.5,46.5,1.5"
_PER_DEGREE = 240


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A tile, and a photo in its middle."""
    folder = tmp_path_factory.mktemp("made")
    heights = 1500.0 + fractal(_PER_DEGREE, _PER_DEGREE, 1200.0, seed=5)
    (folder / "dem.tif").write_bytes(degree_tile(heights, 9, 46))
    terrain = read_dem(folder / "dem.tif")
    eye = stand_at(terrain, lon=PLACE[0], lat=PLACE[1])
    take_photo(folder / "photo.jpg", terrain, eye)
    return folder


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SKYLINE_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    hasty = partial(fetch_dem, patience=Patience(first_delay_s=0.0))
    monkeypatch.setattr("skyline.cache.fetch_dem", hasty)
    return tmp_path / "cache"


@pytest.fixture
def server(made, monkeypatch):
    """The behaviour of a server that has the one tile and is the source by default."""
    behaviour = Behaviour(files={"/N46E009.tif": (made / "dem.tif").read_bytes()})
    with serve(behaviour) as address:
        monkeypatch.setenv("SKYLINE_DEM_SOURCE", address + "/{ns}{lat:02d}{ew}{lon:03d}.tif")
        yield behaviour


@pytest.fixture
def located(run, made, cache, server):
    """What the first search of an area printed; the server has nothing to give any more."""
    words = "--near", NEAR, "--fov-deg", 60, "--json", "--report", "page"
    done = run("locate", made / "photo.jpg", *words).ok()
    server.requests.clear()
    server.files.clear()
    return done


def test_a_photo_is_located(located, cache, tmp_path):
    record = json.loads(located.out)
    frame, best = skyline.Frame.local(lon=PLACE[0], lat=PLACE[1]), record["answer"]
    off_m = math.hypot(*frame.from_lonlat(best["lon"], best["lat"]))
    assert off_m < record["answer_within_m"] <= 1000.0
    assert abs(best["heading_deg"] - 140.0) < 5.0
    assert f"{cache}" in located.err, "it says where it keeps what it makes"
    assert "report: page/index.html" in located.err
    assert (tmp_path / "page" / "index.html").stat().st_size > 0


@pytest.mark.usefixtures("located")
def test_a_second_photo_of_an_area_asks_no_server(run, made, server, tmp_path):
    (tmp_path / "places.csv").write_text("Name;Longitude;Latitude\nAlp;9,501;46,5\n")
    locate = "locate", made / "photo.jpg", "--near", "alp,1", "--peaks", "places.csv"
    again = run(*locate, "--fov-deg", 60, "--json").ok()
    assert "in the cache already" in again.err
    assert "reading the elevation model" not in again.err
    quiet = run(*locate, "--fov-deg", 60, "--quiet").ok()
    assert quiet.err == ""
    assert quiet.out.endswith("report: skyline-report/index.html\n")
    assert (tmp_path / "skyline-report" / "index.html").exists()
    found = skyline.locate(made / "photo.jpg", (*PLACE, 1.0), fov_deg=60.0)
    assert abs(found.best.heading_deg - 140.0) < 5.0
    assert not server.requests


@pytest.mark.usefixtures("server")
def test_the_cache_is_listed_and_cleared_but_for_other_files(run, cache):
    prepare_area(Area.around([PLACE], 1.5, 1.5))
    listed = json.loads(run("cache", "--json").out)
    (area,) = listed["areas"]
    assert (area["tiles"], area["finished"]) == (1, True)
    assert listed["bytes"] == area["tile_bytes"] + area["store_bytes"] > 0
    assert "areas: 1," in run("cache").out
    (cache / "mine.txt").write_text("not of skyline")
    assert "areas removed: 1," in run("cache", "--clear").out
    assert [path.name for path in cache.rglob("*") if path.is_file()] == ["mine.txt"]


def test_the_area_is_that_of_the_photo_s_own_position(made, tmp_path):
    def taken_at(name, lon, lat):
        return noting(made / "photo.jpg", tmp_path / name, gps=gps_of(lon, lat))

    photo = taken_at("noted.jpg", *PLACE)
    area, narrowing = area_of([photo], skyline.Narrowing())
    assert narrowing.near == pytest.approx((*PLACE, 10.0))
    frame = skyline.Frame.local(lon=PLACE[0], lat=PLACE[1])
    np.testing.assert_allclose(frame.rectangle_m(area.built), [-1e4, -1e4, 1e4, 1e4], rtol=0.02)
    near = taken_at("near.jpg", PLACE[0] + 0.3, PLACE[1])
    both, narrowing = area_of([photo, near], skyline.Narrowing())
    assert contains_box(both.built, area.built)
    assert narrowing.bounds_deg == both.built
    far = taken_at("far.jpg", PLACE[0] + 100.0, PLACE[1])
    with pytest.raises(skyline.InputError, match="more than 50 km apart"):
        area_of([photo, far], skyline.Narrowing())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("{photo}",), "notes no position; say where to search: --near LON,LAT,KM"),
        (("{none}", "--near", NEAR), "does not exist"),
        (("{photo}", "--near", "7.5,46.5,1", "--dem", "{dem}"), "do not meet the DEM"),
        (("{photo}", "--near", "8.99,46.5,2", "--dem", "{dem}"), "not the place 8.99"),
        (("{photo}", "--near", NEAR, "--dem", "{sea}"), "nothing but sea or holes"),
        (("{photo}", "--near", "9.5,46.5,1", "--dem", "{empty}"), "no elevation files"),
        (("{photo}", "--near", "Davos"), "with --peaks FILE a name in that file"),
        (("{photo}", "--near", "Nan,5"), "with --peaks FILE a name in that file"),
        (("{photo}", "--bounds", "9.5,46.5,1e-9,1"), "bounds are 9.5,46.5,1e-09,1.0"),
        (("{photo}", "--near", "Davo,2", "--peaks", "{places}"), "no place named Davo: Davos?"),
        (("{photo}", "--near", "sella", "--peaks", "{places}"), "sella, at 9.4000,46.4000 and 9.6"),
    ],
)
def test_bad_input_is_one_line(run, made, cache, tmp_path, arguments, message):
    (tmp_path / "empty").mkdir()
    sea = np.zeros((_PER_DEGREE, _PER_DEGREE), np.float32)
    (tmp_path / "sea.tif").write_bytes(degree_tile(sea, 9, 46))
    names = {"sea": "sea.tif", "none": "none.jpg", "empty": "empty", "places": "places.csv"}
    given = {name: tmp_path / file for name, file in names.items()}
    given |= {"photo": made / "photo.jpg", "dem": made / "dem.tif"}
    rows = ["Davos,46.5,9.5", "Sella,46.4,9.4", "Sella,46.6,9.6"]
    csv_of(given["places"], rows, "name,lat,lon")
    done = run("locate", *(one.format(**given) for one in arguments))
    notes, _, error = done.err.rstrip("\n").rpartition("\n")
    assert "error" not in notes
    assert_refused(replace(done, err=f"{error}\n"), message)
    assert not list(cache.rglob("*.h5"))
    assert areas.cached_areas() == []


def test_failures_of_a_server_are_one_line_and_the_next_try_continues(run, made, cache, server):
    locate = "locate", made / "photo.jpg", "--near", NEAR, "--fov-deg", 60
    server.status["/N46E009.tif"] = 503
    done = run(*locate)
    assert done.code == 1
    assert "503" in done.err.splitlines()[-1]
    assert "--dem" in done.err.splitlines()[-1]
    assert not list(cache.rglob("*.tif*"))
    server.status["/N46E009.tif"] = 404
    assert "usual in the sea" in run(*locate).err.splitlines()[-1]
    server.status.clear()
    assert run(*locate).code == 0


def test_an_area_with_a_tile_that_is_refused_is_not_searched(run, made, cache, server):
    """A border of one degree crosses the terrain that is seen from the place."""
    server.status["/N46E010.tif"] = 403
    photo, near = made / "photo.jpg", ("--near", "9.95,46.5,1.5")
    done = run("locate", photo, *near, "--fov-deg", 60)
    assert done.code == 1
    assert "1 of 2 tiles could not be fetched, N46E010: " in done.err.splitlines()[-1]
    assert done.out == ""
    assert [path.name for path in cache.rglob("*.tif")] == ["N46E009.tif"]
    assert not list(cache.rglob("*.h5"))
    server.status["/N46E010.tif"] = 404
    assert "no tile (usually sea) for N46E010" in run("locate", photo, *near, "--fov-deg", 60).err


def test_a_fetch_with_a_tile_that_is_refused_fails_and_keeps_the_others(run, server, tmp_path):
    server.status["/N46E010.tif"] = 403
    source = os.environ["SKYLINE_DEM_SOURCE"]
    fetch = "dem", "fetch", "--bounds", "9.9,46.4,10.1,46.6", "-o", tmp_path, "--source", source
    done = run(*fetch)
    assert (done.code, done.out, done.err.count("\n")) == (1, "", 1)
    assert "1 of 2 tiles could not be fetched, N46E010: " in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["N46E009.tif"]


def test_a_cache_without_rights_or_room_is_one_line(
    run, made, cache, server, tmp_path, monkeypatch
):
    locate = "locate", made / "photo.jpg", "--near", NEAR
    usage = namedtuple("usage", "total used free")
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: usage(9, 9, 0))
        assert "0 MB are free" in run(*locate).err.splitlines()[-1]

    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SKYLINE_CACHE", str(tmp_path / "file"))
    done = run(*locate)
    assert_refused(done, "name another folder with SKYLINE_CACHE")


def test_one_process_waits_for_another_and_clear_leaves_its_area(cache, server):
    area = Area.around([PLACE], 1.5, 1.5)
    first = prepare_area(area)
    folder, store = first.store.parent, first.store
    kept = store.rename(cache / "kept.h5")
    notes, ended = [], threading.Event()

    def print_note(note):
        notes.append(note)
        if "waiting" in note:
            ended.set()

    with areas.hold_area(folder) as is_alone:
        assert is_alone
        assert areas.clear_cache() == 0
        waiting = threading.Thread(target=lambda: prepare_area(area, print_note=print_note))
        waiting.start()
        assert ended.wait(20.0)
        kept.rename(store)
    waiting.join(20.0)
    assert len(notes) == 1, "it takes the store that the other has made"
    assert areas.clear_cache() == 1


def test_an_interrupted_build_continues(made, cache, server):
    area = Area.around([PLACE], 1.5, 1.5)

    def stop(done, total):
        if done == total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare_area(area, bar=lambda doing: nullcontext(stop if "building" in doing else None))
    (unfinished,) = areas.cached_areas()
    assert not unfinished.is_finished
    assert list(unfinished.folder.rglob("*-of-*.h5"))
    server.requests.clear()
    ready = prepare_area(area)
    assert ready.store.exists()
    assert not server.requests
    assert not list(unfinished.folder.rglob("*-of-*.h5"))


def test_a_lock_that_is_removed_while_waited_for_is_taken_anew(cache):
    folder = areas.areas_folder() / "dem-1" / "9.00_46.00_10.00_47.00"
    waits, holds, ends = threading.Event(), threading.Event(), threading.Event()

    def wait():
        with areas.hold_area(folder, lambda _: waits.set()):
            holds.set()
            ends.wait(20.0)

    with areas.hold_area(folder):
        waiting = threading.Thread(target=wait)
        waiting.start()
        assert waits.wait(20.0)
    assert holds.wait(20.0)
    with areas.hold_area(folder) as is_alone:
        assert not is_alone
    ends.set()
    waiting.join(20.0)
    assert not folder.parent.exists()


@pytest.mark.usefixtures("cache")
def test_other_files_of_a_name_and_files_beside_a_dem_tell_areas_apart(made, tmp_path):
    dem = tmp_path / "dem.tif"

    def origin():
        return prepare_area(Area.around([PLACE], 0.5, 0.5), dem).folder.parent

    shutil.copy2(made / "dem.tif", dem)
    first = origin()
    assert origin() == first
    time.sleep(0.05)
    shutil.copy2(made / "dem.tif", dem)  # As long and, by its time, as old
    copied = origin()
    (tmp_path / "dem.tif.aux.xml").write_text("<PAMDataset><SRS>EPSG:4258</SRS></PAMDataset>")
    assert len({first, copied, origin()}) == 3
