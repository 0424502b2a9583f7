r"""Retrieval: from a query's rays to a short list of poses among all places of a store.

Coarse to fine: screening compares every heading of every place by phases (`screening`). Then whole
poses are fitted to the skylines of the best places, first roughly to many of them, then well to
fewer. The short list holds the best poses that differ from one another.

A pose is fitted to a place without rendering. With the distance D, tangent y and slope y' of the
place's skyline at azimuth a, and the ground rising by g, an eye moved by t (east, north) sees to
first order

.. math::

    y(a; t) \approx y(a) + \frac{y' t_\perp + y t_\parallel - g \cdot t}{D}, \quad
    t_\parallel = t_e \sin a + t_n \cos a, \quad t_\perp = t_e \cos a - t_n \sin a

so heading, pitch, roll, field of view and a small move are fitted together, by damped Gauss-Newton
with Cauchy weights whose scale shrinks from round to round. The first order neglects an error that
grows with (t / D)^2, so near terrain is trusted less.
"""

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Rows
from skyline.errors import InputError
from skyline.match.candidate import Hypotheses
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.query_rays import REFERENCE_FOV_DEG, QueryRays, in_runs, level_axes
from skyline.match.screening import Alike, Screen, report_progress, sample_of, screen_places
from skyline.store.places import Places
from skyline.store.read import PlaceSource
from skyline.terrain.edge import DataEdge
from skyline.terrain.heightfield import Ground

_ZOOM_STEP, _START_ZOOM_STEP = 0.18, 0.065
"""Steps of the logarithm of the zoom between the fields of view that are screened, and between
those that fits start from."""
_SCREENED_SHARE, _SCREENED_LEAST, _SCREENED_MOST = 0.05, 16_384, 262_144
"""Share of the places to which poses are fitted roughly, and their least and greatest number: they
are held in memory."""
_TURNS, _STARTS = 3, 1.5
"""Turns of each place from which poses may be fitted roughly, and the number of fits, a place: the
turns that screening likes best. It finds the right place more often than the right turn, since it
knows neither the pitch nor where the eye stands."""
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
_SLOPE_REACH_M = 15.0
"""Half the distance over which the ground's slope is taken."""

_HEADING, _PITCH, _ROLL, _ZOOM, _EAST, _NORTH, _WANDER = range(7)
"""Columns of a fitted pose: heading from grid north, pitch and roll, radians; zoom, the
`QueryRays.log_scale` of the field of view; metres east and north of the stored place. The columns
from `_WANDER` on are those of a panorama's `QueryRays.wander`, and there are none for a lens."""
_MOVE = slice(_EAST, _WANDER)
_DAMPING = np.float32(1e-3)
_LONGEST_STEP = np.array([*np.radians([3.0, 4.0, 3.0]), 0.04, 1.25, 1.25], dtype=np.float32)
"""Longest step of a round; moves in standard deviations of the place. Rows of a panorama wander at
most as far as a pitch goes."""
_MIN_FORWARD = np.float32(0.05)
"""Rays nearer to a quarter turn from straight ahead are taken to lie there."""
_QUERY_ERROR_DEG = 0.06
"""Expected error of a mean of rays, at a field of view of 60 degrees."""
_CURVATURE = 0.05
"""Error of the tangent over (t / D)^2, for a query at t from its place and terrain at distance
D."""
_PITCH_SD_DEG, _ROLL_SD_DEG = 5.0, 4.0
"""Prior standard deviations of the attitude."""
_OUTLIER = 4.0
"""Largest miss of a ray that is counted, in expected errors."""
_BEYOND = 2.0
"""The same for a ray above the profile where terrain past the data's edge may rise as high."""


_ROUGHLY = 40, (0.5, 0.35, 0.25)
_WELL = 100, (0.5, 0.35, 0.25, 0.2, 0.2)
"""Stages of fitting: the number of runs of the query's columns whose means are fitted, and the
scales of the Cauchy weights, degrees, beside the expected error, from round to round."""


class Retriever:
    """Finds short lists of poses among places.

    Without ``ground`` the ground around each place is taken to be level; without ``edge`` no
    terrain is taken to lie past the data.
    """

    def __init__(
        self, places: PlaceSource, ground: Ground | None = None, edge: DataEdge | None = None
    ) -> None:
        self.places, self._ground, self._edge = places, ground, edge
        share = math.ceil(_SCREENED_SHARE * len(places))
        self._screened = min(max(share, _SCREENED_LEAST), _SCREENED_MOST)

    @cached_property
    def _sample(self) -> Places:
        return sample_of(self.places)

    def _no_place_error(self, priors: Sequence[Prior]) -> InputError:
        """Return the error that a search is narrowed to no place."""
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
        aim = self._aim(query, prior)
        start = self._start(query, aim, self.places.take(alike.row), alike.score, _TURNS)
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
            self._start(query, self._aim(query, prior), places, screen.scores(places.phase))
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
        zooms = _middles(float(low), float(high), _ZOOM_STEP * _zoom_share(query))
        penalty = _UNLIKELY * np.square(zooms / query.log_scale_sd)
        return Screen.of(query, _fov_deg(query, zooms), self._sample, prior.open_turns, penalty)

    def _aim(self, query: QueryRays, prior: Prior) -> Screen:
        """Return the screen that finds headings and fields of view at places: of all of these."""
        fovs_deg = _fov_deg(query, _start_zooms(query))
        return Screen.of(query, fovs_deg, self._sample, prior.open_turns)

    def _start(
        self, query: QueryRays, aim: Screen, places: Places, score: Float32Array, turns: int = 1
    ) -> "_Start":
        """Return the starts of fits: the best turn of each place, or the best of several of each.

        Few places are seen at a time, as each is seen at every turn.
        """
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            parts = range(0, len(places), _PLACES_AT_ONCE)
            found = pool.map(
                lambda first: aim.best_turns(places.phase[first : first + _PLACES_AT_ONCE], turns),
                parts,
            )
            heading_deg, fov, peak = (
                np.concatenate(part).ravel() for part in zip(*found, strict=True)
            )
        best = np.argsort(-peak, kind="stable")[: math.ceil(_STARTS * len(places))]
        best = np.sort(best)
        row, zoom = best // turns, _start_zooms(query)[fov[best]]
        return _Start(places[row], score[row], np.radians(heading_deg[best]), zoom)

    def _fitted(self, queries: Sequence[QueryRays], starts: Sequence["_Start"]) -> list[Hypotheses]:
        """Return the poses of each query, fitted at the places that fit all of them best."""
        rough = [
            self._fits(query, start, *_ROUGHLY)
            for query, start in zip(queries, starts, strict=True)
        ]
        best = np.sort(np.argsort(_total(rough), kind="stable")[:_FITTED])
        return [
            self._fits(query, start[best], *_WELL)
            for query, start in zip(queries, starts, strict=True)
        ]

    def _fits(
        self, query: QueryRays, start: "_Start", runs: int, scales_deg: tuple[float, ...]
    ) -> Hypotheses:
        """Return the poses fitted from starts, in order."""
        rays = in_runs(query, runs)

        def fitted(first: int) -> Hypotheses:
            part = start[slice(first, first + _FITS_AT_ONCE)]
            places, slope = part.places, np.zeros((len(part), 2), dtype=np.float32)
            if self._ground is not None:
                rise = ground_slope(self._ground, places.easting_m, places.northing_m)
                slope = rise.astype(np.float32)
            fit = _CurveFit(places, slope, rays, runs, scales_deg, self._edge)
            pose, score = fit.fit(part.heading_rad, part.zoom)
            heading, pitch, roll, zoom = pose[:, :4].T.astype(np.float64)
            move = pose[:, _MOVE].astype(np.float64)
            return Hypotheses(
                places.easting_m + move[:, 0],
                places.northing_m + move[:, 1],
                places.eye_elevation_m + (slope * move).sum(axis=1),
                np.degrees(heading) % 360.0,
                np.degrees(pitch),
                np.degrees(roll),
                _fov_deg(query, zoom),
                np.zeros(len(zoom)),
                # The sum of both scores: a fit compares more than screening does, but assumes that
                # the query is near its place.
                score.astype(np.float64) - part.score,
            )

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


def ground_slope(ground: Ground, easting_m: Float64Array, northing_m: Float64Array) -> Float64Array:
    """Return the rise of the ground (M, 2) a metre east and north; 0 beside unknown ground."""
    place = easting_m + 1j * northing_m
    around = np.concatenate([place + _SLOPE_REACH_M * turn for turn in (1.0, -1.0, 1.0j, -1.0j)])
    east, west, north, south = ground(around.real, around.imag).reshape(4, -1)
    return np.nan_to_num(np.stack([east - west, north - south], axis=1) / (2.0 * _SLOPE_REACH_M))


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


def _middles(low: float, high: float, step: float) -> Float64Array:
    """Return the middles of equal parts of a range, as few as are no wider than a step."""
    parts = max(1, math.ceil((high - low) / step))
    return np.asarray(low + (np.arange(parts) + 0.5) * ((high - low) / parts))


def _start_zooms(query: QueryRays) -> Float64Array:
    """Return the zooms that fits start from."""
    return _middles(*query.log_scale_bounds, _START_ZOOM_STEP * _zoom_share(query))


def _zoom_share(query: QueryRays) -> float:
    """Return the share of a zoom step that moves the ends of a wide panorama as far."""
    return min(1.0, REFERENCE_FOV_DEG / query.fov_deg) if query.is_panorama else 1.0


def _fov_deg(query: QueryRays, zoom: Float64Array) -> Float64Array:
    # Rounding must not take a field of view out of the query's range.
    return np.asarray(np.clip(query.fov_at(zoom), *query.fov_bounds_deg))


@dataclass(frozen=True, slots=True, eq=False)
class _Misses:
    """Elevation tangents of rays (M, R) of M poses minus those of the profiles."""

    miss: Float32Array
    """(M, R) float32. 0 where the profile is unknown."""
    change: Float32Array
    """(M, P, R) float32. Derivatives of the miss by the columns of a pose."""
    nearness: Float32Array
    """(M, R) float32. Inverse distance of the profile, 1 / m."""
    known: BoolArray
    azimuth: Float32Array
    tangent: Float32Array
    """``azimuth``, ``tangent``: (M, R) float32. Azimuths of the rays from grid north, radians, and
    their elevation tangents."""


@dataclass(frozen=True, slots=True, eq=False)
class _CurveFit:
    """Fits one pose of a query to each of M places."""

    places: Places
    """M places. Queries lie evenly within a place's tolerance, so their standard deviation from it
    is the tolerance over the root of 3; no fit moves farther than twice that."""
    ground_slope: Float32Array
    """(M, 2) float32. Rise of the ground to the east and to the north."""
    rays: QueryRays
    """R means of runs of the query's rays; see `in_runs`."""
    runs: int
    scales_deg: tuple[float, ...]
    """``runs``, ``scales_deg``: see `_ROUGHLY`."""
    edge: DataEdge | None

    @property
    def _wander(self) -> Float32Array:
        """Ways (R, K) in which the rows of a panorama may wander; see `QueryRays.wander`."""
        return self.rays.wander.astype(np.float32)

    @property
    def _deviation_m(self) -> Float32Array:
        """Standard deviation (M,) of a query's easting, and northing, from the place's."""
        return self.places.tolerance_m / np.float32(np.sqrt(3.0))

    def fit(self, heading: Float64Array, zoom: Float64Array) -> tuple[Float32Array, Float32Array]:
        """Return poses (M, P) fitted from headings, radians, and zooms (M,), and scores (M,).

        A score is the mean over rays of the negative log likelihood, up to a constant.
        """
        columns = _WANDER + self._wander.shape[1]
        pose = np.zeros((len(heading), columns), dtype=np.float32)
        pose[:, _HEADING], pose[:, _ZOOM] = heading, zoom
        y, nearness = self.places.elevation_tan(), 1.0 / self.places.distance_m()
        nearness = np.where(np.isfinite(nearness), nearness, np.float32(0.0))
        misses = self._misses(pose, y, nearness)
        pose[:, _PITCH] = -np.median(misses.miss, axis=1)
        prior = self._prior()
        for scale_deg in self.scales_deg:
            misses = self._misses(pose, y, nearness)
            variance = self._variance(pose, misses.nearness)
            weight = self.rays.weight.astype(np.float32) * misses.known
            weight = weight / (variance + np.square(misses.miss) + np.radians(scale_deg) ** 2)
            pose = self._bounded(pose, _step(pose, misses, weight.astype(np.float32), prior))
        return pose, self._score(pose, self._misses(pose, y, nearness), prior)

    def _misses(self, pose: Float32Array, y: Float32Array, nearness: Float32Array) -> _Misses:
        """Return the misses of poses (M, P) from profiles y (M, B), and their derivatives."""
        azimuth, tangent = self._project(pose)
        bins = y.shape[1]
        toward = azimuth + pose[:, :1]
        position = toward * np.float32(bins / (2.0 * np.pi)) - np.float32(0.5)
        left = np.floor(position)
        share = position - left
        row = (np.arange(len(y)) * bins)[:, np.newaxis]
        begin = row + left.astype(np.intp) % bins
        end = row + (left.astype(np.intp) + 1) % bins
        profile = y.ravel()[begin]
        rise = y.ravel()[end] - profile
        known = np.isfinite(rise)
        rise = np.where(known, rise, np.float32(0.0))
        profile = np.where(known, profile, np.float32(0.0)) + share * rise
        slope = rise * np.float32(bins / (2.0 * np.pi))
        coarse = nearness.shape[1]
        run = np.floor((position + np.float32(0.5)) * np.float32(coarse / bins)).astype(np.intp)
        near = nearness.ravel()[(np.arange(len(y)) * coarse)[:, np.newaxis] + run % coarse]
        sine, cosine = np.sin(toward), np.cos(toward)
        ground = self.ground_slope[:, :, np.newaxis]
        east = (slope * cosine + profile * sine - ground[:, 0]) * near
        north = (profile * cosine - slope * sine - ground[:, 1]) * near
        miss = tangent - profile - east * pose[:, _EAST, np.newaxis]
        miss -= north * pose[:, _NORTH, np.newaxis]
        own_sine, own_cosine = np.sin(azimuth), np.cos(azimuth)
        if self.rays.is_panorama:
            pitch, zoom = np.ones_like(tangent), tangent - slope * azimuth
        else:
            pitch = own_cosine
            zoom = tangent * np.square(own_cosine) - slope * own_sine * own_cosine
        change = np.stack([-slope, pitch, -own_sine, zoom, -east, -north], axis=1)
        if self.rays.is_panorama:
            wander = self._wander.T
            change = np.concatenate([change, np.tile(wander, (len(y), 1, 1))], axis=1)
        miss = np.where(known, miss, np.float32(0.0))
        return _Misses(miss, change, near, known, toward, tangent)

    def _project(self, pose: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Return azimuths from straight ahead and tangents of the rays (M, R); see `level`."""
        pitch, roll, zoom = (pose[:, k, np.newaxis] for k in (_PITCH, _ROLL, _ZOOM))
        scale = np.exp(zoom)
        u, v = (ray.astype(np.float32) * scale for ray in (self.rays.u, self.rays.v))
        is_panorama = self.rays.is_panorama
        if is_panorama:
            v = v + pose[:, _WANDER:] @ self._wander.T
        right, up, forward = level_axes(u, v, pitch, roll, is_panorama=is_panorama)
        if is_panorama:
            return np.arctan2(right, forward), up / np.hypot(right, forward)
        forward = np.maximum(forward, _MIN_FORWARD)
        return np.arctan(right / forward), up / np.hypot(right, forward)

    def _variance(self, pose: Float32Array, nearness: Float32Array) -> Float32Array:
        """Return the expected squared error (M, R) of the tangents."""
        query = np.radians(_QUERY_ERROR_DEG) * self._scale(pose)
        move = _CURVATURE * np.square(self._deviation_m[:, np.newaxis] * nearness)
        return np.asarray(np.square(query)[:, np.newaxis] + np.square(move), dtype=np.float32)

    def _scale(self, pose: Float32Array) -> Float32Array:
        """Return the size (M,) of a pixel over that at a field of view of 60 degrees.

        A camera measures pixels. Without this scale a small enough field of view would make every
        miss small.
        """
        half_rad = np.radians([self.rays.fov_deg, REFERENCE_FOV_DEG]) / 2.0
        size = 1.0 if self.rays.is_panorama else float(np.divide(*np.tan(half_rad)))
        return np.asarray(np.exp(pose[:, _ZOOM]) * size, dtype=np.float32)

    def _prior(self) -> Float32Array:
        """Return the inverse variances (M, P) of the columns of a pose."""
        columns = _WANDER + self._wander.shape[1]
        prior = np.zeros((len(self.places), columns), dtype=np.float32)
        prior[:, _PITCH] = np.radians(_PITCH_SD_DEG) ** -2.0
        prior[:, _ROLL] = np.radians(_ROLL_SD_DEG) ** -2.0
        prior[:, _ZOOM] = self.rays.log_scale_sd**-2.0
        prior[:, _MOVE] = self._deviation_m[:, np.newaxis] ** -2.0
        if self.rays.is_panorama:
            prior[:, _WANDER:] = self.rays.warp_sd**-2.0
        return prior

    def _bounded(self, pose: Float32Array, step: Float32Array) -> Float32Array:
        """Return poses less a step, within the bounds of a step and of a pose."""
        deviation_m = self._deviation_m[:, np.newaxis]
        limit = np.tile(_LONGEST_STEP, (len(pose), 1))
        limit[:, _MOVE] *= deviation_m
        wander = np.repeat(limit[:, _PITCH, np.newaxis], self._wander.shape[1], axis=1)
        limit = np.concatenate([limit, wander], axis=1)
        pose = pose - np.clip(step, -limit, limit)
        pose[:, _ZOOM] = np.clip(pose[:, _ZOOM], *self.rays.log_scale_bounds)
        farthest = 2.0 * deviation_m
        pose[:, _MOVE] = np.clip(pose[:, _MOVE], -farthest, farthest)
        return pose

    def _score(self, pose: Float32Array, misses: _Misses, prior: Float32Array) -> Float32Array:
        variance = self._variance(pose, misses.nearness)
        outlier = np.float32(_OUTLIER)
        miss = np.abs(misses.miss) / np.sqrt(variance)
        most = np.where(self._may_hide(misses), np.float32(_BEYOND), outlier)
        cost = np.where(misses.known, np.minimum(miss, most), outlier)
        cost += 0.5 * np.log(variance / np.square(self._scale(pose))[:, np.newaxis])
        unlikely = 0.5 * (np.square(pose) * prior).sum(axis=1) / self.runs
        mean = (cost * self.rays.weight.astype(np.float32)).mean(axis=1)
        return np.asarray(mean + unlikely, dtype=np.float32)

    def _may_hide(self, misses: _Misses) -> BoolArray:
        """Return which rays (M, R) terrain past the data's edge may explain."""
        if self.edge is None:
            return np.zeros(misses.miss.shape, dtype=np.bool_)
        places = self.places
        eyes = np.stack([places.easting_m, places.northing_m, places.eye_elevation_m])
        east_m, north_m, eye_m = eyes.astype(np.float32)[..., np.newaxis]
        most = self.edge.elevation_tan(east_m, north_m, eye_m, misses.azimuth)
        return np.asarray((misses.miss > 0.0) & (misses.tangent < most))


def _step(
    pose: Float32Array, misses: _Misses, weight: Float32Array, prior: Float32Array
) -> Float32Array:
    """Return the damped Gauss-Newton step (M, P) that is subtracted from poses."""
    weighted = misses.change * weight[:, np.newaxis]
    normal = weighted @ misses.change.transpose(0, 2, 1)
    gradient = (weighted @ misses.miss[:, :, np.newaxis])[:, :, 0] + prior * pose
    diagonal = np.einsum("mkk->mk", normal)
    diagonal += prior
    diagonal += _DAMPING * (diagonal + 1.0)
    return np.asarray(np.linalg.solve(normal, gradient[:, :, np.newaxis])[:, :, 0])
