"""``skyline-bench scale`` as a user meets it."""

import json

import cv2
import pytest
from commands import assert_refused


@pytest.mark.slow
@pytest.mark.usefixtures("refined_once")
def test_areas_are_built_and_searched(run_bench, dem, tmp_path):
    record, plot = tmp_path / "record.json", tmp_path / "plot.png"
    done = run_bench(
        "scale", dem, "--quick", "--area", 2, "--spacing", 300, "--queries", 1,
        "--folder", tmp_path / "kept", "--json", record, "--plot", plot,
    )  # fmt: skip
    assert done.code == 0, done.err
    written = json.loads(record.read_text())
    assert written["bench"] == "scale"
    assert written["machine"]["cores"] > 0
    (cost,) = written["summary"]["store"]
    assert cost["store"] in done.out
    assert {row["search"] for row in written["rows"]} == {"2 km2", "all"}
    assert cv2.imread(str(plot)) is not None
    # The same store, given.
    given = run_bench(
        "scale", dem, "--quick", "--store", tmp_path / "kept" / "places-300.h5", "--area", 2,
        "--queries", 1, "--folder", tmp_path / "kept", "--json", record,
    )  # fmt: skip
    assert given.code == 0, given.err
    again = json.loads(record.read_text())
    assert again["rows"] == written["rows"]


def test_bad_options_are_one_line_and_write_nothing(run_bench, dem, tmp_path):
    record = tmp_path / "record.json"
    for arguments, message in [
        (["--area", "0"], "area is 0.0 km2"),
        (["--area", "nan"], "area is nan km2"),
        (["--near", "-1"], "radius is -1.0 km"),
        (["--spacing", "3400"], "too small for a grid of 3400 m"),
        (["--spacing", "-1"], "spacing is -1"),
        (["--queries", "0"], "queries is 0"),
        (["--seed", "-1"], "seed is -1"),
        (["--bounds", "40,10,41,11"], "do not meet the DEM"),
        (["--store", tmp_path / "none.h5"], "none.h5 does not exist"),
        (["--plot", tmp_path / "plot.doc"], ".doc"),
        ([tmp_path / "none.tif"], "none.tif"),
    ]:
        assert_refused(run_bench("scale", dem, "--json", record, *arguments), message)
    assert not list(tmp_path.iterdir())
