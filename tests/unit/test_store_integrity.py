"""Damage is found and named, what is whole is saved, and copies depend on the rows alone."""

import errno
import hashlib
import os
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from store_rows import HEADER, WIDTH, rows

from skyline.errors import InputError, MissingFileError, StoreError, StoreMismatchError
from skyline.store import (
    Built,
    RowCoding,
    StoreHeader,
    check_store,
    compact_store,
    create_store,
    integrity,
    merge_stores,
    open_for_append,
    open_store,
    repair_store,
)
from skyline.store.integrity import examine

CHUNK = 32
COMPACT = replace(HEADER, coding=RowCoding.within(WIDTH))


def build(path: Path, *spans: tuple[int, int], header: StoreHeader = HEADER) -> Path:
    with create_store(path, header) as writer:
        for start, stop in spans:
            writer.append(*rows(start, stop))
    return path


def part(path: Path, span: tuple[int, int], built: Built) -> Path:
    with create_store(path, HEADER) as writer:
        writer.append(*rows(*span))
        writer.note_built(built)
    return path


def assert_holds(path: Path, count: int, header: StoreHeader = HEADER) -> None:
    views, keypoints = rows(0, count)
    with open_store(path) as store:
        assert store.header == header
        np.testing.assert_array_equal(store.views().elevation_tan, views.elevation_tan)
        np.testing.assert_array_equal(store.views().northing_m, views.northing_m)
        np.testing.assert_array_equal(store.keypoint_columns(), keypoints)


class TestCheck:
    @pytest.mark.parametrize("header", [HEADER, COMPACT])
    def test_a_whole_store(self, tmp_path: Path, header: StoreHeader) -> None:
        path = build(tmp_path / "s.h5", (0, 100), header=header)
        report = check_store(path)
        assert (report.committed, report.whole, report.in_use) == (100, True, False)

    @pytest.mark.parametrize("header", [HEADER, COMPACT])
    def test_every_flipped_bit_that_changes_data_is_found(
        self, tmp_path: Path, header: StoreHeader
    ) -> None:
        whole = build(tmp_path / "whole.h5", (0, 100), header=header)
        with open_store(whole) as store:
            wanted = store.stored()
        data = np.frombuffer(whole.read_bytes(), dtype=np.uint8)
        path, generator, found = tmp_path / "s.h5", np.random.default_rng(7), 0
        for position in generator.integers(0, len(data), 40):
            damaged = data.copy()
            damaged[position] ^= 1 << generator.integers(8)
            path.write_bytes(damaged.tobytes())
            if not examine(path).whole:
                found += 1
                continue
            with open_store(path) as store:
                assert store.header == header
                for name, values in store.stored().items():
                    np.testing.assert_array_equal(values, wanted[name], err_msg=str(position))
        assert found >= 10

    @pytest.mark.parametrize("text", [b"davos.tif", b"EPSG", b"spacing_m", b"Mesa", b"a1a1a1a1"])
    def test_a_flip_in_the_header_is_refused_by_readers(self, tmp_path: Path, text: bytes) -> None:
        path = build(tmp_path / "s.h5", (0, 5))
        data = bytearray(path.read_bytes())
        data[data.index(text)] ^= 1
        path.write_bytes(data)
        with pytest.raises(StoreError, match="does not have the digest"):
            open_store(path)

    def test_a_count_too_low(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", (0, 100))
        with h5py.File(path, "r+", libver=("v110", "v110")) as file:
            file["committed"][()] = 36
        (damage,) = examine(path).damage
        assert damage.what == "it holds 100 rows and says 36 are committed"

    def test_a_hole_that_reads_as_zeros(self, tmp_path: Path) -> None:
        """The Fletcher-32 of zeros is zero, so HDF5 takes them for data."""
        path = build(tmp_path / "s.h5", (0, 100))
        with h5py.File(path) as file:
            chunk = file["views/easting"].id.get_chunk_info(1)
        with path.open("r+b") as file:
            file.seek(chunk.byte_offset)
            file.write(bytes(chunk.size))
        with open_store(path) as store:
            assert not store.views(slice(32, 64)).easting_m.any()
        (damage,) = examine(path).damage
        assert (damage.first_row, damage.rows) == (CHUNK, CHUNK)

    def test_damage_of_neighbouring_chunks_is_told_as_one(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", (0, 5 * CHUNK))
        with h5py.File(path) as file:
            chunks = [file["views/northing"].id.get_chunk_info(number) for number in (1, 2, 4)]
        data = bytearray(path.read_bytes())
        for chunk in chunks:
            data[chunk.byte_offset + chunk.size // 2] ^= 16
        path.write_bytes(data)
        told = [(damage.first_row, damage.rows) for damage in examine(path).damage]
        assert told == [(CHUNK, 2 * CHUNK), (4 * CHUNK, CHUNK)]

    def test_a_store_that_its_writer_left(self, tmp_path: Path) -> None:
        with create_store(tmp_path / "live.h5", HEADER) as writer:
            writer.append(*rows(0, 100))
            shutil.copy(tmp_path / "live.h5", tmp_path / "s.h5")
        report = examine(tmp_path / "s.h5")
        assert (report.committed, report.in_use, report.whole) == (96, True, True)

    def test_what_is_no_store(self, tmp_path: Path) -> None:
        with pytest.raises(MissingFileError, match="does not exist"):
            check_store(tmp_path / "s.h5")
        (tmp_path / "s.h5").write_text("easting,northing\n")
        (damage,) = check_store(tmp_path / "s.h5").damage
        assert "not an HDF5 file" in damage.what

    def test_a_file_on_which_hdf5_fails(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Forged structures can make HDF5 loop or crash; the process that checks lives on."""
        path, examine = build(tmp_path / "s.h5", (0, 3)), integrity._EXAMINE
        monkeypatch.setattr(integrity, "_EXAMINE", "import os; os.abort()")
        assert "crashes on it (signal 6)" in check_store(path).damage[0].what
        monkeypatch.setattr(integrity, "_EXAMINE", "raise MemoryError")
        with pytest.raises(StoreError, match="could not be examined: MemoryError"):
            check_store(path)
        monkeypatch.setattr(integrity, "_PATIENCE_S", 0.2)
        monkeypatch.setattr(integrity, "_EXAMINE", "import time; time.sleep(1000)")
        with monkeypatch.context() as patch:
            patch.setattr(integrity, "_WAITED", 1.0)
            assert "had not read it after 0 s" in check_store(path).damage[0].what
        loops = examine.replace("json.dump(", "while True: pass\njson.dump(")
        assert loops != examine
        monkeypatch.setattr(integrity, "_EXAMINE", loops)
        monkeypatch.setattr(integrity, "_WAITED", 3000.0)
        assert "of processor time" in check_store(path).damage[0].what


class TestRepair:
    @pytest.mark.parametrize("name", ["views/elevation_tan", "views/northing", "views/checksum"])
    def test_whole_chunks_are_saved(self, tmp_path: Path, name: str) -> None:
        path = build(tmp_path / "s.h5", (0, 100))
        with h5py.File(path) as file:
            chunk = file[name].id.get_chunk_info(1)
        data = bytearray(path.read_bytes())
        data[chunk.byte_offset + chunk.size // 2] ^= 16
        path.write_bytes(data)
        with pytest.raises(StoreError, match="repair` saves"):
            compact_store(path, tmp_path / "no.h5")
        report = repair_store(path, tmp_path / "saved.h5")
        assert report.rows == 68
        assert [(damage.first_row, damage.rows) for damage in report.damage] == [(32, 32)]
        kept = np.r_[0:32, 64:100]
        with open_store(tmp_path / "saved.h5") as store:
            np.testing.assert_array_equal(store.locations().easting_m, 7.5e5 + kept)
        assert examine(tmp_path / "saved.h5").whole
        assert {file.name for file in tmp_path.iterdir()} == {"s.h5", "saved.h5"}

    def test_a_whole_store_is_copied(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", (0, 100))
        assert repair_store(path, tmp_path / "saved.h5").damage == ()
        assert_holds(tmp_path / "saved.h5", 100)

    def test_of_a_damaged_store_it_is_not_known_what_is_missing(self, tmp_path: Path) -> None:
        path = part(tmp_path / "s.h5", (0, 40), Built(2, 2))
        assert repair_store(path, tmp_path / "whole.h5").built == Built(2, 2)
        data = bytearray(path.read_bytes())
        with h5py.File(path) as file:
            data[file["views/northing"].id.get_chunk_info(0).byte_offset] ^= 1
        path.write_bytes(data)
        assert repair_store(path, tmp_path / "saved.h5").built == Built()


class TestMerge:
    @pytest.mark.parametrize(
        ("parts", "wanted"),
        [
            ([((0, 40), Built(1, 3))], Built(1, 3)),
            ([((0, 40), Built(1, 3)), ((40, 70), Built(2, 3))], Built(3, 3)),
            ([((0, 40), Built(1, 3)), ((40, 70), Built(1, 3))], Built(2, 3)),
            ([((0, 40), Built(1, 3)), ((0, 40), Built(1, 3))], Built(1, 3)),
            ([((0, 40), Built(1, 3)), ((0, 70), Built(2, 3))], Built(2, 3)),
            ([((0, 40), Built(3, 3)), ((40, 41), Built())], Built(3, 3)),
            ([((0, 40), Built(1, 3)), ((40, 70), Built())], Built(1, 3)),
            ([((0, 40), Built()), ((40, 70), Built())], Built()),
        ],
    )
    def test_parts_of_a_build_add_up(
        self, tmp_path: Path, parts: list[tuple[tuple[int, int], Built]], wanted: Built
    ) -> None:
        """At least: stores that share rows hold no more than the one that holds most."""
        stores = [part(tmp_path / f"{number}.h5", *one) for number, one in enumerate(parts)]
        assert merge_stores(stores, tmp_path / "out.h5").built == wanted
        compact_store(tmp_path / "out.h5", tmp_path / "copy.h5")
        with open_store(tmp_path / "copy.h5") as store:
            assert store.built == wanted

    def test_order_and_cut_change_no_byte(self, tmp_path: Path) -> None:
        a = build(tmp_path / "a.h5", (0, 40))
        b = build(tmp_path / "b.h5", (70, 100), (40, 70))
        digests = set()
        for number, stores in enumerate([(a, b), (b, a), (b, b, a)]):
            out = tmp_path / f"{number}.h5"
            report = merge_stores(stores, out)
            assert (report.rows, report.duplicates) == (100, 60 if number == 2 else 0)
            digests.add(hashlib.sha256(out.read_bytes()).hexdigest())
        compact_store(build(tmp_path / "whole.h5", (0, 100)), tmp_path / "3.h5")
        digests.add(hashlib.sha256((tmp_path / "3.h5").read_bytes()).hexdigest())
        assert len(digests) == 1
        assert_holds(tmp_path / "0.h5", 100)

    def test_resumed_and_compacted_is_unbroken_and_compacted(self, tmp_path: Path) -> None:
        with create_store(tmp_path / "live.h5", COMPACT) as writer:
            writer.append(*rows(0, 75))
            shutil.copy(tmp_path / "live.h5", tmp_path / "killed.h5")
        with open_for_append(tmp_path / "killed.h5", COMPACT) as writer:
            writer.append(*rows(64, 100))
        build(tmp_path / "whole.h5", (0, 100), header=COMPACT)
        for name in ("killed", "whole"):
            compact_store(tmp_path / f"{name}.h5", tmp_path / f"{name}.compact")
        killed, whole = (tmp_path / f"{name}.compact" for name in ("killed", "whole"))
        assert killed.read_bytes() == whole.read_bytes()

    @pytest.mark.parametrize(
        ("change", "said"),
        [
            ({"dem_digest": "b2" * 32}, ("a1" * 32 + "' in a.h5", "b2" * 32 + "' in b.h5")),
            ({"config": {"planner": "rov"}}, ("planner is 'uniform' in", "'rov' in b.h5")),
            ({"coding": COMPACT.coding}, ("rows is 'exact' in a.h5", "'compact' in b.h5")),
            ({"frame_wkt": "nonsense"}, ("EPSG:32632", "'nonsense' in b.h5")),
        ],
    )
    def test_stores_that_do_not_belong_together(
        self, tmp_path: Path, change: dict[str, object], said: tuple[str, str]
    ) -> None:
        a = build(tmp_path / "a.h5", (0, 3))
        b = build(tmp_path / "b.h5", (3, 6), header=replace(HEADER, **change))
        with pytest.raises(StoreMismatchError) as caught:
            merge_stores([a, b], tmp_path / "out.h5")
        assert all(value in str(caught.value) for value in said)
        assert {file.name for file in tmp_path.iterdir()} == {"a.h5", "b.h5"}

    def test_nothing_is_overwritten(self, tmp_path: Path) -> None:
        a = build(tmp_path / "a.h5", (0, 3))
        before = a.read_bytes()
        with pytest.raises(StoreError, match="exists already"):
            compact_store(a, a)
        with pytest.raises(MissingFileError, match="make it first"):
            compact_store(a, tmp_path / "no" / "b.h5")
        with pytest.raises(InputError, match="no stores"):
            merge_stores([], tmp_path / "b.h5")
        assert a.read_bytes() == before
        assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]

    def test_empty_stores(self, tmp_path: Path) -> None:
        merge_stores([build(tmp_path / "a.h5"), build(tmp_path / "b.h5")], tmp_path / "c.h5")
        assert check_store(tmp_path / "c.h5").committed == 0

    @pytest.mark.parametrize("call", ["posix_fallocate", "fsync"])
    def test_full_disk(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
        a = build(tmp_path / "a.h5", (0, 200))
        real, calls = getattr(os, call), iter([True])

        def full(*arguments: int) -> None:
            # The first time, the empty store is written.
            if call == "posix_fallocate" or not next(calls, False):
                raise OSError(errno.ENOSPC, "No space left on device")
            real(*arguments)

        monkeypatch.setattr(os, call, full)
        with pytest.raises(StoreError, match="No space left on device"):
            compact_store(a, tmp_path / "b.h5")
        assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]


class TestQuantize:
    def test_exact_rows_are_rounded_once(self, tmp_path: Path) -> None:
        exact = build(tmp_path / "exact.h5", (0, 70))
        compact_store(exact, tmp_path / "compact.h5", COMPACT.coding)
        compact_store(
            build(tmp_path / "as_built.h5", (0, 70), header=COMPACT), tmp_path / "same.h5"
        )
        assert (tmp_path / "compact.h5").read_bytes() == (tmp_path / "same.h5").read_bytes()
        with pytest.raises(InputError, match="rounded already"):
            compact_store(tmp_path / "same.h5", tmp_path / "no.h5", COMPACT.coding)
