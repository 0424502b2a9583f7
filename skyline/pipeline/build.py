"""Rendering viewpoints: into memory, into a store, onto pictures."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Self, TypeVar

import cv2
import numpy as np

from skyline import report
from skyline.camera import HEADINGS
from skyline.features import polyline_keypoints
from skyline.pipeline.config import RenderConfig, make_renderer, store_header
from skyline.pipeline.jobs import Progress
from skyline.planning.adaptive import Blocks
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import ColumnRenderer
from skyline.store import StoreHeader, StoreWriter, create_store, open_for_append, open_store
from skyline.store.header import PLACES
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views


@dataclass(frozen=True, slots=True)
class BuildResult:
    """What a build did.

    Attributes
    ----------
    rows : int
        Renderings or places in the store.
    rendered : int
        Of these, the ones added now; the others were there already.
    """

    rows: int
    rendered: int
    seconds: float


Work = TypeVar("Work", Viewpoints, Blocks)
"""What is rendered: viewpoints, or blocks of the map whose viewpoints are planned."""

VIEWPOINTS_AT_A_TIME = 64


@dataclass(frozen=True)
class RowRenderer(Generic[Work]):
    """Renders viewpoints, or what a planner makes of blocks, as rows of one kind of store."""

    renderer: ColumnRenderer
    """Released at the end of a ``with`` block."""
    header: StoreHeader
    """Of the store that the rows are for."""
    at_a_time: int
    """How much of the work to do between two looks at the progress."""
    render_into: Callable[[StoreWriter, Work], None]
    """Appends the rows of some work to a store."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.renderer.release()


def view_rows(
    terrain: HeightField, config: RenderConfig, plan: dict[str, object]
) -> RowRenderer[Viewpoints]:
    """Return what renders views in all four headings, and their keypoints, by a configuration."""
    renderer = make_renderer(terrain, config)

    def render_into(writer: StoreWriter, viewpoints: Viewpoints) -> None:
        append_views(writer, renderer.render(viewpoints), config)

    header = store_header(terrain, renderer.description, config, plan)
    return RowRenderer(renderer, header, VIEWPOINTS_AT_A_TIME, render_into)


def append_views(writer: StoreWriter, views: Views, config: RenderConfig) -> None:
    """Append views to a store, with their keypoints."""
    writer.append(views, polyline_keypoints(views, config.keypoint_tolerance_px))


def render_views(
    terrain: HeightField, viewpoints: Viewpoints, config: RenderConfig | None = None
) -> Views:
    """Render the skylines of viewpoints to grid north, east, south, west (4 N views)."""
    config = config or RenderConfig()
    with make_renderer(terrain, config) as renderer:
        return renderer.render(viewpoints)


def render_missing(
    path: str | Path, rows: RowRenderer[Work], work: Work, progress: Progress | None = None
) -> BuildResult:
    """Render what a store lacks of some work; the store is made where there is none.

    Raises `StoreMismatchError` where the store at ``path`` was built from another DEM or with
    another configuration.
    """
    if not Path(path).exists():
        with create_store(path, rows.header) as writer:
            return _render_into(writer, rows, work, len(work), progress)
    with open_for_append(path, rows.header) as writer:
        left = missing(path, work)
        return _render_into(writer, rows, left, len(work), progress)


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
    with (
        view_rows(terrain, config, {"planner": "viewpoints"}) as rows,
        create_store(path, rows.header) as writer,
    ):
        return _render_into(writer, rows, viewpoints, len(viewpoints), progress)


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
            report.save_depth_images(images, views, folder / f"{index:04d}.png")


def _render_into(
    writer: StoreWriter,
    rows: RowRenderer[Work],
    left: Work,
    total: int,
    progress: Progress | None,
) -> BuildResult:
    """Render what is left of so much work into a store, a few at a time."""
    started = time.perf_counter()
    held = len(writer)
    for start in range(0, len(left), rows.at_a_time):
        if progress:
            progress(total - len(left) + start, total)
        rows.render_into(writer, left[start : start + rows.at_a_time])
    writer.flush()
    if progress:
        progress(total, total)
    return BuildResult(len(writer), len(writer) - held, time.perf_counter() - started)


def missing(path: str | Path, work: Work) -> Work:
    """Return the work of which a store lacks rows."""
    with open_store(path) as store:
        there, wanted = store.eyes(), rows_each(store.header)
    if isinstance(work, Blocks):
        # A block is stored whole, after those before it.
        done = np.flatnonzero(work.holding(there.easting_m, there.northing_m))
        return work[done[-1] + 1 :] if len(done) else work
    stored, count = np.unique(there.easting_m + 1j * there.northing_m, return_counts=True)
    whole = stored[count >= wanted]
    return work[~np.isin(work.easting_m + 1j * work.northing_m, whole)]


def rows_each(header: StoreHeader) -> int:
    """Return how many rows a viewpoint has in a store: a place, or a rendering a heading."""
    return 1 if header.holds == PLACES else len(HEADINGS)
