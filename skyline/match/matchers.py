"""The interface of matchers, the settings of a match, and the matchers by name."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pkgutil import resolve_name
from types import MappingProxyType
from typing import ClassVar, Self, cast

from skyline.errors import InputError, named
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.profiles import Fits, Profiles
from skyline.match.query_rays import Attitudes, QueryRays
from skyline.match.ranking import Hypotheses, Ranking
from skyline.match.scene import OpenedStore
from skyline.match.screening import Alike
from skyline.store.format import RENDERINGS

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

MIN_VISIBLE_DEG = 14.0
"""Least width of a skyline for an answer. Screening compares rises over 2 degrees, and a pose has
seven unknowns: below 14 degrees there are fewer rises than unknowns."""


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
        of 0.9. Of answers to queries as hard as those that the confidence was learned from, on
        other terrain, 93 % are right; of easier queries more.
    fov_slack : float
        Standard deviation of a given field of view, as a share of it, 0 to 1.
    fov_range_deg : (float, float)
        Range of fields of view that the full matcher searches where none is given.
    usual_fov_deg : (float, float)
        Mean and standard deviation of those fields of view: most photos are taken with a phone or
        a usual zoom lens.

    Raises
    ------
    InputError
        A value is out of its range.
    """

    refine: bool = True
    min_confidence: float = 0.8
    fov_slack: float = 0.025
    fov_range_deg: tuple[float, float] = (25.0, 100.0)
    usual_fov_deg: tuple[float, float] = (55.0, 14.0)

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_confidence <= 1.0:
            raise InputError(
                f"least confidence is {self.min_confidence}; expected 0 (always answer) to 1"
            )
        if not 0.0 <= self.fov_slack < 1.0:
            raise InputError(f"slack of the field of view is {self.fov_slack}; expected 0 to 1")
        low, high = self.fov_range_deg
        if not 0.0 < low < high < 180.0:
            raise InputError(
                f"fields of view to search are {low:g} to {high:g} degrees; expected two that "
                "increase, within 0 to 180"
            )
        mean, deviation = self.usual_fov_deg
        if not (low <= mean <= high and deviation > 0.0):
            raise InputError(
                f"the usual field of view is {mean:g} degrees with a deviation of {deviation:g}; "
                f"expected one within {low:g} to {high:g} and a deviation above 0"
            )


class Ranker(ABC):
    """Base class of matchers: opened on a store, it ranks poses for queries.

    A new matcher is one subclass in a file of its own, and one line in `MATCHERS`.
    """

    narrows: ClassVar[bool] = False
    """True if the matcher uses prior knowledge of a pose; if not, it is called without any."""
    finds_fov: ClassVar[bool] = False
    """True if the matcher can match a photo of unknown field of view."""
    searches: ClassVar[str] = RENDERINGS
    """Kind of store that the matcher searches, `PLACES` or `RENDERINGS` of
    `skyline.store.format`."""

    @classmethod
    @abstractmethod
    def open(cls, store: OpenedStore) -> Self:
        """Return a matcher of an opened store, with all that its queries share."""

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
            `NOTHING_KNOWN` for matchers that cannot narrow a search.
        screened : Alike or None
            The results of `screened` for all parts of the store, joined; None to screen here.
        """

    def rank_together(
        self, queries: Sequence[tuple[QueryRays, Prior]], top: int
    ) -> Sequence[Ranking] | None:
        """Return up to ``top`` places of queries of one eye, as each query's poses there.

        A query that was likely taken somewhere else has no poses. A place lies within the
        narrowings of all queries that agree. None if this matcher cannot match jointly.
        """
        return None

    def fit_from(self, query: QueryRays, start: Hypotheses) -> Ranking | None:
        """Return one pose, refined by rendering; an empty ranking where nothing fits.

        The eye keeps its height above the ground. The confidence is that of a search in which
        nothing else fits. None if this matcher cannot render.
        """
        return None

    def screened(self, query: QueryRays, prior: Prior, part: slice) -> Alike | None:
        """Return the best places of a part of the store; None if this matcher does not screen."""
        return None

    def release(self) -> None:  # noqa: B027  (most matchers hold nothing)
        """Free the matcher's GPU memory, if it holds any."""


class ProfileRanker(Ranker):
    """Base class of matchers of renderings, which fit one pose at every location."""

    def __init__(self, profiles: Profiles, attitudes: Attitudes | None = None) -> None:
        """``attitudes`` are the assumed pitches and rolls; pitches of -10 to 10 by default."""
        self.profiles, self.attitudes = profiles, attitudes or Attitudes()

    @classmethod
    def open(cls, store: OpenedStore) -> Self:
        """See `Ranker.open`."""
        return cls(store.profiles())

    def rank(
        self,
        query: QueryRays,
        top: int,
        prior: Prior = NOTHING_KNOWN,
        screened: Alike | None = None,
    ) -> Ranking:
        """See `Ranker.rank`."""
        return self.profiles.ranked(self.fit(query), query.fov_deg, top)

    @abstractmethod
    def fit(self, query: QueryRays) -> Fits:
        """Return the best pose at each location of `profiles`; lower scores are better.

        `skyline.match.query_rays.QueryCurves` levels the query at the assumed attitudes and puts it
        on the profiles' bins. The score is infinite at a location where nothing fits.
        """


def matcher_class(name: str) -> type[Ranker]:
    """Return the class of a matcher; raises `InputError` for an unknown name."""
    return cast(type[Ranker], resolve_name(named("matcher", name, MATCHERS)))
