"""Matching queries to a store, and to the terrain it was rendered from."""

import logging
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError, SkylineError, named
from skyline.files import is_file
from skyline.geodesy import Frame
from skyline.matching import Candidate, Hypotheses, Narrowing, Profiles, QueryRays
from skyline.matching.claim import Claim
from skyline.matching.confidence import DISTANCES_M
from skyline.matching.match_config import MatchConfig
from skyline.matching.narrowing import Narrowed
from skyline.matching.progress import telling
from skyline.matching.screening import Alike
from skyline.photo import Lens, NotedPlace, Projection, QuerySkyline, read_query
from skyline.pipeline.config import check_dem, read_dem_of
from skyline.pipeline.matchers import FULL, MATCHERS, check_narrows
from skyline.pipeline.scene import RenderedScene
from skyline.pipeline.tables import to_geodataframe
from skyline.places import PlaceSource
from skyline.render.thread import RenderThread
from skyline.report.claims import claim_said
from skyline.store import Store, StoreHeader, open_store
from skyline.store.header import PLACES
from skyline.terrain.heightfield import Ground, HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

_log = logging.getLogger(__name__)

_GPS_SD_M, _LEAST_GPS_SD_M = 30.0, 15.0
"""Scales of positions without an accuracy, and of those with a good one: the model is off too."""
_LEAST_ALTITUDE_SD_M, _ALTITUDE_ACCURACIES = 15.0, 3.0
"""Heights are two to three times as uncertain as places, and the model's datum may be another."""
_COMPASS_SD_DEG, _MAGNETIC_SD_DEG = 20.0, 30.0
"""The declination, which nothing here knows, is up to 20 degrees where people live."""

_DISAGREES = "the photo does not fit where the others were taken"

Dem = str | Path | Sequence[str | Path] | HeightField


@dataclass(frozen=True, slots=True)
class MatchResult:
    """What was found for one query.

    Attributes
    ----------
    query : QuerySkyline
        The skyline that was matched.
    candidates : tuple of Candidate
        Best first.
    seconds : float
        From the query to the candidates.
    refusal : str or None
        Why there is no answer, where there is none.
    within_m : float or None
        Distance within which the best candidate is sure to be right: 200 m, or 1 km where only
        that is sure. None without an answer, and for matchers without a confidence.
    """

    query: QuerySkyline
    candidates: tuple[Candidate, ...]
    seconds: float
    refusal: str | None = None
    within_m: float | None = None

    @property
    def answer(self) -> Candidate | None:
        """The best candidate, if the matcher stands by it."""
        return self.candidates[0] if self.candidates and not self.refusal else None

    @property
    def claim(self) -> str:
        """Where the photo says that it was taken, against the best candidate; empty without."""
        best = next(iter(self.candidates), None)
        return claim_said(self.query.noted, best, self.answer is not None)

    def __repr__(self) -> str:
        return f"MatchResult({_in_short(self)}; candidates: {len(self.candidates)})"

    def _repr_html_(self) -> str:
        from skyline.report.matches import result_html  # noqa: PLC0415  (slow to load)

        return result_html(_in_short(self), self.query, self.candidates)

    def to_geodataframe(self) -> Any:
        """Return the candidates as points of a GeoDataFrame; see `skyline.to_geodataframe`."""
        return to_geodataframe([self])


@dataclass(frozen=True, slots=True)
class JointResult:
    """What was found for several queries of one place.

    Attributes
    ----------
    results : tuple of MatchResult
        One for each query. The candidates of those that agree are the same places with the same
        confidences; each has its own camera there. A query that does not agree has no candidates,
        and its refusal says why.
    agrees : tuple of bool
        Whether each query was taken at the best place rather than anywhere else.
    seconds : float
        From the queries to the places.
    refusal : str or None
        Why there is no answer, where there is none.
    """

    results: tuple[MatchResult, ...]
    agrees: tuple[bool, ...]
    seconds: float
    refusal: str | None = None

    @property
    def places(self) -> tuple[Candidate, ...]:
        """The places, best first, with the camera of the first query that agrees."""
        of_agreeing = (one.candidates for one, is_of in self._each() if is_of)
        return next(of_agreeing, ())

    @property
    def answer(self) -> Candidate | None:
        """The best place, if the matcher stands by it; the camera as of `places`."""
        return self.places[0] if self.places and not self.refusal else None

    @property
    def within_m(self) -> float | None:
        """Distance within which the answer is sure to be right; None without an answer."""
        return next((one.within_m for one, is_of in self._each() if is_of), None)

    def __repr__(self) -> str:
        agree = f"{sum(self.agrees)} of {len(self.agrees)} photos agree"
        return f"JointResult({_in_short(self)}; {agree})"

    def to_geodataframe(self) -> Any:
        """Return the cameras as points of a GeoDataFrame; see `skyline.to_geodataframe`."""
        return to_geodataframe(self.results)

    def _each(self) -> Iterable[tuple[MatchResult, bool]]:
        return zip(self.results, self.agrees, strict=True)


def _in_short(result: MatchResult | JointResult) -> str:
    best = result.answer
    if best is None:
        return f"no answer: {result.refusal or 'no place fits'}"
    said = f"latitude {best.lat:.5f}, longitude {best.lon:.5f}, heading {best.heading_deg:.1f}"
    if result.within_m is not None:
        said += f", right within {result.within_m:g} m"
    return said if best.confidence is None else f"{said}, confidence {best.confidence:.2f}"


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
        One of `skyline.pipeline.matchers.MATCHERS`: ``full``, which is ours and searches places,
        or one that compares renderings.
    config : MatchConfig, optional
    render_thread : RenderThread, optional
        Renders, so that any thread may match, and several at a time; by default the thread that
        makes the matcher renders, and it alone may match.

    Raises
    ------
    InputError
        No such matcher, or a store that does not hold what the matcher compares with.
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
    ) -> None:
        kind = named("matcher", matcher, MATCHERS)
        self._config = config or MatchConfig()
        with open_store(store) as opened:
            self.header = opened.header
            self.rows, self.holds = len(opened), opened.header.holds
            self.viewpoints = _some_eyes(opened)
            terrain = _given_terrain(self.header, dem)
            source = _OpenedSource(store, opened, terrain, self._config, render_thread)
            self._ranker = kind.open(source)
        self.terrain, self._scene = source.terrain, source.rendered
        self.render_thread = render_thread
        self.frame = Frame(self.header.frame_wkt)

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
            How many candidates to return at most.
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
        query = _skyline_of(query, fov_deg)
        candidates: tuple[Candidate, ...] = ()
        refusal = too_little(query, self._config)
        if refusal is None:
            rays, narrowed = self._rays(query), self._narrowed(narrowing, query)
            with telling(told):
                ranking = self._ranker.rank(rays, top, narrowed, screened)
            candidates = ranking.candidates(self.frame)
            refusal = unsure(candidates, self._config) or at_bound(candidates, rays)
        within_m = None if refusal else sure_within_m(candidates[0], self._config)
        return MatchResult(query, candidates, time.perf_counter() - started, refusal, within_m)

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
            MatchResult(query, places, seconds, refusal, within_m)
            if places
            else MatchResult(query, (), seconds, little or _DISAGREES)
            for query, places, little in zip(skylines, found, refusals, strict=True)
        )
        return JointResult(results, tuple(map(bool, found)), seconds, refusal)

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

    def fit(self, query: QuerySkyline, start: Candidate) -> Candidate | None:
        """Return the pose that a pose nearby becomes by rendering; None where nothing fits.

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
        pose = Hypotheses.of_pose(
            start.easting_m,
            start.northing_m,
            start.eye_elevation_m,
            start.grid_heading_deg,
            start.pitch_deg,
            start.roll_deg,
            start.fov_deg,
        )
        ranking = self._ranker.fit_from(self._rays(query.with_fov(start.fov_deg)), pose)
        if ranking is None:
            raise InputError("this matcher does not render; a fit needs the full one and the DEM")
        return next(iter(ranking.candidates(self.frame)), None)

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

    def match_all(
        self,
        queries: Iterable[str | Path | QuerySkyline],
        fov_deg: float | None = None,
        top: int = 5,
    ) -> list[MatchResult]:
        """Find where several queries were taken, in order; see `match`."""
        return [self.match(query, fov_deg, top) for query in queries]

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
        fov_deg, bounds_deg = query.fov_deg, self._config.fov_range_deg
        weight = query.confidence[query.trusted]
        if query.projection is not Projection.PERSPECTIVE and fov_deg is not None:
            # Other fields of view of a panorama are not its rays scaled.
            return QueryRays(*query.image_plane(fov_deg), weight, fov_deg)
        if fov_deg is not None:
            lens, rays = query.lens or Lens(fov_deg), query.image_plane(fov_deg)
            sd_deg = self._config.fov_slack * fov_deg if lens.sd_deg is None else lens.sd_deg
            return QueryRays.about(*rays, weight, fov_deg, sd_deg, lens.most_deg or math.inf)
        if self._ranker.finds_fov and query.projection is Projection.PERSPECTIVE:
            fov_deg, sd_deg = self._config.usual_fov_deg
            return QueryRays(*query.image_plane(fov_deg), weight, fov_deg, bounds_deg, sd_deg)
        raise InputError(
            "the query's field of view is not known: it is not in the image; give --fov-deg"
        )


def _skyline_of(query: str | Path | QuerySkyline, fov_deg: float | None) -> QuerySkyline:
    if not isinstance(query, QuerySkyline):
        return read_query(query, fov_deg)
    return query if fov_deg is None else query.with_fov(fov_deg)


def claim_of(noted: NotedPlace, frame: Frame) -> Claim | None:
    """Return what a photo notes of its place as a prior in a frame; None where it notes none."""
    if noted.lonlat_deg is None:
        return None
    east, north = (float(value) for value in frame.from_lonlat(*noted.lonlat_deg))
    if not (np.isfinite(east) and np.isfinite(north)):
        return None  # Too far from the frame to have a place in it.
    heading_deg = noted.heading_deg
    if heading_deg is not None:
        heading_deg -= float(frame.convergence_deg(east, north))
    sd_m = max(_LEAST_GPS_SD_M, noted.accuracy_m or _GPS_SD_M)
    compass_sd_deg = _MAGNETIC_SD_DEG if noted.is_magnetic else _COMPASS_SD_DEG
    elevation_m, elevation_sd_m = None, _LEAST_ALTITUDE_SD_M
    if noted.accuracy_m is not None:
        # Who says how good a position is has satellites in view, and corrects for the geoid.
        elevation_m = noted.elevation_m
        elevation_sd_m = max(_LEAST_ALTITUDE_SD_M, _ALTITUDE_ACCURACIES * noted.accuracy_m)
    return Claim(east, north, sd_m, heading_deg, compass_sd_deg, elevation_m, elevation_sd_m)


def too_little(query: QuerySkyline, config: MatchConfig) -> str | None:
    """Say why a query shows too little of a skyline to be matched, if so."""
    widest_deg = config.fov_range_deg[1] if query.fov_deg is None else query.fov_deg
    if query.lens is not None and query.lens.most_deg is not None:
        widest_deg = query.lens.most_deg
    visible_deg, least_deg = query.visible_deg(widest_deg), config.min_visible_deg
    if visible_deg >= least_deg:
        return None
    return (
        f"{visible_deg:.1f} degrees of skyline are visible, {least_deg:g} are needed; correct "
        "the skyline by a trace or a mask, or check the field of view"
    )


def unsure(candidates: Sequence[Candidate], config: MatchConfig) -> str | None:
    """Say why candidates are no answer, if so."""
    if not candidates:
        return "no place fits"
    best, least = candidates[0], config.min_confidence
    if best.confidence is None or sure_within_m(best, config) is not None:
        return None
    return (
        f"the best place has confidence {best.confidence:.2f}, within 1 km "
        f"{best.confidence_1km:.2f}; {least:.2f} is needed"
    )


def sure_within_m(candidate: Candidate, config: MatchConfig) -> float | None:
    """Return the distance within which a candidate is sure enough to be right; None where none.

    The nearer distance takes half the doubt that the farther one may leave: saying it wrongly is
    worse than saying less.
    """
    doubt = 1.0 - config.min_confidence
    sure = (candidate.confidence, 1.0 - 0.5 * doubt), (candidate.confidence_1km, 1.0 - doubt)
    for within_m, (confidence, least) in zip(DISTANCES_M, sure, strict=True):
        if confidence is not None and confidence >= least:
            return within_m
    return None


def at_bound(candidates: Sequence[Candidate], rays: QueryRays) -> str | None:
    """Say that the field of view of the best candidate is the least or greatest searched, if so."""
    low_deg, high_deg = rays.fov_bounds_deg
    found_deg, near_deg = candidates[0].fov_deg, _AT_BOUND_SHARE * (high_deg - low_deg)
    if low_deg == high_deg or low_deg + near_deg < found_deg < high_deg - near_deg:
        return None
    return (
        f"the best place needs a field of view of {found_deg:.1f} degrees, and {low_deg:.1f} to "
        f"{high_deg:.1f} were searched; give another one (--fov-deg)"
    )


class _OpenedSource:
    """An open store and its terrain; see `skyline.matching.ranker.Source`."""

    def __init__(
        self,
        path: str | Path,
        store: Store,
        terrain: HeightField | None,
        config: MatchConfig,
        thread: RenderThread | None,
    ) -> None:
        self._path, self._store, self._thread = path, store, thread
        self.terrain, self.config = terrain, config
        self.rendered: RenderedScene | None = None
        self._sought = False

    def places(self) -> PlaceSource:
        """Return the places of the store."""
        places = self._store.places()
        if not len(places):
            raise InputError(f"store {self._path} holds no places; build it first")
        return places

    def profiles(self) -> Profiles:
        """Return the renderings of the store, joined."""
        return Profiles.from_views(_chunks(self._store))

    def ground(self) -> Ground | None:
        """Return the heights of the terrain."""
        terrain = self._found_terrain()
        return None if terrain is None else terrain.height_at

    def scene(self) -> RenderedScene | None:
        """Return the terrain to render."""
        terrain = self._found_terrain()
        if terrain is not None and self.config.refine:
            header = self._store.header
            self.rendered = RenderedScene.of_store(terrain, header, self.config, self._thread)
        return self.rendered

    def _found_terrain(self) -> HeightField | None:
        if self.terrain is None and not self._sought:
            self._sought = True
            self.terrain = terrain_at_hand(self._store.header, "answers unrefined")
        return self.terrain


def terrain_at_hand(header: StoreHeader, otherwise: str) -> HeightField | None:
    """Return the terrain a store was rendered from, read from where it lay then.

    Where it is not to be had there is a warning of what is left ``otherwise``. Only plain files
    are read: a store from a stranger must not make the reader go anywhere else.
    """
    if not header.dem_files or not all(map(is_file, header.dem_files)):
        _log.warning(
            "%s: the store's DEM is not at hand (no file here is %s); say where it lies with --dem",
            otherwise,
            ", ".join(header.dem_files) or "no path",
        )
        return None
    try:
        return read_dem_of(header)
    except SkylineError as error:
        _log.warning("%s: the store's DEM cannot be used: %s", otherwise, error)
        return None


def _given_terrain(header: StoreHeader, dem: Dem | None) -> HeightField | None:
    """Return the terrain that was given, as the store's build read it."""
    if isinstance(dem, HeightField):
        check_dem(header, dem)
        return dem
    if dem is None:
        return None
    return read_dem_of(header, [dem] if isinstance(dem, str | Path) else dem)


_SHOWN_EYES = 20_000
_AT_BOUND_SHARE = 1e-3
"""Of the range searched: a fit is held to its bound but for rounding."""


def _some_eyes(store: Store) -> Viewpoints:
    """Return where the eyes of a store stand, evenly chosen ones of very many."""
    if store.header.holds == PLACES:
        places = store.places()
        rows = np.arange(0, len(places), max(1, len(places) // _SHOWN_EYES))
        some = places.take(rows)
        height_m = some.eye_elevation_m.astype(np.float64)
        return Viewpoints(some.easting_m, some.northing_m, height_m)
    there = store.locations()
    eyes = np.stack([there.easting_m, there.northing_m, there.eye_elevation_m])
    return Viewpoints(*np.ascontiguousarray(np.unique(eyes, axis=1)))


def _chunks(store: Store) -> Iterable[tuple[Views, NDArray[np.uint16]]]:
    start = 0
    for views in store.iter_views():
        rows = slice(start, start + len(views))
        yield views, store.keypoint_columns(rows)
        start = rows.stop
