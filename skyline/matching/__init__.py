"""Matching: from a query's skyline to a ranked list of places and poses."""

from skyline.matching.hypotheses import Hypotheses
from skyline.matching.narrowing import Narrowing
from skyline.matching.pose import Poses, Scene, refine
from skyline.matching.profiles import Profiles
from skyline.matching.query import Attitudes, QueryRays
from skyline.matching.ranking import Candidate, Ranking
from skyline.matching.refine_config import RefineConfig
from skyline.matching.retrieval import RetrievalConfig, Retriever

__all__ = [
    "Attitudes",
    "Candidate",
    "Hypotheses",
    "Narrowing",
    "Poses",
    "Profiles",
    "QueryRays",
    "Ranking",
    "RefineConfig",
    "RetrievalConfig",
    "Retriever",
    "Scene",
    "refine",
]
