"""Files that are written whole or not at all."""

import errno
import os
from pathlib import Path
from threading import Thread

import pytest

from skyline.errors import InputError
from skyline.files.disk import write_whole


def test_missing_folders_of_a_file_are_made(tmp_path):
    write_whole(tmp_path / "new" / "folder" / "a.csv", "one")
    assert (tmp_path / "new" / "folder" / "a.csv").read_text() == "one"
    with pytest.raises(InputError, match="cannot be written"):
        write_whole(tmp_path / "new" / "folder" / "a.csv" / "b.csv", "two")


def test_a_full_disk_keeps_no_new_folder(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match="No space left"):
        write_whole(tmp_path / "new" / "folder" / "a.csv", "one")
    assert not list(tmp_path.iterdir())


def test_links_stay_and_pipes_are_written(tmp_path):
    (tmp_path / "first.csv").touch()
    link = tmp_path / "latest.csv"
    link.symlink_to("first.csv")
    write_whole(link, "one")
    assert (link.is_symlink(), (tmp_path / "first.csv").read_text()) == (True, "one")
    os.mkfifo(tmp_path / "pipe")
    read = []
    reader = Thread(target=lambda: read.append((tmp_path / "pipe").read_text()), daemon=True)
    reader.start()
    write_whole(tmp_path / "pipe", "two")
    reader.join(timeout=10.0)
    assert (read, (tmp_path / "pipe").is_fifo()) == (["two"], True)
    out, into = os.pipe()
    write_whole(Path(f"/dev/fd/{into}"), "three")
    assert os.read(out, 9) == b"three"
    for pipe in (out, into):
        os.close(pipe)
    assert {one.name for one in tmp_path.iterdir()} == {"first.csv", "latest.csv", "pipe"}


def test_two_that_write_a_file_at_once_both_write_it_whole(tmp_path, monkeypatch):
    path, replace = tmp_path / "table.csv", Path.replace

    def replace_late(partial, target):
        monkeypatch.undo()
        write_whole(path, "of the other")
        return replace(partial, target)

    monkeypatch.setattr(Path, "replace", replace_late)
    write_whole(path, "of this one")
    assert path.read_text() == "of this one"
    assert list(tmp_path.iterdir()) == [path]
