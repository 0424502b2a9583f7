"""Plans of a store: its rows, its parts, and the renderer of a part."""

import hashlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

import numpy as np

from skyline.build.grid import map_bounds, uniform_grid
from skyline.build.spacing import AdaptivePlanner, blocks_of, check_loss, price_of
from skyline.geodesy import Bounds, Curvature
from skyline.render.horizon import (
    DEFAULT_TOLERANCE_DEG,
    HorizonRenderer,
    PanoramaRenderer,
    RenderConfig,
)
from skyline.render.march import ColumnRenderer
from skyline.skylines import Views
from skyline.store import StoreHeader, columns_of
from skyline.store.format import PLACES, Columns
from skyline.store.keypoints import polyline_keypoints
from skyline.store.places import BINS, Places
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints

DEFAULT_LOSS = 0.2
"""Share of the views that may be lost because places lie apart; docs/accuracy.md gives the effect
of other shares."""

_PLACES_A_PART = 4096
_VIEWPOINTS_A_PART = 1024
"""Size of a part: some seconds of work without a GPU, which are lost if the process is killed."""

_KEYPOINT_TOLERANCE_PX = 1.0
"""Greatest distance of a skyline from the polyline whose vertices are its keypoints."""


@dataclass(frozen=True, slots=True)
class PartRenderer:
    """Renders parts of one plan; a context manager that releases the renderer."""

    renderer: ColumnRenderer
    header: StoreHeader
    """Header of the parts, with the renderer's name."""
    columns: Callable[[Any], Columns]
    """Returns the rows of a part."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.renderer.release()


@dataclass(frozen=True, slots=True)
class PlacePlan:
    """The plan of a store of places, on a uniform grid or as far apart as the skyline allows.

    Attributes
    ----------
    spacing_m : float, optional
        Distance between the places of a uniform grid. By default places are planned; see
        `skyline.build.spacing`.
    bounds_deg : tuple, optional
        W, S, E, N in degrees; by default all of the terrain.
    loss : float
        Without a spacing: the share of the views, 60 degrees wide, that may be lost because places
        lie apart.
    curvature : Curvature
    """

    spacing_m: float | None = None
    bounds_deg: Bounds | None = None
    loss: float = DEFAULT_LOSS
    curvature: Curvature = field(default_factory=Curvature)

    def header(self, terrain: HeightField) -> StoreHeader:
        """Return the header of the store, without the renderer's name."""
        spread: dict[str, object] = {"planner": "uniform", "spacing_m": self.spacing_m}
        if self.spacing_m is None:
            spread = {"planner": "adaptive", "loss": self.loss}
        settings = {
            **spread,
            "bounds_deg": self.bounds_deg,
            "rasterizer": "panorama",
            "tolerance_deg": DEFAULT_TOLERANCE_DEG,
        }
        return header_of(terrain, settings, self.curvature, holds=PLACES)

    def parts(self, terrain: HeightField) -> list[Viewpoints] | list[tuple[int, int]]:
        """Return the parts of the store: viewpoints, or blocks of the map.

        Raises `InputError` for bounds or a spacing that suit no grid, and for a loss outside 0 to
        1.
        """
        area = map_bounds(terrain, self.bounds_deg)
        if self.spacing_m is not None:
            return _cut(uniform_grid(terrain, self.spacing_m, area), _PLACES_A_PART)
        check_loss(self.loss)
        return blocks_of(area)

    def opened(self, terrain: HeightField) -> PartRenderer:
        """Return a renderer of the parts; raises as `price_of`."""
        renderer = PanoramaRenderer(terrain, BINS, self.curvature)
        header = replace(self.header(terrain), renderer=renderer.description)
        spacing_m = self.spacing_m
        if spacing_m is not None:
            tolerance_m = spacing_m / 2.0
            return PartRenderer(
                renderer,
                header,
                lambda eyes: columns_of(header, Places.of(renderer.render(eyes), tolerance_m)),
            )
        area = map_bounds(terrain, self.bounds_deg)
        price = price_of(self.loss, terrain, area, renderer.render)
        planner = AdaptivePlanner(terrain, renderer.render, area, price)

        def columns(block: tuple[int, int]) -> Columns:
            places = planner.places(block)
            if places is None:
                return {name: np.zeros(0, row) for name, row in header.specs.items()}
            return columns_of(header, places)

        return PartRenderer(renderer, header, columns)


@dataclass(frozen=True, slots=True, eq=False)
class RenderingPlan:
    """The plan of a store of renderings along the four grid headings, for the paper's matcher.

    Attributes
    ----------
    viewpoints : Viewpoints
        The eyes of the renderings.
    settings : dict
        Description of the viewpoints, for the header.
    config : RenderConfig
    """

    viewpoints: Viewpoints
    settings: dict[str, object]
    config: RenderConfig = field(default_factory=RenderConfig)

    @classmethod
    def given(cls, viewpoints: Viewpoints, config: RenderConfig) -> Self:
        """Return the plan of given viewpoints."""
        eyes = viewpoints.easting_m, viewpoints.northing_m, viewpoints.eye_elevation_m
        digest = hashlib.sha256(b"".join(column.tobytes() for column in eyes)).hexdigest()
        return cls(viewpoints, {"planner": "viewpoints", "viewpoints_digest": digest}, config)

    @classmethod
    def uniform(
        cls,
        terrain: HeightField,
        spacing_m: float,
        bounds_deg: Bounds | None,
        config: RenderConfig,
    ) -> Self:
        """Return the plan of a uniform grid; raises `InputError` as `uniform_grid`."""
        eyes = uniform_grid(terrain, spacing_m, map_bounds(terrain, bounds_deg))
        about = {"planner": "uniform", "spacing_m": spacing_m, "bounds_deg": bounds_deg}
        return cls(eyes, about, config)

    def header(self, terrain: HeightField) -> StoreHeader:
        """Return the header of the store, without the renderer's name."""
        return rendering_header(terrain, self.settings, self.config)

    def parts(self, _: HeightField) -> list[Viewpoints]:
        """Return the parts of the store."""
        return _cut(self.viewpoints, _VIEWPOINTS_A_PART)

    def opened(self, terrain: HeightField) -> PartRenderer:
        """Return a renderer of the parts."""
        renderer = HorizonRenderer.of(terrain, self.config)
        header = replace(self.header(terrain), renderer=renderer.description)
        return PartRenderer(
            renderer, header, lambda eyes: rendering_columns(header, renderer.render(eyes))
        )


Plan = PlacePlan | RenderingPlan


def header_of(
    terrain: HeightField, settings: dict[str, object], curvature: Curvature, **rows: Any
) -> StoreHeader:
    """Return the header of a store of a terrain, without the renderer's name."""
    return StoreHeader(
        frame_wkt=terrain.frame.wkt,
        dem_digest=terrain.digest,
        dem_files=terrain.provenance.files,
        config={
            **settings,
            "eye_height_m": DEFAULT_EYE_HEIGHT_M,
            "curvature": asdict(curvature),
            "dem_options": dict(terrain.provenance.options),
        },
        **rows,
    )


def rendering_header(
    terrain: HeightField, settings: dict[str, object], config: RenderConfig
) -> StoreHeader:
    """Return the header of a store of renderings, without the renderer's name."""
    about = {
        **settings,
        "rasterizer": "horizon",
        "width": config.width,
        "tolerance_px": config.tolerance_px,
        "keypoint_tolerance_px": _KEYPOINT_TOLERANCE_PX,
    }
    return header_of(terrain, about, config.curvature, width=config.width)


def rendering_columns(header: StoreHeader, views: Views) -> Columns:
    """Return views and their keypoints as a store holds them."""
    return columns_of(header, views, polyline_keypoints(views, _KEYPOINT_TOLERANCE_PX))


def _cut(viewpoints: Viewpoints, size: int) -> list[Viewpoints]:
    return [viewpoints[first : first + size] for first in range(0, len(viewpoints), size)]
