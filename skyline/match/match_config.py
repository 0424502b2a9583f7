"""How queries are matched, and how far refinement goes."""

from dataclasses import dataclass, field

from skyline.errors import InputError
from skyline.match.noise import Noise
from skyline.match.retrieval import RetrievalConfig
from skyline.match.solver import SolverConfig
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M


@dataclass(frozen=True, slots=True)
class RefineConfig:
    """How many hypotheses are refined, and how far.

    Attributes
    ----------
    shortlist : int
        Hypotheses taken, the best by their scores.
    particles : int
        How many of them set out, the best by one rendering each.
    rounds : int
        Renderings of one that is kept, before the last rounds.
    keep_share, keep_least : float, int
        What part is kept from one round to the next, and how many at least.
    restarts : int
        The best places from whose surroundings the search starts again.
    restart_m : float
        Radius of the ring of eight places around each.
    restart_rounds : int
        Renderings of each of those.
    finalists : int
        Places that go through the last rounds.
    final_rounds : int
        Renderings of each, at most.
    separation_m : float
        Finalists are at least this far apart.
    elsewhere_m : float
        A pose farther off than this is a different answer.
    far_m : float
        A pose farther off than this is not even roughly the same answer.
    rivals : int
        The best of those elsewhere, and the best of those far off, are kept to the end beside the
        best: what an answer is worth shows in how much worse they fit.
    temperature : float
        What differences of scores are divided by to be log odds: neighbouring columns share
        errors that no model here knows of.
    first_step_m, longest_step_m : float
        Deviations that damp steps.
    slope_reach_m : float
        Half the distance over which the ground's slope is taken.
    eye_height_m : float
        Usual height of the eye above the ground.
    eye_height_known : bool
        Whether it is just that.
    scout_bins, bins : int
        Steps of azimuth of a panorama, a multiple of 8, while scouting and after; the latter
        about as fine as the renderings.
    rough, fine : SolverConfig
        The solver of the search, and of the last rounds.
    """

    shortlist: int = 400
    particles: int = 128
    rounds: int = 8
    keep_share: float = 0.9
    keep_least: int = 48
    restarts: int = 6
    restart_m: float = 30.0
    restart_rounds: int = 3
    finalists: int = 12
    final_rounds: int = 5
    separation_m: float = 12.0
    elsewhere_m: float = 200.0
    far_m: float = 1000.0
    rivals: int = 3
    temperature: float = 8.0
    first_step_m: float = 40.0
    longest_step_m: float = 120.0
    slope_reach_m: float = 15.0
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    eye_height_known: bool = False
    scout_bins: int = 480
    bins: int = 1440
    rough: SolverConfig = field(default_factory=lambda: SolverConfig(noise=Noise(nodes=0)))
    fine: SolverConfig = field(default_factory=lambda: SolverConfig(iterations=2, choices=1))

    def __post_init__(self) -> None:
        for name in ("shortlist", "particles", "rounds", "keep_least", "finalists"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; expected at least 1")
        for name in ("restarts", "restart_rounds", "final_rounds", "rivals", "eye_height_m"):
            if getattr(self, name) < 0:
                raise InputError(f"{name} is {getattr(self, name)}; expected at least 0")
        if not 0.0 < self.keep_share <= 1.0:
            raise InputError(f"keep_share is {self.keep_share}; expected above 0, at most 1")
        if not 0.0 < self.first_step_m <= self.longest_step_m or self.slope_reach_m <= 0.0:
            raise InputError(
                f"steps are {self.first_step_m} to {self.longest_step_m} m and the slope's reach "
                f"{self.slope_reach_m} m; expected increasing steps and a reach above 0"
            )


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
