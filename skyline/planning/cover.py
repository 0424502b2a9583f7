"""Our own strategy: a whole layout planned by prediction, corrected as the truth arrives."""

import numpy as np

from skyline.coverage import Problem, Requests
from skyline.planning.forecast import Forecast
from skyline.planning.layout import Annealing, Areas, Layout

_SKETCH = Annealing(sweeps=20)
_PLAN = Annealing(sweeps=240)
_RENEWAL = Annealing(sweeps=40, hot=0.15)
_REVISION = Annealing(sweeps=12, hot=0.04)
_TOUCH = Annealing(sweeps=6, hot=0.04)

_PROBES = 4
"""How many views are rendered before a forecast is first compared with the truth."""

_MISFIT = 0.05
"""Share by which predicted areas may miss the true ones for the forecast to be trusted."""

_WORTH_PLANNING = 0.2
"""Share up to which a forecast may miss for a long search for the best layout to pay: beyond, the
layout found is the one whose areas are overrated most."""

_TAIL = 0.02
"""When no more than this share of the views is still to be asked for, all of it is; of more, the
more a forecast misses, since it is then not worth waiting for the truth."""


def cover(problem: Problem, generator: np.random.Generator) -> Requests:
    """Plan the fewest areas that cover what is asked, render those that do not touch, revise.

    The whole layout is planned with predicted areas (`skyline.planning.layout`), since a rendering
    cannot be taken back. A few views of a rough sketch are rendered first, for the prediction to
    go by; then the plan is worked out. Requests go out together where their predicted areas do not
    touch, so that none could have been placed better for knowing another's true area. What comes
    back is compared with what was predicted, the forecast learns from it
    (`skyline.planning.forecast`), and what is left of the layout is revised on top of what is truly
    covered.
    """
    if problem.done:
        return
    reach = problem.grid.reach
    forecast = Forecast(problem, step=1 + reach // 2)
    areas = _areas(problem, forecast)
    layout = _layout(problem, areas, generator)
    layout.start_greedily()
    layout.anneal(_SKETCH)
    allowed, planned, due, misfit = _PROBES, False, 0, 0.0
    while not problem.done:
        rendered = len(problem.coverage.viewpoints)
        few = len(layout.sites) <= _TAIL * max(1.0, misfit / _WORTH_PLANNING) * rendered
        batch = layout.sites if few else layout.sites[layout.apart()[:allowed]]
        errors = yield batch
        missed = forecast.learn(batch, errors)
        if len(batch) >= _PROBES:
            # Fewer views say little of the forecast as a whole.
            misfit = missed
        left = layout.sites[~np.isin(layout.sites, batch)]
        rendered += len(batch)
        hopeful = misfit <= _WORTH_PLANNING
        annealing = _REVISION if hopeful else _TOUCH
        if not planned or (missed > _MISFIT and rendered >= due and len(left) > len(batch)):
            # The next forecast waits for twice the views, so there are few of them.
            due = 2 * rendered
            forecast.refresh(step=1 + reach // 3)
            areas = _areas(problem, forecast)
            trusted = missed <= _MISFIT or allowed > _PROBES
            annealing = _PLAN if trusted and hopeful and not planned else _RENEWAL
            planned = planned or trusted
            allowed = len(areas.size) if planned else _PROBES**2
        layout = _layout(problem, areas, generator)
        layout.place(left)
        layout.start_greedily()
        layout.anneal(annealing)


def _areas(problem: Problem, forecast: Forecast) -> Areas:
    worth = (problem.region & problem.grid.valid).ravel().astype(np.int32)
    return Areas(problem.grid, forecast.areas, worth)


def _layout(problem: Problem, areas: Areas, generator: np.random.Generator) -> Layout:
    covered = ~problem.coverage.uncovered.ravel()
    rendered = np.zeros(covered.size, dtype=bool)
    rendered[problem.coverage.viewpoints] = True
    asked = int(np.ceil(problem.target * areas.weight.sum() - 1e-9))
    target = asked - int(areas.weight[covered].sum())
    return Layout(areas, covered, rendered, target, generator)
