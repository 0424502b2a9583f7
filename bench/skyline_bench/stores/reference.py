"""The stores of a comparison: built once in a folder and used again, or given as files."""

import json
import logging
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.spatial import cKDTree

from skyline.arrays import Float32Array
from skyline.camera import HEADINGS
from skyline.errors import InputError, MissingFileError
from skyline.geodesy import Bounds, Rectangle
from skyline.paper.planning.plan import PlanConfig
from skyline.pipeline.build import BuildResult, build_store, render_missing
from skyline.pipeline.config import BuildConfig, PlaceConfig, RenderConfig, store_header
from skyline.pipeline.jobs import Progress
from skyline.pipeline.layout import Layout
from skyline.pipeline.planned import build_planned
from skyline.pipeline.row_renderers import place_rows
from skyline.places import BINS
from skyline.planning.uniform import map_bounds, uniform_grid
from skyline.render.panorama import PanoramaRenderer
from skyline.store import StoreHeader, open_store
from skyline.store.header import PLACES
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
    terrain: HeightField,
    folder: Path,
    layout: Layout,
    config: BuildConfig,
    progress: Progress | None = None,
) -> ReferenceStore:
    """Return a store of a layout in a folder, built as far as it is not there yet."""
    kind = "places" if isinstance(config, PlaceConfig) else "uniform"
    spacing_m = layout.spacing_m
    name = f"planned-{layout.loss:g}" if spacing_m is None else f"{kind}-{spacing_m:g}"
    path = folder / f"{name}.h5"
    return _built(name, path, lambda: build_store(terrain, path, layout, config, progress))


def planned_store(
    terrain: HeightField,
    folder: Path,
    planned: PlanConfig,
    bounds_deg: Bounds | None,
    config: RenderConfig,
) -> ReferenceStore:
    """Return a planned store in a folder, built as far as it is not there yet.

    It is named by its strategy and, where it has one, its budget. A plan that was followed to its
    end is not worked out again.
    """
    name = planned.strategy + (f"-{planned.budget}" if planned.budget else "")
    path = folder / f"{name}.h5"
    settings = [terrain.digest, bounds_deg, asdict(planned), asdict(config)]
    asked = json.loads(json.dumps(settings))
    if path.exists() and _noted(path).get("followed") == asked:
        return _reference(name, path)
    return _built(
        name,
        path,
        lambda: build_planned(terrain, path, planned, bounds_deg, config).built,
        followed=asked,
    )


def planned_places(terrain: HeightField, folder: Path, planned: ReferenceStore) -> ReferenceStore:
    """Return a store of places at the locations of a planned store; as `laid_out_store`.

    A place stands for half the distance to the nearest other. Its cost is the planning's as well.
    """
    with open_store(planned.path) as store:
        there = store.eyes()
    # The headings of one location share its eye.
    eyes = np.unique(np.stack([there.easting_m, there.northing_m, there.eye_elevation_m]), axis=1)
    tree = cKDTree(eyes[:2].T)

    def tolerance(some: Viewpoints) -> Float32Array:
        apart_m = np.asarray(tree.query(np.stack([some.easting_m, some.northing_m], 1), k=[2])[0])
        return (apart_m[:, 0] / 2.0).astype(np.float32)

    def render() -> BuildResult:
        config = PlaceConfig()
        renderer = PanoramaRenderer(terrain, BINS, config.curvature, config.tolerance_deg)
        header = store_header(terrain, renderer.description, config, {"planner": "viewpoints"})
        with place_rows(renderer, header, tolerance) as rows:
            easting_m, northing_m, up_m = np.ascontiguousarray(eyes)
            at = Viewpoints(easting_m=easting_m, northing_m=northing_m, eye_elevation_m=up_m)
            return render_missing(path, rows, at)

    path = folder / f"{planned.name}-places.h5"
    built = _built(planned.name, path, render)
    return replace(
        built,
        build_s=planned.build_s + built.build_s,
        build_cpu_s=planned.build_cpu_s + built.build_cpu_s,
    )


def _built(
    name: str, path: Path, build: Callable[[], BuildResult], **about: object
) -> ReferenceStore:
    """Build a store, note beside it what it took over all runs and what is given, and return it."""
    before = _noted(path) if path.exists() else dict.fromkeys(_SECONDS, 0.0)
    cpu = time.process_time()
    built = build()
    now = (built.seconds, time.process_time() - cpu) if built.rendered else (0.0, 0.0)
    taken = {key: before.get(key, math.nan) + new for key, new in zip(_SECONDS, now, strict=True)}
    _log.info("%s: %d of %d rows now", name, built.rendered, built.rows)
    path.with_suffix(_NOTE).write_text(json.dumps({**taken, **about}) + "\n", encoding="utf-8")
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
            store.committed,
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
