"""Non-maximum suppression among hypotheses."""

import numpy as np

from skyline.match.ranking import Hypotheses


def _hypotheses(easting_m: list[float], heading_deg: list[float], score: list[float]) -> Hypotheses:
    zero = np.zeros(len(score))
    return Hypotheses(
        np.array(easting_m),
        zero,
        zero,
        np.array(heading_deg),
        zero,
        zero,
        zero + 60.0,
        zero,
        np.array(score),
    )


def test_the_best_of_a_place_stands_for_it() -> None:
    some = _hypotheses([0.0, 10.0, 500.0, 505.0], [0.0, 90.0, 0.0, 0.0], [2.0, 1.0, 3.0, 3.0])
    assert some.suppress_non_maxima(9, separation_m=100.0).tolist() == [1, 2]


def test_one_place_may_be_seen_in_two_ways() -> None:
    some = _hypotheses([0.0, 0.0, 0.0], [359.0, 2.0, 90.0], [1.0, 2.0, 3.0])
    assert some.suppress_non_maxima(9, separation_m=100.0, turn_deg=10.0).tolist() == [0, 2]


def test_poses_that_fit_nowhere_are_left_out_and_the_count_is_kept() -> None:
    some = _hypotheses([0.0, 500.0, 900.0], [0.0, 0.0, 0.0], [np.inf, 1.0, 2.0])
    assert some.suppress_non_maxima(1, separation_m=1.0).tolist() == [1]
    assert some.suppress_non_maxima(5, separation_m=1.0).tolist() == [1, 2]


def test_parts_are_joined_in_order() -> None:
    one, two = _hypotheses([1.0], [0.0], [5.0]), _hypotheses([2.0], [0.0], [4.0])
    assert Hypotheses.concatenate([one, two]).easting_m.tolist() == [1.0, 2.0]
    assert Hypotheses.concatenate([one, two])[1:].score.tolist() == [4.0]
