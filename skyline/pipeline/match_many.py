"""Matching many queries, spread over workers that each open the store once."""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

from skyline.errors import SkylineError
from skyline.photo import Projection, QuerySkyline, SkySession, load_sky_model, read_query
from skyline.pipeline.jobs import Runner, in_order
from skyline.pipeline.match import Matcher, MatchResult


@dataclass(frozen=True, slots=True)
class QueryReading:
    """How queries are read; see `read_query`.

    Attributes
    ----------
    fov_deg : float, optional
    projection : Projection, optional
    sky_model : Path, optional
        Loaded once a process.
    """

    fov_deg: float | None = None
    projection: Projection | None = None
    sky_model: Path | None = None

    def read(self, path: str | Path) -> QuerySkyline:
        """Read a query; raises as `read_query`."""
        model = None if self.sky_model is None else _sky_model(self.sky_model.absolute())
        return read_query(path, self.fov_deg, projection=self.projection, sky_model=model)


_sky_model: Callable[[Path], SkySession] = lru_cache(maxsize=1)(load_sky_model)


def match_many(
    runner: Runner,
    matcher: tuple[Hashable, ...],
    queries: Sequence[str | Path],
    reading: QueryReading | None = None,
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
    queries : sequence of paths
    reading : QueryReading, optional
    top : int
        As of `Matcher.match`.
    """
    store = Path(str(matcher[0])).absolute()
    # A worker that outlives this command must not take a store for the one it has replaced.
    stamp = store.stat().st_mtime_ns if store.exists() else 0
    work = partial(_match, stamp, (str(store), *matcher[1:]), reading or QueryReading(), top)
    names = [f"query-{index}" for index in range(len(queries))]
    return in_order(runner(work, [str(Path(query).absolute()) for query in queries], names))


def _match(
    stamp: int, matcher: tuple[Hashable, ...], reading: QueryReading, top: int, query: str
) -> MatchResult:
    return _opened(stamp, *matcher).match(reading.read(query), top=top)


_here: dict[tuple[Hashable, ...], Matcher] = {}
"""The matcher that this process has open."""


def _opened(*asked: Hashable) -> Matcher:
    if asked not in _here:
        while _here:
            _here.popitem()[1].release()
        _, *matcher = asked
        _here[asked] = Matcher(*matcher)  # type: ignore[arg-type]
    return _here[asked]
