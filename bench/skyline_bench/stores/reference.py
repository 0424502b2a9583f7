"""The stores of a comparison: built once in a folder and used again, or given as files."""

import json
import logging
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from skyline.arrays import Float32Array, Float64Array
from skyline.camera import HEADINGS
from skyline.errors import InputError, MissingFileError
from skyline.paper.planning.plan import PlanConfig
from skyline.pipeline.build import BuildResult, render_missing
from skyline.pipeline.config import PlaceConfig, RenderConfig, store_header
from skyline.pipeline.layout import DEFAULT_LOSS, Layout
from skyline.pipeline.places import build_store, place_renderer, place_rows
from skyline.pipeline.planned import build_planned
from skyline.planning.uniform import MapBounds, map_bounds, uniform_grid
from skyline.store import open_store
from skyline.store.header import PLACES
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_log = logging.getLogger(__name__)

_NOTE = ".build.json"
_SECONDS = ("build_s", "build_cpu_s")


@dataclass(frozen=True, slots=True)
class ReferenceStore:
    """A store and what it cost.

    Attributes
    ----------
    name : str
    path : Path
    holds : str
        Renderings or places.
    rows, size_bytes : int
    build_s, build_cpu_s : float or None
        By the clock and of processor time, over all the runs it was built in; None where that
        was not noted.
    """

    name: str
    path: Path
    holds: str
    rows: int
    size_bytes: int
    build_s: float | None
    build_cpu_s: float | None

    @property
    def renderings(self) -> int:
        """Views along a heading; a place counts as four: it looks all the way round."""
        return len(HEADINGS) * self.rows if self.holds == PLACES else self.rows

    @property
    def places(self) -> float:
        """Places, or a quarter of the renderings."""
        return self.renderings / len(HEADINGS)


def check_spacing(
    terrain: HeightField, spacing_m: float | None, bounds_deg: MapBounds | None
) -> None:
    """Refuse a uniform grid that does not fit an area; without a spacing there is none.

    Raises
    ------
    InputError
        A spacing that is not positive, or wider than the area.
    """
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


def uniform_store(
    terrain: HeightField,
    folder: Path,
    spacing_m: float,
    bounds_deg: MapBounds | None,
    config: RenderConfig,
) -> ReferenceStore:
    """Return a uniform store of renderings in a folder, built as far as it is not there yet.

    Raises
    ------
    StoreMismatchError
        The folder has one of that name from another DEM, area or configuration.
    """
    name, layout = f"uniform-{spacing_m:g}", Layout(spacing_m, bounds_deg=bounds_deg)
    path = folder / f"{name}.h5"
    return _built(name, path, lambda: build_store(terrain, path, layout, config))


def place_store(
    terrain: HeightField,
    folder: Path,
    spacing_m: float | None,
    bounds_deg: MapBounds | None,
    config: PlaceConfig,
    progress: Callable[[int, int], None] | None = None,
    loss: float = DEFAULT_LOSS,
) -> ReferenceStore:
    """Return a store of places in a folder, planned without a spacing; as `uniform_store`."""
    name = f"planned-{loss:g}" if spacing_m is None else f"places-{spacing_m:g}"
    layout = Layout(spacing_m, bounds_deg=bounds_deg, loss=loss)
    path = folder / f"{name}.h5"
    return _built(name, path, lambda: build_store(terrain, path, layout, config, progress))


def planned_store(
    terrain: HeightField,
    folder: Path,
    planned: PlanConfig,
    bounds_deg: MapBounds | None,
    config: RenderConfig,
) -> ReferenceStore:
    """Return a planned store in a folder, built as far as it is not there yet.

    It is named by its strategy and, where it has one, its budget. A plan that was followed to its
    end is not worked out again.

    Raises
    ------
    InputError
        An area that cannot be planned.
    StoreMismatchError
        The folder has one of that name from another DEM, area or configuration.
    """
    name = planned.strategy + (f"-{planned.budget}" if planned.budget else "")
    path = folder / f"{name}.h5"
    asked = _as_read(
        {
            "dem": terrain.digest,
            "bounds_deg": bounds_deg,
            "plan": asdict(planned),
            "render": asdict(config),
        }
    )
    if path.exists() and _noted(path).get("followed") == asked:
        return _reference(name, path)
    return _built(
        name,
        path,
        lambda: build_planned(terrain, path, planned, bounds_deg, config).built,
        followed=asked,
    )


def planned_places(terrain: HeightField, folder: Path, planned: ReferenceStore) -> ReferenceStore:
    """Return a store of places at the locations of a planned store; as `uniform_store`.

    A place stands for half the distance to the nearest other. Its cost is the planning's as well.
    """
    with open_store(planned.path) as store:
        there = store.eyes()
    # The headings of one location share its eye.
    eyes = np.unique(np.stack([there.easting_m, there.northing_m, there.eye_elevation_m]), axis=1)
    apart_m = np.asarray(cKDTree(eyes[:2].T).query(eyes[:2].T, k=[2])[0])[:, 0]
    path = folder / f"{planned.name}-places.h5"
    viewpoints = Viewpoints(*np.ascontiguousarray(eyes))
    built = _built(
        planned.name, path, lambda: _render_places(terrain, viewpoints, apart_m / 2.0, path)
    )
    return replace(
        built,
        build_s=_sum(planned.build_s, built.build_s),
        build_cpu_s=_sum(planned.build_cpu_s, built.build_cpu_s),
    )


def _render_places(
    terrain: HeightField, viewpoints: Viewpoints, tolerance_m: Float64Array, path: Path
) -> BuildResult:
    """Render viewpoints as places into a store, each with its own tolerance (N,)."""
    tolerances = tolerance_m.astype(np.float32).tolist()
    of_eye = dict(zip(_eyes(viewpoints), tolerances, strict=True))

    def tolerance(some: Viewpoints) -> Float32Array:
        return np.array([of_eye[eye] for eye in _eyes(some)], dtype=np.float32)

    config = PlaceConfig()
    renderer = place_renderer(terrain, config)
    header = store_header(terrain, renderer.description, config, {"planner": "viewpoints"})
    with place_rows(renderer, header, tolerance) as rows:
        return render_missing(path, rows, viewpoints)


def _eyes(viewpoints: Viewpoints) -> list[complex]:
    eyes: list[complex] = (viewpoints.easting_m + 1j * viewpoints.northing_m).tolist()
    return eyes


def _built(
    name: str, path: Path, build: Callable[[], BuildResult], **about: object
) -> ReferenceStore:
    """Build a store, note beside it what it took over all runs and what is given, and return it."""
    was_there, noted = path.exists(), _noted(path)
    cpu = time.process_time()
    built = build()
    now = built.seconds, time.process_time() - cpu
    taken: dict[str, float | None] = dict(zip(_SECONDS, now, strict=True))
    _log.info("%s: %d of %d rows now", name, built.rendered, built.rows)
    if was_there:
        before = {key: noted.get(key) for key in _SECONDS}
        both = {key: _sum(before[key], taken[key]) for key in _SECONDS}
        taken = both if built.rendered else before
    path.with_suffix(_NOTE).write_text(json.dumps({**taken, **about}) + "\n", encoding="utf-8")
    return _reference(name, path)


def _sum(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else one + other


def _noted(path: Path) -> dict[str, Any]:
    noted = path.with_suffix(_NOTE)
    return dict(json.loads(noted.read_text(encoding="utf-8"))) if noted.exists() else {}


def _as_read(settings: dict[str, object]) -> dict[str, object]:
    """Return settings as they come back from JSON."""
    return dict(json.loads(json.dumps(settings)))


def given_store(terrain: HeightField, path: Path) -> ReferenceStore:
    """Return a store that is there already, under its file's name.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        It lies in another frame than the terrain, so that its places cannot be compared.
    StoreError
        It cannot be read.
    """
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
            *(noted.get(key) for key in _SECONDS),
        )
