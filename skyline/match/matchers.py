"""The base class of matchers, the settings of a match, and the matchers by name."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pkgutil import resolve_name
from types import MappingProxyType
from typing import ClassVar, Self, cast

from skyline.errors import InputError, named
from skyline.match.candidate import Hypotheses, Ranking
from skyline.match.prior import Prior
from skyline.match.query_rays import QueryRays
from skyline.match.scene import RenderedScene
from skyline.match.screening import Alike
from skyline.store import Store
from skyline.store.format import RENDERINGS
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

FULL = "full"

MATCHERS: Mapping[str, str] = MappingProxyType(
    {
        FULL: "skyline.match.full:FullMatcher",
        "paper": "skyline.paper.matcher:PaperMatcher",
        "correlation": "skyline.match.correlation:CorrelationMatcher",
    }
)
"""The module and the class of each matcher: Skyline's own, the paper's, a baseline. A class is
imported when it is first used, so that a matcher may lie in a layer above this one."""


@dataclass(frozen=True, slots=True)
class MatchConfig:
    """Settings of a match.

    Attributes
    ----------
    refine : bool
        Whether the full matcher refines the retrieved poses by rendering.
    min_confidence : float
        Least probability, 0 to 1, that the best place is right within 1 km for it to be the answer.
        The answer is given within 200 m instead if the probability of an error above 200 m is at
        most half of what is allowed for 1 km: with the default, if it is right with a probability
        of 0.9. All 38 answers to the queries of the terrain that was held out from learning were
        right; docs/accuracy.md says how hard those are.
    fov_slack : float
        Standard deviation of a given field of view, as a share of it, 0 to 1.

    Raises
    ------
    InputError
        A value is out of its range.
    """

    refine: bool = True
    min_confidence: float = 0.8
    fov_slack: float = 0.025

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_confidence <= 1.0:
            raise InputError(
                f"least confidence is {self.min_confidence}; expected 0 (always answer) to 1"
            )
        if not 0.0 <= self.fov_slack < 1.0:
            raise InputError(f"slack of the field of view is {self.fov_slack}; expected 0 to 1")


class Ranker(ABC):
    """Base class of matchers: opened on a store, it ranks poses for queries.

    A new matcher is one subclass in a file of its own, and one line in `MATCHERS`. A matcher of
    renderings is best a `skyline.match.profiles.ProfileRanker`.
    """

    searches: ClassVar[str] = RENDERINGS
    """Kind of store that the matcher searches, `PLACES` or `RENDERINGS` of
    `skyline.store.format`. A matcher of places can narrow its search and find an unknown field of
    view; a matcher of renderings is called without prior knowledge."""

    @classmethod
    @abstractmethod
    def open(cls, store: Store, terrain: HeightField | None, scene: RenderedScene | None) -> Self:
        """Return a matcher of an open store that is not empty, with all that its queries share.

        ``terrain`` and ``scene`` are those of the store, for a matcher of places; None where the
        DEM cannot be read, and without refinement there is no scene.
        """

    @abstractmethod
    def eyes(self) -> Viewpoints:
        """Return the eyes of the store, or an even selection of very many."""

    @abstractmethod
    def rank(self, query: QueryRays, top: int, prior: Prior, screened: Alike | None) -> Ranking:
        """Return up to ``top`` poses, best first, at most one a location.

        Locations where nothing fits are left out, so there may be none. Headings are grid azimuths.
        A ranking without confidences always counts as an answer.

        Parameters
        ----------
        query : QueryRays
        top : int
        prior : Prior
        screened : Alike or None
            The results of `screened` for all parts of the store, joined; None to screen here.
        """

    def rank_together(
        self, queries: Sequence[tuple[QueryRays, Prior]], top: int
    ) -> Sequence[Ranking]:
        """Return up to ``top`` places of queries of one eye, as each query's poses there.

        A query that was likely taken at another place has no poses. A place lies within the
        narrowings of all queries that agree. Raises `InputError` if the matcher does not render.
        """
        raise InputError(
            "photos are matched together by rendering alone; use the full matcher, refine, and "
            "give the DEM"
        )

    def fit_from(self, query: QueryRays, start: Hypotheses) -> Ranking:
        """Return one pose, refined by rendering; an empty ranking where nothing fits.

        The eye keeps its height above the ground. The confidence is that of a search in which
        nothing else fits. Raises `InputError` if the matcher does not render.
        """
        raise InputError("this matcher does not render; a fit needs the full one and the DEM")

    def screened(self, query: QueryRays, prior: Prior, part: slice) -> Alike | None:
        """Return the best places of a part of the store; None if this matcher does not screen."""
        return None


def matcher_class(name: str) -> type[Ranker]:
    """Return the class of a matcher; raises `InputError` for an unknown name."""
    return cast(type[Ranker], resolve_name(named("matcher", name, MATCHERS)))
