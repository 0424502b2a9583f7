"""The reference store against a plain list of rows, and against what can befall a file."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from store_rows import HEADER, WIDTH, rows

from skyline.errors import (
    InputError,
    MissingFileError,
    SkylineError,
    StoreError,
    StoreMismatchError,
)
from skyline.features import NO_KEYPOINT
from skyline.geodesy import Frame
from skyline.store import (
    Store,
    create_store,
    is_store,
    open_for_append,
    open_store,
)
from skyline.store.superblock import Superblock, WholeFile, lookup3
from skyline.views import ROW_FIELDS, Shells, Views

CHUNK = 32


def assert_holds(store: Store, count: int, index: object = slice(None)) -> None:
    """The store holds exactly rows 0 to ``count``."""
    views, keypoints = rows(0, count)
    wanted = np.atleast_1d(np.arange(count)[index])
    got = store.views(index)
    for name in ROW_FIELDS:
        expected = getattr(views, name)[wanted]
        actual = getattr(got, name)
        np.testing.assert_array_equal(actual, expected, err_msg=name)
        assert actual.dtype == expected.dtype, name
    np.testing.assert_array_equal(store.keypoint_columns(index), keypoints[wanted])


def build(path: Path, count: int) -> Path:
    with create_store(path, HEADER) as writer:
        writer.append(*rows(0, count))
    return path


def killed_copy(path: Path, count: int, committed_at_least: int = 0) -> Path:
    """A store as a killed writer leaves it: the bytes of one whose writer is at work."""
    live = path.with_name("live.h5")
    with create_store(live, HEADER) as writer:
        writer.append(*rows(0, count))
        assert writer.committed >= committed_at_least
        shutil.copy(live, path)
    return path


@contextmanager
def edited(path: Path) -> Iterator[h5py.File]:
    """A closed store, changed behind skyline's back."""
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        yield file


class TestRoundTrip:
    @pytest.mark.parametrize("count", [0, 1, CHUNK - 1, CHUNK, CHUNK + 1, 5 * CHUNK + 3])
    def test_rows_come_back_unchanged(self, tmp_path: Path, count: int) -> None:
        with open_store(build(tmp_path / "s.h5", count)) as store:
            assert len(store) == store.committed == count
            assert_holds(store, count)

    def test_header_comes_back(self, tmp_path: Path) -> None:
        with open_store(build(tmp_path / "s.h5", 1)) as store:
            assert store.header == HEADER
            assert store.header.package_version
            assert store.path == tmp_path / "s.h5"

    def test_contract_with_other_programs(self, tmp_path: Path) -> None:
        """Names, types and attributes of DESIGN 8, seen by plain h5py."""
        build(tmp_path / "s.h5", 40)
        with h5py.File(tmp_path / "s.h5", "r") as file:
            assert file.attrs["schema"] == "skyline-store"
            assert file.attrs["schema_version"] == 2
            assert file.attrs["frame"] == HEADER.frame_wkt
            assert file.attrs["dem_digest"] == HEADER.dem_digest
            assert json.loads(file.attrs["config"]) == HEADER.config
            assert file.attrs["renderer"] == HEADER.renderer
            assert isinstance(file.attrs["package_version"], str)
            assert file["committed"][()] == 40
            kinds = {name: data.dtype.str for name, data in file["views"].items()}
            assert kinds == {
                "easting": "<f8",
                "northing": "<f8",
                "eye_elevation_m": "<f8",
                "heading": "|u1",
                "elevation_tan": "<f4",
                "depth_m": "<f4",
                "flags": "|u1",
                "checksum": "<u4",
            }
            assert file["features/keypoint_column"].dtype == "<u2"
            for data in (*file["views"].values(), *file["features"].values()):
                assert data.chunks
                assert data.maxshape[0] is None
                assert len(data) == 40

    @pytest.mark.parametrize(
        "index",
        [
            0,
            -1,
            slice(3, 9),
            slice(None, None, -7),
            slice(80, 20),
            np.array([90, 2, 2, 41, 3]),
            np.arange(100) % 9 == 4,
            np.array([], dtype=int),
        ],
    )
    def test_any_numpy_index(self, tmp_path: Path, index: object) -> None:
        with open_store(build(tmp_path / "s.h5", 100)) as store:
            assert_holds(store, 100, index)

    def test_rows_beyond_the_committed_ones(self, tmp_path: Path) -> None:
        with open_store(build(tmp_path / "s.h5", 10)) as store:
            for index in (10, -11, np.array([3, 10])):
                with pytest.raises(InputError, match="10 committed rows"):
                    store.views(index)

    @pytest.mark.parametrize("chunk_rows", [1, 7, 100, 1000])
    def test_iteration(self, tmp_path: Path, chunk_rows: int) -> None:
        with open_store(build(tmp_path / "s.h5", 100)) as store:
            parts = list(store.iter_views(chunk_rows))
            assert {len(part) for part in parts[:-1]} <= {chunk_rows}
            np.testing.assert_array_equal(Views.concatenate(parts).depth_m, rows(0, 100)[0].depth_m)
            with pytest.raises(InputError, match="chunk_rows is 0"):
                next(store.iter_views(0))

    def test_locations(self, tmp_path: Path) -> None:
        with open_store(build(tmp_path / "s.h5", 50)) as store:
            locations, views = store.locations(), rows(0, 50)[0]
            assert len(locations) == 50
            for name in ("easting_m", "northing_m", "eye_elevation_m", "heading"):
                np.testing.assert_array_equal(getattr(locations, name), getattr(views, name))

    def test_float64_skylines_are_stored_as_float32(self, tmp_path: Path) -> None:
        views, keypoints = rows(0, 3)
        wide = replace(views, elevation_tan=views.elevation_tan.astype(np.float64))
        with create_store(tmp_path / "s.h5", HEADER) as writer:
            writer.append(wide, keypoints)
        with open_store(tmp_path / "s.h5") as store:
            assert_holds(store, 3)

    def test_appended_arrays_may_be_reused(self, tmp_path: Path) -> None:
        views, keypoints = rows(0, 3)
        with create_store(tmp_path / "s.h5", HEADER) as writer:
            writer.append(views, keypoints)
            views.depth_m[:] = -1.0
            keypoints[:] = 0
        with open_store(tmp_path / "s.h5") as store:
            assert_holds(store, 3)

    def test_smooth_skylines_are_packed(self, tmp_path: Path) -> None:
        """Less than two thirds of the plain bytes at the default width."""
        header = replace(HEADER, width=640, max_keypoints=128)
        u = np.linspace(-1.0, 1.0, 640)
        phase = np.arange(256)[:, np.newaxis] / 40.0
        skyline = (0.2 * np.sin(3.0 * u + phase) + 0.02 * np.sin(40.0 * u)).astype(np.float32)
        one = np.zeros(256)
        views = Views(
            one,
            one,
            one,
            one.astype(np.uint8),
            skyline,
            1e4 * (1.0 + skyline),
            np.zeros(skyline.shape, dtype=np.uint8),
        )
        keypoints = np.full((256, 128), NO_KEYPOINT, dtype=np.uint16)
        with create_store(tmp_path / "s.h5", header) as writer:
            writer.append(views, keypoints)
        plain = 25 + 640 * 9 + 256
        assert (tmp_path / "s.h5").stat().st_size / 256 < plain * 2 / 3

    def test_closed_store_and_writer_say_so(self, tmp_path: Path) -> None:
        writer = create_store(tmp_path / "s.h5", HEADER)
        writer.close()
        writer.close()
        with pytest.raises(StoreError, match="closed"):
            writer.append(*rows(0, 1))
        store = open_store(tmp_path / "s.h5")
        store.close()
        store.close()
        with pytest.raises(StoreError, match="closed"):
            store.views()


class TestCommit:
    def test_whole_chunks_at_once_and_the_rest_on_flush(self, tmp_path: Path) -> None:
        with create_store(tmp_path / "s.h5", HEADER) as writer:
            writer.append(*rows(0, CHUNK + 5))
            assert (writer.committed, len(writer)) == (CHUNK, CHUNK + 5)
            writer.flush()
            assert writer.committed == CHUNK + 5
            writer.append(*rows(CHUNK + 5, CHUNK + 6))
        with open_store(tmp_path / "s.h5") as store:
            assert_holds(store, CHUNK + 6)

    def test_an_exception_loses_nothing(self, tmp_path: Path) -> None:
        def interrupted() -> None:
            with create_store(tmp_path / "s.h5", HEADER) as writer:
                writer.append(*rows(0, 5))
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            interrupted()
        with open_store(tmp_path / "s.h5") as store:
            assert_holds(store, 5)
        assert [file.name for file in tmp_path.iterdir()] == ["s.h5"]

    def test_readers_beside_a_writer_keep_their_rows(self, tmp_path: Path) -> None:
        path = tmp_path / "s.h5"
        with create_store(path, HEADER) as writer:
            writer.append(*rows(0, 2 * CHUNK + 7))
            with open_store(path) as first:
                writer.flush()
                with open_store(path) as second:
                    writer.append(*rows(2 * CHUNK + 7, 10 * CHUNK))
                    assert first.in_use
                    assert_holds(first, 2 * CHUNK)
                    assert_holds(second, 2 * CHUNK + 7)
        with open_store(path) as store, open_for_append(path, HEADER) as writer:
            writer.append(*rows(10 * CHUNK, 20 * CHUNK))
            assert_holds(store, 10 * CHUNK)

    def test_uncommitted_rows_are_neither_read_nor_kept(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", 40)
        with edited(path) as file:
            for data in (*file["views"].values(), *file["features"].values()):
                data.resize(100, axis=0)
                data[40:] = 1
        with open_store(path) as store:
            assert_holds(store, 40)
        with open_for_append(path, HEADER) as writer:
            writer.append(*rows(40, 70))
        with open_store(path) as store:
            assert_holds(store, 70)

    def test_killed_writer(self, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
        path = killed_copy(tmp_path / "s.h5", 3 * CHUNK + 9)
        path.chmod(0o640)
        with open_store(path) as store:
            assert store.in_use
            assert_holds(store, 3 * CHUNK)
        with open_for_append(path, HEADER) as writer:
            assert writer.committed == 3 * CHUNK
            writer.append(*rows(3 * CHUNK, 140))
        assert "writer was killed; keeping 96 rows" in caplog.text
        assert path.stat().st_mode & 0o777 == 0o640
        with open_store(path) as store:
            assert not store.in_use
            assert_holds(store, 140)

    @pytest.mark.parametrize(
        ("change", "said"),
        [
            (lambda v, k: (replace(v, flags=v.flags[:, 1:]), k), r"views/flags .*\(3, 23\)"),
            (lambda v, k: (replace(v, easting_m=v.easting_m[1:]), k), "views/easting"),
            (lambda v, k: (v, k[:, :4]), r"keypoint_column .*\(3, 4\)"),
            (lambda v, k: (v, k[:2]), "keypoint_column"),
            (lambda v, k: (v, np.full_like(k, WIDTH)), "outside 0 to 23"),
            (lambda v, k: (replace(v, heading=v.heading + np.uint8(4)), k), "heading"),
        ],
    )
    def test_rows_that_do_not_fit(
        self, tmp_path: Path, change: Callable[..., tuple[Views, np.ndarray]], said: str
    ) -> None:
        with create_store(tmp_path / "s.h5", HEADER) as writer:
            writer.append(*rows(0, 2))
            with pytest.raises(InputError, match=said):
                writer.append(*change(*rows(2, 5)))
            assert len(writer) == 2

    def test_failed_write_keeps_committed_rows(self, tmp_path: Path) -> None:
        """A limit on the file's size stands in for a full disk; the process must not crash."""
        path = tmp_path / "s.h5"
        script = f"""
            import resource, sys
            sys.path.insert(0, {str(Path(__file__).parent)!r})
            from pathlib import Path
            from skyline.errors import StoreError
            from skyline.store import create_store
            from store_rows import HEADER, rows
            path = Path({str(path)!r})
            soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
            try:
                with create_store(path, HEADER) as writer:
                    writer.append(*rows(0, 64))
                    limit = path.stat().st_size + 3000
                    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
                    try:
                        for start in range(64, 4000, 32):
                            writer.append(*rows(start, start + 32))
                    finally:
                        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
            except StoreError as error:
                print(writer.committed, error)
        """
        result = run(script)
        assert result.returncode == 0, result.stderr
        committed = int(result.stdout.split()[0])
        assert "File too large" in result.stdout
        assert "committed rows are safe" in result.stdout
        assert 64 <= committed < 4000
        with open_store(path) as store:
            assert_holds(store, committed)
        with open_for_append(path, HEADER) as writer:
            writer.append(*rows(committed, committed + 50))
        with open_store(path) as store:
            assert_holds(store, committed + 50)


def run(script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, check=False
    )


class TestKill:
    WRITER = """
        import os, signal, sys
        sys.path.insert(0, {tests!r})
        from skyline.store import open_for_append
        from store_rows import HEADER, rows
        syncs, real_sync = 0, os.fsync
        def fatal_sync(descriptor):
            global syncs
            syncs += 1
            if syncs == {last}:
                os.kill(os.getpid(), signal.SIGKILL)
            real_sync(descriptor)
        with open_for_append({path!r}, HEADER) as writer:
            os.fsync = fatal_sync
            while len(writer) < 400:
                print(writer.committed, flush=True)
                writer.append(*rows(len(writer), len(writer) + 21))
    """

    def test_between_rows_and_their_commitment(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", 40)
        result = run(self.script(path, last=3))
        assert result.returncode == -signal.SIGKILL
        self.check_resumes(path, int(result.stdout.split()[-1]))

    @pytest.mark.parametrize("after", [1, 5, 12])
    def test_at_any_time(self, tmp_path: Path, after: int) -> None:
        path = build(tmp_path / "s.h5", 40)
        command = [sys.executable, "-c", self.script(path, last=-1)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
            assert writer.stdout
            for _ in range(after):
                said = writer.stdout.readline()
            writer.kill()
        self.check_resumes(path, int(said))

    def script(self, path: Path, last: int) -> str:
        tests = str(Path(__file__).parent)
        return textwrap.dedent(self.WRITER).format(tests=tests, path=str(path), last=last)

    @staticmethod
    def check_resumes(path: Path, said: int) -> None:
        with open_store(path) as store:
            committed = len(store)
            assert said <= committed
            assert_holds(store, committed)
        with open_for_append(path, HEADER) as writer:
            assert writer.committed == committed
            writer.append(*rows(committed, 500))
        with open_store(path) as store:
            assert_holds(store, 500)
        assert [file.name for file in path.parent.iterdir()] == [path.name]


@settings(max_examples=12, stateful_step_count=10, deadline=None)
class StoreMachine(RuleBasedStateMachine):
    """A store is a list of rows, whatever order it is written, closed, killed and read in."""

    @initialize()
    def create(self) -> None:
        self.folder = Path(tempfile.mkdtemp())
        self.path = self.folder / "s.h5"
        self.writer = create_store(self.path, HEADER)
        self.appended = 0

    @rule(count=st.integers(0, 90))
    def append(self, count: int) -> None:
        self.writer.append(*rows(self.appended, self.appended + count))
        self.appended += count

    @rule()
    def flush(self) -> None:
        self.writer.flush()
        assert self.writer.committed == self.appended

    @rule()
    def close_and_resume(self) -> None:
        self.writer.close()
        self.writer = open_for_append(self.path, HEADER)
        assert self.writer.committed == self.appended

    @rule()
    def kill_and_resume(self) -> None:
        killed = self.folder / "killed.h5"
        shutil.copy(self.path, killed)
        committed = self.writer.committed
        self.writer.close()
        killed.replace(self.path)
        self.writer = open_for_append(self.path, HEADER)
        assert self.writer.committed == committed
        self.appended = committed

    @rule(data=st.data())
    def read_some(self, data: st.DataObject) -> None:
        with open_store(self.path) as store:
            if len(store):
                index = data.draw(st.lists(st.integers(-len(store), len(store) - 1), max_size=5))
                assert_holds(store, len(store), np.array(index, dtype=int))

    @invariant()
    def committed_rows_are_the_model(self) -> None:
        assert len(self.writer) == self.appended
        with open_store(self.path) as store:
            assert len(store) == self.writer.committed
            assert self.appended - len(store) < CHUNK
            assert_holds(store, len(store))

    def teardown(self) -> None:
        if hasattr(self, "writer"):
            self.writer.close()
            shutil.rmtree(self.folder)


TestStoreMachine = StoreMachine.TestCase


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

    def test_through_a_symbolic_link(self, tmp_path: Path) -> None:
        path = killed_copy(tmp_path / "s.h5", CHUNK)
        link = tmp_path / "link.h5"
        link.symlink_to(path)
        with open_for_append(link, HEADER) as writer:
            writer.append(*rows(CHUNK, 40))
        assert link.is_symlink()
        with open_store(path) as store:
            assert_holds(store, 40)


def one_line(error: BaseException, path: Path) -> bool:
    return "\n" not in str(error) and str(path) in str(error)


class TestShells:
    EDGES = (0.0, 100.0, 1000.0, 5000.0)

    @staticmethod
    def shelled(start: int, stop: int) -> tuple[Views, np.ndarray]:
        views, keypoints = rows(start, stop)
        steps = np.arange(3, dtype=np.float32)[:, np.newaxis]
        tan = views.elevation_tan[:, np.newaxis] - steps
        tan[:, 1, ::3] = np.nan
        shells = Shells(np.array(TestShells.EDGES), tan, tan + np.float32(7.0))
        return replace(views, shells=shells), keypoints

    def test_come_back_unchanged(self, tmp_path: Path) -> None:
        header = replace(HEADER, shell_edges_m=self.EDGES)
        with create_store(tmp_path / "s.h5", header) as writer:
            writer.append(*self.shelled(0, 40))
        with open_for_append(tmp_path / "s.h5", header) as writer:
            writer.append(*self.shelled(40, 75))
        with open_store(tmp_path / "s.h5") as store:
            assert store.header.shell_edges_m == self.EDGES
            read, wanted = store.views().shells, self.shelled(0, 75)[0].shells
            assert read is not None
            np.testing.assert_array_equal(read.edges_m, self.EDGES)
            np.testing.assert_array_equal(read.elevation_tan, wanted.elevation_tan)
            np.testing.assert_array_equal(read.depth_m, wanted.depth_m)

    def test_are_all_or_none(self, tmp_path: Path) -> None:
        refused = pytest.raises(InputError, match="render them as the store was begun")
        header = replace(HEADER, shell_edges_m=self.EDGES)
        with create_store(tmp_path / "a.h5", header) as writer, refused:
            writer.append(*rows(0, 3))
        with create_store(tmp_path / "b.h5", HEADER) as writer, refused:
            writer.append(*self.shelled(0, 3))
        with pytest.raises(StoreMismatchError, match="shell_edges_m"):
            open_for_append(tmp_path / "a.h5", HEADER)

    def test_edges_increase(self) -> None:
        with pytest.raises(InputError, match="increasing"):
            replace(HEADER, shell_edges_m=(5.0, 5.0))


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
            ("schema_version", 3, "schema version 3; .* upgrade skyline"),
            ("schema_version", "one", "schema version 'one'"),
            ("schema_version", -1, "schema version"),
            ("config", "{", "cannot be opened"),
            ("config", "[1]", "not a JSON object"),
            ("config", "[" * 100_000, "cannot be opened"),
            ("dem_files", "[1]", "not a JSON list"),
            ("frame", 7, "not text"),
            ("frame", ["a", "b"], "no single attribute"),
        ],
    )
    def test_bad_attributes(self, tmp_path: Path, name: str, value: object, said: str) -> None:
        path = build(tmp_path / "s.h5", 3)
        with edited(path) as file:
            file.attrs[name] = value
        self.assert_refused(path, said)

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
