"""Retrieval: from a query's rays to a short list of poses among all places of a store.

Coarse to fine: screening compares every heading of every place by phases (`screening`). Then whole
poses are fitted to the skylines of the best places, first roughly to many of them, then well to
fewer (`curve_fit`). The short list holds the best poses that differ from one another.
"""

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skyline.arrays import Float32Array, Float64Array, Rows
from skyline.errors import InputError
from skyline.match.candidate import Hypotheses
from skyline.match.curve_fit import GOOD_FIT, ROUGH_FIT, CurveFit
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.query_rays import REFERENCE_FOV_DEG, QueryRays, in_runs
from skyline.match.screening import Alike, Screen, report_progress, screen_places
from skyline.store.places import Places
from skyline.store.read import PlaceSource
from skyline.terrain.heightfield import Ground, ground_slope

_SAMPLE = 2048
"""Places from which the mean and deviation of a query's scores are estimated."""
_ZOOM_STEP, _START_ZOOM_STEP = 0.18, 0.065
"""Steps of the logarithm of the zoom between the fields of view that are screened, and between
those that fits start from."""
_SCREENED_SHARE, _SCREENED_LEAST, _SCREENED_MOST = 0.05, 16_384, 262_144
"""Share of the places to which poses are fitted roughly, and their least and greatest number: they
are held in memory."""
_TURNS, _STARTS = 3, 1.5
"""Best turns of a place that screening passes on, and the mean number of rough fits for a place.
Screening finds the right place more often than the right turn, since it knows neither the pitch nor
where the eye stands."""
_FITTED = 8192
"""Best fits from which poses are fitted well."""
_SEPARATION_M, _TURN_DEG = 30.0, 20.0
"""Poses nearer to a better one, that look within this angle of it, are left out."""
_FITS_AT_ONCE = 2048
"""Poses fitted together. Of 256, two threads wait for the interpreter half the time."""
_PLACES_AT_ONCE = 512
"""Places whose best turns are found together; keeps the arrays in the cache."""
_HEADING_STEP_DEG = 3.0
"""Step of the headings from which poses are fitted at a known place."""
_LIKELY_DEVIATIONS = 2.5
"""Fields of view more than this many standard deviations from the expected one are not screened,
though fits may start there."""
_UNLIKELY = 0.25
"""Penalty of a field of view in screening, over the square of its standard deviations."""


class Retriever:
    """Finds short lists of poses among places.

    Without ``ground`` the ground around each place is taken to be level.
    """

    def __init__(self, places: PlaceSource, ground: Ground | None = None) -> None:
        self.places, self._ground = places, ground
        share = math.ceil(_SCREENED_SHARE * len(places))
        self._screened = min(max(share, _SCREENED_LEAST), _SCREENED_MOST)

    def sample(self, count: int) -> Places:
        """Return an even sample of some ``count`` places, the same in every process."""
        step = max(1, len(self.places) // count)
        return self.places.take(np.arange(0, len(self.places), step, dtype=np.intp))

    @cached_property
    def _sample(self) -> Places:
        return self.sample(_SAMPLE)

    def _no_place_error(self, priors: Sequence[Prior]) -> InputError:
        hints = (prior.swap_hint(self._sample) for prior in priors)
        return InputError(
            "no place of the store lies within what the search is narrowed to; widen it, or build "
            "a store of that area" + next(filter(None, hints), "")
        )

    def screened(
        self, query: QueryRays, prior: Prior = NOTHING_KNOWN, part: slice = slice(None)
    ) -> Alike:
        """Return the places most like a query, of a part of the blocks of places."""
        screen = self._screen(query, prior)
        return screen_places(screen.scores, self.places, self._screened, prior.contains, part)

    def shortlist(
        self,
        query: QueryRays,
        count: int,
        prior: Prior = NOTHING_KNOWN,
        screened: Alike | None = None,
    ) -> Hypotheses:
        """Return up to ``count`` poses that a query is most likely to have, best first.

        Poses may lie between the places. Scores compare poses of one query only. ``screened`` are
        the results of `screened` for all parts, joined; by default the places are screened here.
        Raises `InputError` where the search is narrowed to no place.
        """
        alike = self.screened(query, prior) if screened is None else screened
        alike = alike.best(self._screened)
        if not len(alike):
            raise self._no_place_error([prior])
        start = self._start(query, prior, self.places.take(alike.row), alike.score, _TURNS)
        fitted = self._fitted([query], [start])[0]
        fitted = fitted[prior.allows(fitted)]
        return fitted[fitted.suppress_non_maxima(count, _SEPARATION_M, _TURN_DEG)]

    def fitted_all_round(self, query: QueryRays) -> Hypotheses:
        """Return poses fitted to a query at every place, from headings all the way round.

        The places are few, since none is screened out.
        """
        places = self.places.take(np.arange(len(self.places), dtype=np.intp))
        heading_rad = np.radians(np.arange(0.0, 360.0, _HEADING_STEP_DEG))
        row, heading, zoom = np.meshgrid(
            np.arange(len(places)), heading_rad, _start_zooms(query), indexing="ij"
        )
        none = np.zeros(row.size, dtype=np.float32)
        start = _Start(places[row.ravel()], none, heading.ravel(), zoom.ravel())
        return self._fitted([query], [start])[0]

    def shortlist_together(
        self, queries: Sequence[tuple[QueryRays, Prior]], count: int
    ) -> list[Hypotheses]:
        """Return up to ``count`` places that queries of one eye most likely share, best first.

        The result holds the poses of each query at the same places, in the same order. A place lies
        within the narrowings of all queries, and its score is the sum of the queries' scores. A
        query whose score at a place is worse than its median counts with the median, so a query of
        another place cannot exclude the right one. Raises `InputError` where the search is narrowed
        to no place.
        """
        priors = [prior for _, prior in queries]
        screens = [self._screen(*one) for one in queries]
        alike = screen_places(
            lambda phase: np.sum([screen.scores(phase) for screen in screens], axis=0),
            self.places,
            self._screened,
            lambda some: np.all([prior.contains(some) for prior in priors], axis=0),
        )
        if not len(alike):
            raise self._no_place_error(priors)
        places = self.places.take(alike.row)
        starts = [
            self._start(query, prior, places, screen.scores(places.phase))
            for (query, prior), screen in zip(queries, screens, strict=True)
        ]
        found = self._fitted([query for query, _ in queries], starts)
        shared = {
            name: np.mean([getattr(one, name) for one in found], axis=0)
            for name in ("easting_m", "northing_m")
        } | {"score": _total(found)}
        joint = [replace(one, **shared) for one in found]
        chosen = joint[0].suppress_non_maxima(count, _SEPARATION_M)
        return [one[chosen] for one in joint]

    def _screen(self, query: QueryRays, prior: Prior) -> Screen:
        """Return the screen that finds places: of few, likely fields of view."""
        likely = _LIKELY_DEVIATIONS * query.log_scale_sd
        low, high = np.clip(query.log_scale_bounds, -likely, likely)
        zooms = _zooms(query, float(low), float(high), _ZOOM_STEP)
        penalty = _UNLIKELY * np.square(zooms / query.log_scale_sd)
        fovs_deg = query.searched_fov_deg(zooms)
        return Screen(query, fovs_deg, self._sample, prior.open_turns, penalty)

    def _start(
        self,
        query: QueryRays,
        prior: Prior,
        places: Places,
        score: Float32Array,
        turns: int = 1,
    ) -> "_Start":
        """Return the starts of fits: the best turn of each place, or the best of several of each.

        Every field of view is tried. Places are handled in small groups, because each is compared
        at every turn.
        """
        zooms = _start_zooms(query)
        screen = Screen(query, query.searched_fov_deg(zooms), self._sample, prior.open_turns)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            found = pool.map(
                lambda first: screen.best_turns(
                    places.phase[first : first + _PLACES_AT_ONCE], turns
                ),
                range(0, len(places), _PLACES_AT_ONCE),
            )
            heading_deg, fov, peak = (
                np.concatenate(part).ravel() for part in zip(*found, strict=True)
            )
        best = np.sort(np.argsort(-peak, kind="stable")[: math.ceil(_STARTS * len(places))])
        row = best // turns
        return _Start(places[row], score[row], np.radians(heading_deg[best]), zooms[fov[best]])

    def _fitted(self, queries: Sequence[QueryRays], starts: Sequence["_Start"]) -> list[Hypotheses]:
        """Return the poses of each query, fitted at the places that fit all of them best."""
        rough = [
            self._fits(query, start, *ROUGH_FIT)
            for query, start in zip(queries, starts, strict=True)
        ]
        best = np.sort(np.argsort(_total(rough), kind="stable")[:_FITTED])
        return [
            self._fits(query, start[best], *GOOD_FIT)
            for query, start in zip(queries, starts, strict=True)
        ]

    def _fits(
        self, query: QueryRays, start: "_Start", runs: int, scales_deg: tuple[float, ...]
    ) -> Hypotheses:
        rays = in_runs(query, runs)

        def fitted(first: int) -> Hypotheses:
            part = start[slice(first, first + _FITS_AT_ONCE)]
            places, slope = part.places, np.zeros((len(part), 2), dtype=np.float32)
            if self._ground is not None:
                rise = ground_slope(self._ground, places.easting_m, places.northing_m)
                slope = rise.astype(np.float32)
            fit = CurveFit(places, slope, rays, runs)
            poses = fit.fit(part.heading_rad, part.zoom, scales_deg)
            # The sum of both scores: a fit compares more than screening does, but assumes that the
            # query is near its place.
            return replace(poses, score=poses.score - part.score)

        parts = range(0, len(start), _FITS_AT_ONCE)
        found = []
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            try:
                for fit in pool.map(fitted, parts):
                    found.append(fit)
                    report_progress("fitting", len(found) / len(parts))
            except BaseException:
                # The progress callback may end the match: fits that have not begun are dropped.
                pool.shutdown(cancel_futures=True)
                raise
        return Hypotheses.concatenate(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Start(Rows):
    """N places, their scores in screening, and the headings and zooms that fits start from."""

    places: Places
    score: Float32Array
    heading_rad: Float64Array
    zoom: Float64Array


def _total(found: Sequence[Hypotheses]) -> Float64Array:
    """Return the sum of queries' scores at the same places, none worse than its median."""
    if len(found) == 1:
        return found[0].score
    return np.asarray(sum(np.minimum(one.score, np.median(one.score)) for one in found))


def _zooms(query: QueryRays, low: float, high: float, step: float) -> Float64Array:
    """Return the middles of equal parts of a range of zooms, as few as are no wider than a step.

    The step of a wide panorama is shorter: its ends move as far as those of a lens.
    """
    if query.is_panorama:
        step *= min(1.0, REFERENCE_FOV_DEG / query.fov_deg)
    parts = max(1, math.ceil((high - low) / step))
    return np.asarray(low + (np.arange(parts) + 0.5) * ((high - low) / parts))


def _start_zooms(query: QueryRays) -> Float64Array:
    """Return the zooms that fits start from."""
    return _zooms(query, *query.log_scale_bounds, _START_ZOOM_STEP)
