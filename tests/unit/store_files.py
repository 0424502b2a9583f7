"""Stores on disk for tests: whole, killed at work, changed behind the program's back."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from store_rows import HEADER, rows

from skyline.store import (
    Store,
    create_store,
)
from skyline.views import Views

CHUNK = 32


def assert_holds(store: Store, count: int, index: object = slice(None)) -> None:
    """The store holds exactly rows 0 to ``count``."""
    views, keypoints = rows(0, count)
    wanted = np.atleast_1d(np.arange(count)[index])
    got = store.views(index)
    for name in Views.__slots__:
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


def one_line(error: BaseException, path: Path) -> bool:
    return "\n" not in str(error) and str(path) in str(error)
