"""Predictions kept in a folder: found again, and never when anything they depend on differs."""

import logging
import os
from dataclasses import fields, replace

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline import RenderConfig, render_to_store
from skyline.matching.dense import DenseProfiles, DensifyConfig
from skyline.pipeline import predicted
from skyline.pipeline.digests import file_digest, files_digest
from skyline.pipeline.predicted import cache_folder, predicted_profiles
from skyline.prediction import shell_edges_m
from skyline.store import open_store
from skyline.terrain.viewpoints import stand_on

CONFIG = DensifyConfig(pitch_m=100.0, bins=72, columns=40, reach_m=300.0)
RENDERED = RenderConfig(width=80, shell_edges_m=shell_edges_m(4))


@pytest.fixture(scope="module")
def terrain():
    return field_of(fractal(64, 64, 300.0, seed=2))


@pytest.fixture(scope="module")
def store(tmp_path_factory, terrain):
    path = tmp_path_factory.mktemp("store") / "store.h5"
    west, south, east, north = terrain.bounds_m
    eyes = stand_on(
        terrain, *np.mgrid[west + 400 : east - 400 : 3j, south + 400 : north - 400 : 3j]
    )
    render_to_store(terrain, eyes, path, RENDERED)
    return path


def ask(store, terrain, config=CONFIG, folder=None):
    with open_store(store) as opened:
        return predicted_profiles(opened, terrain, config, folder)


def assert_same(one: DenseProfiles, other: DenseProfiles) -> None:
    for field in fields(DenseProfiles):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.fixture
def never(monkeypatch):
    """Return a function that makes any prediction from now on an error."""

    def predict(*_):
        raise AssertionError("predicted again")

    return lambda: monkeypatch.setattr(predicted, "densified", predict)


def test_predictions_are_kept_and_found_again(tmp_path, store, terrain, never):
    plain = ask(store, terrain)
    kept = ask(store, terrain, folder=tmp_path / "new" / "cache")
    never()
    again = ask(store, terrain, folder=tmp_path / "new" / "cache")
    assert_same(plain, kept)
    assert_same(plain, again)
    assert len(list((tmp_path / "new" / "cache").iterdir())) == 1


def test_whatever_they_depend_on_makes_others(tmp_path, store, terrain, monkeypatch):
    other = tmp_path / "other.h5"
    render_to_store(
        terrain,
        stand_on(terrain, *np.mean([terrain.bounds_m[:2], terrain.bounds_m[2:]], axis=0)),
        other,
        RENDERED,
    )
    folder = tmp_path / "cache"
    ask(store, terrain, folder=folder)
    ask(store, None, folder=folder)
    ask(store, terrain, replace(CONFIG, sources=1), folder)
    ask(other, terrain, folder=folder)
    monkeypatch.setattr(predicted, "PREDICTING_CODE", ("views.py",))
    ask(store, terrain, folder=folder)
    assert len(list(folder.iterdir())) == 5


def encrypted(archive: bytes) -> bytes:
    """Set the bit by which an archive's directory says that its first member is encrypted."""
    flags = archive.index(b"PK\x01\x02") + 8
    return archive[:flags] + bytes([archive[flags] | 1]) + archive[flags + 1 :]


@pytest.mark.parametrize(
    "damage",
    [lambda _: b"", lambda _: b"no archive", lambda whole: whole[: len(whole) // 2], encrypted],
)
def test_a_damaged_file_is_made_again(tmp_path, store, terrain, caplog, damage):
    whole = ask(store, terrain, folder=tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    with caplog.at_level(logging.WARNING):
        assert_same(ask(store, terrain, folder=tmp_path), whole)
    assert "made again" in caplog.text
    caplog.clear()
    assert_same(ask(store, terrain, folder=tmp_path), whole)
    assert not caplog.text


def test_a_folder_that_cannot_be_made_is_warned_of(tmp_path, store, terrain, caplog):
    (tmp_path / "file").write_text("in the way")
    with caplog.at_level(logging.WARNING):
        assert_same(ask(store, terrain, folder=tmp_path / "file"), ask(store, terrain))
    assert "not kept for the next time" in caplog.text


def test_the_longest_unused_goes_when_there_is_no_room(tmp_path, store, terrain, monkeypatch):
    ask(store, terrain, folder=tmp_path)
    (first,) = tmp_path.iterdir()
    ask(store, terrain, replace(CONFIG, sources=1), tmp_path)
    (second,) = set(tmp_path.iterdir()) - {first}
    os.utime(first, (1.0, 1.0))
    os.utime(second, (2.0, 2.0))
    ask(store, terrain, folder=tmp_path)  # Asked for again: now the second is the older one.
    monkeypatch.setattr(predicted, "FOLDER_LIMIT_BYTES", 5 * first.stat().st_size // 2)
    ask(store, None, folder=tmp_path)
    assert first.exists()
    assert not second.exists()
    assert len(list(tmp_path.iterdir())) == 2


def test_what_a_killed_process_left_behind_goes(tmp_path, store, terrain):
    old, new, other = (
        tmp_path / name for name in ("a.predicted.partial", "b.predicted.partial", "c.partial")
    )
    for path in (old, new, other):
        path.touch()
    os.utime(old, (1.0, 1.0))
    os.utime(other, (1.0, 1.0))
    ask(store, terrain, folder=tmp_path)
    assert not old.exists()
    assert new.exists()
    assert other.exists()


def test_the_folder_is_where_the_system_wants_it(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "skyline"
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "skyline"


def test_digests_tell_files_apart(tmp_path):
    for name, text in (("a", "1"), ("b", "1"), ("c", "2")):
        (tmp_path / name).write_text(text)
    a, b, c = (tmp_path / name for name in "abc")
    assert file_digest(a) == file_digest(b) != file_digest(c)
    assert len({files_digest([a]), files_digest([b]), files_digest([a, b])}) == 3
