"""One answer: command, files, report, page and Python give the same numbers and verdict."""

import csv
import io
import json
import re
import sys
from contextlib import redirect_stdout
from types import SimpleNamespace

import pytest
from commands import lonlat_of

from skyline import Matcher, Narrowing, cli, read_dem
from skyline.pose.pose import COLUMNS
from skyline.web.messages import outcome_json


@pytest.fixture(scope="module", params=["answered", "refused"])
def matched(request, store, dem, photo, tmp_path_factory):
    """The JSON of a match, the folder of its files, and the result in Python."""
    folder = tmp_path_factory.mktemp("matched")
    aside = (*lonlat_of(dem, 601_000.0, 5_179_000.0), 0.4)
    near = None if request.param == "answered" else aside
    options = () if near is None else ("--near", ",".join(map(str, near)))
    files = ("--results", folder / "results.csv", "--report", folder / "report")
    words = ("match", store, photo, "--fov-deg", 60, "--json", *files, *options)
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(printed):
        patch.setattr(sys, "argv", ["skyline", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            cli.main()
    assert not stop.value.code
    with Matcher(store, [dem]) as matcher:
        result = matcher.match(photo, fov_deg=60.0, narrowing=Narrowing(near=near))
    record = json.loads(printed.getvalue())
    assert (record["answer"] is None) == (request.param == "refused")
    return record, folder, result


def test_python_has_the_numbers_of_the_command(matched):
    record, _, result = matched
    own = json.loads(json.dumps(result.to_dict()))
    assert own["candidates"] == record["candidates"]
    assert own["answer"] == record["answer"]
    assert own["answer_within_m"] == record["answer_within_m"]
    assert own.get("refusal") == record.get("refusal")


def test_the_row_of_results_has_the_numbers_of_the_command(matched):
    record, folder, _ = matched
    best = record["candidates"][0]
    with (folder / "results.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    shared = row.keys() & best.keys()
    assert {"lon", "lat", "heading_deg", "fov_deg", "radius_m", "confidence"} <= shared
    assert {name: float(row[name]) for name in shared} == {name: best[name] for name in shared}
    assert row["answered"] == ("0" if record["answer"] is None else "1")
    within_m = record["answer_within_m"]
    assert row["within_m"] == ("" if within_m is None else str(within_m))
    assert row["reason"] == record.get("refusal", "")


def test_the_file_of_candidates_has_the_numbers_of_the_command(matched):
    record, folder, _ = matched
    features = json.loads((folder / "report" / "matches.geojson").read_text())["features"]
    points = [one["properties"] for one in features if one["geometry"]["type"] == "Point"]
    assert len(points) == len(record["candidates"])
    for point, candidate in zip(points, record["candidates"], strict=True):
        assert candidate.items() <= point.items()


def test_the_report_has_the_numbers_and_the_verdict_of_the_command(matched):
    record, folder, result = matched
    page = (folder / "report" / "index.html").read_text()
    rows = [re.findall("<td[^>]*>([^<]*)</td>", row) for row in re.findall("<tr>.*?</tr>", page)]
    shown = [row[1 : 1 + len(COLUMNS)] for row in rows if row]
    assert shown == [
        [format(candidate[name], form) for name, form in COLUMNS.values()]
        for candidate in record["candidates"]
    ]
    is_answer = record["answer"] is not None
    assert f'<p class="result {"answer" if is_answer else "refusal"}">' in page
    assert f"{int(is_answer)} of 1 photos answered" in page
    assert (record.get("refusal") or f"within {record['answer_within_m']:g} m") in page
    assert f"confidence {record['candidates'][0]['confidence']:.2f}" in result.to_text()


def test_the_page_has_the_numbers_and_the_verdict_of_the_command(matched, dem):
    record, _, result = matched
    matcher = SimpleNamespace(frame=read_dem([dem]).frame)
    engine = SimpleNamespace(eye_height_m=lambda pose: 2.0, matcher=matcher)
    page = json.loads(json.dumps(outcome_json(result, engine)))
    assert page["answered"] == (record["answer"] is not None)
    assert (page["within_m"], page["refusal"]) == (record["answer_within_m"], record.get("refusal"))
    assert [one["pose"] for one in page["candidates"]] == record["candidates"]
    if record["answer"] is not None:
        near = {200.0: "confidence", 1000.0: "confidence_1km"}[record["answer_within_m"]]
        assert page["confidence"] == record["answer"][near]
