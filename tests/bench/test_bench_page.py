"""The page measured small: every figure is there, and a number."""

import json
import shutil

import pytest

from skyline_bench.runs import page


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("chromedriver"), reason="chromium-driver is not installed")
def test_the_page_is_measured(run_bench, tmp_path, monkeypatch):
    monkeypatch.setattr(page, "_WARM_MATCHES", 1)
    record = tmp_path / "page.json"
    done = run_bench("page", "--quick", "--matches", 1, "--json", record)
    assert done.code == 0, done.err
    rows = {row["figure"]: row["value"] for row in json.loads(record.read_text())["rows"]}
    assert {"server ready", "renderings shown a second", "memory a match"} <= rows.keys()
    assert all(isinstance(value, float) for value in rows.values())
    assert rows["renderings shown a second"] > 0.0
