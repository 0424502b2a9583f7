"""What is said of stores that are damaged, foreign, forged or unfinished, each in one line."""

import errno
import os
import sys
from dataclasses import replace
from functools import partial

import h5py
import numpy as np
import pytest
from refusals import assert_says
from scenes import write_dem
from store_rows import (
    HEADERS,
    PLACES_HEADER,
    VIEWS_HEADER,
    WIDTH,
    chunk_of,
    damaged_rows,
    edited,
    flip,
    hollow_store,
    older_store,
    replace_data,
    write_rows,
)

from skyline.errors import MissingFileError, StoreError, StoreMismatchError
from skyline.geodesy.map_frame import Frame
from skyline.store.check import check_store
from skyline.store.merge import merge_stores, repair_store
from skyline.store.read import open_store, parts_folder
from skyline.store.write import check_store_path


def assert_refused(path, said):
    """Require that opening a store is refused in a line with its name, and leaves it as it is."""
    before = path.read_bytes()
    assert_says(rf"{path}.*{said}", lambda: open_store(path), StoreError)
    assert path.read_bytes() == before


class TestMismatch:
    @pytest.mark.parametrize(
        ("change", "said"),
        [
            ({"dem_digest": "b2" * 32}, r"a1a1\)' in a.h5.*b2b2\)' in b.h5.*one DEM of both areas"),
            ({"config": {"planner": "rov"}}, "planner is 'uniform' in.*'rov' in b.h5"),
            ({"holds": "places", "width": 0}, "'renderings' in a.h5.*'places' in b.h5"),
            (
                {"config": VIEWS_HEADER.config | {"tolerance_px": 0.05}},
                "tolerance_px is 'absent' in a.h5, 0.05 in b.h5; skylines are no longer rendered",
            ),
        ],
    )
    def test_of_two_builds(self, tmp_path, change, said):
        a = write_rows(tmp_path / "a.h5", 0, 3)
        b = write_rows(tmp_path / "b.h5", 3, 6, replace(VIEWS_HEADER, **change))
        assert_says(said, lambda: merge_stores([a, b], tmp_path / "out.h5"), StoreMismatchError)

    def test_of_a_dem_in_another_frame(self, tmp_path):
        header = replace(PLACES_HEADER, frame_wkt=Frame.from_crs("EPSG:3857").wkt)
        dem = write_dem(tmp_path / "dem.tif", np.ones((4, 4), np.float32))
        said = "read in the frame EPSG:32632, .*EPSG:3857"
        assert_says(said, lambda: header.read_dem(dem), StoreMismatchError)


class TestDamage:
    def test_of_a_file_that_is_cut_short(self, tmp_path):
        path = write_rows(tmp_path / "s.h5", 0, 3000, PLACES_HEADER)
        with open_store(path) as store:
            mapped = store.places()
        os.truncate(path, path.stat().st_size // 2)
        assert_says(f"{path}.* is truncated", lambda: mapped.take(np.array([2999])), StoreError)
        assert_says(f"{path}.* is truncated", lambda: list(mapped.blocks()), StoreError)
        assert_says(f"{path}.* is truncated", lambda: mapped.phases(np.array([0])), StoreError)

    @pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
    def test_of_a_store_to_be_merged(self, tmp_path, header):
        path = damaged_rows(tmp_path / "s.h5", header)
        assert_says("repair` saves", lambda: merge_stores([path], tmp_path / "no.h5"), StoreError)

    def test_of_places_that_are_read(self, tmp_path):
        with open_store(damaged_rows(tmp_path / "s.h5", PLACES_HEADER)) as store:
            mapped = store.places()
        assert_says("skyline store check", lambda: mapped.take(np.arange(2500)), StoreError)
        said = "not a list of numbers"
        assert_says(said, lambda: mapped.take(np.ones(2500, dtype=bool)))

    def test_of_all_rows(self, tmp_path):
        path = write_rows(tmp_path / "s.h5", 0, 3)
        flip(path, chunk_of(path, "views/heading", 0))
        said = "none of the 3 rows"
        assert_says(said, lambda: repair_store(path, tmp_path / "saved.h5"), StoreError)

    @pytest.mark.parametrize(
        ("code", "said"),
        [
            ("import os; os.abort()", "HDF5 crashes on it (signal 6)"),
            ("while True: pass", "HDF5 had not read it after 1 s of processor time"),
        ],
    )
    def test_of_hdf5_itself(self, tmp_path, code, said):
        path = write_rows(tmp_path / "s.h5", 0, 3)
        report = check_store(path, limit_s=1.0, examiner=[sys.executable, "-c", code])
        assert said in report.damage[0].what


class TestForeign:
    def test_no_file_and_a_folder(self, tmp_path):
        path = tmp_path / "s.h5"
        assert_says("does not exist", lambda: open_store(path), MissingFileError)
        said = "is a folder; name the file of a store"
        assert_says(said, lambda: open_store(tmp_path), StoreError)

    def test_text(self, tmp_path):
        (tmp_path / "s.h5").write_text("easting,northing\n")
        assert_refused(tmp_path / "s.h5", "not an HDF5 file")

    def test_hdf5_of_another_program(self, tmp_path):
        with h5py.File(tmp_path / "s.h5", "w") as file:
            file["data"] = np.arange(10)
        assert_refused(tmp_path / "s.h5", "not a skyline store")

    def test_a_store_of_an_older_schema(self, tmp_path):
        path = older_store(tmp_path / "s.h5")
        assert_refused(path, "schema version 3.* reads version 4: build the store again")

    def test_rows_that_are_promised_but_not_there(self, tmp_path):
        with open_store(hollow_store(tmp_path / "s.h5")) as store:
            assert_says("holds no row 1024", store.places, StoreError)


def set_attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def link(name, target):
    """Return an edit that moves a part of the file and leaves a link in its place."""

    def edit(file):
        file.move(name, "moved")
        file[name] = target

    return edit


RAW = [("raw.bin", 0, 64)]


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (set_attribute("schema", "skyline-store"), "'schema' that is not text"),  # any length
        (set_attribute("schema_version", 5), "schema version 5; .* upgrade skyline"),
        (set_attribute("config", np.bytes_("[" * 100_000)), "does not have the digest"),
        (set_attribute("renderer", np.bytes_("mine")), "does not have the digest"),
        (set_attribute("rows", np.bytes_('{"rows": "delta"}')), "does not have the digest"),
        (lambda file: file.attrs.__delitem__("schema"), "not a skyline store"),
        (lambda file: file.move("views", "moved"), "lacks views"),
        (link("views", h5py.SoftLink("/moved")), "is a link to another place"),
        (replace_data("views/easting", dtype="f8", external=RAW), "has chunks None"),
        (replace_data("views/depth_m", dtype="f8"), "dtype float64; expected"),
        (replace_data("views/depth_m", dtype="f4", chunks=(3, WIDTH)), "has fletcher32 False"),
        (replace_data("views/easting", **VIEWS_HEADER.layout("views/easting", 4)), "3 to 4 rows"),
    ],
)
def test_a_forged_store(tmp_path, edit, said):
    path = write_rows(tmp_path / "s.h5", 0, 3)
    with edited(path) as file:
        edit(file)
    assert_refused(path, said)


class TestOutputs:
    @pytest.mark.parametrize("copy", [lambda a, out: merge_stores([a], out), repair_store])
    def test_that_exist_or_have_no_folder(self, tmp_path, copy):
        path = write_rows(tmp_path / "a.h5", 0, 3)
        assert_says("exists already", lambda: copy(path, path), StoreError)
        out = tmp_path / "no" / "b.h5"
        assert_says("make it first", lambda: copy(path, out), MissingFileError)
        assert_says("make it first", lambda: write_rows(out, 0, 3), MissingFileError)

    def test_that_may_not_be_written(self, tmp_path, monkeypatch):
        """Before a DEM is read and rendered, as `build` and `render` check it first."""
        monkeypatch.setattr(os, "access", lambda *_: False)
        assert_says("no rights to write in", lambda: check_store_path(tmp_path / "s.h5"))

    def test_of_no_stores(self, tmp_path):
        assert_says("no stores", lambda: merge_stores([], tmp_path / "b.h5"))

    def test_on_a_full_disk(self, tmp_path, monkeypatch):
        path = write_rows(tmp_path / "a.h5", 0, 200)

        def full(*_):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(os, "posix_fallocate", full)
        said = "No space left on device"
        assert_says(said, lambda: merge_stores([path], tmp_path / "b.h5"), StoreError)


@pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
def test_an_unfinished_build(tmp_path, header):
    path = tmp_path / "s.h5"
    folder, other = (parts_folder(path) / build for build in ("0123", "4567"))
    folder.mkdir(parents=True)
    other.mkdir()

    def assert_unfinished(said):
        for read in (open_store, check_store):
            assert_says(f"{path}.*{said}", partial(read, path), MissingFileError)

    assert_unfinished("no part of it is there yet")
    write_rows(folder / f"{header.holds}-00001-00004-of-00037.h5", 0, 3, header)
    assert_unfinished("a part is there")
    write_rows(folder / f"{header.holds}-00005-from-3-of-00037.h5", 0, 3, header)
    command = "skyline build" if header.holds == "places" else "skyline render"
    assert_unfinished(rf"2 parts are there\).* `{command}`")
    write_rows(other / f"{header.holds}-00001-00001-of-00005.h5", 0, 3, header)
    assert_unfinished("3 parts are there")
