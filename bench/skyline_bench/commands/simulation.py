"""Planning measured: the paper's simulation."""

from typing import Annotated

import typer

from skyline_bench.commands.options import JsonFile, PlotFile, Quick, check_outputs, print_rows
from skyline_bench.measuring.record import write_record
from skyline_bench.runs.table1 import SEEDS, conclusions, measure
from skyline_bench.runs.table1 import plot as plot_table1


def table1(
    seeds: Annotated[int, typer.Option(help="How many seeds, from 0 on.")] = SEEDS,
    json_file: JsonFile = None,
    plot: PlotFile = None,
    quick: Quick = False,
) -> None:
    """Repeat the paper's simulation: viewpoints and overlap of every strategy, its own and ours."""
    check_outputs(json_file, plot)
    rows = measure(seeds, quick)
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
    print_rows(rows, columns)
    for said, holds in conclusions(rows).items():
        typer.echo(f"{'holds' if holds else 'does not hold':<14} {said}")
    if json_file is not None:
        write_record(json_file, "table1", rows)
    if plot is not None:
        plot_table1(plot)
