"""Building a store of places: eyes, planned or on a grid, each with its skyline all round."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from skyline.arrays import Float32Array
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.pipeline.build import (
    BuildResult,
    Progress,
    RowRenderer,
    held_whole,
    render_missing,
    uniform_plan,
)
from skyline.pipeline.config import header_of
from skyline.places import BINS, Places
from skyline.planning.adaptive import (
    AdaptivePlanner,
    Blocks,
    blocks_of,
    price_of,
    spread_over,
)
from skyline.planning.uniform import MapBounds, map_bounds, uniform_grid
from skyline.render.panorama import DEFAULT_TOLERANCE_DEG, PanoramaRenderer
from skyline.store import StoreHeader, StoreWriter, open_store
from skyline.store.header import PLACES
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints

DEFAULT_LOSS = 0.2
"""Of views, for places lying apart; docs/accuracy.md has what others cost and find."""


@dataclass(frozen=True, slots=True)
class PlaceConfig:
    """How places are rendered.

    Attributes
    ----------
    eye_height_m : float
        Eye above ground.
    tolerance_deg : float
        How far a skyline may fall short of the exact one, degrees of elevation; 0 is exact but
        for float32.
    curvature : Curvature
    """

    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    tolerance_deg: float = DEFAULT_TOLERANCE_DEG
    curvature: Curvature = field(default_factory=Curvature)


@dataclass(frozen=True)
class PlaceRows(RowRenderer[Viewpoints]):
    """Renders viewpoints as places.

    Attributes
    ----------
    tolerance_m : callable
        How far from their eyes, east and north, the places of viewpoints stand for.
    """

    at_a_time = 2048

    renderer: PanoramaRenderer
    tolerance_m: Callable[[Viewpoints], float | Float32Array]

    def render_into(self, writer: StoreWriter, work: Viewpoints) -> None:
        """See `RowRenderer.render_into`."""
        rendered = self.renderer.render(work)
        writer.append_places(Places.of(rendered, self.tolerance_m(work)))

    def missing(self, path: Path, work: Viewpoints) -> Viewpoints:
        """See `RowRenderer.missing`."""
        return work[~held_whole(path, work, 1)]


@dataclass(frozen=True)
class PlannedRows(RowRenderer[Blocks]):
    """Plans blocks and renders their places; each is stored whole, in the order of the blocks."""

    at_a_time = 1

    renderer: PanoramaRenderer
    planner: AdaptivePlanner

    def render_into(self, writer: StoreWriter, work: Blocks) -> None:
        """See `RowRenderer.render_into`."""
        places = self.planner.places(work)
        if places is not None:
            writer.append_places(places, all_or_none=True)

    def missing(self, path: Path, work: Blocks) -> Blocks:
        """See `RowRenderer.missing`."""
        with open_store(path) as store:
            eyes = store.eyes()
        done = np.flatnonzero(work.holding(eyes.easting_m, eyes.northing_m))
        return work[done[-1] + 1 :] if len(done) else work


def place_header(
    terrain: HeightField, renderer: str, config: PlaceConfig, plan: dict[str, object]
) -> StoreHeader:
    """Return the header of a store of places that a renderer, given by its description, fills."""
    settings = {**plan, "rasterizer": "panorama", **asdict(config)}
    return header_of(terrain, renderer, settings, holds=PLACES)


def adaptive_plan(
    loss: float, bounds_deg: tuple[float, float, float, float] | None
) -> dict[str, object]:
    """Return what the config of an adaptive store says of its places."""
    return {"planner": "adaptive", "loss": loss, "bounds_deg": bounds_deg}


def place_rows(
    terrain: HeightField, config: PlaceConfig, spacing_m: float, plan: dict[str, object]
) -> PlaceRows:
    """Return what renders the places of a grid; each stands for half the spacing around it."""
    renderer = _renderer(terrain, config)
    header = place_header(terrain, renderer.description, config, plan)
    return PlaceRows(renderer, header, lambda _: spacing_m / 2.0)


def planned_rows(
    terrain: HeightField,
    config: PlaceConfig,
    loss: float,
    bounds_deg: tuple[float, float, float, float] | None,
) -> PlannedRows:
    """Return what plans and renders places that lose no more than a share of the views.

    Raises
    ------
    InputError
        A loss outside (0, 1), or less than the densest places would lose, or an area of holes.
    """
    area = map_bounds(terrain, bounds_deg)
    spread = spread_over(terrain, area, config.eye_height_m)
    renderer = _renderer(terrain, config)
    price = price_of(loss, renderer.render(spread))
    planner = AdaptivePlanner(terrain, renderer.render, area, price, config.eye_height_m)
    plan = adaptive_plan(loss, bounds_deg)
    return PlannedRows(renderer, place_header(terrain, renderer.description, config, plan), planner)


def _renderer(terrain: HeightField, config: PlaceConfig) -> PanoramaRenderer:
    return PanoramaRenderer(terrain, BINS, config.curvature, config.tolerance_deg)


def refuse_empty(built: BuildResult, path: Path, area: MapBounds) -> BuildResult:
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
    terrain : HeightField
    path : str or Path
        The store.
    spacing_m : float, optional
        Metres between the places of a uniform grid. By default places lie densely where skylines
        are near, and sparsely where they are far; see `skyline.planning.adaptive`.
    bounds_deg : tuple, optional
        W, S, E, N in degrees; by default all of the terrain.
    config : PlaceConfig, optional
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
    config = config or PlaceConfig()
    area = map_bounds(terrain, bounds_deg)
    if spacing_m is None:
        with planned_rows(terrain, config, loss, bounds_deg) as planned:
            built = render_missing(path, planned, blocks_of(area), progress)
        return refuse_empty(built, Path(path), area)
    viewpoints = uniform_grid(terrain, spacing_m, area, config.eye_height_m)
    with place_rows(terrain, config, spacing_m, uniform_plan(spacing_m, bounds_deg)) as rows:
        return render_missing(path, rows, viewpoints, progress)
