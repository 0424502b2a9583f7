"""The planning loop on real terrain (paper 4): strategies ask, a renderer renders, areas grow.

Every heading and every square of the coarse grid is a problem of its own. All run in step, so that
what they ask for in a round goes to the renderer as one batch. All random choices follow from the
seed.
"""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Int64Array
from skyline.camera import HEADINGS
from skyline.errors import InputError, named
from skyline.geodesy import Rectangle
from skyline.paper.candidates import CandidateMap, Spacing, lay_out
from skyline.paper.coverage import Coverage, Problem, Requests
from skyline.paper.error_models import InterpolatedModel, Measure, PredictedModel
from skyline.paper.strategies import STRATEGIES
from skyline.skylines import Views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_log = logging.getLogger(__name__)

Headings = NDArray[np.uint8]

Render = Callable[[Viewpoints, Headings], Views]
"""Renders N viewpoints along N headings; returns N views in the same order."""


@dataclass(frozen=True, slots=True)
class PlanConfig:
    """What to plan.

    Raises `InputError` for a strategy that is not known, a coverage outside (0, 1], or a threshold
    that is not positive.
    """

    strategy: str = "lpov"
    """A name of `skyline.paper.strategies.STRATEGIES`."""
    spacing: Spacing = field(default_factory=Spacing)
    threshold_px: float = 3.0
    """A location is covered where some view's skyline is predicted within this."""
    coverage: float = 0.98
    """Share of the candidates to cover in each heading, in (0, 1]."""
    seed: int = 0

    def __post_init__(self) -> None:
        named("strategy", self.strategy, STRATEGIES)
        if not 0.0 < self.coverage <= 1.0:
            raise InputError(
                f"coverage is {self.coverage}; expected a share above 0 and at most 1, for example "
                "0.98"
            )
        if not 0.0 < self.threshold_px < np.inf:
            raise InputError(
                f"threshold is {self.threshold_px} px; expected a positive number of pixels, for "
                "example 3"
            )


@dataclass(frozen=True, slots=True)
class PlanProgress:
    """How far a plan has come: after each batch."""

    coverage: float
    """Share of the candidates covered, over all headings."""
    renderings: int
    """Views so far."""
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
    """For which they were planned."""
    progress: PlanProgress
    """At the end."""
    render_s: float
    plan_s: float
    """``render_s``, ``plan_s``: seconds spent in the renderer, and on everything else."""

    @property
    def coverage(self) -> float:
        """Predicted coverage over all headings."""
        return self.progress.coverage


_Waiting = tuple[int, Requests, Int64Array]
"""A heading, a strategy at work there, and the candidates it is waiting for."""


def plan(
    terrain: HeightField,
    render: Render,
    measure: Measure,
    config: PlanConfig | None = None,
    bounds_m: Rectangle | None = None,
    progress: Callable[[PlanProgress], None] | None = None,
) -> Plan:
    """Choose viewpoints and have them rendered until the coverage asked for is reached.

    Raises `InputError` for a spacing larger than the area, or an area wholly in holes.

    Parameters
    ----------
    measure : callable
        Returns the tolerance areas of rendered and of predicted views, of as many candidates to
        every side as the spacing's reach holds.
    bounds_m : tuple, optional
        West, south, east, north of the area, by default all of the terrain.
    progress : callable, optional
        Called with a `PlanProgress` after each batch.
    """
    config = config or PlanConfig()
    candidates = lay_out(terrain, config.spacing, bounds_m)
    return _Loop(candidates, render, measure, config, progress).run()


class _Loop:
    def __init__(
        self,
        candidates: CandidateMap,
        render: Render,
        measure: Measure,
        config: PlanConfig,
        progress: Callable[[PlanProgress], None] | None,
    ) -> None:
        self._candidates = candidates
        self._render, self._measure = render, measure
        self._config = config
        self._progress = progress
        self._coverages = tuple(Coverage(candidates.grid) for _ in HEADINGS)
        self._models: tuple[InterpolatedModel | PredictedModel, ...]
        if config.strategy == "rov":
            archive: dict[tuple[int, int], Views] = {}
            self._models = tuple(
                PredictedModel(candidates, heading, measure, archive) for heading in HEADINGS
            )
        else:
            self._models = tuple(InterpolatedModel(candidates) for _ in HEADINGS)
        self._started = time.perf_counter()
        self._render_s = 0.0
        self._batches = 0

    def run(self) -> Plan:
        """Render the coarse grid, then what the strategies ask for."""
        self._batch([self._candidates.coarse for _ in HEADINGS], list(HEADINGS))
        self._cover()
        plan_s = time.perf_counter() - self._started - self._render_s
        return Plan(
            self._candidates,
            self._coverages,
            self._config.threshold_px,
            self._now(),
            self._render_s,
            plan_s,
        )

    def _cover(self) -> None:
        """Render what the strategies ask for, up to the coverage asked for."""
        waiting = list(self._start())
        while waiting:
            headings = [heading for heading, _, _ in waiting]
            errors = self._batch([asked for _, _, asked in waiting], headings)
            served, waiting = waiting, []
            for (heading, requests, _), answer in zip(served, errors, strict=True):
                if self._coverages[heading].fraction() < self._config.coverage:
                    with suppress(StopIteration):
                        waiting.append((heading, requests, requests.send(answer)))

    def _start(self) -> Iterator[_Waiting]:
        """Start the strategy in every square of every heading, up to the first requests."""
        config, valid = self._config, self._candidates.grid.valid
        squares = np.unique(self._candidates.square[valid])
        for heading, (coverage, model) in enumerate(
            zip(self._coverages, self._models, strict=True)
        ):
            for number, square in enumerate(squares):
                problem = Problem(
                    coverage,
                    model.predict_errors,
                    config.threshold_px,
                    config.coverage,
                    valid & (self._candidates.square == square),
                )
                generator = np.random.default_rng([config.seed, heading, number])
                requests = STRATEGIES[config.strategy](problem, generator)
                asked = next(requests, None)
                if asked is not None:
                    yield heading, requests, asked

    def _batch(self, asked: list[Int64Array], headings: list[int]) -> list[Float32Array]:
        """Render requests, add their areas to the coverage, and return their errors."""
        heading = np.repeat(np.array(headings, np.uint8), [len(one) for one in asked])
        candidates = np.concatenate(asked)
        views = self._views(self._candidates.viewpoints(candidates), heading)
        errors = self._measure(views)
        for one in HEADINGS:
            rows = np.flatnonzero(heading == one)
            if rows.size:
                within = errors[rows] <= self._config.threshold_px
                self._coverages[one].add(candidates[rows], within)
                self._models[one].learn(candidates[rows], views[rows], errors[rows])
        self._report()
        return np.split(errors, np.cumsum([len(one) for one in asked])[:-1])

    def _views(self, viewpoints: Viewpoints, heading: Headings) -> Views:
        """Return the views of requests in their order."""
        started = time.perf_counter()
        views = self._render(viewpoints, heading)
        self._render_s += time.perf_counter() - started
        return views

    def _report(self) -> None:
        self._batches += 1
        now = self._now()
        _log.info(
            "batch %d: coverage %.4f, %d renderings, overlap %d, %.0f renderings/s",
            *(now.batches, now.coverage, now.renderings, now.overlap, now.renderings_per_s),
        )
        if self._progress:
            self._progress(now)

    def _now(self) -> PlanProgress:
        seconds = max(time.perf_counter() - self._started, 1e-9)
        renderings = sum(len(one.viewpoints) for one in self._coverages)
        return PlanProgress(
            coverage=float(np.mean([one.fraction() for one in self._coverages])),
            renderings=renderings,
            overlap=sum(one.overlap for one in self._coverages),
            renderings_per_s=renderings / seconds,
            batches=self._batches,
        )
