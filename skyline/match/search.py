"""The full matcher: retrieval among places, refinement by rendering, and a confidence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from skyline.arrays import BoolArray, Float64Array
from skyline.errors import InputError
from skyline.geodesy.map_frame import Frame
from skyline.match import confidence
from skyline.match.blas_threads import one_blas_thread
from skyline.match.joined_shards import JoinedShards
from skyline.match.method import BY_RENDERING, SearchMethod
from skyline.match.narrowing import Narrowing
from skyline.match.other_projection import OtherProjection, find_other_projection
from skyline.match.prior import Prior
from skyline.match.rays import Rays
from skyline.match.refine import QUICK, WHOLE, Refinement, RefinementEffort, best_of_several
from skyline.match.retrieval import NoPlaceError, Retriever
from skyline.match.screen import AlikePlaces
from skyline.match.shard import LocalShard, Shard
from skyline.match.together import JointRefinement
from skyline.pose.pose import ROUGHLY_WITHIN_M, Pose
from skyline.pose.poses import Poses
from skyline.progress import Step, StepProgress, silent
from skyline.render.horizon import RenderedScene
from skyline.store.layout import PLACES
from skyline.store.read import Store
from skyline.terrain.heightfield import HeightField, ground_of
from skyline.terrain.viewpoints import LEAST_EYE_HEIGHT_M, Viewpoints

_SHORTLIST_SHARE = 1 / 1500
"""Poses that retrieval returns for each place: the more places there are, the more are alike."""
_SEPARATION_M = 100.0
"""Least distance between candidates."""
_EYES = 20_000
"""A store of more places returns about this many eyes."""


@dataclass(frozen=True, slots=True)
class SearchEffort:
    """How many poses a search refines, and how thoroughly."""

    quick: RefinementEffort = QUICK
    """The effort for the first short list, and for the surroundings of answers."""
    whole: RefinementEffort = WHOLE
    """The effort for the last short list."""
    sure_margin: float = 75.0
    """A quick refinement is enough where its best pose leads all others by this margin."""
    least_shortlist: int = 400
    """Least number of poses that retrieval returns; the greatest is ``whole.shortlist``."""
    large_area: float = round(WHOLE.shortlist / _SHORTLIST_SHARE)
    """Places from which on the short list grows no more: it holds few poses of each
    neighbourhood."""
    surroundings: int = 3
    """Answers whose surroundings are searched again in a large area, where a quick refinement is
    not enough."""
    surroundings_km: float = 2e-3 * ROUGHLY_WITHIN_M
    """Radius of these surroundings: two poses that are roughly right are no farther apart."""
    nearby_shortlist: int = 100
    """Poses that retrieval returns from the surroundings of one place."""


@dataclass(frozen=True, slots=True, eq=False)
class SearchedArea:
    """Places of one elevation model and frame, with a scene of it."""

    shards: Sequence[Shard]
    frame: Frame
    scene: RenderedScene | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FoundPoses:
    """The poses found for one photo."""

    retrieved: Poses
    refined: Poses | None
    """None without a scene."""

    @property
    def best(self) -> Poses:
        """The best refined pose alone, or none."""
        return self.retrieved[:0] if self.refined is None else self.refined[:1]


class FullMatcher(SearchMethod):
    """Retrieval, refinement and confidence; without a scene, poses stay as retrieved.

    The places of all areas are ranked together. Poses are refined in their own areas, and then
    compared. Either all areas have a scene, or none has.
    """

    holds = PLACES
    renders = True
    finds_fov = True
    takes_prior = True
    effort: ClassVar[SearchEffort] = SearchEffort()

    def __init__(self, areas: Sequence[SearchedArea], at_once: int = 1) -> None:
        self._areas = areas
        self._frames = [area.frame for area in areas] if len(areas) > 1 else []
        self._places = JoinedShards([area.shards for area in areas], self._frames, at_once)
        self._retriever = Retriever(self._places)
        self.models = confidence.models()
        share = round(_SHORTLIST_SHARE * len(self._places))
        self._shortlist = min(max(share, self.effort.least_shortlist), self.effort.whole.shortlist)

    @classmethod
    def open(
        cls, store: Store, terrain: HeightField | None = None, scene: RenderedScene | None = None
    ) -> "FullMatcher":
        """Return the matcher of an open store of places.

        ``terrain`` is the terrain of its places; None where the DEM cannot be read.
        """
        ground = None if terrain is None else ground_of(terrain)
        shard = LocalShard(store.places(), ground)
        return cls([SearchedArea([shard], Frame(store.header.frame_wkt), scene)])

    @classmethod
    def joined(cls, methods: Sequence["FullMatcher"]) -> "FullMatcher":
        """Return one matcher of all their areas; see `SearchMethod.joined`."""
        areas = [area for method in methods for area in method._areas]
        if any(area.scene is None for area in areas):
            areas = [replace(area, scene=None) for area in areas]
        return cls(areas)

    def by_shards(self, shards: Sequence[Sequence[Shard]], at_once: int) -> "FullMatcher":
        """Return this matcher with other shards, by area; see `SearchMethod.by_shards`."""
        areas = [
            replace(area, shards=its_shards)
            for area, its_shards in zip(self._areas, shards, strict=True)
        ]
        return FullMatcher(areas, at_once)

    def eyes(self) -> Viewpoints:
        """Return the eyes of all places, or a sample of very many."""
        some = self._places.sample(_EYES)
        eyes = (some.easting_m, some.northing_m, some.eye_elevation_m)
        east_m, north_m, eye_m = (column.astype(np.float64) for column in eyes)
        return Viewpoints(easting_m=east_m, northing_m=north_m, eye_elevation_m=eye_m)

    def search(self, rays: Rays, prior: Prior, top: int, report: StepProgress = silent) -> Poses:
        """Return up to ``top`` poses with confidences, best first; see `SearchMethod.search`."""
        found = self.found(rays, prior, report)
        retrieved, poses = found.retrieved, found.refined
        if not len(retrieved):
            return retrieved
        if poses is None:
            figures = confidence.retrieved_figures(retrieved, rays)
            chosen = retrieved.suppress_non_maxima(top, _SEPARATION_M)
            sure = confidence.probabilities(self.models, "retrieved", figures)
            return _with_confidence(retrieved, sure)[chosen]
        if not len(poses):
            return poses
        # A pose that has moved out of the narrowing is no candidate.
        is_allowed = prior.allows(poses, self._frames)
        narrowed = replace(poses, cost=np.where(is_allowed, poses.cost, np.inf))
        chosen = narrowed.suppress_non_maxima(top, _SEPARATION_M)
        if not len(chosen):
            return poses[chosen]
        figures = confidence.refined_figures(narrowed, retrieved, rays)
        sure = confidence.shared_probabilities(self.models, narrowed, figures)
        return _with_confidence(poses, sure)[chosen]

    @one_blas_thread()
    def found(self, rays: Rays, prior: Prior, report: StepProgress = silent) -> FoundPoses:
        """Return the poses found for a photo.

        The first short list is refined quickly. That is enough where one place fits far better than
        any other, as with most skylines. Otherwise the last short list is refined with more effort,
        and in a large area the surroundings of the best answers are searched again. Raises as
        `search`.
        """
        effort = self.effort
        lists = self._retriever.shortlists(rays, self._shortlist, prior, report)
        retrieved = next(lists)
        if self._areas[0].scene is None:
            return FoundPoses(next(lists, retrieved), None)
        likely = self._about_likely_places(rays, prior, report)
        starts = _with_likely(retrieved, likely)
        poses = self._refined(effort.quick, rays, prior, starts, report)
        if len(poses) and poses.figures().margin[0] > effort.sure_margin:
            return FoundPoses(retrieved, poses)
        retrieved = next(lists, retrieved)
        starts = _with_likely(retrieved, likely)
        poses = self._refined(effort.whole, rays, prior, starts, report)
        if len(self._places) > effort.large_area:
            poses = self._with_surroundings(rays, prior, poses, report)
        return FoundPoses(retrieved, poses)

    def _with_surroundings(
        self, rays: Rays, prior: Prior, poses: Poses, report: StepProgress
    ) -> Poses:
        """Return refined poses, with those around the best answers, best first.

        Few poses of one neighbourhood have been refined, and these may have ended in local optima.
        A search of the surroundings alone finds better ones. The best rivals get such a search as
        well, so that no answer leads by its second search.
        """
        effort = self.effort
        radius_km = effort.surroundings_km
        answers = poses[poses.suppress_non_maxima(effort.surroundings, 1000.0 * radius_km)]
        parts = [poses]
        for number, one in enumerate(answers.on_map(*(area.frame for area in self._areas))):
            report(Step.SURROUNDINGS, number / len(answers))
            frame = self._areas[0].frame
            around = prior.around(frame, lon=one.lon, lat=one.lat, radius_km=radius_km)
            near = self._retrieved_in(around, rays)
            if near is not None:
                parts.append(self._refined(effort.quick, rays, prior, near))
        return best_of_several(parts, effort.whole.finalists)

    def _refined(
        self,
        effort: RefinementEffort,
        rays: Rays,
        prior: Prior,
        poses: Poses,
        report: StepProgress = silent,
    ) -> Poses:
        """Return distinct poses that fit, best first; see `Refinement.run`.

        Each area refines its own poses among the best of all areas.
        """
        priors = prior.in_frames(self._frames)
        best = poses[np.argsort(poses.cost, kind="stable")[: effort.shortlist]]
        parts = []
        for number, (area, its_prior) in enumerate(zip(self._areas, priors, strict=True)):
            own = replace(best[best.areas() == number], in_areas=None)
            # The first area refines even no poses, so that there is an answer, if an empty one.
            if area.scene is None or (not len(own) and number):
                continue
            found = Refinement(rays, area.scene, effort, its_prior, report=report).run(own)
            parts.append(self._found_in(number, found))
        return best_of_several(parts, effort.finalists)

    def _found_in(self, area: int, poses: Poses) -> Poses:
        """Return poses marked as an area's, if several areas are searched."""
        if not self._frames:
            return poses
        return poses.found_in(np.full(len(poses), area, dtype=np.intp), self._frames)

    @one_blas_thread()
    def likely_places(
        self, photos: Sequence[tuple[Rays, Prior]], report: StepProgress = silent
    ) -> tuple[Poses, AlikePlaces]:
        """Return what is known of all places; see `SearchMethod.likely_places`."""
        if len(photos) == 1:
            ((rays, prior),) = photos
            fitted = self._retriever.shortlist(rays, self._shortlist, prior, report)
        else:
            fitted = self._retriever.shortlist_together(photos, self._shortlist, report)[0]
        return fitted, self._retriever.alike_places(photos, report)

    @one_blas_thread()
    def other_projection(self, rays: Rays, best: Pose, prior: Prior) -> OtherProjection | None:
        """Return the likeliest other projection of a photo.

        Returns None for a panorama, and if the best candidate is unrefined or more likely wrong.
        """
        scene = self._areas[best.area].scene
        if scene is None or not best.refined:
            return None
        its_prior = prior.in_frames(self._frames)[best.area]
        return find_other_projection(
            rays,
            Poses.of(best),
            best.confidence_1km or 0.0,
            lambda bent: Refinement(bent, scene, self.effort.quick, its_prior),
        )

    @one_blas_thread()
    def fitted(self, rays: Rays, start: Pose, prior: Prior, about_start: Rays) -> Poses:
        """Return a pose refined by rendering.

        The result is empty where nothing near the start fits. The first fit uses ``about_start``,
        the photo's rays about the start's field of view, and keeps the eye's height above the
        ground, or the least at which a camera is held. The second fit is as in a search, so its
        cost compares with costs of a search with the same rays and prior. The confidence is learned
        from such fits (`confidence.FITTED`). Raises `InputError` without a scene, and for a pose
        off the map or on a hole.
        """
        scene = self._needed_scene(start.area)
        prior = prior.in_frames(self._frames)[start.area]
        pose = Poses.of(start)
        off_m = pose.eye_elevation_m - scene.ground_m(pose.easting_m, pose.northing_m)
        if not np.isfinite(off_m).all():
            raise InputError("the pose to fit from is off the map or on a hole; move it")
        above_m = max(LEAST_EYE_HEIGHT_M, float(off_m[0]))
        effort = replace(self.effort.whole, restarts=1)
        held = Prior(Narrowing(eye_height_m=above_m))
        poses = Refinement(about_start, scene, effort, held).run(pose)
        poses = Refinement(rays, scene, effort, prior, first_eye_height_m=above_m).run(poses[:1])
        if not len(poses):
            return poses
        poses = poses[:1]
        figures = confidence.pose_figures(poses, rays)
        sure = confidence.probabilities(self.models, confidence.FITTED, figures)
        return self._found_in(start.area, _with_confidence(poses, sure))

    @one_blas_thread()
    def search_together(
        self,
        photos: Sequence[tuple[Rays, Prior]],
        top: int,
        report: StepProgress = silent,
    ) -> tuple[list[Poses], BoolArray]:
        """Return the best common places of photos; see `SearchMethod.search_together`.

        A place lies within the narrowings of all photos that agree. Each photo is first matched by
        itself: its least cost shows whether it was taken there. Raises as `search`, and
        `InputError` without a scene.
        """
        scene = self._needed_scene()
        photos = _with_one_place_prior(photos)
        whole = self.effort.whole
        found = [self.found(rays, prior, report) for rays, prior in photos]
        refinements = [
            Refinement(rays, scene, whole, prior, report=report) for rays, prior in photos
        ]
        together = self._retriever.shortlist_together(photos, whole.particles, report)
        joint, agreeing = JointRefinement(refinements).run(together, [one.best for one in found])
        cost = joint[0].cost
        for poses, (_, prior), agrees in zip(joint, photos, agreeing, strict=True):
            cost = np.where(prior.allows(poses) | ~agrees, cost, np.inf)
        places = replace(joint[0], cost=cost)
        chosen = places.suppress_non_maxima(top, _SEPARATION_M)
        agrees = np.asarray(agreeing[:, chosen[:1]].any(axis=1))
        # Margins are means over the photos, and so are these odds.
        cost_of_one = cost / max(agrees.sum(), 1)
        figures = [
            confidence.refined_figures(replace(poses, cost=cost_of_one), alone.retrieved, rays)
            for poses, (rays, _), alone, belongs in zip(joint, photos, found, agrees, strict=True)
            if belongs and len(alone.retrieved)
        ]
        sure = self._joint_probabilities(places, figures)
        return [_with_confidence(poses, sure)[chosen] for poses in joint], agrees

    def _joint_probabilities(
        self, places: Poses, figures: Sequence[Mapping[str, Float64Array]]
    ) -> tuple[Float64Array, Float64Array]:
        """Return the probabilities that photos' common places are right.

        ``figures`` has the figures of each photo that agrees; the results are as in
        `skyline.match.confidence.shared_probabilities`.
        """
        if not figures:
            none = np.zeros(len(places))
            return none, none
        # Photos of one place share the errors of the terrain model there, to an unknown degree:
        # together they count as one photo with the mean figures.
        mean = {name: np.mean([one[name] for one in figures], axis=0) for name in figures[0]}
        return confidence.shared_probabilities(self.models, places, mean)

    def _needed_scene(self, area: int = 0) -> RenderedScene:
        """Return the scene of an area; raises `InputError` without one."""
        scene = self._areas[area].scene
        if scene is None:
            raise InputError(BY_RENDERING)
        return scene

    def _about_likely_places(self, rays: Rays, prior: Prior, report: StepProgress) -> list[Poses]:
        """Return the poses retrieved around the photo's noted place, and around photo spots.

        Raises `NoPlaceError` if no place that is searched is near a spot.
        """
        near_noted, near_spots = prior.near_noted(), prior.near_spots()
        found = []
        if near_noted is not None:
            found.append(self._retrieved_in(near_noted, rays, report))
        if near_spots is not None:
            # Few places are near a spot: a first short list is made from many of them.
            count = self.effort.nearby_shortlist
            found.append(next(self._retriever.shortlists(rays, count, near_spots, report)))
        return [poses for poses in found if poses is not None]

    def _retrieved_in(
        self, surroundings: Prior, rays: Rays, report: StepProgress = silent
    ) -> Poses | None:
        """Return the poses retrieved from surroundings.

        Returns None if no place of the store lies in them.
        """
        try:
            return self._retriever.shortlist(
                rays, self.effort.nearby_shortlist, surroundings, report
            )
        except NoPlaceError:
            return None


def _with_confidence(poses: Poses, sure: tuple[Float64Array, Float64Array]) -> Poses:
    """Return poses with confidences (M,) within 200 m and within 1 km."""
    near, roughly = sure
    return replace(poses, confidence=near, confidence_1km=roughly)


def _with_likely(found: Poses, likely: Sequence[Poses]) -> Poses:
    """Return retrieved poses with those around likely places.

    The costs of those around a likely place are shifted until their best equals the best of the
    others, and refinement decides.
    """
    if not len(found):
        return found
    shifted = [
        replace(near, cost=near.cost - near.cost.min() + found.cost.min())
        for near in likely
        if len(near)
    ]
    return Poses.concatenate([found, *shifted])


def _with_one_place_prior(
    photos: Sequence[tuple[Rays, Prior]],
) -> list[tuple[Rays, Prior]]:
    """Return photos of one place with the most precise noted place, and the first spots, alone.

    Positions that one phone notes share their error, and one place is near a spot once, so they do
    not count as independent.
    """
    positions = [prior.position for _, prior in photos if prior.position is not None]
    best = min(positions, key=lambda position: position.scale_m, default=None)
    return [
        (
            rays,
            replace(
                prior,
                position=prior.position if prior.position is best else None,
                spots=None if number else prior.spots,
            ),
        )
        for number, (rays, prior) in enumerate(photos)
    ]
