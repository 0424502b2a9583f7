"""Examples of matches, from which the confidence is learned.

Synthetic queries of many kinds, some taken outside the mapped area, are matched on Sierra,
Rofental, Everest and Davos: skylines with errors and things in front, of the store's own model and
of others; made photographs, whose skylines are extracted; photos that note where they were taken,
rightly or wrongly. A third of the lenses are given, a third are noted by one EXIF value, and a
third are unknown. The figures of each query's best pose (`skyline.match.confidence`) and its error
form an example.
"""

import json
import math
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from skyline import Matcher, build_places, read_dem
from skyline.angles import angle_between_deg
from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.files.disk import write_whole
from skyline.geodesy.map_frame import Rectangle, in_rectangle
from skyline.match import confidence
from skyline.match.noted_errors import NOTED_ERRORS
from skyline.match.position_prior import PositionPrior
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.search import FullMatcher
from skyline.photo.extract import extract_skyline
from skyline.photo.frame import CROP
from skyline.photo.noted_focal_length import NOMINAL_SD
from skyline.photo.noted_fov import CROP_SHARES
from skyline.photo.skyline import Lens
from skyline.pose.pose import SAME_VIEW_DEG
from skyline.pose.poses import Poses
from skyline.progress import Progress
from skyline.render.depth import DepthRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline_bench.measuring import middle_of
from skyline_bench.queries.kinds import perturbed, resampled
from skyline_bench.queries.made_photos import drawn_scenery
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, make_queries
from skyline_training.photos import draw_photo
from skyline_training.workers import over_processes

T = TypeVar("T")

STAGES = ("refined", "retrieved", confidence.FITTED)

SIDE_M, WIDE_M = 6_000.0, 18_000.0
"""Sides of the areas in which terrain is searched in its own model, and in a coarse one."""
OUTSIDE = 1.35
"""Queries come from an area this much wider than the store: nearly half from outside it."""

LEARNED = {
    "sierra": ("sierra/sierra_ansel_adams_30m_albers.tif", DemOptions()),
    "rofental": ("rofental/dem_rofental_50.asc", DemOptions(crs="EPSG:32632")),
    "everest": ("everest/mt_everest_90m.tif", DemOptions()),
}
HELD_OUT = {"davos": ("davos/davos_srtm1_30m.tif", DemOptions())}

STRANGERS = {"sierra": "rofental", "rofental": "sierra", "everest": "rofental", "davos": "sierra"}
"""Terrain -> one whose skylines its store must refuse."""
STRANGE = "strangers"
"""Kind of the queries of other terrain."""
STRANGERS_SHARE = 3
"""Queries of a kind for each stranger of each of four kinds."""

_PLAIN = QueryConfig(max_tilt_deg=20.0, tilt_sd_deg=(6.0, 3.0))
"""Cameras are held as the solver expects, `skyline.match.solver`: some roll by six degrees."""
_ROUGH = replace(_PLAIN, fov_deg=(40.0, 90.0), noise_deg=(0.05, 0.3), distortion_sd=0.02)
KINDS = (_ROUGH, replace(_ROUGH, occluded_share=(0.0, 0.4)))

COARSE_M = 100.0
"""Spacing of the coarse models of the same terrain."""
_RAISED = replace(KINDS[0], eye_height_m=20.0)
"""Eyes on what a coarse model cuts off."""
PHOTO = replace(
    _PLAIN, fov_deg=(35.0, 75.0), distortion_sd=0.02, occluded_share=(0.0, 0.3), width_px=900,
    height_px=600, azimuths=14_400,
)  # fmt: skip
_RENDERED_PX = 1440
"""Columns of the depth images of a heading, of 90 degrees."""
_NOTED_SD_M, _NOTED_WRONG_SHARE = 30.0, 0.3
"""Error of the places that photos note, along each axis, and the share of the photos that note any
other place."""


@dataclass(frozen=True, slots=True)
class Example:
    """The figures of a query's best pose, and the pose's error."""

    figures: Mapping[str, float]
    # The error of a place, metres, infinite where the pose looks another way; or the error of a
    # heading, degrees. Infinite for a query of other terrain.
    error: float
    kind: str = ""  # The kind of the query
    turn_deg: float = 0.0  # Error of the heading of a place
    is_outside: bool = False  # Whether the query was taken outside the area that was searched


Examples = dict[str, dict[str, list[Example]]]
"""Examples by terrain and stage."""


def gather_matches(
    data: Path, queries: int, seed: int, progress: Progress, places: int | None = None
) -> Examples:
    """Match queries on every terrain, each in a process; return the examples.

    Stores have ``places`` places, by default as many as `build` plans.
    """
    return on_each_terrain(partial(_gathered_on, data, queries, seed, places), progress)


def on_each_terrain(gather: Callable[[str], T], progress: Progress) -> dict[str, T]:
    """Gather on each terrain in a process of its own; return results by name."""
    names = [*LEARNED, *HELD_OUT]
    found: dict[str, T] = {}
    for name, one in zip(names, over_processes(gather, names), strict=True):
        found[name] = one
        progress(len(found), len(names))
    return found


def _gathered_on(
    data: Path, queries: int, seed: int, places: int | None, name: str
) -> dict[str, list[Example]]:
    """Match queries of each kind on one terrain; return examples by stage.

    There are ``queries`` queries of each kind, drawn by a seed.
    """
    terrain, strange = read_terrains(data, name)
    with tempfile.TemporaryDirectory() as folder:
        return _examples_on(terrain, strange, Path(folder), queries, seed, places)


def read_terrains(data: Path, name: str) -> tuple[HeightField, HeightField]:
    """Read a terrain, and the one whose photos are its strangers."""
    terrain, strange = (
        read_dem([data / path], options)
        for path, options in ((LEARNED | HELD_OUT)[one] for one in (name, STRANGERS[name]))
    )
    return terrain, strange


def _examples_on(
    terrain: HeightField,
    strange: HeightField,
    folder: Path,
    queries: int,
    seed: int,
    places: int | None,
) -> dict[str, list[Example]]:
    """Match queries in a terrain's middle; return examples by stage.

    There are queries of all kinds, and some of another terrain. Most kinds are searched in the
    terrain itself, the others in a coarse model of it and a wider area, where places lie farther
    apart.
    """
    other, coarse = perturbed(terrain, seed=seed), resampled(terrain, COARSE_M)
    area, wide = built_of(terrain, SIDE_M, OUTSIDE), built_of(terrain, WIDE_M, OUTSIDE)

    def made(
        seen: HeightField, area_m: Rectangle, number: int, config: QueryConfig
    ) -> Sequence[SyntheticQuery]:
        return with_lenses(
            make_queries(seen, area_m, queries, seed + number, config), seed + number
        )

    own = {
        "own model, plain": _without_prior(made(terrain, area, 9, _PLAIN)),
        "own model": _without_prior(made(terrain, area, 1, KINDS[0])),
        "own model, hidden": _without_prior(made(terrain, area, 2, KINDS[1])),
        "other model": _without_prior(made(other, area, 3, KINDS[0])),
        "other model, hidden": _without_prior(made(other, area, 4, KINDS[1])),
        "place noted": _noted(made(other, area, 5, KINDS[1]), area, seed),
    }
    in_coarse = {
        "coarse model": _without_prior(made(terrain, wide, 6, KINDS[0])),
        "coarse model, raised": _without_prior(made(terrain, wide, 7, _RAISED)),
        "photographs": _without_prior(photographed(terrain, made(terrain, wide, 8, PHOTO), seed)),
    }
    strangers = _without_prior(strangers_of(strange, queries, seed))
    found: dict[str, list[Example]] = {name: [] for name in STAGES}
    for model, side_m, kinds in ((terrain, SIDE_M, own), (coarse, WIDE_M, in_coarse)):
        searched = built_of(model, side_m)
        with _matcher(model, searched, folder, places) as matcher:
            for kind, some in kinds.items():
                for stage, example in examples_from(matcher, some, kind, searched):
                    found[stage].append(example)
            for stage, example in examples_from(matcher, strangers, STRANGE, searched):
                stranger = replace(example, error=math.inf, turn_deg=math.inf, is_outside=True)
                found[stage].append(stranger)
    return found


def _without_prior(queries: Iterable[SyntheticQuery]) -> list[tuple[SyntheticQuery, Prior]]:
    return [(query, NOTHING_KNOWN) for query in queries]


def _noted(
    queries: Iterable[SyntheticQuery], area_m: Rectangle, seed: int
) -> list[tuple[SyntheticQuery, Prior]]:
    """Return queries with the places that they note.

    Some note a random place in the area.
    """
    rng = np.random.default_rng([seed, 1])
    west, south, east, north = area_m
    pairs = []
    for query in queries:
        off_m = _NOTED_SD_M * rng.standard_normal(2)
        easting_m, northing_m = query.truth.easting_m + off_m[0], query.truth.northing_m + off_m[1]
        if rng.random() < _NOTED_WRONG_SHARE:
            easting_m, northing_m = rng.uniform(west, east), rng.uniform(south, north)
        place = PositionPrior(float(easting_m), float(northing_m), NOTED_ERRORS.gps_scale_m)
        pairs.append((query, Prior(position=place)))
    return pairs


def photographed(
    terrain: HeightField, queries: Iterable[SyntheticQuery], seed: int
) -> Iterator[SyntheticQuery]:
    """Yield queries with skylines extracted from photographs of them.

    A query is left out if no skyline is found in its photograph.
    """
    rng = np.random.default_rng([seed, 2])
    heights_m = terrain.height_range_m
    with DepthRenderer(terrain, _RENDERED_PX) as renderer:
        for query in queries:
            scenery = drawn_scenery(rng, (15e3, 200e3), heights_m, heights_m)
            image = draw_photo(renderer, query, int(rng.integers(1 << 31)), scenery)
            try:
                skyline = extract_skyline(image)
            except InputError:
                continue
            known = query.skyline
            yield replace(query, skyline=replace(skyline, fov_deg=known.fov_deg, lens=known.lens))


@contextmanager
def _matcher(
    terrain: HeightField, area_m: Rectangle, folder: Path, places: int | None
) -> Iterator[FullMatcher]:
    """Open a matcher on an area's store for the block.

    The store has so many ``places``, or the default number.
    """
    west, south, east, north = area_m
    store = folder / f"{terrain.digest[:12]}.h5"
    lon, lat = terrain.frame.to_lonlat([west, east], [south, north])
    bounds_deg = float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])
    build_places(terrain, store, bounds_deg=bounds_deg, places=places)
    with Matcher(store, terrain) as matcher:
        ranker = matcher._method
        assert isinstance(ranker, FullMatcher)
        yield ranker


def examples_from(
    matcher: FullMatcher,
    queries: Sequence[tuple[SyntheticQuery, Prior]],
    kind: str,
    searched_m: Rectangle,
) -> Iterator[tuple[str, Example]]:
    """Yield the stages and examples of each query of a kind.

    A query that fits nowhere yields none.
    """
    for query, prior in queries:
        try:
            rays = query.rays()
        except InputError:
            continue
        found = matcher.found(rays, prior)
        retrieved, poses = found.retrieved, found.refined
        if len(retrieved):
            figures = confidence.retrieved_figures(retrieved, rays)
            yield "retrieved", _example(figures, retrieved, query, kind, searched_m)
        if poses is not None and len(poses):
            figures = confidence.refined_figures(poses, retrieved, rays)
            yield "refined", _example(figures, poses, query, kind, searched_m)
            figures = confidence.pose_figures(poses, rays)
            yield confidence.FITTED, _example(figures, poses, query, kind, searched_m)


def _example(
    figures: dict[str, Float64Array],
    poses: Poses,
    query: SyntheticQuery,
    kind: str,
    searched_m: Rectangle,
) -> Example:
    best = int(np.argmin(poses.cost))
    truth = query.truth
    off_m = float(truth.off_m(poses.easting_m[best], poses.northing_m[best]))
    turn_deg = float(angle_between_deg(poses.grid_heading_deg[best], truth.grid_heading_deg))
    return Example(
        {name: float(values[best]) for name, values in figures.items()},
        off_m if turn_deg <= SAME_VIEW_DEG else math.inf,
        kind,
        turn_deg,
        not in_rectangle(searched_m, truth.easting_m, truth.northing_m).item(),
    )


def built_of(terrain: HeightField, side_m: float = SIDE_M, wider: float = 1.0) -> Rectangle:
    """Return the square in a terrain's middle that is built.

    ``wider`` is a factor on its side.
    """
    west, south, east, north = terrain.bounds_m
    side_m = wider * min(side_m, 0.7 * (east - west), 0.7 * (north - south))
    return middle_of(terrain.bounds_m, (side_m, side_m))


def strangers_of(terrain: HeightField, queries: int, seed: int) -> list[SyntheticQuery]:
    """Make queries of every kind in a terrain's middle.

    Plain ones and photographs are among them. There is a stranger of each kind for every
    `STRANGERS_SHARE` of ``queries``.
    """
    count, area = max(queries // STRANGERS_SHARE, 1), built_of(terrain)
    made = {
        kind: with_lenses(make_queries(terrain, area, count, number, kind), number)
        for number, kind in enumerate((*KINDS, _PLAIN, PHOTO), start=seed + 100)
    }
    made[PHOTO] = list(photographed(terrain, made[PHOTO], seed + 100))
    return [query for some in made.values() for query in some]


def with_lenses(queries: Iterable[SyntheticQuery], seed: int) -> list[SyntheticQuery]:
    """Return queries with lenses known in three ways, in turn.

    The field of view is given, or noted by one EXIF value with its expected error
    (`skyline.photo.noted_fov`), or unknown.
    """
    rng = np.random.default_rng([seed, 3])
    made = []
    for number, query in enumerate(queries):
        skyline = query.skyline
        if number % 3 == 1:
            lens = _noted_alone(query.truth.fov_deg, rng)
            skyline = replace(skyline, fov_deg=lens.fov_deg, lens=lens)
        elif number % 3 == 2:
            skyline = replace(skyline, fov_deg=None)
        made.append(replace(query, skyline=skyline))
    return made


def _noted_alone(fov_deg: float, rng: np.random.Generator) -> Lens:
    """Return the lens of a photo with one value in EXIF.

    The value is the true field of view with an error; for a cropped photo, the field of view before
    the crop.
    """
    tangent = math.tan(math.radians(fov_deg) / 2.0) * math.exp(NOMINAL_SD * rng.standard_normal())
    if rng.uniform() < CROP_SHARES.resized:
        tangent /= rng.uniform(*CROP.left)
    noted_rad = 2.0 * math.atan(tangent)
    return Lens(
        math.degrees(noted_rad),
        math.degrees(NOMINAL_SD * math.sin(noted_rad)),
        crop_share=CROP_SHARES.resized,
    )


def read_examples(path: Path) -> Examples:
    """Read what `write_examples` wrote."""
    return {
        terrain: {stage: [Example(**one) for one in some] for stage, some in stages.items()}
        for terrain, stages in json.loads(path.read_text()).items()
    }


def write_examples(examples: Examples, path: Path) -> None:
    """Write examples, so that another model can be learned from them."""
    write_whole(path, json.dumps(examples, default=asdict))
