"""What the rows of uniform against adaptive come to, and how they are drawn."""

import numpy as np
import pytest
from PIL import Image

from skyline_bench.figures.plots import draw_costs, save_figure
from skyline_bench.runs.cost_summary import equal_rows, reached_rows


def row(store, matcher, renderings, mean_m, used=None, group="all"):
    return {
        "store": store,
        "planner": store.split("-")[0],
        "matcher": matcher,
        "group": group,
        "renderings": renderings,
        "bytes": used or 1000 * renderings,
        "mean_m": mean_m,
        "mean_m_low": 0.8 * mean_m,
        "mean_m_high": 1.3 * mean_m,
        "median_m": 0.5 * mean_m,
    }


ROWS = [
    row("uniform-512", "paper", 100, 1600.0),
    row("uniform-128", "paper", 1600, 100.0),
    row("uniform-128", "paper", 1600, 1.0, group="close"),
    row("uniform-512", "full", 100, 400.0, 400_000),
    row("uniform-128", "full", 1600, 25.0, 6_400_000),
    row("lpov-100", "paper", 100, 400.0),
    row("lpov-400", "paper", 400, 200.0),
    row("lpov-100", "full", 100, 200.0, 600_000),
    row("lpov-400", "full", 400, 50.0, 2_400_000),
]


def reached(matcher, goal, cost):
    found = [
        one
        for one in reached_rows(ROWS)
        if (one["matcher"], one["goal"], one["cost"]) == (matcher, goal, cost)
    ]
    assert len(found) == 1
    return found[0]


def test_the_cheapest_store_as_good_as_the_finest_grid_is_found():
    one = reached("full", "paper on uniform-128", "renderings")
    assert (one["store"], one["needed"], one["goal_cost"]) == ("lpov-400", 400, 1600)
    assert one["share"] == 0.25
    # The line from (100, 200 m) to (400, 50 m) on logarithmic axes is at 100 m half way.
    assert one["interpolated"] == pytest.approx(200.0)
    in_bytes = reached("full", "paper on uniform-128", "bytes")
    assert in_bytes["share"] == pytest.approx(2_400_000 / 1_600_000)
    assert in_bytes["interpolated"] == pytest.approx(1_200_000)


def test_what_no_store_reaches_is_said():
    one = reached("paper", "paper on uniform-128", "renderings")
    assert [one[key] for key in ("store", "mean_m", "needed", "share", "interpolated")] == [
        None
    ] * 5
    assert one["goal_mean_m"] == 100.0
    assert reached("full", "full on uniform-128", "renderings")["store"] is None


def test_the_cheapest_budget_may_do_and_then_nothing_is_interpolated():
    easy = [row("uniform-512", "full", 100, 400.0), *ROWS[-2:]]
    one = reached_rows(easy)[0]
    assert (one["store"], one["interpolated"]) == ("lpov-100", None)


def test_stores_are_held_to_grids_of_as_many_renderings():
    told = {(one["store"], one["matcher"]): one for one in equal_rows(ROWS)}
    assert len(told) == 4
    assert told["lpov-100", "paper"]["gain"] == pytest.approx(4.0)
    # Half way from 100 to 1600 renderings, and so from 1600 to 100 m.
    assert told["lpov-400", "paper"]["uniform_mean_m"] == pytest.approx(400.0)
    assert told["lpov-400", "full"]["gain"] == pytest.approx(100.0 / 50.0)
    beyond = equal_rows([*ROWS[:2], row("lpov-9000", "paper", 9000, 10.0)])
    assert (beyond[0]["uniform_mean_m"], beyond[0]["gain"]) == (None, None)


def test_costs_are_drawn_one_column_a_matcher_and_legible(tmp_path):
    figure = draw_costs(ROWS)
    assert len(figure.axes) == 4
    for axis in figure.axes:
        low, high = axis.get_ylim()
        assert low < 20.0
        assert high > 1600.0
        assert axis.get_xlabel()
    assert "renderings" in figure.axes[0].get_xlabel()
    assert "MB" in figure.axes[2].get_xlabel()
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["uniform in the paper", "adaptive in the paper", "uniform", "lpov"]
    save_figure(figure, tmp_path / "costs.png")
    assert np.asarray(Image.open(tmp_path / "costs.png").convert("RGB")).std() > 20.0
    save_figure(figure, tmp_path / "costs.svg")
    assert "<svg" in (tmp_path / "costs.svg").read_text()
