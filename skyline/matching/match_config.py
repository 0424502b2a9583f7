"""How queries are matched."""

from dataclasses import dataclass, field

from skyline.errors import InputError
from skyline.matching.refine_config import RefineConfig
from skyline.matching.retrieval import RetrievalConfig

_QUICK = RefineConfig(
    shortlist=64,
    particles=16,
    rounds=4,
    keep_share=0.6,
    keep_least=6,
    restarts=1,
    finalists=6,
    final_rounds=3,
)


@dataclass(frozen=True, slots=True)
class FullConfig:
    """How a query is matched.

    Attributes
    ----------
    shortlist : int
        Poses retrieved.
    separation_m : float
        Candidates are at least this far apart.
    quick : RefineConfig
        How the best of them are refined first.
    sure_margin : float
        Where the quick refinement's best pose is this much likelier than any elsewhere (natural
        logarithm), it stands. Infinite never lets it.
    refine : RefineConfig
        How they are refined where it does not.
    """

    shortlist: int = 400
    separation_m: float = 100.0
    quick: RefineConfig = field(default_factory=lambda: _QUICK)
    sure_margin: float = 75.0
    refine: RefineConfig = field(default_factory=RefineConfig)

    def __post_init__(self) -> None:
        if self.shortlist < 1 or self.separation_m < 0.0:
            raise InputError(
                f"{self.shortlist} retrieved poses and candidates {self.separation_m:g} m apart; "
                "expected at least 1 and 0"
            )


@dataclass(frozen=True, slots=True)
class MatchConfig:
    """How queries are matched; what is not said to be of the full matcher is of all.

    Attributes
    ----------
    refine : bool
        Whether the full matcher renders around what it has retrieved.
    min_confidence : float
        A place is the answer that is this likely right within 1 km. It is said to be right within
        200 m where only half of the doubt is left: with the default, where that is 0.9 likely. Of
        answers to queries as hard as confidence was learned from, on terrain that it was not
        learned from, 93 % are right; of easier ones more.
    min_visible_deg : float
        Nor is there where a query shows less of a skyline. Screening compares rises over 2 degrees,
        and a pose has seven unknowns: below 14 degrees there are fewer rises than unknowns. How
        little more than that is worth, the confidence has learned.
    fov_slack : float
        Standard deviation of a field of view that is given, as a share of it.
    fov_range_deg : (float, float)
        What is searched where none is given.
    usual_fov_deg : (float, float)
        Mean and standard deviation of those fields of view: most photos are taken with a lens of
        a phone or a usual zoom.
    render_width : int
        Columns of the views that refinement renders.
    render_tolerance_px : float
        How far their skylines may fall short.
    retrieval : RetrievalConfig
    full : FullConfig
    """

    refine: bool = True
    min_confidence: float = 0.8
    min_visible_deg: float = 14.0
    fov_slack: float = 0.025
    fov_range_deg: tuple[float, float] = (25.0, 100.0)
    usual_fov_deg: tuple[float, float] = (55.0, 14.0)
    render_width: int = 360
    render_tolerance_px: float = 0.05
    retrieval: RetrievalConfig = field(default_factory=RetrievalConfig)
    full: FullConfig = field(default_factory=FullConfig)

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
