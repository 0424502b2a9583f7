"""The one place that ties renderer, store, photo and matcher together."""

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from skyline.camera import DEFAULT_WIDTH, HEADINGS
from skyline.errors import InputError
from skyline.features import polyline_keypoints
from skyline.geodesy import Curvature, Frame
from skyline.matching import MATCHERS, Candidate, Profiles, QueryRays
from skyline.photo import QuerySkyline, read_query
from skyline.planning.uniform import map_bounds, uniform_grid
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import HorizonRenderer
from skyline.report import save_depth_images
from skyline.store import Store, StoreHeader, StoreWriter, create_store, open_for_append, open_store
from skyline.terrain.heightfield import HeightField
from skyline.terrain.scene import SceneNeeds, scene_needs
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints
from skyline.views import Views

Progress = Callable[[int, int], None]
"""Called with the renderings done and the renderings there will be."""

_VIEWPOINTS_A_COMMIT = 64
_ROWS_A_READ = 1024


@dataclass(frozen=True, slots=True)
class RenderConfig:
    """How skylines are rendered.

    Attributes
    ----------
    width : int
        Columns W of a view.
    tolerance_px : float
        How far a skyline may fall short of the exact one; 0 is exact but for float32.
    eye_height_m : float
        Eye above ground, where a viewpoint does not say.
    shell_edges_m : tuple of float
        Edges of distance shells to render and keep beside the skylines; empty for none.
    reach_m : float
        Shells keep what could surface within this distance of a viewpoint.
    keypoint_tolerance_px : float
        How far a skyline may be from the polyline whose vertices are its keypoints.
    curvature : Curvature
    """

    width: int = DEFAULT_WIDTH
    tolerance_px: float = 0.05
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    shell_edges_m: tuple[float, ...] = ()
    reach_m: float = 300.0
    keypoint_tolerance_px: float = 1.0
    curvature: Curvature = field(default_factory=Curvature)


@dataclass(frozen=True, slots=True)
class BuildResult:
    """What a build did.

    Attributes
    ----------
    renderings : int
        Renderings in the store.
    rendered : int
        Of these, the ones rendered now; the others were there already.
    seconds : float
    """

    renderings: int
    rendered: int
    seconds: float


def render_views(
    terrain: HeightField, viewpoints: Viewpoints, config: RenderConfig | None = None
) -> Views:
    """Render the skylines of viewpoints in all four headings (4 N views)."""
    config = config or RenderConfig()
    with make_renderer(terrain, config) as renderer:
        return renderer.render(viewpoints)


def explain(
    terrain: HeightField, eye: Viewpoints, config: RenderConfig | None = None
) -> tuple[SceneNeeds, Views]:
    """Return what one viewpoint's skyline needs, and its views at tolerance 0 and as configured.

    The four exact views come first, the four of the configuration after them.
    """
    config = config or RenderConfig()
    # What the tolerance leaves out shows only in skylines that were rendered without it.
    exact = render_views(terrain, eye, replace(config, tolerance_px=0.0))
    given = render_views(terrain, eye, config)
    needs = scene_needs(terrain, eye, config.width, config.tolerance_px, config.curvature)
    return needs, Views.concatenate([exact, given])


def build_uniform(
    terrain: HeightField,
    path: str | Path,
    spacing_m: float,
    bounds_deg: tuple[float, float, float, float] | None = None,
    config: RenderConfig | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Render a uniform grid into a store; an interrupted build goes on where it stopped.

    Raises
    ------
    StoreMismatchError
        The store at ``path`` was built from another DEM or with another configuration.
    """
    config = config or RenderConfig()
    viewpoints = uniform_grid(
        terrain, spacing_m, map_bounds(terrain, bounds_deg), config.eye_height_m
    )
    plan = {"planner": "uniform", "spacing_m": spacing_m, "bounds_deg": bounds_deg}
    with make_renderer(terrain, config) as renderer:
        header = store_header(terrain, renderer, config, plan)
        if not Path(path).exists():
            with create_store(path, header) as writer:
                return _render_into(writer, renderer, viewpoints, config, progress)
        with open_for_append(path, header) as writer:
            left = viewpoints[~_held(path, viewpoints)]
            return _render_into(writer, renderer, left, config, progress)


def render_to_store(
    terrain: HeightField,
    viewpoints: Viewpoints,
    path: str | Path,
    config: RenderConfig | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Render given viewpoints into a new store.

    Raises
    ------
    StoreError
        Something is at ``path`` already.
    """
    config = config or RenderConfig()
    with make_renderer(terrain, config) as renderer:
        header = store_header(terrain, renderer, config, {"planner": "viewpoints"})
        with create_store(path, header) as writer:
            return _render_into(writer, renderer, viewpoints, config, progress)


def save_depth_pictures(
    terrain: HeightField, viewpoints: Viewpoints, folder: Path, config: RenderConfig
) -> None:
    """Save depth images (TIFF, float32 metres, inf = sky) and a picture of each viewpoint.

    The files are ``NNNN_heading_H.tif`` and ``NNNN.png``, numbered in the viewpoints' order.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with DepthRenderer(terrain, config.width, config.curvature) as renderer:
        for index in range(len(viewpoints)):
            images = renderer.depth_images(viewpoints, index)
            for heading in HEADINGS:
                cv2.imwrite(str(folder / f"{index:04d}_heading_{heading}.tif"), images[heading])
            views = renderer.render(viewpoints[index : index + 1])
            save_depth_images(images, views, folder / f"{index:04d}.png")


def make_renderer(terrain: HeightField, config: RenderConfig) -> HorizonRenderer:
    """Return the renderer a configuration asks for."""
    return HorizonRenderer(
        terrain,
        config.width,
        config.curvature,
        config.tolerance_px,
        config.shell_edges_m or None,
        config.reach_m,
    )


def store_header(
    terrain: HeightField, renderer: HorizonRenderer, config: RenderConfig, plan: dict[str, object]
) -> StoreHeader:
    """Return the header of a store that a renderer fills by a plan."""
    return StoreHeader(
        frame_wkt=terrain.frame.wkt,
        dem_digest=terrain.digest,
        dem_files=terrain.provenance.files,
        config={**plan, "rasterizer": "horizon", **asdict(config)},
        renderer=renderer.description,
        width=config.width,
        shell_edges_m=config.shell_edges_m,
    )


def _render_into(
    writer: StoreWriter,
    renderer: HorizonRenderer,
    viewpoints: Viewpoints,
    config: RenderConfig,
    progress: Progress | None,
) -> BuildResult:
    """Render viewpoints into a store, a few a commit."""
    started = time.perf_counter()
    held = len(writer)
    total = held + len(HEADINGS) * len(viewpoints)
    for start in range(0, len(viewpoints), _VIEWPOINTS_A_COMMIT):
        if progress:
            progress(len(writer), total)
        views = renderer.render(viewpoints[start : start + _VIEWPOINTS_A_COMMIT])
        writer.append(views, polyline_keypoints(views, config.keypoint_tolerance_px))
    writer.flush()
    if progress:
        progress(len(writer), total)
    return BuildResult(len(writer), len(writer) - held, time.perf_counter() - started)


def _held(path: str | Path, viewpoints: Viewpoints) -> NDArray[np.bool_]:
    """Return which viewpoints the store holds in all four headings, shape (N,)."""
    with open_store(path) as store:
        there = store.locations()
    stored, count = np.unique(there.easting_m + 1j * there.northing_m, return_counts=True)
    whole = stored[count >= len(HEADINGS)]
    return np.isin(viewpoints.easting_m + 1j * viewpoints.northing_m, whole)


@dataclass(frozen=True, slots=True)
class MatchResult:
    """What was found for one query.

    Attributes
    ----------
    query : QuerySkyline
        The skyline that was matched.
    candidates : tuple of Candidate
        Best first; headings from grid north.
    seconds : float
        From the query to the candidates.
    """

    query: QuerySkyline
    candidates: tuple[Candidate, ...]
    seconds: float

    @property
    def answer(self) -> Candidate | None:
        """The best candidate, if there is any."""
        return self.candidates[0] if self.candidates else None


class Matcher:
    """Matches query skylines to a store, which is read once.

    Parameters
    ----------
    store : str or Path
    matcher : str
        A name of `skyline.matching.MATCHERS`.

    Raises
    ------
    InputError
        No such matcher, or a store without renderings.
    StoreError
        The store cannot be read.
    """

    def __init__(self, store: str | Path, matcher: str = "paper") -> None:
        if matcher not in MATCHERS:
            raise InputError(f"matcher is {matcher!r}; expected one of {', '.join(MATCHERS)}")
        self._matcher = MATCHERS[matcher]()
        with open_store(store) as opened:
            self.header = opened.header
            self._profiles = Profiles.from_views(_chunks(opened))
        self.frame = Frame(self.header.frame_wkt)

    @property
    def viewpoints(self) -> Viewpoints:
        """The store's locations."""
        profiles = self._profiles
        return Viewpoints(profiles.easting_m, profiles.northing_m, profiles.eye_elevation_m)

    def match(
        self, query: str | Path | QuerySkyline, fov_deg: float | None = None, top: int = 5
    ) -> MatchResult:
        """Find where a photo, a sky mask, a trace or a query skyline was taken.

        Parameters
        ----------
        query : path or QuerySkyline
        fov_deg : float, optional
            Horizontal field of view; by default the query's own.
        top : int
            How many candidates to return at most.

        Raises
        ------
        InputError
            The query has no usable skyline, or its field of view is not known.
        """
        started = time.perf_counter()
        if not isinstance(query, QuerySkyline):
            query = read_query(query, fov_deg)
        elif fov_deg is not None:
            query = query.with_fov(fov_deg)
        candidates = self._matcher.rank(self._profiles, _rays(query), top)
        return MatchResult(query, tuple(candidates), time.perf_counter() - started)


def _rays(query: QuerySkyline) -> QueryRays:
    if query.fov_deg is None:
        raise InputError(
            "the query's field of view is not known: it is not in the image; give --fov-deg"
        )
    u, v = query.image_plane()
    trusted = np.isfinite(query.row_px)
    return QueryRays(u, v, query.confidence[trusted], query.fov_deg)


def _chunks(store: Store) -> Iterable[tuple[Views, NDArray[np.uint16]]]:
    for start in range(0, store.committed, _ROWS_A_READ):
        rows = slice(start, min(start + _ROWS_A_READ, store.committed))
        yield store.views(rows), store.keypoint_columns(rows)
