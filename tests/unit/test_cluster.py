"""Jobs on a cluster, without one: a worker's bench, and a scheduler that is lost."""

import threading
from concurrent.futures import CancelledError
from unittest.mock import Mock

import pytest

from skyline.errors import BuildError, InputError
from skyline.survey.cluster import Bench, Opening, Runner


@pytest.mark.parametrize("lost", [CancelledError(), OSError("stream is closed")], ids=repr)
def test_a_lost_scheduler_ends_the_run(lost):
    future = Mock(**{"exception.return_value": None, "result.side_effect": lost})
    runner = Runner(Mock(**{"submit.return_value": future}))
    outcomes = runner(print, Opening(0, Mock), [1, 2], ["job 1", "job 2"])
    with pytest.raises(BuildError):
        next(outcomes)


@pytest.fixture
def openings():
    """Openings of two tools, ``a`` twice, and what is opened and closed, in order."""
    events = []

    def opening(name):
        def opened():
            events.append(f"open {name}")
            return Mock(**{"close.side_effect": lambda: events.append(f"close {name}")})

        return Opening(name, opened)

    return events, [opening(name) for name in "aab"]


def test_a_bench_opens_a_tool_once_and_closes_it_before_the_next(openings):
    events, some = openings
    bench = Bench()
    for opening in some:
        assert bench.do(lambda tool, item, tell: item, opening, 7, print) == 7
    assert events == ["open a", "close a", "open b"]


def test_a_tool_that_could_not_be_opened_is_opened_by_the_next_job():
    opening = Opening("a", Mock(side_effect=[InputError("no DEM"), Mock()]))
    bench = Bench()
    with pytest.raises(InputError):
        bench.do(lambda *_: 1, opening, None, print)
    assert bench.do(lambda *_: 2, opening, None, print) == 2


def test_the_jobs_of_a_bench_share_a_thread_of_their_own():
    bench, opening = Bench(), Opening("a", Mock)
    threads = {bench.do(lambda *_: threading.get_ident(), opening, None, print) for _ in range(2)}
    assert len(threads) == 1
    assert threads != {threading.get_ident()}
