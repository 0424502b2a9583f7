"""Matching queries on workers, each of which opens the store once.

A store of many places is screened in parts, so that one query keeps many workers busy; what they
find is joined, and one of them fits and refines the best. The answers are those of one process,
to the bit.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from skyline.build.cluster import Runner, in_order
from skyline.errors import SkylineError
from skyline.match.matcher import Matcher
from skyline.match.queries import Query
from skyline.match.results import MatchResult
from skyline.match.screening import Alike
from skyline.photo.query import QuerySkyline
from skyline.store import open_store
from skyline.store.format import PLACES, PLACES_A_CHUNK

_read: Callable[[Query], QuerySkyline] = lru_cache(maxsize=4)(Query.read)
"""Once for all the parts of a store that a query is compared with."""

_PART_BLOCKS = 128
"""Blocks of places that are screened by one job: a tenth of a second."""

_Job = tuple[Query, slice]
_Asked = tuple[Hashable, ...]


@dataclass(frozen=True, slots=True)
class _Work:
    """What all jobs of a batch share."""

    stamp: int
    """When the store was written."""
    matcher: _Asked
    """What a `Matcher` is made of."""
    top: int

    def screen(self, job: _Job) -> Alike | None:
        """Screen a part of the store for a query."""
        query, part = job
        opened = _opened(self.stamp, *self.matcher)
        return opened.screen(_read(query), query.narrowing, part)

    def match(self, job: tuple[Query, Alike | None]) -> MatchResult:
        """Match a query, given what all parts were screened for."""
        query, screened = job
        opened = _opened(self.stamp, *self.matcher)
        return query.match(opened, self.top, _read(query), screened)


def match_many(
    runner: Runner,
    matcher: _Asked,
    queries: Sequence[Query],
    top: int = 5,
) -> Iterator[MatchResult | SkylineError]:
    """Match queries to a store; yields results in the queries' order, as they come.

    In the place of a query that fails comes what `Matcher` or `Matcher.match` raised, and the
    others are matched.

    Parameters
    ----------
    runner : Runner
        What does the matching. Workers need the store, the DEM and the queries under the same
        paths.
    matcher : tuple
        What a `Matcher` is made of, in order: the store's path first.
    top : int
        As of `Matcher.match`.
    """
    store = Path(str(matcher[0])).absolute()
    # A worker that outlives this command must not take a store for the one it has replaced.
    stamp = store.stat().st_mtime_ns if store.exists() else 0
    work = _Work(stamp, (str(store), *matcher[1:]), top)
    asked = [replace(query, path=str(Path(query.path).absolute())) for query in queries]
    parts = _parts(store)
    screened: list[Alike | None] = [None] * len(asked)
    failed: dict[int, SkylineError] = {}
    if len(parts) > 1:
        jobs = [(query, part) for query in asked for part in parts]
        names = [f"screen-{index}" for index in range(len(jobs))]
        found = list(in_order(runner(work.screen, jobs, names)))
        for index in range(len(asked)):
            some = found[index * len(parts) : (index + 1) * len(parts)]
            errors = [one for one in some if isinstance(one, SkylineError)]
            if errors:
                failed[index] = errors[0]
            else:
                screened[index] = _joined(some)
    left = [index for index in range(len(asked)) if index not in failed]
    names = [f"query-{index}" for index in left]
    done = in_order(runner(work.match, [(asked[k], screened[k]) for k in left], names))
    for index in range(len(asked)):
        yield failed[index] if index in failed else next(done)


def _parts(store: Path) -> list[slice]:
    """Return parts of a store's blocks of places; one where there is nothing to share."""
    try:
        with open_store(store) as opened:
            holds, rows = opened.header.holds, len(opened)
            blocks = -(-rows // PLACES_A_CHUNK) if holds == PLACES else 0
    except SkylineError:
        # Each job says so by itself.
        return [slice(None)]
    starts = range(0, max(blocks, 1), _PART_BLOCKS)
    return [slice(start, start + _PART_BLOCKS) for start in starts]


def _joined(parts: Sequence[Alike | SkylineError | None]) -> Alike | None:
    alike = [part for part in parts if isinstance(part, Alike)]
    return Alike.joined(alike) if len(alike) == len(parts) else None


_here: dict[_Asked, Matcher] = {}
"""The matcher that this process has open."""


def _opened(*asked: Hashable) -> Matcher:
    if asked not in _here:
        while _here:
            _here.popitem()[1].release()
        _, *matcher = asked
        _here[asked] = Matcher(*matcher)  # type: ignore[arg-type]
    return _here[asked]
