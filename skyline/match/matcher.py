"""Matching queries to a store, and to the terrain it was rendered from."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Self

from skyline.errors import InputError
from skyline.geodesy import Frame
from skyline.match.answer import (
    DISAGREES,
    JointResult,
    MatchResult,
    misfit,
    refusal_of,
    sure_within_m,
    too_little,
    unsure,
)
from skyline.match.candidate import Candidate
from skyline.match.claim import claim_of
from skyline.match.hypotheses import Hypotheses
from skyline.match.match_config import MatchConfig
from skyline.match.matchers import FULL, check_narrows, matcher_class
from skyline.match.narrowing import Narrowed, Narrowing
from skyline.match.opened import OpenedSource, given_terrain
from skyline.match.progress import telling
from skyline.match.query_rays import QueryRays
from skyline.match.screening import Alike
from skyline.photo.lens import Lens
from skyline.photo.projection import MAX_PANORAMA_DEG
from skyline.photo.query import QuerySkyline
from skyline.photo.read import read_query
from skyline.render.thread import RenderThread
from skyline.store import open_store
from skyline.terrain.surface import Dem
from skyline.terrain.viewpoints import Viewpoints

_WIDE_DEG = 75.0
"""Lenses of a wider field of view may distort: phones correct what their main camera does."""
_DISTORTION_SD = 0.05
"""Of what those leave."""


class Matcher:
    """Matches query skylines to a store, which is read once.

    Parameters
    ----------
    store : str or Path
    dem : path, paths or HeightField, optional
        The DEM the store was rendered from; by default read from where it lay then. The full
        matcher takes heights from it, and renders it to refine. Where it is not to be had,
        answers stay unrefined, which is logged.
    matcher : str
        One of `skyline.match.matchers.MATCHERS`: ``full``, which is ours and searches places,
        or one that compares renderings.
    config : MatchConfig, optional
    render_thread : RenderThread, optional
        Renders, so that any thread may match, and several at a time; by default the thread that
        makes the matcher renders, and it alone may match.
    surface : path, paths or HeightField, optional
        A surface or canopy model: how far trees and houses may rise above the DEM's skyline. For
        the full matcher, which heeds it in refinement.

    Raises
    ------
    InputError
        No such matcher, a store that does not hold what the matcher compares with, or a surface
        that is not over the DEM, or for who does not refine.
    StoreError
        The store cannot be read.
    StoreMismatchError
        The store was rendered from another DEM.
    """

    def __init__(
        self,
        store: str | Path,
        dem: Dem | None = None,
        matcher: str = FULL,
        config: MatchConfig | None = None,
        render_thread: RenderThread | None = None,
        surface: Dem | None = None,
    ) -> None:
        kind = matcher_class(matcher)
        self._config = config or MatchConfig()
        if surface is not None and not (matcher == FULL and self._config.refine):
            raise InputError("a surface acts in refinement; use the full matcher, and refine")
        with open_store(store) as opened:
            self.header = opened.header
            self.rows, self.holds = len(opened), opened.header.holds
            terrain = given_terrain(self.header, dem)
            source = OpenedSource(store, opened, terrain, self._config, render_thread, surface)
            self._ranker = kind.open(source)
            self._eyes = source.eyes()
        self.terrain, self._scene = source.terrain, source.rendered
        if surface is not None and self._scene is None:
            raise InputError("a surface needs the store's DEM, which is not at hand; give it")
        self.render_thread = render_thread
        self.frame = Frame(self.header.frame_wkt)

    @cached_property
    def viewpoints(self) -> Viewpoints:
        """Where the store's eyes stand, evenly chosen ones of very many."""
        return self._eyes()

    def release(self) -> None:
        """Free what the matcher holds on the GPU; it cannot refine after that."""
        if self._scene is not None:
            self._scene.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def match(
        self,
        query: str | Path | QuerySkyline,
        fov_deg: float | None = None,
        top: int = 5,
        narrowing: Narrowing | None = None,
        screened: Alike | None = None,
        told: Callable[[str, float], None] | None = None,
    ) -> MatchResult:
        """Find where a photo, a sky mask, a trace or a query skyline was taken.

        Parameters
        ----------
        query : path or QuerySkyline
        fov_deg : float, optional
            Horizontal field of view; by default the query's own.
        top : int
            How many candidates to return at most; how many has no influence on what they are.
        narrowing : Narrowing, optional
            What is known of where the photo was taken; for the full matcher alone.
        screened : Alike, optional
            What `screen` found in all parts of the store, joined; by default the store is
            screened here.
        told : callable, optional
            Called, in this thread, with the step that the match is at and the share of the step
            that is done, 0 to 1. What it raises ends the match.

        Raises
        ------
        InputError
            The query has no usable skyline, the matcher needs a field of view and none is
            known, or there is no place within what the search is narrowed to.
        StoreError
            The store was damaged or cut short since it was opened.
        """
        started = time.perf_counter()
        name, query = _name_of(query), _skyline_of(query, fov_deg)
        candidates: tuple[Candidate, ...] = ()
        refusal = too_little(query, self._config)
        if refusal is None:
            rays, narrowed = self._rays(query), self._narrowed(narrowing, query)
            with telling(told):
                ranking = self._ranker.rank(rays, top, narrowed, screened)
            candidates = ranking.candidates(self.frame)
            refusal = refusal_of(candidates, self._config, query, rays)
        within_m = None if refusal else sure_within_m(candidates[0], self._config)
        seconds = time.perf_counter() - started
        return MatchResult(query, candidates, seconds, refusal, within_m, name)

    def match_together(
        self,
        queries: Sequence[str | Path | QuerySkyline],
        fov_deg: float | None = None,
        top: int = 5,
        narrowings: Sequence[Narrowing | None] | None = None,
        told: Callable[[str, float], None] | None = None,
    ) -> JointResult:
        """Find the one place where several photos were taken.

        Photos that look different ways tell more than each by itself. One that was taken
        elsewhere is named where it fits nowhere near, and seldom spoils the answer.

        Parameters
        ----------
        queries : sequence of path or QuerySkyline
            Two or more.
        fov_deg, top, told
            As of `match`.
        narrowings : sequence of Narrowing or None, optional
            What is known of each query.

        Raises
        ------
        InputError
            Fewer than two queries, a matcher that does not render, or as `match`.
        StoreError
            As `match`.
        """
        started = time.perf_counter()
        known = [None] * len(queries) if narrowings is None else narrowings
        if len(queries) < 2 or len(known) != len(queries):
            raise InputError(
                f"{len(queries)} photos and {len(known)} narrowings; expected two photos or more "
                "and as many narrowings"
            )
        skylines = [_skyline_of(query, fov_deg) for query in queries]
        refusals = [too_little(query, self._config) for query in skylines]
        asked = [
            (self._rays(query), self._narrowed(narrowing, query))
            for query, narrowing, refusal in zip(skylines, known, refusals, strict=True)
            if refusal is None
        ]
        with telling(told):
            left = iter(self._cameras(asked, top) if len(asked) > 1 else ())
        found = [() if refusal else next(left, ()) for refusal in refusals]
        best = next((one for one in found if one), ())
        refusal, within_m = unsure(best, self._config), None
        if sum(map(bool, found)) < 2:
            refusal = "fewer than two photos agree on a place"
        if refusal is None:
            within_m = sure_within_m(best[0], self._config)
        seconds = time.perf_counter() - started
        results = tuple(
            MatchResult(query, places, seconds, refusal, within_m, name)
            if places
            else MatchResult(query, (), seconds, little or DISAGREES, name=name)
            for name, query, places, little in zip(
                map(_name_of, queries), skylines, found, refusals, strict=True
            )
        )
        return JointResult(results, seconds, refusal)

    def _cameras(
        self, asked: Sequence[tuple[QueryRays, Narrowed | None]], top: int
    ) -> list[tuple[Candidate, ...]]:
        """Return the candidates of each query of one place; none of one that does not agree."""
        joint = self._ranker.rank_together(asked, top)
        if joint is None:
            raise InputError(
                "photos are matched together by rendering alone; use the full matcher, refine, and "
                "say where the DEM lies"
            )
        return [
            ranking.candidates(self.frame) if agrees else ()
            for ranking, agrees in zip(joint.rankings, joint.agrees.tolist(), strict=True)
        ]

    def fit(self, query: QuerySkyline, start: Candidate) -> MatchResult:
        """Fit a pose nearby by rendering.

        The one candidate of the result holds how far the skylines are apart. It has no confidence,
        since no other place was tried. The fit has failed, and there is no answer, where a search
        would not stand by the pose even if nothing else fitted: the candidate then has no
        covariance. Where this pose does not fit either, there is no candidate.

        Parameters
        ----------
        query : QuerySkyline
        start : Candidate
            Some 100 m from the place and 5 degrees from the heading at most; the field of view is
            taken to be right within the matcher's slack. The eye keeps its height above the
            ground.

        Raises
        ------
        InputError
            The matcher does not render, or the pose is off the map.
        """
        started = time.perf_counter()
        given = Hypotheses.of_pose(
            start.easting_m,
            start.northing_m,
            start.eye_elevation_m,
            start.grid_heading_deg,
            start.pitch_deg,
            start.roll_deg,
            start.fov_deg,
            start.distortion,
        )
        ranking = self._ranker.fit_from(self._rays(query.with_fov(start.fov_deg)), given)
        if ranking is None:
            raise InputError("this matcher does not render; a fit needs the full one and the DEM")
        fitted: tuple[Candidate, ...] = ()
        refusal: str | None = "nothing near this pose fits"
        for alone in ranking.candidates(self.frame):
            refusal = misfit(alone, self._config)
            pose = replace(alone, rank=None, confidence=None, confidence_1km=None)
            fitted = (pose if refusal is None else replace(pose, covariance_m2=None),)
        return MatchResult(query, fitted, time.perf_counter() - started, refusal)

    def screen(
        self, query: QuerySkyline, narrowing: Narrowing | None = None, part: slice = slice(None)
    ) -> Alike | None:
        """Return the places of a part of the store most like a query.

        None where there is nothing to screen: a query that shows too little, or another matcher.
        ``part`` is of the store's blocks of places. Raises as `match`.
        """
        if too_little(query, self._config) is not None:
            return None
        return self._ranker.screened(self._rays(query), self._narrowed(narrowing, query), part)

    def _narrowed(self, narrowing: Narrowing | None, query: QuerySkyline) -> Narrowed | None:
        narrowing = narrowing or Narrowing()
        known_m = query.eye_height_m if self._ranker.narrows else None
        if narrowing.eye_height_m is None and known_m is not None:
            narrowing = replace(narrowing, eye_height_m=known_m)
        claim = claim_of(query.noted, self.frame) if narrowing.use_gps else None
        narrowed = narrowing.within(self.frame, claim)
        if narrowed is not None:
            check_narrows(self._ranker)
        return narrowed

    def _rays(self, query: QuerySkyline) -> QueryRays:
        fov_deg, is_panorama = query.fov_deg, query.projection.is_panorama
        weight = query.confidence[query.trusted]
        if fov_deg is not None:
            may_bend = fov_deg > _WIDE_DEG and not is_panorama
            rays = QueryRays(
                *query.image_plane(),
                weight,
                fov_deg,
                is_panorama=is_panorama,
                distortion_sd=_DISTORTION_SD if may_bend else 0.0,
            )
            lens = query.lens or Lens(fov_deg)
            slack = 0.0 if fov_deg == MAX_PANORAMA_DEG else self._config.fov_slack
            sd_deg = slack * fov_deg if lens.sd_deg is None else lens.sd_deg
            return rays.about(sd_deg, lens.most_deg or math.inf)
        if self._ranker.finds_fov and not is_panorama:
            fov_deg, sd_deg = self._config.usual_fov_deg
            bounds_deg = self._config.fov_range_deg
            return QueryRays(*query.image_plane(fov_deg), weight, fov_deg, bounds_deg, sd_deg)
        raise InputError(
            "the query's field of view is not known: it is not in the image; give --fov-deg"
        )


def _name_of(query: str | Path | QuerySkyline) -> str:
    return "" if isinstance(query, QuerySkyline) else str(query)


def _skyline_of(query: str | Path | QuerySkyline, fov_deg: float | None) -> QuerySkyline:
    if not isinstance(query, QuerySkyline):
        return read_query(query, fov_deg)
    return query if fov_deg is None else query.with_fov(fov_deg)
