"""The commands that make stores: ``skyline render`` and ``skyline build``."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline import report
from skyline.cli.console import (
    Crs,
    Dems,
    NoCurvature,
    RefractionK,
    Reproject,
    Scheduler,
    Tolerance,
    Width,
    Workers,
    keeps,
    panel,
    parse_bounds,
    progress_bar,
    runner_of,
    say,
)
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.paper.planning.plan import PlanConfig, PlanProgress
from skyline.paper.planning.strategies import STRATEGIES
from skyline.pipeline.build import BuildResult, build_store, render_to_store
from skyline.pipeline.config import ROWS, PlaceConfig, RenderConfig
from skyline.pipeline.layout import DEFAULT_LOSS, DEFAULT_TILE_M, Layout
from skyline.pipeline.planned import build_planned
from skyline.pipeline.renderings import save_depth_pictures
from skyline.pipeline.shards import build_sharded
from skyline.places import Places
from skyline.planning.uniform import uniform_grid
from skyline.store import open_store
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import read_viewpoints

_DEFAULTS = RenderConfig()
_PLANNED = PlanConfig()

Output = Annotated[Path, Option("--output", "-o", help="The store to write (HDF5).")]
Bounds = Annotated[
    str | None, Option(metavar="W,S,E,N", help="Degrees of longitude and latitude (WGS 84).")
]
_renderings = panel("Renderings, for the paper's matcher")
_OF_PLANNERS = ("candidate_spacing", "threshold_px", "coverage", "budget", "seed")
"""What only the paper's planners are told."""

ShardKm = Annotated[
    float | None,
    Option(
        metavar="K",
        help="Build in tiles of K km; each tile is a job. The default with workers is 10.",
    ),
]
Rows = Annotated[
    str, Option(help=f"How the store holds rows: {' or '.join(ROWS)} (docs/store.md).")
]


def render(
    dem: Dems,
    output: Output,
    viewpoints: Annotated[
        Path | None,
        Option(metavar="FILE.csv", help="Viewpoints as CSV: easting,northing or lon,lat."),
    ] = None,
    grid: Annotated[
        float | None,
        Option(metavar="SPACING_M", help="Render a uniform grid instead: metres between."),
    ] = None,
    width: Width = _DEFAULTS.width,
    tolerance_px: Tolerance = _DEFAULTS.tolerance_px,
    k: RefractionK = _DEFAULTS.curvature.refraction_k,
    no_curvature: NoCurvature = False,
    rows: Rows = _DEFAULTS.rows,
    depth_images: Annotated[
        Path | None,
        Option(metavar="DIR", help="Also save depth images (TIFF, metres) and pictures."),
    ] = None,
    crs: Crs = None,
    reproject: Reproject = False,
) -> None:
    """Render the skylines of given viewpoints, to grid north, east, south, west, into a store."""
    if (viewpoints is None) == (grid is None):
        raise InputError("give one of --viewpoints FILE.csv and --grid SPACING_M")
    config = replace(_render_config(width, tolerance_px, k, no_curvature), rows=rows)
    terrain = read_dem(dem, DemOptions(crs=crs, reproject=reproject))
    if viewpoints is not None:
        eyes = read_viewpoints(viewpoints, terrain, config.eye_height_m)
    else:
        eyes = uniform_grid(terrain, grid or 0.0, eye_height_m=config.eye_height_m)
    with progress_bar("rendering") as progress:
        result = render_to_store(terrain, eyes, output, config, progress)
    if depth_images is not None:
        save_depth_pictures(terrain, eyes, depth_images, config)
    _say_built(result, output, "renderings")


def build(
    ctx: typer.Context,
    dem: Dems,
    output: Output,
    spacing: Annotated[
        float | None,
        Option(
            help="Metres between places of a uniform grid; with a planner, between viewpoints of "
            "its coarse grid.",
            show_default=f"places are planned; {_PLANNED.spacing.coarse_m:g} with a planner",
        ),
    ] = None,
    loss: Annotated[
        float,
        Option(
            metavar="SHARE",
            help="Share of the photos that may be missed because places lie apart. Places are "
            "planned for it: dense where skylines are near, sparse where they are far.",
        ),
    ] = DEFAULT_LOSS,
    bounds: Bounds = None,
    drawn: Annotated[
        Path | None,
        Option(
            "--map",
            metavar="PNG",
            help="Draw a map of the places and how far apart they lie; with a planner, of "
            "viewpoints and their areas.",
        ),
    ] = None,
    shard_km: ShardKm = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    k: RefractionK = _DEFAULTS.curvature.refraction_k,
    no_curvature: NoCurvature = False,
    crs: Crs = None,
    reproject: Reproject = False,
    planner: Annotated[
        str | None,
        _renderings(
            help="Store renderings instead of places, for the paper's matcher. The planner "
            f"chooses their viewpoints: uniform, {', '.join(STRATEGIES)}."
        ),
    ] = None,
    candidate_spacing: Annotated[
        float, _renderings(help="Metres between candidate locations.")
    ] = _PLANNED.spacing.candidate_m,
    threshold_px: Annotated[
        float,
        _renderings(
            "--threshold-px", help="Pixels by which the skyline of a covered location may differ."
        ),
    ] = _PLANNED.threshold_px,
    coverage: Annotated[
        float, _renderings(help="Share of the candidates to cover.")
    ] = _PLANNED.coverage,
    budget: Annotated[
        int | None,
        _renderings(metavar="N", help="Number of renderings; the threshold is raised to fit."),
    ] = None,
    seed: Annotated[int, _renderings(help="Seed of the planner's random choices.")] = _PLANNED.seed,
    width: Annotated[int, _renderings(help="Columns of a 90 degree view.")] = _DEFAULTS.width,
    tolerance_px: Annotated[
        float, _renderings("--tolerance-px", help="Pixels by which a skyline may lie too low.")
    ] = _DEFAULTS.tolerance_px,
    rows: Annotated[
        str, _renderings(help=f"How the store holds renderings, {' or '.join(ROWS)}.")
    ] = _DEFAULTS.rows,
) -> None:
    """Build the store that `match` searches. After Ctrl-C, the same command continues."""
    keeps("what was built is kept, and the same command continues from there")
    corners = parse_bounds(bounds) if bounds is not None else None
    options = DemOptions(crs=crs, reproject=reproject)
    config = replace(_render_config(width, tolerance_px, k, no_curvature), rows=rows)
    tiled = (shard_km, workers, scheduler) != (None, None, None)
    tile_m = DEFAULT_TILE_M if shard_km is None else 1000.0 * shard_km
    coarse_m = _PLANNED.spacing.coarse_m if spacing is None else spacing
    made: PlaceConfig | RenderConfig = config
    layout = Layout(coarse_m, tile_m, corners)
    if planner is None:
        why = "a store of renderings; give --planner too"
        _refuse_given(ctx, [*_OF_PLANNERS, "width", "tolerance_px", "rows"], why)
        if spacing is not None:
            _refuse_given(ctx, ["loss"], f"planned places, --spacing {spacing:g} for a grid")
        made = PlaceConfig(curvature=config.curvature)
        layout = Layout(spacing, tile_m, corners, loss)
    else:
        _refuse_given(ctx, ["loss"], f"places; leave out --planner {planner}")
        if planner == "uniform":
            why = "a planner that chooses viewpoints; uniform does not choose"
            _refuse_given(ctx, [*_OF_PLANNERS, "drawn"], why)
        elif planner not in STRATEGIES:
            raise InputError(f"planner is {planner!r}; expected uniform, {', '.join(STRATEGIES)}")
        elif tiled:
            raise InputError(
                f"planner {planner} plans one area as a whole; tiles and workers are for uniform "
                "grids"
            )
        else:
            planned = PlanConfig(
                planner,
                replace(_PLANNED.spacing, coarse_m=coarse_m, candidate_m=candidate_spacing),
                threshold_px,
                coverage,
                seed=seed,
                budget=budget,
            )
            _build_planned(read_dem(dem, options), output, planned, corners, config, drawn)
            return
    with runner_of(workers, scheduler) as runner, progress_bar("rendering") as bar:
        terrain = read_dem(dem, options)
        if tiled:
            result = build_sharded(terrain, output, layout, made, runner, bar)
        else:
            result = build_store(terrain, output, layout, made, bar)
    if drawn is not None:
        with open_store(output) as opened:
            places = Places.concatenate(list(opened.places().blocks()))
        report.save_place_map(terrain, places, drawn)
    _say_built(result, output, "places" if planner is None else "renderings")


def _build_planned(
    terrain: HeightField,
    output: Path,
    planned: PlanConfig,
    bounds_deg: tuple[float, float, float, float] | None,
    config: RenderConfig,
    drawn: Path | None,
) -> None:
    """Build what one of the paper's planners chooses, draw it, and say what the planner did."""
    budget = planned.budget
    with progress_bar("covering, %" if budget is None else "rendering") as bar:

        def tell(now: PlanProgress) -> None:
            if budget is None:
                bar(int(100 * now.coverage), 100)
            else:
                bar(now.renderings, budget)

        done = build_planned(terrain, output, planned, bounds_deg, config, tell)
    if drawn is not None:
        report.save_coverage_map(done.plan, drawn)
    _say_built(done.built, output, "renderings")
    proof, made = done.verification, done.plan.progress
    say(
        f"to {done.plan.threshold_px:.3g} px: coverage {100 * proof.predicted:.1f} % predicted, "
        f"{100 * proof.verified:.1f} % verified by rendering ({proof.sampled} covered locations: "
        f"{100 * proof.share:.1f} % hold, 95 % interval {100 * proof.low:.1f} to "
        f"{100 * proof.high:.1f}); overlap {made.overlap}, "
        f"{made.batches} batches, rendering {done.plan.render_s:.1f} s, planning "
        f"{done.plan.plan_s:.1f} s"
    )


def _refuse_given(ctx: typer.Context, names: Sequence[str], why: str) -> None:
    """Raise `InputError` where one of some parameters was given on the command line."""
    options = {option.name: option.opts[0] for option in ctx.command.params}
    for name in names:
        source = ctx.get_parameter_source(name)
        if source is not None and source.name != "DEFAULT":
            raise InputError(f"{options[name]} {ctx.params[name]} is for {why}")


def _render_config(width: int, tolerance_px: float, k: float, no_curvature: bool) -> RenderConfig:
    """Return how renderings are made, from options."""
    curvature = Curvature(refraction_k=k, enabled=not no_curvature)
    return RenderConfig(width=width, tolerance_px=tolerance_px, curvature=curvature)


def _say_built(result: BuildResult, path: Path, what: str) -> None:
    rate = result.rendered / result.seconds if result.seconds > 0.0 else 0.0
    say(
        f"{path}: {result.rows} {what}, {result.rendered} of them new in "
        f"{result.seconds:.1f} s ({rate:.0f}/s), {path.stat().st_size / 1e6:.1f} MB"
    )
