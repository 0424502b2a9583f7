"""`skyline locate` and `skyline cache`: areas from EXIF or --near, tiles, stores, refusals."""

import json
import math
import shutil
import threading
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import gps_of, noting

import skyline
from skyline import cache as areas
from skyline.cache import Area, prepare_area
from skyline.geodesy.bounds import contains_box
from skyline.location import area_of
from skyline.tasks.locate import serving_command

PLACE = 9.5, 46.5
NEAR = "9.5,46.5,1.5"


@pytest.fixture
def located(run, one_degree, cache, tile_server):
    """What the first search of an area printed; the server has nothing to give any more."""
    words = "--near", NEAR, "--fov-deg", 60, "--json", "--report", "page"
    done = run("locate", one_degree / "photo.jpg", *words).ok()
    tile_server.requests.clear()
    tile_server.files.clear()
    return done


def test_a_photo_is_located(located, cache, tmp_path):
    record = json.loads(located.out)
    frame, best = skyline.Frame.local(lon=PLACE[0], lat=PLACE[1]), record["answer"]
    off_m = math.hypot(*frame.from_lonlat(best["lon"], best["lat"]))
    assert off_m < record["answer_within_m"] <= 1000.0
    assert abs(best["heading_deg"] - 140.0) < 5.0
    (folder,) = cache.glob("areas/*/*")
    assert f"skyline serve {folder} " in located.err
    report = (tmp_path / "page" / "index.html").read_text()
    assert f"run: skyline serve {folder} " in report
    assert 'href="http://127.0.0.1:8765/"' in report


def test_the_command_that_serves_the_page_names_no_home():
    area = Path.home() / "a cache" / "9_46_10_47"
    assert serving_command(area, ["my photo.jpg"]) == (
        "skyline serve ~/'a cache/9_46_10_47' 'my photo.jpg'"
    )


@pytest.mark.usefixtures("located")
def test_a_second_photo_of_an_area_asks_no_server(run, one_degree, tile_server, tmp_path):
    (tmp_path / "places.csv").write_text("Name;Longitude;Latitude\nAlp;9,501;46,5\n")
    locate = "locate", one_degree / "photo.jpg", "--near", "alp,1", "--peaks", "places.csv"
    again = run(*locate, "--fov-deg", 60, "--json").ok()
    assert json.loads(again.out)["answer"]
    quiet = run(*locate, "--fov-deg", 60, "--quiet", "--export", "found.geojson").ok()
    assert quiet.err == ""
    assert quiet.out.endswith("report: skyline-report/index.html\n")
    assert (tmp_path / "skyline-report" / "index.html").exists()
    assert json.loads((tmp_path / "found.geojson").read_text())["features"]
    found = skyline.locate(one_degree / "photo.jpg", (*PLACE, 1.0), fov_deg=60.0)
    assert abs(found.best.heading_deg - 140.0) < 5.0
    assert not tile_server.requests


def test_a_model_in_memory_is_searched_and_kept_by_its_heights(photo, dem, cache):
    """The photo looks along 140 degrees from grid north, which is not a degree off true north."""
    terrain = skyline.read_dem([dem])
    lon, lat = (float(at) for at in terrain.frame.to_lonlat(601_800.0, 5_178_000.0))
    found = skyline.locate(photo, (lon, lat, 0.7), dem=terrain)
    assert abs(found.best.heading_deg - 140.0) < 2.0
    (area,) = areas.cached_areas()
    same = replace(terrain, provenance=skyline.Provenance())
    assert prepare_area(Area.around([(lon, lat)], 0.7, 0.7), same) == area


@pytest.mark.usefixtures("tile_server")
def test_the_cache_is_listed_and_cleared_but_for_other_files(run, cache):
    prepare_area(Area.around([PLACE], 1.5, 1.5))
    listed = json.loads(run("cache", "--json").out)
    (area,) = listed["areas"]
    assert (area["tiles"], area["finished"]) == (1, True)
    assert listed["bytes"] == area["tile_bytes"] + area["store_bytes"] > 0
    said = run("cache").out
    assert said.startswith(f"{area['folder']}: tiles: 1,")
    assert "areas: 1," in said
    assert json.loads(run("info", area["folder"], "--json").out)["kind"] == "store"
    assert run("store", "check", area["folder"]).code == 0
    (cache / "mine.txt").write_text("not of skyline")
    assert "areas removed: 1," in run("cache", "--clear").out
    assert [path.name for path in cache.rglob("*") if path.is_file()] == ["mine.txt"]


def test_the_area_is_that_of_the_photo_s_own_position(one_degree, tmp_path):
    def taken_at(name, lon, lat):
        return noting(one_degree / "photo.jpg", tmp_path / name, gps=gps_of(lon, lat))

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
    with pytest.raises(skyline.InputError):
        area_of([photo, far], skyline.Narrowing())


def test_the_next_try_after_failures_of_a_server_continues(run, one_degree, cache, tile_server):
    locate = "locate", one_degree / "photo.jpg", "--near", NEAR, "--fov-deg", 60
    tile_server.status["/N46E009.tif"] = 503
    assert run(*locate).code == 1
    assert not list(cache.rglob("*.tif*"))
    tile_server.status["/N46E009.tif"] = 404
    assert run(*locate).code != 0
    tile_server.status.clear()
    assert run(*locate).code == 0


def test_an_area_with_a_tile_that_is_refused_is_not_searched(run, one_degree, cache, tile_server):
    """A border of one degree crosses the terrain that is seen from the place."""
    tile_server.status["/N46E010.tif"] = 403
    photo, near = one_degree / "photo.jpg", ("--near", "9.95,46.5,1.5")
    done = run("locate", photo, *near, "--fov-deg", 60)
    assert (done.code, done.out) == (1, "")
    assert [path.name for path in cache.rglob("*.tif")] == ["N46E009.tif"]
    assert not list(cache.rglob("*.h5"))
    tile_server.status["/N46E010.tif"] = 404
    run("locate", photo, *near, "--fov-deg", 60).ok()


def test_a_fetch_with_a_tile_that_is_refused_fails_and_keeps_the_others(run, tile_server, tmp_path):
    tile_server.status["/N46E010.tif"] = 403
    done = run("dem", "fetch", "--bounds", "9.9,46.4,10.1,46.6", "-o", tmp_path)
    assert (done.code, done.out, done.err.count("\n")) == (1, "", 1)
    assert [path.name for path in tmp_path.iterdir()] == ["N46E009.tif"]


def test_a_fetch_uses_the_source_that_the_environment_names(run, tile_server, tmp_path):
    run("dem", "fetch", "--bounds", "9.4,46.4,9.6,46.6", "-o", tmp_path).ok()
    assert [path.name for path in tmp_path.iterdir()] == ["N46E009.tif"]
    assert tile_server.requests


def test_one_process_waits_for_another_and_clear_leaves_its_area(cache, tile_server):
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


def test_an_interrupted_build_continues(one_degree, cache, tile_server):
    area = Area.around([PLACE], 1.5, 1.5)

    def stop(done, total):
        if done == total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare_area(area, bar=lambda doing: nullcontext(stop if "building" in doing else None))
    (unfinished,) = areas.cached_areas()
    assert not unfinished.is_finished
    assert list(unfinished.folder.rglob("*-of-*.h5"))
    tile_server.requests.clear()
    ready = prepare_area(area)
    assert ready.store.exists()
    assert not tile_server.requests
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
def test_other_files_of_a_name_and_files_beside_a_dem_tell_areas_apart(one_degree, tmp_path):
    dem = tmp_path / "dem.tif"

    def origin():
        return prepare_area(Area.around([PLACE], 0.5, 0.5), dem).folder.parent

    shutil.copy2(one_degree / "dem.tif", dem)
    first = origin()
    assert origin() == first
    time.sleep(0.05)
    shutil.copy2(one_degree / "dem.tif", dem)  # As long and, by its time, as old
    copied = origin()
    (tmp_path / "dem.tif.aux.xml").write_text("<PAMDataset><SRS>EPSG:4258</SRS></PAMDataset>")
    assert len({first, copied, origin()}) == 3


def test_an_area_without_a_model_of_this_form_keeps_its_store(one_degree, cache, tile_server):
    """Earlier releases wrote models of another form, under another name."""
    area = Area.around([PLACE], 1.5, 1.5)
    made = prepare_area(area)
    digest = skyline.read_dem(made.terrain).digest
    before = made.store.stat().st_mtime_ns
    made.terrain.unlink()
    again = prepare_area(area)
    assert again.store.stat().st_mtime_ns == before
    assert skyline.read_dem(again.terrain).digest == digest
