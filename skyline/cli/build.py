"""``skyline build`` and ``render``: stores of places, and of renderings for the paper."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from typer import Option

from skyline.arrays import Progress
from skyline.cli.console import (
    Crs,
    Dems,
    RefractionK,
    Workers,
    lies_in_any,
    of_terrain,
    on_interrupt,
    output_option,
    panel,
    parse_bounds,
    print_line,
    print_note,
    progress_bar,
    read_terrain,
)
from skyline.errors import InputError, suffix_of
from skyline.files import check_folder
from skyline.geodesy import DEFAULT_REFRACTION_K, Curvature
from skyline.paper.plan import PlanConfig, build_planned
from skyline.paper.strategies import PLANNERS
from skyline.plugins import names_of
from skyline.render.horizon import RenderConfig
from skyline.store.read import open_store, parts_folder
from skyline.store.write import check_store_path
from skyline.survey.build import BuildResult, build_store
from skyline.survey.cluster import runner_of
from skyline.survey.lattices import expected_finds
from skyline.survey.plans import PlacePlan, RenderingPlan
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import read_viewpoints

Output = Annotated[Path, output_option("The store to write.", "STORE.h5")]
Bounds = Annotated[
    str | None,
    Option(
        metavar="W,S,E,N",
        help="The area of the eyes: west, south, east, north in degrees (WGS 84).",
        show_default="all of the DEM",
    ),
]

_DEFAULTS = RenderConfig()
_PLANNED = PlanConfig()
_of_planners = panel("With --planner")


def build(
    dem: Dems,
    output: Output,
    spacing: Annotated[
        float | None,
        Option(
            metavar="M",
            help="Metres between places of a uniform grid.",
            show_default="places are planned",
        ),
    ] = None,
    places: Annotated[
        int | None,
        Option(
            metavar="N",
            help="About this many places: dense where skylines are near, else sparse. "
            "A thousand take a quarter of a second on two cores without a GPU, and 0.7 MB.",
            show_default="100,000; fewer for small areas, more for large ones",
        ),
    ] = None,
    bounds: Bounds = None,
    workers: Workers = None,
    k: RefractionK = DEFAULT_REFRACTION_K,
    crs: Crs = None,
) -> None:
    """Build the store that `match` searches. After Ctrl-C, the same command continues."""
    _advise_to_continue(output)
    plan = PlacePlan(
        spacing, None if bounds is None else parse_bounds(bounds), places, Curvature(refraction_k=k)
    )
    terrain = read_terrain(dem, crs)
    with runner_of(workers) as runner, _bar(output, "places") as bar:
        result = build_store(terrain, output, plan, runner, bar)
    _print_built(result, output, "places")
    with open_store(output) as opened:
        _print_finds(expected_finds(opened.places()))


def render(
    dem: Dems,
    output: Output,
    viewpoints: Annotated[
        Path | None,
        Option(
            metavar="FILE.csv", help="Viewpoints to render, as CSV: lon,lat or easting,northing."
        ),
    ] = None,
    grid: Annotated[
        float | None,
        Option(
            metavar="SPACING_M",
            help="Metres between the viewpoints of a uniform grid; with --planner, of the coarse "
            "grid that is rendered first [1000].",
        ),
    ] = None,
    planner: Annotated[
        str | None,
        Option(
            metavar="NAME",
            help=f"Let a planner choose the viewpoints: {', '.join(names_of(PLANNERS))}.",
        ),
    ] = None,
    bounds: Bounds = None,
    depth_images: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="Also save depth images (TIFF, metres) and pictures of them; not with --planner.",
        ),
    ] = None,
    candidate_spacing: Annotated[
        float | None,
        _of_planners(
            metavar="M",
            help="Metres between the locations that the planner chooses from.",
            show_default=f"{_PLANNED.candidate_m:g}",
        ),
    ] = None,
    threshold_px: Annotated[
        float | None,
        _of_planners(
            "--threshold-px",
            metavar="PX",
            help="A location is covered if a rendered skyline differs by at most this many pixels.",
            show_default=f"{_PLANNED.threshold_px:g}",
        ),
    ] = None,
    coverage: Annotated[
        float | None,
        _of_planners(
            metavar="SHARE",
            help="Share of the locations to cover, from 0 to 1.",
            show_default=f"{_PLANNED.coverage:g}",
        ),
    ] = None,
    drawn: Annotated[
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
    ] = _DEFAULTS.width,
    k: RefractionK = DEFAULT_REFRACTION_K,
    crs: Crs = None,
) -> None:
    """Render views to grid north, east, south and west into a store, for the paper's matcher."""
    if (viewpoints is None) == (grid is None and planner is None):
        raise InputError("give one of --viewpoints FILE.csv, --grid SPACING_M and --planner NAME")
    check_store_path(output.resolve())
    if drawn is not None:
        suffix_of(drawn, [".png"])
    if depth_images is not None:
        check_folder(depth_images)
    config = RenderConfig(width, Curvature(refraction_k=k))
    corners = None if bounds is None else parse_bounds(bounds)
    of_planners = {
        "--candidate-spacing": candidate_spacing,
        "--threshold-px": threshold_px,
        "--coverage": coverage,
        "--map": drawn,
    }
    if planner is not None:
        others = {"--workers": workers, "--depth-images": depth_images}
        _refuse_given(others, "leave it out: a planner plans one area as a whole, in this process")
        chosen = {
            "coarse_m": grid,
            "candidate_m": candidate_spacing,
            "threshold_px": threshold_px,
            "coverage": coverage,
        }
        given = {name: value for name, value in chosen.items() if value is not None}
        planned = PlanConfig(planner, **given)  # type: ignore[arg-type]
        _build_planned(read_terrain(dem, crs), output, planned, corners, config, drawn)
        return
    _advise_to_continue(output)
    _refuse_given(of_planners, "give --planner too")
    if depth_images is not None and lies_in_any(depth_images, dem):
        _refuse_given({"--depth-images": depth_images}, "name a folder that holds no DEM")
    if viewpoints is not None:
        _refuse_given({"--bounds": bounds}, "leave it out: all viewpoints are rendered")
    terrain = read_terrain(dem, crs)
    labels: tuple[str, ...] = ()
    if viewpoints is not None:
        eyes, labels = read_viewpoints(viewpoints, terrain)
        plan = RenderingPlan.given(eyes, config)
    else:
        plan = RenderingPlan.uniform(terrain, grid or 0.0, corners, config)
    if depth_images is not None:
        from skyline.report import paper_pictures  # noqa: PLC0415  (slow to load)

        paper_pictures.check_depth_folder(depth_images, len(plan.viewpoints), labels)
    with runner_of(workers) as runner, _bar(output, "renderings") as bar:
        result = build_store(terrain, output, plan, runner, bar)
    if depth_images is not None:
        paper_pictures.save_depth_pictures(terrain, plan.viewpoints, depth_images, config, labels)
    _print_built(result, output, "renderings")


def _refuse_given(options: Mapping[str, object], advice: str) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} {value} does not suit the other options; {advice}")


def _build_planned(
    terrain: HeightField,
    output: Path,
    planned: PlanConfig,
    bounds_deg: tuple[float, float, float, float] | None,
    config: RenderConfig,
    drawn: Path | None,
) -> None:
    """Build the store that one of the paper's planners chooses, and print its coverage."""
    with progress_bar("covering, %") as bar:
        result = build_planned(terrain, output, planned, bounds_deg, config, bar)
    if result is None:
        if drawn is not None:
            raise InputError(
                f"{output} is complete, and only a new plan can be drawn as a map; remove the "
                "store to plan it again"
            )
        print_line(f"{output}: complete: nothing was left to render")
        return
    built, plan, proof = result
    _print_built(built, output, "renderings")
    print_line(
        f"to {planned.threshold_px:.3g} px: coverage {100 * proof.predicted:.1f} % predicted, "
        f"{100 * proof.verified:.1f} % verified by rendering ({proof.sampled} covered locations: "
        f"{100 * proof.share:.1f} % hold, 95 % interval {100 * proof.low:.1f} to "
        f"{100 * proof.high:.1f}); overlap {plan.overlap}, "
        f"{plan.batches} batches, rendering {plan.render_s:.1f} s, planning {plan.plan_s:.1f} s"
    )
    if drawn is not None:
        from skyline.report.paper_pictures import save_coverage_map  # noqa: PLC0415  (slow to load)

        save_coverage_map(plan, drawn)


def _print_finds(classes: Sequence[tuple[float, float, float]]) -> None:
    """Print how many photos 60 degrees wide are expected to be found, by distance."""
    shares, below_m = [], 0.0
    for least_m, share, found in reversed(classes):
        away = f"{least_m:.0f} to {below_m:.0f} m" if below_m else f"over {least_m:.0f} m"
        shares.append(f"{100.0 * found:.0f} % at {away} ({100.0 * share:.0f} % of all)")
        below_m = least_m
    print_line(f"photos expected to be found, by the distance of the skyline: {', '.join(shares)}")


def _advise_to_continue(store: Path) -> None:
    """Check a store's folder; after Ctrl-C the error says that a build with parts continues."""
    check_store_path(store.resolve())
    on_interrupt(
        "what was built is kept, and the same command continues from there",
        lambda: any(parts_folder(store.resolve()).glob("*/*.h5")),
    )


@contextmanager
def _bar(output: Path, rows: str) -> Iterator[Progress]:
    """Show the progress of a build, after a note on what an earlier command has left."""
    with progress_bar("rendering") as bar:
        is_first = True

        def show(done: int, total: int) -> None:
            nonlocal is_first
            if is_first and done:
                print_note(f"{output}: {done} of about {total} {rows} are there already")
            is_first = False
            bar(done, total)

        yield show


def _print_built(result: BuildResult, path: Path, rows: str) -> None:
    size = f"{path.stat().st_size / 1e6:.1f} MB"
    if not result.rendered:
        print_line(f"{path}: {result.rows} {rows}, complete: nothing was left to render, {size}")
        return
    rate = result.rendered / max(result.seconds, 1e-9)
    print_line(
        f"{path}: {result.rows} {rows}, {result.rendered} of them new in "
        f"{result.seconds:.1f} s ({rate:.0f}/s), {size}"
    )
