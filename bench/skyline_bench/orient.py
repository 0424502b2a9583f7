"""Poses at known places, and the summits that photos show.

The photos are photographs, made photos and frames of a webcam. Made photos see the elevation model
with errors of 10 m rms added, and the given place is 50 m beside the true one: models and phones
are off by as much. Unmarked panoramas and fisheyes are given as perspective photos, at their
places. Strangers are photos of other terrain, with any place given. `skyline_bench.noted_heights`
makes photos that note heights.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from PIL import Image
from typer import Option

from skyline import Orientation, Orienter, PhotoSkyline, read_dem
from skyline.angles import angle_between_deg, wrapped_deg
from skyline.cli.terminal import Terminal
from skyline.errors import InputError, SkylineError
from skyline.geodesy.map_frame import Rectangle
from skyline.orientation.orienter import DEFAULT_POSITION_SD_M, KnownPosition, orienters
from skyline.orientation.result import RIGHT_DEG
from skyline.progress import Progress
from skyline.render.depth import DepthRenderer
from skyline.survey.plans import map_bounds
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline.terrain.viewpoints import at_elevation
from skyline_bench import options
from skyline_bench.measuring import Row, square_km
from skyline_bench.noted_heights import HEIGHTS, MEASURED, NOTING, Find, LonLat, height_rows
from skyline_bench.queries.kinds import STRANGERS, UNMARKED, Query, make_kind, perturbed
from skyline_bench.queries.made_photos import Scenery, distance_along, photograph
from skyline_bench.queries.manifest import EXTRACT, LOCATE, Photograph, read_manifest
from skyline_bench.queries.synthetic import BESIDE_M, SyntheticQuery, make_queries
from skyline_bench.records import write_record
from skyline_bench.search.stores import middle_deg
from skyline_bench.search.trials import ALL, groups
from skyline_bench.sights import Posed, label_row, pixel_row

SHARP_DEG = 0.15
"""Standard error below which a heading claims to be right within 0.3 degrees."""
_ORIENTED = """of measured=queries group km2 n answered within_0.3_deg within_1_deg=within_1
    median_deg p95_deg median_sd_deg=median_sd within_2_sd fov_within_3_% wrong strongest
    seconds=s"""
_TABLES = {
    "photo": """photo kind answered off_deg sd_deg fov_off confidence moved_m seconds=s refusal""",
    "photos": _ORIENTED,
    "made photos": _ORIENTED,
    "unmarked": _ORIENTED,
    "strangers": _ORIENTED,
    MEASURED: HEIGHTS,
    "labels": """measured pose model km2 photos=n summits visible named within_5_px hidden
        hidden_named median_px p95_px""",
    "pixels": """measured pose model km2 photos=n pixels sky_right median_off_m p99_off_m
        within_2_sd""",
    "webcam": """measured skyline_m km2 frames=n answered within_0.1_deg spread_deg greatest_deg
        off_deg fog fog_answered seconds=s""",
}
"""Columns of the printed tables, by what is measured."""

_OrienterAt = Callable[[KnownPosition], Orienter]
_Held = tuple[SyntheticQuery, Orientation]
"""A made photo, and how its camera was found to be held."""


def orient(
    dem: options.Dems,
    photos: Annotated[
        Path | None,
        options.read_option("MANIFEST.csv", "Measure these photographs instead of made ones."),
    ] = None,
    strange: Annotated[
        str | None,
        options.read_option("DEM", "Other terrain, whose photos are refused."),
    ] = None,
    queries: Annotated[int, Option(min=1, help="Made photos, strangers and frames.")] = 200,
    record: options.Record = None,
    seed: options.Seed = 71,
    quick: Annotated[bool, options.quick_with(queries=4)] = False,
    crs: options.Crs = None,
) -> None:
    """Headings at known places: how many are answered, and how well.

    Photographs are oriented, or else made photos, with summits' names and pixels' places in them,
    and frames of a webcam. docs/howto/comparing-grids.md has the columns of a manifest. Places are
    given to 50 m. In the tables, n is the number of photos, photographs or frames, and km2 the area
    from which made photos come.
    """
    name = photos.stem if photos else Path(dem[0]).stem
    wanted = [one for one in read_manifest(photos) if one.kind != EXTRACT] if photos else []
    if photos and not wanted:
        raise InputError(f"{photos} names no photograph to locate or to refuse; expected some")
    if photos and strange:
        raise InputError("--strange is measured with made photos; give it without --photos")
    terrain = read_dem(dem, DemOptions(crs=crs))
    other = read_dem(strange) if strange else None
    area_deg = None if photos else middle_deg(terrain)
    with Terminal().progress("orienting") as progress, orienters(terrain) as orienter_at:
        if photos:
            rows = photograph_rows(orienter_at, wanted, progress)
        else:
            area_m = map_bounds(terrain, area_deg)
            rows = made_rows(orienter_at, terrain, other, area_m, queries, seed, progress)
    rows = [{"of": name, **row} for row in rows]
    options.print_tables(rows, _TABLES)
    files = [file for one in wanted for file in one.files]
    write_record(record, rows, terrain=terrain, bounds_deg=area_deg, files=files)


def photograph_rows(
    orienter_at: _OrienterAt, photographs: Sequence[Photograph], progress: Progress
) -> list[Row]:
    """Return a row for each photograph, and one for each kind."""
    rows = list[Row]()
    for one in photographs:
        given = one.elevation_m, one.given_fov_deg
        found = _oriented(orienter_at, one.photo, one.lonlat, *given)
        about = {"measured": "photo", "photo": one.name, "kind": one.kind}
        rows.append(about | figures_of(found, one.heading_deg, one.fov_deg))
        progress(len(rows), len(photographs))
    for kind in dict.fromkeys(one.kind for one in photographs):
        some = [row for row in rows if row.get("kind") == kind]
        about = {"measured": "photos", "group": kind}
        rows.append(about | summarize(some, is_strange=kind != LOCATE))
    return rows


def made_rows(
    orienter_at: _OrienterAt,
    terrain: HeightField,
    strange: HeightField | None,
    area: Rectangle,
    count: int,
    seed: int,
    progress: Progress,
) -> list[Row]:
    """Return the rows of all that is made.

    Photos, strangers, labels, pixels and a webcam are made.
    """
    few = -(-count // 10)
    whole = 2 + len(UNMARKED) + (strange is not None)
    steps, total = itertools.count(1), whole * count + len(NOTING) * few
    to_lonlat = terrain.frame.to_lonlat

    def find(query: Path | PhotoSkyline, lonlat: LonLat) -> Orientation:
        found = _oriented(orienter_at, query, lonlat)
        progress(next(steps), total)
        return found

    def refused(measured: str, group: str, given: Iterable[tuple[Query, LonLat]]) -> Row:
        found = [figures_of(find(query.skyline, lonlat)) for (query,), lonlat in given]
        return {"measured": measured, "group": group} | summarize(found, is_strange=True)

    seen = perturbed(terrain, seed=seed)
    rng = np.random.default_rng(seed)
    held = [
        (query, find(query.skyline, to_lonlat(*query.truth.beside_m(rng))))
        for query in make_queries(seen, area, count, seed)
    ]
    rows: list[Row] = [*_by_distance(terrain, held)]
    for kind in UNMARKED:
        made = make_kind(kind, seen, area, count, seed + 3)
        true = ((query, query[0].truth.lonlat(terrain.frame)) for query in made)
        rows.append(refused("unmarked", kind, true))
    if strange is not None:
        made = make_kind(STRANGERS, terrain, area, count, seed + 1, strange)
        anywhere_m = ((rng.uniform(area[0], area[2]), rng.uniform(area[1], area[3])) for _ in made)
        anywhere = (to_lonlat(*place_m) for place_m in anywhere_m)
        rows.append(refused("strangers", ALL, zip(made, anywhere, strict=True)))
    rows += height_rows(find, terrain, seen, area, few, seed)
    rows += _sight_rows(terrain, seen, make_queries(terrain, area, count, seed + 2), held)
    far = (query for query, _ in held if query.distance_m > 2000.0)
    rows.append(webcam_row(find, terrain, seen, next(far, held[0][0]), count, seed))
    return [{**row, "km2": square_km(area)} for row in rows]


def _sight_rows(
    terrain: HeightField, seen: HeightField, own: Sequence[SyntheticQuery], held: Sequence[_Held]
) -> Iterator[Row]:
    """Yield rows of summits' names and of pixels' places.

    Photos show the model itself or another one, with true poses or with those found.
    """
    exact: list[Posed] = [(query, None) for query in own]
    given: list[Posed] = [(query, None) for query, _ in held]
    answered: list[Posed] = [(query, one.pose) for query, one in held if one.answer is not None]
    # Places in pixels are compared for one photo in ten: each takes seconds.
    for row_of, share in ((label_row, 1), (pixel_row, 10)):
        for model, posed in ((terrain, exact), (seen, given), (seen, answered)):
            if posed:
                yield row_of(terrain, model, posed[: -(-len(held) // share)])


def figures_of(
    found: Orientation, heading_deg: float | None = None, fov_deg: float | None = None
) -> dict[str, Any]:
    """Return the figures of an orientation.

    It is compared with the true angles, if known.
    """
    pose = found.pose
    off_deg = fov_off = None
    if pose is not None and heading_deg is not None:
        off_deg = float(angle_between_deg(pose.heading_deg, heading_deg))
    if pose is not None and fov_deg is not None:
        fov_off = pose.fov_deg / fov_deg - 1.0
    return {
        "answered": found.answer is not None,
        "off_deg": off_deg,
        "sd_deg": found.heading_sd_deg,
        "fov_off": fov_off,
        "confidence": found.confidence,
        "moved_m": found.moved_m,
        "seconds": found.seconds,
        "refusal": found.refusal,
    }


def summarize(rows: Sequence[Row], *, is_strange: bool = False) -> dict[str, Any]:
    """Return how many photos are answered, and how well.

    An answer to a stranger is wrong.
    """
    answered = [row for row in rows if row["answered"]]
    known = [row for row in answered if row["off_deg"] is not None]
    off, sd = (np.array([row[key] for row in known]) for key in ("off_deg", "sd_deg"))
    fov = [abs(row["fov_off"]) for row in answered if row["fov_off"] is not None]
    line: dict[str, Any] = {
        "n": len(rows),
        "answered": len(answered),
        "wrong": len(answered) if is_strange else int((off > RIGHT_DEG).sum()),
        "strongest": max((row["confidence"] for row in rows), default=None),
        "seconds": float(np.median([row["seconds"] for row in rows])),
    }
    if known and not is_strange:
        line |= {
            "within_0.3_deg": float((off <= 0.3).mean()),
            "within_1_deg": float((off <= RIGHT_DEG).mean()),
            "median_deg": float(np.median(off)),
            "p95_deg": float(np.quantile(off, 0.95)),
            "median_sd_deg": float(np.median(sd)),
            "within_2_sd": float((off <= 2.0 * sd).mean()),
        }
    if fov and not is_strange:
        line["fov_within_3_%"] = float((np.array(fov) <= 0.03).mean())
    return line


def webcam_row(
    find: Find,
    terrain: HeightField,
    seen: HeightField,
    query: SyntheticQuery,
    count: int,
    seed: int,
) -> Row:
    """Return how steady the headings of a fixed camera's frames are.

    Weather and season differ from frame to frame. In the fog of every tenth frame 2 % of the
    contrast is left at half the distance of the nearest skyline, or nearer.
    """
    truth = query.truth
    camera = truth.camera()
    eyes = at_elevation(seen, truth.easting_m, truth.northing_m, truth.eye_elevation_m)
    lonlat = terrain.frame.to_lonlat(truth.easting_m + BESIDE_M, truth.northing_m)
    rng = np.random.default_rng(seed)
    found = list[Orientation]()
    fog = np.arange(count) % 10 == 9
    with DepthRenderer(seen, 2048) as renderer, TemporaryDirectory() as folder:
        away_m = distance_along(renderer.depth_images(eyes, 0), camera.rays())
        nearest_m = float(np.where(np.isfinite(away_m), away_m, 0.0).max(axis=0).min())
        for number in range(count):
            scenery = Scenery(
                visibility_m=float(np.exp(rng.uniform(np.log(20_000.0), np.log(120_000.0)))),
                snow_line_m=float(rng.uniform(1200.0, 3500.0)),
                clouds=float(rng.uniform(0.0, 0.7)),
                fog_m=float(rng.uniform(0.1, 0.5)) * nearest_m if fog[number] else math.inf,
            )
            file = Path(folder) / f"{number:04}.jpg"
            frame = photograph(renderer, eyes, 0, camera, seed + number, scenery)
            Image.fromarray(frame).save(file, quality=92)
            found.append(find(file, lonlat))
    answered = np.array([one.answer is not None for one in found])
    clear = [one.pose for one, is_clear in zip(found, answered & ~fog, strict=True) if is_clear]
    off_deg = (
        wrapped_deg(pose.grid_heading_deg - truth.grid_heading_deg) for pose in clear if pose
    )
    turned = np.array(list(off_deg))
    middle = float(np.median(turned)) if len(turned) else math.nan
    spread = np.abs(turned - middle)
    return {
        "measured": "webcam",
        "skyline_m": query.distance_m,
        "nearest_m": nearest_m,
        "frames": int((~fog).sum()),
        "answered": len(clear),
        "within_0.1_deg": float((spread <= 0.1).mean()) if clear else None,
        "spread_deg": float(np.std(turned)) if clear else None,
        "greatest_deg": float(spread.max(initial=0.0)),
        "off_deg": abs(middle),
        "fog": int(fog.sum()),
        "fog_answered": int((answered & fog).sum()),
        "seconds": float(np.median([one.seconds for one in found])),
    }


def _oriented(
    orienter_at: _OrienterAt,
    query: Path | PhotoSkyline,
    lonlat: LonLat,
    elevation_m: float | None = None,
    fov_deg: float | None = None,
) -> Orientation:
    """Orient a query at a place.

    A query that cannot be read or oriented counts as refused.
    """
    try:
        lon, lat = map(float, lonlat)
        place = KnownPosition(lon, lat, elevation_m, DEFAULT_POSITION_SD_M)
        return orienter_at(place).orient(query, fov_deg)
    except SkylineError as error:
        blank = PhotoSkyline(np.full(1, np.nan), np.zeros(1), 1, 1)
        said = str(error)
        if isinstance(query, Path):
            said = said.replace(str(query), query.stem)
        return Orientation(blank, None, refusal=said)


def _by_distance(terrain: HeightField, held: Sequence[_Held]) -> list[dict[str, Any]]:
    """Return rows of made photos, by distance and of those sharply held."""
    figures = [
        figures_of(found, query.truth.heading_deg(terrain.frame), query.truth.fov_deg)
        for query, found in held
    ]
    members = dict(groups([query.distance_m for query, _ in held], by_thirds=False))
    sharp = [number for number, one in enumerate(figures) if one["sd_deg"] <= SHARP_DEG]
    members |= {f"sd <= {SHARP_DEG:g}": sharp} if sharp else {}
    return [
        {"measured": "made photos", "group": name} | summarize([figures[k] for k in some])
        for name, some in members.items()
    ]
