"""Our matcher followed through a search: after which stage the right place is still there."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skyline.errors import InputError
from skyline.geodesy import Frame
from skyline.matching.full import FullMatcher
from skyline.matching.hypotheses import Hypotheses
from skyline.matching.narrowing import Narrowed
from skyline.matching.pose import Scene
from skyline.matching.query_rays import QueryRays
from skyline.matching.retrieval import Retriever
from skyline.matching.screening import Alike, Screen, sample_of
from skyline.pipeline.refusals import sure_within_m, too_little
from skyline.places import PlaceSource
from skyline.terrain.heightfield import Ground
from skyline_bench.queries.synthetic import SyntheticQuery, Truth
from skyline_bench.trials.trials import MATCHING, errors

STAGES = ("screened", "fitted", "retrieved", "refined")
"""Places most alike; of these, those whose pose was fitted well; the short list; candidates."""
_TURN_DEG = 10.0
_TOP = 5


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one query in one search."""

    error_m: float | None = None  # Of the best candidate; None without any
    confidence: float | None = None  # Its own
    # How near the matcher says that it is; None where it does not stand by it.
    answered_within_m: float | None = None
    # By the clock, and processor time of all threads.
    seconds: float = 0.0
    cpu_s: float = 0.0
    # Whether a pose within one spacing of the truth, looking within 10 degrees of the right way,
    # was there after each of the `STAGES`.
    screened: bool = False
    fitted: bool = False
    retrieved: bool = False
    refined: bool = False


class Traced:
    """The full matcher on places, whose stages can be looked at."""

    def __init__(self, places: PlaceSource, ground: Ground, scene: Scene, frame: Frame) -> None:
        self._frame = frame
        self._retriever = _Noting(places, ground, MATCHING.retrieval, scene.edge)
        self._matcher = FullMatcher(self._retriever, scene, MATCHING.full)
        self.spacing_m = 2.0 * float(np.median(sample_of(places).tolerance_m))
        """Between places."""

    def match(self, query: SyntheticQuery, narrowed: Narrowed | None = None) -> Outcome:
        """Match a query, and say how far it came."""
        if too_little(query.skyline, MATCHING):
            return Outcome()
        rays, noted = query.rays(), self._retriever
        noted.aim = noted.alike = noted.fitted = noted.retrieved = None
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            candidates = self._matcher.rank(rays, _TOP, narrowed).candidates(self._frame)
        except InputError:  # There is no place where the search is narrowed to.
            candidates = ()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        best = candidates[0] if candidates else None
        return Outcome(
            None if best is None else errors(best, query.truth)[0],
            None if best is None else best.confidence,
            None if best is None else sure_within_m(best, MATCHING),
            wall,
            cpu,
            self._screened(noted, query.truth),
            self._held(noted.fitted, query.truth),
            self._held(noted.retrieved, query.truth),
            self._is_there(
                [one.easting_m for one in candidates],
                [one.northing_m for one in candidates],
                [one.grid_heading_deg for one in candidates],
                query.truth,
            ),
        )

    def _screened(self, noted: "_Noting", truth: Truth) -> bool:
        if noted.alike is None or noted.aim is None:
            return False
        places = noted.places.take(noted.alike.row)
        near = places[truth.off_m(places.easting_m, places.northing_m) <= self.spacing_m]
        heading_deg, _ = noted.aim.best_turns(near.phase)
        return self._is_there(near.easting_m, near.northing_m, heading_deg, truth)

    def _held(self, poses: Hypotheses | None, truth: Truth) -> bool:
        return poses is not None and self._is_there(
            poses.easting_m, poses.northing_m, poses.heading_deg, truth
        )

    def _is_there(
        self, easting_m: ArrayLike, northing_m: ArrayLike, heading_deg: ArrayLike, truth: Truth
    ) -> bool:
        """Whether one of some poses (N,) is within one spacing and looks the right way."""
        turn = (np.asarray(heading_deg) - truth.heading_deg + 180.0) % 360.0 - 180.0
        near = truth.off_m(easting_m, northing_m) <= self.spacing_m
        return bool((near & (np.abs(turn) <= _TURN_DEG)).any())


class _Noting(Retriever):
    """A retriever that notes what its last search came to after each stage."""

    aim: Screen | None = None
    alike: Alike | None = None
    fitted: Hypotheses | None = None
    retrieved: Hypotheses | None = None

    def shortlist(
        self,
        query: QueryRays,
        count: int,
        narrowed: Narrowed | None = None,
        screened: Alike | None = None,
    ) -> Hypotheses:
        self.retrieved = super().shortlist(query, count, narrowed, screened)
        return self.retrieved

    def _fitted(self, query: QueryRays, aim: Screen, alike: Alike) -> Hypotheses:
        self.aim, self.alike = aim, alike
        self.fitted = super()._fitted(query, aim, alike)
        return self.fitted
