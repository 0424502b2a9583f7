"""Commands refine quickly; the pose of the photo in a file."""

import json

import pytest
from scenes import candidate_at

from skyline import read_dem


@pytest.fixture(scope="module", autouse=True)
def quickly(refined_quickly):
    """Refine quickly in all tests of commands."""


@pytest.fixture(scope="module")
def pose(dem, tmp_path_factory):
    """The true pose of the photo as a person writes it; its heading is from true north."""
    true = candidate_at(601_800.0, 5_178_000.0, 140.0, frame=read_dem([dem]).frame)
    names = ("lon", "lat", "heading_deg", "pitch_deg", "roll_deg", "fov_deg")
    path = tmp_path_factory.mktemp("pose") / "pose.json"
    path.write_text(json.dumps({name: getattr(true, name) for name in names}))
    return path
