"""``skyline cache``: the elevation tiles and the stores of areas that ``locate`` keeps."""

import json
from datetime import datetime
from typing import Annotated, Any

from typer import Option

from skyline.cli.console import AsJson, print_line, print_note
from skyline.match.areas import cache_folder, cached_areas, clear_cache


def cache(
    clear: Annotated[bool, Option("--clear", help="Remove all of it.")] = False,
    as_json: AsJson = False,
) -> None:
    """List what `locate` keeps: elevation tiles and stores of areas."""
    areas = [one.to_dict() for one in cached_areas()]
    total = _bytes_of(areas)
    if clear:
        count = clear_cache(print_note)
        left = _bytes_of([one.to_dict() for one in cached_areas()])
        print_line(f"{cache_folder()}: {count} areas removed, {(total - left) / 1e6:.1f} MB")
        return
    if as_json:
        about = {"folder": str(cache_folder()), "areas": areas}
        print_line(json.dumps(about | {"bytes": total}))
        return
    for one in areas:
        unfinished = "" if one["finished"] else ", unfinished"
        store = f"store {one['store_bytes'] / 1e6:.1f} MB{unfinished}"
        tiles = f"{one['tiles']} tiles {one['tile_bytes'] / 1e6:.1f} MB, " if one["tiles"] else ""
        box = ",".join(f"{side:g}" for side in one["bounds_deg"])
        changed = datetime.fromisoformat(one["changed"])
        print_line(f"{one['origin']} {box}: {tiles}{store}, {changed:%Y-%m-%d %H:%M}")
    print_line(f"{cache_folder()}: {len(areas)} areas, {total / 1e6:.1f} MB")


def _bytes_of(areas: list[dict[str, Any]]) -> int:
    """Return the size of all files of areas."""
    return sum(one["tile_bytes"] + one["store_bytes"] for one in areas)
