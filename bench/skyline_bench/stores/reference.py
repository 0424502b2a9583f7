"""The stores of a comparison: built once in a folder and used again, or given as files."""

import json
import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.spatial import cKDTree

from skyline.build.cluster import Progress
from skyline.build.grid import map_bounds, uniform_grid
from skyline.build.parts import BuildResult, build_store, build_uniform, finished_store
from skyline.build.plans import PlacePlan, header_of
from skyline.camera import HEADINGS
from skyline.errors import InputError, MissingFileError
from skyline.geodesy import Bounds, Curvature, Rectangle
from skyline.paper.planned import build_planned
from skyline.paper.planning.plan import PlanConfig
from skyline.places import BINS, Places
from skyline.render.horizon import RenderConfig
from skyline.render.panorama import PanoramaRenderer
from skyline.store import StoreHeader, columns_of, open_store, write_store
from skyline.store.format import PLACES
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_log = logging.getLogger(__name__)

_NOTE = ".build.json"
_SECONDS = ("build_s", "build_cpu_s")


@dataclass(frozen=True, slots=True)
class ReferenceStore:
    """A store and what it cost."""

    name: str
    path: Path
    holds: str  # Renderings or places
    rows: int
    size_bytes: int
    # By the clock and of processor time, over all the runs it was built in; NaN where that was not
    # noted.
    build_s: float
    build_cpu_s: float

    @property
    def renderings(self) -> int:
        """Views along a heading; a place counts as four: it looks all the way round."""
        return len(HEADINGS) * self.rows if self.holds == PLACES else self.rows

    @property
    def places(self) -> float:
        """Places, or a quarter of the renderings."""
        return self.renderings / len(HEADINGS)


def check_spacing(terrain: HeightField, spacing_m: float | None, bounds_deg: Bounds | None) -> None:
    """Refuse a uniform grid that does not fit an area; without a spacing there is none."""
    bounds = map_bounds(terrain, bounds_deg)
    if spacing_m is None:
        return
    uniform_grid(terrain, spacing_m, bounds)
    width, height = bounds[2] - bounds[0], bounds[3] - bounds[1]
    if min(width, height) < spacing_m:
        raise InputError(
            f"the area is {width:.0f} x {height:.0f} m, too small for a grid of {spacing_m:g} m; "
            "choose larger bounds or a smaller spacing"
        )


def laid_out_store(
    terrain: HeightField, folder: Path, plan: PlacePlan, progress: Progress | None = None
) -> ReferenceStore:
    """Return a store of places in a folder, built unless it is there."""
    name = f"planned-{plan.loss:g}" if plan.spacing_m is None else f"places-{plan.spacing_m:g}"
    path = folder / f"{name}.h5"
    return _built(name, path, lambda: build_store(terrain, path, plan, progress=progress))


def uniform_renderings(
    terrain: HeightField,
    folder: Path,
    spacing_m: float,
    bounds_deg: Bounds | None = None,
    config: RenderConfig | None = None,
) -> ReferenceStore:
    """Return a store of the renderings of a uniform grid, as `laid_out_store`."""
    name = f"uniform-{spacing_m:g}"
    path = folder / f"{name}.h5"
    return _built(name, path, lambda: build_uniform(terrain, path, spacing_m, bounds_deg, config))


def planned_store(
    terrain: HeightField,
    folder: Path,
    planned: PlanConfig,
    bounds_deg: Bounds | None,
    config: RenderConfig,
) -> ReferenceStore:
    """Return a planned store in a folder, as `laid_out_store`.

    It is named by its strategy and threshold.
    """
    name = f"{planned.strategy}-{planned.threshold_px:g}px"
    path = folder / f"{name}.h5"

    def build() -> BuildResult:
        done = build_planned(terrain, path, planned, bounds_deg, config)
        return BuildResult(0, 0, 0.0) if done is None else done.built

    return _built(name, path, build)


def planned_places(terrain: HeightField, folder: Path, planned: ReferenceStore) -> ReferenceStore:
    """Return a store of places at the locations of a planned store; as `laid_out_store`.

    A place stands for half the distance to the nearest other. Its cost is the planning's as well.
    """
    with open_store(planned.path) as store:
        there = store.eyes()
    # The headings of one location share its eye.
    eyes = np.unique(np.stack([there.easting_m, there.northing_m, there.eye_elevation_m]), axis=1)
    apart_m = np.asarray(cKDTree(eyes[:2].T).query(eyes[:2].T, k=[2])[0])[:, 0]
    path = folder / f"{planned.name}-places.h5"

    def build() -> BuildResult:
        header = header_of(terrain, {"planner": "viewpoints"}, Curvature(), holds=PLACES)
        if path.exists():
            return finished_store(path, header)
        with PanoramaRenderer(terrain, BINS) as renderer:
            started = time.perf_counter()
            easting_m, northing_m, up_m = np.ascontiguousarray(eyes)
            at = Viewpoints(easting_m=easting_m, northing_m=northing_m, eye_elevation_m=up_m)
            rendered = renderer.render(at)
            places = Places.of(rendered, (apart_m / 2.0).astype(np.float32))
            header = replace(header, renderer=renderer.description)
            write_store(path, header, columns_of(header, places))
        return BuildResult(len(places), len(places), time.perf_counter() - started)

    built = _built(planned.name, path, build)
    return replace(
        built,
        build_s=planned.build_s + built.build_s,
        build_cpu_s=planned.build_cpu_s + built.build_cpu_s,
    )


def _built(name: str, path: Path, build: Callable[[], BuildResult]) -> ReferenceStore:
    """Build a store, note beside it the seconds that it took over all runs, and return it."""
    before = _noted(path) if path.exists() else dict.fromkeys(_SECONDS, 0.0)
    cpu = time.process_time()
    built = build()
    now = (built.seconds, time.process_time() - cpu) if built.rendered else (0.0, 0.0)
    taken = {key: before.get(key, math.nan) + new for key, new in zip(_SECONDS, now, strict=True)}
    _log.info("%s: %d of %d rows now", name, built.rendered, built.rows)
    path.with_suffix(_NOTE).write_text(json.dumps(taken) + "\n", encoding="utf-8")
    return _reference(name, path)


def _noted(path: Path) -> dict[str, Any]:
    noted = path.with_suffix(_NOTE)
    return dict(json.loads(noted.read_text(encoding="utf-8"))) if noted.exists() else {}


def given_store(terrain: HeightField, path: Path) -> ReferenceStore:
    """Return a store that is there already, under its file's name."""
    if not path.is_file():
        raise MissingFileError(f"{path} does not exist; give a store that `skyline build` made")
    with open_store(path) as store:
        frame_wkt = store.header.frame_wkt
    if frame_wkt != terrain.frame.wkt:
        raise InputError(
            f"{path} lies in another frame than the DEM, {terrain.frame.name}; give the DEM that "
            "the store was built from"
        )
    return _reference(path.stem, path)


def _reference(name: str, path: Path) -> ReferenceStore:
    noted = _noted(path)
    with open_store(path) as store:
        return ReferenceStore(
            name,
            path,
            store.header.holds,
            len(store),
            path.stat().st_size,
            *(noted.get(key, math.nan) for key in _SECONDS),
        )


def mapped_area_m(header: StoreHeader, terrain: HeightField) -> Rectangle | None:
    """Return the part of a terrain that a store was built for; None where it does not say.

    Bounds that are no box on the terrain count as unsaid, with a warning.
    """
    if "bounds_deg" not in header.config:
        return None
    bounds_deg = header.config["bounds_deg"]
    if bounds_deg is None:
        return map_bounds(terrain, None)
    try:
        west, south, east, north = (float(degrees) for degrees in cast(list[float], bounds_deg))
        return map_bounds(terrain, (west, south, east, north))
    except (TypeError, ValueError) as error:
        _log.warning("the store's own bounds_deg, %r, are of no use: %s", bounds_deg, error)
        return None
