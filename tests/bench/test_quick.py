"""``--quick`` makes defaults smaller and keeps what is asked for; tables say what they are of."""

import pytest
from commands import assert_refused, headings

from skyline_bench.options import table_text
from skyline_bench.search.commands import COMPARISONS


@pytest.fixture
def measured(recorded):
    """Return a function that runs a benchmark with --quick, and gives rows and output."""

    def run(*command):
        record, printed = recorded(*command, "--quick")
        return record["rows"], printed

    return run


PLAIN = "--matcher", "correlation", "--kind", "plain"


def test_stores_and_queries_that_are_named_are_all_searched(measured, dem):
    asked = "matching", dem, *PLAIN, "--spacing", 600, "--spacing", 400, "--queries", 5
    rows, _ = measured(*asked)
    every = [row for row in rows if row["group"] == "all"]
    assert [(row["store"], row["n"]) for row in every] == [("uniform-600", 5), ("uniform-400", 5)]


def test_bounds_that_are_given_are_searched_whole(measured, dem):
    bounds = "10.311,46.737,10.354,46.764"
    (*_, row), _ = measured("matching", dem, *PLAIN, "--spacing", 600, "--bounds", bounds)
    # 0.043 degrees of longitude at 46.75 north by 0.027 of latitude; by default it is 3 x 3 km.
    assert row["km2"] == pytest.approx(0.043 * 76.4 * 0.027 * 111.2, rel=0.05)
    (*_, row), _ = measured("matching", dem, *PLAIN, "--spacing", 600)
    assert row["km2"] == pytest.approx(9.0, rel=0.05)
    assert row["n"] == 3


def test_an_area_that_does_not_fit_is_refused(run_bench, dem):
    asked = "matching", dem, "--places", 400, "--quick", "--area", 5, "--area", 50
    assert_refused(run_bench(*asked), "--area 50 is not less than the 9.3 km2")


@pytest.mark.parametrize(("options", "seeds"), [((), 1), (("--seeds", 2), 2)])
def test_seeds_that_are_given_are_run(measured, options, seeds):
    rows, _ = measured("table1", "--side", 30, "--row", 2, *options)
    assert {row["n"] for row in rows} == {seeds}


def test_all_photographs_of_a_manifest_are_measured(measured, run_bench, photo, tmp_path):
    manifest = tmp_path / "held.csv"
    manifest.write_text("photo,kind\n" + 4 * f"{photo},extract\n")
    rows, out = measured("photos", manifest)
    assert len(rows) == 4
    assert "extract     -   4" in out
    assert_refused(
        run_bench("photos", manifest, "--store", photo, "--side-km", 4), "give one of them"
    )


@pytest.mark.slow
def test_all_photographs_at_known_places_are_oriented(measured, dem, photo, tmp_path):
    manifest = tmp_path / "held.csv"
    lines = [f"{photo},locate,{lon},46.751,,60,60" for lon in (10.333, 10.3331, 10.3332)]
    manifest.write_text("photo,kind,lon,lat,heading_deg,fov_deg,given_fov_deg\n" + "\n".join(lines))
    rows, _ = measured("orient", dem, "--photos", manifest)
    assert [row["n"] for row in rows if row["measured"] == "photos"] == [3]


@pytest.mark.parametrize("name", COMPARISONS)
def test_the_columns_of_a_search_have_the_queries_their_number_and_the_area(name):
    columns = {one.partition("=")[0] for one in COMPARISONS[name].columns.split()}
    assert {"queries", "n", "km2"} <= columns


TERRAIN = {"n", "km2"}
TABLES = {
    "uniform-adaptive": (
        ("DEM", "--spacing", 600, "--threshold-px", 40, "--matcher", "paper", "--kind", "aligned"),
        [{"queries", *TERRAIN}, {"queries", *TERRAIN}],
    ),
    "matching": (("DEM", *PLAIN, "--spacing", 600), [{"queries", *TERRAIN}]),
    "speed-error": (("DEM",), [TERRAIN]),
    "summits": (("DEM",), [TERRAIN]),
    "large-dem": ((), [TERRAIN]),
    "sky-view": (("DEM", "--side", 40), [TERRAIN]),
    "table1": (("--side", 30, "--row", 2), [{"n"}]),
}
"""By command: its arguments, and headings that its tables must have."""


@pytest.mark.parametrize("name", TABLES)
def test_each_table_says_how_many_were_measured_and_where(measured, dem, name):
    arguments, wanted = TABLES[name]
    _, out = measured(name, *(dem if word == "DEM" else word for word in arguments))
    found = headings(out)
    assert len(found) >= len(wanted)
    for columns in found:
        assert any(needed <= set(columns) for needed in wanted), columns


def test_a_wide_table_is_printed_in_parts_that_each_say_what_is_measured():
    """Of 40 columns of 12 letters six or so fit 100 columns beside what a row is of."""
    figures = {f"figure_{number:05d}": number for number in range(40)}
    rows = [{"store": "uniform-80", "km2": 50, "n": 9, **figures}]
    text = table_text(rows)
    parts = headings(text)
    assert max(map(len, text.splitlines())) <= 100
    assert all(part[:3] == ["store", "km2", "n"] for part in parts)
    assert [name for part in parts for name in part[3:]] == [
        name.replace("_", " ") for name in figures
    ]


def test_a_table_that_fits_is_printed_in_one_part():
    assert len(headings(table_text([{"path": "a", "n": 1, "seconds": 0.5}]))) == 1


def test_a_share_of_one_query_has_no_interval():
    row = {"within_200m": 1.0, "within_200m_low": 0.25, "within_200m_high": 1.0}
    assert "(0.25 to 1)" in table_text([{"n": 2, **row}])
    assert "0.25" not in table_text([{"n": 1, **row}])
