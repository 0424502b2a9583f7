"""Real photographs: skylines, places, the stages that lost places, and masks."""

import hashlib
import math
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from PIL import Image
from typer import Option

from skyline import (
    HeightField,
    InputError,
    Matcher,
    MatchResult,
    Narrowing,
    PhotoSkyline,
    Pose,
    Viewer,
    read_dem,
    read_skyline,
)
from skyline.angles import wrapped_deg
from skyline.arrays import Float64Array
from skyline.cli.terminal import Terminal
from skyline.files.disk import write_whole
from skyline.geodesy.bounds import Bounds
from skyline.geodesy.map_frame import geodesic_m
from skyline.photo.read import read_picture
from skyline.pose.pose import RIGHT_WITHIN_M
from skyline.report.html import figures, page, picture, section, table
from skyline.report.overlay import draw_overlay
from skyline.survey.plans import map_bounds
from skyline.terrain.provenance import DemOptions
from skyline_bench import options
from skyline_bench.measuring import Row, shown, square_km, timed
from skyline_bench.queries.manifest import EXTRACT, KINDS, LOCATE, Photograph, read_manifest
from skyline_bench.records import write_record
from skyline_bench.search.stores import BuiltStore, StoreSpec

_COLUMNS = """photo kind km2 trusted right_columns=right error_m rank
    heading_error_deg=heading_off confidence answered gps_off_m=GPS_off_m lost=lost_by seconds=s"""

_SUMMARY = """kind km2 photographs=n within_200m answered answered_200m answered_right
    right_columns mostly_wrong no_skyline"""

_SAME_WAY_DEG = 10.0
"""A pose whose heading is off by more looks another way than the photograph."""


@dataclass(slots=True)
class Measured:
    """A photograph, and what was found of it."""

    photograph: Photograph
    figures: dict[str, Any]  # The row of the table
    skyline: PhotoSkyline | None = None  # None where no skyline was found
    row_px: Float64Array | None = None  # (W,); the true skyline, where it is known
    best: Pose | None = None
    searched: tuple[str, str] | None = None  # The store's name and digest


def photos(
    manifest: Annotated[
        Path,
        options.read_argument("MANIFEST.csv", "Photographs and what is true of them."),
    ],
    dem: Annotated[
        list[str] | None,
        options.read_argument("DEM...", "Their elevation model; none to extract alone."),
    ] = None,
    folder: options.Folder = None,
    side_km: Annotated[
        float | None,
        Option(
            min=0.1,
            help="Side of the square about a photograph that is searched: 22, or 4 with --quick.",
        ),
    ] = None,
    store: Annotated[
        Path | None,
        options.read_option("STORE.h5", "Search this store instead of squares."),
    ] = None,
    use_gps: Annotated[
        bool, Option("--use-gps", help="Let the photographs' own positions draw the search.")
    ] = False,
    page_file: Annotated[
        Path | None, options.new_file("Draw each photograph's skylines, as HTML.", "--page")
    ] = None,
    record: options.Record = None,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Real photographs: their skylines, their places, and which stage lost a place.

    docs/howto/comparing-grids.md has the columns of a manifest.

    An area takes a minute to build, a photograph 10 s, one that is lost a minute.
    In the tables, n is the number of photographs, and km2 the area searched.
    """
    wanted = read_manifest(manifest)
    located = any(one.kind != EXTRACT for one in wanted)
    if located and not dem:
        raise InputError(f"{manifest} has photographs to locate; give their elevation model too")
    if store and side_km:
        raise InputError("--store is searched whole, and --side-km is of squares; give one of them")
    terrain = read_dem(dem, DemOptions(crs=crs)) if located and dem else None
    side_m = 1000.0 * (side_km or (4.0 if quick else 22.0))
    sections = list[str]()
    found = dict[Photograph, Measured]()
    with options.store_folder(folder) as place, Terminal().progress("photographs") as progress:
        for measured, viewer in measure(wanted, terrain, place, side_m, store, use_gps):
            found[measured.photograph] = measured
            if page_file is not None:
                sections.append(_section(measured, viewer))
            progress(len(found), len(wanted))
    about = {"manifest": manifest.stem, "use_gps": use_gps}
    rows: list[Row] = [about | found[one].figures for one in wanted]
    summary = [about | row for row in summarize(rows)]
    options.print_rows(rows, _COLUMNS)
    options.print_rows(summary, _SUMMARY)
    stores = dict(one.searched for one in found.values() if one.searched)
    files = [file for one in wanted for file in one.files]
    write_record(record, rows, {"photos": summary}, terrain=terrain, stores=stores, files=files)
    if page_file is not None:
        lead = f"{len(rows)} photographs of {manifest.name}."
        write_whole(page_file, page("Photographs", lead, sections))


def _section(measured: Measured, viewer: Viewer | None) -> str:
    """Return a photograph's section, with a drawing of any skyline found."""
    known = ([name, shown(value)] for name, value in measured.figures.items() if value is not None)
    parts = [table(("", ""), list(known))]
    if measured.skyline is not None:
        sight = None
        if viewer is not None and measured.best is not None:
            sight = viewer.look(measured.best, measured.skyline)
        photo = read_picture(measured.photograph.photo)
        drawn, _ = draw_overlay(measured.skyline, photo, measured.best, sight)
        parts.insert(0, figures([picture(drawn, "Found, and rendered at the best candidate.")]))
    return section(measured.photograph.name, parts)


def measure(
    photographs: Sequence[Photograph],
    terrain: HeightField | None,
    folder: Path,
    side_m: float,
    store: Path | None = None,
    use_gps: bool = False,
) -> Iterator[tuple[Measured, Viewer | None]]:
    """Yield each photograph measured, and what renders its surroundings.

    Squares of a side are searched about the photographs, or one store; the terrain is not needed
    where nothing is located. The squares' stores are kept in a folder and found again. ``use_gps``
    lets the photographs' own positions pull the search. Raises `InputError` if a place is not on
    the elevation model, or if there is none.
    """
    for one in photographs:
        if one.kind == EXTRACT:
            yield _extracted(one), None
    located = [one for one in photographs if one.kind != EXTRACT]
    for group in _groups(located, math.inf if store else 0.25 * side_m):
        if terrain is None:
            raise InputError("photographs are to be located; give the elevation model too")
        if store is not None:
            name = store.stem
            built = BuiltStore.read(StoreSpec(path=store), store)
        else:
            name = f"{group[0].name}-area"
            (folder / name).mkdir(exist_ok=True)
            area_deg = _area_deg(terrain, group[0], side_m)
            built = StoreSpec().build(terrain, folder / name, area_deg)
        km2 = square_km(map_bounds(terrain, built.bounds_deg))
        with Matcher(built.path, terrain) as matcher, Viewer(terrain) as viewer:
            for one in group:
                measured = _located(one, matcher, viewer, use_gps)
                measured.searched = name, built.digest
                measured.figures |= {"searched": name, "km2": km2}
                yield measured, viewer


def summarize(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return one row for each kind of photograph.

    It says how many were found, answered and right.
    """
    table = []
    for kind in sorted({row["kind"] for row in rows}, key=KINDS.index):
        some = [row for row in rows if row["kind"] == kind]
        line: dict[str, Any] = {"kind": kind, "photographs": len(some)}
        if kind != EXTRACT:
            sizes = [row["km2"] for row in some if "km2" in row]
            line["km2"] = float(np.mean(sizes)) if sizes else None
            answered = [row for row in some if row.get("answered")]
            true = [row["error_m"] <= row["within_m"] for row in answered]
            line |= {
                "within_200m": sum(row.get("rank") == 1 for row in some) / len(some),
                "answered": len(answered) / len(some),
                "answered_200m": sum(row["within_m"] == RIGHT_WITHIN_M for row in answered)
                / len(some),
                "answered_right": sum(true) / len(true) if true and kind == LOCATE else None,
            }
        shares = [row["right_columns"] for row in some if row.get("right_columns") is not None]
        line |= {
            "right_columns": float(np.mean(shares)) if shares else None,
            "mostly_wrong": sum(share < 0.5 for share in shares) if shares else None,
            "no_skyline": sum(row.get("trusted") is None for row in some),
        }
        table.append(line)
    return table


def _extracted(one: Photograph) -> Measured:
    """Read a photograph, and compare its skyline with any known truth."""
    figures: dict[str, Any] = {"photo": one.name, "kind": one.kind}
    try:
        skyline, timing = timed(lambda: read_skyline(one.photo, one.given_fov_deg))
    except InputError as error:
        refusal = str(error).replace(str(one.photo), one.name)
        return Measured(one, figures | {"refusal": refusal, "lost": "extraction"})
    figures |= {"seconds": timing.seconds, "trusted": float(skyline.trusted.mean())}
    if one.given_eye_height_m is not None:
        skyline = replace(skyline, eye_height_m=one.given_eye_height_m)
    true_px = one.true_row_px(skyline.width_px, skyline.height_px)
    if true_px is not None:
        columns = count_columns(skyline, true_px)
        figures |= {
            "right_columns": columns.right / columns.trusted if columns.trusted else None,
            "found_columns": columns.right / max(columns.known, 1),
        }
    return Measured(one, figures, skyline, true_px)


class ColumnCounts(NamedTuple):
    """Numbers of columns with a true skyline."""

    trusted: int
    right: int  # Trusted ones within 1 % of the photo's height
    far: int  # Trusted ones that are off by more than 3 %
    known: int  # All


def count_columns(skyline: PhotoSkyline, true_px: Float64Array) -> ColumnCounts:
    """Count the columns with a true skyline."""
    known = np.isfinite(true_px)
    off = np.abs(skyline.row_px - true_px)[known & skyline.trusted] / skyline.height_px
    right = int((off <= 0.01).sum())
    far = int((off > 0.03).sum())
    return ColumnCounts(off.size, right, far, int(known.sum()))


def _located(one: Photograph, matcher: Matcher, viewer: Viewer, use_gps: bool) -> Measured:
    measured = _extracted(one)
    if measured.skyline is None:
        return measured
    skyline = measured.skyline
    result = matcher.match(skyline, narrowing=Narrowing(use_gps=use_gps))
    best = next(iter(result.candidates), None)
    errors = [_off_m(one, place, matcher) for place in result.candidates]
    right = [rank for rank, off in enumerate(errors, start=1) if off <= RIGHT_WITHIN_M]
    exif = result.exif
    measured.figures |= {
        "seconds": measured.figures["seconds"] + result.seconds,
        "answered": result.answer is not None,
        "within_m": result.within_m,
        "error_m": errors[0] if errors else None,
        "rank": right[0] if right else None,
        "heading_error_deg": None if best is None else _turn_deg(one, best),
        "fov_given_deg": skyline.fov_deg,
        "fov_found_deg": None if best is None else best.fov_deg,
        "confidence": None if best is None else best.confidence,
        "confidence_1km": None if best is None else best.confidence_1km,
        "gps_off_m": None if exif is None else exif["distance_m"],
        "refusal": result.refusal,
        "lost": None,
    }
    measured.best = best
    if one.kind == LOCATE and not (right and right[0] == 1 and result.answer is not None):
        measured.figures |= _stages(one, measured, result, matcher, viewer)
    return measured


def _stages(
    one: Photograph, measured: Measured, result: MatchResult, matcher: Matcher, viewer: Viewer
) -> dict[str, Any]:
    """Return the stage that lost a place.

    The truth is given to one later stage after the other.
    docs/howto/comparing-grids.md says what each stage means.
    """
    skyline = result.skyline
    if measured.figures["rank"] == 1:
        return {"lost": "confidence"}
    refused = result.refusal is not None and not result.candidates
    if refused or _found_by_truth(one, skyline, measured.row_px, matcher):
        return {"lost": "extraction"}
    near = Narrowing(near=(*one.lonlat, 0.3))
    try:
        there = next(iter(matcher.match(skyline, narrowing=near).candidates), None)
    except InputError:
        there = None
    stage = "ranking"
    if there is None or abs(_turn_deg(one, there) or 0.0) > _SAME_WAY_DEG:
        fitted = _fitted(one, skyline, matcher, viewer)
        stage = "skyline" if fitted is None else "pose"
        there = fitted or there
    if there is None:
        return {"lost": "skyline"}
    gap_deg = viewer.look(there, skyline).median_gap_deg
    # A found skyline so far from what the model shows at the true place is not the model's.
    if gap_deg is None or gap_deg > 0.5:
        stage = "skyline"
    elif stage == "ranking" and there.cost < result.candidates[0].cost:
        stage = "search"
    return {
        "lost": stage,
        "true_place_gap_deg": gap_deg,
        "true_place_behind": there.cost - result.candidates[0].cost,
    }


def _found_by_truth(
    one: Photograph, skyline: PhotoSkyline, true_px: Float64Array | None, matcher: Matcher
) -> bool:
    """Return whether the true skyline, where known, leads to the place."""
    if true_px is None:
        return False
    true = replace(skyline, row_px=true_px, trust=np.isfinite(true_px).astype(float))
    found = matcher.match(true).candidates
    return bool(found) and _off_m(one, found[0], matcher) <= RIGHT_WITHIN_M


def _fitted(
    one: Photograph, skyline: PhotoSkyline, matcher: Matcher, viewer: Viewer
) -> Pose | None:
    """Return the fit of the true pose; None if unknown or lost."""
    if one.heading_deg is None:
        return None
    lon, lat = one.lonlat
    ground_m = float(viewer.terrain.height_at(lon=lon, lat=lat))
    above_m = 2.0 if one.elevation_m is None else max(0.0, one.elevation_m - ground_m)
    pose = viewer.pose(
        lon=lon, lat=lat, heading_deg=one.heading_deg, pitch_deg=one.pitch_deg or 0.0,
        roll_deg=one.roll_deg or 0.0, fov_deg=one.fov_deg or skyline.fov_deg or 60.0,
        eye_height_m=above_m,
    )  # fmt: skip
    fitted = next(iter(matcher.fit(skyline, pose).candidates), None)
    if fitted is None or _off_m(one, fitted, matcher) > RIGHT_WITHIN_M:
        return None
    return fitted if abs(_turn_deg(one, fitted) or 0.0) <= _SAME_WAY_DEG else None


def _off_m(one: Photograph, place: Pose, matcher: Matcher) -> float:
    east, north = matcher.frame.from_lonlat(*one.lonlat)
    return float(np.hypot(place.easting_m - east, place.northing_m - north))


def _turn_deg(one: Photograph, place: Pose) -> float | None:
    if one.heading_deg is None:
        return None
    return float(wrapped_deg(place.heading_deg - one.heading_deg))


def _groups(photographs: Sequence[Photograph], apart_m: float) -> Iterator[list[Photograph]]:
    """Yield groups of photographs that share an area.

    Groups are in order of their first photographs.
    """
    left = list(photographs)
    while left:
        first = left[0]
        group = [one for one in left if geodesic_m(*first.lonlat, *one.lonlat) <= apart_m]
        yield group
        left = [one for one in left if one not in group]


def _area_deg(terrain: HeightField, first: Photograph, side_m: float) -> Bounds:
    """Return west, south, east and north of an area, degrees.

    The given place is in the area, but not in its middle.
    """
    generator = np.random.default_rng(zlib.crc32(first.name.encode()))
    lon, lat = first.lonlat
    m_per_deg = 111_320.0 * np.array([math.cos(math.radians(lat)), 1.0])
    off = generator.uniform(-0.27, 0.27, 2) * side_m / m_per_deg
    middle = np.array([lon, lat]) + off
    half = side_m / 2.0 / m_per_deg
    west, south, east, north = (float(value) for value in (*(middle - half), *(middle + half)))
    map_bounds(terrain, (west, south, east, north))
    return west, south, east, north


def sky_masks(
    folder: Annotated[
        Path,
        options.read_argument("FOLDER", "NAME.jpg and NAME.mask.png, white = mountain."),
    ],
    record: options.Record = None,
) -> None:
    """Skylines extracted from real photographs, against masks drawn by people.

    Names are split in two by their hash: one half to develop on, and one that is
    only ever measured. Columns whose mask has no edge are left out.
    """

    def split_by(mask: Path) -> str:
        return hashlib.sha256(mask.name.removesuffix(".mask.png").encode()).hexdigest()

    masks = sorted(folder.glob("*.mask.png"), key=split_by)
    if len(masks) < 2:
        raise InputError(f"{folder} has {len(masks)} masks NAME.mask.png; expected two or more")
    middle = len(masks) // 2
    rows = list[Row]()
    with Terminal().progress("photographs") as progress:
        for half, some in {"development": masks[:middle], "held out": masks[middle:]}.items():
            counts = []
            seconds = []
            for mask in some:
                photo = mask.with_name(mask.name.replace(".mask.png", ".jpg"))
                counted, timing = timed(partial(_columns, Photograph(photo, EXTRACT, mask=mask)))
                counts.append(counted)
                seconds.append(timing.cpu_seconds)
                progress(len(rows) * len(some) + len(counts), len(masks))
            trusted, right, far, known = np.array(counts).T
            rows.append(
                {
                    "half": half,
                    "photos": len(counts),
                    "refused": int((trusted == 0).sum()),
                    "within": float(right.sum() / max(trusted.sum(), 1)),
                    "far_off": float(far.sum() / max(trusted.sum(), 1)),
                    "trusted": float(trusted.sum() / max(known.sum(), 1)),
                    "mostly_wrong": int((2 * right < trusted).sum()),
                    "seconds": float(np.mean(seconds)),
                }
            )
    columns = "half photos=n refused within far_off trusted mostly_wrong seconds"
    options.report(record, rows, columns)


def _columns(photo: Photograph) -> ColumnCounts:
    """Return the figures of `count_columns`.

    If the photo is refused, no column is trusted.
    """
    measured = _extracted(photo)
    if measured.skyline is not None and measured.row_px is not None:
        return count_columns(measured.skyline, measured.row_px)
    with Image.open(photo.photo) as picture:
        true_px = photo.true_row_px(*picture.size)
    known = 0 if true_px is None else int(np.isfinite(true_px).sum())
    return ColumnCounts(trusted=0, right=0, far=0, known=known)
