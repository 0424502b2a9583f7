"""Rendering viewpoints: into memory, into a store, onto pictures."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from skyline.camera import HEADINGS
from skyline.features import polyline_keypoints
from skyline.pipeline.config import RenderConfig, make_renderer, store_header
from skyline.planning.uniform import map_bounds, uniform_grid
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import HorizonRenderer
from skyline.report import save_depth_images
from skyline.store import StoreHeader, StoreWriter, create_store, open_for_append, open_store
from skyline.terrain.heightfield import HeightField
from skyline.terrain.scene import SceneNeeds, scene_needs
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

Progress = Callable[[int, int], None]
"""Called with the renderings done and the renderings there will be."""

_VIEWPOINTS_A_COMMIT = 64


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
    with make_renderer(terrain, config) as renderer:
        plan = uniform_plan(spacing_m, bounds_deg)
        header = store_header(terrain, renderer.description, config, plan)
        return render_missing(path, header, renderer, viewpoints, config, progress)


def uniform_plan(
    spacing_m: float, bounds_deg: tuple[float, float, float, float] | None
) -> dict[str, object]:
    """Return what the config of a uniform store says of its viewpoints."""
    return {"planner": "uniform", "spacing_m": spacing_m, "bounds_deg": bounds_deg}


def render_missing(
    path: str | Path,
    header: StoreHeader,
    renderer: HorizonRenderer,
    viewpoints: Viewpoints,
    config: RenderConfig,
    progress: Progress | None = None,
) -> BuildResult:
    """Render those of some viewpoints that a store lacks; it is made where there is none.

    Raises
    ------
    StoreMismatchError
        The store at ``path`` was built from another DEM or with another configuration.
    """
    if not Path(path).exists():
        with create_store(path, header) as writer:
            return _render_into(writer, renderer, viewpoints, config, progress)
    with open_for_append(path, header) as writer:
        left = viewpoints[~held_whole(path, viewpoints)]
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
        plan: dict[str, object] = {"planner": "viewpoints"}
        header = store_header(terrain, renderer.description, config, plan)
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


def held_whole(path: str | Path, viewpoints: Viewpoints) -> NDArray[np.bool_]:
    """Return which viewpoints the store holds in all four headings, shape (N,)."""
    with open_store(path) as store:
        there = store.locations()
    stored, count = np.unique(there.easting_m + 1j * there.northing_m, return_counts=True)
    whole = stored[count >= len(HEADINGS)]
    return np.isin(viewpoints.easting_m + 1j * viewpoints.northing_m, whole)
