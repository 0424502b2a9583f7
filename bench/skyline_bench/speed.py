"""Speed: the time and the error of programs that compute skylines.

Times are medians after a warm-up; the programs take turns, and each has all cores. Times vary on
shared machines, so compare only times of one run.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from itertools import count

import numpy as np

from skyline.arrays import Float64Array
from skyline.cli.terminal import Terminal
from skyline.geodesy.earth import Curvature
from skyline.geodesy.map_frame import Frame
from skyline.horizons.horizon import DEFAULT_STEP_DEG
from skyline.progress import Progress
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import HorizonRenderer, PanoramaRenderer, RenderConfig
from skyline.skylines import DEFAULT_WIDTH, Horizons, Views, elevation_deg
from skyline.store.places import BINS
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline_bench import options, peers
from skyline_bench.measuring import (
    Row,
    central_viewpoints,
    in_turns,
    over_cores,
    peak_bytes,
    square_km,
    timed,
)
from skyline_bench.truth import oracle
from skyline_bench.truth.agreement import PIXEL_TAN, compare
from skyline_bench.truth.closed_forms import fractal

_log = logging.getLogger(__name__)

_STEPS = round(360.0 / DEFAULT_STEP_DEG)


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """One way to a skyline with one setting, ready to render viewpoints."""

    path: str
    width: int
    setting: str
    viewpoints: Viewpoints  # Timed together
    compared: Viewpoints
    render: Callable[[Viewpoints], Views | Horizons]
    details: Row = field(default_factory=dict)


def speed_error(
    dem: options.Dems,
    record: options.Record = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Every way to a skyline: its time against its error.

    Times are milliseconds a viewpoint; errors are differences from the oracle.

    Viewpoints stand on a 100 m grid in the DEM's middle, and n of them are compared with the
    oracle. Errors are over the columns that neither side flags, in px of W = 640 whatever the
    width; for skylines all the way round, as places have them, they are errors of elevation angles.
    Embree needs embreex (extra peers), GRASS `grass` on the path: a peer that is not installed is
    left out.
    """
    terrain = read_dem(dem, DemOptions(crs=crs))
    with Terminal().progress("measuring") as progress:
        rows = _speed_error(terrain, seed, quick, progress)
    columns = """path setting km2 timed_viewpoints=timed ms_per_viewpoint compared_viewpoints=n
        rms_px max_px missing"""
    options.report(record, rows, columns, terrain=terrain)


def _speed_error(terrain: HeightField, seed: int, quick: bool, progress: Progress) -> list[Row]:
    batch = central_viewpoints(terrain, 16 if quick else 400, 100.0)
    drawn = np.random.default_rng(seed).permutation(len(batch))
    compared = batch[np.sort(drawn[: 4 if quick else 24])]
    repeats = 2 if quick else 3
    steps = count(1)

    def tick() -> None:
        progress(next(steps), len(ways) * (2 + repeats))

    with ExitStack() as held:
        ways = list(_ways(terrain, batch, compared, quick, held))
        truths: dict[tuple[int, int], Views] = {}
        true_deg = _true_deg(terrain, compared, np.zeros(len(compared)), Curvature())
        errors = list[Row]()
        for way in ways:
            seen = way.render(way.compared)
            key = (way.width, len(way.compared))
            if isinstance(seen, Views):
                if key not in truths:
                    truths[key] = _oracle(terrain, way.width, way.compared)
                errors.append(compare(seen, truths[key]))
            else:
                found_deg = np.degrees(np.arctan(seen.elevation_tan.astype(np.float64)))
                errors.append(_errors_px(found_deg - true_deg[:, :: _STEPS // found_deg.shape[1]]))
            tick()
        batches = in_turns([partial(way.render, way.viewpoints) for way in ways], repeats, tick)
    rows: list[Row] = [
        {
            "path": way.path,
            "width": way.width,
            "setting": way.setting,
            "ms_per_viewpoint": 1e3 * batch_time.seconds / len(way.viewpoints),
            **error,
            "viewpoints_per_s": len(way.viewpoints) / batch_time.seconds,
            "cpu_ms_per_viewpoint": 1e3 * batch_time.cpu_seconds / len(way.viewpoints),
            "timed_viewpoints": len(way.viewpoints),
            "compared_viewpoints": len(way.compared),
            **way.details,
        }
        for way, error, batch_time in zip(ways, errors, batches, strict=True)
    ]
    if peers.has_grass():
        rows.append(_grass(terrain, compared))
    return [{**row, "km2": square_km(terrain.bounds_m)} for row in rows]


def _ways(
    terrain: HeightField, batch: Viewpoints, compared: Viewpoints, quick: bool, held: ExitStack
) -> Iterator[_Way]:
    """Yield every way that is compared; renderers are closed with ``held``."""
    # The depth path and the oracle take viewpoints one by one, and fewer are enough.
    few = compared[:2]
    some = compared[: 2 if quick else 8]
    width = 160 if quick else DEFAULT_WIDTH
    for columns in (160, 320) if quick else (160, 320, 640, 1280, 2560):
        depth = held.enter_context(DepthRenderer(terrain, columns))
        yield _Way("depth", columns, f"W = {columns}", few, some, depth.render)
    four_views = held.enter_context(HorizonRenderer(terrain, RenderConfig(width)))
    yield _Way("horizon", width, f"W = {width}", batch, compared, four_views.render)
    for azimuths in (_STEPS, BINS):
        panorama = held.enter_context(PanoramaRenderer(terrain, azimuths))
        # Their azimuths count from grid north on.
        from_north = partial(panorama.render, first_azimuth_rad=0.0)
        yield _Way("all round", azimuths, f"{azimuths} azimuths", batch, compared, from_north)
    if peers.has_embree():
        peer = peers.EmbreePeer(terrain, width)
        for bisections in (11, 15) if quick else (9, 11, 13, 15, 18):
            render = partial(peer.render, depth=bisections)
            name = f"{bisections} bisections"
            details = {"bisections": bisections}
            yield _Way("embree", width, name, batch, compared, render, details)
    else:
        _log.warning("Embree is left out: pip install 'skyline-bench[peers]' to measure it")
    yield _Way("oracle", width, "exact", few, some, partial(_oracle, terrain, width))


def _grass(terrain: HeightField, eyes: Viewpoints) -> Row:
    """Return the row of r.horizon, which takes one place at a time.

    It stands on the nearest sample, and has neither curvature nor angles below zero; the same holds
    for the truth with which it is compared.
    """
    row, col = (
        np.rint(at) for at in terrain.to_grid(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
    )
    easting_m, northing_m = terrain.to_map(row, col)
    stand = stand_on(terrain, easting_m=easting_m, northing_m=northing_m, eye_height_m=0.0)
    found_deg, seconds = peers.grass_horizons(terrain, stand, DEFAULT_STEP_DEG)
    north_deg = terrain.frame.convergence_deg(easting_m=easting_m, northing_m=northing_m)
    true_deg = _true_deg(terrain, stand, -north_deg, Curvature(enabled=False))
    each_s = float(np.median(seconds))
    return {
        "path": "grass",
        "width": _STEPS,
        "setting": "r.horizon",
        "ms_per_viewpoint": 1e3 * each_s,
        **_errors_px(found_deg - np.maximum(true_deg, 0.0)),
        "viewpoints_per_s": 1.0 / each_s,
        "cpu_ms_per_viewpoint": None,
        "timed_viewpoints": len(eyes),
        "compared_viewpoints": len(eyes),
    }


def _true_deg(
    terrain: HeightField, eyes: Viewpoints, turn_deg: Float64Array, curvature: Curvature
) -> Float64Array:
    """Return the oracle's elevation angles (N, A) from azimuths (N,) on."""
    azimuth_deg = np.arange(_STEPS) * DEFAULT_STEP_DEG
    true_deg = np.empty((len(eyes), _STEPS))
    for index in range(len(eyes)):
        grid_deg = (azimuth_deg + turn_deg[index] + 45.0) % 360.0 - 45.0
        order = np.argsort(grid_deg)
        heading = np.floor((grid_deg[order] + 45.0) / 90.0).astype(int)
        away = np.radians(grid_deg[order] - 90.0 * heading).reshape(4, -1)
        u = np.tan(away[0])
        views = oracle.skyline_at(terrain, eyes[index : index + 1], u, curvature)
        true_deg[index, order] = elevation_deg(views.v.astype(np.float64), u).ravel()
    return true_deg


def _errors_px(off_deg: Float64Array) -> Row:
    """Return errors of elevation angles, px at a view's middle."""
    off_px = np.tan(np.radians(np.abs(off_deg[np.isfinite(off_deg)]))) / PIXEL_TAN
    return {
        "rms_px": float(np.sqrt(np.mean(off_px**2))),
        "max_px": float(off_px.max()),
        "columns": off_px.size,
        "missing": int(np.isnan(off_deg).sum()),
    }


def _oracle(terrain: HeightField, width: int, viewpoints: Viewpoints) -> Views:
    """Return the oracle's skylines, computed on all cores."""
    render = partial(oracle.skyline, terrain, width=width)
    return Views.concatenate(over_cores(render, viewpoints, 1))


def large_dem(record: options.Record = None, quick: options.Quick = False) -> None:
    """A DEM of 20,000 x 20,000 samples: seconds of rendering, and memory."""
    samples, viewpoints = (1000, 4) if quick else (20_000, 256)
    # Rough terrain that repeats every 60 km, in one array and no copies.
    period = 2000
    spacing_m = 30.0
    tile = (1500.0 + 1500.0 * fractal(period, period, 1, 2.1)).astype(np.float32)
    again = np.arange(samples) % period
    heights = tile[np.ix_(again, again)]
    heights.setflags(write=False)
    terrain = HeightField(heights, 0.0, 0.0, spacing_m, spacing_m, Frame.local(lon=10.0, lat=46.0))
    middle = samples * spacing_m / 2.0
    place = np.random.default_rng(2).uniform(-5000.0, 5000.0, (2, viewpoints))
    eyes = stand_on(terrain, easting_m=middle + place[0], northing_m=-middle + place[1])
    with HorizonRenderer(terrain, RenderConfig()) as renderer:
        views, timing = timed(lambda: renderer.render(eyes))
    row = {
        "samples": samples,
        "km2": square_km(terrain.bounds_m),
        "viewpoints": viewpoints,
        "seconds": timing.seconds,
        "median_depth_m": float(np.nanmedian(views.depth_m)),
        "greatest_depth_m": float(np.nanmax(views.depth_m)),
        "dem_bytes": heights.nbytes,
        "peak_resident_bytes": peak_bytes(),
    }
    columns = """samples km2 viewpoints=n seconds median_depth_m greatest_depth_m dem_bytes
        peak_resident_bytes"""
    options.report(record, [row], columns)
