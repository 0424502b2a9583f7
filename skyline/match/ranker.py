"""What a matcher is: it is opened on a store, and ranks the store's places."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Protocol, Self

from skyline.match.hypotheses import Hypotheses
from skyline.match.match_config import MatchConfig
from skyline.match.narrowing import Narrowed
from skyline.match.pose import Scene
from skyline.match.profiles import Profiles
from skyline.match.query_rays import QueryRays
from skyline.match.ranking import Fits, JointRanking, Ranking, select
from skyline.match.screening import Alike
from skyline.store.format import RENDERINGS
from skyline.store.places import PlaceSource
from skyline.terrain.edge import DataEdge
from skyline.terrain.heightfield import Ground


class Source(Protocol):
    """A store and its terrain as matchers take them; nothing is read before it is asked for."""

    @property
    def config(self) -> MatchConfig:
        """How queries are to be matched."""

    def places(self) -> PlaceSource:
        """Return the places of a store of places; raises `InputError` for another or none."""

    def profiles(self) -> Profiles:
        """Return the renderings of a store, joined; raises `InputError` where it has none."""

    def ground(self) -> Ground | None:
        """Return the heights of the terrain, where that is to be had."""

    def edge(self) -> DataEdge | None:
        """Return where the terrain's data end, where that is to be had."""

    def scene(self) -> Scene | None:
        """Return the terrain to render, where that is to be had and rendering is wanted."""


class Ranker(Protocol):
    """Ranks the places of the store it is opened on."""

    narrows: ClassVar[bool] = False
    """Whether it can search a part of the store alone. One that cannot is never asked to."""
    finds_fov: ClassVar[bool] = False
    """Whether it can match a photo whose field of view is not known."""
    searches: ClassVar[str] = RENDERINGS
    """Kind of rows that it searches, `PLACES` or `RENDERINGS` of `skyline.store.format`."""

    @classmethod
    def open(cls, source: Source) -> Self:
        """Prepare for a store; what queries share is done here, once."""

    def rank(
        self,
        query: QueryRays,
        top: int,
        narrowed: Narrowed | None = None,
        screened: Alike | None = None,
    ) -> Ranking:
        """Return up to ``top`` poses, best first, at most one a location.

        Locations nothing fits at are left out, so there may be none. Azimuths, those of a place's
        bins (`skyline.skylines.bin_azimuths_rad`) and those of poses (`Hypotheses`), are from grid
        north. A ranking without confidence always counts as an answer. ``screened`` is what
        `screened` found in all parts of the store, joined.
        """

    def rank_together(
        self, asked: Sequence[tuple[QueryRays, Narrowed | None]], top: int
    ) -> JointRanking | None:
        """Return up to ``top`` places that queries of one eye share; None from who cannot.

        A place lies within the narrowings of all queries that agree on it.
        """
        return None

    def fit_from(self, query: QueryRays, start: Hypotheses) -> Ranking | None:
        """Return the pose that one pose becomes by rendering; None if this matcher cannot render.

        The eye keeps its height above the ground. The ranking is empty where nothing fits. Its
        confidence is what a search would give the pose if nothing else fitted.
        """
        return None

    def screened(self, query: QueryRays, narrowed: Narrowed | None, part: slice) -> Alike | None:
        """Return the places of a part of the store worth ranking; None if all are to be ranked."""
        return None


class ProfileRanker(Ranker):
    """A matcher of renderings, which fits one pose at every location.

    `Profiles.y` (L, B) has the tangents of elevation angles at grid azimuths 360 b / B degrees, NaN
    where nothing is known. `QueryCurves.of` gives a query's likewise, with bin B / 2 straight
    ahead. So a query whose bin i lies over bin i + s of a profile looks along 180 + 360 s / B
    degrees.
    """

    profiles: Profiles

    def __init__(self, profiles: Profiles) -> None:
        self.profiles = profiles

    @classmethod
    def open(cls, source: Source) -> Self:
        """See `Ranker.open`."""
        return cls(source.profiles())

    @abstractmethod
    def fit(self, query: QueryRays) -> Fits:
        """Return the best pose at every location.

        Lower scores are better. A location with an infinite score is left out.
        """

    def rank(
        self,
        query: QueryRays,
        top: int,
        narrowed: Narrowed | None = None,
        screened: Alike | None = None,
    ) -> Ranking:
        """Return the best poses, best first; see `Ranker.rank`."""
        return select(self.profiles, self.fit(query), query.fov_deg, top)
