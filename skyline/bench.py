"""The command line of benchmarks: ``skyline-bench COMMAND`` (DESIGN 8)."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from skyline import __version__
from skyline.console import parse_bounds, progress_bar, run_app
from skyline.errors import InputError, SkylineError
from skyline.experiments import stability as hard_cases
from skyline.experiments.agreement import DEPTH, HORIZON
from skyline.experiments.matching import KINDS, OPENERS, MatchingConfig
from skyline.experiments.matching import measure as measure_matching
from skyline.experiments.matching_plot import save_errors
from skyline.experiments.record import Row, machine, write_record
from skyline.experiments.speed_error import SpeedErrorConfig, measure
from skyline.experiments.speed_error_plot import save_speed_error
from skyline.experiments.stability_plot import save_stability
from skyline.experiments.table1 import SEEDS, conclusions
from skyline.experiments.table1 import measure as measure_table1
from skyline.experiments.table1 import plot as plot_table1
from skyline.experiments.trials import candidate_rows, write_rows
from skyline.terrain.dem import DemOptions, read_dem

_PLOT_SUFFIXES = (".png", ".pdf", ".svg")
_PIPED_WIDTH = 200
_SPEED_ERROR = SpeedErrorConfig()
_MATCHING = MatchingConfig()

app = typer.Typer(
    name="skyline-bench",
    help="Measure Skyline: speeds with their errors, on this machine.",
    pretty_exceptions_enable=False,
    add_completion=False,
)

Dems = Annotated[
    list[str], typer.Argument(metavar="DEM...", help="Elevation files: one, or tiles of one grid.")
]
JsonFile = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write rows and machine as JSON.")
]
PlotFile = Annotated[
    Path | None, typer.Option("--plot", metavar="FILE", help="Draw them: PNG, PDF or SVG.")
]
Seed = Annotated[int, typer.Option(help="Of whatever is drawn at random.")]
Quick = Annotated[bool, typer.Option("--quick", help="A smaller version, in seconds.")]
Crs = Annotated[
    str | None, typer.Option(help="The DEM's CRS where its file has none, e.g. EPSG:32632.")
]


@app.command("speed-error")
def speed_error(
    dem: Dems,
    viewpoints: Annotated[
        int, typer.Option(help="Viewpoints of a batch, on a 100 m grid in the DEM's middle.")
    ] = _SPEED_ERROR.viewpoints,
    width: Annotated[
        int, typer.Option(help="Columns of all but the depth path.")
    ] = _SPEED_ERROR.width,
    json_file: JsonFile = None,
    plot: PlotFile = None,
    seed: Seed = _SPEED_ERROR.seed,
    quick: Quick = False,
    crs: Crs = None,
) -> None:
    """Every way to a skyline: milliseconds a viewpoint against error from the oracle."""
    config = replace(_SPEED_ERROR, viewpoints=viewpoints, width=width, seed=seed)
    _check_outputs(json_file, plot)
    terrain = read_dem(dem, DemOptions(crs=crs))
    with progress_bar("measuring") as progress:
        rows = measure(terrain, config.quick() if quick else config, progress)
    columns = {
        "path": "path",
        "setting": "setting",
        "viewpoints_per_s": "per s",
        "ms_per_viewpoint": "ms",
        "ms_alone": "alone",
        "rms_px": "rms px",
        "max_px": "max px",
        "missing": "lost",
    }
    _print_rows(rows, columns)
    if json_file is not None:
        write_record(json_file, "speed-error", rows)
    if plot is not None:
        save_speed_error(rows, machine(), plot)


@app.command()
def stability(
    json_file: JsonFile = None,
    plot: PlotFile = None,
    seed: Annotated[
        int, typer.Option(help="For uniformity: the cases are fixed, nothing is drawn.")
    ] = 0,
    quick: Quick = False,
) -> None:
    """Every hard case along every path that promises something there; exit code 1 if one fails."""
    _check_outputs(json_file, plot)
    rows: list[hard_cases.Row] = []
    asked = [
        (path, case)
        for path in (HORIZON, DEPTH)
        for case in hard_cases.HARD_CASES
        if path.name in case.paths
    ]
    with progress_bar("cases") as progress:
        for path, case in asked:
            progress(len(rows), len(asked))
            rows += hard_cases.measure(path, quick, [case])
    _print_rows(
        [{**row, "verdict": "holds" if row["ok"] else "FAILS"} for row in rows],
        {
            "case": "case",
            "path": "path",
            "error_px": "error px",
            "bound_px": "bound px",
            "verdict": "verdict",
        },
    )
    if json_file is not None:
        write_record(json_file, "stability", rows)
    if plot is not None:
        save_stability(rows, plot)
    failed = [f"{row['case']} ({row['path']})" for row in rows if not row["ok"]]
    if failed:
        raise SkylineError(f"{len(failed)} of {len(rows)} cases fail: {', '.join(failed)}")


@app.command()
def table1(
    seeds: Annotated[int, typer.Option(help="How many seeds, from 0 on.")] = SEEDS,
    json_file: JsonFile = None,
    plot: PlotFile = None,
    quick: Quick = False,
) -> None:
    """Repeat the paper's simulation: viewpoints and overlap of every strategy, its own and ours."""
    _check_outputs(json_file, plot)
    rows = measure_table1(seeds, quick)
    columns = {
        "row": "row",
        "strategy": "strategy",
        "A": "(A)",
        "A_std": "+-",
        "B": "(B)",
        "mean_area": "mean area",
        "bound": "bound",
        "seconds": "s",
    }
    _print_rows(rows, columns)
    for said, holds in conclusions(rows).items():
        typer.echo(f"{'holds' if holds else 'does not hold':<14} {said}")
    if json_file is not None:
        write_record(json_file, "table1", rows)
    if plot is not None:
        plot_table1(plot)


@app.command()
def matching(
    dem: Dems,
    bounds: Annotated[
        str | None,
        typer.Option(
            metavar="W,S,E,N",
            help="Degrees of longitude and latitude (WGS 84); by default 5 x 10 km in the middle.",
        ),
    ] = None,
    spacing: Annotated[
        list[float] | None,
        typer.Option(help="Of a uniform store, metres; may be repeated [1024 512 256 128]."),
    ] = None,
    shells: Annotated[int, typer.Option(help="Distance shells these stores keep.")] = (
        _MATCHING.shells
    ),
    store: Annotated[
        list[Path] | None,
        typer.Option(help="A store that is there already, instead; may be repeated."),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(help="Where uniform stores are kept and found again; else thrown away."),
    ] = None,
    matcher: Annotated[
        list[str] | None,
        typer.Option(help=f"May be repeated; by default all: {', '.join(OPENERS)}."),
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(help=f"Of queries; may be repeated; by default all: {', '.join(KINDS)}."),
    ] = None,
    queries: Annotated[int, typer.Option(help="Queries of each kind.")] = _MATCHING.queries,
    json_file: JsonFile = None,
    per_query: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write every candidate of every query: CSV or JSON."),
    ] = None,
    plot: PlotFile = None,
    seed: Seed = _MATCHING.seed,
    quick: Quick = False,
    crs: Crs = None,
) -> None:
    """Matchers on uniform stores: how often, how far off and how fast made queries are found.

    A query without any candidate counts as wrong by half of the area's diagonal.
    """
    spacings_m = tuple(spacing) if spacing else () if store else _MATCHING.spacings_m
    config = MatchingConfig(
        bounds_deg=parse_bounds(bounds) if bounds is not None else None,
        spacings_m=spacings_m,
        shells=shells,
        stores=tuple(store or ()),
        matchers=tuple(matcher or OPENERS),
        kinds=tuple(kind or KINDS),
        queries=queries,
        seed=seed,
    )
    _check_outputs(json_file, plot)
    _check_folder("--per-query", per_query)
    terrain = read_dem(dem, DemOptions(crs=crs))
    with _folder(folder) as place, progress_bar("matching") as progress:
        compared = measure_matching(terrain, config.quick() if quick else config, place, progress)
    rows = [comparison.row(seed) for comparison in compared]
    columns = {
        "store": "store",
        "matcher": "matcher",
        "queries": "queries",
        "within_200m": "in 200 m",
        "within_200m_low": "from",
        "within_200m_high": "to",
        "median_m": "median m",
        "p90_m": "90 % m",
        "heading_median_deg": "heading",
        "answered": "answered",
        "query_ms": "ms",
    }
    _print_rows(rows, columns)
    if json_file is not None:
        write_record(json_file, "matching", rows)
    if per_query is not None:
        candidates = [
            {"store": each.store.name, "matcher": each.matcher, "queries": each.kind, **row}
            for each in compared
            for trial in each.trials
            for row in candidate_rows(trial)
        ]
        write_rows(per_query, "matching-candidates", candidates)
    if plot is not None:
        save_errors(compared, plot)


@app.callback(invoke_without_command=True)
def options(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Measure Skyline: speeds with their errors, on this machine."""
    if version:
        typer.echo(f"skyline {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


def main() -> None:
    """Run the command line; every error is one line, exit code 2 for bad input, 1 for failure."""
    run_app(app, "stopped; nothing was written")


def _check_outputs(json_file: Path | None, plot: Path | None) -> None:
    """Refuse files that could not be written, before the measurement and not after it."""
    for option, path in (("--json", json_file), ("--plot", plot)):
        _check_folder(option, path)
    if plot is not None and plot.suffix.lower() not in _PLOT_SUFFIXES:
        raise InputError(
            f"--plot {plot}: cannot draw {plot.suffix!r}; expected {', '.join(_PLOT_SUFFIXES)}"
        )


def _check_folder(option: str, path: Path | None) -> None:
    if path is not None and not path.absolute().parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}; make it first")


@contextmanager
def _folder(kept: Path | None) -> Iterator[Path]:
    """Give a folder for stores: the one named, made where it is not there, else one for now."""
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
        yield kept
        return
    with tempfile.TemporaryDirectory(prefix="skyline-bench-") as passing:
        yield Path(passing)


def _print_rows(rows: Sequence[Row], columns: dict[str, str]) -> None:
    """Print rows as a table; ``columns`` are the keys shown, with their headings."""
    table = Table(box=SIMPLE_HEAD)
    for key, heading in columns.items():
        words = any(isinstance(row.get(key), str) for row in rows)
        table.add_column(heading, justify="left" if words else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(_cell(row.get(key)) for key in columns))
    console = Console()
    # A file or a pipe has no width that figures would have to be cut to.
    (console if console.is_terminal else Console(width=_PIPED_WIDTH)).print(table)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
    return str(value)
