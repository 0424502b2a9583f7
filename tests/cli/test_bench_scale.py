"""``skyline-bench scale`` as a user meets it."""

import json

import cv2

KEYS = {"area_km2", "renderings", "build_s", "bytes", "query_ms"}


def test_areas_are_measured_and_a_larger_one_extrapolated(run_bench, dem, tmp_path):
    record, plot = tmp_path / "record.json", tmp_path / "plot.png"
    done = run_bench(
        "scale", dem, "--quick", "--area", 60, "--area", 20, "--spacing", 500,
        "--queries", 1, "--json", record, "--plot", plot,
    )  # fmt: skip
    assert done.code == 0, done.err
    written = json.loads(record.read_text())
    assert written["bench"] == "scale"
    assert written["machine"]["cores"] > 0
    rows = written["rows"]
    assert [(row["kind"], row["area_km2"]) for row in rows] == [
        ("measured", 2.0), ("measured", 6.0), ("probe", 0.4), ("extrapolated", 10_000.0),
    ]  # fmt: skip
    assert all(row.keys() >= KEYS for row in rows)
    assert all(row["query_ms"] > 0.0 for row in rows if row["kind"] == "measured")
    assert rows[-1]["renderings"] == 16_000_000
    assert rows[-1]["build_s"] > rows[1]["build_s"]
    for assumption in rows[-1]["assumptions"]:
        assert assumption in done.out
    assert "10,000 km2, 50 m apart, 0 shells" in done.out
    assert cv2.imread(str(plot)) is not None


def test_bad_options_are_one_line_and_write_nothing(run_bench, dem, tmp_path):
    record = tmp_path / "record.json"
    for arguments, message in [
        (["--area", "500"], "no area fits: 500 km2"),
        (["--area", "0"], "area is 0.0 km2"),
        (["--area", "nan"], "area is nan km2"),
        (["--area", "2", "--spacing", "3000"], "too small for a grid of 3000 m"),
        (["--spacing", "-1"], "spacing is -1.0 m"),
        (["--shells", "1"], "1 distance shells"),
        (["--shells", "-3"], "-3 distance shells"),
        (["--queries", "0"], "queries is 0"),
        (["--seed", "-1"], "seed is -1"),
        (["--open-limit", "nan"], "limit of opening"),
        (["--plot", tmp_path / "plot.doc"], ".doc"),
        ([tmp_path / "none.tif"], "none.tif"),
    ]:
        done = run_bench("scale", dem, "--json", record, *arguments)
        assert done.code == 2, done
        assert message in done.err
        assert done.err.startswith("error: ")
        assert done.err.count("\n") == 1
        assert done.out == ""
    assert not list(tmp_path.iterdir())
