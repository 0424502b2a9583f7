"""Jobs on a cluster, without one: what a run does when the scheduler is lost."""

from concurrent.futures import CancelledError
from unittest.mock import Mock

import pytest

from skyline.errors import BuildError
from skyline.survey.cluster import Runner


@pytest.mark.parametrize("lost", [CancelledError(), OSError("stream is closed")], ids=repr)
def test_a_lost_scheduler_ends_the_run(lost):
    future = Mock(**{"exception.return_value": None, "result.side_effect": lost})
    runner = Runner(Mock(**{"submit.return_value": future}))
    outcomes = runner(print, [1, 2], ["job 1", "job 2"])
    with pytest.raises(BuildError, match="scheduler has ended"):
        next(outcomes)
