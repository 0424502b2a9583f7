"""Our matcher: retrieve among places, refine by rendering, say how sure the answer is."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.match import confidence
from skyline.match.claim import Claim
from skyline.match.confidence import DISTANCES_M, model_name
from skyline.match.hypotheses import Hypotheses
from skyline.match.match_config import FullConfig, RefineConfig
from skyline.match.narrowing import Narrowed
from skyline.match.pose import Poses, Refinement, Scene, refine
from skyline.match.query_rays import QueryRays
from skyline.match.ranker import Ranker, Source
from skyline.match.ranking import JointRanking, Ranking
from skyline.match.retrieval import Retriever
from skyline.match.screening import Alike
from skyline.match.threads import one_blas_thread
from skyline.match.together import JointRefinement
from skyline.store.format import PLACES


class FullMatcher(Ranker):
    """Retrieval, refinement and confidence in one.

    The scene is the terrain the store was rendered from; without it poses stay as retrieved.
    """

    narrows = True
    finds_fov = True
    searches = PLACES

    def __init__(
        self, retriever: Retriever, scene: Scene | None = None, config: FullConfig | None = None
    ) -> None:
        self._retriever = retriever
        self._scene = scene
        self._config = config or FullConfig()
        self._models = confidence.models()

    @classmethod
    def open(cls, source: Source) -> Self:
        """See `Ranker.open`."""
        places, config = source.places(), source.config
        retriever = Retriever(places, source.ground(), config.retrieval, source.edge())
        return cls(retriever, source.scene(), config.full)

    def rank(
        self,
        query: QueryRays,
        top: int,
        narrowed: Narrowed | None = None,
        screened: Alike | None = None,
    ) -> Ranking:
        """See `Ranker.rank`.

        Raises `InputError` for a ``top`` below 1, and where the search is narrowed to no place.
        """
        if top < 1:
            raise InputError(f"top is {top}; expected at least 1 candidate")
        found, poses = self._found(query, narrowed, screened)
        if not len(found):
            return Ranking(found)
        if poses is None:
            figures = confidence.retrieved_figures(found, query)
            chosen = self._chosen(found, top)
            near, roughly = self._sure("retrieved", figures, chosen)
            return Ranking(found[chosen], near, confidence_1km=roughly)
        figures = confidence.refined_figures(poses, found, query)
        if narrowed is not None:
            # What has moved out of the narrowing fits nowhere.
            score = np.where(narrowed.holds(poses.hypotheses), poses.hypotheses.score, np.inf)
            poses = replace(poses, hypotheses=replace(poses.hypotheses, score=score))
        chosen = self._chosen(poses.hypotheses, top)
        near, roughly = self._sure("refined", figures, chosen)
        return _ranking(poses, chosen, near, roughly)

    def _found(
        self,
        query: QueryRays,
        narrowed: Narrowed | None,
        screened: Alike | None = None,
    ) -> tuple[Hypotheses, Poses | None]:
        """Return the poses retrieved for a query, and those refined where there is a scene."""
        found = self.retrieve(query, narrowed, screened)
        if not len(found):
            return found, None
        return found, self.refine(self._with_claimed(found, query, narrowed), query, narrowed)

    def rank_together(
        self, asked: Sequence[tuple[QueryRays, Narrowed | None]], top: int
    ) -> JointRanking | None:
        """See `Ranker.rank_together`; raises as `rank`.

        Each query is looked for by itself first: what it costs where it fits best says whether it
        belongs to the others.
        """
        if self._scene is None:
            return None
        asked = _with_one_claim(asked)
        found = [self._found(query, known) for query, known in asked]
        own = [places[:0] if poses is None else poses.hypotheses[:1] for places, poses in found]
        config = self._config.refine
        refinements = [
            Refinement(query, self._scene, _of_known_height(config, known), _claim(known))
            for query, known in asked
        ]
        with one_blas_thread():
            places = self._retriever.shortlist_together(asked, config.particles)
            joint, agreeing = JointRefinement(refinements, config).run(places, own)
        cost = joint[0].hypotheses.score
        for poses, (_, known), agrees in zip(joint, asked, agreeing, strict=True):
            if known is not None:
                cost = np.where(known.holds(poses.hypotheses) | ~agrees, cost, np.inf)
        chosen = self._chosen(replace(joint[0].hypotheses, score=cost), top)
        agrees = np.asarray(agreeing[:, chosen[:1]].any(axis=1))
        figures = [
            confidence.refined_figures(poses, retrieved, query)
            for poses, (query, _), (retrieved, _), is_of in zip(
                joint, asked, found, agrees, strict=True
            )
            if is_of and len(retrieved)
        ]
        near = roughly = np.zeros(len(chosen))
        if figures:
            near, roughly = self._sure("refined", confidence.mean_figures(figures), chosen)
        rankings = tuple(_ranking(poses, chosen, near, roughly) for poses in joint)
        return JointRanking(rankings, agrees)

    def screened(self, query: QueryRays, narrowed: Narrowed | None, part: slice) -> Alike:
        """Return the places most like a query; see `Retriever.screened`."""
        with one_blas_thread():
            return self._retriever.screened(query, narrowed, part)

    def retrieve(
        self,
        query: QueryRays,
        narrowed: Narrowed | None = None,
        screened: Alike | None = None,
    ) -> Hypotheses:
        """Return the poses retrieved for a query."""
        with one_blas_thread():
            return self._retriever.shortlist(query, self._config.shortlist, narrowed, screened)

    def refine(
        self,
        found: Hypotheses,
        query: QueryRays,
        narrowed: Narrowed | None = None,
    ) -> Poses | None:
        """Return retrieved poses refined, as far as it takes; None without a scene.

        Most skylines fit one place far better than any other, and those show it at once.
        """
        if self._scene is None:
            return None
        quick, claim = _of_known_height(self._config.quick, narrowed), _claim(narrowed)
        with one_blas_thread():
            poses = refine(found, query, self._scene, quick, claim)
            if len(poses) and poses.margin[0] > self._config.sure_margin:
                return poses
            spent = poses.renderings
            whole = _of_known_height(self._config.refine, narrowed)
            poses = refine(found, query, self._scene, whole, claim)
        return replace(poses, renderings=spent + poses.renderings)

    def fit_from(self, query: QueryRays, start: Hypotheses) -> Ranking | None:
        """See `Ranker.fit_from`."""
        if self._scene is None:
            return None
        ground_m = self._scene.ground_m(start.easting_m, start.northing_m)
        above_m = np.maximum(start.eye_elevation_m - ground_m, 0.0)
        if not np.isfinite(above_m).all():
            raise InputError("the pose to fit from is off the map or on a hole; move it")
        config = _held_at(replace(self._config.refine, restarts=1), float(above_m[0]))
        with one_blas_thread():
            poses = refine(start, query, self._scene, config)
        if not len(poses):
            return Ranking(poses.hypotheses)
        models = [self._models[model_name("refined", within_m)] for within_m in DISTANCES_M]
        near, roughly = (
            model.probability(confidence.lone_figures(poses, query, model))[:1] for model in models
        )
        return _ranking(poses, slice(1), near, np.maximum(near, roughly))

    def _with_claimed(
        self, found: Hypotheses, query: QueryRays, narrowed: Narrowed | None
    ) -> Hypotheses:
        """Return what was found with what lies where the photo says that it was taken.

        There the best counts as much as the best of all: which is better, refinement says.
        """
        there = None if narrowed is None else narrowed.about_the_claim()
        if there is None:
            return found
        with one_blas_thread():
            alike = self._retriever.screened(query, there)
            if not len(alike):
                return found
            near = self._retriever.shortlist(query, self._config.shortlist // 4, there, alike)
        if not len(near):
            return found
        raised = near.score - near.score.min() + found.score.min()
        return Hypotheses.concatenate([found, replace(near, score=raised)])

    def _sure(
        self, stage: str, figures: dict[str, Float64Array], chosen: NDArray[np.intp]
    ) -> tuple[Float64Array, Float64Array]:
        """Return how likely chosen poses are right within 200 m and within 1 km."""
        near, roughly = (
            self._models[model_name(stage, within_m)].probability(figures)[chosen]
            for within_m in DISTANCES_M
        )
        return near, np.maximum(near, roughly)

    def _chosen(self, poses: Hypotheses, top: int) -> NDArray[np.intp]:
        return poses.suppress_non_maxima(top, self._config.separation_m)


def _ranking(
    poses: Poses,
    chosen: slice | NDArray[np.intp],
    near: Float64Array | None = None,
    roughly: Float64Array | None = None,
) -> Ranking:
    """Return those chosen of poses, and how likely they are right within 200 m and within 1 km."""
    return Ranking(
        poses.hypotheses[chosen],
        near,
        poses.covariance_m2[chosen],
        roughly,
        poses.beyond_share[chosen],
        poses.residual_deg[chosen],
        poses.inlier_share[chosen],
    )


def _claim(narrowed: Narrowed | None) -> Claim | None:
    return None if narrowed is None else narrowed.claim


def _with_one_claim(
    asked: Sequence[tuple[QueryRays, Narrowed | None]],
) -> list[tuple[QueryRays, Narrowed | None]]:
    """Return queries of which the best claim alone is left: one phone errs alike in all photos."""
    claims = [known.claim for _, known in asked if known is not None and known.claim is not None]
    best = min(claims, key=lambda claim: claim.sd_m, default=None)
    return [
        (query, known and (known if known.claim is best else replace(known, claim=None)))
        for query, known in asked
    ]


def _of_known_height(config: RefineConfig, narrowed: Narrowed | None) -> RefineConfig:
    """Return a refinement whose eyes stand as high above the ground as the narrowing says."""
    eye_height_m = None if narrowed is None else narrowed.narrowing.eye_height_m
    return config if eye_height_m is None else _held_at(config, eye_height_m)


def _held_at(config: RefineConfig, eye_height_m: float) -> RefineConfig:
    """Return a refinement of eyes at just that height above the ground."""
    return replace(config, eye_height_m=eye_height_m, eye_height_known=True)
