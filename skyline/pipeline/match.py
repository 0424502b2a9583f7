"""Matching queries to a store."""

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError
from skyline.geodesy import Frame
from skyline.matching import MATCHERS, Candidate, Profiles, QueryRays
from skyline.photo import QuerySkyline, read_query
from skyline.store import Store, open_store
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

_ROWS_A_READ = 1024


@dataclass(frozen=True, slots=True)
class MatchResult:
    """What was found for one query.

    Attributes
    ----------
    query : QuerySkyline
        The skyline that was matched.
    candidates : tuple of Candidate
        Best first; headings from grid north.
    seconds : float
        From the query to the candidates.
    """

    query: QuerySkyline
    candidates: tuple[Candidate, ...]
    seconds: float

    @property
    def answer(self) -> Candidate | None:
        """The best candidate, if there is any."""
        return self.candidates[0] if self.candidates else None


class Matcher:
    """Matches query skylines to a store, which is read once.

    Parameters
    ----------
    store : str or Path
    matcher : str
        A name of `skyline.matching.MATCHERS`.

    Raises
    ------
    InputError
        No such matcher, or a store without renderings.
    StoreError
        The store cannot be read.
    """

    def __init__(self, store: str | Path, matcher: str = "paper") -> None:
        if matcher not in MATCHERS:
            raise InputError(f"matcher is {matcher!r}; expected one of {', '.join(MATCHERS)}")
        self._matcher = MATCHERS[matcher]()
        with open_store(store) as opened:
            self.header = opened.header
            self._profiles = Profiles.from_views(_chunks(opened))
        self.frame = Frame(self.header.frame_wkt)

    @property
    def viewpoints(self) -> Viewpoints:
        """The store's locations."""
        profiles = self._profiles
        return Viewpoints(profiles.easting_m, profiles.northing_m, profiles.eye_elevation_m)

    def match(
        self, query: str | Path | QuerySkyline, fov_deg: float | None = None, top: int = 5
    ) -> MatchResult:
        """Find where a photo, a sky mask, a trace or a query skyline was taken.

        Parameters
        ----------
        query : path or QuerySkyline
        fov_deg : float, optional
            Horizontal field of view; by default the query's own.
        top : int
            How many candidates to return at most.

        Raises
        ------
        InputError
            The query has no usable skyline, or its field of view is not known.
        """
        started = time.perf_counter()
        if not isinstance(query, QuerySkyline):
            query = read_query(query, fov_deg)
        elif fov_deg is not None:
            query = query.with_fov(fov_deg)
        candidates = self._matcher.rank(self._profiles, _rays(query), top)
        return MatchResult(query, tuple(candidates), time.perf_counter() - started)


def _rays(query: QuerySkyline) -> QueryRays:
    if query.fov_deg is None:
        raise InputError(
            "the query's field of view is not known: it is not in the image; give --fov-deg"
        )
    u, v = query.image_plane()
    trusted = np.isfinite(query.row_px)
    return QueryRays(u, v, query.confidence[trusted], query.fov_deg)


def _chunks(store: Store) -> Iterable[tuple[Views, NDArray[np.uint16]]]:
    for start in range(0, store.committed, _ROWS_A_READ):
        rows = slice(start, min(start + _ROWS_A_READ, store.committed))
        yield store.views(rows), store.keypoint_columns(rows)
