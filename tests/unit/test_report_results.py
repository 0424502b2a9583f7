"""Files of results: rows that are kept, a search that goes on, and what is no such file."""

import csv
import errno
import os
import sqlite3
from contextlib import closing

import numpy as np
import pytest

from skyline.errors import InputError
from skyline.match.results_file import RESULTS, open_results, row_of

PLACE = dict.fromkeys(
    (
        "easting_m", "northing_m", "eye_elevation_m", "radius_m", "pitch_deg", "roll_deg",
        "fov_deg", "score",
    ), 1.5,
) | {
    "lon": 9.8, "lat": 46.7, "heading_deg": 131.0, "confidence": 0.9, "confidence_1km": 0.95,
    "refined": True,
}  # fmt: skip
FOUND = {
    "query": "a,b.jpg", "answer": PLACE, "answer_within_m": 200.0, "candidates": [PLACE],
    "seconds": 2.0,
}  # fmt: skip
NOTHING = {
    "query": "c.jpg", "answer": None, "answer_within_m": None, "candidates": [],
    "seconds": 1.0, "refusal": "no\nplace",
}  # fmt: skip
BROKEN = {"query": "d.jpg", "error": "d.jpg is not an image"}


@pytest.fixture(params=RESULTS)
def path(request, tmp_path):
    return tmp_path / f"results{request.param}"


def test_a_search_goes_on_where_it_was_stopped(path):
    kept, had = open_results(path, "one")
    assert had == set()
    for record in (FOUND, NOTHING, BROKEN):
        kept.add(row_of(record, "one"))
    kept, had = open_results(path, "one")
    assert had == {"a,b.jpg", "c.jpg", "d.jpg"}
    kept.add(row_of(FOUND | {"query": "e\n\udce4.jpg"}, "one"))
    assert open_results(path, "one")[1] == had | {r"e\n\xe4.jpg"}


def test_results_of_another_search_are_not_mixed(path):
    kept, _ = open_results(path, "one")
    open_results(path, "another")
    kept.add(row_of(FOUND, "one"))
    with pytest.raises(InputError, match="another store or other options"):
        open_results(path, "another")


def test_what_is_no_file_of_results_is_refused(path):
    path.write_bytes(b"column_px,row_px\n1,2\n")
    with pytest.raises(InputError, match="--results"):
        open_results(path, "one")
    assert path.read_bytes() == b"column_px,row_px\n1,2\n"
    with pytest.raises(InputError, match=r"expected \.csv or \.gpkg"):
        open_results(path.with_suffix(".xlsx"), "one")


@pytest.mark.parametrize("cut", range(1, 36, 5))
def test_a_row_that_was_cut_off_is_done_again(tmp_path, cut):
    path = tmp_path / "results.csv"
    kept, _ = open_results(path, "one")
    for record in (FOUND, NOTHING):
        kept.add(row_of(record, "one"))
    path.write_bytes(path.read_bytes()[:-cut])
    assert open_results(path, "one")[1] == {"a,b.jpg"}
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["query"] for row in rows] == ["a,b.jpg"]
    assert (rows[0]["answered"], float(rows[0]["lon"])) == ("1", 9.8)
    assert (float(rows[0]["within_m"]), float(rows[0]["confidence_1km"])) == (200.0, 0.95)


def test_a_geopackage_in_a_folder_without_file_locks(tmp_path, monkeypatch):
    path = tmp_path / "results.gpkg"
    open_results(path, "one")

    def refuse(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.lockf", refuse)
    with closing(sqlite3.connect(path)) as other:
        other.execute("BEGIN EXCLUSIVE")  # a lock that SQLite would wait for
        open_results(path, "one")[0].add(row_of(FOUND, "one"))
        other.rollback()
    assert open_results(path, "one")[1] == {"a,b.jpg"}
    assert [file.name for file in tmp_path.iterdir()] == ["results.gpkg"]


def test_a_geopackage_is_one_for_others(tmp_path):
    geopandas = pytest.importorskip("geopandas")
    path = tmp_path / "results.gpkg"
    kept, _ = open_results(path, "one")
    for record in (FOUND, NOTHING):
        kept.add(row_of(record, "one"))
    table = geopandas.read_file(path)
    assert table.crs.to_epsg() == 4326
    np.testing.assert_allclose([table.geometry[0].x, table.geometry[0].y], [9.8, 46.7])
    assert list(table["query"]) == ["a,b.jpg", "c.jpg"]
    assert table["said"][1] == r"no\nplace"
    assert table.geometry[1] is None
