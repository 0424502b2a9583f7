"""What a store is made with, and what it is told apart by."""

import errno
import fcntl
import os
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from store_files import CHUNK, assert_holds, build, killed_copy
from store_rows import HEADER, rows

from skyline.errors import (
    InputError,
    MissingFileError,
    StoreError,
    StoreMismatchError,
)
from skyline.geodesy import Frame
from skyline.store import (
    check_store,
    create_store,
    is_store,
    merge_stores,
    open_for_append,
    open_store,
)


class TestMismatch:
    @pytest.mark.parametrize(
        ("change", "said"),
        [
            ({"frame_wkt": Frame.from_crs("EPSG:2056").wkt}, ("EPSG:32632", "EPSG:2056")),
            ({"frame_wkt": "nonsense"}, ("EPSG:32632", "nonsense")),
            ({"dem_digest": "b2" * 32}, ("a1" * 32, "b2" * 32)),
            ({"config": {**HEADER.config, "spacing_m": 250.0}}, ("spacing_m is 500.0", "250.0")),
            ({"config": {"planner": "uniform", "spacing_m": 500.0}}, ("bounds", "'absent' here")),
            ({"width": 640}, ("width is 24 there", "640 here")),
            ({"max_keypoints": 9}, ("max_keypoints is 6 there", "9 here")),
        ],
    )
    def test_both_values_are_named(
        self, tmp_path: Path, change: dict[str, object], said: tuple[str, str]
    ) -> None:
        path = build(tmp_path / "s.h5", 3)
        before = path.read_bytes()
        with pytest.raises(StoreMismatchError) as caught:
            open_for_append(path, replace(HEADER, **change))
        assert all(value in str(caught.value) for value in said)
        assert "\n" not in str(caught.value)
        assert path.read_bytes() == before
        assert [file.name for file in tmp_path.iterdir()] == ["s.h5"]

    def test_where_the_dem_lies_now_may_differ(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", 3)
        moved = replace(HEADER, dem_files=("/elsewhere.tif",), renderer="another")
        with open_for_append(path, moved) as writer:
            assert writer.header == HEADER

    def test_tuples_in_the_config_are_lists(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", 3)
        tuples = replace(HEADER, config={**HEADER.config, "bounds": (1, 2, 3, 4)})
        open_for_append(path, tuples).close()


class TestHeader:
    @pytest.mark.parametrize("config", [{"a": object()}, {"a": float("nan")}, {"a": {1, 2}}])
    def test_config_that_json_does_not_hold(self, config: dict[str, object]) -> None:
        with pytest.raises(InputError, match="JSON"):
            replace(HEADER, config=config)

    def test_the_digest_of_a_header_is_for_ever(self) -> None:
        """It is written into stores; one that changes makes all that exist look damaged."""
        header = replace(HEADER, frame_wkt="a frame", package_version="0.1")
        assert header.digest == "4ef0b9bab547bc168ecb4b832590e8bf333bb9488db125e3b93124acd228eb9b"

    @pytest.mark.parametrize("change", [{"width": 1}, {"max_keypoints": 1}])
    def test_sizes_out_of_range(self, change: dict[str, int]) -> None:
        with pytest.raises(InputError, match="is 1"):
            replace(HEADER, **change)


class TestCreate:
    def test_refuses_what_exists(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", 3)
        with pytest.raises(StoreError, match="exists already; resume it"):
            create_store(path, HEADER)
        with open_store(path) as store:
            assert_holds(store, 3)
        with pytest.raises(StoreError, match="exists already"):
            create_store(tmp_path, HEADER, overwrite=True)

    def test_overwrites_when_told(self, tmp_path: Path) -> None:
        path = tmp_path / "s.h5"
        path.write_text("something else")
        create_store(path, HEADER, overwrite=True).close()
        with open_store(path) as store:
            assert len(store) == 0

    def test_missing_folder(self, tmp_path: Path) -> None:
        with pytest.raises(MissingFileError, match=r"folder .* does not exist"):
            create_store(tmp_path / "no" / "s.h5", HEADER)

    def test_failure_leaves_nothing(self, tmp_path: Path) -> None:
        with pytest.raises(StoreError, match="cannot be created"):
            create_store(tmp_path / "s.h5", replace(HEADER, renderer="a\0b"))
        assert list(tmp_path.iterdir()) == []

    def test_leftovers_of_a_killed_creation_are_replaced(self, tmp_path: Path) -> None:
        (tmp_path / "s.h5.partial").write_bytes(b"half")
        (tmp_path / "s.h5.lock").write_text("process 1 on mars")
        build(tmp_path / "s.h5", 2)
        assert [file.name for file in tmp_path.iterdir()] == ["s.h5"]

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
    def test_read_only_folder(self, tmp_path: Path) -> None:
        tmp_path.chmod(0o500)
        with pytest.raises(StoreError, match="Permission denied"):
            create_store(tmp_path / "s.h5", HEADER)

    def test_second_writer(self, tmp_path: Path) -> None:
        path = tmp_path / "s.h5"
        with create_store(path, HEADER) as writer:
            for attempt in (
                lambda: open_for_append(path, HEADER),
                lambda: create_store(path, HEADER, overwrite=True),
            ):
                with pytest.raises(StoreError, match=f"being written by process {os.getpid()} on"):
                    attempt()
            writer.append(*rows(0, 3))
        with open_for_append(path, HEADER) as writer:
            assert writer.committed == 3

    @pytest.mark.parametrize("name", ["ENOLCK", "EOPNOTSUPP", "ENOSYS", "EINVAL", "EIO", "EACCES"])
    def test_a_folder_without_file_locks(
        self,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        caplog: pytest.LogCaptureFixture,
        name: str,
    ) -> None:
        def refuse(*_: object) -> None:
            raise OSError(getattr(errno, name), os.strerror(getattr(errno, name)))

        monkeypatch.setattr("fcntl.flock", refuse)
        path = killed_copy(tmp_path / "s.h5", CHUNK)
        with open_for_append(path, HEADER) as writer:
            writer.append(*rows(CHUNK, CHUNK + 3))
        with open_store(path) as store:
            assert_holds(store, CHUNK + 3)
        assert merge_stores([path], tmp_path / "merged.h5").rows == CHUNK + 3
        assert check_store(path).whole
        warnings = [said for said in caplog.messages if "file locks" in said]
        reason = os.strerror(getattr(errno, name))
        assert warnings == [
            f"folder {tmp_path} has no file locks ({reason}): nothing keeps two processes from "
            "writing one store there at the same time; see to it that only one does"
        ]
        assert not list(tmp_path.glob("*.lock"))

    def test_hdf5_asks_for_no_locks(self, tmp_path: Path) -> None:
        """Its own would fail here, and in folders that have none."""
        path = build(tmp_path / "s.h5", 3)
        with path.open("rb") as held:
            fcntl.flock(held, fcntl.LOCK_EX)
            with open_for_append(path, HEADER) as writer:
                writer.append(*rows(3, 5))
            with open_store(path) as store:
                assert_holds(store, 5)
            assert check_store(path).whole

    @pytest.mark.parametrize("call", ["os.ftruncate", "os.write"])
    def test_a_lock_that_cannot_be_written_is_not_left(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
    ) -> None:
        def refuse(*_: object) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patch:
            patch.setattr(call, refuse)
            with pytest.raises(StoreError, match="No space left on device"):
                create_store(tmp_path / "s.h5", HEADER)
        assert list(tmp_path.iterdir()) == []

    def test_a_writer_lets_go_of_all_its_files(self, tmp_path: Path) -> None:
        path, open_files = build(tmp_path / "s.h5", 3), Path("/proc/self/fd")
        held = sorted(file.name for file in open_files.iterdir())
        open_for_append(path, HEADER).close()
        assert sorted(file.name for file in open_files.iterdir()) == held

    def test_through_a_symbolic_link(self, tmp_path: Path) -> None:
        path = killed_copy(tmp_path / "s.h5", CHUNK)
        link = tmp_path / "link.h5"
        link.symlink_to(path)
        with open_for_append(link, HEADER) as writer:
            writer.append(*rows(CHUNK, 40))
        assert link.is_symlink()
        with open_store(path) as store:
            assert_holds(store, 40)


class TestIsStore:
    def test_stores_and_other_files(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", 3)
        assert is_store(path)
        assert is_store(killed_copy(tmp_path / "killed", 3))
        with h5py.File(tmp_path / "dem", "w") as file:
            file["heights"] = np.zeros((3, 3))
        assert not is_store(tmp_path / "dem")
        assert not is_store(tmp_path / "absent.h5")
        path.write_bytes(path.read_bytes()[:1000])
        assert is_store(path), "so that its damage is what the user hears of"
