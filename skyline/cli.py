"""The command line: ``skyline COMMAND``."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from skyline import dem_cli, horizon_cli, page_cli, panorama_cli, photo_cli, report
from skyline.console import (
    Crs,
    Dems,
    NoCurvature,
    RefractionK,
    Reproject,
    Scheduler,
    Workers,
    command_line,
    parse_bounds,
    progress_bar,
    run_app,
    runner_of,
)
from skyline.describe import (
    describe_gl,
    describe_scene,
    describe_store,
    describe_terrain,
)
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.paper.planning.plan import PlanConfig
from skyline.paper.planning.strategies import STRATEGIES
from skyline.pipeline import (
    BuildResult,
    PlaceConfig,
    PlannedResult,
    RenderConfig,
    ShardPlan,
    build_places,
    build_planned,
    build_sharded,
    build_uniform,
    explain_scene,
    render_to_store,
    save_depth_pictures,
)
from skyline.pipeline.config import ROWS
from skyline.pipeline.places import DEFAULT_LOSS
from skyline.pipeline.shards import DEFAULT_TILE_M
from skyline.places import Places
from skyline.planning.uniform import uniform_grid
from skyline.store import is_store, open_store
from skyline.store_cli import store_app
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoint_csv import read_viewpoints
from skyline.terrain.viewpoints import stand_on

_DEFAULTS = RenderConfig()
_PLANNED = PlanConfig()

app = command_line("skyline", "A photo of mountains in, a place on the map out.")
app.add_typer(dem_cli.app)
app.add_typer(store_app, name="store")

Output = Annotated[Path, typer.Option("--output", "-o", help="The store to write (HDF5).")]
Width = Annotated[int, typer.Option(help="Columns of a 90 degree view.")]
Tolerance = Annotated[
    float,
    typer.Option("--tolerance-px", help="Pixels by which a skyline may lie too low; 0 is exact."),
]
Bounds = Annotated[
    str | None, typer.Option(metavar="W,S,E,N", help="Degrees of longitude and latitude (WGS 84).")
]
ShardKm = Annotated[
    float | None,
    typer.Option(metavar="K", help="Build in tiles of K km; each tile is a job. With workers: 10."),
]
Rows = Annotated[
    str, typer.Option(help=f"How the store holds rows: {' or '.join(ROWS)} (docs/store.md).")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@app.command()
def render(
    dem: Dems,
    output: Output,
    viewpoints: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Viewpoints as CSV: easting,northing or lon,lat."),
    ] = None,
    grid: Annotated[
        float | None,
        typer.Option(metavar="SPACING_M", help="Render a uniform grid instead: metres between."),
    ] = None,
    width: Width = _DEFAULTS.width,
    tolerance_px: Tolerance = _DEFAULTS.tolerance_px,
    k: RefractionK = _DEFAULTS.curvature.refraction_k,
    no_curvature: NoCurvature = False,
    rows: Rows = _DEFAULTS.rows,
    depth_images: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Also save depth images (TIFF, metres) and pictures."),
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
    _say_built(result, output)


@app.command()
def build(
    dem: Dems,
    output: Output,
    spacing: Annotated[
        float | None,
        typer.Option(
            help="Metres between places of a uniform grid; with a planner, between viewpoints of "
            "its coarse grid.",
            show_default=f"places are planned; {_PLANNED.spacing.coarse_m:g} with a planner",
        ),
    ] = None,
    loss: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE",
            help="Share of the photos that may be missed because places lie apart. Places are "
            "planned for it: dense where skylines are near, sparse where they are far.",
            show_default=f"{DEFAULT_LOSS:g}",
        ),
    ] = None,
    bounds: Bounds = None,
    shard_km: ShardKm = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    k: RefractionK = _DEFAULTS.curvature.refraction_k,
    no_curvature: NoCurvature = False,
    crs: Crs = None,
    reproject: Reproject = False,
    planner: Annotated[
        str | None,
        typer.Option(
            help="Store renderings instead of places, for the paper's matcher. The planner "
            f"chooses their viewpoints: uniform, {', '.join(STRATEGIES)}."
        ),
    ] = None,
    candidate_spacing: Annotated[
        float | None,
        typer.Option(
            help="Planner: metres between candidates.",
            show_default=f"{_PLANNED.spacing.candidate_m:g}",
        ),
    ] = None,
    threshold_px: Annotated[
        float | None,
        typer.Option(
            "--threshold-px",
            help="Planner: pixels by which the skyline of a covered location may differ.",
            show_default=f"{_PLANNED.threshold_px:g}",
        ),
    ] = None,
    coverage: Annotated[
        float | None,
        typer.Option(
            help="Planner: share of the candidates to cover.",
            show_default=f"{_PLANNED.coverage:g}",
        ),
    ] = None,
    budget: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Planner: number of renderings; the threshold is raised to fit."
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(help="Planner: seed of its random choices.", show_default=f"{_PLANNED.seed}"),
    ] = None,
    coverage_map: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="PNG",
            help="Draw a map of the places and how far apart they lie; with a planner, of "
            "viewpoints and their areas.",
        ),
    ] = None,
    width: Annotated[
        int | None,
        typer.Option(
            help="Renderings: columns of a 90 degree view.", show_default=f"{_DEFAULTS.width}"
        ),
    ] = None,
    tolerance_px: Annotated[
        float | None,
        typer.Option(
            "--tolerance-px",
            help="Renderings: pixels by which a skyline may lie too low.",
            show_default=f"{_DEFAULTS.tolerance_px:g}",
        ),
    ] = None,
    rows: Annotated[
        str | None,
        typer.Option(
            help=f"Renderings: how the store holds them, {' or '.join(ROWS)}.",
            show_default=_DEFAULTS.rows,
        ),
    ] = None,
) -> None:
    """Build the store that `match` searches. After Ctrl-C, the same command continues."""
    corners = parse_bounds(bounds) if bounds is not None else None
    dem_options = DemOptions(crs=crs, reproject=reproject)
    tiled = (shard_km, workers, scheduler) != (None, None, None)
    tile_m = DEFAULT_TILE_M if shard_km is None else 1000.0 * shard_km
    only_planned: dict[str, object] = {
        "--candidate-spacing": candidate_spacing,
        "--threshold-px": threshold_px,
        "--coverage": coverage,
        "--budget": budget,
        "--seed": seed,
    }
    only_rendered: dict[str, object] = {
        "--width": width,
        "--tolerance-px": tolerance_px,
        "--rows": rows,
    }
    if planner is None:
        _refuse_given(only_planned | only_rendered, "a store of renderings; give --planner too")
        places = PlaceConfig(curvature=_curvature(k, no_curvature))
        if spacing is not None:
            _refuse_given({"--loss": loss}, f"planned places, --spacing {spacing:g} for a grid")
        share = DEFAULT_LOSS if loss is None else loss
        with runner_of(workers, scheduler) as runner, progress_bar("rendering") as progress:
            terrain = read_dem(dem, dem_options)
            if tiled:
                plan = ShardPlan(spacing, tile_m, corners, share)
                result = build_sharded(terrain, output, plan, places, runner, progress)
            else:
                result = build_places(
                    terrain, output, spacing, corners, places, progress, loss=share
                )
        _say_built(result, output, "places")
        if coverage_map is not None:
            _draw_places(terrain, output, coverage_map)
        return
    _refuse_given({"--loss": loss}, f"places; leave out --planner {planner}")
    if planner != "uniform" and planner not in STRATEGIES:
        raise InputError(f"planner is {planner!r}; expected uniform, {', '.join(STRATEGIES)}")
    config = replace(
        _render_config(
            _DEFAULTS.width if width is None else width,
            _DEFAULTS.tolerance_px if tolerance_px is None else tolerance_px,
            k,
            no_curvature,
        ),
        rows=_DEFAULTS.rows if rows is None else rows,
    )
    coarse_m = _PLANNED.spacing.coarse_m if spacing is None else spacing
    if planner == "uniform":
        only_planned["--map"] = coverage_map
        _refuse_given(only_planned, "a planner that chooses viewpoints; uniform does not choose")
        with runner_of(workers, scheduler) as runner, progress_bar("rendering") as progress:
            terrain = read_dem(dem, dem_options)
            if tiled:
                plan = ShardPlan(coarse_m, tile_m, corners)
                result = build_sharded(terrain, output, plan, config, runner, progress)
            else:
                result = build_uniform(terrain, output, coarse_m, corners, config, progress)
        _say_built(result, output)
        return
    if tiled:
        raise InputError(
            f"planner {planner} plans one area as a whole; tiles and workers are for uniform grids"
        )
    candidate_m = _PLANNED.spacing.candidate_m if candidate_spacing is None else candidate_spacing
    planned = PlanConfig(
        planner,
        replace(_PLANNED.spacing, coarse_m=coarse_m, candidate_m=candidate_m),
        _PLANNED.threshold_px if threshold_px is None else threshold_px,
        _PLANNED.coverage if coverage is None else coverage,
        seed=_PLANNED.seed if seed is None else seed,
        budget=budget,
    )
    terrain = read_dem(dem, dem_options)
    with progress_bar("covering, %" if budget is None else "rendering") as bar:
        done = build_planned(
            terrain,
            output,
            planned,
            corners,
            config,
            lambda now: (
                bar(int(100 * now.coverage), 100) if budget is None else bar(now.renderings, budget)
            ),
        )
    _say_built(done.built, output)
    _say_planned(done)
    if coverage_map is not None:
        report.save_coverage_map(done.plan, coverage_map)


def _draw_places(terrain: HeightField, store: Path, path: Path) -> None:
    with open_store(store) as opened:
        places = Places.concatenate(list(opened.places().blocks()))
    report.save_place_map(terrain, places, path)


def _refuse_given(options: Mapping[str, object], why: str) -> None:
    """Raise `InputError` where one of some options was given."""
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} {value} is for {why}")


app.command()(photo_cli.match)
app.command()(photo_cli.extract)
app.command()(page_cli.serve)
app.command()(horizon_cli.horizon)
app.command()(horizon_cli.sun)
app.command()(panorama_cli.panorama)
app.command()(panorama_cli.peaks)


@app.command()
def info(
    path: Annotated[
        list[str] | None,
        typer.Argument(metavar="[DEM...|STORE]", help="The files of a DEM, or a store."),
    ] = None,
    gl: Annotated[bool, typer.Option("--gl", help="Say which OpenGL is used and why.")] = False,
    as_json: AsJson = False,
    crs: Crs = None,
    reproject: Reproject = False,
) -> None:
    """Describe a DEM, a store, or the OpenGL in use."""
    if not path and not gl:
        raise InputError("nothing to describe; name a DEM or a store, or give --gl")
    facts: dict[str, object] = describe_gl() if gl else {}
    if path:
        if len(path) == 1 and is_store(path[0]):
            facts |= describe_store(path[0])
        else:
            facts |= describe_terrain(read_dem(path, DemOptions(crs=crs, reproject=reproject)))
    _say_facts(facts, as_json)


@app.command()
def explain(
    dem: Dems,
    at: Annotated[str, typer.Option(metavar="E,N", help="Easting and northing, metres.")],
    width: Width = _DEFAULTS.width,
    tolerance_px: Tolerance = _DEFAULTS.tolerance_px,
    k: RefractionK = _DEFAULTS.curvature.refraction_k,
    no_curvature: NoCurvature = False,
    crs: Crs = None,
    reproject: Reproject = False,
    as_json: AsJson = False,
) -> None:
    """Show which terrain a skyline depends on, what is left out, and what that costs."""
    config = _render_config(width, tolerance_px, k, no_curvature)
    easting, northing = _parse_place(at)
    terrain = read_dem(dem, DemOptions(crs=crs, reproject=reproject))
    eye = stand_on(terrain, easting, northing, config.eye_height_m)
    needs, views = explain_scene(terrain, eye, config)
    _say_facts(describe_scene(eye, config, needs, views), as_json)


def main() -> None:
    """Run the command line; every error is one line, exit code 2 for bad input, 1 for failure."""
    run_app(
        app, "stopped; what was built or fetched is kept, and the same command continues from there"
    )


def _render_config(width: int, tolerance_px: float, k: float, no_curvature: bool) -> RenderConfig:
    curvature = _curvature(k, no_curvature)
    return RenderConfig(width=width, tolerance_px=tolerance_px, curvature=curvature)


def _curvature(k: float, no_curvature: bool) -> Curvature:
    return Curvature(refraction_k=k, enabled=not no_curvature)


def _parse_place(text: str) -> tuple[float, float]:
    try:
        easting, northing = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(
            f"the place is `{text}`; expected easting and northing in metres, e.g. 601000,5179000"
        ) from error
    return easting, northing


def _say_facts(facts: dict[str, object], as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(facts))
        return
    for name, value in facts.items():
        values = value if isinstance(value, list) else [value]
        for line, item in enumerate(values):
            shown = f"{item:.9g}" if isinstance(item, float) else item
            typer.echo(f"{name if line == 0 else '':<24} {shown}")


def _say_built(result: BuildResult, path: Path, what: str = "renderings") -> None:
    rate = result.rendered / result.seconds if result.seconds > 0.0 else 0.0
    typer.echo(
        f"{path}: {result.rows} {what}, {result.rendered} of them new in "
        f"{result.seconds:.1f} s ({rate:.0f}/s), {path.stat().st_size / 1e6:.1f} MB"
    )


def _say_planned(done: PlannedResult) -> None:
    proof, made = done.verification, done.plan.progress
    typer.echo(
        f"to {done.plan.threshold_px:.3g} px: coverage {100 * proof.predicted:.1f} % predicted, "
        f"{100 * proof.verified:.1f} % verified by rendering ({proof.sampled} covered locations: "
        f"{100 * proof.share:.1f} % hold, 95 % interval {100 * proof.low:.1f} to "
        f"{100 * proof.high:.1f}); overlap {made.overlap}, "
        f"{made.batches} batches, rendering {done.plan.render_s:.1f} s, planning "
        f"{done.plan.plan_s:.1f} s"
    )
