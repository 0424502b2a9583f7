"""Matching: from a query's skyline to a ranked list of places and poses.

A matcher is chosen by name from `MATCHERS`; each has its defaults and is a frozen dataclass,
so ``dataclasses.replace`` or its constructor changes them.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from skyline.matching.correlation import CorrelationMatcher
from skyline.matching.hypotheses import Hypotheses
from skyline.matching.narrowing import Narrowing
from skyline.matching.pose import Poses, Scene, refine
from skyline.matching.profiles import Profiles
from skyline.matching.query import Attitudes, QueryRays
from skyline.matching.ranking import Candidate, Matcher, Ranker, Ranking
from skyline.matching.refine_config import RefineConfig
from skyline.matching.retrieval import RetrievalConfig, Retriever
from skyline.paper.matcher import PaperMatcher

MATCHERS: Mapping[str, Callable[[], Matcher]] = MappingProxyType(
    {"paper": PaperMatcher, "correlation": CorrelationMatcher}
)
"""Matchers by the name the command line gives them."""

__all__ = [
    "MATCHERS",
    "Attitudes",
    "Candidate",
    "CorrelationMatcher",
    "Hypotheses",
    "Matcher",
    "Narrowing",
    "PaperMatcher",
    "Poses",
    "Profiles",
    "QueryRays",
    "Ranker",
    "Ranking",
    "RefineConfig",
    "RetrievalConfig",
    "Retriever",
    "Scene",
    "refine",
]
