"""Retrieval: from rays to a short list of poses in a store.

Retrieval goes from coarse to fine. A coarse screen compares the photo with every place by phases,
and a fine screen compares it with the best of them (`skyline.match.screen`). Then whole poses are
fitted to the skylines of the best places, first roughly to many of them, then well to fewer
(`skyline.match.fit`). A short list holds the best poses that differ from one another.

The most promising places come first. They make the first short list, which is enough for most
photos. The last short list is made from all places that are worth a fit.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, IntArray
from skyline.errors import InputError
from skyline.geodesy.map_frame import Frame
from skyline.match.fit import GOOD_FIT, ROUGH_FIT, FitEffort
from skyline.match.posterior import AlikePlaces
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.rays import REFERENCE_FOV_DEG, Rays
from skyline.match.screen import Alike, Screen, Turns
from skyline.match.shard import Neighbours, Shard, Starts
from skyline.pose.pose import Poses
from skyline.progress import StepProgress, silent
from skyline.store.places import Places

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class RetrievalEffort:
    """How many places and poses each step of retrieval keeps."""

    sample: int = 2048
    """Places from which the mean and the deviation of a photo's scores are estimated."""
    screened_step: float = 0.18
    """Step of `Rays.log_scale` between the fields of view that are screened. With one between two
    of them, the edges of a view of 60 degrees are off by one bin of phases."""
    screened_again: int = 4
    """Places that the fine screen compares again, for each one that is wanted."""
    first_places: int = 2048
    """Places from which the first short list is made."""
    start_step: float = 0.09
    """Step of `Rays.log_scale` between the fields of view that fits start from."""
    likely_sd: float = 2.5
    """Fields of view more than this many standard deviations from the expected one are not
    screened, though fits may reach them."""
    unlikely_penalty: float = 0.5
    """Penalty of a field of view in screening, as a multiple of its cost in `LensPrior`."""
    least_crop_share: float = 0.1
    """Narrower fields of view are screened if a crop is at least so probable."""
    crop_steps: float = 2.0
    """Step between these narrower fields of view, in steps of the likely ones."""
    last_share: float = 0.05
    """Share of all places from which the last short list is made."""
    last_least: int = 16_384
    """Least number of these places."""
    last_most: int = 65_536
    """Greatest number of these places. Among six million places, none of 29 queries came into a
    short list from a rank beyond 13,198."""
    turns: int = 3
    """Best turns of a place that screening passes on. Screening finds the right place more often
    than the right turn, since it knows neither the pitch nor where the eye stands."""
    starts: float = 1.5
    """Mean number of rough fits for a place."""
    good_share: float = 1 / 3
    """Share of the rough fits, the best ones, that are followed by good fits."""
    good_least: int = 1024
    """Least number of good fits: a whole first short list has as many. In a search of few places
    every pose is fitted well, so the short list lacks none of them."""
    good_most: int = 8192
    """Greatest number of good fits."""
    climbing_share: float = 0.1
    """Share of the good fits, the best distinct ones, from which the last short list climbs. A
    place beside a pose's own may be more like the photo, though screening passed over it."""
    beside: int = 7
    """Places next to such a pose that it is fitted to: its own and those around it."""
    separation_m: float = 30.0
    """A pose nearer to a better one that looks the same way is left out of the short list."""
    same_turn_deg: float = 20.0
    """Poses look the same way within this angle."""
    heading_step_deg: float = 3.0
    """Step of the headings from which poses are fitted at a known place."""


_EFFORT = RetrievalEffort()


class Retriever:
    """Finds short lists of poses among the places of shards.

    Places are ranked together, whatever their shards. Rows are counted through all shards, one
    after another.

    Parameters
    ----------
    areas : sequence of sequence of Shard
        The shards of each elevation model, which share its frame.
    frames : sequence of Frame
        The frames, by area. One area alone needs none.
    at_once : int
        Shards that are asked at a time; shards of this process take all of its cores.
    """

    def __init__(
        self, areas: Sequence[Sequence[Shard]], frames: Sequence[Frame] = (), at_once: int = 1
    ) -> None:
        self._at_once = at_once
        self._shards = [shard for shards in areas for shard in shards]
        self._area_of_shard = np.repeat(np.arange(len(areas)), [len(shards) for shards in areas])
        self._frames = frames
        self._first_row = np.cumsum([0, *map(len, self._shards)])
        share = math.ceil(_EFFORT.last_share * len(self))
        self._last_places = min(max(share, _EFFORT.last_least), _EFFORT.last_most)

    def __len__(self) -> int:
        return int(self._first_row[-1])

    def sample(self, count: int) -> Places:
        """Return about ``count`` places, the same ones in every process."""
        step = max(1, len(self) // count)
        rows = np.arange(0, len(self), step, dtype=np.intp)
        return self._of_each(rows, lambda shard, _, own: shard.take(own), Places.concatenate)

    @cached_property
    def _sample(self) -> Places:
        return self.sample(_EFFORT.sample)

    def allowed(self, prior: Prior, poses: Poses) -> BoolArray:
        """Return which poses (M,) a narrowing allows."""
        if poses.in_areas is None:
            return prior.allows(poses)
        allowed = np.zeros(len(poses), dtype=bool)
        for area, its_prior in enumerate(prior.in_frames(self._frames)):
            mine = np.flatnonzero(poses.in_areas.area == area)
            allowed[mine] = its_prior.allows(poses[mine])
        return allowed

    def _shard_of(self, rows: IntArray) -> IntArray:
        """Return the numbers (M,) of the shards that hold places."""
        return np.searchsorted(self._first_row, rows, side="right") - 1

    def _asked(self, asks: Iterable[Callable[[], T]]) -> Iterator[T]:
        """Yield shards' answers, in order."""
        if self._at_once == 1:
            yield from (ask() for ask in asks)
            return
        with ThreadPoolExecutor(self._at_once) as pool:
            yield from pool.map(lambda ask: ask(), asks)

    def _of_each(
        self,
        rows: IntArray,
        ask: Callable[[Shard, IntArray, IntArray], T],
        concatenate: Callable[[list[T]], T],
    ) -> T:
        """Return shards' answers about places (M,), in the places' order.

        ``ask`` takes a shard, the indices of its places in ``rows``, and their rows in the shard.
        """
        number = self._shard_of(rows)
        # About no places the first shard is asked: its answer is empty, and of the right kind.
        asked = np.unique(number).tolist() if len(rows) else [0]
        at = [np.flatnonzero(number == one) for one in asked]
        asks = (
            partial(ask, self._shards[one], mine, rows[mine] - self._first_row[one])
            for one, mine in zip(asked, at, strict=True)
        )
        parts = list(self._asked(asks))
        if len(parts) == 1:
            return parts[0]
        back: Any = np.argsort(np.concatenate(at), kind="stable")
        together: Any = concatenate(parts)
        answer: T = together[back]
        return answer

    def shortlist(
        self,
        rays: Rays,
        count: int,
        prior: Prior = NOTHING_KNOWN,
        report: StepProgress = silent,
    ) -> Poses:
        """Return the last of `shortlists`."""
        *_, last = self.shortlists(rays, count, prior, report)
        return last

    def shortlists(
        self,
        rays: Rays,
        count: int,
        prior: Prior = NOTHING_KNOWN,
        report: StepProgress = silent,
    ) -> Iterator[Poses]:
        """Yield short lists of a photo's likely poses, each from more places.

        A list has up to ``count`` poses, best first, which may lie between the places. The poses of
        earlier lists compete again for a place in later ones. A list is empty where no fitted pose
        lies within the narrowing. Raises `InputError` where the search is narrowed to no place.
        """
        starts: list[Starts] = []
        fitted: list[Poses] = []
        counts = (_EFFORT.first_places, self._last_places)
        for alike in self._screened([self._screens(rays, prior)], [prior], counts, report):
            its_starts, its_poses = self._fitted_at(rays, prior, alike, report)
            starts.append(its_starts)
            fitted.append(its_poses)
            poses = Poses.concatenate(fitted)
            if len(fitted) > 1:
                beside = self._beside(rays, Starts.concatenate(starts), poses)
                climbed = self._fits(rays, beside, GOOD_FIT, report)
                poses = Poses.concatenate([poses, climbed[self.allowed(prior, climbed)]])
            yield poses[_distinct(poses, count)]

    def _fitted_at(
        self, rays: Rays, prior: Prior, alike: Alike, report: StepProgress
    ) -> tuple[Starts, Poses]:
        """Return the allowed poses fitted well at places, with their starts."""
        starts = self._starts(rays, prior, alike, math.ceil(_EFFORT.starts * len(alike)))
        (starts,) = self._promising([rays], [starts], _good_count(len(starts)), report)
        poses = self._fits(rays, starts, GOOD_FIT, report)
        is_allowed = self.allowed(prior, poses)
        return starts[is_allowed], poses[is_allowed]

    def _screened(
        self,
        screens: Sequence[Sequence[Screen]],
        priors: Sequence[Prior],
        counts: Sequence[int],
        report: StepProgress,
    ) -> Iterator[Alike]:
        """Yield the places of each short list that earlier lists lack.

        ``screens`` holds the coarse and the fine screen of each photo, whose scores are added.
        ``counts`` has the number of places of each list, with the places of earlier lists; a list
        has fewer if fewer lie within the narrowings. Raises `InputError` where none does.
        """
        coarse, fine = zip(*screens, strict=True)
        ranked = self._ranked(coarse, priors, _EFFORT.screened_again * counts[-1], report)
        if not len(ranked):
            raise self._no_place_error(priors)
        waiting = ranked[:0]
        for before, count in pairwise((0, *counts)):
            more = ranked[_EFFORT.screened_again * before : _EFFORT.screened_again * count]
            # Places that did not get into the list before this one compete again.
            again = Alike(more.row, self._rescored(fine, more.row))
            waiting = Alike.joined([waiting, again]).best()
            part = waiting[: count - before]
            waiting = waiting[count - before :]
            if len(part):
                yield part

    def _ranked(
        self,
        screens: Sequence[Screen],
        priors: Sequence[Prior],
        count: int,
        report: StepProgress,
    ) -> Alike:
        """Return the best ``count`` places of all shards, best first."""
        by_area = [prior.in_frames(self._frames) for prior in priors]
        kept = Alike.joined([])
        least = -math.inf

        def screened(number: int) -> Alike:
            shard = self._shards[number]
            there = [its_priors[self._area_of_shard[number]] for its_priors in by_area]
            first = self._first_row[number]
            told = partial(_report_part, report, first / len(self), len(shard) / len(self))
            alike = shard.screened(screens, there, count, least, told)
            return replace(alike, row=first + alike.row)

        for alike in self._asked(partial(screened, number) for number in range(len(self._shards))):
            kept = Alike.joined([kept, alike])
            if len(kept) > count:
                # Shards that are asked later need not answer with places that are worse.
                kept = kept.best(count)
                least = float(kept.score[-1])
        return kept.best()

    def _rescored(self, screens: Sequence[Screen], rows: IntArray) -> Float32Array:
        """Return the sums of photos' scores at places (M,)."""
        return self._of_each(
            rows, lambda shard, _, own: shard.rescored(screens, own), np.concatenate
        )

    def alike_places(
        self, photos: Sequence[tuple[Rays, Prior]], report: StepProgress = silent
    ) -> AlikePlaces:
        """Return all places within the narrowings of photos, with scores.

        The photos are of one eye, and the places of one area. The coarse screen gives the scores,
        which are summed over the photos. Raises `InputError` where the search is narrowed to no
        place.
        """
        priors = [prior for _, prior in photos]
        coarse = [self._screens(rays, prior)[0] for rays, prior in photos]
        asks = (partial(shard.alike_places, coarse, priors, report) for shard in self._shards)
        alike = AlikePlaces.concatenate(list(self._asked(asks)))
        if not len(alike):
            raise self._no_place_error(priors)
        return alike

    def fitted_all_round(self, rays: Rays) -> Poses:
        """Return poses fitted to a photo at every place.

        They start from headings all the way round. No place is screened out, so there must be few.
        """
        row, grid_heading_rad, log_scale = np.meshgrid(
            np.arange(len(self)),
            np.radians(np.arange(0.0, 360.0, _EFFORT.heading_step_deg)),
            _even_log_scales(rays, *rays.log_scale_bounds, _EFFORT.start_step),
            indexing="ij",
        )
        starts = Starts(
            row=row.ravel(),
            score=np.zeros(row.size, dtype=np.float32),
            grid_heading_rad=grid_heading_rad.ravel(),
            log_scale=log_scale.ravel(),
        )
        return self._fitted([rays], [starts], _EFFORT.good_most, silent)[0]

    def shortlist_together(
        self,
        photos: Sequence[tuple[Rays, Prior]],
        count: int,
        report: StepProgress = silent,
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
        alike = next(self._screened(screens, priors, [self._last_places], report))
        starts = []
        for (rays, prior), (_, fine) in zip(photos, screens, strict=True):
            own = replace(alike, score=self._rescored([fine], alike.row))
            starts.append(self._starts(rays, prior, own, len(own), turns=1))
        every = [rays for rays, _ in photos]
        found = self._fitted(every, starts, _good_count(len(alike)), report)
        shared = {
            "easting_m": np.mean([one.easting_m for one in found], axis=0),
            "northing_m": np.mean([one.northing_m for one in found], axis=0),
            "cost": _joint_cost(found),
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
        log_scales = _likely_log_scales(rays, _EFFORT.screened_step)
        coarse = self._screen(rays, prior, log_scales, coarse=True)
        return coarse, self._screen(rays, prior, log_scales)

    def _screen(
        self, rays: Rays, prior: Prior, log_scales: Float64Array, *, coarse: bool = False
    ) -> Screen:
        """Return a screen of fields of view that penalizes unlikely ones."""
        penalty = _EFFORT.unlikely_penalty * rays.lens.cost(log_scales)
        fovs_deg = rays.searched_fov_deg(log_scales)
        return Screen(rays, fovs_deg, self._sample, prior.open_turns, penalty, coarse=coarse)

    def _starts(
        self, rays: Rays, prior: Prior, alike: Alike, count: int, turns: int = _EFFORT.turns
    ) -> Starts:
        """Return up to ``count`` starts of fits, the best ones.

        Each place offers its best ``turns``.
        """
        log_scales = _likely_log_scales(rays, _EFFORT.start_step)
        screen = self._screen(rays, prior, log_scales)
        found = self._of_each(
            alike.row,
            lambda shard, _, own: shard.best_turns(screen, own, turns),
            Turns.concatenate,
        )
        score = found.score.ravel()
        best = np.sort(np.argsort(-score, kind="stable")[:count])
        # In a narrow range of headings a place may have fewer turns than are asked for.
        best = best[score[best] > -np.inf]
        place = best // turns
        return Starts(
            row=alike.row[place],
            score=alike.score[place],
            grid_heading_rad=np.radians(found.grid_heading_deg.ravel()[best]),
            log_scale=log_scales[found.fov.ravel()[best]],
        )

    def _beside(self, rays: Rays, starts: Starts, fitted: Poses) -> Starts:
        """Return the starts of fits beside the best poses.

        ``fitted`` are the poses fitted from ``starts``. The new starts are the poses themselves, at
        the places next to them.
        """
        best = _distinct(fitted, math.ceil(_EFFORT.climbing_share * len(fitted)))
        poses = fitted[best]
        near = self._nearest(poses, _EFFORT.beside)
        pose, rank = np.nonzero(np.isfinite(near.distance_m))
        return Starts(
            row=near.row[pose, rank],
            score=starts.score[best][pose],
            grid_heading_rad=np.radians(poses.grid_heading_deg)[pose],
            log_scale=rays.log_scale(poses.fov_deg)[pose],
        )

    def _nearest(self, poses: Poses, count: int) -> Neighbours:
        """Return the ``count`` places of each pose's area nearest to it."""
        place_m = np.stack([poses.easting_m, poses.northing_m], axis=1)
        row = np.zeros((len(poses), count), dtype=np.intp)
        distance_m = np.full(row.shape, np.inf)

        def nearest(number: int, mine: IntArray) -> Neighbours:
            found = self._shards[number].nearest(place_m[mine], count)
            return replace(found, row=found.row + self._first_row[number])

        areas = poses.areas()
        for area in np.unique(areas):
            mine = np.flatnonzero(areas == area)
            shards = np.flatnonzero(self._area_of_shard == area).tolist()
            parts = list(self._asked(partial(nearest, number, mine) for number in shards))
            rows = np.concatenate([part.row for part in parts], axis=1)
            distances_m = np.concatenate([part.distance_m for part in parts], axis=1)
            order = np.argsort(distances_m, axis=1, kind="stable")[:, :count]
            row[mine] = np.take_along_axis(rows, order, axis=1)
            distance_m[mine] = np.take_along_axis(distances_m, order, axis=1)
        return Neighbours(row=row, distance_m=distance_m)

    def _fitted(
        self,
        photos: Sequence[Rays],
        starts: Sequence[Starts],
        count: int,
        report: StepProgress,
    ) -> list[Poses]:
        """Return the photos' poses fitted from the ``count`` most promising starts."""
        return [
            self._fits(rays, start, GOOD_FIT, report)
            for rays, start in zip(
                photos, self._promising(photos, starts, count, report), strict=True
            )
        ]

    def _promising(
        self,
        photos: Sequence[Rays],
        starts: Sequence[Starts],
        count: int,
        report: StepProgress,
    ) -> Sequence[Starts]:
        """Return the photos' ``count`` common starts with the best rough fits.

        They keep their order.
        """
        if count >= len(starts[0]):
            return starts
        rough = [
            self._fits(rays, start, ROUGH_FIT, report)
            for rays, start in zip(photos, starts, strict=True)
        ]
        best = np.sort(np.argsort(_joint_cost(rough), kind="stable")[:count])
        return [start[best] for start in starts]

    def _fits(self, rays: Rays, starts: Starts, effort: FitEffort, report: StepProgress) -> Poses:
        """Return the poses fitted from starts, in order.

        They have `Poses.in_areas` if there are several areas.
        """

        def fitted(shard: Shard, mine: IntArray, rows: IntArray) -> Poses:
            return shard.fitted(rays, replace(starts[mine], row=rows), effort, report)

        poses = self._of_each(starts.row, fitted, Poses.concatenate)
        if len(self._frames) < 2:
            return poses
        return poses.found_in(self._area_of_shard[self._shard_of(starts.row)], self._frames)


def _report_part(report: StepProgress, done: float, share: float, step: str, part: float) -> None:
    """Report part of a shard's work as a share of all work."""
    report(step, done + share * part)


def _distinct(poses: Poses, count: int) -> IntArray:
    """Return the indices of up to ``count`` distinct poses, best first."""
    return poses.suppress_non_maxima(count, _EFFORT.separation_m, _EFFORT.same_turn_deg)


def _good_count(rough: int) -> int:
    """Return how many poses are fitted well after so many rough fits."""
    share = math.ceil(_EFFORT.good_share * rough)
    return min(max(share, _EFFORT.good_least), _EFFORT.good_most)


def _joint_cost(found: Sequence[Poses]) -> Float64Array:
    """Return the sum of photos' costs at the same places.

    Of several photos, no cost counts for more than its photo's median.
    """
    if len(found) == 1:
        return found[0].cost
    return np.asarray(sum(np.minimum(one.cost, np.median(one.cost)) for one in found))


def _even_log_scales(rays: Rays, low: float, high: float, step: float) -> Float64Array:
    """Return the middles of equal parts of a range.

    There are as few parts as possible, each no wider than a step. A wide panorama or fisheye has a
    shorter step, so its ends move no farther than the ends of a lens.
    """
    if rays.projection.spreads_angles:
        step *= min(1.0, REFERENCE_FOV_DEG / rays.fov_deg)
    parts = max(1, math.ceil((high - low) / step))
    return np.asarray(low + (np.arange(parts) + 0.5) * ((high - low) / parts))


def _likely_log_scales(rays: Rays, step: float) -> Float64Array:
    """Return `Rays.log_scale` of likely fields of view, a step apart.

    Fields of view of crops lie farther apart, and are left out if a crop is unlikely.
    """
    likely = _EFFORT.likely_sd * rays.lens.sd
    least, most = rays.log_scale_bounds
    low, high = (float(one) for one in np.clip((least, most), -likely, likely))
    core = _even_log_scales(rays, low, high, step)
    if rays.lens.crop_share < _EFFORT.least_crop_share:
        return core
    crops = _even_log_scales(rays, least, low, _EFFORT.crop_steps * step)
    return np.concatenate([crops, core])
