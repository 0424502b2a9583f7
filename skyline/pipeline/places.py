"""Building stores: of places, planned or on a grid, each with its skyline all round.

A store of renderings, for the paper's matcher, is built on a grid too, or as `planned.py` says.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from skyline.arrays import Float32Array
from skyline.errors import InputError
from skyline.geodesy import Rectangle
from skyline.pipeline.build import BuildResult, RowRenderer, render_missing, view_rows
from skyline.pipeline.config import BuildConfig, PlaceConfig, RenderConfig, store_header
from skyline.pipeline.jobs import Progress
from skyline.pipeline.layout import DEFAULT_LOSS, Layout
from skyline.places import BINS, Places
from skyline.planning.adaptive import AdaptivePlanner, Blocks, price_of, spread_over
from skyline.planning.uniform import map_bounds
from skyline.render.panorama import PanoramaRenderer
from skyline.store import StoreHeader, StoreWriter
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

PLACES_AT_A_TIME = 2048


def place_renderer(terrain: HeightField, config: PlaceConfig) -> PanoramaRenderer:
    """Return the renderer a configuration asks for."""
    return PanoramaRenderer(terrain, BINS, config.curvature, config.tolerance_deg)


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


def rows_of(terrain: HeightField, config: BuildConfig, layout: Layout) -> RowRenderer[Any]:
    """Return what renders the rows of a store, and plans them where no spacing is given.

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
    if spacing_m is not None:
        renderer = place_renderer(terrain, config)
        header = store_header(terrain, renderer.description, config, layout.record)
        return place_rows(renderer, header, lambda _: spacing_m / 2.0)
    area = map_bounds(terrain, layout.bounds_deg)
    spread = spread_over(terrain, area, config.eye_height_m)
    renderer = place_renderer(terrain, config)
    header = store_header(terrain, renderer.description, config, layout.record)
    price = price_of(layout.loss, renderer.render(spread))
    planner = AdaptivePlanner(terrain, renderer.render, area, price, config.eye_height_m)

    def render_into(writer: StoreWriter, blocks: Blocks) -> None:
        # A block is stored whole, in the order of the blocks.
        places = planner.places(blocks)
        if places is not None:
            writer.append_places(places, all_or_none=True)

    return RowRenderer(renderer, header, 1, render_into)


def build_store(
    terrain: HeightField,
    path: str | Path,
    layout: Layout,
    config: BuildConfig,
    progress: Progress | None = None,
) -> BuildResult:
    """Render what a store lacks of a layout, in this process; raises as `build_places`."""
    work = layout.work(terrain, config.eye_height_m)
    with rows_of(terrain, config, layout) as rows:
        built = render_missing(path, rows, work, progress)
    return refuse_empty(built, Path(path), map_bounds(terrain, layout.bounds_deg))


def refuse_empty(built: BuildResult, path: Path, area: Rectangle) -> BuildResult:
    """Return what a plan came to; a store without places is removed, and `InputError` raised."""
    if built.rows:
        return built
    path.unlink()
    west, south, east, north = area
    raise InputError(
        f"the area is {east - west:.0f} x {north - south:.0f} m, and no planned place falls on the "
        "surface in it; choose a larger area, a smaller loss, or the spacing of a uniform grid"
    )


def build_places(
    terrain: HeightField,
    path: str | Path,
    spacing_m: float | None = None,
    bounds_deg: tuple[float, float, float, float] | None = None,
    config: PlaceConfig | None = None,
    progress: Progress | None = None,
    *,
    loss: float = DEFAULT_LOSS,
) -> BuildResult:
    """Render places into a store; an interrupted build goes on.

    Parameters
    ----------
    path : str or Path
        The store.
    spacing_m : float, optional
        Metres between the places of a uniform grid. By default places lie densely where skylines
        are near, and sparsely where they are far; see `skyline.planning.adaptive`.
    bounds_deg : tuple, optional
        W, S, E, N in degrees; by default all of the terrain.
    progress : callable, optional
        Called with how much of the area is done, and with how much there is.
    loss : float
        Without a spacing: the share of the views, 60 degrees wide, that may be lost because
        places lie apart. The smaller the share, the more places.

    Raises
    ------
    InputError
        A spacing that suits no grid on the terrain, a loss that no places come down to, or an
        area so small that no place falls in it.
    StoreMismatchError
        The store at ``path`` holds renderings, or was built from another DEM or with another
        configuration.
    """
    layout = Layout(spacing_m, bounds_deg=bounds_deg, loss=loss)
    return build_store(terrain, path, layout, config or PlaceConfig(), progress)


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
    layout = Layout(spacing_m, bounds_deg=bounds_deg)
    return build_store(terrain, path, layout, config or RenderConfig(), progress)
