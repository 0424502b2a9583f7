"""Files of results: rows are kept, a stopped search continues, other files are refused.

One process at a time writes a file.
"""

import csv
import errno
import os
import sqlite3
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from scenes import candidate_at

from skyline.errors import BusyError, InputError
from skyline.match.result import MatchResult
from skyline.photo.skyline import PhotoSkyline
from skyline.report.results_file import RESULTS, ResultsFile

SKYLINE = PhotoSkyline(np.full(8, 3.0), np.ones(8), 8, 8, 60.0)
PLACE = candidate_at(
    1000.0, 2000.0, 131.0, confidence=0.9, confidence_1km=0.95,
    covariance_m2=((9.0, 0.0), (0.0, 9.0)),
)  # fmt: skip
RESULT = MatchResult(SKYLINE, (PLACE,), 2.0, None, 200.0, "a,b.jpg")
FOUND = RESULT.to_row()
NOTHING = MatchResult(SKYLINE, (), 1.0, "no\nplace", name="c.jpg").to_row()
BROKEN = {"photo": "d.jpg", "answered": 0, "reason": "d.jpg is not an image"}


@pytest.fixture(params=RESULTS)
def path(request, tmp_path):
    return tmp_path / f"results{request.param}"


def write(path, *rows):
    """Add rows to a file of results; return the photos that were there before, and their errors."""
    with ResultsFile(path, "one") as kept:
        before = dict(kept.photos)
        for row in rows:
            kept.add(row, row["photo"])
    return before


def test_a_search_goes_on_where_it_was_stopped(path):
    assert write(path, FOUND, NOTHING, BROKEN) == {}
    with ResultsFile(path, "one") as kept:
        assert kept.photos == {"a,b.jpg": None, "c.jpg": None, "d.jpg": BROKEN["reason"]}
        kept.add(replace(RESULT, name="e\n\udce4.jpg").to_row(), "e")
    assert list(write(path)) == list(kept.photos) == ["a,b.jpg", "c.jpg", "d.jpg", "e"]


def test_a_photo_has_one_row(path):
    write(path, FOUND, FOUND)
    before = path.read_bytes()
    assert write(path, FOUND) == {"a,b.jpg": None}
    assert path.read_bytes() == before


def test_a_second_writer_is_refused(path):
    with ResultsFile(path, "one") as kept:
        with pytest.raises(BusyError):
            ResultsFile(path, "one")
        kept.add(FOUND, "a")
    assert write(path) == {"a": None}
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_a_link_is_the_same_file(path):
    write(path)
    link = path.with_name(f"link{path.suffix}")
    link.symlink_to(path)
    with ResultsFile(path, "one"), pytest.raises(BusyError):
        ResultsFile(link, "one")


def test_results_of_another_search_are_not_mixed(path):
    write(path)
    with ResultsFile(path, "another"):
        pass
    write(path, FOUND)
    with pytest.raises(InputError):
        ResultsFile(path, "another")


@pytest.mark.parametrize("content", [b"column_px,row_px\n1,2\n", b"my notes"])
def test_another_file_is_refused_and_kept(path, content):
    path.write_bytes(content)
    with pytest.raises(InputError):
        ResultsFile(path, "one")
    assert path.read_bytes() == content
    with pytest.raises(InputError):
        ResultsFile(path.with_suffix(".xlsx"), "one")


@pytest.mark.parametrize("cut", range(1, 36, 5))
def test_a_row_that_was_cut_off_is_done_again(tmp_path, cut):
    path = tmp_path / "results.csv"
    write(path, FOUND, NOTHING)
    path.write_bytes(path.read_bytes()[:-cut])
    assert write(path) == {"a,b.jpg": None}
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["photo"] for row in rows] == ["a,b.jpg"]
    assert (rows[0]["answered"], float(rows[0]["lon"])) == ("1", PLACE.lon)
    assert (float(rows[0]["within_m"]), float(rows[0]["confidence_1km"])) == (200.0, 0.95)


def test_a_geopackage_in_a_folder_without_file_locks(tmp_path, monkeypatch):
    path = tmp_path / "results.gpkg"
    write(path)

    def refuse(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.lockf", refuse)
    monkeypatch.setattr("fcntl.flock", refuse)
    with closing(sqlite3.connect(path)) as other:
        other.execute("BEGIN EXCLUSIVE")  # a lock that SQLite would wait for
        write(path, FOUND)
        other.rollback()
    assert write(path) == {"a,b.jpg": None}
    assert [file.name for file in tmp_path.iterdir()] == ["results.gpkg"]


def test_geopandas_reads_the_geopackage(tmp_path):
    geopandas = pytest.importorskip("geopandas")
    path = tmp_path / "results.gpkg"
    write(path, FOUND, NOTHING)
    table = geopandas.read_file(path)
    assert table.crs.to_epsg() == 4326
    np.testing.assert_allclose([table.geometry[0].x, table.geometry[0].y], [PLACE.lon, PLACE.lat])
    assert list(table["photo"]) == ["a,b.jpg", "c.jpg"]
    assert table["reason"][1] == r"no\nplace"
    assert table.geometry[1] is None


def test_cells_that_are_missing_are_empty(tmp_path):
    path = tmp_path / "results.csv"
    write(path, FOUND)
    path.write_text(path.read_text() + "short.jpg,,one-short.jpg\n")
    with ResultsFile(path, "one") as kept:
        assert kept.photos == {"a,b.jpg": None, "short.jpg": None}


def test_a_row_with_too_many_cells_is_refused(tmp_path):
    path = tmp_path / "results.csv"
    write(path, FOUND)
    path.write_text(path.read_text() + "long.jpg" + "," * 20 + "more\n")
    with pytest.raises(InputError):
        ResultsFile(path, "one")
