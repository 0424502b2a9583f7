"""All commands of ``skyline-bench``: help, records, and small runs of the short ones."""

import json
import re
import shutil
from pathlib import Path

import pytest
from commands import assert_refused
from scenes import field_of, fractal

from skyline.errors import InputError
from skyline_bench import paper
from skyline_bench.truth import stability

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("command", "rows", "key"),
    [
        (("summits", "DEM", "--quick"), 1, "summits_off"),
        (("large-dem", "--quick"), 1, "seconds"),
        (("drawn", "DEM", "--quick"), 2, "km2"),
        (("table1", "--seeds", 1, "--side", 30, "--row", 2), 5, "mean_area"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_short_ones_write_their_rows(run_bench, dem, tmp_path, command, rows, key):
    given = [{"DEM": dem}.get(word, word) for word in command]
    record = tmp_path / "record.json"
    run_bench(*given, "--json", record).ok()
    written = json.loads(record.read_text())
    assert written["bench"] == command[0]
    assert len(written["rows"]) >= rows
    assert all(row[key] >= 0.0 for row in written["rows"])


def test_the_help_of_a_command_says_how_long_it_takes(run_bench):
    assert "On 2 cores without a GPU it takes 2 minutes." in run_bench("table1", "--help").ok().out


def test_help_fills_the_lines_that_a_docstring_breaks(run_bench):
    shown = run_bench("placing", "--help").ok().out
    paragraph = shown[shown.index("The claimed loss") : shown.index("Stores that are named")]
    first, second = paragraph.strip().splitlines()
    assert len(first) + len(second.split()[0]) > 70, "the next word would fit"
    assert second.strip().endswith("is lost.")


RESULTS = ROOT / "bench" / "results"


def checkout_of(folder):
    """Make a folder a checkout with the records of this one."""
    (folder / "bench").mkdir()
    (folder / "bench" / "results").symlink_to(RESULTS)


def test_tables_and_figures_are_made_from_the_records(run_bench, tmp_path):
    readme = (ROOT / "README.md").read_text()
    stale = readme.replace("The place found", "The place\nfound").replace("| tie |", "| adaptive |")
    (tmp_path / "README.md").write_text(re.sub(r"(find )\d+", r"\1 7", stale, count=1))
    checkout_of(tmp_path)
    assert "README.md: written" in run_bench("figures", "--output", tmp_path).ok().out
    assert (tmp_path / "README.md").read_text().split() == readme.split()
    for name in ("speed-error", "uniform-adaptive"):
        assert "<svg" in (tmp_path / "docs" / f"{name}.svg").read_text()
    again = run_bench("figures", "--output", tmp_path).ok()
    assert again.out == "", "a second run changes nothing"


def test_a_page_without_a_sentence_with_figures_is_refused(run_bench, tmp_path):
    readme = (ROOT / "README.md").read_text()
    (tmp_path / "README.md").write_text(readme.replace("The place found", "A place found"))
    checkout_of(tmp_path)
    assert_refused(
        run_bench("figures", "--output", tmp_path),
        "README.md has the sentence `The place found is {} m off; its confidence is {}.` 0 times",
    )


def test_a_page_with_an_unknown_table_is_refused(run_bench, tmp_path):
    (tmp_path / "README.md").write_text("<!-- figures: none -->\n\n\n<!-- end of figures -->\n")
    checkout_of(tmp_path)
    assert_refused(run_bench("figures", "--output", tmp_path), "has the table `none`")


def test_a_folder_without_records_is_refused(run_bench, tmp_path):
    shutil.copy(ROOT / "README.md", tmp_path)
    assert_refused(
        run_bench("figures", "--output", tmp_path),
        "bench/results is no folder; run this in a checkout of Skyline, or name a folder of "
        "records to draw",
    )
    assert [one.name for one in tmp_path.iterdir()] == ["README.md"]
    assert_refused(run_bench("figures", tmp_path), "has no record of a benchmark")
    none = tmp_path / "none"
    assert_refused(
        run_bench("figures", none),
        f"{none} is no folder; name a folder of records, which commands write with "
        "--json FOLDER/NAME.json",
    )


@pytest.mark.parametrize(
    ("written", "error"),
    [
        ("--json {dem}", "is an input; choose another name for the output"),
        ("--json {tmp}", "is a folder; name a file for the output"),
    ],
)
def test_a_record_replaces_nothing_that_was_read(run_bench, dem, tmp_path, written, error):
    """Refused before the measurement, which may take an hour."""
    copy = shutil.copy(dem, tmp_path / "dem.tif")
    given = written.format(dem=copy, tmp=tmp_path).split()
    assert_refused(run_bench("summits", copy, "--quick", *given), error)
    assert_refused(run_bench("summits", *given, copy, "--quick"), error)
    assert copy.read_bytes() == dem.read_bytes()


def test_a_picture_of_another_kind_is_refused_before_it_is_drawn(run_bench, tmp_path):
    drawn = run_bench("readme-picture", "--quick", "-o", tmp_path / "picture.txt")
    assert_refused(drawn, "picture.txt is '.txt'; expected one of .jpg, .jpeg")


@pytest.mark.parametrize(
    "words", ["input-fuzz --cases 0", "store-durability DEM --flips -1", "shards DEM --km2 0"]
)
def test_counts_of_nothing_are_refused(run_bench, words):
    assert_refused(run_bench(*words.split()), "Input should be greater than or equal to")


def test_the_help_of_quick_has_each_number_of_a_list(run_bench):
    shown = " ".join(run_bench("shards", "--help").ok().out.replace("│", " ").split())
    assert "by default --places 2000, --km2 20000" in shown


def test_a_folder_of_any_records_is_drawn(run_bench, tmp_path):
    """Records have any names; those of searches and of speed are drawn as diagrams."""
    for name in ("placing_davos", "speed_error", "page"):
        shutil.copy(RESULTS / f"{name}.json", tmp_path / f"my {name}.json")
    (tmp_path / "other.json").write_text("[]")
    drawn = tmp_path / "new" / "drawn"
    out = run_bench("figures", tmp_path, "-o", drawn).ok().out
    assert out.count(": written") == 3
    page = (drawn / "figures.md").read_text()
    assert re.findall(r"^## (.*)$", page, re.MULTILINE) == [
        "my page",
        "my placing_davos",
        "my speed_error",
    ]
    tables = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    assert max(len(line) for table in tables for line in table.splitlines()) <= 100
    for name in ("placing_davos", "speed_error"):
        assert f"(<my {name}.svg>)" in page
        assert "<svg" in (drawn / f"my {name}.svg").read_text()


def test_the_table_of_a_search_has_a_row_for_all_queries_of_a_store(run_bench, tmp_path):
    """Rows of groups of queries, which the table does not name, would pass for the whole."""
    shutil.copy(RESULTS / "matching.json", tmp_path)
    run_bench("figures", tmp_path).ok()
    table = (tmp_path / "figures.md").read_text().split("```text")[1].split("\n\n\n")[0]
    rows = json.loads((RESULTS / "matching.json").read_text())["rows"]
    whole = [row for row in rows if row["group"] == "all"]
    assert len(whole) < len(rows)
    assert sum(row["store"] in table for row in whole) == len(whole)
    assert len(table.strip().splitlines()) - 2 == len(whole)


def test_stability_says_what_fails(run_bench, tmp_path, monkeypatch):
    # All hard cases are tested one by one in test_stability.
    measured, three_cases = stability.measure, stability.HARD_CASES[:3]
    monkeypatch.setattr(stability, "HARD_CASES", three_cases)

    def spoiled(*arguments):
        row = measured(*arguments)
        return {**row, "ok": row["path"] == "depth", "error_px": float("inf")}

    monkeypatch.setattr(stability, "measure", spoiled)
    record = tmp_path / "record.json"
    done = run_bench("stability", "--quick", "--json", record)
    rows = json.loads(record.read_text())["rows"]
    assert {row["case"] for row in rows} == {case.name for case in three_cases}
    assert {row["path"] for row in rows} == {"horizon", "depth"}
    assert "FAILS" in done.out
    assert done.code == 1
    assert done.err.startswith("error: 3 of ")
    assert f"{three_cases[0].name} (horizon)" in done.err
    assert done.err.count("\n") == 1
    assert all(row["error_px"] is None for row in rows)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("chromedriver"), reason="chromium-driver is not installed")
def test_the_page_is_measured(run_bench, tmp_path):
    record = tmp_path / "page.json"
    smaller = "--spacing", 400, "--photo-width", 1200, "--quick"
    run_bench("page", *smaller, "--json", record).ok()
    rows = {row["figure"]: row["value"] for row in json.loads(record.read_text())["rows"]}
    expected = {
        "server ready",
        "first place found",
        "second place found",
        "hand to skyline, median",
    }
    assert expected <= rows.keys()
    assert all(isinstance(value, float) for value in rows.values())
    assert rows["renderings shown a second"] > 0.0


def test_predictors_are_compared_with_renderings():
    heights = fractal(180, 180, 1200.0, seed=7)
    found = paper.measure_quality(field_of(heights, 60.0), 8, seed=3)
    rows = {row["predictor"]: row for row in found}
    assert rows["affine-mean"]["recall"] > rows["non-affine"]["recall"]
    for row in rows.values():
        for share in ("precision", "recall"):
            low, high = row[f"{share}_interval"]
            assert 0.0 <= low <= row[share] <= high <= 1.0
        assert 0.0 < row["answered"] <= 1.0
    with pytest.raises(InputError, match=r"5\.4 x 5\.4 km; expected more than 6\.6"):
        paper.measure_quality(field_of(heights, 30.0), 8, seed=3)
