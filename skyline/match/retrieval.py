r"""Retrieval: from a rays's rays to a short list of poses among all places of a store.

Coarse to fine: screening compares every heading of every place by phases (`screening`). Then whole
poses are fitted to the skylines of the best places, first roughly to many of them, then well to
fewer (`CurveFit`). The short list holds the best poses that differ from one another.

With the distance D, tangent y and slope y' of a place's skyline at azimuth a, and the ground rising
by g, an eye moved by t (east, north) sees to first order

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

from skyline.arrays import BoolArray, Float32Array, Float64Array, FloatArray, Rows
from skyline.camera import near_level_changes
from skyline.errors import InputError
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.rays import REFERENCE_FOV_DEG, Rays, in_runs
from skyline.match.screen import ReportProgress, Screen, screen_places, silent
from skyline.pose import Poses
from skyline.store.places import Places
from skyline.store.read import PlaceSource
from skyline.terrain.heightfield import Ground, ground_slope

_SAMPLE = 2048
"""Places from which the mean and deviation of a rays's scores are estimated."""
_SCALE_STEP, _START_SCALE_STEP = 0.18, 0.065
"""Steps of the logarithm of the log_scale between the fields of view that are screened, and between
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
"""Poses fitted together. With 256, two threads spend half their time waiting for the GIL."""
_PLACES_AT_ONCE = 512
"""Places whose best turns are found together; keeps the arrays in the cache."""
_HEADING_STEP_DEG = 3.0
"""Step of the headings from which poses are fitted at a known place."""
_LIKELY_DEVIATIONS = 2.5
"""Fields of view more than this many standard deviations from the expected one are not screened,
though fits may start there."""
_UNLIKELY = 0.25
"""Penalty of a field of view in screening, over the square of its standard deviations."""

_HEADING, _PITCH, _ROLL, _LOG_SCALE, _EAST, _NORTH, _WANDER = range(7)
"""Columns of a fitted pose: heading from grid north, pitch and roll, radians; log_scale, the
`Rays.log_scale` of the field of view; metres east and north of the stored place. The columns
from `_WANDER` on are those of a panorama's `Rays.wander`, and there are none for a lens."""
_MOVE = slice(_EAST, _WANDER)
_DAMPING = np.float32(1e-3)
_LONGEST_STEP = np.array([*np.radians([3.0, 4.0, 3.0]), 0.04, 1.25, 1.25], dtype=np.float32)
"""Longest step of a round; moves in standard deviations of the place. Rows of a panorama wander at
most as far as a pitch goes."""
_PHOTO_ERROR_DEG = 0.06
"""Expected error of a mean of rays, at a field of view of 60 degrees."""
_CURVATURE = 0.05
"""Error of the tangent over (t / D)^2, for a rays at t from its place and terrain at distance
D."""
_PITCH_SD_DEG, _ROLL_SD_DEG = 5.0, 4.0
"""Prior standard deviations of the attitude."""
_OUTLIER, _UNKNOWN = 8.0, 4.0
"""Largest miss of a ray that counts, and the miss of a ray without a profile, in expected errors:
in coarse elevation models rays of the right pose miss by several."""

_ROUGH_FIT = 40, (0.5, 0.35, 0.25)
_GOOD_FIT = 100, (0.5, 0.35, 0.25, 0.2, 0.2)
"""The number of runs of the rays's columns whose means are fitted, and the scales of the Cauchy
weights, degrees, beside the expected error, from round to round."""


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

    def shortlist(
        self,
        rays: Rays,
        count: int,
        prior: Prior = NOTHING_KNOWN,
        report: ReportProgress = silent,
    ) -> Poses:
        """Return up to ``count`` poses that a rays is most likely to have, best first.

        Poses may lie between the places. Scores compare poses of one rays only. Raises
        `InputError` where the search is narrowed to no place.
        """
        scores = self._screen(rays, prior).scores
        alike = screen_places(scores, self.places, self._screened, prior.contains, report)
        if not len(alike):
            raise self._no_place_error([prior])
        start = self._start(rays, prior, self.places.take(alike.row), alike.score, _TURNS)
        fitted = self._fitted([rays], [start], report)[0]
        fitted = fitted[prior.allows(fitted)]
        return fitted[fitted.suppress_non_maxima(count, _SEPARATION_M, _TURN_DEG)]

    def fitted_all_round(self, rays: Rays) -> Poses:
        """Return poses fitted to a rays at every place, from headings all the way round.

        The places are few, since none is screened out.
        """
        places = self.places.take(np.arange(len(self.places), dtype=np.intp))
        heading_rad = np.radians(np.arange(0.0, 360.0, _HEADING_STEP_DEG))
        row, heading, log_scale = np.meshgrid(
            np.arange(len(places)), heading_rad, _start_log_scales(rays), indexing="ij"
        )
        none = np.zeros(row.size, dtype=np.float32)
        start = _Start(places[row.ravel()], none, heading.ravel(), log_scale.ravel())
        return self._fitted([rays], [start], silent)[0]

    def shortlist_together(
        self,
        photos: Sequence[tuple[Rays, Prior]],
        count: int,
        report: ReportProgress = silent,
    ) -> list[Poses]:
        """Return up to ``count`` places that photos of one eye most likely share, best first.

        The result holds the poses of each rays at the same places, in the same order. A place lies
        within the narrowings of all photos, and its score is the sum of the photos' scores. A
        rays whose score at a place is worse than its median counts with the median, so a rays of
        another place cannot exclude the right one. Raises `InputError` where the search is narrowed
        to no place.
        """
        priors = [prior for _, prior in photos]
        screens = [self._screen(*one) for one in photos]
        alike = screen_places(
            lambda phase: np.sum([screen.scores(phase) for screen in screens], axis=0),
            self.places,
            self._screened,
            lambda some: np.all([prior.contains(some) for prior in priors], axis=0),
            report,
        )
        if not len(alike):
            raise self._no_place_error(priors)
        places = self.places.take(alike.row)
        starts = [
            self._start(rays, prior, places, screen.scores(places.phase))
            for (rays, prior), screen in zip(photos, screens, strict=True)
        ]
        found = self._fitted([rays for rays, _ in photos], starts, report)
        shared = {
            name: np.mean([getattr(one, name) for one in found], axis=0)
            for name in ("easting_m", "northing_m")
        } | {"cost": _total(found)}
        joint = [replace(one, **shared) for one in found]
        chosen = joint[0].suppress_non_maxima(count, _SEPARATION_M)
        return [one[chosen] for one in joint]

    def _screen(self, rays: Rays, prior: Prior) -> Screen:
        """Return the screen that finds places: of few, likely fields of view."""
        likely = _LIKELY_DEVIATIONS * rays.log_scale_sd
        low, high = np.clip(rays.log_scale_bounds, -likely, likely)
        log_scales = _log_scales(rays, float(low), float(high), _SCALE_STEP)
        penalty = _UNLIKELY * np.square(log_scales / rays.log_scale_sd)
        fovs_deg = rays.searched_fov_deg(log_scales)
        return Screen(rays, fovs_deg, self._sample, prior.open_turns, penalty)

    def _start(
        self,
        rays: Rays,
        prior: Prior,
        places: Places,
        score: Float32Array,
        turns: int = 1,
    ) -> "_Start":
        """Return the starts of fits: the best turn of each place, or the best of several of each.

        Every field of view is tried. Places are handled in small groups, because each is compared
        at every turn.
        """
        log_scales = _start_log_scales(rays)
        screen = Screen(rays, rays.searched_fov_deg(log_scales), self._sample, prior.open_turns)
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
        return _Start(places[row], score[row], np.radians(heading_deg[best]), log_scales[fov[best]])

    def _fitted(
        self, photos: Sequence[Rays], starts: Sequence["_Start"], report: ReportProgress
    ) -> list[Poses]:
        """Return the poses of each rays, fitted at the places that fit all of them best."""
        rough = [
            self._fits(rays, start, *_ROUGH_FIT, report)
            for rays, start in zip(photos, starts, strict=True)
        ]
        best = np.sort(np.argsort(_total(rough), kind="stable")[:_FITTED])
        return [
            self._fits(rays, start[best], *_GOOD_FIT, report)
            for rays, start in zip(photos, starts, strict=True)
        ]

    def _fits(
        self,
        rays: Rays,
        start: "_Start",
        runs: int,
        scales_deg: tuple[float, ...],
        report: ReportProgress,
    ) -> Poses:
        rays = in_runs(rays, runs)

        def fitted(first: int) -> Poses:
            part = start[slice(first, first + _FITS_AT_ONCE)]
            places, slope = part.places, np.zeros((len(part), 2), dtype=np.float32)
            if self._ground is not None:
                rise = ground_slope(self._ground, places.easting_m, places.northing_m)
                slope = rise.astype(np.float32)
            fit = CurveFit(places, slope, rays, runs)
            poses = fit.fit(part.heading_rad, part.log_scale, scales_deg)
            # Both count: a fit compares more than screening does, but assumes that the photo was
            # taken near its place.
            return replace(poses, cost=poses.cost - part.score)

        parts = range(0, len(start), _FITS_AT_ONCE)
        found = []
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            try:
                for fit in pool.map(fitted, parts):
                    found.append(fit)
                    report("fitting", len(found) / len(parts))
            except BaseException:
                # The progress callback may end the match: fits that have not begun are dropped.
                pool.shutdown(cancel_futures=True)
                raise
        return Poses.concatenate(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Start(Rows):
    """N places, their scores in screening, and the headings and log_scales that fits start from."""

    places: Places
    score: Float32Array
    heading_rad: Float64Array
    log_scale: Float64Array


def _total(found: Sequence[Poses]) -> Float64Array:
    """Return the sum of photos' costs at the same places, none above its median."""
    if len(found) == 1:
        return found[0].cost
    return np.asarray(sum(np.minimum(one.cost, np.median(one.cost)) for one in found))


def _log_scales(rays: Rays, low: float, high: float, step: float) -> Float64Array:
    """Return the middles of equal parts of a range, as few as are no wider than a step.

    The step of a wide panorama is shorter: its ends move as far as those of a lens.
    """
    if rays.is_panorama:
        step *= min(1.0, REFERENCE_FOV_DEG / rays.fov_deg)
    parts = max(1, math.ceil((high - low) / step))
    return np.asarray(low + (np.arange(parts) + 0.5) * ((high - low) / parts))


def _start_log_scales(rays: Rays) -> Float64Array:
    """Return the log_scales that fits start from."""
    return _log_scales(rays, *rays.log_scale_bounds, _START_SCALE_STEP)


class CurveFit:
    """Fits one pose of a rays to each of M places.

    Queries lie evenly within a place's tolerance, so their standard deviation from it is the
    tolerance over the root of 3; no fit moves farther than twice that.

    Parameters
    ----------
    places : Places
    ground_slope : (M, 2) float32
        Rise of the ground to the east and to the north.
    rays : Rays
        R means of runs of the rays's rays; see `skyline.match.rays.in_runs`.
    runs : int
        Number of runs within 60 degrees.
    """

    def __init__(self, places: Places, ground_slope: Float32Array, rays: Rays, runs: int) -> None:
        self._places, self._ground_slope, self._rays, self._runs = places, ground_slope, rays, runs
        self._y = places.elevation_tan()
        nearness = 1.0 / places.distance_m()
        self._nearness = np.where(np.isfinite(nearness), nearness, np.float32(0.0))
        self._deviation_m = (places.tolerance_m / np.float32(np.sqrt(3.0)))[:, np.newaxis]
        self._wander = rays.wander.astype(np.float32)
        self._prior = self._inverse_variances()

    def fit(
        self, heading_rad: Float64Array, log_scale: Float64Array, scales_deg: tuple[float, ...]
    ) -> Poses:
        """Return the poses fitted from headings and log_scales (M,).

        A cost is the mean over rays of the misses, in expected errors, and what the priors add.
        ``scales_deg`` are the scales of the Cauchy weights from round to round.
        """
        pose = np.zeros(self._prior.shape, dtype=np.float32)
        pose[:, _HEADING], pose[:, _LOG_SCALE] = heading_rad, log_scale
        pose[:, _PITCH] = -np.median(self._misses(pose)[0], axis=1)
        for scale_deg in scales_deg:
            miss, change, nearness, known = self._misses(pose)
            # The expected squared errors of the tangents.
            bent = _CURVATURE * np.square(self._deviation_m * nearness)
            variance = np.square(self._photo_error(pose))[:, np.newaxis] + np.square(bent)
            variance = variance.astype(np.float32)
            weight = self._rays.weight.astype(np.float32) * known
            weight = weight / (variance + np.square(miss) + np.radians(scale_deg) ** 2)
            pose = self._bounded(pose, self._step(pose, miss, change, weight.astype(np.float32)))
        miss, _, _, known = self._misses(pose)
        cost = self._cost(pose, miss, known)
        heading, pitch, roll, log_scale = pose[:, :_EAST].T.astype(np.float64)
        move = pose[:, _MOVE].astype(np.float64)
        return Poses(
            easting_m=self._places.easting_m + move[:, 0],
            northing_m=self._places.northing_m + move[:, 1],
            eye_elevation_m=self._places.eye_elevation_m + (self._ground_slope * move).sum(axis=1),
            grid_heading_deg=np.degrees(heading) % 360.0,
            pitch_deg=np.degrees(pitch),
            roll_deg=np.degrees(roll),
            fov_deg=self._rays.searched_fov_deg(log_scale),
            cost=cost.astype(np.float64),
        )

    def _misses(
        self, pose: Float32Array
    ) -> tuple[Float32Array, Float32Array, Float32Array, BoolArray]:
        """Return the misses (M, R) of poses (M, P): rays' tangents minus those of the profiles.

        Also return their derivatives (M, P, R) by the columns of a pose, the profiles' inverse
        distances (M, R), 1 / m, and whether a profile is known (M, R). An unknown one has a miss
        of 0.
        """
        y, nearness = self._y, self._nearness
        lift = pose[:, _WANDER:] @ self._wander.T if self._rays.is_panorama else np.float32(0.0)
        pitch, roll, log_scale = (pose[:, k, np.newaxis] for k in (_PITCH, _ROLL, _LOG_SCALE))
        azimuth, tangent = self._rays.levelled(pitch, roll, log_scale, lift)
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
        ground = self._ground_slope[:, :, np.newaxis]
        east = (slope * cosine + profile * sine - ground[:, 0]) * near
        north = (profile * cosine - slope * sine - ground[:, 1]) * near
        miss = tangent - profile - east * pose[:, _EAST, np.newaxis]
        miss -= north * pose[:, _NORTH, np.newaxis]
        turned = near_level_changes(azimuth, tangent, slope, is_panorama=self._rays.is_panorama)
        change = np.stack([-slope, *turned, -east, -north], axis=1)
        if self._rays.is_panorama:
            wander = self._wander.T
            change = np.concatenate([change, np.tile(wander, (len(y), 1, 1))], axis=1)
        miss = np.where(known, miss, np.float32(0.0))
        return miss, change, near, known

    def _photo_error(self, pose: Float32Array) -> FloatArray:
        """Return the expected error (M,) of the rays's tangents, as large as a pixel.

        A camera measures pixels. If the error did not grow with the field of view, a small enough
        one would make every miss small.
        """
        usual = self._rays.projection.half_width(REFERENCE_FOV_DEG)
        size = 1.0 if self._rays.is_panorama else self._rays.half_width / usual
        scale = np.asarray(np.exp(pose[:, _LOG_SCALE]) * size, dtype=np.float32)
        return np.asarray(np.radians(_PHOTO_ERROR_DEG) * scale)

    def _inverse_variances(self) -> Float32Array:
        """Return the prior inverse variances (M, P) of the columns of a pose."""
        columns = _WANDER + self._wander.shape[1]
        prior = np.zeros((len(self._places), columns), dtype=np.float32)
        prior[:, _PITCH] = np.radians(_PITCH_SD_DEG) ** -2.0
        prior[:, _ROLL] = np.radians(_ROLL_SD_DEG) ** -2.0
        prior[:, _LOG_SCALE] = self._rays.log_scale_sd**-2.0
        prior[:, _MOVE] = self._deviation_m**-2.0
        if self._rays.is_panorama:
            prior[:, _WANDER:] = self._rays.warp_sd**-2.0
        return prior

    def _step(
        self, pose: Float32Array, miss: Float32Array, change: Float32Array, weight: Float32Array
    ) -> Float32Array:
        """Return the damped Gauss-Newton step (M, P) that is subtracted from poses."""
        weighted = change * weight[:, np.newaxis]
        normal = weighted @ change.transpose(0, 2, 1)
        gradient = (weighted @ miss[:, :, np.newaxis])[:, :, 0] + self._prior * pose
        diagonal = np.einsum("mkk->mk", normal)
        diagonal += self._prior
        diagonal += _DAMPING * (diagonal + 1.0)
        return np.asarray(np.linalg.solve(normal, gradient[:, :, np.newaxis])[:, :, 0])

    def _bounded(self, pose: Float32Array, step: Float32Array) -> Float32Array:
        """Return poses less a step, within the bounds of a step and of a pose."""
        limit = np.tile(_LONGEST_STEP, (len(pose), 1))
        limit[:, _MOVE] *= self._deviation_m
        wander = np.repeat(limit[:, _PITCH, np.newaxis], self._wander.shape[1], axis=1)
        limit = np.concatenate([limit, wander], axis=1)
        pose = pose - np.clip(step, -limit, limit)
        pose[:, _LOG_SCALE] = np.clip(pose[:, _LOG_SCALE], *self._rays.log_scale_bounds)
        farthest = 2.0 * self._deviation_m
        pose[:, _MOVE] = np.clip(pose[:, _MOVE], -farthest, farthest)
        return pose

    def _cost(self, pose: Float32Array, miss: Float32Array, known: BoolArray) -> Float32Array:
        error = self._photo_error(pose)
        off = np.minimum(np.abs(miss) / error[:, np.newaxis], np.float32(_OUTLIER))
        off = np.where(known, off, np.float32(_UNKNOWN))
        unlikely = 0.5 * (np.square(pose) * self._prior).sum(axis=1) / self._runs
        mean = (off * self._rays.weight.astype(np.float32)).mean(axis=1)
        return np.asarray(mean + unlikely, dtype=np.float32)
