"""How far refinement goes: what is kept from round to round, and what its solvers model."""

from dataclasses import dataclass, field

from skyline.errors import InputError
from skyline.matching.noise import Noise
from skyline.matching.solver import SolverConfig
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
