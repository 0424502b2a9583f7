"""Building a store of places: eyes, of a grid or given, each with its skyline all round."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.geodesy import Curvature
from skyline.pipeline.build import BuildResult, Progress, render_missing, uniform_plan
from skyline.places import BINS, Places
from skyline.planning.uniform import map_bounds, uniform_grid
from skyline.render.panorama import DEFAULT_TOLERANCE_DEG, PanoramaRenderer
from skyline.store import StoreHeader, StoreWriter
from skyline.store.header import PLACES
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints

Tolerance = Callable[[Viewpoints], float | NDArray[np.float32]]

DEFAULT_SPACING_M = 80.0
"""Between places of a grid; docs/accuracy.md has what others cost and find."""

_VIEWPOINTS_A_COMMIT = 2048


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


@dataclass(frozen=True, slots=True)
class PlaceRows:
    """Renders viewpoints as places; a `skyline.pipeline.build.RowRenderer`.

    Attributes
    ----------
    renderer : PanoramaRenderer
    header : StoreHeader
    tolerance_m : callable
        How far from their eyes, east and north, the places of viewpoints stand for.
    """

    renderer: PanoramaRenderer
    header: StoreHeader
    tolerance_m: Tolerance

    rows_each: ClassVar[int] = 1

    @property
    def viewpoints_a_commit(self) -> int:
        """How many to render at a time."""
        return _VIEWPOINTS_A_COMMIT

    def render_into(self, writer: StoreWriter, viewpoints: Viewpoints) -> None:
        """Append the places of viewpoints to a store."""
        rendered = self.renderer.render(viewpoints)
        writer.append_places(Places.of(rendered, self.tolerance_m(viewpoints)))

    def release(self) -> None:
        """Let go of the renderer."""
        self.renderer.release()


def place_header(
    terrain: HeightField, renderer: str, config: PlaceConfig, plan: dict[str, object]
) -> StoreHeader:
    """Return the header of a store of places that a renderer, given by its description, fills."""
    return StoreHeader(
        frame_wkt=terrain.frame.wkt,
        dem_digest=terrain.digest,
        dem_files=terrain.provenance.files,
        config={
            **plan,
            "rasterizer": "panorama",
            **asdict(config),
            "dem_options": dict(terrain.provenance.options),
        },
        renderer=renderer,
        holds=PLACES,
    )


def place_rows(
    terrain: HeightField, config: PlaceConfig, spacing_m: float, plan: dict[str, object]
) -> PlaceRows:
    """Return what renders the places of a grid; each stands for half the spacing around it."""
    return _rows(terrain, config, lambda _: spacing_m / 2.0, plan)


def _rows(
    terrain: HeightField, config: PlaceConfig, tolerance_m: Tolerance, plan: dict[str, object]
) -> PlaceRows:
    renderer = PanoramaRenderer(terrain, BINS, config.curvature, config.tolerance_deg)
    header = place_header(terrain, renderer.description, config, plan)
    return PlaceRows(renderer, header, tolerance_m)


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
    viewpoints = uniform_grid(
        terrain, spacing_m, map_bounds(terrain, bounds_deg), config.eye_height_m
    )
    rows = place_rows(terrain, config, spacing_m, uniform_plan(spacing_m, bounds_deg))
    try:
        return render_missing(path, rows, viewpoints, progress)
    finally:
        rows.release()


def render_places(
    terrain: HeightField,
    viewpoints: Viewpoints,
    tolerance_m: ArrayLike,
    path: str | Path,
    config: PlaceConfig | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Render given viewpoints as places into a store; an interrupted build goes on.

    Parameters
    ----------
    terrain : HeightField
    viewpoints : Viewpoints
        N eyes, each at a place of its own.
    tolerance_m : (N,) or float
        How far around its eye each stands for.
    path : str or Path
        The store.
    config : PlaceConfig, optional
        Its height of the eye is that of the viewpoints.
    progress : callable, optional

    Raises
    ------
    StoreMismatchError
        As `build_places`.
    """
    tolerances = np.broadcast_to(np.asarray(tolerance_m, np.float32), len(viewpoints))
    of_eye = dict(zip(_eyes(viewpoints), tolerances.tolist(), strict=True))

    def tolerance(some: Viewpoints) -> NDArray[np.float32]:
        return np.array([of_eye[eye] for eye in _eyes(some)], dtype=np.float32)

    rows = _rows(terrain, config or PlaceConfig(), tolerance, {"planner": "viewpoints"})
    try:
        return render_missing(path, rows, viewpoints, progress)
    finally:
        rows.release()


def _eyes(viewpoints: Viewpoints) -> list[complex]:
    eyes: list[complex] = (viewpoints.easting_m + 1j * viewpoints.northing_m).tolist()
    return eyes
