"""Skylines held to the truth: the hard cases, and the summits of a DEM's file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from skyline.console import progress_bar
from skyline.errors import SkylineError
from skyline_bench.commands import options
from skyline_bench.measuring.record import Row, write_record
from skyline_bench.runs import summits as summits_kept
from skyline_bench.truth import stability as hard_cases
from skyline_bench.truth.agreement import DEPTH, HORIZON


def stability(
    json_file: options.JsonFile = None, plot: options.PlotFile = None, quick: options.Quick = False
) -> None:
    """Every hard case along every path that promises something there; exit code 1 if one fails."""
    rows: list[Row] = []
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
    verdicts = [{**row, "verdict": "holds" if row["ok"] else "FAILS"} for row in rows]
    options.print_rows(verdicts, "case path error_px bound_px verdict")
    write_record(json_file, "stability", rows)
    if plot is not None:
        save_stability(rows, plot)
    failed = [f"{row['case']} ({row['path']})" for row in rows if not row["ok"]]
    if failed:
        raise SkylineError(f"{len(failed)} of {len(rows)} cases fail: {', '.join(failed)}")


_SMALLEST_PX, _LARGEST_PX = 1e-8, 1e3
"""Errors of 0 and of columns without a value are drawn at these."""


def save_stability(rows: Sequence[Row], path: Path) -> None:
    """Save every hard case's greatest error beside its bound, on a log scale, a panel a path."""
    paths = list(dict.fromkeys(row["path"] for row in rows))
    cases = list(dict.fromkeys(row["case"] for row in rows))
    figure = Figure(figsize=(6.5 + 3.5 * len(paths), 1.5 + 0.19 * len(cases)), layout="constrained")
    panels = figure.subplots(1, len(paths), sharey=True, squeeze=False)[0]
    for axis, name in zip(panels, paths, strict=True):
        mine = [row for row in rows if row["path"] == name]
        place = [cases.index(row["case"]) for row in mine]
        error, bound = np.clip(
            [[row[key] for row in mine] for key in ("error_px", "bound_px")],
            _SMALLEST_PX, _LARGEST_PX,
        )  # fmt: skip
        colours = ["tab:green" if row["ok"] else "crimson" for row in mine]
        axis.scatter(bound, place, marker="|", color="black", label="bound")
        axis.scatter(error, place, marker="o", s=14, c=colours, label="greatest error")
        axis.set(xscale="log", xlabel="px (0 at 1e-8)", title=f"{name} path")
        axis.grid(alpha=0.25)
    panels[0].set_yticks(range(len(cases)), cases, fontsize=7)
    panels[0].set_ylim(len(cases) - 0.5, -0.5)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.savefig(path, dpi=110)


def summits(
    dem: options.Dems,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Summits of a DEM's file against those of the surface, how they are seen and what from them.

    A record that is there keeps the rows of other DEMs.
    """
    config = summits_kept.SummitsConfig()
    rows = summits_kept.measure(dem, crs, config.quick() if quick else config)
    columns = """surface spacing_m summits lowest_m highest_m summits_off sights median_sight_m
        p90_sight_m bias_m rms_off_m place_cpu_ms"""
    options.print_rows(rows, columns)
    for name, value in rows[0].items():
        if name.startswith(("summit_below", "prominent", "anywhere", *summits_kept.STOOD)):
            typer.echo(f"{name:<24} {value:g}")
    write_record(json_file, "summits", options.rows_but(json_file, "dem", [rows[0]["dem"]]) + rows)
