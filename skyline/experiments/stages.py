"""Our matcher taken apart, and the paper's: what prediction, shells and refinement each give."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np

from skyline.experiments.queries import MadeQuery, QueryConfig
from skyline.matching import QueryRays
from skyline.matching.dense import DensifyConfig
from skyline.matching.full import FullMatcher
from skyline.matching.hypotheses import Hypotheses
from skyline.matching.retrieval import Retriever
from skyline.pipeline import MatchConfig, Matcher, MatchResult
from skyline.pipeline.config import check_dem
from skyline.pipeline.match import RenderedScene, too_little, unsure
from skyline.pipeline.predicted import densified
from skyline.store import open_store
from skyline.terrain.heightfield import HeightField

PAPER, STORED, DEPTH, SHELLS, REFINED = "paper", "stored", "depth", "full", "full+refine"
STAGES: Mapping[str, str] = MappingProxyType(
    {
        PAPER: "the paper's: keypoints, Chamfer, RANSAC",
        STORED: "ours on stored skylines alone",
        DEPTH: "ours on predictions from their depth",
        SHELLS: "ours on predictions from shells",
        REFINED: "the same, refined by rendering",
    }
)
"""Matchers by name, each with one thing more than the one before, and what they are."""

READS_SHELLS = frozenset({SHELLS, REFINED})

GROUPS: tuple[tuple[str, ...], ...] = ((PAPER,), (STORED,), (DEPTH,), (SHELLS, REFINED))
"""Matchers measured together, since they share what is retrieved."""

_TOP = 1
"""Candidates asked for: the best is what counts."""


class Stages(Protocol):
    """Matchers that answer a query together."""

    def match(self, query: MadeQuery) -> dict[str, MatchResult]:
        """Return what each matcher found, by its name, with the seconds it took by itself."""
        ...


@contextmanager
def open_stages(names: Sequence[str], store: Path, terrain: HeightField) -> Iterator[Stages]:
    """Open a store for matchers of one of the `GROUPS`, for the block.

    Raises
    ------
    StoreError
        The store cannot be read.
    StoreMismatchError
        It was rendered from another DEM.
    """
    config = MatchConfig(fov_slack=QueryConfig().fov_error)
    if PAPER in names:
        yield _Paper(Matcher(store, terrain, PAPER, config))
        return
    densify = DensifyConfig(pitch_m=np.inf) if STORED in names else config.densify
    with open_store(store) as opened:
        header = opened.header
        check_dem(header, terrain)
        chunks = opened.iter_views()
        if not READS_SHELLS & set(names):
            chunks = (replace(views, shells=None) for views in chunks)
        dense = densified(chunks, header, terrain, densify)
    retriever = _Remembering(dense, config.retrieval)
    unrefined = [name for name in names if name != REFINED]
    matchers = {name: FullMatcher(retriever, None, config.full) for name in unrefined}
    if REFINED not in names:
        yield _Ours(matchers, config)
        return
    scene = RenderedScene(terrain, header, config)
    try:
        yield _Ours(matchers | {REFINED: FullMatcher(retriever, scene, config.full)}, config)
    finally:
        scene.release()


class _Paper:
    def __init__(self, matcher: Matcher) -> None:
        self._matcher = matcher

    def match(self, query: MadeQuery) -> dict[str, MatchResult]:
        return {PAPER: self._matcher.match(query.skyline, top=_TOP)}


class _Ours:
    """Full matchers in order: each goes on from what the one before has retrieved."""

    def __init__(self, matchers: Mapping[str, FullMatcher], config: MatchConfig) -> None:
        self._matchers = matchers
        self._config = config

    def match(self, query: MadeQuery) -> dict[str, MatchResult]:
        started = time.perf_counter()
        if refusal := too_little(query.skyline, self._config):
            return dict.fromkeys(self._matchers, MatchResult(query.skyline, (), 0.0, refusal))
        rays = query.rays()
        results = {}
        for name, matcher in self._matchers.items():
            candidates = tuple(matcher.rank(rays, _TOP))
            refusal = unsure(candidates, self._config)
            seconds = time.perf_counter() - started
            results[name] = MatchResult(query.skyline, candidates, seconds, refusal)
        return results


class _Remembering(Retriever):
    """A retriever that is asked the same twice and works once."""

    _asked: tuple[QueryRays | None, int] = (None, 0)
    _found: Hypotheses | None = None

    def shortlist(self, query: QueryRays, count: int) -> Hypotheses:
        if self._found is None or self._asked[0] is not query or self._asked[1] != count:
            self._asked, self._found = (query, count), super().shortlist(query, count)
        return self._found
