"""The one place that ties renderer, store, planner, photo and matcher together."""

from skyline.pipeline.batch import match_many
from skyline.pipeline.build import (
    BuildResult,
    Progress,
    explain_scene,
    render_to_store,
    render_views,
    save_depth_pictures,
)
from skyline.pipeline.cluster import local_runner, remote_runner
from skyline.pipeline.config import PlaceConfig, RenderConfig
from skyline.pipeline.layout import Layout
from skyline.pipeline.local_horizons import DEFAULT_STEP_DEG, horizon, horizons_of
from skyline.pipeline.match import Matcher
from skyline.pipeline.matchers import FULL, MATCHERS
from skyline.pipeline.panorama import PanoramaConfig, save_panorama
from skyline.pipeline.places import build_places, build_store, build_uniform
from skyline.pipeline.planned import PlannedResult, build_planned
from skyline.pipeline.queries import Query, listed
from skyline.pipeline.reports import matched, report_matches
from skyline.pipeline.results import JointResult, MatchResult
from skyline.pipeline.shards import build_sharded

__all__ = [
    "DEFAULT_STEP_DEG",
    "FULL",
    "MATCHERS",
    "BuildResult",
    "JointResult",
    "Layout",
    "MatchResult",
    "Matcher",
    "PanoramaConfig",
    "PlaceConfig",
    "PlannedResult",
    "Progress",
    "Query",
    "RenderConfig",
    "build_places",
    "build_planned",
    "build_sharded",
    "build_store",
    "build_uniform",
    "explain_scene",
    "horizon",
    "horizons_of",
    "listed",
    "local_runner",
    "match_many",
    "matched",
    "remote_runner",
    "render_to_store",
    "render_views",
    "report_matches",
    "save_depth_pictures",
    "save_panorama",
]
