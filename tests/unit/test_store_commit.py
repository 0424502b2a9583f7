"""What is committed stays, however a writer ends."""

import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from store_files import CHUNK, assert_holds, build, edited, killed_copy
from store_rows import HEADER, WIDTH, rows

from skyline.errors import (
    InputError,
)
from skyline.store import (
    Built,
    create_store,
    open_for_append,
    open_store,
)
from skyline.views import Views


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


def built(path: Path) -> Built:
    with open_store(path) as store:
        return store.built


class TestBuilt:
    def test_no_part_is_claimed_before_its_rows_are_committed(self, tmp_path: Path) -> None:
        path = tmp_path / "s.h5"
        with create_store(path, HEADER, Built(0, 3)) as writer:
            assert built(path) == Built(0, 3)
            for part, stop in enumerate((CHUNK, CHUNK + 20, 2 * CHUNK + 10), start=1):
                writer.append(*rows(len(writer), stop))
                writer.note_built(Built(part, 3))
                assert writer.built == Built(part, 3)
                # Committed are whole chunks.
                assert built(path) == Built(min(part, 2 if stop > 2 * CHUNK else 1), 3)
        assert built(path) == Built(3, 3)
        assert built(path).finished

    def test_a_killed_writers_parts_are_kept(self, tmp_path: Path) -> None:
        path, killed = tmp_path / "s.h5", tmp_path / "killed.h5"
        with create_store(path, HEADER, Built(0, 3)) as writer:
            writer.append(*rows(0, CHUNK))
            writer.note_built(Built(1, 3))
            shutil.copy(path, killed)
        open_for_append(killed, HEADER).close()
        assert built(killed) == Built(1, 3)

    def test_a_store_of_an_older_release_does_not_know(self, tmp_path: Path) -> None:
        path = build(tmp_path / "s.h5", 3)
        with edited(path) as file:
            del file["built"]
        with open_for_append(path, HEADER) as writer:
            writer.append(*rows(3, 5))
            writer.note_built(Built(5, 5))
        with open_store(path) as store:
            assert_holds(store, 5)
            assert store.built.share is store.built.finished is None
            assert store.built.note == "it is not known whether its build was finished"

    @pytest.mark.parametrize(
        ("done", "said"), [(0, "0 %"), (1, "less than 1 %"), (9999, "99 %"), (10000, "")]
    )
    def test_it_is_said_how_much_is_there(self, done: int, said: str) -> None:
        note = Built(done, 10_000).note
        assert note == (said and f"its build is not finished: {said} of the area is there")


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


@settings(max_examples=12, stateful_step_count=10)
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
