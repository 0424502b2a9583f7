"""Speed against error: every way to a skyline, on the same viewpoints, in one run.

Times are medians by the clock on the wall, after a warm-up, taken in turns, all cores for
everyone. Errors are against the oracle, over the columns that neither side flags, in px of
W = 640 whatever the width.
"""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import Any

import numpy as np

from skyline.build.cluster import Progress
from skyline.build.grid import uniform_grid
from skyline.camera import DEFAULT_WIDTH, check_width
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import HorizonRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import in_turns, over_cores, unseen
from skyline_bench.peers.embree import STARTS, Bisection, EmbreePeer, is_installed
from skyline_bench.truth import oracle
from skyline_bench.truth.agreement import compare

_Render = Callable[[Viewpoints], Views]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SpeedErrorConfig:
    """What is measured."""

    width: int = DEFAULT_WIDTH  # Columns W of all paths but the depth path
    depth_widths: tuple[int, ...] = (160, 320, 640, 1280, 2560)
    tolerances_px: tuple[float, ...] = (0.0, 0.05, 0.1, 0.25, 0.5, 1.0)  # Of the horizon path
    # Settings of the Embree peer.
    bisections: tuple[Bisection, ...] = tuple(
        Bisection(depth, start) for start in STARTS for depth in (9, 11, 13, 15, 18)
    )
    # Viewpoints of a timed batch, on a grid of ``spacing_m`` in the middle of the DEM.
    viewpoints: int = 400
    spacing_m: float = 100.0
    # The same for the depth path and the oracle: they take viewpoints one by one, so that the time
    # of one does not depend on how many there are.
    slow_viewpoints: int = 2
    # How many of the batch, drawn with ``seed``, are compared with the oracle.
    compared_viewpoints: int = 24
    # And of those for the depth path, which takes seconds for one.
    slow_compared_viewpoints: int = 8
    repeats: int = 3  # Timed rounds
    seed: int = 0
    curvature: Curvature = field(default_factory=Curvature)

    def __post_init__(self) -> None:
        for width in (self.width, *self.depth_widths):
            check_width(width)
        for name in (
            "viewpoints",
            "slow_viewpoints",
            "compared_viewpoints",
            "slow_compared_viewpoints",
            "repeats",
        ):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; expected 1 or more")
        if not (np.isfinite(self.spacing_m) and self.spacing_m > 0.0):
            raise InputError(f"spacing_m is {self.spacing_m}; expected a positive number of metres")
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; expected 0 or more")

    def quick(self) -> "SpeedErrorConfig":
        """Return a version that takes seconds: fewer settings, viewpoints and rounds."""
        return replace(
            self,
            depth_widths=(160, 320),
            tolerances_px=(0.0, 0.1),
            bisections=tuple(Bisection(depth) for depth in (11, 15)),
            viewpoints=min(self.viewpoints, 64),
            slow_viewpoints=2,
            compared_viewpoints=4,
            slow_compared_viewpoints=2,
            repeats=2,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Contender:
    """One way to a skyline with one setting, ready to be asked for viewpoints."""

    path: str
    width: int
    setting: str
    viewpoints: Viewpoints
    compared: Viewpoints
    render: _Render
    first_s: float  # From nothing to the first viewpoint's answer
    details: Row = field(default_factory=dict)


def central_viewpoints(terrain: HeightField, count: int, spacing_m: float) -> Viewpoints:
    """Return up to ``count`` viewpoints of a uniform grid, a square in the middle of a DEM."""
    side = int(np.ceil(np.sqrt(count)))
    west, south, east, north = terrain.bounds_m
    half_m = (side - 0.5) / 2.0 * spacing_m
    # Half a step over from a multiple of the spacing, an even number of them is in the middle.
    easting, northing = (
        (np.floor(middle / spacing_m) + (0.0 if side % 2 else 0.5)) * spacing_m
        for middle in ((west + east) / 2.0, (south + north) / 2.0)
    )
    bounds = (easting - half_m, northing - half_m, easting + half_m, northing + half_m)
    return uniform_grid(terrain, spacing_m, bounds)[:count]


def measure(
    terrain: HeightField, config: SpeedErrorConfig, progress: Progress = unseen
) -> list[Row]:
    """Return one row a contender: what a benchmark always says, and what explains it."""
    batch = central_viewpoints(terrain, config.viewpoints, config.spacing_m)
    drawn = np.random.default_rng(config.seed).permutation(len(batch))
    compared = batch[np.sort(drawn[: config.compared_viewpoints])]
    steps = count(1)

    def tick() -> None:
        progress(next(steps), len(contenders) * (3 + 2 * config.repeats))

    with ExitStack() as held:
        contenders = list(_contenders(terrain, batch, compared, config, held))
        truths: dict[tuple[int, int], Views] = {}
        errors = []
        for one in contenders:
            key = one.width, len(one.compared)
            if key not in truths:
                truths[key] = _oracle(terrain, config, one.width)(one.compared)
            errors.append(compare(one.render(one.compared), truths[key]))
            tick()
        batch_work = [partial(one.render, one.viewpoints) for one in contenders]
        one_work = [partial(one.render, compared[:1]) for one in contenders]
        batches = in_turns(batch_work, config.repeats, tick)
        alone = in_turns(one_work, config.repeats, tick)
    return [
        {
            "path": one.path,
            "width": one.width,
            "tolerance_px": None,
            "setting": one.setting,
            "ms_per_viewpoint": 1e3 * batch_time.seconds / len(one.viewpoints),
            **error,
            "viewpoints_per_s": len(one.viewpoints) / batch_time.seconds,
            "cpu_ms_per_viewpoint": 1e3 * batch_time.cpu_seconds / len(one.viewpoints),
            "ms_alone": 1e3 * alone_time.seconds,
            "first_s": one.first_s,
            "timed_viewpoints": len(one.viewpoints),
            "compared_viewpoints": len(one.compared),
            **one.details,
        }
        for one, error, batch_time, alone_time in zip(
            contenders, errors, batches, alone, strict=True
        )
    ]


def _contenders(
    terrain: HeightField,
    batch: Viewpoints,
    compared: Viewpoints,
    config: SpeedErrorConfig,
    held: ExitStack,
) -> Iterator[_Contender]:
    """Yield everything that is compared; what holds resources is entered into ``held``."""
    few, width, curvature = compared[: config.slow_viewpoints], config.width, config.curvature
    some = compared[: config.slow_compared_viewpoints]

    def first(make: Callable[[], AbstractContextManager[Any]]) -> tuple[_Render, float]:
        started = time.perf_counter()
        render: _Render = held.enter_context(make()).render
        render(few[:1])
        return render, time.perf_counter() - started

    for columns in config.depth_widths:
        made = first(partial(DepthRenderer, terrain, columns, curvature))
        yield _Contender("depth", columns, f"W = {columns}", few, some, *made)
    for tolerance_px in config.tolerances_px:
        made = first(partial(HorizonRenderer, terrain, width, curvature, tolerance_px))
        setting, details = f"{tolerance_px:g} px", {"tolerance_px": tolerance_px}
        yield _Contender("horizon", width, setting, batch, compared, *made, details)
    if is_installed():
        started = time.perf_counter()
        peer = EmbreePeer(terrain, width, curvature)
        peer.render(few[:1], Bisection(15))
        first_s = time.perf_counter() - started
        for bisection in config.bisections:
            setting = f"{bisection.start} {bisection.depth}"
            render = partial(peer.render, bisection=bisection)
            how = {"start": bisection.start, "bisections": bisection.depth}
            yield _Contender("embree", width, setting, batch, compared, render, first_s, how)
    else:
        _log.warning("Embree is left out; to have it measured: pip install 'skyline-bench[peers]'")
    started = time.perf_counter()
    exact = _oracle(terrain, config, width)
    exact(few[:1])
    first_s = time.perf_counter() - started
    yield _Contender("oracle", width, "exact", few, some, exact, first_s)


def _oracle(terrain: HeightField, config: SpeedErrorConfig, width: int) -> _Render:
    """Return the oracle as a renderer that uses all cores."""

    def render(part: Viewpoints) -> Views:
        return oracle.skyline(terrain, part, width, config.curvature)

    return lambda viewpoints: Views.concatenate(over_cores(render, viewpoints, 1))
