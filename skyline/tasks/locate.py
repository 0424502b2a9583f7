"""Locating photos in the area where they were taken.

The store of the area is made or found in the cache, and searched.
"""

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from skyline.batch import Entry, usable_entries
from skyline.cache import cached_files, prepare_area
from skyline.errors import InputError, MissingFileError
from skyline.location import area_of
from skyline.match.prior import Narrowing
from skyline.tasks.listener import Listener
from skyline.tasks.match import MatchTask, match_photos


@dataclass(frozen=True, slots=True, kw_only=True)
class LocateTask:
    """Photos of one area, and where its elevation comes from."""

    entries: Sequence[Entry]
    """The photos."""
    common: Entry
    """What is known of every photo."""
    inputs: Sequence[Path] = ()
    """Files that the user has named as photos: no output replaces them."""
    dem: Sequence[str] = ()
    """Elevation files, or folders of them; by default tiles are fetched."""
    source: str | None = None
    """Source of tiles, as for `prepare_area`."""
    same_place: bool = False
    """Whether all photos were taken at one place."""
    report: Path
    """Folder of a page with pictures and maps."""
    peaks: Path | None = None
    """Gazetteer of the page."""
    exports: Sequence[Path] = ()
    """Files of the candidates, as in `MatchTask`."""
    probability: Sequence[Path] = ()
    """Files of the posteriors, as in `MatchTask`."""
    walked_km_h: float | None = None
    """As in `MatchTask`."""


def locate_photos(task: LocateTask, listener: Listener) -> int:
    """Find where photos were taken, and show the results.

    The photos or the user name the area. Returns the exit code as `match_photos`. Raises
    `InputError` if no photo can be read, the area is unknown, or the DEM does not cover it, and
    `FetchError` if a server fails.
    """
    if task.dem and task.source:
        raise InputError(
            "give one of --dem (files at hand; also $SKYLINE_DEM) and --source (tiles to fetch)"
        )
    # These checks come before minutes of work.
    usable = usable_entries(task.entries)
    if task.peaks is not None and not task.peaks.is_file():
        raise MissingFileError(f"{task.peaks} does not exist; expected peaks to name")
    search = MatchTask(
        stores=(),
        entries=task.entries,
        common=task.common,
        inputs=task.inputs,
        same_place=task.same_place,
        report=task.report,
        peaks=task.peaks,
        exports=task.exports,
        probability=task.probability,
        walked_km_h=task.walked_km_h,
    )
    search.check_files()
    area, narrowing = area_of([one.path for one in usable], task.common.narrowing)
    before = cached_files()
    listener.keeps(
        "what was fetched and built is kept, and the same command continues from there",
        lambda: bool(cached_files() - before),
    )
    ready = prepare_area(area, task.dem, task.source, listener.note, listener.progress)
    listener.keeps(f"the area is kept in {ready.folder}")
    serve = serving_command(ready.folder, [one.path for one in usable])
    found_in = replace(
        search,
        stores=(ready.store,),
        entries=[_within(one, task.common.narrowing, narrowing) for one in task.entries],
        common=replace(task.common, narrowing=narrowing),
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
