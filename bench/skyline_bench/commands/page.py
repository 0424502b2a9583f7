"""The page measured as a person at it waits: ready, strokes, the live skyline, memory."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline_bench.commands.options import JsonFile, Quick, check_outputs, keep_record, print_rows
from skyline_bench.runs import page as pages


def page(
    matches: Annotated[int, typer.Option(help="Over which memory is compared.")] = 50,
    json_file: JsonFile = None,
    quick: Quick = False,
) -> None:
    """The page in a browser: ready, strokes on 12 megapixels, the live skyline, memory."""
    check_outputs(json_file, None)
    with (
        tempfile.TemporaryDirectory(prefix="skyline-bench-") as folder,
        progress_bar("page") as bar,
    ):
        rows = pages.measure(Path(folder), 3 if quick else matches, 2.0 if quick else 10.0, bar)
    print_rows(rows)
    keep_record(json_file, "page", rows)
