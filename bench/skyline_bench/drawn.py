"""Errors of drawings laid on the ground, and of control points' poses.

Photos see the elevation model with errors of 10 m rms added, and are matched, within 2 km of their
places, in a store of the model itself. Polygons of 5 to 11 vertices and 15 to 45 pixels of radius
are drawn in them on ground that is 100 m away or more, each vertex a pixel (rms) beside where it
should be. The truth is the ground that the photos show. Control points are six pixels of each
photo and the places that they show, one of them anywhere else in the photo; the camera's place is
given 50 m beside the true one, and no skyline is used.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from typer import Option

from skyline import (
    GroundErrors,
    GroundPoints,
    InputError,
    Matcher,
    Narrowing,
    PhotoSkyline,
    Pose,
    Viewer,
    build_places,
    read_dem,
)
from skyline.angles import angle_between_deg
from skyline.arrays import Float64Array
from skyline.cli.terminal import Terminal
from skyline.files.shapes import POLYGON, Shape
from skyline.ground.ground_shapes import GroundShape, on_ground
from skyline.orientation.control_points import KnownCamera, PointErrors, fit_points
from skyline.orientation.point_files import ControlPoints
from skyline.survey.plans import map_bounds
from skyline.terrain.provenance import DemOptions
from skyline_bench import options
from skyline_bench.measuring import Row, square_km
from skyline_bench.queries.kinds import HEIGHT_SD_M, perturbed
from skyline_bench.queries.synthetic import BESIDE_M, SyntheticQuery, make_queries
from skyline_bench.records import write_record
from skyline_bench.search.stores import middle_deg
from skyline_bench.sights import true_pose

_SHAPES = 6
"""Polygons in a photo."""
_TRIES = 60
_NEAREST_M = 100.0
_NEAR_KM = 2.0
_ERRORS = GroundErrors(pixel_sd_px=1.0, height_sd_m=HEIGHT_SD_M)
_EXACT = PointErrors(pixel_sd_px=0.5, place_sd_m=0.5, height_sd_m=HEIGHT_SD_M)
_POINTS = 6
_WIDE_PX = 4000
"""Width, in pixels, of the photos in which control points are marked."""
_LANDMARK_M = 1000.0
"""Least distance of control points."""


def drawn(
    dem: options.Dems,
    queries: Annotated[int, Option(min=1, help="Made photos.")] = 24,
    folder: options.Folder = None,
    record: options.Record = None,
    seed: options.Seed = 83,
    quick: Annotated[bool, options.quick_with(queries=2)] = False,
    crs: options.Crs = None,
) -> None:
    """How well drawings lie on the ground.

    Points and areas are drawn in made photos that were matched, and compared with the
    ground that the photos show; poses come from six control points, one of them wrong.
    """
    terrain = read_dem(dem, DemOptions(crs=crs))
    area_deg = middle_deg(terrain)
    area_m = map_bounds(terrain, area_deg)
    seen = perturbed(terrain, seed=seed)
    made = make_queries(seen, area_m, queries, seed)
    with options.store_folder(folder) as kept, Terminal().progress("drawing") as progress:
        store = kept / "drawn.h5"
        build_places(terrain, store, bounds_deg=area_deg)
        with Matcher(store, dem=terrain) as matcher, Viewer(terrain) as viewer:
            found = list[tuple[GroundShape, GroundShape]]()
            held = list[Row]()
            answered = 0
            for number, query in enumerate(made):
                rng = np.random.default_rng([seed, number])
                pose = _matched(matcher, query)
                answered += pose is not None
                with Viewer(seen) as truth:
                    if pose is not None:
                        found += _drawings(viewer, truth, query, pose, rng)
                    held += _by_points(viewer, truth, query, rng)
                progress(number + 1, queries)
    rows = [_drawn_row(found) | {"photos": answered}, _points_row(held)]
    rows = [{**row, "of": Path(dem[0]).stem, "km2": square_km(area_m)} for row in rows]
    options.print_tables(rows, _TABLES)
    write_record(record, rows, terrain=terrain, bounds_deg=area_deg)


_TABLES = {
    "drawn": """of km2 photos vertices=n within_2_sd in_95_%_ellipse median_off_m median_error_m
        grazing shapes areas_within_2_sd median_area_off""",
    "control points": """of km2 n wrong_named within_0.1_deg median_deg within_2_sd
        median_sd_deg""",
}
"""Columns of the printed tables, by what is measured."""


def _matched(matcher: Matcher, query: SyntheticQuery) -> Pose | None:
    """Return the answer for a photo, its place known to some kilometres."""
    near = Narrowing(near=(*query.truth.lonlat(matcher.frame), _NEAR_KM))
    return matcher.match(query.skyline, narrowing=near).answer


def _drawings(
    viewer: Viewer, truth: Viewer, query: SyntheticQuery, pose: Pose, rng: np.random.Generator
) -> Iterator[tuple[GroundShape, GroundShape]]:
    """Yield a photo's polygons, as they truly lie and by the pose."""
    photo = query.skyline
    true_view = truth.ground_view(true_pose(truth, query.truth), photo)
    view = viewer.ground_view(pose, photo)
    made = 0
    for _ in range(_TRIES):
        ring = _polygon(query, rng)
        if ring is None or made == _SHAPES:
            continue
        try:
            exact = on_ground(true_view, Shape(POLYGON, (ring,), "it"), truth.frame, _ERRORS)
            if exact.vertices.distance_m.min() < _NEAREST_M:
                continue
            hand = ring + rng.normal(0.0, _ERRORS.pixel_sd_px, ring.shape)
            yield exact, on_ground(view, Shape(POLYGON, (hand,), "it"), viewer.frame, _ERRORS)
        except InputError:
            continue  # A vertex shows sky.
        made += 1


def _polygon(query: SyntheticQuery, rng: np.random.Generator) -> Float64Array | None:
    """Return a polygon (V, 2) below the skyline, or None without room."""
    photo = query.skyline
    column = int(rng.integers(60, photo.width_px - 60))
    top = query.row_px[column] + 20.0
    if not top < photo.height_px - 60.0:
        return None
    turn = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(5, 12)))
    radius = rng.uniform(15.0, 45.0, len(turn))
    middle = column, rng.uniform(top, photo.height_px - 60.0)
    return np.asarray(middle + np.stack([radius * np.cos(turn), radius * np.sin(turn) / 2.0], 1))


def _drawn_row(found: Sequence[tuple[GroundShape, GroundShape]]) -> dict[str, Any]:
    """Return the figures of drawn polygons."""
    row: dict[str, Any] = {"measured": "drawn", "shapes": len(found)}
    if not found:
        return row
    exact, drawn_there = (
        GroundPoints.concatenate([pair[side].vertices for pair in found]) for side in (0, 1)
    )
    off = np.stack(
        [drawn_there.easting_m - exact.easting_m, drawn_there.northing_m - exact.northing_m], axis=1
    )
    off_m = np.linalg.norm(off, axis=1)
    inverse = np.linalg.inv(drawn_there.covariance_m2[:, :2, :2])
    squares = np.einsum("ni,nij,nj->n", off, inverse, off)
    areas = [(one.area, other.area) for one, other in found if one.area and other.area]
    area_off = [abs(other.value - one.value) for one, other in areas]
    return row | {
        "vertices": len(off),
        "within_2_sd": float(np.mean(off_m <= 2.0 * drawn_there.error_m)),
        "in_95_%_ellipse": float(np.mean(squares <= -2.0 * math.log(0.05))),
        "median_off_m": float(np.median(off_m)),
        "median_error_m": float(np.median(drawn_there.error_m)),
        "grazing": float(drawn_there.is_grazing.mean()),
        "areas_within_2_sd": float(
            np.mean([off <= 2.0 * area.sd for off, (_, area) in zip(area_off, areas, strict=True)])
        ),
        "median_area_off": float(
            np.median([off / one.value for off, (one, _) in zip(area_off, areas, strict=True)])
        ),
    }


def _by_points(
    viewer: Viewer, truth: Viewer, query: SyntheticQuery, rng: np.random.Generator
) -> list[Row]:
    """Return how control points orient a photo, if it shows enough ground."""
    size = _WIDE_PX, _WIDE_PX * 2 // 3
    unknown = np.full(size[0], np.nan), np.zeros(size[0])
    photo = PhotoSkyline(*unknown, *size, query.given_fov_deg)
    view = truth.ground_view(true_pose(truth, query.truth), photo)
    column, row = rng.uniform(20.0, np.array(size)[:, np.newaxis] - 20.0, (2, 400))
    shown = view.points(column, row)
    with np.errstate(invalid="ignore"):
        usable = np.flatnonzero((shown.distance_m > _LANDMARK_M) & ~shown.is_grazing)
    if len(usable) < 2 * _POINTS:
        return []
    chosen = rng.choice(usable, _POINTS, replace=False)
    marked = np.stack([column[chosen], row[chosen]]) + rng.normal(0.0, 0.5, (2, _POINTS))
    wrong = int(rng.integers(_POINTS))
    marked[:, wrong] = (marked[:, wrong] + np.array(size) * rng.uniform(0.2, 0.8, 2)) % size
    places_deg = viewer.frame.to_lonlat(shown.easting_m[chosen], shown.northing_m[chosen])
    points = ControlPoints(
        path=Path("points.csv"),
        names=tuple(map(str, range(_POINTS))),
        column_px=marked[0],
        row_px=marked[1],
        lon=places_deg[0],
        lat=places_deg[1],
        elevation_m=shown.elevation_m[chosen],
    )
    lon, lat = map(float, viewer.frame.to_lonlat(*query.truth.beside_m(rng)))
    known = KnownCamera.at(viewer, photo, lon=lon, lat=lat, position_sd_m=BESIDE_M)
    found = fit_points(viewer, photo, points, known, _EXACT)
    off_deg = float(angle_between_deg(found.pose.grid_heading_deg, query.truth.grid_heading_deg))
    is_named = found.wrong == (str(wrong),)
    return [{"off_deg": off_deg, "sd_deg": found.sds_deg["heading"], "is_named": is_named}]


def _points_row(held: Sequence[Row]) -> dict[str, Any]:
    """Return the figures of poses from control points."""
    row: dict[str, Any] = {"measured": "control points", "n": len(held)}
    if not held:
        return row
    off, sd, named = (
        np.array([one[key] for one in held]) for key in ("off_deg", "sd_deg", "is_named")
    )
    return row | {
        "wrong_named": float(named.mean()),
        "within_0.1_deg": float((off <= 0.1).mean()),
        "median_deg": float(np.median(off)),
        "within_2_sd": float((off <= 2.0 * sd).mean()),
        "median_sd_deg": float(np.median(sd)),
    }
