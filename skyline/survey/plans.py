"""Plans of a store: its viewpoints, its jobs, and their renderer."""

import hashlib
import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

import numpy as np

from skyline.arrays import Float64Array, refuse_text
from skyline.errors import InputError, swapped_in_words
from skyline.geodesy.bounds import Bounds, are_bounds, check_bounds
from skyline.geodesy.earth import Curvature
from skyline.geodesy.map_frame import Rectangle
from skyline.render.context import Closeable
from skyline.render.horizon import HorizonRenderer, PanoramaRenderer, RenderConfig
from skyline.render.march import ColumnRenderer
from skyline.skylines import Views, pixel_size, polyline_vertices
from skyline.store.layout import BEGUN, LOST, PLACES, Columns, StoreHeader, columns_of
from skyline.store.places import BINS, Places
from skyline.survey.adaptive_places import (
    LEVELS,
    NODES_AROUND,
    BegunPlaces,
    Prices,
    blocks_of,
    planned_places,
)
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, stand_where_possible

DEFAULT_PLACES = 100_000
"""Default number of places, which two cores without a GPU render in half a minute."""

DEFAULT_LOSSES = (0.05, 0.2)
"""Least and greatest share of views that a default plan loses. A small area gets only as many
places as lose the first share; a large area gets enough to lose no more than the second."""

_KEYPOINT_TOLERANCE_PX = 1.0
"""Greatest distance of a skyline from the polyline whose vertices are its keypoints."""

_log = logging.getLogger(__name__)


Look = Callable[[Viewpoints], Columns]
"""Renders viewpoints, and returns their rows."""


@dataclass(frozen=True, slots=True)
class JobSize:
    """How many viewpoints each piece of a plan's work has."""

    whole: int
    """Viewpoints of a job, which one worker renders: some seconds of work without a GPU."""
    at_once: int
    """Viewpoints that are rendered at once, after which a part can be written: up to a second of
    work without a GPU. With fewer, each takes longer: 16 % with 64 places, 25 % with 36."""


@dataclass(frozen=True, slots=True)
class JobRenderer(Closeable):
    """Renders jobs of one plan."""

    renderer: ColumnRenderer
    header: StoreHeader
    """Header of the store, with the renderer's name."""
    look: Look
    """Renders viewpoints, and returns their rows as begun parts hold them."""
    begun: StoreHeader
    """Header of begun parts."""
    at_once: int
    """The number of viewpoints that ``look`` is called with."""
    rows: Callable[[Any, Look], Columns]
    """Returns the store's rows for a job. Its arguments are the job and a function to use in place
    of ``look``. Every run calls that function with the same viewpoints in the same order."""
    expected: int = 0
    """About how many rows the jobs of the plan render; 0 if each job is given as viewpoints."""

    def close(self) -> None:
        """Free the renderer's memory on the GPU."""
        self.renderer.close()


@dataclass(frozen=True, slots=True)
class PlacePlan:
    """Plan of places, on a uniform grid or adapted to skylines.

    Its settings are the parameters of `skyline.build_places`; ``job_size`` changes no byte of the
    store. Raises `InputError` for both a spacing and a number of places.
    """

    spacing_m: float | None = None
    bounds_deg: Bounds | None = None
    places: int | None = None
    curvature: Curvature = field(default_factory=Curvature)
    job_size: JobSize = JobSize(4096, 512)

    def __post_init__(self) -> None:
        if self.spacing_m is not None and self.places is not None:
            raise InputError("give a spacing (for a uniform grid) or a number of places, not both")
        refuse_text(spacing_m=self.spacing_m, places=self.places)
        # JSON takes no NumPy numbers.
        for name, number in (("spacing_m", float), ("places", int), ("bounds_deg", check_bounds)):
            if (given := getattr(self, name)) is not None:
                object.__setattr__(self, name, number(given))

    def header(self, terrain: HeightField) -> StoreHeader:
        """Return the store's header, without the renderer's name."""
        spread: dict[str, object] = {"planner": "uniform", "spacing_m": self.spacing_m}
        if self.spacing_m is None:
            spread = {"planner": "adaptive", "places": self.places}
        settings = {**spread, "bounds_deg": self.bounds_deg, "rasterizer": "panorama"}
        return header_of(terrain, settings, self.curvature, holds=PLACES)

    def jobs(self, terrain: HeightField) -> list[Viewpoints] | list[tuple[int, int]]:
        """Return the jobs: viewpoints to render, or blocks to plan.

        Raises `InputError` for bounds or a spacing that do not allow a grid, and if there are no
        places.
        """
        area = _area_to_build(terrain, self.bounds_deg)
        if self.spacing_m is not None:
            return _cut(uniform_grid(terrain, self.spacing_m, area), self.job_size)
        if self.places is not None and self.places < 1:
            raise InputError(f"{self.places} places are asked for; expected at least 1")
        return blocks_of(area)

    def opened(self, terrain: HeightField) -> JobRenderer:
        """Return a renderer of the jobs; raises as `Prices`."""
        renderer = PanoramaRenderer(terrain, BINS, self.curvature)
        header = replace(self.header(terrain), renderer=renderer.description)
        at_once = _at_once(renderer, self.job_size)
        if self.spacing_m is None:
            return self._opened_adaptive(terrain, renderer, header, at_once)
        half_m = self.spacing_m / 2.0

        def look(eyes: Viewpoints) -> Columns:
            return columns_of(header, Places.of(renderer.render(eyes), half_m))

        return JobRenderer(renderer, header, look, header, at_once, _looked_at)

    def _opened_adaptive(
        self,
        terrain: HeightField,
        renderer: PanoramaRenderer,
        header: StoreHeader,
        at_once: int,
    ) -> JobRenderer:
        """Return a renderer of blocks, whose price is computed first."""
        area = map_bounds(terrain, self.bounds_deg)
        prices = Prices(terrain, area, lambda eyes: BegunPlaces.of(renderer.render(eyes)))
        price = prices.of_number(self.places or DEFAULT_PLACES)
        if self.places is None:
            densest, sparsest = map(prices.of_loss, DEFAULT_LOSSES)
            price = min(max(price, densest), sparsest)
        begun = replace(header, holds=BEGUN, width=LEVELS)

        def look(eyes: Viewpoints) -> Columns:
            rendered = BegunPlaces.of(renderer.render(eyes))
            return {**columns_of(begun, rendered.places), LOST: rendered.lost}

        def rows(block: tuple[int, int], look: Look) -> Columns:
            def render(eyes: Viewpoints) -> BegunPlaces:
                columns = look(eyes)
                fields: Any = {field: columns[name] for field, name in begun.fields.items()}
                return BegunPlaces(Places(**fields), columns[LOST])

            return columns_of(header, planned_places(terrain, render, area, price, block))

        expected = prices.places(price) + NODES_AROUND * len(blocks_of(area))
        return JobRenderer(renderer, header, look, begun, at_once, rows, expected)


@dataclass(frozen=True, slots=True, eq=False)
class RenderingPlan:
    """Plan of a store of renderings, which the paper's matcher searches."""

    viewpoints: Viewpoints
    """The eyes of the renderings."""
    settings: dict[str, object]
    """Description of the viewpoints, for the header."""
    config: RenderConfig = field(default_factory=RenderConfig)
    job_size: JobSize = JobSize(1024, 64)
    """Does not change a byte of the store."""

    @classmethod
    def given(cls, viewpoints: Viewpoints, config: RenderConfig) -> Self:
        """Return the plan of given viewpoints."""
        eyes = viewpoints.easting_m, viewpoints.northing_m, viewpoints.eye_elevation_m
        digest = hashlib.sha256(b"".join(column.tobytes() for column in eyes)).hexdigest()
        # Each eye has a height of its own.
        about: dict[str, object] = {
            "planner": "viewpoints",
            "viewpoints_digest": digest,
            "eye_height_m": None,
        }
        return cls(viewpoints, about, config)

    @classmethod
    def uniform(
        cls,
        terrain: HeightField,
        spacing_m: float,
        bounds_deg: Bounds | None,
        config: RenderConfig,
    ) -> Self:
        """Return the plan of a uniform grid; raises `InputError` as `uniform_grid`."""
        bounds_deg = None if bounds_deg is None else check_bounds(bounds_deg)
        eyes = uniform_grid(terrain, spacing_m, _area_to_build(terrain, bounds_deg))
        about = {"planner": "uniform", "spacing_m": float(spacing_m), "bounds_deg": bounds_deg}
        return cls(eyes, about, config)

    def header(self, terrain: HeightField) -> StoreHeader:
        """Return the header of the store, without the renderer's name."""
        return rendering_header(terrain, self.settings, self.config)

    def jobs(self, _: HeightField) -> list[Viewpoints]:
        """Return the jobs of the build: viewpoints to render."""
        return _cut(self.viewpoints, self.job_size)

    def opened(self, terrain: HeightField) -> JobRenderer:
        """Return a renderer of the jobs."""
        renderer = HorizonRenderer(terrain, self.config)
        header = replace(self.header(terrain), renderer=renderer.description)

        def look(eyes: Viewpoints) -> Columns:
            return rendering_columns(header, renderer.render(eyes))

        at_once = _at_once(renderer, self.job_size)
        return JobRenderer(renderer, header, look, header, at_once, _looked_at)


Plan = PlacePlan | RenderingPlan


def _at_once(renderer: ColumnRenderer, size: JobSize) -> int:
    """Return how many viewpoints are rendered at once.

    If each rendering loads the terrain anew, these are all viewpoints of a job.
    """
    return size.at_once if renderer.is_resident else size.whole


def _looked_at(eyes: Viewpoints, look: Look) -> Columns:
    """Return the rows of a job that is given as viewpoints."""
    return look(eyes)


def header_of(
    terrain: HeightField, settings: dict[str, object], curvature: Curvature, **rows: Any
) -> StoreHeader:
    """Return the header of a terrain's store, without the renderer's name."""
    return StoreHeader(
        frame_wkt=terrain.frame.wkt,
        dem_digest=terrain.digest,
        dem_files=terrain.provenance.files,
        config={
            "eye_height_m": DEFAULT_EYE_HEIGHT_M,
            **settings,
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
        "keypoint_tolerance_px": _KEYPOINT_TOLERANCE_PX,
    }
    return header_of(terrain, about, config.curvature, width=config.width)


def rendering_columns(header: StoreHeader, views: Views) -> Columns:
    """Return views and their keypoints as a store holds them."""
    tolerance = _KEYPOINT_TOLERANCE_PX * pixel_size(views.width)
    return columns_of(header, views, polyline_vertices(views.v, tolerance))


def map_bounds(field: HeightField, bounds_deg: Bounds | None) -> Rectangle:
    """Return the part of a field inside bounds, or all of it.

    The box in degrees is a curved quadrangle on the map; its bounding rectangle is returned,
    clipped to the field. Raises `InputError` for bounds that are not numbers in order, or that do
    not meet the field.
    """
    if bounds_deg is None:
        return field.bounds_m
    clipped = _clipped(field, bounds_deg)
    if clipped is not None:
        return clipped
    west, south, east, north = bounds_deg
    advice = "name an area inside it, or a DEM of the area"
    other = south, west, north, east
    if are_bounds(*other) and _clipped(field, other) is not None:
        advice = swapped_in_words(*bounds_deg)
    covered = ",".join(f"{side:.4f}" for side in field.box_deg)
    raise InputError(
        f"bounds {west:.6g},{south:.6g},{east:.6g},{north:.6g} do not meet the DEM, which covers "
        f"{covered}; {advice}"
    )


def _area_to_build(field: HeightField, bounds_deg: Bounds | None) -> Rectangle:
    """Return `map_bounds`; warn where a tenth lies outside the field."""
    area = map_bounds(field, bounds_deg)
    if bounds_deg is not None:
        share = _area_m2(area) / _area_m2(field.frame.rectangle_m(bounds_deg))
        # Degrees are curved on the map, so the box of a DEM's own bounds may be a little larger
        # than the DEM.
        if share < 0.9:
            _log.warning(
                "the DEM covers %.0f %% of the bounds, and the store will have only that part; "
                "give a DEM of all of them",
                100.0 * share,
            )
    return area


def _area_m2(rectangle: Rectangle) -> float:
    west, south, east, north = rectangle
    return (east - west) * (north - south)


def _clipped(field: HeightField, bounds_deg: Bounds) -> Rectangle | None:
    """Return the part of a field in bounds, or None."""
    west, south, east, north = field.frame.rectangle_m(bounds_deg)
    left, low, right, high = field.bounds_m
    clipped = (max(west, left), max(south, low), min(east, right), min(north, high))
    return clipped if clipped[0] < clipped[2] and clipped[1] < clipped[3] else None


def uniform_grid(
    field: HeightField, spacing_m: float, bounds_m: Rectangle | None = None
) -> Viewpoints:
    """Return viewpoints at whole multiples of a spacing in the field's frame.

    Areas that overlap share their viewpoints. Locations on holes or off the surface are left out.
    The order is row by row from the north-west. Raises `InputError` for a spacing that is not
    positive, or so large that no viewpoint falls on the surface.
    """
    refuse_text(spacing_m=spacing_m)
    if not (np.isfinite(spacing_m) and spacing_m > 0.0):
        raise InputError(f"spacing is {spacing_m} m; expected a positive number of metres")
    west, south, east, north = bounds_m or field.bounds_m
    easting_m, northing_m = lattice_m((west, south, east, north), spacing_m, most=50_000_000)
    easting, northing = (grid.ravel() for grid in np.meshgrid(easting_m, northing_m))
    eyes, _ = stand_where_possible(field, easting, northing)
    if not len(eyes):
        raise InputError(
            f"no viewpoint of a {spacing_m} m grid falls on the surface in easting {west:.0f} to "
            f"{east:.0f}, northing {south:.0f} to {north:.0f}; choose a smaller spacing"
        )
    return eyes


def lattice_m(
    bounds_m: Rectangle, spacing_m: float, most: int
) -> tuple[Float64Array, Float64Array]:
    """Return a spacing's multiples in bounds: eastings, and northings from north.

    Raises `InputError` for more than ``most`` locations.
    """
    west, south, east, north = (side / spacing_m for side in bounds_m)
    number = (east - west + 1.0) * (north - south + 1.0)
    if not number <= most:
        raise InputError(
            f"{number:.2g} locations {spacing_m:g} m apart are too many; choose a larger spacing "
            "or smaller bounds"
        )
    return (
        np.arange(np.ceil(west), np.floor(east) + 1.0) * spacing_m,
        np.arange(np.floor(north), np.ceil(south) - 1.0, -1.0) * spacing_m,
    )


def _cut(viewpoints: Viewpoints, size: JobSize) -> list[Viewpoints]:
    """Return the jobs of viewpoints, in order."""
    starts = range(0, len(viewpoints), size.whole)
    return [viewpoints[start : start + size.whole] for start in starts]
