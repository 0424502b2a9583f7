"""The full matcher, of one query or of several of one eye.

Retrieval among places comes first, then refinement by rendering, then a confidence.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache

import numpy as np
from threadpoolctl import ThreadpoolController

from skyline.errors import InputError
from skyline.geodesy import Frame
from skyline.match import confidence, projections
from skyline.match.prior import Narrowing, Prior
from skyline.match.projections import OtherProjection
from skyline.match.rays import Rays
from skyline.match.refine import QUICK, WHOLE, JointRefinement, Refinement
from skyline.match.retrieval import Retriever
from skyline.pose import (
    Pose,
    Poses,
    RefinedPoses,
    candidates_of,
    hypothesis_of,
)
from skyline.render.horizon import RenderedScene
from skyline.store.read import PlaceSource
from skyline.terrain.eyes import LEAST_EYE_HEIGHT_M, Viewpoints
from skyline.terrain.heightfield import HeightField, ground_of

_SHORTLIST_SHARE, _SHORTLIST_LEAST, _SHORTLIST_MOST = 1 / 1500, 400, WHOLE.shortlist
"""Poses that retrieval returns for each place of the store, and their least and greatest number:
the more places there are, the more are alike."""
_SEPARATION_M = 100.0
"""Least distance between candidates."""
_SURE_MARGIN = 75.0
"""A quick refinement is enough where its best pose leads all other answers by this margin."""
_SHOWN_EYES = 20_000
BY_RENDERING = (
    "photos are matched together, and poses fitted, by rendering alone; use the full matcher, "
    "refine, and give the DEM"
)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit matrix products to one thread each within the block.

    If a BLAS library splits small products among threads, each thread waits for the slowest a
    thousand times a second, and a busy machine becomes several times slower. Matching shares its
    work by blocks of places instead. One thread also gives the same bits in every process.
    """
    with _blas().limit(limits=1, user_api="blas"):
        yield


_blas = cache(ThreadpoolController)
"""The libraries' controls, which take milliseconds to find."""


class FullMatcher:
    """Retrieval, refinement and confidence; without a scene, poses stay as retrieved.

    ``terrain`` is that of the store's places; None where the DEM cannot be read.
    """

    def __init__(
        self,
        places: PlaceSource,
        frame: Frame,
        terrain: HeightField | None,
        scene: RenderedScene | None,
    ) -> None:
        ground = None if terrain is None else ground_of(terrain)
        self.frame, self._scene = frame, scene
        self.retriever = Retriever(places, ground)
        self.models = confidence.models()
        share = round(_SHORTLIST_SHARE * len(places))
        self._shortlist = min(max(share, _SHORTLIST_LEAST), _SHORTLIST_MOST)

    def eyes(self) -> Viewpoints:
        """Return the eyes of the places; of very many, every n-th."""
        some = self.retriever.sample(_SHOWN_EYES)
        eyes = (some.easting_m, some.northing_m, some.eye_elevation_m)
        east_m, north_m, eye_m = (column.astype(np.float64) for column in eyes)
        return Viewpoints(easting_m=east_m, northing_m=north_m, eye_elevation_m=eye_m)

    def rank(self, query: Rays, top: int, prior: Prior) -> tuple[Pose, ...]:
        """Return up to ``top`` candidates, best first, none where nothing fits.

        Raises `InputError` where the search is narrowed to no place.
        """
        found, poses = self.found(query, prior)
        if not len(found) or (poses is not None and not len(poses)):
            return ()
        if poses is None:
            figures = confidence.retrieved_figures(found, query)
            chosen = found.suppress_non_maxima(top, _SEPARATION_M)
            near, roughly = confidence.probabilities(self.models, "retrieved", figures)
            return candidates_of(self.frame, found[chosen], near[chosen], roughly[chosen])
        figures = confidence.refined_figures(poses, found, query)
        # A pose that has moved out of the narrowing is no candidate.
        allowed = replace(poses, score=np.where(prior.allows(poses), poses.score, np.inf))
        chosen = allowed.suppress_non_maxima(top, _SEPARATION_M)
        if not len(chosen):
            return ()
        near, roughly = confidence.shared_probabilities(self.models, allowed, figures)
        return candidates_of(self.frame, poses[chosen], near[chosen], roughly[chosen])

    @one_blas_thread()
    def found(self, query: Rays, prior: Prior) -> tuple[Poses, RefinedPoses | None]:
        """Return the poses retrieved for a query, and the refined ones; None without a scene.

        A quick refinement comes first, and is enough where one place fits far better than any
        other, as with most skylines. Otherwise the poses are refined with more effort. Raises as
        `rank`.
        """
        found = self.retriever.shortlist(query, self._shortlist, prior)
        if not len(found) or self._scene is None:
            return found, None
        start = self._with_noted(found, query, prior)
        poses = Refinement(query, self._scene, QUICK, prior).run(start)
        if not len(poses) or poses.margin[0] <= _SURE_MARGIN:
            poses = Refinement(query, self._scene, WHOLE, prior).run(start)
        return found, poses

    @one_blas_thread()
    def other_projection(self, query: Rays, best: Pose, prior: Prior) -> OtherProjection | None:
        """Return the likeliest other projection of a photo, as its best candidate shows it.

        None for a panorama, and for a candidate that is not refined or more likely wrong.
        """
        scene = self._scene
        sure = best.confidence_1km or 0.0
        if scene is None or not best.refined or sure < projections.LEAST_CONFIDENCE:
            return None
        return projections.other_projection(
            query, hypothesis_of(best), lambda rays: Refinement(rays, scene, QUICK, prior)
        )

    @one_blas_thread()
    def fitted(self, query: Rays, start: Pose, prior: Prior, about_start: Rays) -> Pose | None:
        """Return a pose refined by rendering; None where nothing near it fits.

        A start farther off is fitted with ``about_start``, the query's rays about the start's field
        of view, while the eye keeps its height above the ground, if a camera can be held so low.
        The pose is then fitted as in a search, so its score compares with those of a search with
        the same query and prior. The confidence is that of `confidence.FITTED`. Raises `InputError`
        without a scene, and for a pose off the map or on a hole.
        """
        scene, pose = self._needed_scene(), hypothesis_of(start)
        off_m = pose.eye_elevation_m - scene.ground_m(pose.easting_m, pose.northing_m)
        if not np.isfinite(off_m).all():
            raise InputError("the pose to fit from is off the map or on a hole; move it")
        above_m, effort = max(LEAST_EYE_HEIGHT_M, float(off_m[0])), replace(WHOLE, restarts=1)
        held = Prior(Narrowing(eye_height_m=above_m))
        poses = Refinement(about_start, scene, effort, held).run(pose)
        poses = Refinement(query, scene, effort, prior, first_eye_height_m=above_m).run(poses[:1])
        if not len(poses):
            return None
        poses = poses[:1]
        figures = confidence.pose_figures(poses, query)
        near, roughly = confidence.probabilities(self.models, confidence.FITTED, figures)
        return candidates_of(self.frame, poses, near, roughly)[0]

    @one_blas_thread()
    def rank_together(
        self, queries: Sequence[tuple[Rays, Prior]], top: int
    ) -> list[tuple[Pose, ...]]:
        """Return up to ``top`` places of queries of one eye, as each query's candidates there.

        A query that was likely taken at another place has none. A place lies within the narrowings
        of all queries that agree. Raises as `rank`, and `InputError` without a scene.

        Each query is first matched by itself: its least cost shows whether it was taken there.
        """
        scene = self._needed_scene()
        queries = _with_one_noted_place(queries)
        found = [self.found(query, prior) for query, prior in queries]
        alone = [places[:0] if poses is None else poses[:1] for places, poses in found]
        refinements = [Refinement(query, scene, WHOLE, prior) for query, prior in queries]
        places = self.retriever.shortlist_together(queries, WHOLE.particles)
        joint, agreeing = JointRefinement(refinements).run(places, alone)
        cost = joint[0].score
        for poses, (_, prior), agrees in zip(joint, queries, agreeing, strict=True):
            cost = np.where(prior.allows(poses) | ~agrees, cost, np.inf)
        standing = replace(joint[0], score=cost)
        chosen = standing.suppress_non_maxima(top, _SEPARATION_M)
        agrees = np.asarray(agreeing[:, chosen[:1]].any(axis=1))
        # As margins, odds are those of one query in the mean.
        cost_of_one = cost / max(agrees.sum(), 1)
        figures = [
            confidence.refined_figures(replace(poses, score=cost_of_one), retrieved, query)
            for poses, (query, _), (retrieved, _), belongs in zip(
                joint, queries, found, agrees, strict=True
            )
            if belongs and len(retrieved)
        ]
        near = roughly = np.zeros(len(cost))
        if figures:
            # Queries of one place share the errors of the terrain model there, to an unknown
            # degree: together they count as one query with the mean figures.
            mean = {name: np.mean([one[name] for one in figures], axis=0) for name in figures[0]}
            near, roughly = confidence.shared_probabilities(self.models, standing, mean)
        return [
            candidates_of(self.frame, poses[chosen], near[chosen], roughly[chosen])
            if belongs
            else ()
            for poses, belongs in zip(joint, agrees.tolist(), strict=True)
        ]

    def _needed_scene(self) -> RenderedScene:
        """Return the scene; raises `InputError` without one."""
        if self._scene is None:
            raise InputError(BY_RENDERING)
        return self._scene

    def _with_noted(self, found: Poses, query: Rays, prior: Prior) -> Poses:
        """Return retrieved poses with those around the place that the photo's EXIF notes.

        The best of these gets the score of the best pose of all; refinement then compares them.
        """
        near_noted = prior.near_noted()
        if near_noted is None:
            return found
        try:
            near = self.retriever.shortlist(query, _SHORTLIST_LEAST // 4, near_noted)
        except InputError:  # No place of the store lies there.
            return found
        if not len(near):
            return found
        raised = near.score - near.score.min() + found.score.min()
        return Poses.concatenate([found, replace(near, score=raised)])


def _with_one_noted_place(
    queries: Sequence[tuple[Rays, Prior]],
) -> list[tuple[Rays, Prior]]:
    """Return queries with the most precise noted place alone.

    The positions of photos from one phone share their error, so they are not independent.
    """
    noted = [prior.noted for _, prior in queries if prior.noted is not None]
    best = min(noted, key=lambda place: place.sd_m, default=None)
    return [
        (query, prior if prior.noted is best else replace(prior, noted=None))
        for query, prior in queries
    ]
