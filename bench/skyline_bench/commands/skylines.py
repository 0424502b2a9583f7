"""Skylines held to the truth: the hard cases, and the summits of a DEM's file."""

import typer

from skyline.cli.console import progress_bar
from skyline.errors import SkylineError
from skyline_bench.commands import options
from skyline_bench.measuring.record import Row, write_record
from skyline_bench.runs import summits as summits_kept
from skyline_bench.truth import stability as hard_cases
from skyline_bench.truth.agreement import DEPTH, HORIZON


def stability(json_file: options.JsonFile = None, quick: options.Quick = False) -> None:
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
    failed = [f"{row['case']} ({row['path']})" for row in rows if not row["ok"]]
    if failed:
        raise SkylineError(f"{len(failed)} of {len(rows)} cases fail: {', '.join(failed)}")


def summits(
    dem: options.Dems,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Summits of a DEM's file and of its surface, how they are seen, and horizons beside them.

    A record that is there keeps the rows of other DEMs.
    """
    config = summits_kept.SummitsConfig()
    rows = summits_kept.measure(dem, crs, config.quick() if quick else config)
    columns = """surface spacing_m summits lowest_m highest_m summits_off sights median_sight_m
        p90_sight_m bias_m rms_off_m place_cpu_ms"""
    options.print_rows(rows, columns)
    for name, value in rows[0].items():
        if name.startswith(
            ("summit_below", "prominent", "coarse", "anywhere", *summits_kept.STOOD)
        ):
            typer.echo(f"{name:<24} {value:g}")
    write_record(json_file, "summits", options.rows_but(json_file, "dem", [rows[0]["dem"]]) + rows)
