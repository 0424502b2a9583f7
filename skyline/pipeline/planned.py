"""A build whose viewpoints a planner chooses."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from skyline.paper.planning.budget import spaced_for
from skyline.paper.planning.candidates import lay_out
from skyline.paper.planning.plan import Headings, Plan, PlanConfig, PlanProgress, plan
from skyline.paper.planning.reprojection import ToleranceMeter
from skyline.paper.planning.truth import true_errors_px
from skyline.paper.planning.verify import Verification, verify_coverage
from skyline.pipeline.build import BuildResult
from skyline.pipeline.config import RenderConfig, make_renderer, store_header
from skyline.pipeline.row_renderers import append_views
from skyline.planning.uniform import map_bounds
from skyline.render.horizon import HorizonRenderer
from skyline.store import (
    Built,
    StoreWriter,
    amend_config,
    as_stored,
    create_store,
    open_for_append,
    open_store,
)
from skyline.terrain.heightfield import HeightField, ground_of
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

_PARTS = 1000
"""How finely the store notes how far the plan has come."""

_REACHED = "reached_px"
"""The setting that names the threshold a budget sufficed for."""


@dataclass(frozen=True, slots=True)
class PlannedResult:
    """What a planned build did."""

    built: BuildResult
    plan: Plan
    verification: Verification
    """The predicted coverage held to renderings."""


def build_planned(
    terrain: HeightField,
    path: str | Path,
    planned: PlanConfig,
    bounds_deg: tuple[float, float, float, float] | None = None,
    config: RenderConfig | None = None,
    progress: Callable[[PlanProgress], None] | None = None,
) -> PlannedResult:
    """Let a planner choose viewpoints until the area is covered; store what it has rendered.

    Areas are those of Equation 4 with the mean depth. A build that was stopped goes on: its plan
    is followed again, and what the store holds is not rendered again. With a budget, distances of
    the plan are widened to suit it (`spaced_for`), and the store's settings name the threshold that
    was reached once it is.

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
        The store at ``path`` was built from another DEM or with another configuration.
    """
    config = config or RenderConfig()
    area = map_bounds(terrain, bounds_deg)
    planned = replace(planned, eye_height_m=config.eye_height_m)
    if planned.budget is not None:
        planned = replace(planned, spacing=spaced_for(planned.spacing, planned.budget, area))
    started = time.perf_counter()
    settings: dict[str, object] = {
        "planner": planned.strategy,
        "plan": {name: value for name, value in asdict(planned).items() if value is not None},
        "bounds_deg": bounds_deg,
    }
    # An area that cannot be planned is refused before a store is made for it.
    lay_out(terrain, planned.spacing, area, planned.eye_height_m, planned.budget)
    with make_renderer(terrain, config) as renderer, ExitStack() as held:
        there: Views | None = None
        if Path(path).exists():
            with open_store(path) as store:
                there = store.views()
                settings |= {k: v for k, v in store.header.config.items() if k == _REACHED}
        header = store_header(terrain, renderer.description, config, settings)
        if there is None:
            writer = held.enter_context(create_store(path, header, Built(0, _PARTS)))
        else:
            writer = held.enter_context(open_for_append(path, header))
        before = len(writer)
        render = partial(_render_and_keep, renderer, writer, config)

        def note(now: PlanProgress) -> None:
            share = now.coverage / planned.coverage
            if planned.budget is not None:
                share = now.renderings / planned.budget
            # A plan that is followed again from the store begins with less than the store has.
            part = max(min(int(_PARTS * share), _PARTS - 1), writer.built.done)
            writer.note_built(Built(part, _PARTS))
            if progress:
                progress(now)

        done = plan(terrain, render, _meter(terrain, planned), planned, area, there, note)
        writer.note_built(Built(_PARTS, _PARTS))
        writer.close()
        built = BuildResult(len(writer), len(writer) - before, time.perf_counter() - started)
        if planned.budget is not None:
            amend_config(path, {_REACHED: done.threshold_px})
        return PlannedResult(built, done, verify_coverage(done, renderer.render, true_errors_px))


def _meter(terrain: HeightField, planned: PlanConfig) -> ToleranceMeter:
    spacing = planned.spacing
    size = 2 * int(spacing.reach_m // spacing.candidate_m) + 1
    return ToleranceMeter(
        ground_of(terrain), size, spacing.candidate_m, eye_height_m=planned.eye_height_m
    )


def _render_and_keep(
    renderer: HorizonRenderer,
    writer: StoreWriter,
    config: RenderConfig,
    viewpoints: Viewpoints,
    heading: Headings,
) -> Views:
    views = renderer.render(viewpoints, heading)
    append_views(writer, views, config)
    # A plan that is followed again from the store must see what this one saw.
    return as_stored(writer.header, views)
