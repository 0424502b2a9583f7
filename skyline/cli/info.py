"""``skyline info``: facts about a DEM, a store and OpenGL."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline.cache import store_of
from skyline.cli.facts import table_of
from skyline.cli.options import AsJson, Crs
from skyline.cli.terminal import Terminal
from skyline.errors import InputError
from skyline.files.disk import STORE_SUFFIXES
from skyline.render.context import held_context
from skyline.store.read import is_store
from skyline.tasks.describe import MEANINGS, describe_store, describe_terrain
from skyline.tasks.terrain import read_terrain


def info(
    context: typer.Context,
    path: Annotated[
        list[str] | None,
        Argument(
            metavar="DEM|STORE.h5",
            help="The files of a DEM, a folder or zip of files, or a store.",
        ),
    ] = None,
    gl: Annotated[bool, Option("--gl", help="Show which OpenGL is used, and why.")] = False,
    as_json: AsJson = False,
    crs: Crs = None,
) -> None:
    """Describe a DEM, a store, or the OpenGL in use."""
    terminal = Terminal.of(context, as_json)
    if not path and not gl:
        raise InputError("nothing to describe; name a DEM or a store, or give --gl")
    facts: dict[str, object] = {}
    if gl:
        with held_context() as opengl:
            facts |= opengl.facts()
    one = store_of(Path(path[0])) if path and len(path) == 1 else None
    if one is not None and (is_store(one) or _is_missing_store(one)):
        facts |= describe_store(str(one))
    elif path:
        facts |= describe_terrain(read_terrain(terminal, path, crs))
    terminal.result(facts, table_of(facts, MEANINGS.get(str(facts.get("kind")))))


def _is_missing_store(path: Path) -> bool:
    return path.suffix in STORE_SUFFIXES and not path.exists()
