"""``skyline build`` in tiles, here and on workers."""

import pytest


@pytest.fixture
def tiles(dem, tmp_path):
    return "build", dem, "-o", tmp_path / "s.h5", "--spacing", "900", "--width", "80"


def test_tiles_and_workers_make_the_same_store(run, tiles, tmp_path):
    here = run(*tiles, "--shard-km", "2")
    assert here.code == 0, here.err
    assert "renderings" in here.out
    content = (tmp_path / "s.h5").read_bytes()
    (tmp_path / "s.h5").unlink()
    spread = run(*tiles, "--shard-km", "2", "--workers", "1")
    assert (spread.code, spread.err) == (0, "")
    assert (tmp_path / "s.h5").read_bytes() == content
    again = run(*tiles, "--shard-km", "2")
    assert ", 0 of them new" in again.out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--shard-km", "0"), "tile size is 0.0 m"),
        (("--shard-km", "nan"), "tile size is nan m"),
        (("--workers", "0"), "workers is 0; expected 1 or more"),
        (("--workers", "2", "--scheduler", "tcp://127.0.0.1:1"), "one of --workers and"),
        (("--scheduler", "nonsense://x"), "no dask scheduler answers"),
        (("--shard-km", "2", "--planner", "lpov"), "planner lpov plans one area"),
    ],
)
def test_options_that_do_not_fit(run, tiles, options, said, tmp_path):
    done = run(*tiles, *options)
    assert done.code == 2
    assert done.err.startswith("error: ")
    assert said in done.err
    assert done.err.count("\n") == 1
    assert not list(tmp_path.iterdir())
