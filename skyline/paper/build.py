"""Stores of renderings whose viewpoints a strategy of the paper chooses."""

import time
from dataclasses import replace
from pathlib import Path

from skyline.errors import StoreMismatchError
from skyline.geodesy.bounds import Bounds
from skyline.paper.plan import CoveragePlan, PlanConfig, plan
from skyline.paper.plan_check import Verification, verify_coverage
from skyline.progress import Progress
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.store.layout import StoreHeader
from skyline.store.merge import sorted_once
from skyline.store.write import check_store_path, write_store
from skyline.survey.build import BuildResult, finished_store
from skyline.survey.plans import map_bounds, rendering_columns, rendering_header
from skyline.terrain.heightfield import HeightField


def build_planned(
    terrain: HeightField,
    path: str | Path,
    planned: PlanConfig,
    bounds_deg: Bounds | None = None,
    config: RenderConfig | None = None,
    progress: Progress | None = None,
) -> tuple[BuildResult, CoveragePlan, Verification] | None:
    """Let a strategy choose viewpoints that cover an area; store their renderings.

    The store is written at the end of the plan. Returns the build, the plan, and the share of its
    coverage that renderings confirm; None if the store already exists with the same settings.

    Bounds are W, S, E, N in degrees, by default all of the terrain. ``progress`` is called after
    each batch with the covered share, of 100.

    Raises `InputError` if the area cannot be planned, and `StoreMismatchError` if the store at
    ``path`` was built from another DEM or with other settings.
    """
    started = time.perf_counter()
    path = Path(path).resolve()
    config = config or RenderConfig()
    settings: dict[str, object] = {
        "planner": planned.strategy,
        "plan": planned.to_dict(),
        "bounds_deg": bounds_deg,
    }
    header = rendering_header(terrain, settings, config)
    check_store_path(path)
    if _is_planned(path, header):
        return None
    with HorizonRenderer(terrain, config) as renderer:
        area = map_bounds(terrain, bounds_deg)
        done = plan(terrain, renderer.render, planned, area, progress)
        header = replace(header, renderer=renderer.description)
        columns = rendering_columns(header, done.views)
        order = sorted_once(header, columns)
        # A plan takes long, and another store may have been written meanwhile.
        if not _is_planned(path, header):
            write_store(path, header, columns, order)
        built = BuildResult(len(order), len(order), time.perf_counter() - started)
        return built, done, verify_coverage(done, renderer.render)


def _is_planned(path: Path, header: StoreHeader) -> bool:
    """Return whether a store is finished; raises `StoreMismatchError` for any other."""
    if not path.exists():
        return False
    if finished_store(path, header) is None:
        raise StoreMismatchError(
            f"store {path} was planned for other bounds; write to another file, and join the "
            "two with `skyline store merge`"
        )
    return True
