"""The planning loop on real terrain (paper 4): strategies ask, a renderer renders, areas grow.

Every heading and every square of the coarse grid is a problem of its own. All run in step, so that
what they ask for in a round goes to the renderer as one batch. What comes back is put in order by
where it was rendered, so the order it comes back in makes no difference. Nothing is random but what
the seed says: given the views of a plan that was stopped, the same plan asks for the same views
again, is handed those there are, and goes on where they end.
"""

import logging
import time
from collections.abc import Callable, Generator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Int64Array
from skyline.camera import HEADINGS
from skyline.errors import InputError
from skyline.geodesy import Rectangle
from skyline.paper.planning.budget import AIMS, ENOUGH, Outlook, check_coarse, covering_px
from skyline.paper.planning.candidates import CandidateMap, lay_out
from skyline.paper.planning.coverage import AreaModel, Coverage, Problem
from skyline.paper.planning.models import Archive, InterpolatedModel, PredictedModel
from skyline.paper.planning.plan import (
    Headings,
    Oracles,
    Plan,
    PlanConfig,
    PlanProgress,
    as_asked,
    places,
    rows_by_place,
)
from skyline.paper.planning.strategies import STRATEGIES
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

_log = logging.getLogger(__name__)


class _Model(AreaModel, Protocol):
    def learn(self, candidates: Int64Array, views: Views, errors: Float32Array) -> None: ...


_Pending = tuple[Generator[Int64Array, Float32Array, None], Int64Array]
"""A strategy at work and the candidates it is waiting for."""


def plan(
    terrain: HeightField,
    oracles: Oracles,
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
    bounds_m : tuple, optional
        West, south, east, north of the area, by default all of the terrain.
    rendered : Views, optional
        Views of the same plan, stopped earlier; they are not rendered again.
    progress : callable, optional
        Called with a `PlanProgress` after each batch.
    """
    config = config or PlanConfig()
    candidates = lay_out(terrain, config.spacing, bounds_m, config.eye_height_m)
    check_coarse(candidates, config.budget)
    loop = _Loop(candidates, oracles, config, rendered, progress)
    loop.run()
    return loop.result()


class _Loop:
    def __init__(
        self,
        candidates: CandidateMap,
        oracles: Oracles,
        config: PlanConfig,
        rendered: Views | None,
        progress: Callable[[PlanProgress], None] | None,
    ) -> None:
        self._candidates = candidates
        self._oracles = oracles
        self._config = config
        self._rendered = rendered
        self._at = {} if rendered is None else rows_by_place(rendered)
        self._progress = progress
        self._errors: tuple[list[Float32Array], ...] = tuple([] for _ in HEADINGS)
        self._coverages = tuple(Coverage(candidates.grid) for _ in HEADINGS)
        self._threshold_px = config.threshold_px
        self._archive = Archive()
        self._models = tuple(self._model(heading) for heading in HEADINGS)
        self._started = _clocks()
        self._render_s = np.zeros(2)
        self._fresh = 0
        self._batches = 0

    def run(self) -> None:
        """Render the coarse grid, then what the strategies ask for."""
        coarse, budget = self._candidates.coarse, self._config.budget
        self._batch([coarse for _ in HEADINGS], list(HEADINGS))
        if budget is None:
            self._cover()
        else:
            self._spend(budget)

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
        waiting = [self._start(heading) for heading in HEADINGS]
        while any(waiting):
            asked = [(heading, one) for heading in HEADINGS for one in waiting[heading]]
            headings = [heading for heading, _ in asked]
            wanted = self._affordable([one[1] for _, one in asked], headings)
            errors = self._batch(wanted, headings)
            # The last requests may have been cut: their strategies are not to go on.
            if self._left() == 0:
                return
            waiting = [[] for _ in HEADINGS]
            for (heading, (requests, _)), answer in zip(asked, errors, strict=True):
                if self._coverages[heading].fraction() >= self._config.coverage:
                    requests.close()
                    continue
                try:
                    waiting[heading].append((requests, requests.send(answer)))
                except StopIteration:
                    continue

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

    def result(self) -> Plan:
        """Return the plan as it stands."""
        (render_s, render_cpu_s), whole_s = self._render_s.tolist(), _clocks() - self._started
        plan_s, plan_cpu_s = (whole_s - self._render_s).tolist()
        return Plan(
            self._candidates,
            self._coverages,
            self._threshold_px,
            self._now(),
            render_s,
            plan_s,
            render_cpu_s,
            plan_cpu_s,
        )

    def _model(self, heading: int) -> _Model:
        oracles = self._oracles
        if oracles.predict is None:
            return InterpolatedModel(self._candidates)
        return PredictedModel(
            self._candidates, heading, oracles.predict, oracles.measure, self._archive
        )

    def _start(self, heading: int) -> list[_Pending]:
        """Start the strategy in every square, up to the first requests."""
        config = self._config
        waiting = []
        for number, region in enumerate(self._regions()):
            problem = Problem(
                self._coverages[heading],
                self._models[heading],
                self._threshold_px,
                config.coverage,
                region,
            )
            generator = np.random.default_rng([config.seed, heading, number])
            requests = STRATEGIES[config.strategy](problem, generator)
            asked = next(requests, None)
            if asked is not None:
                waiting.append((requests, asked))
        return waiting

    def _regions(self) -> list[BoolArray]:
        valid = self._candidates.grid.valid
        squares = np.unique(self._candidates.square[valid])
        return [valid & (self._candidates.square == square) for square in squares]

    def _batch(self, asked: list[Int64Array], headings: list[int]) -> list[Float32Array]:
        """Render requests, add their areas to the coverage, and return their errors."""
        heading = np.repeat(np.array(headings, np.uint8), [len(one) for one in asked])
        candidates = np.concatenate(asked)
        views = self._views(self._candidates.viewpoints(candidates), heading)
        errors = self._oracles.measure(views)
        window = self._candidates.grid.window
        if errors.shape != (len(views), window, window):
            raise InputError(
                f"measured errors have shape {errors.shape}; expected "
                f"{(len(views), window, window)}: a neighbourhood of {window} x {window} "
                f"candidates {self._config.spacing.candidate_m:g} m apart"
            )
        if self._oracles.predict is not None:
            self._archive.add(candidates, views)
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
            started = _clocks()
            parts.append(self._oracles.render(viewpoints[~held], heading[~held]))
            self._render_s += _clocks() - started
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
        seconds = max(float((_clocks() - self._started)[0]), 1e-9)
        return PlanProgress(
            coverage=float(np.mean([one.fraction() for one in self._coverages])),
            renderings=sum(len(one.viewpoints) for one in self._coverages),
            overlap=sum(one.overlap for one in self._coverages),
            renderings_per_s=self._fresh / seconds,
            batches=self._batches,
        )


def _clocks() -> NDArray[np.float64]:
    """Return the time by the wall and by the processor, seconds."""
    return np.array([time.perf_counter(), time.process_time()])
