"""CSV files as people have them: other separators, names and orders of columns."""

import csv
import io
import sys

import numpy as np
import pytest
from commands import csv_of
from scenes import field_of

from skyline.errors import InputError
from skyline.files.tables import csv_lines, is_table, read_table
from skyline.photo.trace import read_trace
from skyline.terrain.viewpoints import read_viewpoints


def places(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    rows = read_table(path, "expected places").rows
    return [(row.label, row.number("lon"), row.number("lat")) for row in rows]


@pytest.mark.parametrize(
    "text",
    [
        "id,note,lon,lat\rA,a\u2028b,9.85,46.75\r",
        "\ufeffLongitude, Latitude ,Name\r\n9.85,46.75, A\r\n\r\n",
        "name;longitude;latitude\nA;9,85;46,75\n",
        "lat\tlng\tid\tname\n46.75\t9.85\tA\tnot this\n",
        "@lat\t@lon\tname\n46.75\t9.85\tA\n",
        '# from a survey\n"id","long","lat"\n"A","9.85","46.75"\n',
    ],
    ids=["old line ends", "excel", "semicolons and decimal commas", "tabs", "overpass", "quotes"],
)
def test_places_are_read_however_their_file_is_written(tmp_path, text):
    assert places(tmp_path / "a.csv", text) == [("A", 9.85, 46.75)]


@pytest.mark.parametrize(
    ("row", "elevation_m"),
    [
        ("1;9,85;2.500", 2500.0),
        ("1;9,85;12.500,25", 12500.25),
        ("1;9,850;2.5", 2.5),
        ("1;9.850;2.500", 2.5),
        ("1,5;9.850;2.500", 2.5),
        ("1;9.850;2.500,5", 2500.5),
    ],
)
def test_points_beside_decimal_commas_part_thousands(tmp_path, row, elevation_m):
    path = tmp_path / "a.csv"
    path.write_text(f"id;lon;elevation\n{row}\n")
    (row,) = read_table(path, "").rows
    assert (row.number("lon"), row.number("elevation")) == (9.85, elevation_m)


@pytest.mark.parametrize(
    ("row", "values"),
    [
        ("1.234,5;9,5;1.800", (1234.5, 1800.0)),
        ("1,234.5;9.5;1,800", (1234.5, 1800.0)),
        ("123.456;9.5;1.800", (123.456, 1.8)),
        ("123,456;9,512;1,800", (123.456, 1.8)),
    ],
    ids=["german", "english", "points", "commas"],
)
def test_a_table_tells_what_its_separators_part(tmp_path, row, values):
    path = tmp_path / "a.csv"
    path.write_text(f"row_px;lon;elevation_m\n{row}\n")
    (row,) = read_table(path, "").rows
    assert (row.number("row_px"), row.number("elevation_m")) == values


@pytest.mark.parametrize("row", ["1.234;9,5;2", "1,234;9.5;2", "1,234;9;2"])
def test_a_number_that_may_be_thousands_or_decimals_is_refused(tmp_path, row):
    path = tmp_path / "a.csv"
    path.write_text(f"row_px;lon;elevation_m\n{row}\n")
    (row,) = read_table(path, "").rows
    with pytest.raises(InputError, match=r"which may be 1.234 or 1234; write one more"):
        row.number("row_px", 0.0, 2000.0)


@pytest.mark.parametrize("note", ['"# width=640 height=480"', '"# width=640 height=480",,'])
def test_notes_that_a_spreadsheet_has_quoted_are_read(tmp_path, note):
    path = tmp_path / "a.csv"
    path.write_text(f"{note}\ncolumn_px,row_px\n0,12\n60,12\n")
    assert repr(read_trace(path)).startswith("PhotoSkyline(640 x 480 px")


def test_standard_input_is_read_and_its_kind_is_seen(monkeypatch):
    for content, is_csv in ((b"path,id\na.jpg,1\n", True), (b"\xff\xd8\xff\xe0", False)):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))
        assert is_table("-") is is_csv
        if is_csv:
            assert read_table("-", "").rows[0].label == "1"


FORMULAS = [
    "=1+1", "+A1", "-2+3", "@SUM(A1)", "=cmd|' /C calc'!A0", '=HYPERLINK("http://a";"b")', "-",
    "-3.5 m", "+41 81 1", "\uff1d1+1", "'=1+1",
]  # fmt: skip
"""Names that spreadsheets would take for formulas, and one that has the guard already."""


@pytest.mark.parametrize("name", FORMULAS)
def test_a_formula_is_written_as_text_and_read_as_it_was(tmp_path, name):
    path = tmp_path / "a.csv"
    path.write_text(csv_lines([["name", "lon", "lat"], [name, -3.5, 46.0]]))
    with path.open(newline="") as file:
        assert list(csv.reader(file))[1] == [f"'{name}", "-3.5", "46.0"]
    (row,) = read_table(path, "").rows
    assert (row["name"], row.number("lon")) == (name, -3.5)


@pytest.mark.parametrize(
    ("name", "written"),
    [("\t=1+1", r"\t=1+1"), ("a\r=1+1", r"a\r=1+1"), ("\n+1", r"\n+1"), ("b\udce4r", r"b\xe4r")],
)
def test_a_name_is_one_line_of_printable_letters(name, written):
    assert list(csv.reader([csv_lines([[name, 1]])])) == [[written, "1"]]


@pytest.mark.parametrize("text", ["-3.5", "+12", "-1e-05", "-3,5", "'a", "a=b", "", "山"])
def test_numbers_and_other_texts_are_written_as_they_are(tmp_path, text):
    (tmp_path / "a.csv").write_text(csv_lines([["id", "name"], ["1", text]]))
    with (tmp_path / "a.csv").open(newline="") as file:
        assert list(csv.reader(file))[1] == ["1", text]
    (row,) = read_table(tmp_path / "a.csv", "").rows
    assert row["name"] == text


def test_a_number_that_another_program_has_guarded_is_read(tmp_path):
    assert places(tmp_path / "a.csv", "name,lon,lat\nA,'-9.85,'+46.75\n") == [("A", -9.85, 46.75)]


@pytest.mark.parametrize(
    ("column", "given", "elevations_m"),
    [("eye_height_m", "30", [130.0, 105.0]), ("eye_elevation_m", "170", [170.0, 105.0])],
)
def test_an_empty_cell_of_viewpoints_is_the_default(tmp_path, column, given, elevations_m):
    field = field_of(np.full((9, 9), 100.0))
    rows = [f"80,-80,{given}", "120,-80,"]
    path = csv_of(tmp_path / "eyes.csv", rows, f"easting,northing,{column}")
    eyes, _ = read_viewpoints(path, field, eye_height_m=5.0)
    assert eyes.eye_elevation_m.tolist() == elevations_m
    assert eyes.easting_m.tolist() == [80.0, 120.0]


def test_a_row_of_viewpoints_has_a_height_or_an_elevation(tmp_path):
    field = field_of(np.full((9, 9), 100.0))
    header = "easting,northing,eye_height_m,eye_elevation_m"
    path = csv_of(tmp_path / "eyes.csv", ["80,-80,30,", "120,-80,,170", "80,-80,,"], header)
    eyes, _ = read_viewpoints(path, field, eye_height_m=5.0)
    assert eyes.eye_elevation_m.tolist() == [130.0, 170.0, 105.0]
    csv_of(path, ["80,-80,30,170"], header)
    with pytest.raises(InputError):
        read_viewpoints(path, field)


def test_empty_columns_at_the_end_are_no_columns(tmp_path):
    path = csv_of(tmp_path / "photos.csv", ["a.jpg,60,,", "b.jpg,,,"], "path,fov_deg,,")
    table = read_table(path, "expected a list")
    assert table.header == ("path", "fov_deg")
    table.refuse_other("path", "fov_deg")
    assert [row["fov_deg"] for row in table.rows] == ["60", ""]
