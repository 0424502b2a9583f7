"""``skyline render``: stores of renderings, for the paper's matcher."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.build import built_in_words
from skyline.cli.options import (
    BoundsOrAll,
    Crs,
    Dems,
    RefractionK,
    Spacing,
    Workers,
    of_terrain,
    output_option,
    panel,
    parse_bounds,
)
from skyline.cli.terminal import Terminal
from skyline.paper.plan import CoveragePlan, PlanConfig
from skyline.paper.plan_check import Verification
from skyline.paper.planners import PLANNERS
from skyline.plugins import names_of
from skyline.render.horizon import RenderConfig
from skyline.tasks.render import RenderTask, render_planned, render_store

_RENDERED = RenderConfig()
_PLANNED = PlanConfig()
_of_planners = panel("With --planner")


def render(
    context: typer.Context,
    dem: Dems,
    output: Annotated[Path, output_option("The store to write.", "STORE.h5")],
    viewpoints: Annotated[
        Path | None,
        Option(
            metavar="FILE.csv",
            help="Viewpoints to render, as CSV: lon,lat or easting,northing[,id][,eye_height_m].",
        ),
    ] = None,
    spacing: Spacing = None,
    planner: Annotated[
        str | None,
        Option(
            metavar="NAME",
            help=f"Let a planner choose the viewpoints: {', '.join(names_of(PLANNERS))}.",
            autocompletion=lambda: names_of(PLANNERS),
        ),
    ] = None,
    bounds: BoundsOrAll = None,
    depth_images: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="Also save depth images (TIFF, metres) and pictures of them; not with --planner.",
        ),
    ] = None,
    coarse_spacing: Annotated[
        float | None,
        _of_planners(
            metavar="M",
            help="Metres between the viewpoints that are rendered first.",
            show_default=f"{_PLANNED.coarse_m:g}",
        ),
    ] = None,
    site_spacing: Annotated[
        float | None,
        _of_planners(
            metavar="M",
            help="Metres between the sites from which the planner chooses.",
            show_default=f"{_PLANNED.site_spacing_m:g}",
        ),
    ] = None,
    threshold_px: Annotated[
        float | None,
        _of_planners(
            metavar="PX",
            help="A site is covered if a rendered skyline differs by at most this many pixels.",
            show_default=f"{_PLANNED.threshold_px:g}",
        ),
    ] = None,
    coverage: Annotated[
        float | None,
        _of_planners(
            metavar="SHARE",
            help="Share of the sites to cover, from 0 to 1.",
            show_default=f"{_PLANNED.coverage:g}",
        ),
    ] = None,
    map_file: Annotated[
        Path | None,
        _of_planners(
            "--map",
            metavar="PNG",
            help="Draw a map of the chosen viewpoints and the areas they cover.",
        ),
    ] = None,
    workers: Workers = None,
    width: Annotated[
        int, of_terrain(metavar="N", help="Columns of a 90 degree view.")
    ] = _RENDERED.width,
    refraction_k: RefractionK = None,
    crs: Crs = None,
) -> None:
    """Render views into a store, for the paper's matcher.

    The views look to grid north, east, south and west.
    """
    terminal = Terminal.of(context)
    task = RenderTask(
        dem=tuple(dem),
        crs=crs,
        output=output,
        viewpoints=viewpoints,
        spacing_m=spacing,
        planner=planner,
        coarse_m=coarse_spacing,
        site_m=site_spacing,
        threshold_px=threshold_px,
        coverage=coverage,
        map=map_file,
        bounds_deg=None if bounds is None else parse_bounds(bounds),
        depth_images=depth_images,
        workers=workers,
        width=width,
        refraction_k=refraction_k,
    )
    if planner is None:
        terminal.line(built_in_words(render_store(task, terminal), output, "renderings"))
        return
    built = render_planned(task, terminal)
    if built is None:
        terminal.line(f"{output}: complete: nothing was left to render")
        return
    terminal.line(built_in_words(built[0], output, "renderings"))
    terminal.line(_coverage_in_words(*built[1:]))


def _coverage_in_words(plan: CoveragePlan, proof: Verification) -> str:
    """Return a plan's coverage, predicted and confirmed, in words."""
    return (
        f"to {plan.config.threshold_px:.3g} px: coverage {100 * proof.predicted:.1f} % predicted, "
        f"{100 * proof.verified:.1f} % verified by rendering ({proof.sampled} covered locations: "
        f"{100 * proof.share:.1f} % hold, 95 % interval {100 * proof.low:.1f} to "
        f"{100 * proof.high:.1f}); overlap {plan.overlap}, "
        f"{plan.batches} batches, rendering {plan.render_s:.1f} s, planning {plan.plan_s:.1f} s"
    )
