"""``--workers``: the same stores and answers as in one process."""

import json

import pytest
from commands import csv_of, trace_of


@pytest.fixture
def traces(tmp_path):
    """Three traces with skylines of their own, and one with none."""
    paths = [trace_of(tmp_path / f"{index}.csv", 5 + 3 * index) for index in range(4)]
    csv_of(paths[3], [], "# width=160 height=120\ncolumn_px,row_px")
    return paths


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("renderings", ("--matcher", "correlation")),
        ("store", ("--matcher", "unrefined", "--heading", "100", "--heading-slack", "120")),
    ],
)
def test_photos_are_matched_by_workers_as_here(run, traces, dask_cluster, request, kind, options):
    store = request.getfixturevalue(kind)
    options = "--fov-deg", "60", "--json", *options
    here = run("match", store, *traces[:3], *options)
    spread = run("match", store, *traces, *options, "--workers", dask_cluster.scheduler_address)
    answers = [[json.loads(line) for line in done.out.splitlines()] for done in (here, spread)]
    failed = answers[1].pop()
    for answer in [*answers[0], *answers[1]]:
        answer.pop("seconds")
        answer.pop("loading_seconds")
    assert answers[0] == answers[1]
    assert [answer["photo"] for answer in answers[0]] == [str(path) for path in traces[:3]]
    assert len({json.dumps(answer["candidates"]) for answer in answers[0]}) == 3
    # The fourth has no skyline; what came before it has been said.
    assert failed == {"photo": str(traces[3]), "error": failed["error"]}
    assert (here.code, spread.code) == (0, 2)
    assert spread.err.count("\n") == 1
    assert "3.csv" in spread.err
