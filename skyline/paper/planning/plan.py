"""The planning loop on real terrain (paper 4): strategies ask, a renderer renders, areas grow.

Every heading and every square of the coarse grid is a problem of its own. All run in step, so that
what they ask for in a round goes to the renderer as one batch. What comes back is put in order by
place and heading, so the order it comes back in makes no difference. Nothing is random but what
the seed says: given the views of a plan that was stopped, the same plan asks for the same views
again, is handed those there are, and goes on where they end.
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
from skyline.paper.planning.budget import AIMS, ENOUGH, Outlook, covering_px
from skyline.paper.planning.candidates import CandidateMap, Spacing, lay_out
from skyline.paper.planning.coverage import Coverage, Problem, Requests
from skyline.paper.planning.models import InterpolatedModel, Measure, PredictedModel
from skyline.paper.planning.strategies import STRATEGIES
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints
from skyline.views import Views

_log = logging.getLogger(__name__)

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
        if self.budget is not None and self.budget < len(HEADINGS):
            raise InputError(
                f"budget is {self.budget} renderings; expected at least {len(HEADINGS)}, one "
                "location"
            )


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
    rendered: Views | None = None,
    progress: Callable[[PlanProgress], None] | None = None,
) -> Plan:
    """Choose viewpoints and have them rendered until the coverage asked for is reached.

    Raises `InputError` for a spacing larger than the area, an area wholly in holes, a coarse grid
    beyond the budget, or a renderer that does not return what it was asked for.

    Parameters
    ----------
    measure : callable
        Returns the tolerance areas of rendered and of predicted views, of as many candidates to
        every side as the spacing's reach holds.
    bounds_m : tuple, optional
        West, south, east, north of the area, by default all of the terrain.
    rendered : Views, optional
        Views of the same plan, stopped earlier; they are not rendered again.
    progress : callable, optional
        Called with a `PlanProgress` after each batch.
    """
    config = config or PlanConfig()
    candidates = lay_out(terrain, config.spacing, bounds_m, config.eye_height_m, config.budget)
    return _Loop(candidates, render, measure, config, rendered, progress).run()


class _Loop:
    def __init__(
        self,
        candidates: CandidateMap,
        render: Render,
        measure: Measure,
        config: PlanConfig,
        rendered: Views | None,
        progress: Callable[[PlanProgress], None] | None,
    ) -> None:
        self._candidates = candidates
        self._render, self._measure = render, measure
        self._config = config
        self._rendered = rendered
        self._at = {} if rendered is None else rows_by_place(rendered)
        self._progress = progress
        self._errors: tuple[list[Float32Array], ...] = tuple([] for _ in HEADINGS)
        self._coverages = tuple(Coverage(candidates.grid) for _ in HEADINGS)
        self._threshold_px = config.threshold_px
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
        self._fresh = 0
        self._batches = 0

    def run(self) -> Plan:
        """Render the coarse grid, then what the strategies ask for."""
        self._batch([self._candidates.coarse for _ in HEADINGS], list(HEADINGS))
        if self._config.budget is None:
            self._cover()
        else:
            self._spend(self._config.budget)
        plan_s = time.perf_counter() - self._started - self._render_s
        return Plan(
            self._candidates,
            self._coverages,
            self._threshold_px,
            self._now(),
            self._render_s,
            plan_s,
        )

    def _spend(self, budget: int) -> None:
        """Cover to one threshold after the other, each lower, while there is budget left."""
        lowest_px, share = self._config.threshold_px, self._config.coverage
        outlook = Outlook(
            np.concatenate([errors for one in self._errors for errors in one]),
            len(HEADINGS) * int(self._candidates.grid.valid.sum()),
            share,
        )
        for aim in AIMS:
            self._hold_to(outlook.threshold_px(aim * budget, lowest_px))
            self._cover()
            made = self._now().renderings
            if made >= ENOUGH * budget or self._threshold_px <= lowest_px:
                break
            outlook.learn(self._threshold_px, made)
        reached_px = max(
            covering_px(one.grid, one.viewpoints, np.concatenate(errors), share)
            for one, errors in zip(self._coverages, self._errors, strict=True)
        )
        if np.isfinite(reached_px):
            self._hold_to(max(reached_px, lowest_px))

    def _hold_to(self, threshold_px: float) -> None:
        """Go on with the areas that the views have at another threshold."""
        self._threshold_px = threshold_px
        before = self._coverages
        self._coverages = tuple(Coverage(self._candidates.grid) for _ in HEADINGS)
        for old, new, errors in zip(before, self._coverages, self._errors, strict=True):
            new.add(old.viewpoints, np.concatenate(errors) <= threshold_px)

    def _cover(self) -> None:
        """Render what the strategies ask for, to the coverage asked for or the budget's end."""
        if self._left() == 0:
            return
        waiting = list(self._start())
        while waiting:
            headings = [heading for heading, _, _ in waiting]
            wanted = self._affordable([asked for _, _, asked in waiting], headings)
            errors = self._batch(wanted, headings)
            # The last requests may have been cut: their strategies are not to go on.
            if self._left() == 0:
                return
            served, waiting = waiting, []
            for (heading, requests, _), answer in zip(served, errors, strict=True):
                if self._coverages[heading].fraction() < self._config.coverage:
                    with suppress(StopIteration):
                        waiting.append((heading, requests, requests.send(answer)))

    def _left(self) -> int | None:
        """Return how many more renderings there may be; None for any number."""
        made = sum(len(one.viewpoints) for one in self._coverages)
        return None if self._config.budget is None else self._config.budget - made

    def _affordable(self, asked: list[Int64Array], headings: list[int]) -> list[Int64Array]:
        """Return requests, of too many those that are predicted to cover most."""
        left = self._left()
        if left is None or sum(map(len, asked)) <= left:
            return asked
        gains = [
            self._coverages[heading].gains(
                one, self._models[heading].predict_errors(one) <= self._threshold_px
            )
            for one, heading in zip(asked, headings, strict=True)
        ]
        order = np.argsort(-np.concatenate(gains), kind="stable")
        kept = np.zeros(len(order), dtype=bool)
        kept[order[:left]] = True
        parts = np.split(kept, np.cumsum([len(one) for one in asked])[:-1])
        return [one[part] for one, part in zip(asked, parts, strict=True)]

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
                    self._threshold_px,
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
                self._errors[one].append(errors[rows])
                self._coverages[one].add(candidates[rows], errors[rows] <= self._threshold_px)
                self._models[one].learn(candidates[rows], views[rows], errors[rows])
        self._report()
        return np.split(errors, np.cumsum([len(one) for one in asked])[:-1])

    def _views(self, viewpoints: Viewpoints, heading: Headings) -> Views:
        """Return views of requests in their order: those there are already, the others rendered."""
        asked = places(viewpoints, heading)
        held = np.array([place in self._at for place in asked])
        parts = []
        if held.any() and self._rendered is not None:
            stored = [self._at[place] for place, there in zip(asked, held, strict=True) if there]
            parts.append(self._rendered[np.array(stored)])
        if not held.all():
            started = time.perf_counter()
            parts.append(self._render(viewpoints[~held], heading[~held]))
            self._render_s += time.perf_counter() - started
            self._fresh += int(np.count_nonzero(~held))
        return as_asked(Views.concatenate(parts), asked)

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
        return PlanProgress(
            coverage=float(np.mean([one.fraction() for one in self._coverages])),
            renderings=sum(len(one.viewpoints) for one in self._coverages),
            overlap=sum(one.overlap for one in self._coverages),
            renderings_per_s=self._fresh / seconds,
            batches=self._batches,
        )


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
