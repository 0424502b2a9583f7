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


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory):
    """Keep what commands keep for the next time out of the user's folders."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def dask_cluster():
    """Two workers on this machine, for the tests of a module."""
    with local_cluster(2) as cluster:
        yield cluster
