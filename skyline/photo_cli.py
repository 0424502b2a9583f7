"""``skyline match extract``: photos in, places and skylines out."""

import hashlib
import json
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from skyline.console import (
    Scheduler,
    Surfaces,
    Workers,
    complain,
    parse_bounds,
    patience,
    remark,
    runner_of,
    told,
)
from skyline.describe import describe_match, describe_together, match_in_words, together_in_words
from skyline.errors import InputError, SkylineError
from skyline.matching import Narrowing
from skyline.matching.match_config import MatchConfig
from skyline.photo import Projection, QuerySkyline, extract_photo, write_overlay, write_trace
from skyline.pipeline import (
    FULL,
    MATCHERS,
    Matcher,
    MatchResult,
    Query,
    listed,
    match_many,
    matched,
    report_matches,
)
from skyline.pipeline.opened import terrain_at_hand
from skyline.report.exports import EXPORTS, check_export, export_matches
from skyline.report.peaks import Peaks, read_peaks
from skyline.report.records import FailureRecord
from skyline.report.results import RESULTS, Results, open_results, row_of
from skyline.terrain.tiles import absolute_name

_DEFAULTS = MatchConfig()

# Groups of options in the help, after those that most people need.
_PHOTOS, _CAMERA = "The photos", "Where the camera stood, and how"
_SEARCH, _OUTPUT = "The search", "More files to write"

FieldOfView = Annotated[
    float | None,
    typer.Option(help="Horizontal field of view; by default from the photo's EXIF or XMP."),
]
PhotoProjection = Annotated[
    Projection | None,
    typer.Option(
        "--projection",
        help="Projection of a panorama, usually cylindrical.",
        rich_help_panel=_PHOTOS,
    ),
]
SkyModel = Annotated[
    Path | None,
    typer.Option(metavar="ONNX", help="Your own sky segmentation model.", rich_help_panel=_PHOTOS),
]


def match(
    store: Annotated[Path, typer.Argument(metavar="STORE.h5")],
    query: Annotated[
        list[Path],
        typer.Argument(
            metavar="QUERY...",
            help="Photos, folders of them, sky masks (white = sky), CSV traces or lists.",
        ),
    ],
    fov_deg: FieldOfView = None,
    near: Annotated[
        str | None,
        typer.Option(metavar="LON,LAT,KM", help="Search only within so many km of a point."),
    ] = None,
    dem: Annotated[
        list[str] | None,
        typer.Option(metavar="DEM", help="The store's DEM, if it has moved; repeat for each tile."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write a page with pictures and maps.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    projection: PhotoProjection = None,
    bounds: Annotated[
        str | None,
        typer.Option(
            metavar="W,S,E,N", help="Search only in this box, in degrees.", rich_help_panel=_CAMERA
        ),
    ] = None,
    heading: Annotated[
        str | None,
        typer.Option(
            metavar="DEG,SLACK",
            help="Camera heading from true north, within SLACK degrees.",
            rich_help_panel=_CAMERA,
        ),
    ] = None,
    elevation: Annotated[
        str | None,
        typer.Option(
            metavar="LOW,HIGH",
            help="The camera stood between these elevations, in metres.",
            rich_help_panel=_CAMERA,
        ),
    ] = None,
    eye_height: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Camera above the ground; by default it is found.",
            rich_help_panel=_CAMERA,
        ),
    ] = None,
    fov_slack: Annotated[
        float,
        typer.Option(
            help="Standard deviation of the field of view, as a share of it.",
            rich_help_panel=_PHOTOS,
        ),
    ] = _DEFAULTS.fov_slack,
    use_gps: Annotated[
        bool,
        typer.Option(
            "--use-gps",
            help="Let each photo's own GPS position draw its search, never bind it.",
            rich_help_panel=_CAMERA,
        ),
    ] = False,
    same_place: Annotated[
        bool,
        typer.Option(
            "--same-place",
            help="The photos were taken at one place: find it from all of them.",
            rich_help_panel=_PHOTOS,
        ),
    ] = False,
    surface: Surfaces = None,
    matcher: Annotated[
        str, typer.Option(help=f"One of {', '.join(MATCHERS)}.", rich_help_panel=_SEARCH)
    ] = FULL,
    no_refine: Annotated[
        bool,
        typer.Option(
            "--no-refine", help="Skip refinement: faster, less exact.", rich_help_panel=_SEARCH
        ),
    ] = False,
    sky_model: SkyModel = None,
    min_confidence: Annotated[
        float, typer.Option(help="Least confidence for an answer.", rich_help_panel=_SEARCH)
    ] = _DEFAULTS.min_confidence,
    top: Annotated[
        int, typer.Option(help="Number of candidates to print.", rich_help_panel=_SEARCH)
    ] = 5,
    results: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help=f"Write a row a photo as it is done ({', '.join(RESULTS)}). Photos that the file "
            "has are not matched again.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    export: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help=f"Write the candidates, by the suffix: {', '.join(EXPORTS)}; may be repeated.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    peaks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Peaks to name in the report: GeoJSON, or CSV with name,lon,lat[,height_m].",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
) -> None:
    """Find where photos were taken and in which direction the camera looked."""
    exports = export or []
    if peaks is not None and report is None:
        raise InputError(f"--peaks {peaks} names peaks in a report; give --report DIR too")
    config = replace(
        _DEFAULTS, refine=not no_refine, min_confidence=min_confidence, fov_slack=fov_slack
    )
    if use_gps and no_refine:
        raise InputError("--use-gps acts in refinement; leave one of --use-gps, --no-refine out")
    narrowing = replace(
        _narrowing(near, bounds, heading, elevation), eye_height_m=eye_height, use_gps=use_gps
    )
    common = Query("", fov_deg, None, projection, sky_model, narrowing)
    queries = list(listed(query, common))
    _check_outputs([*exports, results], [store, *query, *(Path(one.path) for one in queries)])
    for path in exports:
        check_export(path)
    if same_place:
        _check_together(no_refine, matcher, results, workers, scheduler)
    surfaces = tuple(absolute_name(one) for one in surface or ())
    search = _search(store, matcher, config, common, *surfaces)
    kept = _Kept(results, search, as_json, top)
    queries = kept.left(queries)
    refused = _refused(queries)
    usable = [one for one in queries if one not in refused]
    skylines = _read_together(usable) if same_place else []
    if not usable:
        kept.tell_all(queries, refused, iter(()))
        raise typer.Exit(kept.exit_code)
    # Workers may have another working directory.
    tiles = tuple(absolute_name(one) for one in dem or ())
    asked = (str(store), tiles or None, matcher, config, None, surfaces or None)
    opened = time.perf_counter()
    with patience(f"opening {store} and its elevation model"):
        matching = Matcher(*asked)
    kept.loading_s = time.perf_counter() - opened
    gazetteer = None if peaks is None else read_peaks(peaks, matching.frame)
    if same_place:
        matches = _tell_together(matching, skylines, top, as_json, kept.loading_s)
        failed = len(matches) < len(queries)
        kept.exit_code = InputError.exit_code if failed else 0
    else:
        with runner_of(workers, scheduler) as runner:
            if runner is None:
                found = _matched_here(matching, usable, top)
            else:
                found = match_many(runner, asked, usable, top)
            matches = kept.tell_all(queries, refused, found)
    done = [f"{matching.rows} {matching.holds} of the store were searched."]
    if same_place:
        done.append(f"{len(skylines)} photos of one place were matched together.")
    _write(matching, matches, done, exports, report, gazetteer)
    if kept.exit_code:
        raise typer.Exit(kept.exit_code)


class _Kept:
    """Prints what is found of each query, and keeps it in a file where one is asked for."""

    def __init__(self, results: Path | None, search: str, as_json: bool, top: int) -> None:
        self.loading_s, self.exit_code = 0.0, 0
        self._path, self._search, self._as_json, self._top = results, search, as_json, top
        self._file: Results | None = None
        self._had: set[str] = set()
        if results is not None:
            self._file, self._had = open_results(results, search)

    def left(self, queries: list[Query]) -> list[Query]:
        """Return the queries that the file does not have, and say how many those are not."""
        left = [one for one in queries if one.path not in self._had]
        if len(left) < len(queries):
            done = len(queries) - len(left)
            remark(f"{self._path}: {done} of {len(queries)} are there already")
        return left

    def tell_all(
        self,
        queries: Sequence[Query],
        refused: Mapping[Query, SkylineError],
        found: Iterator[MatchResult | SkylineError],
    ) -> list[tuple[Path, MatchResult]]:
        """Tell of all queries in order, as they come; return those that could be matched."""
        matches: list[tuple[Path, MatchResult]] = []
        progress = told("matching")
        for done, one in enumerate(queries):
            progress(done, len(queries))
            with nullcontext() if matches else patience(f"matching {one.path}"):
                result = refused.get(one) or next(found)
            if isinstance(result, SkylineError):
                self._tell_failed(one, result, is_said=one in refused)
                continue
            matches.append((Path(one.path), result))
            record = describe_match(one.path, result, self.loading_s)
            said = match_in_words(record, self._top)
            typer.echo(json.dumps(record) if self._as_json else "\n".join(said))
            if self._file is not None:
                self._file.add(row_of(record, self._search))
        progress(len(queries), len(queries))
        return matches

    def _tell_failed(self, one: Query, error: SkylineError, is_said: bool) -> None:
        """Tell of a query that cannot be matched; one that was not tried is tried again."""
        self.exit_code = error.exit_code
        record = FailureRecord(query=one.path, error=str(error))
        if not is_said:
            complain(str(error))
        if self._as_json:
            typer.echo(json.dumps(record))
        if self._file is not None and not is_said:
            self._file.add(row_of(record, self._search))


def _check_together(
    no_refine: bool,
    matcher: str,
    results: Path | None,
    workers: int | None,
    scheduler: str | None,
) -> None:
    """Refuse what does not go with photos of one place."""
    if no_refine or matcher != FULL:
        raise InputError(
            "--same-place compares renderings of the terrain; leave --no-refine and --matcher out"
        )
    if results is not None:
        raise InputError("--same-place has one answer, not a row a photo; leave --results out")
    if workers is not None or scheduler is not None:
        raise InputError(
            "--same-place matches in this process; leave --workers and --scheduler out"
        )


def _read_together(queries: Sequence[Query]) -> list[tuple[Query, QuerySkyline]]:
    """Return the photos that can be read, and say of the others why not."""
    read: list[tuple[Query, QuerySkyline]] = []
    for one in queries:
        try:
            read.append((one, one.read()))
        except SkylineError as error:
            complain(str(error))
    if len(read) < 2:
        raise InputError(
            f"--same-place needs two photos or more that can be read, and has {len(read)}; name "
            "more, or leave --same-place out"
        )
    return read


def _tell_together(
    matching: Matcher,
    asked: Sequence[tuple[Query, QuerySkyline]],
    top: int,
    as_json: bool,
    loading_s: float,
) -> list[tuple[Path, MatchResult]]:
    """Tell what was found for photos of one place; return it photo by photo."""
    with patience(f"matching {len(asked)} photos together"):
        found = matching.match_together(
            [skyline for _, skyline in asked], None, top, [one.narrowing for one, _ in asked]
        )
    names = [one.path for one, _ in asked]
    record, said = describe_together(names, found, loading_s), together_in_words(names, found)
    typer.echo(json.dumps(record) if as_json else "\n".join(said))
    return [(Path(one.path), result) for (one, _), result in zip(asked, found.results, strict=True)]


def _write(
    matching: Matcher,
    matches: Sequence[tuple[Path, MatchResult]],
    done: Sequence[str],
    exports: Sequence[Path],
    report: Path | None,
    gazetteer: Peaks | None,
) -> None:
    """Write what was found, where anything was, to the files asked for."""
    for path in exports if matches else ():
        packed = path.suffix.lower() == ".kmz"
        told_of = [matched(one, result, with_photo=packed) for one, result in matches]
        export_matches(path, told_of, matching.frame)
    if report is not None and matches:
        told = (matched(path, result, done) for path, result in matches)
        terrain = matching.terrain or terrain_at_hand(matching.header, "no relief")
        report_matches(report, matching, told, terrain, gazetteer)


def extract(
    photo: Annotated[Path, typer.Argument(metavar="PHOTO")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The trace to write (CSV).")],
    overlay: Annotated[
        Path | None,
        typer.Option(metavar="PNG", help="Also write the photo with its skyline drawn."),
    ] = None,
    fov_deg: FieldOfView = None,
    projection: PhotoProjection = None,
    sky_model: SkyModel = None,
) -> None:
    """Find the skyline in a photo and write it as a trace that a person can correct."""
    _check_outputs([output, overlay], [photo])
    image, skyline = extract_photo(photo, fov_deg, projection=projection, sky_model=sky_model)
    write_trace(skyline, output)
    if overlay is not None:
        write_overlay(image, skyline, overlay)
    trusted = sum(math.isfinite(row) for row in skyline.row_px)
    typer.echo(f"{output}: skyline found in {trusted} of {skyline.width_px} columns")


def _matched_here(
    matching: Matcher, queries: Sequence[Query], top: int
) -> Iterator[MatchResult | SkylineError]:
    """Yield what was found for each query, or why it cannot be matched."""
    for one in queries:
        try:
            yield one.match(matching, top)
        except SkylineError as error:
            yield error


def _narrowing(
    near: str | None, bounds: str | None, heading: str | None, elevation: str | None
) -> Narrowing:
    """Return what is known of where photos were taken; raises `InputError` for what is not so."""
    return Narrowing(
        _numbers("near", near, "LON,LAT,KM", 3),  # type: ignore[arg-type]
        parse_bounds(bounds) if bounds is not None else None,
        _numbers("heading", heading, "DEG,SLACK", 2),  # type: ignore[arg-type]
        _numbers("elevation", elevation, "LOW,HIGH", 2),  # type: ignore[arg-type]
    )


def _numbers(name: str, text: str | None, wanted: str, count: int) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        raise InputError(f"--{name} is `{text}`; expected {count} numbers {wanted}")
    return values


def _search(store: Path, matcher: str, config: MatchConfig, common: Query, *surfaces: str) -> str:
    """Return what tells this search from others: a store, how it is searched, what is known."""
    written = store.stat().st_mtime_ns if store.exists() else 0
    settings = repr((store.name, written, matcher, config, common, *surfaces))
    return hashlib.sha256(settings.encode()).hexdigest()[:12]


def _refused(queries: Sequence[Query]) -> dict[Query, SkylineError]:
    """Return what cannot be matched and why, said at once.

    A store is opened for minutes, and a DEM read: nobody should wait for a wrong name.
    """
    refused: dict[Query, SkylineError] = {}
    for one in queries:
        try:
            one.check()
        except SkylineError as error:
            refused[one] = error
            complain(str(error))
    return refused


def _check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path]) -> None:
    """Raise `InputError` where a file that is written is one that is read."""
    read = [path for path in inputs if path.exists()]
    for path in outputs:
        if path is not None and path.exists() and any(path.samefile(one) for one in read):
            raise InputError(f"{path} is an input; choose another name for the output")
