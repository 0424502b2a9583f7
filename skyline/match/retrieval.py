"""Retrieval: from rays to a short list of poses in a store.

It is coarse to fine. A coarse screen compares the photo with every place by phases, and a fine one
with the best of these places (`skyline.match.screen`). Then whole poses are fitted to the skylines
of the best places, first roughly to many of them, then well to fewer (`skyline.match.fit`). A short
list holds the best poses that differ from one another.

The most promising places come first. They make the first short list, which is enough for most
photos. The last short list is of all places that are worth a fit.
"""

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Rows
from skyline.errors import InputError
from skyline.match.fit import GOOD_FIT, ROUGH_FIT, CurveFit, FitEffort
from skyline.match.posterior import AlikePlaces
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.rays import REFERENCE_FOV_DEG, Rays, in_runs
from skyline.match.screen import (
    Alike,
    ReportProgress,
    Scores,
    Screen,
    rescored,
    screen_places,
    silent,
)
from skyline.pose import Poses
from skyline.store.mapped_places import PlaceSource
from skyline.store.places import Places
from skyline.terrain.heightfield import Ground, ground_slope


@dataclass(frozen=True, slots=True)
class RetrievalEffort:
    """How many places and poses each step of retrieval keeps."""

    sample: int = 2048
    """Places from which the mean and the deviation of a photo's scores are estimated."""
    coarse_step: float = 0.36
    """Step of `Rays.log_scale` between the fields of view of the coarse screen."""
    screened_step: float = 0.18
    """Step of `Rays.log_scale` between the fields of view of the fine screen."""
    screened_again: int = 2
    """Places that the fine screen compares again, for each one that is wanted."""
    first: int = 2048
    """Places of the first short list."""
    start_step: float = 0.09
    """Step of `Rays.log_scale` between the fields of view that fits start from."""
    likely_sd: float = 2.5
    """Fields of view more than this many standard deviations from the expected one are not
    screened, though fits may reach them."""
    unlikely_penalty: float = 0.5
    """Penalty of a field of view in screening, over the cost of its `LensPrior`."""
    least_crop_share: float = 0.1
    """Least probability of a crop with which narrower fields of view are screened."""
    crop_steps: float = 2.0
    """Step between those narrower ones, in steps of the likely ones."""
    rough_share: float = 0.05
    """Share of all places that the last short list is of."""
    rough_least: int = 16_384
    """Least number of these places."""
    rough_most: int = 262_144
    """Greatest number of these places: fits are held in memory."""
    turns: int = 3
    """Best turns of a place that screening passes on. Screening finds the right place more often
    than the right turn, since it knows neither the pitch nor where the eye stands."""
    starts: float = 1.5
    """Mean number of rough fits for a place."""
    good_share: float = 1 / 3
    """Share of the rough fits from which poses are fitted well: the best ones."""
    good_least: int = 1024
    """Least number of good fits, as many as a whole first short list has. In a search of few places
    every pose is fitted well, so the short list lacks none of them."""
    good_most: int = 8192
    """Greatest number of good fits."""
    separation_m: float = 30.0
    """A pose nearer to a better one that looks the same way is left out of the short list."""
    same_turn_deg: float = 20.0
    """Poses look the same way within this angle."""
    heading_step_deg: float = 3.0
    """Step of the headings from which poses are fitted at a known place."""


_EFFORT = RetrievalEffort()
_FITS_AT_ONCE = 2048
"""Poses fitted together. With 256, two threads spend half their time waiting for the GIL."""
_PLACES_AT_ONCE = 512
"""Places whose best turns are found together; keeps the arrays in the cache."""


class Retriever:
    """Finds short lists of poses among places.

    Without ``ground`` the ground around each place is taken to be level.
    """

    def __init__(self, places: PlaceSource, ground: Ground | None = None) -> None:
        self.places = places
        self._ground = ground
        share = math.ceil(_EFFORT.rough_share * len(places))
        self._rough = min(max(share, _EFFORT.rough_least), _EFFORT.rough_most)

    def sample(self, count: int) -> Places:
        """Return some ``count`` places, the same ones in every process."""
        step = max(1, len(self.places) // count)
        return self.places.take(np.arange(0, len(self.places), step, dtype=np.intp))

    @cached_property
    def _sample(self) -> Places:
        return self.sample(_EFFORT.sample)

    def shortlist(
        self,
        rays: Rays,
        count: int,
        prior: Prior = NOTHING_KNOWN,
        report: ReportProgress = silent,
    ) -> Poses:
        """Return the last of `shortlists`."""
        *_, last = self.shortlists(rays, count, prior, report)
        return last

    def shortlists(
        self,
        rays: Rays,
        count: int,
        prior: Prior = NOTHING_KNOWN,
        report: ReportProgress = silent,
    ) -> Iterator[Poses]:
        """Yield short lists of a photo's likely poses, each of more places.

        A list has up to ``count`` poses, best first, which may lie between the places. The poses of
        earlier lists compete again for a place in later ones. A list is empty where no fitted pose
        lies within the narrowing. Raises `InputError` where the search is narrowed to no place.
        """
        best: list[Poses] = []
        counts = (_EFFORT.first, self._rough)
        for alike in self._screened([self._screens(rays, prior)], [prior], counts, report):
            places = self.places.take(alike.row)
            starts = math.ceil(_EFFORT.starts * len(places))
            start = self._start(rays, prior, places, alike.score, starts)
            fitted = self._fitted([rays], [start], _good_count(len(start)), report)[0]
            best.append(fitted[prior.allows(fitted)])
            poses = Poses.concatenate(best)
            distinct = poses.suppress_non_maxima(count, _EFFORT.separation_m, _EFFORT.same_turn_deg)
            best = [poses[distinct]]
            yield best[0]

    def _screened(
        self,
        screens: Sequence[Sequence[Screen]],
        priors: Sequence[Prior],
        counts: Sequence[int],
        report: ReportProgress,
    ) -> Iterator[Alike]:
        """Yield the places of each short list that earlier lists lack.

        ``screens`` holds the coarse and the fine screen of each photo, whose scores are added.
        ``counts`` says of how many places each list is, the places of earlier lists included; there
        are fewer if fewer lie within the narrowings. Raises `InputError` where none does.
        """
        coarse, fine = (_sum_of(level) for level in zip(*screens, strict=True))
        ranked = screen_places(
            coarse,
            self.places,
            _EFFORT.screened_again * counts[-1],
            _within_all(priors),
            report,
        )
        if not len(ranked):
            raise self._no_place_error(priors)
        waiting = ranked[:0]
        for before, count in pairwise((0, *counts)):
            more = ranked[_EFFORT.screened_again * before : _EFFORT.screened_again * count]
            # Places that did not get into the list before this one compete again.
            waiting = Alike.joined([waiting, rescored(fine, self.places, more)]).best()
            part = waiting[: count - before]
            waiting = waiting[count - before :]
            if len(part):
                yield part

    def alike_places(
        self, photos: Sequence[tuple[Rays, Prior]], report: ReportProgress = silent
    ) -> AlikePlaces:
        """Return all places within the narrowings of photos of one eye, with their scores.

        The scores are of the coarse screen, summed over the photos. Raises `InputError` where the
        search is narrowed to no place.
        """
        priors = [prior for _, prior in photos]
        coarse = _sum_of([self._screens(rays, prior)[0] for rays, prior in photos])
        alike = screen_places(coarse, self.places, len(self.places), _within_all(priors), report)
        if not len(alike):
            raise self._no_place_error(priors)
        easting_m, northing_m, half_m = (
            np.concatenate(column)[alike.row]
            for column in zip(
                *((one.easting_m, one.northing_m, one.tolerance_m) for one in self.places.blocks()),
                strict=True,
            )
        )
        score = alike.score.astype(np.float64)
        return AlikePlaces(easting_m, northing_m, half_m.astype(np.float64), score)

    def fitted_all_round(self, rays: Rays) -> Poses:
        """Return poses fitted to a photo at every place.

        They start from headings all the way round. The places are few, since none is screened out.
        """
        places = self.places.take(np.arange(len(self.places), dtype=np.intp))
        row, heading_rad, log_scale = np.meshgrid(
            np.arange(len(places)),
            np.radians(np.arange(0.0, 360.0, _EFFORT.heading_step_deg)),
            _even_log_scales(rays, *rays.log_scale_bounds, _EFFORT.start_step),
            indexing="ij",
        )
        start = _Start(
            places=places[row.ravel()],
            score=np.zeros(row.size, dtype=np.float32),
            heading_rad=heading_rad.ravel(),
            log_scale=log_scale.ravel(),
        )
        return self._fitted([rays], [start], _EFFORT.good_most, silent)[0]

    def shortlist_together(
        self,
        photos: Sequence[tuple[Rays, Prior]],
        count: int,
        report: ReportProgress = silent,
    ) -> list[Poses]:
        """Return up to ``count`` likely common places, best first.

        The photos are of one eye. The result holds the poses of each photo at the same places, in
        the same order. A place lies within the narrowings of all photos, and its score is the sum
        of the photos' scores. A photo that fits a place worse than its median place counts there
        with the median, so a photo of another place cannot exclude the right one. Raises
        `InputError` where the search is narrowed to no place.
        """
        priors = [prior for _, prior in photos]
        screens = [self._screens(rays, prior) for rays, prior in photos]
        alike = next(self._screened(screens, priors, [self._rough], report))
        places = self.places.take(alike.row)
        starts = [
            self._start(rays, prior, places, fine.scores(places.phase), len(places), turns=1)
            for (rays, prior), (_, fine) in zip(photos, screens, strict=True)
        ]
        every = [rays for rays, _ in photos]
        found = self._fitted(every, starts, _good_count(len(places)), report)
        shared = {
            "easting_m": np.mean([one.easting_m for one in found], axis=0),
            "northing_m": np.mean([one.northing_m for one in found], axis=0),
            "cost": _total(found),
        }
        joint = [replace(one, **shared) for one in found]
        chosen = joint[0].suppress_non_maxima(count, _EFFORT.separation_m)
        return [one[chosen] for one in joint]

    def _no_place_error(self, priors: Sequence[Prior]) -> InputError:
        hints = (prior.swap_hint(self._sample) for prior in priors)
        return InputError(
            "no place of the store lies within what the search is narrowed to; widen it, or build "
            "a store of that area" + next(filter(None, hints), "")
        )

    def _screens(self, rays: Rays, prior: Prior) -> tuple[Screen, Screen]:
        """Return the coarse and the fine screen of a photo."""
        return (
            self._screen(rays, prior, _likely_log_scales(rays, _EFFORT.coarse_step), coarse=True),
            self._screen(rays, prior, _likely_log_scales(rays, _EFFORT.screened_step)),
        )

    def _screen(
        self, rays: Rays, prior: Prior, log_scales: Float64Array, *, coarse: bool = False
    ) -> Screen:
        """Return a screen of fields of view, with a penalty for unlikely ones."""
        penalty = _EFFORT.unlikely_penalty * rays.lens.cost(log_scales)
        fovs_deg = rays.searched_fov_deg(log_scales)
        return Screen(rays, fovs_deg, self._sample, prior.open_turns, penalty, coarse=coarse)

    def _start(
        self,
        rays: Rays,
        prior: Prior,
        places: Places,
        score: Float32Array,
        count: int,
        turns: int = _EFFORT.turns,
    ) -> "_Start":
        """Return up to ``count`` starts of fits, the best ones.

        Each place offers its best ``turns``. Places are handled in small groups, because each is
        compared at every turn.
        """
        log_scales = _likely_log_scales(rays, _EFFORT.start_step)
        screen = self._screen(rays, prior, log_scales)
        groups = range(0, len(places), _PLACES_AT_ONCE)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            found = pool.map(
                lambda k: screen.best_turns(places.phase[k : k + _PLACES_AT_ONCE], turns), groups
            )
            heading_deg, fov, peak = (
                np.concatenate(part).ravel() for part in zip(*found, strict=True)
            )
        best = np.sort(np.argsort(-peak, kind="stable")[:count])
        # In a narrow range of headings a place may have fewer turns than are asked for.
        best = best[peak[best] > -np.inf]
        row = best // turns
        return _Start(
            places=places[row],
            score=score[row],
            heading_rad=np.radians(heading_deg[best]),
            log_scale=log_scales[fov[best]],
        )

    def _fitted(
        self,
        photos: Sequence[Rays],
        starts: Sequence["_Start"],
        count: int,
        report: ReportProgress,
    ) -> list[Poses]:
        """Return the photos' poses fitted well from the ``count`` best common starts.

        Rough fits choose these starts, where there are more.
        """
        if count < len(starts[0]):
            rough = [
                self._fits(rays, start, ROUGH_FIT, report)
                for rays, start in zip(photos, starts, strict=True)
            ]
            best = np.sort(np.argsort(_total(rough), kind="stable")[:count])
            starts = [start[best] for start in starts]
        return [
            self._fits(rays, start, GOOD_FIT, report)
            for rays, start in zip(photos, starts, strict=True)
        ]

    def _fits(
        self, rays: Rays, start: "_Start", effort: FitEffort, report: ReportProgress
    ) -> Poses:
        means = in_runs(rays, effort.runs)

        def fitted(first: int) -> Poses:
            part = start[slice(first, first + _FITS_AT_ONCE)]
            fit = CurveFit(part.places, self._ground_slope(part.places), means, effort)
            poses = fit.fit(part.heading_rad, part.log_scale)
            # Both count: a fit compares more than screening does, but assumes that the photo was
            # taken near its place.
            return replace(poses, cost=poses.cost - part.score)

        parts = range(0, len(start), _FITS_AT_ONCE)
        found = []
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            try:
                for poses in pool.map(fitted, parts):
                    found.append(poses)
                    report("fitting", len(found) / len(parts))
            except BaseException:
                # The report may end the match: fits that have not begun are dropped.
                pool.shutdown(cancel_futures=True)
                raise
        return Poses.concatenate(found)

    def _ground_slope(self, places: Places) -> Float32Array:
        """Return the ground's rise (M, 2) to the east and north."""
        if self._ground is None:
            return np.zeros((len(places), 2), dtype=np.float32)
        rise = ground_slope(self._ground, places.easting_m, places.northing_m)
        return rise.astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Start(Rows):
    """N places with the starts of their fits."""

    places: Places
    score: Float32Array
    heading_rad: Float64Array
    log_scale: Float64Array


def _good_count(rough: int) -> int:
    """Return how many poses are fitted well after so many rough fits."""
    share = math.ceil(_EFFORT.good_share * rough)
    return min(max(share, _EFFORT.good_least), _EFFORT.good_most)


def _total(found: Sequence[Poses]) -> Float64Array:
    """Return the sum of photos' costs at the same places.

    No cost counts for more than its photo's median.
    """
    if len(found) == 1:
        return found[0].cost
    return np.asarray(sum(np.minimum(one.cost, np.median(one.cost)) for one in found))


def _within_all(priors: Sequence[Prior]) -> Callable[[Places], BoolArray]:
    """Return a function that marks the places (N,) within the narrowings of all photos."""
    return lambda some: np.all([prior.contains(some) for prior in priors], axis=0)


def _sum_of(screens: Sequence[Screen]) -> Scores:
    """Return a function that adds the scores of several photos."""
    return lambda phase: np.sum([screen.scores(phase) for screen in screens], axis=0)


def _even_log_scales(rays: Rays, low: float, high: float, step: float) -> Float64Array:
    """Return the middles of equal parts of a range.

    There are as few parts as possible, each no wider than a step. The step of a wide panorama or
    fisheye is shorter: its ends move as far as the ends of a lens.
    """
    if rays.projection.spreads_angles:
        step *= min(1.0, REFERENCE_FOV_DEG / rays.fov_deg)
    parts = max(1, math.ceil((high - low) / step))
    return np.asarray(low + (np.arange(parts) + 0.5) * ((high - low) / parts))


def _likely_log_scales(rays: Rays, step: float) -> Float64Array:
    """Return `Rays.log_scale` of likely fields of view, a step apart.

    Those of crops lie farther apart, and are left out if a crop is unlikely.
    """
    likely = _EFFORT.likely_sd * rays.lens.sd
    least, most = rays.log_scale_bounds
    low, high = (float(one) for one in np.clip((least, most), -likely, likely))
    core = _even_log_scales(rays, low, high, step)
    if rays.lens.crop_share < _EFFORT.least_crop_share:
        return core
    crops = _even_log_scales(rays, least, low, _EFFORT.crop_steps * step)
    return np.concatenate([crops, core])
