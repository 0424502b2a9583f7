"""The stores of a comparison: built once in a folder and used again, or given as files."""

import json
import logging
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from skyline.errors import InputError, MissingFileError
from skyline.pipeline import BuildResult, RenderConfig, build_planned, build_uniform
from skyline.planning.plan import PlanConfig
from skyline.planning.uniform import MapBounds, map_bounds, uniform_grid
from skyline.store import open_store
from skyline.terrain.heightfield import HeightField

_log = logging.getLogger(__name__)

_NOTE = ".build.json"
_SHELLS = "views/shell_"
"""What the names of datasets of shells begin with."""


@dataclass(frozen=True, slots=True)
class ReferenceStore:
    """A store and what it cost.

    Attributes
    ----------
    name : str
    path : Path
    renderings, size_bytes : int
    shell_bytes : int
        Of these bytes, what its distance shells take.
    build_s : float or None
        Over all the runs it was built in; None where that was not noted.
    """

    name: str
    path: Path
    renderings: int
    size_bytes: int
    shell_bytes: int
    build_s: float | None


def check_spacing(terrain: HeightField, spacing_m: float, bounds_deg: MapBounds | None) -> None:
    """Refuse a uniform grid that does not fit an area.

    Raises
    ------
    InputError
        A spacing that is not positive, or wider than the area.
    """
    bounds = map_bounds(terrain, bounds_deg)
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
    bounds_deg: tuple[float, float, float, float] | None,
    config: RenderConfig,
) -> ReferenceStore:
    """Return a uniform store in a folder, built as far as it is not there yet.

    Raises
    ------
    StoreMismatchError
        The folder has one of that name from another DEM, area or configuration.
    """
    shells = max(len(config.shell_edges_m) - 1, 0)
    name = f"uniform-{spacing_m:g}" + (f"-{shells}" if shells else "")
    path = folder / f"{name}.h5"
    was_there = path.exists()
    built = build_uniform(terrain, path, spacing_m, bounds_deg, config)
    _log.info("%s: %d of %d renderings now", name, built.rendered, built.renderings)
    return _reference(name, path, _note(path, built, was_there, {}))


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
    noted, was_there = _noted(path), path.exists()
    if was_there and noted.get("followed") == asked:
        return _reference(name, path, noted["build_s"])
    built = build_planned(terrain, path, planned, bounds_deg, config).built
    _log.info("%s: %d of %d renderings now", name, built.rendered, built.renderings)
    return _reference(name, path, _note(path, built, was_there, {"followed": asked}))


def _note(
    path: Path, built: BuildResult, was_there: bool, about: dict[str, object]
) -> float | None:
    """Note beside a store what it took over all runs, and return it."""
    build_s = _all_runs_s(built, was_there, _noted(path).get("build_s"))
    text = json.dumps({"build_s": build_s, **about}) + "\n"
    path.with_suffix(_NOTE).write_text(text, encoding="utf-8")
    return build_s


def _noted(path: Path) -> dict[str, Any]:
    noted = path.with_suffix(_NOTE)
    return dict(json.loads(noted.read_text(encoding="utf-8"))) if noted.exists() else {}


def _as_read(settings: dict[str, object]) -> dict[str, object]:
    """Return settings as they come back from JSON."""
    return dict(json.loads(json.dumps(settings)))


def _all_runs_s(built: BuildResult, was_there: bool, before_s: float | None) -> float | None:
    """Return what a store took over all runs; None where one of them was not noted."""
    if not was_there:
        return built.seconds
    if not built.rendered:
        return before_s
    return None if before_s is None else before_s + built.seconds


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
    return _reference(path.stem, path, None)


def _reference(name: str, path: Path, build_s: float | None) -> ReferenceStore:
    with open_store(path) as store:
        sizes = store.stored_bytes.items()
        shell_bytes = sum(size for dataset, size in sizes if dataset.startswith(_SHELLS))
        return ReferenceStore(
            name, path, store.committed, path.stat().st_size, shell_bytes, build_s
        )
