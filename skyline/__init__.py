"""A photo of mountains in, a place on the map out.

>>> from skyline import Matcher, build_places, read_dem
>>> build_places(read_dem(["dem.tif"]), "store.h5")
>>> answer = Matcher("store.h5").match("photo.jpg", fov_deg=60.0).answer
"""

from importlib.metadata import version

from skyline.errors import SkylineError
from skyline.geodesy import Curvature, Frame
from skyline.matching import Candidate, Narrowing
from skyline.pipeline import (
    MatchConfig,
    Matcher,
    MatchResult,
    PlaceConfig,
    RenderConfig,
    build_places,
    build_uniform,
    render_to_store,
    render_views,
)
from skyline.store import open_store
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline.views import Views

__version__ = version("skyline")

__all__ = [
    "Candidate",
    "Curvature",
    "DemOptions",
    "Frame",
    "HeightField",
    "MatchConfig",
    "MatchResult",
    "Matcher",
    "Narrowing",
    "PlaceConfig",
    "RenderConfig",
    "SkylineError",
    "Viewpoints",
    "Views",
    "build_places",
    "build_uniform",
    "open_store",
    "read_dem",
    "render_to_store",
    "render_views",
    "stand_on",
]
