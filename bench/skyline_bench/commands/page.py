"""The page measured as a person at it waits: ready, strokes, the live skyline, memory."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline_bench.commands import options
from skyline_bench.runs import page as pages


def page(
    matches: Annotated[int, typer.Option(help="Over which memory is compared.")] = 50,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
) -> None:
    """The page in a browser: ready, strokes on 12 megapixels, the live skyline, memory."""
    with (
        tempfile.TemporaryDirectory(prefix="skyline-bench-") as folder,
        progress_bar("page") as bar,
    ):
        rows = pages.measure(Path(folder), 3 if quick else matches, 2.0 if quick else 10.0, bar)
    options.tell(json_file, "page", rows)
