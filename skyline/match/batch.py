"""Matching the photos of a list, here or on workers.

An entry of a list is one job of a worker, which opens the store once. The answers are the same to
the bit as in one process.
"""

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from skyline.errors import SkylineError
from skyline.files.disk import version_of
from skyline.match.config import MatchConfig
from skyline.match.matcher import Matcher
from skyline.match.photo_lists import Entry
from skyline.match.result import MatchResult
from skyline.survey.cluster import Opening, Runner, Tell


def match_here(matcher: Matcher, entries: Iterable[Entry]) -> Iterator[MatchResult | SkylineError]:
    """Match photos in this process; yield each one's result or error."""
    for entry in entries:
        try:
            yield _match(matcher, entry)
        except SkylineError as error:
            yield error


@dataclass(frozen=True, slots=True)
class MatcherFiles:
    """A matcher's files and settings, by which any process opens it."""

    stores: tuple[Path, ...]
    dem: tuple[str, ...]
    """Elevation files of the stores; none for those that the stores name."""
    surface: tuple[str, ...]
    """Files of a surface or canopy model; none without one."""
    matcher: str
    config: MatchConfig

    def open(self) -> Matcher:
        """Open the matcher; raises as `Matcher`."""
        dem, surface = self.dem or None, self.surface or None
        return Matcher(self.stores, dem, self.matcher, self.config, surface=surface)


def match_many(
    runner: Runner, files: MatcherFiles, entries: Sequence[Entry]
) -> Iterator[MatchResult | SkylineError]:
    """Match photos on workers; yield results in order, as soon as possible.

    A photo that cannot be matched yields its error; the others are still matched. Workers need the
    stores, the DEM and the photos under the same paths.
    """
    files = replace(files, stores=tuple(one.absolute() for one in files.stores))
    # A worker that outlives this command must not take a file for the one it has replaced.
    read = *files.stores, *map(Path, files.dem), *map(Path, files.surface)
    opening = Opening((tuple(map(version_of, read)), files), files.open)
    jobs = [replace(one, path=str(Path(one.path).absolute())) for one in entries]
    names = [f"photo-{index}" for index in range(len(jobs))]
    matched = runner(_match, opening, jobs, names)
    for entry, result in zip(entries, matched, strict=True):
        yield _named_as(entry.path, result)


def _named_as(path: str, result: MatchResult | SkylineError) -> MatchResult | SkylineError:
    """Return a worker's result under the photo's path as given.

    The worker knows the photo by its absolute path.
    """
    if isinstance(result, MatchResult):
        return replace(result, name=path)
    return type(result)(str(result).replace(str(Path(path).absolute()), path))


def _match(matcher: Matcher, entry: Entry, _: Tell | None = None) -> MatchResult:
    """Match one photo; the result's seconds include reading it."""
    started = time.perf_counter()
    found = matcher.match(entry.read(), narrowing=entry.narrowing)
    seconds = time.perf_counter() - started
    return replace(found, seconds=seconds, name=entry.path, id=entry.label)
