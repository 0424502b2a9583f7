"""What a plan is asked for, whom it asks, and what it has come to."""

from dataclasses import dataclass, field

from skyline.coverage import Coverage, check_target, check_threshold
from skyline.errors import named
from skyline.planning.budget import check_budget
from skyline.planning.candidates import CandidateMap, Spacing
from skyline.planning.models import Measure, Predict
from skyline.planning.requests import Render
from skyline.planning.strategies import STRATEGIES
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M


@dataclass(frozen=True, slots=True)
class PlanConfig:
    """What to plan.

    Attributes
    ----------
    strategy : str
        A name of `skyline.planning.strategies.STRATEGIES`.
    spacing : Spacing
    threshold_px : float
        A location is covered where some view's skyline is predicted within this.
    coverage : float
        Share of the candidates to cover in each heading, in (0, 1].
    eye_height_m : float
    seed : int
    budget : int, optional
        At most so many renderings, and nearly as many where the terrain allows it: the threshold
        is raised, or lowered as far as ``threshold_px``, to what they can cover.

    Raises
    ------
    InputError
        No such strategy, a coverage outside (0, 1], a threshold that is not positive, or a budget
        that does not suffice for one location.
    """

    strategy: str = "cover"
    spacing: Spacing = field(default_factory=Spacing)
    threshold_px: float = 3.0
    coverage: float = 0.98
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    seed: int = 0
    budget: int | None = None

    def __post_init__(self) -> None:
        named("strategy", self.strategy, STRATEGIES)
        check_target(self.coverage)
        check_threshold(self.threshold_px)
        check_budget(self.budget)


@dataclass(frozen=True, slots=True)
class Oracles:
    """What the loop asks others for.

    Attributes
    ----------
    render : Render
    measure : Measure
        Tolerance areas of rendered views.
    predict : Predict, optional
        Views at candidates that have not been rendered. Without it, areas of candidates are
        interpolated from those of the rendered views around.
    measure_predicted : Measure, optional
        Tolerance areas of predicted views; by default ``measure``.
    """

    render: Render
    measure: Measure
    predict: Predict | None = None
    measure_predicted: Measure | None = None


@dataclass(frozen=True, slots=True)
class PlanProgress:
    """How far a plan has come: after each batch.

    Attributes
    ----------
    coverage : float
        Share of the candidates covered, over all headings.
    renderings : int
        Views so far, those handed in at the start included.
    overlap : int
        Inclusions in tolerance areas less covered candidates, over all headings.
    renderings_per_s : float
    batches : int
        So far.
    """

    coverage: float
    renderings: int
    overlap: int
    renderings_per_s: float
    batches: int


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What was planned and rendered.

    Attributes
    ----------
    candidates : CandidateMap
    coverages : tuple of Coverage
        One a heading: its viewpoints and their tolerance areas.
    threshold_px : float
        What they were planned for; with a budget, what the renderings sufficed for.
    progress : PlanProgress
        At the end.
    render_s, plan_s : float
        Seconds spent in the renderer, and on everything else.
    render_cpu_s, plan_cpu_s : float
        The same in processor time, all threads of the process.
    """

    candidates: CandidateMap
    coverages: tuple[Coverage, ...]
    threshold_px: float
    progress: PlanProgress
    render_s: float
    plan_s: float
    render_cpu_s: float
    plan_cpu_s: float

    @property
    def coverage(self) -> float:
        """Predicted coverage over all headings."""
        return self.progress.coverage
