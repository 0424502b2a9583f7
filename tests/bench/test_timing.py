"""Work in turns and over cores: order and counts, never durations."""

import numpy as np
from scenes import field_of, fractal

from skyline.terrain.viewpoints import stand_on
from skyline_bench.measuring.timing import core_count, in_turns, over_cores


def test_work_is_done_in_turns_after_a_warm_up():
    done = []
    ticks = []
    timings = in_turns(
        [lambda: done.append("a"), lambda: done.append("b")], 3, lambda: ticks.append(len(done))
    )
    assert done == ["a", "b"] * 4
    assert ticks == list(range(1, 9))
    assert len(timings) == 2
    assert all(timing.seconds >= 0.0 and timing.cpu_seconds >= 0.0 for timing in timings)


def test_viewpoints_shared_out_come_back_in_order():
    field = field_of(fractal(20, 20))
    viewpoints = stand_on(field, easting_m=np.linspace(0.0, 500.0, 11), northing_m=-200.0)
    parts = over_cores(lambda part: part.easting_m, viewpoints, 4)
    assert [len(part) for part in parts] == [4, 4, 3]
    np.testing.assert_array_equal(np.concatenate(parts), viewpoints.easting_m)
    assert over_cores(len, viewpoints[:0], 4) == []
    assert core_count() >= 1
