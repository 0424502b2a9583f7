"""What can befall a file, and what is said of it."""

import os
from pathlib import Path

import h5py
import numpy as np
import pytest
from store_files import CHUNK, assert_holds, build, edited, killed_copy, one_line
from store_rows import HEADER, WIDTH

from skyline.errors import (
    MissingFileError,
    SkylineError,
    StoreError,
)
from skyline.store import (
    open_for_append,
    open_store,
)
from skyline.store.superblock import Superblock, WholeFile, lookup3
from skyline_bench.measuring.workers import outcome_of


class TestDamage:
    def test_truncated_anywhere(self, tmp_path: Path) -> None:
        whole = build(tmp_path / "whole.h5", 70).read_bytes()
        path = tmp_path / "s.h5"
        for size in [*range(0, 64), *range(64, len(whole), 211), len(whole) - 1]:
            path.write_bytes(whole[:size])
            with pytest.raises(StoreError) as caught:
                open_store(path)
            assert one_line(caught.value, path), size

    def test_truncated_after_a_kill(self, tmp_path: Path) -> None:
        """The end is not known then: an error, or all the committed rows."""
        whole = killed_copy(tmp_path / "whole.h5", 3 * CHUNK).read_bytes()
        path, read, refused = tmp_path / "s.h5", 0, []
        for size in [*range(0, len(whole), len(whole) // 16), len(whole) - 1, len(whole)]:
            path.write_bytes(whole[:size])
            try:
                with open_store(path) as store:
                    assert_holds(store, 3 * CHUNK)
                read += 1
            except StoreError as error:
                refused.append(error)
        assert read >= 1
        assert len(refused) >= 12
        assert all(one_line(error, path) for error in refused)

    def test_flipped_bits_never_crash(self, tmp_path: Path) -> None:
        whole = np.frombuffer(build(tmp_path / "whole.h5", 70).read_bytes(), dtype=np.uint8)
        path, generator, refused = tmp_path / "s.h5", np.random.default_rng(5), []
        for position in [*range(0, 48, 3), *generator.integers(0, len(whole), 60)]:
            damaged = whole.copy()
            damaged[position] ^= 1 << generator.integers(8)
            path.write_bytes(damaged.tobytes())
            try:
                with open_store(path) as store:
                    store.views()
                    store.keypoint_columns()
            except SkylineError as error:
                refused.append(error)
        assert len(refused) >= 16, "the superblock at least is protected by a checksum"
        assert all(one_line(error, path) for error in refused)

    def test_missing_and_foreign_files(self, tmp_path: Path) -> None:
        path = tmp_path / "s.h5"
        for open_it in (open_store, lambda path: open_for_append(path, HEADER)):
            with pytest.raises(MissingFileError, match="does not exist"):
                open_it(path)
        assert list(tmp_path.iterdir()) == []
        path.write_text("easting,northing\n")
        with pytest.raises(StoreError, match="not an HDF5 file"):
            open_store(path)
        with pytest.raises(StoreError, match="cannot be read: Is a directory"):
            open_store(tmp_path)

    @pytest.mark.parametrize("libver", ["earliest", "v110"])
    def test_another_programs_hdf5(self, tmp_path: Path, libver: str) -> None:
        path = tmp_path / "s.h5"
        with h5py.File(path, "w", libver=(libver, "v110")) as file:
            file["data"] = np.arange(10)
        with pytest.raises(StoreError, match="not a skyline store"):
            open_store(path)

    @pytest.mark.parametrize(
        ("name", "value", "said"),
        [
            ("schema", "other", "not a skyline store"),
            ("schema_version", 4, "schema version 4; .* upgrade skyline"),
            ("schema_version", "one", "schema version 'one'"),
            ("schema_version", 2, "schema version .*2.*; build it again"),
            ("config", "{", "cannot be opened"),
            ("config", "[1]", "not a JSON object"),
            ("config", "[" * 100_000, "cannot be opened"),
            ("dem_files", "[1]", "not a JSON list"),
            ("frame", 7, "not text"),
            ("frame", ["a", "b"], "no single attribute"),
            ("rows", '{"rows": "delta"}', "'delta'.*, which skyline does not read"),
            ("rows", '{"rows": "compact"}', "'compact'.*, which skyline does not read"),
        ],
    )
    def test_bad_attributes(self, tmp_path: Path, name: str, value: object, said: str) -> None:
        path = build(tmp_path / "s.h5", 3)
        with edited(path) as file:
            file.attrs[name] = value
        self.assert_refused(path, said)

    def test_a_heap_of_texts_that_has_no_end(self, tmp_path: Path) -> None:
        """HDF5 walks one of zeros for ever, and guards none with a checksum."""
        path = build(tmp_path / "s.h5", 3)
        data = bytearray(path.read_bytes())
        first = data.index(b"GCOL") + 16
        data[first : first + 64] = bytes(64)
        path.write_bytes(data)

        def opened() -> str:
            with pytest.raises(StoreError) as caught:
                open_store(path)
            return str(caught.value)

        assert "heap of texts" in outcome_of(opened, patience_s=30)

    @pytest.mark.parametrize("name", ["frame", "config", "dem_digest", "renderer"])
    def test_missing_attributes(self, tmp_path: Path, name: str) -> None:
        path = build(tmp_path / "s.h5", 3)
        with edited(path) as file:
            del file.attrs[name]
        self.assert_refused(path, f"'{name}'")

    @pytest.mark.parametrize(
        "name",
        ["views", "features", "committed", "views/depth_m", "views/easting", "views/elevation_tan"],
    )
    def test_missing_datasets(self, tmp_path: Path, name: str) -> None:
        path = build(tmp_path / "s.h5", 3)
        with edited(path) as file:
            del file[name]
        self.assert_refused(path, f"lacks {name}")

    @pytest.mark.parametrize("committed", [4, 2**63])
    def test_more_committed_than_there_are_rows(self, tmp_path: Path, committed: int) -> None:
        path = build(tmp_path / "s.h5", 3)
        with edited(path) as file:
            file["committed"][()] = committed
        self.assert_refused(path, f"says {committed} rows are committed and holds 3")

    @pytest.mark.parametrize(
        ("built", "said"),
        [
            ([3, 2], "3 of 2 parts of it are built"),
            ([1, 2, 3], "`built` is not two unsigned numbers"),
            ([-1, 2], "`built` is not two unsigned numbers"),
        ],
    )
    def test_more_built_than_there_is_to_build(
        self, tmp_path: Path, built: list[int], said: str
    ) -> None:
        path = build(tmp_path / "s.h5", 3)
        with edited(path) as file:
            del file["built"]
            file["built"] = np.array(built, dtype="u8" if min(built) >= 0 else "i8")
        self.assert_refused(path, said)

    def test_rows_that_are_promised_but_not_there(self, tmp_path: Path) -> None:
        """A small file that claims a trillion rows must not be taken at its word."""
        path = build(tmp_path / "s.h5", 3)
        with edited(path) as file:
            for data in (*file["views"].values(), *file["features"].values()):
                data.resize(10**12, axis=0)
            file["committed"][()] = 10**12
        self.assert_refused(path, "says 1000000000000 rows are committed")
        with edited(path) as file:
            file["committed"][()] = 2000
        self.assert_refused(path, "holds no row 1999, which is committed")

    @pytest.mark.parametrize(
        ("name", "layout", "said"),
        [
            ("views/depth_m", {"dtype": "f8", "shape": (3, WIDTH)}, "is of type float64"),
            ("views/flags", {"dtype": "u1", "shape": (3, WIDTH + 1)}, "is not rows of shape"),
            ("views/elevation_tan", {"dtype": "f4", "shape": (3,)}, "is not a table"),
            ("views/elevation_tan", {"dtype": "f4", "shape": (3, 50_000)}, "width is 50000"),
            ("views/easting", {"dtype": "f8", "shape": ()}, "is not rows of shape"),
            ("views/easting", {"dtype": "f8", "shape": (3,)}, "is not chunked"),
            ("views/easting", {"dtype": h5py.string_dtype(), "shape": (3,)}, "is of type object"),
            ("committed", {"dtype": "u8", "shape": (2,)}, "not one unsigned number"),
            ("committed", {"dtype": h5py.ref_dtype, "shape": ()}, "not one unsigned number"),
            (
                "views/heading",
                {"dtype": "u1", "shape": (3,), "chunks": (2**27,), "maxshape": (None,)},
                "too large",
            ),
            (
                "views/depth_m",
                {"dtype": "f4", "shape": (3, WIDTH), "compression": "lzf"},
                "by a filter",
            ),
        ],
    )
    def test_wrong_layout(
        self, tmp_path: Path, name: str, layout: dict[str, object], said: str
    ) -> None:
        path = build(tmp_path / "s.h5", 3)
        with edited(path) as file:
            del file[name]
            file.create_dataset(name, **layout)
        self.assert_refused(path, said)

    @pytest.mark.parametrize("name", ["views", "views/depth_m", "committed"])
    @pytest.mark.parametrize("external", [False, True])
    def test_links_are_not_followed(self, tmp_path: Path, name: str, external: bool) -> None:
        path, other = build(tmp_path / "s.h5", 3), build(tmp_path / "other.h5", 3)
        with edited(path) as file:
            file.move(name, "moved")
            file[name] = h5py.ExternalLink(other, name) if external else h5py.SoftLink("/moved")
        self.assert_refused(path, f"{name}.* is a link to elsewhere")

    @pytest.mark.parametrize("name", ["views/easting", "committed"])
    @pytest.mark.parametrize("virtual", [False, True])
    def test_data_of_other_files_is_not_read(
        self, tmp_path: Path, name: str, virtual: bool
    ) -> None:
        path, other = build(tmp_path / "s.h5", 3), build(tmp_path / "other.h5", 3)
        with edited(path) as file:
            shape, kind = file[name].shape, file[name].dtype
            del file[name]
            if virtual:
                layout = h5py.VirtualLayout(shape=shape, dtype=kind)
                layout[...] = h5py.VirtualSource(other, name, shape=shape)
                file.create_virtual_dataset(name, layout)
            else:
                (tmp_path / "raw.bin").write_bytes(b"\1" * 64)
                created = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
                created.set_external(os.fsencode(tmp_path / "raw.bin"), 0, 64)
                space = h5py.h5s.create_simple(shape) if shape else h5py.h5s.create(h5py.h5s.SCALAR)
                of_type = h5py.h5t.py_create(kind)
                h5py.h5d.create(file.id, name.encode(), of_type, space, created)
        self.assert_refused(path, "not chunked|not one unsigned number")

    def test_values_no_skyline_wrote(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", 3)
        with edited(path) as file:
            file["views/heading"][1] = 200
            file["features/keypoint_column"][1, 1] = WIDTH
        with open_store(path) as store:
            for read in (store.views, store.locations):
                with pytest.raises(StoreError, match="heading 200"):
                    read()
            with pytest.raises(StoreError, match="columns beyond 23"):
                store.keypoint_columns()

    @staticmethod
    def assert_refused(path: Path, said: str) -> None:
        before = path.read_bytes()
        for open_it in (open_store, lambda path: open_for_append(path, HEADER)):
            with pytest.raises(StoreError, match=said) as caught:
                open_it(path)
            assert one_line(caught.value, path)
        assert path.read_bytes() == before
        assert not path.with_name(f"{path.name}.lock").exists()


class TestSuperblock:
    def test_checksum_is_hdf5s(self, tmp_path: Path) -> None:
        head = build(tmp_path / "s.h5", 3).read_bytes()[:48]
        assert lookup3(head[:44]).to_bytes(4, "little") == head[44:]
        assert Superblock.parse(tmp_path, head).pack() == head

    def test_mark_is_taken_off_for_the_reader_alone(self, tmp_path: Path) -> None:
        path = killed_copy(tmp_path / "s.h5", CHUNK)
        before = path.read_bytes()
        with WholeFile(path) as file:
            assert file.superblock.in_use
            assert not file.refresh() or file.superblock.in_use
            seen = bytearray(48)
            file.readinto(seen)
            presented = Superblock.parse(path, bytes(seen))
            assert (presented.in_use, presented.end) == (False, len(before))
            piece = bytearray(10)
            file.seek(8)
            file.readinto(piece)
            assert piece == seen[8:18]
        assert path.read_bytes() == before
