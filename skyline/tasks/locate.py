"""Locating photos in the area where they were taken.

The store of the area is made or found in the cache, and searched.
"""

import os
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from skyline.cache import cached_files, prepare_area
from skyline.errors import InputError, MissingFileError
from skyline.location import area_of
from skyline.match.narrowing import Narrowing
from skyline.match.photo_lists import Entry, usable_entries
from skyline.tasks.listener import Listener
from skyline.tasks.match import MatchTask, match_photos


def locate_photos(search: MatchTask, source: str | None, listener: Listener) -> int:
    """Find where photos were taken, and show the results.

    The photos or the user name the area, so ``search`` has no stores yet. If it has no elevation
    files either, tiles are fetched from ``source``, as by `prepare_area`. Returns the exit code as
    `match_photos`. Raises `InputError` if no photo can be read, the area is unknown, or the DEM
    does not cover it, and `FetchError` if a server fails.
    """
    if search.dem and source:
        raise InputError(
            "give one of --dem (files at hand; also $SKYLINE_DEM) and --source (tiles to fetch)"
        )
    # These checks come before minutes of work.
    usable = usable_entries(search.entries)
    if search.peaks is not None and not search.peaks.is_file():
        raise MissingFileError(f"{search.peaks} does not exist; expected peaks to name")
    search.check_files()
    given = search.common.narrowing
    area, narrowing = area_of([one.path for one in usable], given)
    before = cached_files()
    listener.keeps(
        "what was fetched and built is kept, and the same command continues from there",
        lambda: bool(cached_files() - before),
    )
    ready = prepare_area(area, search.dem, source, listener.note, listener.progress)
    listener.keeps(f"the area is kept in {ready.folder}")
    serve = serving_command(ready.folder, [one.path for one in usable])
    found_in = replace(
        search,
        stores=(ready.store,),
        entries=[_within(one, given, narrowing) for one in search.entries],
        common=replace(search.common, narrowing=narrowing),
        dem=[str(ready.terrain)],
        serve=serve,
    )
    code = match_photos(found_in, listener)
    listener.note(f"to mend a skyline or to place a camera by hand: {serve}")
    return code


def serving_command(area: Path, photos: Sequence[str]) -> str:
    """Return the command that serves the page with photos of an area.

    If there are very many photos, it names the first ones.
    """
    home = f"{Path.home()}{os.sep}"
    # Others who read the report need not learn the user's name, which the home folder has.
    words = [shlex.quote(str(area).removeprefix(home)), *map(shlex.quote, photos[:9])]
    if str(area).startswith(home):
        words[0] = f"~/{words[0]}"
    return " ".join(["skyline serve", *words])


def _within(entry: Entry, given: Narrowing, area: Narrowing) -> Entry:
    """Return a photo whose search is narrowed to the area.

    A circle from a list of photos stays.
    """
    own = entry.narrowing
    near = area.near if own.near == given.near else own.near
    return replace(entry, narrowing=replace(own, near=near, bounds_deg=area.bounds_deg))
