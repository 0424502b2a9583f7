"""``--workers``: the same stores and answers as in one process."""

import json
import os
import signal

import pytest
from commands import csv_of, trace_of
from distributed import Client

from skyline.survey.cluster import Opening, Runner, local_cluster


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


def test_two_workers_search_for_one_photo_as_one_process_does(run, traces, dask_cluster, store):
    words = "match", store, traces[0], "--fov-deg", "60", "--json", "--matcher", "unrefined"
    here = run(*words).ok()
    there = "--workers", dask_cluster.scheduler_address
    spread = run(*words, *there).ok()
    assert answers_in(spread) == answers_in(here)
    with Client(dask_cluster) as client:
        os.kill(min(client.run(os.getpid).values()), signal.SIGKILL)
    assert answers_in(run(*words, *there).ok()) == answers_in(here)


def answers_in(done):
    """Return the printed records, without times."""
    records = [json.loads(line) for line in done.out.splitlines()]
    return [{k: v for k, v in one.items() if not k.endswith("seconds")} for one in records]


def die_once(tool, mark, _):
    """End the worker, the first time."""
    if not mark.exists():
        mark.touch()
        os._exit(1)
    return "alive"


class NoTool:
    """A tool of nothing."""

    def close(self):
        """Free nothing."""


def test_another_worker_answers_for_one_that_dies(dask_cluster, tmp_path):
    assert answer_after_death(dask_cluster, tmp_path / "died") == "alive"


def test_the_only_worker_answers_when_it_is_back_after_its_death(tmp_path):
    with local_cluster(1) as cluster:
        assert answer_after_death(cluster, tmp_path / "died") == "alive"


def answer_after_death(cluster, mark):
    """Return what a cluster answers if the first worker that is asked dies."""
    with Client(cluster) as client:
        return Runner(client).ask(die_once, Opening("nothing", NoTool), mark, 1)
