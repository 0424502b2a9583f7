"""What fills the rows of a store: views, places of a grid, or places that are planned."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Self, TypeVar

from skyline.arrays import Float32Array
from skyline.errors import InputError
from skyline.features import polyline_keypoints
from skyline.geodesy import Rectangle
from skyline.pipeline.config import (
    BuildConfig,
    RenderConfig,
    make_renderer,
    store_header,
)
from skyline.pipeline.layout import Layout
from skyline.places import BINS, Places
from skyline.planning.adaptive import AdaptivePlanner, Blocks, price_of
from skyline.render.horizon import ColumnRenderer
from skyline.render.panorama import PanoramaRenderer
from skyline.store import StoreHeader, StoreWriter
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

Work = TypeVar("Work", Viewpoints, Blocks)
"""What is rendered: viewpoints, or blocks of the map whose viewpoints are planned."""

VIEWPOINTS_AT_A_TIME = 64
PLACES_AT_A_TIME = 2048


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


def rows_of(
    terrain: HeightField, area: Rectangle, config: BuildConfig, layout: Layout
) -> RowRenderer[Any]:
    """Return what renders a store's rows over an area, and plans them where no spacing is given.

    A place of a grid stands for half the spacing around it; places that are planned lose no more
    than a share of the views.

    Raises `InputError` for a loss outside (0, 1), or less than the densest places would lose, or an
    area of holes, and for renderings without a spacing.
    """
    spacing_m = layout.spacing_m
    if isinstance(config, RenderConfig):
        if spacing_m is None:
            raise InputError("a store of renderings needs a spacing; expected metres, e.g. 500")
        return view_rows(terrain, config, layout.record)
    renderer = PanoramaRenderer(terrain, BINS, config.curvature, config.tolerance_deg)
    header = store_header(terrain, renderer.description, config, layout.record)
    if spacing_m is not None:
        return place_rows(renderer, header, lambda _: spacing_m / 2.0)
    eye_height_m = config.eye_height_m
    price = price_of(layout.loss, terrain, area, renderer.render, eye_height_m)
    planner = AdaptivePlanner(terrain, renderer.render, area, price, eye_height_m)

    def render_into(writer: StoreWriter, blocks: Blocks) -> None:
        # A block is stored whole, in the order of the blocks.
        places = planner.places(blocks)
        if places is not None:
            writer.append_places(places, all_or_none=True)

    return RowRenderer(renderer, header, 1, render_into)


def place_rows(
    renderer: PanoramaRenderer,
    header: StoreHeader,
    tolerance_m: Callable[[Viewpoints], float | Float32Array],
) -> RowRenderer[Viewpoints]:
    """Return what renders viewpoints as places.

    ``tolerance_m`` says how far from their eyes, east and north, the places stand for.
    """

    def render_into(writer: StoreWriter, viewpoints: Viewpoints) -> None:
        rendered = renderer.render(viewpoints)
        writer.append_places(Places.of(rendered, tolerance_m(viewpoints)))

    return RowRenderer(renderer, header, PLACES_AT_A_TIME, render_into)


def view_rows(
    terrain: HeightField, config: RenderConfig, plan: dict[str, object]
) -> RowRenderer[Viewpoints]:
    """Return what renders views in all four headings, and their keypoints, by a configuration."""
    renderer = make_renderer(terrain, config)
    header = store_header(terrain, renderer.description, config, plan)

    def render_into(writer: StoreWriter, viewpoints: Viewpoints) -> None:
        append_views(writer, renderer.render(viewpoints), config)

    return RowRenderer(renderer, header, VIEWPOINTS_AT_A_TIME, render_into)


def append_views(writer: StoreWriter, views: Views, config: RenderConfig) -> None:
    """Append views to a store, with their keypoints."""
    writer.append(views, polyline_keypoints(views, config.keypoint_tolerance_px))
