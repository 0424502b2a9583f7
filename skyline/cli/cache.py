"""``skyline cache``: what is kept for later runs."""

import json
from contextlib import suppress
from datetime import datetime
from typing import Annotated, Any

import typer
from typer import Option

from skyline.cache import cached_areas, clear_cache
from skyline.cli.options import AsJson
from skyline.cli.terminal import Terminal, size_in_words
from skyline.files.disk import cache_folder
from skyline.terrain.kept_models import kept_bytes


def cache(
    context: typer.Context,
    clear: Annotated[bool, Option("--clear", help="Remove all of it.")] = False,
    as_json: AsJson = False,
) -> None:
    """List what is kept: areas, and elevation models that were read.

    Commands take the folder of an area wherever they take a store, as in `skyline serve FOLDER`.
    """
    terminal = Terminal.of(context, as_json)
    areas = _areas()
    total = _bytes_of(areas) + kept_bytes()
    if clear:
        count = clear_cache(terminal.note)
        left = _bytes_of(_areas()) + kept_bytes()
        terminal.line(f"{cache_folder()}: areas removed: {count}, {size_in_words(total - left)}")
        return
    if as_json:
        about = {"folder": str(cache_folder()), "areas": areas, "model_bytes": kept_bytes()}
        terminal.line(json.dumps(about | {"bytes": total}))
        return
    for one in areas:
        unfinished = "" if one["finished"] else ", unfinished"
        store = f"store {size_in_words(one['store_bytes'])}{unfinished}"
        tiles = (
            f"tiles: {one['tiles']}, {size_in_words(one['tile_bytes'])}; " if one["tiles"] else ""
        )
        changed = datetime.fromisoformat(one["changed"])
        terminal.line(f"{one['folder']}: {tiles}{store}, {changed:%Y-%m-%d %H:%M}")
    if models := kept_bytes():
        terminal.line(f"elevation models as they were read: {size_in_words(models)}")
    terminal.line(f"{cache_folder()}: areas: {len(areas)}, {size_in_words(total)}")


def _areas() -> list[dict[str, Any]]:
    """Return the areas, except any that another process removes meanwhile."""
    areas = []
    for one in cached_areas():
        with suppress(FileNotFoundError):
            areas.append(one.to_dict())
    return areas


def _bytes_of(areas: list[dict[str, Any]]) -> int:
    return sum(one["tile_bytes"] + one["store_bytes"] for one in areas)
