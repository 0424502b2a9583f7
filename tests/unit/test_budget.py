"""Planning for a number of renderings: what a threshold takes, and what renderings suffice for."""

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.camera import HEADINGS
from skyline.errors import InputError
from skyline.paper.planning.budget import Outlook, covering_px, spaced_for
from skyline.paper.planning.candidates import Spacing, lay_out
from skyline.paper.planning.coverage import CandidateGrid
from skyline.paper.planning.plan import PlanConfig, plan
from skyline.views import Views

REACH = 6
SPACING = Spacing(coarse_m=300.0, candidate_m=30.0, reach_m=180.0)
DAVOS = (0.0, 0.0, 5_000.0, 10_000.0)


def cones(px_a_candidate):
    """Errors (N, K, K) of views that err in proportion to the distance."""
    step = np.arange(-REACH, REACH + 1)
    return (np.asarray(px_a_candidate)[:, None, None] * np.hypot(step[:, None], step)).astype("f4")


def outlook():
    rates = np.random.default_rng(2).uniform(0.5, 4.0, 60)
    return Outlook(cones(rates), locations=10_000, share=0.95)


def test_a_higher_threshold_takes_fewer_views():
    needed = [outlook().views(threshold) for threshold in (0.1, 1.0, 3.0, 10.0)]
    assert needed == sorted(needed, reverse=True)
    # At 0.1 px every area is its own location.
    assert needed[0] == pytest.approx(2.0 * 0.95 * 10_000)


def test_the_threshold_that_some_views_allow():
    seen = outlook()
    threshold_px = seen.threshold_px(800, 0.5)
    assert seen.views(threshold_px) <= 800 < seen.views(0.999 * threshold_px)
    assert seen.threshold_px(1e9, 0.5) == 0.5
    assert seen.threshold_px(1, 0.5) == pytest.approx(seen.errors.max())


def test_what_a_threshold_took_corrects_the_outlook():
    seen = outlook()
    before = seen.views(6.0)
    seen.learn(3.0, round(1.5 * seen.views(3.0)))
    assert seen.views(6.0) == pytest.approx(1.5 * before, rel=0.01)


def test_the_threshold_that_views_cover_to():
    valid = np.ones((20, 25), dtype=bool)
    valid[3:6, 4:9] = False
    grid = CandidateGrid(valid, REACH)
    viewpoints = np.array([0, 130, 260, 412])
    errors = cones([1.0, 0.7, 2.0, 0.9])
    least = np.full(valid.shape, np.inf)
    for at, one in zip(viewpoints, errors, strict=True):
        row, col = divmod(int(at), 25)
        for down in range(-REACH, REACH + 1):
            for right in range(-REACH, REACH + 1):
                if 0 <= row + down < 20 and 0 <= col + right < 25:
                    value = one[down + REACH, right + REACH]
                    least[row + down, col + right] = min(least[row + down, col + right], value)
    for share in (0.3, 0.6):
        threshold_px = covering_px(grid, viewpoints, errors, share)
        assert np.mean(least[valid] <= threshold_px) >= share
        assert np.mean(least[valid] < threshold_px) < share
    assert covering_px(grid, viewpoints, errors, 1.0) == np.inf


@pytest.mark.parametrize("budget", [30, 200, 800, 2_800, 20_000])
def test_distances_suit_the_budget(budget):
    given = Spacing()
    spacing = spaced_for(given, budget, DAVOS)
    assert spacing.candidate_m >= given.candidate_m
    assert spacing.reach_m >= given.reach_m
    assert spacing.coarse_m >= given.coarse_m
    disc_m2 = np.pi * (spacing.reach_m / 2.0) ** 2
    assert disc_m2 * budget >= 0.99 * len(HEADINGS) * 5_000.0 * 10_000.0
    coarse = len(HEADINGS) * 5_000.0 * 10_000.0 / spacing.coarse_m**2
    assert coarse <= 0.26 * budget


def test_many_renderings_need_no_other_distances():
    assert spaced_for(Spacing(), 7_000, DAVOS) == Spacing()


def views_at(viewpoints, heading):
    shape = (len(viewpoints), 8)
    return Views(
        viewpoints.easting_m,
        viewpoints.northing_m,
        viewpoints.eye_elevation_m,
        heading,
        np.zeros(shape, dtype=np.float32),
        np.full(shape, 100.0, dtype=np.float32),
        np.zeros(shape, dtype=np.uint8),
    )


def rough_in_the_east(views):
    """Errors of views: the farther east, the faster the skyline changes."""
    return cones(0.5 + views.easting_m / 400.0 + 0.2 * views.heading)


@pytest.fixture(scope="module")
def terrain():
    return field_of(fractal(36, 36, relief_m=50.0, seed=1), 30.0)


def run_plan(terrain, name, **options):
    config = PlanConfig(name, SPACING, coverage=0.95, threshold_px=0.5, **options)
    return plan(terrain, views_at, rough_in_the_east, config)


@pytest.mark.parametrize("budget", [160, 320])
@pytest.mark.parametrize("name", ["lpov", "hov"])
def test_a_budget_is_spent_and_not_exceeded(terrain, name, budget):
    done = run_plan(terrain, name, budget=budget)
    assert 0.9 * budget <= done.progress.renderings <= budget
    assert sum(len(one.viewpoints) for one in done.coverages) == done.progress.renderings
    assert done.threshold_px > 0.5
    # The threshold is what the renderings suffice for, in every heading.
    assert min(one.fraction() for one in done.coverages) >= 0.95
    for one in done.coverages:
        assert len(set(one.viewpoints.tolist())) == len(one.viewpoints)


def test_more_renderings_cover_to_a_lower_threshold(terrain):
    few, many = (run_plan(terrain, "lpov", budget=budget) for budget in (160, 320))
    assert many.threshold_px < 0.8 * few.threshold_px


def test_the_threshold_asked_for_is_not_undercut(terrain):
    config = {"coverage": 0.9, "threshold_px": 4.0}
    asked = terrain, views_at, rough_in_the_east
    free = plan(*asked, PlanConfig("lpov", SPACING, **config))
    ample = plan(*asked, PlanConfig("lpov", SPACING, budget=5_000, **config))
    assert ample.threshold_px == 4.0
    for one, other in zip(free.coverages, ample.coverages, strict=True):
        np.testing.assert_array_equal(one.viewpoints, other.viewpoints)


def test_a_budget_that_the_coarse_grid_spends_is_kept(terrain):
    coarse = 4 * len(lay_out(terrain, SPACING).coarse)
    assert run_plan(terrain, "lpov", budget=coarse).progress.renderings == coarse


@pytest.mark.parametrize(
    ("budget", "said"), [(3, "expected at least 4"), (20, "the coarse grid alone takes")]
)
def test_a_budget_that_cannot_be_planned_for_is_refused(terrain, budget, said):
    with pytest.raises(InputError, match=said):
        run_plan(terrain, "lpov", budget=budget)
