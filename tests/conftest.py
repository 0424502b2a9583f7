"""Fixtures that several kinds of tests share."""

from pathlib import Path

import pytest

from skyline.pipeline.cluster import local_cluster


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real DEMs and photos beside the checkout; skips where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"real data not at {folder}")
    return folder


@pytest.fixture(scope="module")
def dask_cluster():
    """Two workers on this machine, for the tests of a module."""
    with local_cluster(2) as cluster:
        yield cluster
