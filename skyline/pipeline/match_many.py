"""Matching many queries, spread over workers that each open the store once."""

from collections.abc import Hashable, Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path

from skyline.photo import QuerySkyline
from skyline.pipeline.jobs import Runner, in_order
from skyline.pipeline.match import Matcher, MatchResult


def match_many(
    runner: Runner,
    matcher: tuple[Hashable, ...],
    queries: Sequence[QuerySkyline],
    top: int = 5,
) -> Iterator[MatchResult]:
    """Match queries to a store; yields results in the queries' order, as they come.

    Parameters
    ----------
    runner : Runner
        What does the matching. Workers need the store under the same path.
    matcher : tuple
        What a `Matcher` is made of, in order: the store's path first.
    queries : sequence of QuerySkyline
    top : int
        As of `Matcher.match`.

    Raises
    ------
    SkylineError
        As `Matcher` and `Matcher.match`, at the place of the query that fails.
    """
    store = Path(str(matcher[0])).absolute()
    # A worker that outlives this command must not take a store for the one it has replaced.
    stamp = store.stat().st_mtime_ns if store.exists() else 0
    work = partial(_match, stamp, (str(store), *matcher[1:]), top)
    names = [f"query-{index}" for index in range(len(queries))]
    return in_order(runner(work, queries, names))


def _match(stamp: int, matcher: tuple[Hashable, ...], top: int, query: QuerySkyline) -> MatchResult:
    return _opened(stamp, *matcher).match(query, top=top)


@lru_cache(maxsize=1)
def _opened(_stamp: int, *matcher: Hashable) -> Matcher:
    return Matcher(*matcher)  # type: ignore[arg-type]
