"""Retrieval: from rays to a short list of poses in a store.

Retrieval goes from coarse to fine. A coarse screen compares the photo with every place by phases,
and a fine screen compares it with the best of them (`skyline.match.screen`). Then whole poses are
fitted to the skylines of the best places, first roughly to many of them, then well to fewer
(`skyline.match.fit`). A short list holds the best poses that differ from one another.

The most promising places come first. They make the first short list, which is enough for most
photos. The last short list is made from all places that are worth a fit.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from skyline.arrays import BoolArray, Float64Array, IntArray
from skyline.errors import InputError
from skyline.match.fit import GOOD_FIT, ROUGH_FIT
from skyline.match.joined_shards import JoinedShards
from skyline.match.narrowing import Narrowing
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.rays import REFERENCE_FOV_DEG, Rays
from skyline.match.screen import Alike, AlikePlaces, Screen, turns_within
from skyline.match.shard import Starts
from skyline.pose.poses import Poses
from skyline.progress import StepProgress, silent
from skyline.store.places import Places

_CONVERGENCE_DEG = 5.0
"""Bound on the convergence of meridians within a frame; screening searches turns this much farther
to either side of a given heading."""


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
    """Greatest number of these places."""
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

    def last_places(self, places: int) -> int:
        """Return how many of all places make the last short list."""
        share = math.ceil(self.last_share * places)
        return min(max(share, self.last_least), self.last_most)

    def good_fits(self, rough: int) -> int:
        """Return how many poses are fitted well after so many rough fits."""
        share = math.ceil(self.good_share * rough)
        return min(max(share, self.good_least), self.good_most)


class NoPlaceError(InputError):
    """A search that is narrowed to no place."""


class Retriever:
    """Finds short lists of poses among the places of a search."""

    def __init__(self, places: JoinedShards, effort: RetrievalEffort | None = None) -> None:
        self._places = places
        self._effort = effort or RetrievalEffort()

    @cached_property
    def _sample(self) -> Places:
        return self._places.sample(self._effort.sample)

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
        lies within the narrowing. Raises `NoPlaceError` where the search is narrowed to no place.
        """
        starts: list[Starts] = []
        fitted: list[Poses] = []
        counts = self._effort.first_places, self._effort.last_places(len(self._places))
        for alike in self._screened([self._screens(rays, prior)], [prior], counts, report):
            its_starts, its_poses = self._fitted_at(rays, prior, alike, report)
            starts.append(its_starts)
            fitted.append(its_poses)
            poses = Poses.concatenate(fitted)
            if len(fitted) > 1:
                beside = self._beside(rays, Starts.concatenate(starts), poses)
                climbed = self._places.fitted(rays, beside, GOOD_FIT, report)
                climbed = climbed[prior.allows(climbed, self._places.frames)]
                poses = Poses.concatenate([poses, climbed])
            yield poses[self._distinct(poses, count)]

    def _fitted_at(
        self, rays: Rays, prior: Prior, alike: Alike, report: StepProgress
    ) -> tuple[Starts, Poses]:
        """Return the allowed poses fitted well at places, with their starts."""
        effort = self._effort
        count = math.ceil(effort.starts * len(alike))
        starts = self._starts(rays, prior, alike, count, effort.turns)
        (starts,) = self._promising([rays], [starts], effort.good_fits(len(starts)), report)
        poses = self._places.fitted(rays, starts, GOOD_FIT, report)
        is_allowed = prior.allows(poses, self._places.frames)
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
        has fewer if fewer lie within the narrowings. Raises `NoPlaceError` where none does.
        """
        coarse, fine = zip(*screens, strict=True)
        times = self._effort.screened_again
        ranked = self._places.screened(coarse, priors, times * counts[-1], report)
        if not len(ranked):
            raise self._no_place_error(priors)
        waiting = ranked[:0]
        for before, count in pairwise((0, *counts)):
            more = ranked[times * before : times * count]
            # Places that did not get into the list before this one compete again.
            again = Alike(more.row, self._places.rescored(fine, more.row))
            waiting = Alike.joined([waiting, again]).best()
            part = waiting[: count - before]
            waiting = waiting[count - before :]
            if len(part):
                yield part

    def alike_places(
        self, photos: Sequence[tuple[Rays, Prior]], report: StepProgress = silent
    ) -> AlikePlaces:
        """Return all places within the narrowings of photos, with scores.

        The photos are of one eye, and the places of one area. The coarse screen gives the scores,
        which are summed over the photos. Raises `NoPlaceError` where the search is narrowed to no
        place.
        """
        priors = [prior for _, prior in photos]
        coarse = [self._screens(rays, prior)[0] for rays, prior in photos]
        alike = self._places.alike_places(coarse, priors, report)
        if not len(alike):
            raise self._no_place_error(priors)
        return alike

    def fitted_all_round(self, rays: Rays) -> Poses:
        """Return poses fitted to a photo at every place.

        They start from headings all the way round. No place is screened out, so there must be few.
        """
        row, grid_heading_rad, log_scale = np.meshgrid(
            np.arange(len(self._places)),
            np.radians(np.arange(0.0, 360.0, self._effort.heading_step_deg)),
            _even_log_scales(rays, *rays.log_scale_bounds, self._effort.start_step),
            indexing="ij",
        )
        starts = Starts(
            row=row.ravel(),
            score=np.zeros(row.size, dtype=np.float32),
            grid_heading_rad=grid_heading_rad.ravel(),
            log_scale=log_scale.ravel(),
        )
        return self._fitted([rays], [starts], self._effort.good_most, silent)[0]

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
        `NoPlaceError` where the search is narrowed to no place.
        """
        priors = [prior for _, prior in photos]
        screens = [self._screens(rays, prior) for rays, prior in photos]
        last = self._effort.last_places(len(self._places))
        alike = next(self._screened(screens, priors, [last], report))
        starts = []
        for (rays, prior), (_, fine) in zip(photos, screens, strict=True):
            own = replace(alike, score=self._places.rescored([fine], alike.row))
            starts.append(self._starts(rays, prior, own, len(own), turns=1))
        every = [rays for rays, _ in photos]
        found = self._fitted(every, starts, self._effort.good_fits(len(alike)), report)
        shared = {
            "easting_m": np.mean([one.easting_m for one in found], axis=0),
            "northing_m": np.mean([one.northing_m for one in found], axis=0),
            "cost": _joint_cost(found),
        }
        joint = [replace(one, **shared) for one in found]
        chosen = joint[0].suppress_non_maxima(count, self._effort.separation_m)
        return [one[chosen] for one in joint]

    def _no_place_error(self, priors: Sequence[Prior]) -> NoPlaceError:
        hints = (prior.swap_hint(self._sample) for prior in priors)
        why = (
            "no place that is searched is near one of the photo spots; give spots of that area"
            if any(prior.only_near_spots for prior in priors)
            else "no place of the store lies within what the search is narrowed to; widen it, or "
            "build a store of that area"
        )
        return NoPlaceError(why + next(filter(None, hints), ""))

    def _screens(self, rays: Rays, prior: Prior) -> tuple[Screen, Screen]:
        """Return the coarse and the fine screen of a photo."""
        log_scales = self._likely_log_scales(rays, self._effort.screened_step)
        coarse = self._screen(rays, prior, log_scales, coarse=True)
        return coarse, self._screen(rays, prior, log_scales)

    def _screen(
        self, rays: Rays, prior: Prior, log_scales: Float64Array, *, coarse: bool = False
    ) -> Screen:
        """Return a screen of fields of view that penalizes unlikely ones."""
        penalty = self._effort.unlikely_penalty * rays.lens.cost(log_scales)
        fovs_deg = rays.searched_fov_deg(log_scales)
        open_turns = _open_turns(prior.narrowing)
        return Screen(rays, fovs_deg, self._sample, open_turns, penalty, coarse=coarse)

    def _starts(self, rays: Rays, prior: Prior, alike: Alike, count: int, turns: int) -> Starts:
        """Return up to ``count`` starts of fits, the best ones.

        Each place offers its best ``turns``.
        """
        log_scales = self._likely_log_scales(rays, self._effort.start_step)
        screen = self._screen(rays, prior, log_scales)
        found = self._places.best_turns(screen, alike.row, turns)
        score = found.score.ravel()
        best = np.sort(np.argsort(-score, kind="stable")[:count])
        # In a narrow range of headings a place may have fewer turns than are asked for.
        best = best[score[best] > -np.inf]
        place = best // turns
        return Starts(
            row=alike.row[place],
            score=alike.score[place],
            grid_heading_rad=np.radians(found.grid_heading_deg.ravel()[best]),
            log_scale=log_scales[found.fov_index.ravel()[best]],
        )

    def _beside(self, rays: Rays, starts: Starts, fitted: Poses) -> Starts:
        """Return the starts of fits beside the best poses.

        ``fitted`` are the poses fitted from ``starts``. The new starts are the poses themselves, at
        the places next to them.
        """
        best = self._distinct(fitted, math.ceil(self._effort.climbing_share * len(fitted)))
        poses = fitted[best]
        near = self._places.nearest(poses, self._effort.beside)
        pose, rank = np.nonzero(np.isfinite(near.distance_m))
        return Starts(
            row=near.row[pose, rank],
            score=starts.score[best][pose],
            grid_heading_rad=np.radians(poses.grid_heading_deg)[pose],
            log_scale=rays.log_scale(poses.fov_deg)[pose],
        )

    def _fitted(
        self,
        photos: Sequence[Rays],
        starts: Sequence[Starts],
        count: int,
        report: StepProgress,
    ) -> list[Poses]:
        """Return the photos' poses fitted from the ``count`` most promising starts."""
        return [
            self._places.fitted(rays, start, GOOD_FIT, report)
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
            self._places.fitted(rays, start, ROUGH_FIT, report)
            for rays, start in zip(photos, starts, strict=True)
        ]
        best = np.sort(np.argsort(_joint_cost(rough), kind="stable")[:count])
        return [start[best] for start in starts]

    def _distinct(self, poses: Poses, count: int) -> IntArray:
        """Return the indices of up to ``count`` distinct poses, best first."""
        effort = self._effort
        return poses.suppress_non_maxima(count, effort.separation_m, effort.same_turn_deg)

    def _likely_log_scales(self, rays: Rays, step: float) -> Float64Array:
        """Return `Rays.log_scale` of likely fields of view, a step apart.

        Fields of view of crops lie farther apart, and are left out if a crop is unlikely.
        """
        likely = self._effort.likely_sd * rays.lens.sd
        least, most = rays.log_scale_bounds
        low, high = (float(one) for one in np.clip((least, most), -likely, likely))
        core = _even_log_scales(rays, low, high, step)
        if rays.lens.crop_share < self._effort.least_crop_share:
            return core
        crops = _even_log_scales(rays, least, low, self._effort.crop_steps * step)
        return np.concatenate([crops, core])


def _open_turns(narrowing: Narrowing) -> BoolArray | None:
    """Return the turns (180,) that screening compares; None for all."""
    if narrowing.heading_deg is None:
        return None
    heading_deg, slack_deg = narrowing.heading_deg
    return turns_within(heading_deg, slack_deg + _CONVERGENCE_DEG)


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
