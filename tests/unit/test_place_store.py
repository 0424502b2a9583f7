"""A store of places: what is appended is mapped to the bit, and damage is found or harmless."""

import json
import os
import shutil
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path
from zlib import crc32

import h5py
import numpy as np
import pytest
from store_files import build, edited, one_line
from store_rows import HEADER, rows

from skyline.cli.info import describe_store
from skyline.errors import InputError, StoreError, StoreMismatchError
from skyline.places import BINS, DISTANCE_BINS, Places
from skyline.store import (
    RowCoding,
    check_store,
    compact_store,
    create_store,
    merge_stores,
    open_for_append,
    open_store,
    reader,
    repair_store,
)
from skyline.store.integrity import examine
from skyline_bench.stores.durability import numbered_places

PLACES = replace(HEADER, width=0, holds="places")
CHUNK = 1024
NAMES = [field.name for field in fields(Places)]
DATASETS = ["easting", "northing", *NAMES[2:], "checksum"]


def build_places(path: Path, *spans: tuple[int, int]) -> Path:
    with create_store(path, PLACES) as writer:
        for start, stop in spans:
            writer.append_places(numbered_places(start, stop))
    return path


def assert_same(got: Places, wanted: Places) -> None:
    for name in NAMES:
        np.testing.assert_array_equal(getattr(got, name), getattr(wanted, name), err_msg=name)
        assert getattr(got, name).dtype == getattr(wanted, name).dtype, name


def assert_holds(path: Path, count: int) -> None:
    with open_store(path) as store:
        mapped = store.places()
        assert len(mapped) == len(store) == count
        assert_same(mapped.take(np.arange(count)), numbered_places(0, count))


def flip(path: Path, position: int) -> None:
    data = bytearray(path.read_bytes())
    data[position] ^= 16
    path.write_bytes(data)


def chunk_of(path: Path, name: str, chunk: int) -> int:
    with h5py.File(path) as file:
        offset: int = file[f"places/{name}"].id.get_chunk_info(chunk).byte_offset
        return offset


class TestRoundTrip:
    @pytest.mark.parametrize("count", [0, 1, CHUNK - 1, CHUNK, CHUNK + 1, 3 * CHUNK + 5])
    def test_places_come_back_unchanged(self, tmp_path: Path, count: int) -> None:
        path = build_places(tmp_path / "s.h5", (0, count))
        assert_holds(path, count)
        with open_store(path) as store:
            assert store.header == PLACES
            mapped = store.places()
            eyes = store.eyes()
        # The store is closed, the map is not.
        blocks = list(mapped.blocks())
        assert [len(block) for block in blocks[:-1]] == [CHUNK] * (len(blocks) - 1)
        assert sum(len(block) for block in blocks) == count
        if count:
            assert_same(Places.concatenate(blocks), numbered_places(0, count))
        np.testing.assert_array_equal(eyes.easting_m, numbered_places(0, count).easting_m)
        assert eyes.eye_elevation_m.dtype == np.float64

    def test_blocks_are_read_only_views_of_what_hdf5_reads(self, tmp_path: Path) -> None:
        path = build_places(tmp_path / "s.h5", (0, 2500))
        with open_store(path) as store:
            (first, *_, last) = store.places().blocks()
        with h5py.File(path) as file:
            for name in NAMES:
                data = file[f"places/{name.removesuffix('_m') if 'ing' in name else name}"]
                np.testing.assert_array_equal(getattr(first, name), data[:CHUNK])
                np.testing.assert_array_equal(getattr(last, name), data[2 * CHUNK :])
                assert not getattr(first, name).flags.writeable
                assert not getattr(first, name).flags.owndata
                assert getattr(first, name).ctypes.data % 64 == 0

    def test_any_rows_in_any_order(self, tmp_path: Path) -> None:
        path = build_places(tmp_path / "s.h5", (0, 5000))
        whole = numbered_places(0, 5000)
        generator = np.random.default_rng(3)
        with open_store(path) as store:
            mapped = store.places()
        for taken in (
            generator.permutation(5000),
            generator.integers(0, 5000, 9000),
            np.array([4999, 0, 4999]),
            np.array([], dtype=int),
        ):
            got = mapped.take(taken)
            assert_same(got, whole[taken])
            assert got.rise.flags.owndata
            assert got.rise.flags.writeable
        for wrong in ([5000], [-1], [[1]]):
            with pytest.raises(InputError, match="from 0 to 4999"):
                mapped.take(np.array(wrong))

    def test_by_several_threads(self, tmp_path: Path) -> None:
        path = build_places(tmp_path / "s.h5", (0, 4000))
        whole = numbered_places(0, 4000)
        with open_store(path) as store:
            mapped = store.places()

        def work(seed: int) -> bool:
            taken = np.random.default_rng(seed).integers(0, 4000, 3000)
            assert_same(mapped.take(taken), whole[taken])
            assert_same(Places.concatenate(list(mapped.blocks())), whole)
            return True

        with ThreadPoolExecutor(4) as pool:
            assert all(pool.map(work, range(8)))

    def test_without_chunk_iter(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """As with an HDF5 library older than 1.12.3."""
        path = build_places(tmp_path / "s.h5", (0, 2500))
        monkeypatch.setattr(reader, "hasattr", lambda *_: False, raising=False)
        assert_holds(path, 2500)

    def test_hardly_more_than_their_own_bytes(self, tmp_path: Path) -> None:
        path = build_places(tmp_path / "s.h5", (0, 32 * CHUNK))
        one = numbered_places(0, 1)
        own = sum(getattr(one, name).nbytes for name in NAMES) + 4  # and the checksum
        assert path.stat().st_size / (32 * CHUNK) < own + 5

    def test_contract_with_other_programs(self, tmp_path: Path) -> None:
        path = build_places(tmp_path / "s.h5", (0, 3))
        with h5py.File(path) as file:
            assert file.attrs["schema_version"] == 3
            said = json.loads(file.attrs["rows"])
            assert (said["rows"], said["bins"], said["distance_bins"]) == (
                "places",
                BINS,
                DISTANCE_BINS,
            )
            assert list(file) == ["built", "committed", "places"]
            assert set(file["places"]) == set(DATASETS)
            documented = (Path(__file__).parents[2] / "docs" / "store.md").read_text()
            for name, data in file["places"].items():
                (row,) = (
                    each for each in documented.splitlines() if f"| `places/{name}` |" in each
                )
                assert f"| {data.dtype.str[1:]} |" in row
            for data in file["places"].values():
                assert (data.compression, data.shuffle, data.fletcher32) == (None, False, True)
                assert data.chunks[0] == CHUNK

    def test_facts(self, tmp_path: Path) -> None:
        facts = describe_store(str(build_places(tmp_path / "s.h5", (0, 7))))
        assert (facts["places"], facts["locations"], facts["rows"]) == (7, 7, "places")
        assert "renderings" not in facts
        assert "width" not in facts


class TestKinds:
    def test_a_store_holds_one_kind(self, tmp_path: Path) -> None:
        views = build(tmp_path / "views.h5", 40)
        places = build_places(tmp_path / "places.h5", (0, 40))
        with open_store(views) as store, pytest.raises(InputError) as caught:
            store.places()
        assert "holds renderings, not places" in str(caught.value)
        assert one_line(caught.value, views)
        with open_store(places) as store:
            for read in (store.views, store.locations, store.keypoint_columns):
                with pytest.raises(InputError, match="holds places, not renderings"):
                    read()
        for path, header in ((views, PLACES), (places, HEADER)):
            with pytest.raises(StoreMismatchError, match="what it holds is"):
                open_for_append(path, header)
        with pytest.raises(StoreMismatchError, match=r"'renderings' in views\.h5, 'places' in"):
            merge_stores([views, places], tmp_path / "no.h5")
        with (
            open_for_append(places, PLACES) as writer,
            pytest.raises(InputError, match="not renderings"),
        ):
            writer.append(*rows(0, 3))
        with (
            open_for_append(views, HEADER) as writer,
            pytest.raises(InputError, match="not places"),
        ):
            writer.append_places(numbered_places(0, 3))
        with pytest.raises(InputError, match="not renderings"):
            compact_store(places, tmp_path / "no.h5", RowCoding.within(24))

    @pytest.mark.parametrize("change", [{"width": 24}, {"coding": RowCoding.within(24)}])
    def test_headers_of_places_have_no_layout(self, change: dict[str, object]) -> None:
        with pytest.raises(InputError, match="no width or coding"):
            replace(PLACES, **change)
        with pytest.raises(InputError, match="not 'peaks'"):
            replace(HEADER, holds="peaks")

    @pytest.mark.parametrize(
        ("change", "said"),
        [
            ({"rise": np.zeros((3, 719), np.int8)}, r"places/rise .*\(3, 719\)"),
            ({"easting_m": np.zeros(2)}, "places/easting|places/northing"),
            ({"tolerance_m": np.full(3, np.nan)}, "tolerance_m to append has values"),
        ],
    )
    def test_places_that_do_not_fit(
        self, tmp_path: Path, change: dict[str, np.ndarray], said: str
    ) -> None:
        with create_store(tmp_path / "s.h5", PLACES) as writer:
            with pytest.raises(InputError, match=said):
                writer.append_places(replace(numbered_places(0, 3), **change))
            assert len(writer) == 0

    def test_another_coding_is_refused(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = build_places(tmp_path / "s.h5", (0, 3))
        monkeypatch.setitem(reader.read_header.__globals__["PLACE_CODING"], "rise_size", 0.007)
        with pytest.raises(StoreError, match=r"another release .* build it again") as caught:
            open_store(path)
        assert one_line(caught.value, path)


class TestChecksums:
    def test_of_renderings_are_those_of_their_bytes(self, tmp_path: Path) -> None:
        """CRC-32s chained over the datasets in order of name."""
        with open_store(build(tmp_path / "s.h5", 40)) as store:
            columns = dict(store.stored())
        sums = columns.pop("views/checksum")
        for row in range(40):
            chained = 0
            for name in sorted(columns):
                chained = crc32(columns[name][row].tobytes(), chained)
            assert sums[row] == chained


class TestCommit:
    def test_whole_chunks_at_once_and_the_rest_on_flush(self, tmp_path: Path) -> None:
        path = tmp_path / "s.h5"
        with create_store(path, PLACES) as writer:
            writer.append_places(numbered_places(0, CHUNK + 5))
            assert (writer.committed, len(writer)) == (CHUNK, CHUNK + 5)
            with open_store(path) as store:
                before = store.places()
            writer.flush()
            writer.append_places(numbered_places(CHUNK + 5, 3 * CHUNK))
            assert writer.committed == 3 * CHUNK
            # What was committed when it was opened, and no more.
            assert len(before) == CHUNK
            assert_same(before.take(np.arange(CHUNK)), numbered_places(0, CHUNK))
            assert_holds(path, 3 * CHUNK)

    def test_a_torn_last_chunk_loses_no_committed_place(self, tmp_path: Path) -> None:
        """A kill in the middle of writing a chunk again leaves its old Fletcher-32."""
        path, live = tmp_path / "s.h5", tmp_path / "live.h5"
        with create_store(live, PLACES) as writer:
            writer.append_places(numbered_places(0, CHUNK + 200))
            writer.flush()
            shutil.copy(live, path)
        # A place that is not committed was written, the checksum after it was not.
        for name in ("rise", "easting", "checksum"):
            size = {"rise": BINS, "easting": 8, "checksum": 4}[name]
            flip(path, chunk_of(live, name, 1) + 200 * size)
        with h5py.File(live) as file:
            assert file["places/rise"][CHUNK:].shape == (200, BINS)
        assert_holds(path, CHUNK + 200)
        assert examine(path).whole
        with open_store(path) as store:
            assert len(np.unique(store.eyes().easting_m)) == CHUNK + 200
        with open_for_append(path, PLACES) as writer:
            writer.append_places(numbered_places(CHUNK + 200, 3000))
        assert_holds(path, 3000)
        assert examine(path).whole

    def test_a_full_disk_keeps_committed_places(self, tmp_path: Path) -> None:
        path = tmp_path / "s.h5"
        script = f"""
            import resource, sys
            sys.path.insert(0, {str(Path(__file__).parent)!r})
            from pathlib import Path
            from skyline.errors import StoreError
            from skyline_bench.stores.durability import numbered_places
            from skyline.store import create_store
            from test_place_store import PLACES
            path = Path({str(path)!r})
            soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
            try:
                with create_store(path, PLACES) as writer:
                    writer.append_places(numbered_places(0, 2048))
                    limit = path.stat().st_size + 3_000_000
                    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
                    try:
                        for start in range(2048, 20480, 512):
                            writer.append_places(numbered_places(start, start + 512))
                    finally:
                        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
            except StoreError as error:
                print(writer.committed, error)
        """
        command = [sys.executable, "-c", textwrap.dedent(script)]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
        assert "committed rows are safe" in result.stdout
        committed = int(result.stdout.split()[0])
        assert 2048 <= committed < 20480
        assert_holds(path, committed)
        with open_for_append(path, PLACES) as writer:
            writer.append_places(numbered_places(committed, committed + 50))
        assert_holds(path, committed + 50)


class TestDamage:
    @pytest.mark.parametrize("name", DATASETS)
    def test_a_flip_in_any_dataset_is_found(self, tmp_path: Path, name: str) -> None:
        path = build_places(tmp_path / "s.h5", (0, 2500))
        flip(path, chunk_of(path, name, 1) + 100)
        (damage,) = examine(path).damage
        assert (damage.first_row, damage.rows) == (CHUNK, CHUNK)
        with open_store(path) as store:
            mapped = store.places()
        with pytest.raises(StoreError, match="skyline store check") as caught:
            mapped.take(np.arange(2500))
        assert one_line(caught.value, path)
        assert_same(mapped.take(np.arange(CHUNK)), numbered_places(0, CHUNK))
        with pytest.raises(StoreError, match="repair` saves"):
            compact_store(path, tmp_path / "no.h5")
        report = repair_store(path, tmp_path / "saved.h5")
        assert (report.rows, report.holds) == (2500 - CHUNK, "places")
        kept = np.r_[0:CHUNK, 2 * CHUNK : 2500]
        with open_store(tmp_path / "saved.h5") as store:
            assert_same(store.places().take(np.arange(len(kept))), numbered_places(0, 2500)[kept])

    def test_cut_short_while_open(self, tmp_path: Path) -> None:
        path = build_places(tmp_path / "s.h5", (0, 3000))
        with open_store(path) as store:
            mapped = store.places()
        blocks = mapped.blocks()
        next(blocks)
        os.truncate(path, path.stat().st_size // 2)
        for read in (lambda: next(blocks), lambda: mapped.take(np.array([2999]))):
            with pytest.raises(StoreError, match="is truncated") as caught:
                read()
            assert one_line(caught.value, path)

    def test_replaced_while_open(self, tmp_path: Path) -> None:
        path = build_places(tmp_path / "s.h5", (0, 1500))
        with open_store(path) as store:
            mapped = store.places()
        build_places(tmp_path / "other.h5", (5, 10)).replace(path)
        assert_same(mapped.take(np.arange(1500)), numbered_places(0, 1500))

    @pytest.mark.parametrize(
        ("layout", "said"),
        [
            ({"dtype": "u1"}, "is of type uint8"),
            ({"shape": (3, 721), "maxshape": (None, 721), "chunks": (CHUNK, 721)}, "not rows of"),
            ({"compression": "gzip"}, "packed by a filter"),
            ({"shuffle": True}, "packed by a filter"),
            ({"chunks": (64, BINS)}, "has chunks of"),
            ({"chunks": (CHUNK, BINS // 2)}, "has chunks of"),
        ],
    )
    def test_a_layout_that_cannot_be_mapped(
        self, tmp_path: Path, layout: dict[str, object], said: str
    ) -> None:
        path = build_places(tmp_path / "s.h5", (0, 3))
        usual = {
            "shape": (3, BINS),
            "maxshape": (None, BINS),
            "chunks": (CHUNK, BINS),
            "dtype": "i1",
        }
        with edited(path) as file:
            del file["places/rise"]
            file.create_dataset("places/rise", **(usual | layout))
        with pytest.raises(StoreError, match=said) as caught:
            open_store(path)
        assert one_line(caught.value, path)

    def test_a_chunk_that_is_not_there(self, tmp_path: Path) -> None:
        path = build_places(tmp_path / "s.h5", (0, 3000))
        with edited(path) as file:
            values = file["places/phase"][:]
            del file["places/phase"]
            data = file.create_dataset(
                "places/phase",
                shape=values.shape,
                dtype="u1",
                maxshape=(None, values.shape[1]),
                chunks=(CHUNK, values.shape[1]),
            )
            data[:10], data[2500:] = values[:10], values[2500:]
        with open_store(path) as store, pytest.raises(StoreError, match="holds no row 1024"):
            store.places()


class TestMerge:
    def test_order_and_cut_change_no_byte(self, tmp_path: Path) -> None:
        a = build_places(tmp_path / "a.h5", (0, 700))
        b = build_places(tmp_path / "b.h5", (2000, 3000), (600, 2000))
        results = set()
        for number, stores in enumerate([(a, b), (b, a), (b, b, a)]):
            report = merge_stores(stores, tmp_path / f"{number}.h5")
            assert (report.rows, report.holds) == (3000, "places")
            assert report.duplicates == (100, 100, 2500)[number]
            results.add((tmp_path / f"{number}.h5").read_bytes())
        compact_store(build_places(tmp_path / "c.h5", (0, 3000)), tmp_path / "d.h5")
        assert results == {(tmp_path / "d.h5").read_bytes()}
        assert_holds(tmp_path / "d.h5", 3000)

    def test_empty(self, tmp_path: Path) -> None:
        a, b = build_places(tmp_path / "a.h5"), build_places(tmp_path / "b.h5")
        merge_stores([a, b], tmp_path / "c.h5")
        assert (check_store(tmp_path / "c.h5").committed, check_store(a).holds) == (0, "places")
