"""Retrieval: from a query's rays to a short list of poses among all places of a store.

Coarse to fine: every heading of every place by phases (`screening`), then a fit of the whole pose
to the skylines of the best, first roughly and of many, then well and of fewer (`curve_fit`), then
the best that differ from one another.
"""

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from skyline.arrays import Float32Array, Float64Array, Rows
from skyline.errors import InputError
from skyline.match.curve_fit import CurveFit, FitConfig
from skyline.match.hypotheses import Hypotheses
from skyline.match.narrowing import Narrowed
from skyline.match.progress import tell
from skyline.match.query_rays import REFERENCE_FOV_DEG, QueryRays, in_runs
from skyline.match.screening import Alike, Screen, sample_of, screen_places
from skyline.store.places import Places, PlaceSource
from skyline.terrain.edge import DataEdge
from skyline.terrain.heightfield import Ground

_FITS_AT_ONCE = 2048
"""Poses fitted together. Of 256, two threads wait for the interpreter half the time."""
_SEEN_AT_ONCE = 512
"""Places seen at every turn together; keeps the arrays in the cache."""
_LIKELY_DEVIATIONS = 2.5
"""Fields of view farther from the one expected are not screened; fits do start from them."""
_UNLIKELY = 0.25
"""Times the square of how many deviations a field of view is off: what its scores lose."""
_SLOPE_REACH_M = 15.0


@dataclass(frozen=True, slots=True)
class RetrievalConfig:
    """How places are retrieved.

    Attributes
    ----------
    zoom_step, start_zoom_step : float
        Fields of view that are screened, and that fits start from, differ by this share.
    screened_share : float
        Part of all places whose pose is fitted roughly.
    screened_least, screened_most : int
        How many these are at least, where there are as many, and at most: they are held in memory.
    fitted : int
        Of these, places whose pose is fitted well.
    alike_weight : float
        What a standard deviation of the screening counts in the score of a fit. The fit knows
        more, but trusts that the query was taken near its place.
    separation_m, turn_deg : float
        Hypotheses nearer to a better one, looking within a turn of the same way, are left out.
    rough, fit : FitConfig
    """

    zoom_step: float = 0.18
    start_zoom_step: float = 0.065
    screened_share: float = 0.05
    screened_least: int = 16_384
    screened_most: int = 262_144
    fitted: int = 8192
    alike_weight: float = 1.0
    separation_m: float = 30.0
    turn_deg: float = 20.0
    rough: FitConfig = field(default_factory=lambda: FitConfig(rays=40, rounds_deg=(0.5, 0.3)))
    fit: FitConfig = field(default_factory=FitConfig)

    def __post_init__(self) -> None:
        steps = self.zoom_step, self.start_zoom_step
        if min(self.screened_least, self.fitted) < 1 or not min(steps) > 0.0:
            raise InputError(
                f"{self.screened_least} screened and {self.fitted} fitted places, fields of view "
                f"{steps[0]:g} and {steps[1]:g} apart; expected each above 0"
            )

    def screened(self, places: int) -> int:
        """Return how many of so many places are fitted roughly."""
        share = math.ceil(self.screened_share * places)
        return min(max(share, self.screened_least), self.screened_most)


class Retriever:
    """Finds short lists of poses among places.

    Without ``ground`` that about a place is taken to be level; without ``edge``, where the
    terrain's data end, nothing is taken to lie beyond.
    """

    def __init__(
        self,
        places: PlaceSource,
        ground: Ground | None = None,
        config: RetrievalConfig | None = None,
        edge: DataEdge | None = None,
    ) -> None:
        self._edge = edge
        self.config = config or RetrievalConfig()
        self.places = places
        self._ground = ground
        self._screened = self.config.screened(len(places))

    @cached_property
    def _sample(self) -> Places:
        return sample_of(self.places)

    def _nowhere(self, narrowed: Sequence[Narrowed]) -> InputError:
        """Return the error that a search is narrowed to no place."""
        hints = (one.swapped(self._sample) for one in narrowed)
        return InputError(
            "no place of the store lies within what the search is narrowed to; widen it, or build "
            "a store of that area" + next(filter(None, hints), "")
        )

    def screened(
        self, query: QueryRays, narrowed: Narrowed | None = None, part: slice = slice(None)
    ) -> Alike:
        """Return the places most like a query, of a part of the blocks of places."""
        screen = self._screen(query, narrowed)
        return screen_places(screen.scores, self.places, self._screened, narrowed, part)

    def shortlist(
        self,
        query: QueryRays,
        count: int,
        narrowed: Narrowed | None = None,
        screened: Alike | None = None,
    ) -> Hypotheses:
        """Return up to ``count`` poses that a query most likely has, best first.

        Its range of fields of view is searched. ``screened`` is what `screened` returned for all
        parts, joined; by default this process screens. Scores compare poses of one query. Poses may
        lie between the places. Raises `InputError` for a ``count`` below 1, and where the search is
        narrowed to no place.
        """
        if count < 1:
            raise InputError(f"count is {count}; expected at least 1 hypothesis")
        alike = self.screened(query, narrowed) if screened is None else screened
        alike = alike.best(self._screened)
        if not len(alike):
            raise self._nowhere([] if narrowed is None else [narrowed])
        fitted = self._fitted(query, self._aim(query, narrowed), alike)
        if narrowed is not None:
            fitted = fitted[narrowed.holds(fitted)]
        if not len(fitted):
            return fitted
        return fitted[
            fitted.suppress_non_maxima(count, self.config.separation_m, self.config.turn_deg)
        ]

    def shortlist_together(
        self, asked: Sequence[tuple[QueryRays, Narrowed | None]], count: int
    ) -> list[Hypotheses]:
        """Return up to ``count`` places that queries of one eye most likely share.

        Each query has its poses there, of the same places in the same order, best first. A place
        lies within the narrowings of all, and counts the sum of the queries' scores. Where a query
        fits worse than at half of the places, it counts as there, so that one query that is lost
        vetoes nothing. Raises `InputError` where the search is narrowed to no place.
        """
        tests = [known for _, known in asked if known is not None]
        screens = [self._screen(*one) for one in asked]
        alike = screen_places(
            lambda phase: np.sum([screen.scores(phase) for screen in screens], axis=0),
            self.places,
            self._screened,
            (lambda some: np.all([test(some) for test in tests], axis=0)) if tests else None,
        )
        if not len(alike):
            raise self._nowhere(tests)
        places = self.places.take(alike.row)
        starts = [
            self._start(query, self._aim(query, narrowed), places, screen.scores(places.phase))
            for (query, narrowed), screen in zip(asked, screens, strict=True)
        ]
        found = self._fitted_together([query for query, _ in asked], starts)
        shared = {
            name: np.mean([getattr(one, name) for one in found], axis=0)
            for name in ("easting_m", "northing_m")
        } | {"score": _total(found)}
        joint = [replace(one, **shared) for one in found]
        chosen = joint[0].suppress_non_maxima(count, self.config.separation_m)
        return [one[chosen] for one in joint]

    def _screen(self, query: QueryRays, narrowed: Narrowed | None) -> Screen:
        """Prepare to find places: few fields of view, the likely ones."""
        likely = _LIKELY_DEVIATIONS * query.log_scale_sd
        low, high = np.clip(query.log_scale_bounds, -likely, likely)
        zooms = _middles(float(low), float(high), self.config.zoom_step * _zoom_share(query))
        unlikely = _UNLIKELY * np.square(zooms / query.log_scale_sd)
        return self._prepared(query, narrowed, zooms, unlikely)

    def _aim(self, query: QueryRays, narrowed: Narrowed | None) -> Screen:
        """Prepare to find headings and fields of view at places, all that are searched."""
        return self._prepared(query, narrowed, self._start_zooms(query))

    def _prepared(
        self,
        query: QueryRays,
        narrowed: Narrowed | None,
        zooms: Float64Array,
        unlikely: Float64Array | None = None,
    ) -> Screen:
        turns = None if narrowed is None else narrowed.open_turns
        return Screen.of(query, _fov_deg(query, zooms), self._sample, turns, unlikely)

    def _start(
        self, query: QueryRays, aim: Screen, places: Places, score: Float32Array
    ) -> "_Start":
        """Return where fits set out from: few places at a time, for each is seen at every turn."""
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            parts = range(0, max(len(places), 1), _SEEN_AT_ONCE)
            turns = pool.map(
                lambda first: aim.best_turns(places.phase[first : first + _SEEN_AT_ONCE]), parts
            )
            heading_deg, fov = (np.concatenate(part) for part in zip(*turns, strict=True))
        return _Start(places, score, np.radians(heading_deg), self._start_zooms(query)[fov])

    def _start_zooms(self, query: QueryRays) -> Float64Array:
        step = self.config.start_zoom_step * _zoom_share(query)
        return _middles(*query.log_scale_bounds, step)

    def _fitted(self, query: QueryRays, aim: Screen, alike: Alike) -> Hypotheses:
        """Return the fitted poses of the places most alike."""
        start = self._start(query, aim, self.places.take(alike.row), alike.score)
        return self._fitted_together([query], [start])[0]

    def _fitted_together(
        self, queries: Sequence[QueryRays], starts: Sequence["_Start"]
    ) -> list[Hypotheses]:
        """Return the poses of each query, fitted at the places that fit all of them best."""
        rough = [
            self._fits(query, start, self.config.rough)
            for query, start in zip(queries, starts, strict=True)
        ]
        best = np.sort(np.argsort(_total(rough), kind="stable")[: self.config.fitted])
        return [
            self._fits(query, start[best], self.config.fit)
            for query, start in zip(queries, starts, strict=True)
        ]

    def _fits(self, query: QueryRays, start: "_Start", config: FitConfig) -> Hypotheses:
        """Return the poses of places fitted from where they start, in order."""
        rays = in_runs(query, config.rays)

        def fitted(first: int) -> Hypotheses:
            some = start[slice(first, first + _FITS_AT_ONCE)]
            places, slope = some.places, self._slope(some.places)
            fit = CurveFit(places, slope, rays, config, self._edge)
            pose, score = fit.fit(some.heading_rad, some.zoom)
            heading, pitch, roll, zoom = pose[:, :4].T.astype(np.float64)
            move = pose[:, 4:].astype(np.float64)
            return Hypotheses(
                places.easting_m + move[:, 0],
                places.northing_m + move[:, 1],
                places.eye_elevation_m + (slope * move).sum(axis=1),
                np.degrees(heading) % 360.0,
                np.degrees(pitch),
                np.degrees(roll),
                _fov_deg(query, zoom),
                np.zeros(len(zoom)),
                score - self.config.alike_weight * some.score.astype(np.float64),
            )

        parts = range(0, max(len(start), 1), _FITS_AT_ONCE)
        found = []
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            try:
                for fit in pool.map(fitted, parts):
                    found.append(fit)
                    tell("fitting", len(found) / len(parts))
            except BaseException:
                # Whoever is told may end the match: what has not begun is not waited for.
                pool.shutdown(cancel_futures=True)
                raise
        return Hypotheses.concatenate(found)

    def _slope(self, places: Places) -> Float32Array:
        """Return the ground's rise (N, 2) to the east and to the north; 0 where unknown."""
        if self._ground is None:
            return np.zeros((len(places), 2), dtype=np.float32)
        slope = ground_slope(self._ground, places.easting_m, places.northing_m, _SLOPE_REACH_M)
        return slope.astype(np.float32)


def ground_slope(
    ground: Ground, easting_m: Float64Array, northing_m: Float64Array, reach_m: float
) -> Float64Array:
    """Return the rise of the ground (M, 2) a metre east and north; 0 beside the unknown."""
    place = easting_m + 1j * northing_m
    around = np.concatenate([place + reach_m * turn for turn in (1.0, -1.0, 1.0j, -1.0j)])
    east, west, north, south = ground(around.real, around.imag).reshape(4, -1)
    return np.nan_to_num(np.stack([east - west, north - south], axis=1) / (2.0 * reach_m))


@dataclass(frozen=True, slots=True, eq=False)
class _Start(Rows):
    """Places (N), how alike they are, and the headings and zooms that fits set out from."""

    places: Places
    score: Float32Array
    heading_rad: Float64Array
    zoom: Float64Array


def _total(found: Sequence[Hypotheses]) -> Float64Array:
    """Return the sum of queries' scores at the same places, none worse than its median."""
    if len(found) == 1:
        return found[0].score
    return np.asarray(sum(np.minimum(one.score, np.median(one.score)) for one in found))


def _middles(low: float, high: float, step: float) -> Float64Array:
    """Return the middles of as few equal parts of a range as are no wider than a step."""
    parts = max(1, math.ceil((high - low) / step))
    return np.asarray(low + (np.arange(parts) + 0.5) * ((high - low) / parts))


def _zoom_share(query: QueryRays) -> float:
    """Return the share of a step of the zoom that moves the ends of a wide panorama as far."""
    return min(1.0, REFERENCE_FOV_DEG / query.fov_deg) if query.is_panorama else 1.0


def _fov_deg(query: QueryRays, zoom: Float64Array) -> Float64Array:
    # Rounding must not take a field of view out of the query's range.
    return np.asarray(np.clip(query.fov_at(zoom), *query.fov_bounds_deg))
