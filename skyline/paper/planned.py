"""A store of renderings whose viewpoints one of the paper's planners chooses."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from skyline.build.grid import map_bounds
from skyline.build.parts import BuildResult, finished_store
from skyline.build.plans import rendering_columns, rendering_header
from skyline.geodesy import Bounds
from skyline.paper.plan import Headings, Plan, PlanConfig, PlanProgress, plan
from skyline.paper.reprojection import ToleranceMeter
from skyline.paper.true_errors import true_errors_px
from skyline.paper.verify import Verification, verify_coverage
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.skylines import Views
from skyline.store import write_store
from skyline.store.merge import sorted_once
from skyline.store.write import check_folder
from skyline.terrain.heightfield import HeightField, ground_of
from skyline.terrain.viewpoints import Viewpoints


@dataclass(frozen=True, slots=True)
class PlannedResult:
    """The result of a planned build."""

    built: BuildResult
    plan: Plan
    verification: Verification
    """The predicted coverage compared with renderings."""


def build_planned(
    terrain: HeightField,
    path: str | Path,
    planned: PlanConfig,
    bounds_deg: Bounds | None = None,
    config: RenderConfig | None = None,
    progress: Callable[[PlanProgress], None] | None = None,
) -> PlannedResult | None:
    """Let a planner choose viewpoints until the area is covered, and store their renderings.

    Areas are those of Equation 4 with the mean depth. The store is written at the end of the plan.
    Returns None where it is there already, with the same settings.

    Parameters
    ----------
    path : str or Path
        The store.
    bounds_deg : tuple, optional
        W, S, E, N in degrees; by default all of the terrain.
    progress : callable, optional
        Called after each batch.

    Raises
    ------
    InputError
        An area that cannot be planned.
    StoreMismatchError
        The store at ``path`` was built from another DEM or with other settings.
    """
    started = time.perf_counter()
    path, config = Path(path).resolve(), config or RenderConfig()
    settings: dict[str, object] = {
        "planner": planned.strategy,
        "plan": asdict(planned),
        "bounds_deg": bounds_deg,
    }
    header = rendering_header(terrain, settings, config)
    check_folder(path)
    if path.exists():
        finished_store(path, header)
        return None
    rendered: list[Views] = []
    with HorizonRenderer.of(terrain, config) as renderer:

        def render(viewpoints: Viewpoints, headings: Headings) -> Views:
            rendered.append(renderer.render(viewpoints, headings))
            return rendered[-1]

        area = map_bounds(terrain, bounds_deg)
        done = plan(terrain, render, _meter(terrain, planned), planned, area, progress)
        header = replace(header, renderer=renderer.description)
        columns = rendering_columns(header, Views.concatenate(rendered))
        order = sorted_once(header, columns)
        write_store(path, header, columns, order)
        built = BuildResult(len(order), len(order), time.perf_counter() - started)
        return PlannedResult(built, done, verify_coverage(done, renderer.render, true_errors_px))


def _meter(terrain: HeightField, planned: PlanConfig) -> ToleranceMeter:
    spacing = planned.spacing
    size = 2 * int(spacing.reach_m // spacing.candidate_m) + 1
    return ToleranceMeter(ground_of(terrain), size, spacing.candidate_m)
