"""Speed against error: every way to a skyline, on the same viewpoints, in one run.

Times are medians by the clock on the wall, after a warm-up, taken in turns, all cores for
everyone. Errors are against the oracle, over the columns that neither side flags, in px of
W = 640 whatever the width.
"""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import count

import numpy as np

from skyline.camera import DEFAULT_WIDTH, check_width
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.pipeline.jobs import Progress
from skyline.planning.uniform import uniform_grid
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import HorizonRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views
from skyline_bench.measuring.timing import Timing, in_turns, over_cores
from skyline_bench.peers.embree import STARTS, Bisection, EmbreePeer, is_installed
from skyline_bench.truth import oracle
from skyline_bench.truth.comparison import Comparison, compare

Row = dict[str, object]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SpeedErrorConfig:
    """What is measured.

    Attributes
    ----------
    width : int
        Columns W of all paths but the depth path.
    depth_widths : tuple of int
    tolerances_px : tuple of float
        Of the horizon path.
    bisections : tuple of Bisection
        Settings of the Embree peer.
    viewpoints : int
        Viewpoints of a timed batch, on a grid of ``spacing_m`` in the middle of the DEM.
    slow_viewpoints : int
        The same for the depth path and the oracle: they take viewpoints one by one, so that the
        time of one does not depend on how many there are.
    compared_viewpoints : int
        How many of the batch, drawn with ``seed``, are compared with the oracle.
    repeats : int
        Timed rounds.
    curvature : Curvature
    """

    width: int = DEFAULT_WIDTH
    depth_widths: tuple[int, ...] = (160, 320, 640, 1280, 2560)
    tolerances_px: tuple[float, ...] = (0.0, 0.05, 0.1, 0.25, 0.5, 1.0)
    bisections: tuple[Bisection, ...] = tuple(
        Bisection(depth, start) for start in STARTS for depth in (9, 11, 13, 15, 18)
    )
    viewpoints: int = 400
    spacing_m: float = 100.0
    slow_viewpoints: int = 2
    compared_viewpoints: int = 24
    repeats: int = 5
    seed: int = 0
    curvature: Curvature = field(default_factory=Curvature)

    def __post_init__(self) -> None:
        for width in (self.width, *self.depth_widths):
            check_width(width)
        for name in ("viewpoints", "slow_viewpoints", "compared_viewpoints", "repeats"):
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
            repeats=2,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Contender:
    """One way to a skyline with one setting, ready to be asked for viewpoints.

    ``first_s`` is what it took from nothing to the first viewpoint's answer.
    """

    path: str
    width: int
    setting: str
    first_s: float
    viewpoints: Viewpoints
    render: Callable[[Viewpoints], Views]
    details: Row = field(default_factory=dict)


def central_viewpoints(terrain: HeightField, count: int, spacing_m: float) -> Viewpoints:
    """Return up to ``count`` viewpoints of a uniform grid, a square in the middle of a DEM.

    Raises
    ------
    InputError
        The spacing is not positive, or no viewpoint falls on the surface.
    """
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
    terrain: HeightField, config: SpeedErrorConfig, progress: Progress | None = None
) -> list[Row]:
    """Return one row a contender: what a benchmark always says, and what explains it.

    Raises
    ------
    InputError
        No viewpoint falls on the surface in the middle of the DEM.
    """
    batch = central_viewpoints(terrain, config.viewpoints, config.spacing_m)
    drawn = np.random.default_rng(config.seed).permutation(len(batch))
    compared = batch[np.sort(drawn[: config.compared_viewpoints])]
    with ExitStack() as held:
        contenders = list(_contenders(terrain, batch, compared, config, held))
        tick = _ticker(progress, len(contenders) * (3 + 2 * config.repeats))
        truths: dict[int, Views] = {}
        errors = []
        for contender in contenders:
            if contender.width not in truths:
                truths[contender.width] = _oracle(terrain, config, contender.width)(compared)
            errors.append(compare(contender.render(compared), truths[contender.width]))
            tick()
        batches = in_turns(
            [partial(c.render, c.viewpoints) for c in contenders], config.repeats, tick
        )
        alone = in_turns(
            [partial(c.render, compared[:1]) for c in contenders], config.repeats, tick
        )
    return [
        _row(*measured, compared_viewpoints=len(compared))
        for measured in zip(contenders, errors, batches, alone, strict=True)
    ]


def _contenders(
    terrain: HeightField,
    batch: Viewpoints,
    few: Viewpoints,
    config: SpeedErrorConfig,
    held: ExitStack,
) -> Iterator[_Contender]:
    """Yield everything that is compared; what holds resources is entered into ``held``."""
    few = few[: config.slow_viewpoints]
    for width in config.depth_widths:
        started = time.perf_counter()
        depth = held.enter_context(DepthRenderer(terrain, width, config.curvature))
        first_s = _first_answer(started, depth.render, few)
        yield _Contender("depth", width, f"W = {width}", first_s, few, depth.render)
    for tolerance_px in config.tolerances_px:
        started = time.perf_counter()
        horizon = held.enter_context(
            HorizonRenderer(terrain, config.width, config.curvature, tolerance_px)
        )
        yield _Contender(
            "horizon",
            config.width,
            f"{tolerance_px:g} px",
            _first_answer(started, horizon.render, few),
            batch,
            horizon.render,
            {"tolerance_px": tolerance_px},
        )
    if is_installed():
        started = time.perf_counter()
        peer = EmbreePeer(terrain, config.width, config.curvature)
        first_s = _first_answer(started, partial(peer.render, bisection=Bisection(15)), few)
        for bisection in config.bisections:
            yield _Contender(
                "embree",
                config.width,
                f"{bisection.start} {bisection.depth}",
                first_s,
                batch,
                partial(peer.render, bisection=bisection),
                {"start": bisection.start, "bisections": bisection.depth},
            )
    else:
        _log.warning("Embree is left out; to have it measured: pip install 'skyline-bench[peers]'")
    started = time.perf_counter()
    exact = _oracle(terrain, config, config.width)
    first_s = _first_answer(started, exact, few)
    yield _Contender("oracle", config.width, "exact", first_s, few, exact)


def _first_answer(
    started: float, render: Callable[[Viewpoints], Views], viewpoints: Viewpoints
) -> float:
    """Return the seconds from ``started`` to a first viewpoint's answer, all set up by then."""
    render(viewpoints[:1])
    return time.perf_counter() - started


def _oracle(
    terrain: HeightField, config: SpeedErrorConfig, width: int
) -> Callable[[Viewpoints], Views]:
    """Return the oracle as a renderer that uses all cores."""

    def render(viewpoints: Viewpoints) -> Views:
        return Views.concatenate(
            over_cores(
                lambda part: oracle.skyline(terrain, part, width, config.curvature), viewpoints, 1
            )
        )

    return render


def _row(
    contender: _Contender,
    error: Comparison,
    batch: Timing,
    alone: Timing,
    *,
    compared_viewpoints: int,
) -> Row:
    timed = len(contender.viewpoints)
    return {
        "path": contender.path,
        "width": contender.width,
        "tolerance_px": None,
        "setting": contender.setting,
        "ms_per_viewpoint": 1e3 * batch.seconds / timed,
        **asdict(error),
        "viewpoints_per_s": timed / batch.seconds,
        "cpu_ms_per_viewpoint": 1e3 * batch.cpu_seconds / timed,
        "ms_alone": 1e3 * alone.seconds,
        "first_s": contender.first_s,
        "timed_viewpoints": timed,
        "compared_viewpoints": compared_viewpoints,
        **contender.details,
    }


def _ticker(progress: Progress | None, total: int) -> Callable[[], None]:
    """Return what to call after each of ``total`` steps."""
    steps = count(1)

    def tick() -> None:
        if progress:
            progress(next(steps), total)

    return tick
