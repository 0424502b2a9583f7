"""What a plan is asked for, whom it asks, and what it has come to.

What comes back from a renderer is matched with what was asked for by place and heading.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError, named
from skyline.paper.planning.budget import check_budget
from skyline.paper.planning.candidates import CandidateMap, Spacing
from skyline.paper.planning.coverage import Coverage, check_target, check_threshold
from skyline.paper.planning.models import Measure, Predict
from skyline.paper.planning.strategies import STRATEGIES
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints
from skyline.views import Views

Headings = NDArray[np.uint8]

Render = Callable[[Viewpoints, Headings], Views]
"""Renders N viewpoints along N headings; the N views may come in any order."""

Place = tuple[float, float, int]
"""Easting, northing and heading."""


@dataclass(frozen=True, slots=True)
class PlanConfig:
    """What to plan.

    Raises `InputError` for a strategy that is not known, a coverage outside (0, 1], a threshold
    that is not positive, or a budget that does not suffice for one location.
    """

    strategy: str = "lpov"
    """A name of `skyline.paper.planning.strategies.STRATEGIES`."""
    spacing: Spacing = field(default_factory=Spacing)
    threshold_px: float = 3.0
    """A location is covered where some view's skyline is predicted within this."""
    coverage: float = 0.98
    """Share of the candidates to cover in each heading, in (0, 1]."""
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    seed: int = 0
    budget: int | None = None
    """At most so many renderings, and nearly as many where the terrain allows it: the threshold is
    raised, or lowered as far as ``threshold_px``, to what they can cover."""

    def __post_init__(self) -> None:
        named("strategy", self.strategy, STRATEGIES)
        check_target(self.coverage)
        check_threshold(self.threshold_px)
        check_budget(self.budget)


@dataclass(frozen=True, slots=True)
class Oracles:
    """What the loop asks others for."""

    render: Render
    measure: Measure
    """Tolerance areas of rendered and of predicted views."""
    predict: Predict | None = None
    """Views at candidates that have not been rendered. Without it, areas of candidates are
    interpolated from those of the rendered views around."""


@dataclass(frozen=True, slots=True)
class PlanProgress:
    """How far a plan has come: after each batch."""

    coverage: float
    """Share of the candidates covered, over all headings."""
    renderings: int
    """Views so far, those handed in at the start included."""
    overlap: int
    """Inclusions in tolerance areas less covered candidates, over all headings."""
    renderings_per_s: float
    batches: int
    """So far."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What was planned and rendered."""

    candidates: CandidateMap
    coverages: tuple[Coverage, ...]
    """One a heading: its viewpoints and their tolerance areas."""
    threshold_px: float
    """What they were planned for; with a budget, what the renderings sufficed for."""
    progress: PlanProgress
    """At the end."""
    render_s: float
    plan_s: float
    """``render_s``, ``plan_s``: seconds spent in the renderer, and on everything else."""
    render_cpu_s: float
    plan_cpu_s: float
    """``render_cpu_s``, ``plan_cpu_s``: the same in processor time, all threads of the process."""

    @property
    def coverage(self) -> float:
        """Predicted coverage over all headings."""
        return self.progress.coverage


def places(viewpoints: Viewpoints | Views, heading: Headings) -> list[Place]:
    """Return the places of N viewpoints along N headings, or of N views."""
    easting, northing = viewpoints.easting_m.tolist(), viewpoints.northing_m.tolist()
    return list(zip(easting, northing, heading.tolist(), strict=True))


def rows_by_place(views: Views) -> dict[Place, int]:
    """Return where in ``views`` each place is."""
    return {place: row for row, place in enumerate(places(views, views.heading))}


def as_asked(views: Views, asked: list[Place]) -> Views:
    """Return views in the order they were asked for, some of them more than once perhaps.

    Raises `InputError` where a view that was asked for is not there.
    """
    row = rows_by_place(views)
    missing = [place for place in asked if place not in row]
    if missing:
        easting, northing, heading = missing[0]
        raise InputError(
            f"there is no view at easting {easting:.2f}, northing {northing:.2f}, heading "
            f"{heading}; expected one for each of the {len(asked)} asked for ({len(missing)} such)"
        )
    return views[np.array([row[place] for place in asked], dtype=np.int64)]
