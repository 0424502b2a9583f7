"""Builds whose viewpoints a planner chooses, the whole way."""

import pytest
from scenes import field_of, fractal

from skyline.errors import StoreMismatchError
from skyline.paper.build import build_planned
from skyline.paper.plan import PlanConfig
from skyline.render.horizon import RenderConfig
from skyline.store.read import open_store

NARROW = RenderConfig(width=64)


def planned(strategy, **options):
    return PlanConfig(strategy, 400.0, 100.0, threshold_px=1.0, coverage=0.9, **options)


@pytest.fixture(scope="module")
def valley():
    return field_of(fractal(50, 50, relief_m=300.0, seed=6), 40.0)


def rows_of(path):
    with open_store(path) as store:
        views = store.views()
    return list(zip(views.easting_m, views.northing_m, views.heading, strict=True))


@pytest.mark.parametrize("strategy", ["lpov", "rov"])
def test_covers_what_was_asked_and_says_what_holds(valley, tmp_path, strategy):
    path = tmp_path / "s.h5"
    built, plan, proof = build_planned(valley, path, planned(strategy), config=NARROW)
    assert plan.coverage >= 0.9
    assert proof.predicted == plan.coverage
    assert 0.5 < proof.low <= proof.share <= proof.high <= 1.0
    places = rows_of(path)
    assert len(places) == len(set(places)) == built.rows
    if strategy == "rov":
        build_planned(valley, tmp_path / "t.h5", planned("rov", seed=2), config=NARROW)
        assert rows_of(tmp_path / "t.h5") != places


def test_a_store_is_there_at_the_end_of_a_plan_or_not_at_all(valley, tmp_path):
    path, batches = tmp_path / "s.h5", iter(range(3))

    def stop(*_):
        if next(batches) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_planned(valley, path, planned("lpov"), config=NARROW, progress=stop)
    assert list(tmp_path.iterdir()) == []
    build_planned(valley, path, planned("lpov"), config=NARROW)
    before = path.read_bytes()
    assert build_planned(valley, path, planned("lpov"), config=NARROW) is None
    with pytest.raises(StoreMismatchError):
        build_planned(valley, path, planned("rov"), config=NARROW)
    assert path.read_bytes() == before
