from .build.parts import BuildResult, build_places, build_uniform, render_to_store
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
from .match.answer import JointResult, MatchResult, to_geodataframe
from .match.candidate import Candidate
from .match.locate import locate
from .match.matcher import Matcher
from .match.matchers import MatchConfig
from .match.orient import Orientation, Orienter, orient
from .match.prior import Narrowing
from .match.screening import Alike
from .photo.correction import Correction, Stroke, StrokeKind
from .photo.exif import NotedPlace
from .photo.lens import Lens
from .photo.projection import Projection
from .photo.query import QuerySkyline
from .photo.read import Photo, read_photo, read_query
from .photo.trace import read_trace, write_trace
from .render.context import RenderThread
from .render.horizon import RenderConfig, render_views
from .report.exports import export_matches
from .report.labelled_panorama import save_panorama
from .report.landscape import PanoramaConfig
from .report.located import write_located
from .report.match_report import report_matches
from .report.overlay import draw_labels
from .report.peaks import Peaks, read_peaks
from .report.pixel_places import PixelPlaces
from .report.relief_tiles import ReliefTiles
from .report.viewer import SeenPeak, Sight, Viewer
from .skylines import Views
from .solar.local_horizons import LocalHorizons, horizon, sky_view_factor
from .store import PlaceMap, Store, StoreHeader, open_store
from .store.places import Places
from .terrain.dem import DemOptions, read_dem
from .terrain.heightfield import HeightField, Provenance
from .terrain.viewpoints import Viewpoints, stand_at, stand_on

__version__: str

__all__ = [
    "Alike",
    "BuildError",
    "BuildResult",
    "Candidate",
    "ContextError",
    "Correction",
    "Curvature",
    "DemOptions",
    "FetchError",
    "Frame",
    "HeightField",
    "InputError",
    "JointResult",
    "Lens",
    "LocalHorizons",
    "MatchConfig",
    "MatchResult",
    "Matcher",
    "MissingFileError",
    "Narrowing",
    "NotedPlace",
    "OffMapError",
    "Orientation",
    "Orienter",
    "PanoramaConfig",
    "Peaks",
    "Photo",
    "PixelPlaces",
    "PlaceMap",
    "Places",
    "Projection",
    "Provenance",
    "QuerySkyline",
    "ReliefTiles",
    "RenderConfig",
    "RenderThread",
    "SeenPeak",
    "Sight",
    "SkylineError",
    "Store",
    "StoreError",
    "StoreHeader",
    "StoreMismatchError",
    "Stroke",
    "StrokeKind",
    "Viewer",
    "Viewpoints",
    "Views",
    "build_places",
    "build_uniform",
    "draw_labels",
    "export_matches",
    "horizon",
    "locate",
    "open_store",
    "orient",
    "read_dem",
    "read_peaks",
    "read_photo",
    "read_query",
    "read_trace",
    "render_to_store",
    "render_views",
    "report_matches",
    "save_panorama",
    "sky_view_factor",
    "stand_at",
    "stand_on",
    "to_geodataframe",
    "write_located",
    "write_trace",
]
