"""The store: rows come back as written, damage is found, foreign and forged files are refused."""

import fcntl
import json
import os
import re
import subprocess
import sys
import textwrap
from dataclasses import fields, replace
from pathlib import Path
from zlib import crc32

import h5py
import numpy as np
import pytest
from store_rows import (
    HEADERS,
    PLACES_HEADER,
    VIEWS_HEADER,
    assert_holds,
    chunk_of,
    damaged_rows,
    flip,
    hollow_store,
    numbered_places,
    older_store,
    write_rows,
)

from skyline.errors import InputError, MissingFileError, StoreError, StoreMismatchError
from skyline.store.check import check_store, examine
from skyline.store.layout import columns_of, refuse_mismatch
from skyline.store.merge import merge_stores, repair_store
from skyline.store.places import Places
from skyline.store.read import is_store, open_store, parts_folder
from skyline.store.write import write_store

STORE_PAGE = Path(__file__).parents[2] / "docs" / "store.md"
KINDS = pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
CHUNK = 1024


class TestRows:
    def test_ordinates_keep_the_name_that_they_have_in_older_files(self, tmp_path):
        write_rows(tmp_path / "new.h5", 0, 4)
        with h5py.File(tmp_path / "new.h5") as file:
            held = file["views/elevation_tan"][:]
        with open_store(tmp_path / "new.h5") as store:
            np.testing.assert_array_equal(store.views().v, held)

    @KINDS
    @pytest.mark.parametrize("count", [0, 33, 3 * CHUNK + 5])
    def test_come_back_unchanged(self, tmp_path, header, count):
        path = write_rows(tmp_path / "s.h5", 0, count, header)
        with open_store(path) as store:
            assert (len(store), store.header) == (count, header)
            assert_holds(store, np.arange(count))
            eyes = store.eyes()
        assert eyes.eye_elevation_m.dtype == np.float64
        np.testing.assert_array_equal(eyes.easting_m, 7.5e5 + np.arange(count))
        assert [file.name for file in tmp_path.iterdir()] == ["s.h5"]

    @KINDS
    @pytest.mark.parametrize(
        "index",
        [-1, slice(None, None, -7), slice(80, 20), np.array([90, 2, 2]), np.arange(100) % 9 == 4],
    )
    def test_by_any_numpy_index(self, tmp_path, header, index):
        with open_store(write_rows(tmp_path / "s.h5", 0, 100, header)) as store:
            assert_holds(store, np.arange(100), index)

    @KINDS
    def test_have_the_checksums_of_their_bytes(self, tmp_path, header):
        """CRC-32s chained over the datasets in order of name."""
        with open_store(write_rows(tmp_path / "s.h5", 0, 40, header)) as store:
            columns = dict(store.stored())
        sums = columns.pop(header.checksum)
        for row in range(40):
            chained = 0
            for name in sorted(columns):
                chained = crc32(columns[name][row].tobytes(), chained)
            assert sums[row] == chained


class TestHeader:
    @KINDS
    def test_and_layout_are_the_documented_ones(self, tmp_path, header):
        """As another program reads them with h5py alone."""
        path = write_rows(tmp_path / "s.h5", 0, 40, header)
        documented = STORE_PAGE.read_text()
        with h5py.File(path) as file:
            assert file.attrs["schema_version"] == 4
            assert file.attrs["schema"] == b"skyline-store"
            assert json.loads(file.attrs["config"]) == header.config
            assert json.loads(file.attrs["dem_files"]) == list(header.dem_files)
            rows = json.loads(file.attrs["rows"])
            assert rows["rows"] == header.holds
            names = re.findall(r"^\| `(\w+)` \| (?:text|integer) \|", documented, re.M)
            assert set(file.attrs) == set(names)
            datasets = [data for group in file.values() for data in group.values()]
            assert {data.name[1:] for data in datasets} == set(header.specs)
            for data in datasets:
                shown = f"| `{data.name[1:]}` |"
                (line,) = (one for one in documented.splitlines() if shown in one)
                assert f"| {data.dtype.str[1:]} |" in line
                assert data.fletcher32
                assert data.chunks[0] == (40 if header.holds == "places" else 32)
                if header.holds == "places":
                    assert (data.compression, data.shuffle) == (None, False)

    @pytest.mark.parametrize(
        "change",
        [
            {"dem_digest": "b2" * 32},
            {"config": {"planner": "rov"}},
            {"config": VIEWS_HEADER.config | {"tolerance_px": 0.05}},
            {"holds": "places", "width": 0},
        ],
    )
    def test_of_another_build_is_refused(self, tmp_path, change):
        a = write_rows(tmp_path / "a.h5", 0, 3)
        b = write_rows(tmp_path / "b.h5", 3, 6, replace(VIEWS_HEADER, **change))
        with pytest.raises(StoreMismatchError):
            merge_stores([a, b], tmp_path / "out.h5")
        assert {file.name for file in tmp_path.iterdir()} == {"a.h5", "b.h5"}

    def test_options_that_are_no_more_distinguish_no_stores(self):
        """Releases up to 0.2 wrote `reproject`."""
        now, before = (
            replace(PLACES_HEADER, config={"dem_options": {"crs": None, **more}})
            for more in ({}, {"reproject": False})
        )
        refuse_mismatch(now, before, "these", "no advice")

    @pytest.mark.parametrize("name", ["tolerance_px", "tolerance_deg"])
    def test_of_exact_skylines_are_alike_whether_or_not_they_name_a_tolerance(self, name):
        """Releases up to 0.2 wrote by how much a skyline might lie too low."""
        before = replace(PLACES_HEADER, config={**PLACES_HEADER.config, name: 0.0})
        refuse_mismatch(before, PLACES_HEADER, "these", "no advice")

    def test_of_less_exact_skylines_names_the_tolerance(self, tmp_path):
        header = replace(VIEWS_HEADER, config={**VIEWS_HEADER.config, "tolerance_px": 0.05})
        with open_store(write_rows(tmp_path / "a.h5", 0, 3, header)) as store:
            assert store.header.config["tolerance_px"] == 0.05
            assert_holds(store, np.arange(3))

    def test_of_less_exact_skylines_is_not_extended_by_settings_that_are_no_more(self):
        before = replace(PLACES_HEADER, config={**PLACES_HEADER.config, "tolerance_deg": 0.01})
        with pytest.raises(StoreMismatchError) as refused:
            refuse_mismatch(before, PLACES_HEADER, "these", "repeat its settings")
        said = str(refused.value)
        assert "tolerance_deg is 0.01 there, 'absent' here" in said
        assert said.endswith(
            "build a new store of that area (the old one is still read and searched)"
        )
        assert "repeat its settings" not in said

    def test_of_less_exact_skylines_is_joined_to_no_exact_one(self, tmp_path):
        header = replace(VIEWS_HEADER, config={**VIEWS_HEADER.config, "tolerance_px": 0.05})
        a = write_rows(tmp_path / "a.h5", 0, 3, header)
        b = write_rows(tmp_path / "b.h5", 3, 6)
        said = (
            "tolerance_px is 0.05 in a.h5, 'absent' in b.h5; skylines are no longer rendered with"
        )
        with pytest.raises(StoreMismatchError, match=said):
            merge_stores([a, b], tmp_path / "out.h5")


class TestMap:
    def test_lies_in_the_file_and_outlives_the_store(self, tmp_path):
        path = write_rows(tmp_path / "s.h5", 0, 2500, PLACES_HEADER)
        with open_store(path) as store:
            mapped = store.places()
        blocks = list(mapped.blocks())
        assert [len(block) for block in blocks] == [CHUNK, CHUNK, 452]
        whole, joined = numbered_places(0, 2500), Places.concatenate(blocks)
        for field in fields(Places):
            np.testing.assert_array_equal(getattr(joined, field.name), getattr(whole, field.name))
            first = getattr(blocks[0], field.name)
            assert not first.flags.writeable
        write_rows(path, 5, 10, PLACES_HEADER)
        np.testing.assert_array_equal(mapped.take(np.arange(2500)).rise, whole.rise)

    def test_of_a_file_that_is_cut_short(self, tmp_path):
        path = write_rows(tmp_path / "s.h5", 0, 3000, PLACES_HEADER)
        with open_store(path) as store:
            mapped = store.places()
        blocks = mapped.blocks()
        next(blocks)
        os.truncate(path, path.stat().st_size // 2)
        for read in (lambda: next(blocks), lambda: mapped.take(np.array([2999]))):
            with pytest.raises(StoreError):
                read()


class TestWriting:
    def test_leaves_the_store_as_it_was_where_it_fails(self, tmp_path):
        """On a disk that is full, at every size of the file at which that may be."""
        path = write_rows(tmp_path / "s.h5", 0, 3, PLACES_HEADER)
        before = path.read_bytes()
        script = f"""
            import resource, sys
            sys.path.insert(0, {str(Path(__file__).parent)!r})
            from pathlib import Path
            from store_rows import HEADERS, write_rows
            from skyline.errors import StoreError
            for header in HEADERS.values():
                for limit in (0, 1000, 20_000, 60_000, 300_000):
                    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
                    try:
                        write_rows(Path({str(path)!r}), 0, 5000, header)
                    except StoreError as error:
                        print(error)
        """
        command = [sys.executable, "-c", textwrap.dedent(script)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        lines = done.stdout.splitlines()
        assert len(lines) == 10
        assert all("cannot be written (" in line and "too large" in line for line in lines)
        assert path.read_bytes() == before
        assert [file.name for file in tmp_path.iterdir()] == ["s.h5"]

    def test_needs_no_file_locks(self, tmp_path):
        """Also where another process holds one, and beside a program that reads the file."""
        path = write_rows(tmp_path / "s.h5", 0, 3)
        with path.open("rb") as file, h5py.File(path), open_store(path) as store:
            fcntl.flock(file, fcntl.LOCK_SH)
            assert_holds(store, np.arange(3))
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            with open_store(path) as store:
                assert_holds(store, np.arange(3))
            write_rows(path, 0, 5)
        assert check_store(path).rows == 5

    def test_into_no_folder(self, tmp_path):
        with pytest.raises(MissingFileError):
            write_rows(tmp_path / "no" / "s.h5", 0, 3)
        assert not list(tmp_path.iterdir())


class TestDamage:
    @KINDS
    def test_in_any_dataset_is_found_and_the_rest_saved(self, tmp_path, header):
        whole = write_rows(tmp_path / "whole.h5", 0, 2500, header).read_bytes()
        size = header.chunk_rows(2500)
        kept = np.r_[0:size, 2 * size : 2500]
        path = tmp_path / "s.h5"
        for name in header.specs:
            path.write_bytes(whole)
            flip(path, chunk_of(path, name, 1) + 12)
            (damage,) = examine(path).damage
            assert (damage.first_row, damage.rows) == (size, size)
            saved = tmp_path / f"{name.replace('/', '-')}.h5"
            report = repair_store(path, saved)
            assert (report.rows, report.holds, len(report.damage)) == (len(kept), header.holds, 1)
            with open_store(saved) as store:
                assert_holds(store, kept)

    @KINDS
    def test_is_merged_into_no_store(self, tmp_path, header):
        path = damaged_rows(tmp_path / "s.h5", header)
        with pytest.raises(StoreError):
            merge_stores([path], tmp_path / "no.h5")
        assert not (tmp_path / "no.h5").exists()

    def test_of_places_lets_the_others_be_read(self, tmp_path):
        with open_store(damaged_rows(tmp_path / "s.h5", PLACES_HEADER)) as store:
            mapped = store.places()
        with pytest.raises(StoreError):
            mapped.take(np.arange(2500))
        assert len(mapped.take(np.r_[0:CHUNK, 2 * CHUNK : 2500])) == 2500 - CHUNK

    def test_a_store_without_a_whole_row_is_not_saved(self, tmp_path):
        path = write_rows(tmp_path / "s.h5", 0, 3)
        flip(path, chunk_of(path, "views/heading", 0))
        with pytest.raises(StoreError):
            repair_store(path, tmp_path / "saved.h5")
        assert not (tmp_path / "saved.h5").exists()

    def test_a_hole_that_reads_as_zeros(self, tmp_path):
        """The Fletcher-32 of zeros is zero, so HDF5 takes them for data."""
        path = write_rows(tmp_path / "s.h5", 0, 100)
        with h5py.File(path) as file:
            chunk = file["views/easting"].id.get_chunk_info(1)
        data = bytearray(path.read_bytes())
        data[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
        path.write_bytes(data)
        with open_store(path) as store:
            assert not store.views(slice(32, 64)).easting_m.any()
        (damage,) = examine(path).damage
        assert (damage.first_row, damage.rows) == (32, 32)

    @KINDS
    def test_of_any_bit_is_found_or_harmless(self, tmp_path, header):
        whole = write_rows(tmp_path / "whole.h5", 0, 100, header)
        with open_store(whole) as store:
            wanted = store.stored()
        data = np.frombuffer(whole.read_bytes(), dtype=np.uint8)
        path, generator, found = tmp_path / "s.h5", np.random.default_rng(7), 0
        for position in [*range(0, 48, 3), *generator.integers(0, len(data), 60)]:
            damaged = data.copy()
            damaged[position] ^= 1 << generator.integers(8)
            path.write_bytes(damaged.tobytes())
            report = examine(path)
            if not report.whole:
                found += 1
                assert all("\n" not in damage.what for damage in report.damage)
                continue
            with open_store(path) as store:
                assert store.header == header
                for name, values in store.stored().items():
                    np.testing.assert_array_equal(values, wanted[name], err_msg=str(position))
        assert found >= 26

    @KINDS
    def test_by_truncation_is_refused(self, tmp_path, header):
        whole = write_rows(tmp_path / "whole.h5", 0, 70, header).read_bytes()
        path = tmp_path / "s.h5"
        for size in [*range(0, 64, 5), *range(64, len(whole), len(whole) // 50), len(whole) - 1]:
            path.write_bytes(whole[:size])
            with pytest.raises(StoreError) as caught:
                open_store(path)
            assert "\n" not in str(caught.value), size
            assert str(path) in str(caught.value), size

    @pytest.mark.parametrize("code", ["import os; os.abort()", "while True: pass"])
    def test_of_hdf5_itself_ends_the_process_that_checks(self, tmp_path, code):
        """Forged structures can make HDF5 crash or loop."""
        path = write_rows(tmp_path / "s.h5", 0, 3)
        report = check_store(path, limit_s=1.0, examiner=[sys.executable, "-c", code])
        assert not report.whole

    def test_is_not_found_in_a_whole_store(self, tmp_path):
        report = check_store(write_rows(tmp_path / "s.h5", 0, 3))
        assert (report.rows, report.whole) == (3, True)


class TestForeign:
    def test_files_are_no_stores(self, tmp_path):
        path = tmp_path / "s.h5"
        path.write_text("easting,northing\n")
        with pytest.raises(StoreError):
            open_store(path)
        with h5py.File(path, "w") as file:
            file["data"] = np.arange(10)
        with pytest.raises(StoreError):
            open_store(path)
        assert not is_store(path)

    def test_older_stores_are_stores_that_are_refused(self, tmp_path):
        path = older_store(tmp_path / "s.h5")
        with pytest.raises(StoreError):
            open_store(path)
        assert is_store(path)

    def test_rows_that_are_promised_but_not_there_are_refused(self, tmp_path):
        with (
            open_store(hollow_store(tmp_path / "s.h5")) as store,
            pytest.raises(StoreError),
        ):
            store.places()


class TestMerge:
    @KINDS
    def test_order_and_cut_change_no_byte(self, tmp_path, header):
        a = write_rows(tmp_path / "a.h5", 0, 700, header)
        b = write_rows(tmp_path / "b.h5", 600, 2000, header)
        c = write_rows(tmp_path / "c.h5", 2000, 3000, header)
        results = set()
        for number, stores in enumerate([(a, b, c), (c, b, a), (b, c, b, a, a)]):
            report = merge_stores(stores, tmp_path / f"{number}.h5")
            assert (report.rows, report.holds) == (3000, header.holds)
            assert report.duplicates == (100, 100, 2200)[number]
            results.add((tmp_path / f"{number}.h5").read_bytes())
        merge_stores([write_rows(tmp_path / "w.h5", 0, 3000, header)], tmp_path / "d.h5")
        assert results == {(tmp_path / "d.h5").read_bytes()}
        with open_store(tmp_path / "d.h5") as store:
            assert_holds(store, np.arange(3000))

    def test_boxes_that_overlap(self, tmp_path):
        """The boxes are listed; of a place in both, that of the denser plan is kept."""
        stores = []
        boxes = ((9, 46, 10, 47), 25.0), ((8, 46, 9.2, 47), 18.0)
        for number, (box, tolerance_m) in enumerate(boxes):
            header = replace(PLACES_HEADER, config=PLACES_HEADER.config | {"bounds_deg": box})
            places = numbered_places(200 * number, 200 * number + 300)
            places = replace(places, tolerance_m=np.full(300, tolerance_m, np.float32))
            stores.append(tmp_path / f"{number}.h5")
            write_store(stores[-1], header, columns_of(header, places))
        results = set()
        for number, order in enumerate([(0, 1), (1, 0)]):
            joined = tmp_path / f"joined-{number}.h5"
            report = merge_stores([stores[one] for one in order], joined)
            assert (report.rows, report.duplicates) == (500, 100)
            results.add(joined.read_bytes())
        assert len(results) == 1
        with open_store(joined) as store:
            assert store.header.boxes_deg == [(8, 46, 9.2, 47), (9, 46, 10, 47)]
            tolerance_m = store.places().take(np.arange(500)).tolerance_m
        assert (tolerance_m == np.where(np.arange(500) < 200, 25.0, 18.0)).all()

    def test_nothing_is_overwritten(self, tmp_path):
        a = write_rows(tmp_path / "a.h5", 0, 3)
        before = a.read_bytes()
        for copy in (lambda out: merge_stores([a], out), lambda out: repair_store(a, out)):
            with pytest.raises(StoreError):
                copy(a)
            with pytest.raises(MissingFileError):
                copy(tmp_path / "no" / "b.h5")
        with pytest.raises(InputError):
            merge_stores([], tmp_path / "b.h5")
        assert a.read_bytes() == before
        assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]

    def test_a_full_disk(self, tmp_path, monkeypatch):
        a = write_rows(tmp_path / "a.h5", 0, 200)

        def full(*_):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "posix_fallocate", full)
        with pytest.raises(StoreError):
            merge_stores([a], tmp_path / "b.h5")
        assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]


def test_an_unfinished_build_is_a_store_that_is_not_there_yet(tmp_path):
    path = tmp_path / "s.h5"
    (parts_folder(path) / "0123").mkdir(parents=True)
    for read in (open_store, check_store):
        with pytest.raises(MissingFileError):
            read(path)
    write_rows(parts_folder(path) / "0123" / "places-00001-00004-of-00037.h5", 0, 3, PLACES_HEADER)
    for read in (open_store, check_store):
        with pytest.raises(MissingFileError):
            read(path)
    assert is_store(path)
