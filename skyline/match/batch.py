"""Matching queries on workers, each of which opens the store once.

A store of many places is screened in parts, so that one query keeps many workers busy. The parts'
places are joined, and one worker fits and refines the best. The answers are those of one process,
to the bit.
"""

import time
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

from skyline.build.cluster import Runner
from skyline.errors import SkylineError
from skyline.match.answer import MatchResult
from skyline.match.matcher import Matcher
from skyline.match.queries import Query
from skyline.match.screening import Alike
from skyline.photo.query import QuerySkyline
from skyline.store import open_store
from skyline.store.format import PLACES, PLACES_A_CHUNK

_PART_BLOCKS = 128
"""Blocks of places that one job screens, in a tenth of a second."""

_Opening = tuple[Hashable, ...]
"""The time at which the store was written, followed by the arguments of `Matcher`."""


def match_many(
    runner: Runner, matcher: tuple[Hashable, ...], queries: Sequence[Query]
) -> Iterator[MatchResult | SkylineError]:
    """Match queries to a store; yields results in the queries' order, each as soon as it is there.

    In place of a query's result stands the error of `Matcher` or `Matcher.match` if the query
    fails; the others are still matched.

    Parameters
    ----------
    runner : Runner
        Runs the jobs. Workers need the store, the DEM and the queries under the same paths.
    matcher : tuple
        The arguments of `Matcher`, in order: the store's path first.
    """
    store = Path(str(matcher[0])).absolute()
    # A worker that outlives this command must not take a store for the one it has replaced.
    written = store.stat().st_mtime_ns if store.exists() else 0
    opening = (written, str(store), *matcher[1:])
    jobs = [replace(one, path=str(Path(one.path).absolute())) for one in queries]
    parts = _parts(store)
    screened: list[Alike | SkylineError | None] = [None] * len(jobs)
    if len(parts) > 1:
        of_parts = [(query, part) for query in jobs for part in parts]
        names = [f"screen-{index}" for index in range(len(of_parts))]
        found = list(runner(partial(_screen, opening), of_parts, names))
        each = range(0, len(found), len(parts))
        screened = [_joined(found[start : start + len(parts)]) for start in each]
    left = [
        (query, alike)
        for query, alike in zip(jobs, screened, strict=True)
        if not isinstance(alike, SkylineError)
    ]
    names = [f"query-{index}" for index in range(len(left))]
    matched = runner(partial(_match, opening), left, names)
    for query, alike in zip(queries, screened, strict=True):
        result = alike if isinstance(alike, SkylineError) else next(matched)
        yield replace(result, name=query.path) if isinstance(result, MatchResult) else result


def _parts(store: Path) -> list[slice]:
    """Return parts of a store's blocks of places; a single part if it has few or none."""
    try:
        with open_store(store) as opened:
            blocks = -(-len(opened) // PLACES_A_CHUNK) if opened.header.holds == PLACES else 0
    except SkylineError:
        return [slice(None)]  # Every job will raise the error.
    starts = range(0, max(blocks, 1), _PART_BLOCKS)
    return [slice(start, start + _PART_BLOCKS) for start in starts]


def _joined(parts: Sequence[Alike | SkylineError | None]) -> Alike | SkylineError | None:
    """Return the places of all parts, or the first error; None if there was nothing to screen."""
    errors = [part for part in parts if isinstance(part, SkylineError)]
    alike = [part for part in parts if isinstance(part, Alike)]
    if errors:
        return errors[0]
    return Alike.joined(alike) if len(alike) == len(parts) else None


def _screen(opening: _Opening, job: tuple[Query, slice]) -> Alike | None:
    query, part = job
    return _opened(*opening).screen(_read(query), query.narrowing, part)


def _match(opening: _Opening, job: tuple[Query, Alike | None]) -> MatchResult:
    query, screened = job
    matcher, started = _opened(*opening), time.perf_counter()
    found = matcher.match(_read(query), narrowing=query.narrowing, screened=screened)
    return replace(found, seconds=time.perf_counter() - started)


@lru_cache(maxsize=4)
def _read(query: Query) -> QuerySkyline:
    """Read a query once for all the parts of a store that this worker compares it with."""
    return query.read()


_open_matcher: dict[_Opening, Matcher] = {}
"""The one matcher that this process has open, by its opening."""


def _opened(*opening: Hashable) -> Matcher:
    if opening not in _open_matcher:
        while _open_matcher:
            _open_matcher.popitem()[1].release()
        _open_matcher[opening] = Matcher(*opening[1:])  # type: ignore[arg-type]
    return _open_matcher[opening]
