"""Building a store of places: the eyes of a grid, each with its skyline all round."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from skyline.arrays import Float32Array
from skyline.geodesy import Curvature
from skyline.pipeline.build import BuildResult, Progress, RowRenderer, render_missing, uniform_plan
from skyline.pipeline.config import header_of
from skyline.places import BINS, Places
from skyline.planning.uniform import map_bounds, uniform_grid
from skyline.render.panorama import DEFAULT_TOLERANCE_DEG, PanoramaRenderer
from skyline.store import StoreHeader, StoreWriter
from skyline.store.header import PLACES
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints

DEFAULT_SPACING_M = 80.0
"""Between places of a grid; docs/accuracy.md has what others cost and find."""


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
class PlaceRows(RowRenderer):
    """Renders viewpoints as places.

    Attributes
    ----------
    tolerance_m : callable
        How far from their eyes, east and north, the places of viewpoints stand for.
    """

    rows_each = 1
    viewpoints_a_commit = 2048

    renderer: PanoramaRenderer
    tolerance_m: Callable[[Viewpoints], float | Float32Array]

    def render_into(self, writer: StoreWriter, viewpoints: Viewpoints) -> None:
        """See `RowRenderer.render_into`."""
        rendered = self.renderer.render(viewpoints)
        writer.append_places(Places.of(rendered, self.tolerance_m(viewpoints)))


def place_header(
    terrain: HeightField, renderer: str, config: PlaceConfig, plan: dict[str, object]
) -> StoreHeader:
    """Return the header of a store of places that a renderer, given by its description, fills."""
    settings = {**plan, "rasterizer": "panorama", **asdict(config)}
    return header_of(terrain, renderer, settings, holds=PLACES)


def place_rows(
    terrain: HeightField, config: PlaceConfig, spacing_m: float, plan: dict[str, object]
) -> PlaceRows:
    """Return what renders the places of a grid; each stands for half the spacing around it."""
    renderer = PanoramaRenderer(terrain, BINS, config.curvature, config.tolerance_deg)
    header = place_header(terrain, renderer.description, config, plan)
    return PlaceRows(renderer, header, lambda _: spacing_m / 2.0)


def build_places(
    terrain: HeightField,
    path: str | Path,
    spacing_m: float = DEFAULT_SPACING_M,
    bounds_deg: tuple[float, float, float, float] | None = None,
    config: PlaceConfig | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Render the places of a uniform grid into a store; an interrupted build goes on.

    Parameters
    ----------
    terrain : HeightField
    path : str or Path
        The store.
    spacing_m : float
        Between eyes; a place stands for half of it around its eye.
    bounds_deg : tuple, optional
        W, S, E, N in degrees; by default all of the terrain.
    config : PlaceConfig, optional
    progress : callable, optional
        Called with the places done and the places there will be.

    Raises
    ------
    InputError
        A spacing that suits no grid on the terrain.
    StoreMismatchError
        The store at ``path`` holds renderings, or was built from another DEM or with another
        configuration.
    """
    config = config or PlaceConfig()
    area, plan = map_bounds(terrain, bounds_deg), uniform_plan(spacing_m, bounds_deg)
    viewpoints = uniform_grid(terrain, spacing_m, area, config.eye_height_m)
    with place_rows(terrain, config, spacing_m, plan) as rows:
        return render_missing(path, rows, viewpoints, progress)
