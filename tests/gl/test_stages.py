"""Our matcher taken apart: what each stage reads, and what they share."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.experiments.queries import QueryConfig, make_queries
from skyline.experiments.stages import (
    DEPTH,
    PAPER,
    REFINED,
    SHELLS,
    STAGES,
    STORED,
    open_stages,
)
from skyline.matching.retrieval import Retriever
from skyline.photo import QuerySkyline
from skyline.pipeline import RenderConfig, build_uniform
from skyline.prediction import shell_edges_m

AREA_M = (300.0, 300.0, 1700.0, 1700.0)


@pytest.fixture(scope="module")
def terrain():
    return field_of(fractal(70, 70, relief_m=400.0, seed=6), 30.0, north_m=2100.0)


@pytest.fixture(scope="module")
def stores(terrain, tmp_path_factory):
    """The same viewpoints with shells and without."""
    folder = tmp_path_factory.mktemp("stores")
    for name, edges in (("shells", shell_edges_m(6)), ("bare", ())):
        config = RenderConfig(width=160, shell_edges_m=edges, rows="exact")
        build_uniform(terrain, folder / name, 300.0, None, config)
    return folder


@pytest.fixture(scope="module")
def queries(terrain):
    config = QueryConfig(width_px=240, height_px=360, render_width=640)
    return make_queries(terrain, AREA_M, 3, 1, config)


def places(terrain, store, names, queries):
    with open_stages(names, store, terrain) as stages:
        answers = [stages.match(query) for query in queries]
    return [
        {name: (found.candidates[0].easting_m, found.candidates[0].northing_m)
         for name, found in answer.items()}
        for answer in answers
    ]  # fmt: skip


@pytest.mark.parametrize("name", [STORED, DEPTH, PAPER])
def test_matchers_without_shells_answer_alike_where_there_are_none(terrain, stores, queries, name):
    with_shells, without = (
        places(terrain, stores / store, (name,), queries) for store in ("shells", "bare")
    )
    assert with_shells == without


def test_shells_make_a_difference(terrain, stores, queries):
    with_shells, without = (
        places(terrain, stores / store, (SHELLS,), queries) for store in ("shells", "bare")
    )
    assert with_shells != without


def test_stored_skylines_alone_answer_with_stored_places(terrain, stores, queries, monkeypatch):
    entries = []
    kept = Retriever.__init__

    def noted(self, profiles, config=None):
        entries.append(len(profiles))
        kept(self, profiles, config)

    monkeypatch.setattr(Retriever, "__init__", noted)
    for name in (STORED, DEPTH):
        places(terrain, stores / "shells", (name,), queries[:1])
    stored, predicted = entries
    assert stored == 7 * 7
    assert predicted > 10 * stored


def test_refinement_goes_on_from_what_was_retrieved(terrain, stores, queries, monkeypatch):
    asked = []
    found = Retriever.shortlist

    def counted(self, query, count):
        asked.append(query)
        return found(self, query, count)

    monkeypatch.setattr(Retriever, "shortlist", counted)
    with open_stages((SHELLS, REFINED), stores / "shells", terrain) as stages:
        both = [stages.match(query) for query in queries]
    assert len(asked) == len(queries)
    for answer in both:
        assert list(answer) == [SHELLS, REFINED]
        assert answer[SHELLS].seconds < answer[REFINED].seconds
        assert not answer[SHELLS].candidates[0].refined
        assert answer[REFINED].candidates[0].refined
    with open_stages((REFINED,), stores / "shells", terrain) as stages:
        alone = stages.match(queries[0])
    assert list(alone) == [REFINED]
    assert alone[REFINED].candidates == both[0][REFINED].candidates


def test_too_little_skyline_has_no_candidate(terrain, stores, queries):
    skyline = queries[0].skyline
    hidden = QuerySkyline(
        np.where(np.arange(skyline.width_px) < 40, skyline.row_px, np.nan),
        np.where(np.arange(skyline.width_px) < 40, skyline.confidence, 0.0),
        skyline.width_px,
        skyline.height_px,
        skyline.fov_deg,
    )
    query = replace(queries[0], skyline=hidden)
    for names in ((PAPER,), (SHELLS, REFINED)):
        with open_stages(names, stores / "shells", terrain) as stages:
            for result in stages.match(query).values():
                assert result.candidates == ()
                assert result.answer is None


def test_every_stage_is_known():
    assert list(STAGES) == [PAPER, STORED, DEPTH, SHELLS, REFINED]
