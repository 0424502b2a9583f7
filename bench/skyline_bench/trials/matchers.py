"""The matchers that are compared: the paper's, plain correlation, and ours without and with all."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from skyline.matching.match_config import MatchConfig
from skyline.pipeline.match import Matcher
from skyline.pipeline.matchers import FULL, MATCHERS
from skyline.store.header import RENDERINGS
from skyline.terrain.heightfield import HeightField
from skyline_bench.queries.synthetic import QueryConfig

PAPER, CORRELATION, RETRIEVED = "paper", "correlation", "retrieved"
MATCHING = MatchConfig(fov_slack=QueryConfig().fov_slack)
"""The field of view of synthetic queries is known to 5 %."""

WHAT: Mapping[str, str] = MappingProxyType(
    {
        PAPER: "the paper's: keypoints, Chamfer, RANSAC",
        CORRELATION: "skylines slid along renderings",
        RETRIEVED: "ours, among places, not refined",
        FULL: "ours, among places, refined by rendering",
    }
)
"""Matchers by name, and what they are."""


def searched_by(name: str) -> str:
    """Return what a store must hold for a matcher to search it: places or renderings."""
    return MATCHERS[FULL if name == RETRIEVED else name].searches


def open_matcher(name: str, store: Path, terrain: HeightField) -> Matcher:
    """Open a store for a matcher; raises as `Matcher`."""
    if searched_by(name) == RENDERINGS:
        return Matcher(store, terrain, name, MATCHING)
    return Matcher(store, terrain, FULL, replace(MATCHING, refine=name == FULL))
