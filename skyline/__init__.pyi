from .errors import (
    BuildError,
    ContextError,
    FetchError,
    InputError,
    MissingFileError,
    OffMapError,
    SkylineError,
    StoreError,
    StoreMismatchError,
)
from .geodesy import Curvature, Frame
from .matching.match_config import FullConfig, MatchConfig
from .matching.narrowing import Narrowing
from .matching.ranking import Candidate
from .matching.refine_config import RefineConfig
from .matching.retrieval import RetrievalConfig
from .matching.screening import Alike
from .photo import Projection, QuerySkyline, read_query
from .pipeline.build import BuildResult, build_uniform, render_to_store, render_views
from .pipeline.config import RenderConfig
from .pipeline.match import Matcher, MatchResult
from .pipeline.places import PlaceConfig, build_places
from .pipeline.tables import to_geodataframe
from .places import Places
from .store import Locations, PlaceMap, RowCoding, Store, StoreHeader, open_store
from .terrain.dem import DemOptions, read_dem
from .terrain.heightfield import HeightField, Provenance
from .terrain.viewpoints import Viewpoints, stand_on
from .views import Shells, Views

__version__: str

__all__ = [
    "Alike",
    "BuildError",
    "BuildResult",
    "Candidate",
    "ContextError",
    "Curvature",
    "DemOptions",
    "FetchError",
    "Frame",
    "FullConfig",
    "HeightField",
    "InputError",
    "Locations",
    "MatchConfig",
    "MatchResult",
    "Matcher",
    "MissingFileError",
    "Narrowing",
    "OffMapError",
    "PlaceConfig",
    "PlaceMap",
    "Places",
    "Projection",
    "Provenance",
    "QuerySkyline",
    "RefineConfig",
    "RenderConfig",
    "RetrievalConfig",
    "RowCoding",
    "Shells",
    "SkylineError",
    "Store",
    "StoreError",
    "StoreHeader",
    "StoreMismatchError",
    "Viewpoints",
    "Views",
    "build_places",
    "build_uniform",
    "open_store",
    "read_dem",
    "read_query",
    "render_to_store",
    "render_views",
    "stand_on",
    "to_geodataframe",
]
