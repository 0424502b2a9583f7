"""``skyline match``, ``extract`` and ``serve``: photos in, places and skylines out."""

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from typer import Argument, Option

from skyline.build.cluster import runner_of
from skyline.cli.answers import Answers, search_of, tried, write_files
from skyline.cli.console import (
    AsJson,
    Scheduler,
    StoreDem,
    Surfaces,
    Workers,
    panel,
    parse_bounds,
    parse_numbers,
    patience,
    say,
)
from skyline.errors import InputError, MissingFileError, SkylineError
from skyline.match.batch import match_many
from skyline.match.match_config import MatchConfig
from skyline.match.matcher import Matcher
from skyline.match.matchers import FULL, MATCHERS
from skyline.match.narrowing import Narrowing
from skyline.match.queries import Query, listed
from skyline.match.results import MatchResult
from skyline.match.results_file import RESULTS
from skyline.photo.projection import Projection
from skyline.photo.read import extract_photo, write_overlay
from skyline.photo.trace import write_trace
from skyline.report.exports import EXPORTS, check_export
from skyline.report.peaks import read_peaks
from skyline.terrain.rasters import absolute_name

_DEFAULTS = MatchConfig()

# Groups of options in the help, after those that most people need.
_photos, _camera = panel("The photos"), panel("Where the camera stood, and how")
_search, _output = panel("The search"), panel("More files to write")

StoreFile = Annotated[Path, Argument(metavar="STORE.h5")]
FieldOfView = Annotated[
    float | None, Option(help="Horizontal field of view; by default from the photo's EXIF or XMP.")
]
PhotoProjection = Annotated[
    Projection | None,
    _photos("--projection", help="Projection of a panorama, usually cylindrical."),
]
SkyModel = Annotated[Path | None, _photos(metavar="ONNX", help="Your own sky segmentation model.")]


def match(
    store: StoreFile,
    query: Annotated[
        list[Path],
        Argument(
            metavar="QUERY...",
            help="Photos, folders of them, sky masks (white = sky), CSV traces or lists.",
        ),
    ],
    fov_deg: FieldOfView = None,
    near: Annotated[
        str | None, Option(metavar="LON,LAT,KM", help="Search only within so many km of a point.")
    ] = None,
    dem: StoreDem = None,
    report: Annotated[
        Path | None, Option(metavar="DIR", help="Write a page with pictures and maps.")
    ] = None,
    as_json: AsJson = False,
    projection: PhotoProjection = None,
    bounds: Annotated[
        str | None, _camera(metavar="W,S,E,N", help="Search only in this box, in degrees.")
    ] = None,
    heading: Annotated[
        str | None,
        _camera(metavar="DEG,SLACK", help="Camera heading from true north, within SLACK degrees."),
    ] = None,
    elevation: Annotated[
        str | None,
        _camera(metavar="LOW,HIGH", help="The camera stood between these elevations, in metres."),
    ] = None,
    eye_height: Annotated[
        float | None, _camera(metavar="M", help="Camera above the ground; by default it is found.")
    ] = None,
    fov_slack: Annotated[
        float, _photos(help="Standard deviation of the field of view, as a share of it.")
    ] = _DEFAULTS.fov_slack,
    use_gps: Annotated[
        bool,
        _camera(
            "--use-gps", help="Let each photo's own GPS position draw its search, never bind it."
        ),
    ] = False,
    same_place: Annotated[
        bool,
        _photos(
            "--same-place", help="The photos were taken at one place: find it from all of them."
        ),
    ] = False,
    surface: Surfaces = None,
    matcher: Annotated[str, _search(help=f"One of {', '.join(MATCHERS)}.")] = FULL,
    no_refine: Annotated[
        bool, _search("--no-refine", help="Skip refinement: faster, less exact.")
    ] = False,
    sky_model: SkyModel = None,
    min_confidence: Annotated[
        float, _search(help="Least confidence for an answer.")
    ] = _DEFAULTS.min_confidence,
    top: Annotated[int, _search(help="Number of candidates to print.")] = 5,
    results: Annotated[
        Path | None,
        _output(
            metavar="FILE",
            help=f"Write a row a photo as it is done ({', '.join(RESULTS)}). Photos that the file "
            "has are not matched again.",
        ),
    ] = None,
    export: Annotated[
        list[Path] | None,
        _output(
            metavar="FILE",
            help=f"Write the candidates, by the suffix: {', '.join(EXPORTS)}; may be repeated.",
        ),
    ] = None,
    peaks: Annotated[
        Path | None,
        _output(
            metavar="FILE",
            help="Peaks to name in the report: GeoJSON, or CSV with name,lon,lat[,height_m].",
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
    narrowing = Narrowing(
        _numbers("near", near, "LON,LAT,KM", 3),  # type: ignore[arg-type]
        parse_bounds(bounds) if bounds is not None else None,
        _numbers("heading", heading, "DEG,SLACK", 2),  # type: ignore[arg-type]
        _numbers("elevation", elevation, "LOW,HIGH", 2),  # type: ignore[arg-type]
        eye_height,
        use_gps,
    )
    common = Query("", fov_deg, None, projection, sky_model, narrowing)
    queries = list(listed(query, common))
    _check_outputs([*exports, results], [store, *query, *(Path(one.path) for one in queries)])
    for path in exports:
        check_export(path)
    if same_place:
        is_spread = workers is not None or scheduler is not None
        _check_together(no_refine or matcher != FULL, results is not None, is_spread)
    surfaces = tuple(absolute_name(one) for one in surface or ())
    search = search_of(store, matcher, config, common, *surfaces)
    answers = Answers(results, search, as_json, top, bool(exports or report))
    queries = answers.left(queries)
    checked, refused = tried(queries, Query.check)
    usable = [one for one, _ in checked]
    skylines, _ = tried(usable if same_place else [], Query.read)
    if same_place and len(skylines) < 2:
        raise InputError(
            f"--same-place needs two photos or more that can be read, and has {len(skylines)}; "
            "name more, or leave --same-place out"
        )
    if not usable:
        answers.tell_all(queries, refused, iter(()))
        raise typer.Exit(answers.exit_code)
    # Workers may have another working directory.
    tiles = tuple(absolute_name(one) for one in dem or ())
    asked = (str(store), tiles or None, matcher, config, None, surfaces or None)
    opened = time.perf_counter()
    with patience(f"opening {store} and its elevation model"):
        matching = Matcher(*asked)
    answers.loading_s = time.perf_counter() - opened
    gazetteer = None if peaks is None else read_peaks(peaks, matching.frame)
    if same_place:
        matches = answers.tell_together(matching, skylines)
        answers.exit_code = InputError.exit_code if len(matches) < len(queries) else 0
    else:
        with runner_of(workers, scheduler) as runner:
            if runner is None:
                found = _matched_here(matching, usable, top)
            else:
                found = match_many(runner, asked, usable, top)
            matches = answers.tell_all(queries, refused, found)
    write_files(matching, matches, len(skylines), exports, report, gazetteer)
    if answers.exit_code:
        raise typer.Exit(answers.exit_code)


def _check_together(is_unrefined: bool, has_results: bool, is_spread: bool) -> None:
    """Refuse what does not go with photos of one place."""
    for is_given, why in (
        (is_unrefined, "compares renderings of the terrain; leave --no-refine and --matcher out"),
        (has_results, "has one answer, not a row a photo; leave --results out"),
        (is_spread, "matches in this process; leave --workers and --scheduler out"),
    ):
        if is_given:
            raise InputError(f"--same-place {why}")


def extract(
    photo: Annotated[Path, Argument(metavar="PHOTO")],
    output: Annotated[Path, Option("--output", "-o", help="The trace to write (CSV).")],
    overlay: Annotated[
        Path | None, Option(metavar="PNG", help="Also write the photo with its skyline drawn.")
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
    trusted = np.count_nonzero(skyline.trusted)
    say(f"{output}: skyline found in {trusted} of {skyline.width_px} columns")


def serve(
    store: StoreFile,
    photos: Annotated[
        list[Path] | None, Argument(metavar="[PHOTO...]", help="Photos that the page begins with.")
    ] = None,
    dem: StoreDem = None,
    peaks: Annotated[
        Path | None, Option(metavar="FILE.csv", help="Peaks to name: name,lon,lat[,height_m].")
    ] = None,
    port: Annotated[
        int, Option(min=0, max=65535, help="Port of the page; 0 takes any that is free.")
    ] = 8765,
    host: Annotated[
        str, Option(help="Address to listen on; another lets other machines in.")
    ] = "127.0.0.1",
) -> None:
    """Open a page in the browser: drop photos, mend skylines, find places, fit by hand."""
    for photo in photos or ():
        if not photo.is_file():
            raise MissingFileError(f"{photo} does not exist; expected a photo")
    try:
        from skyline.web.engine import Given  # noqa: PLC0415  (an extra)
        from skyline.web.server import serve as serve_page  # noqa: PLC0415
    except ImportError as error:
        raise InputError(
            f"the page needs packages that are not installed ({error.name}); "
            "pip install 'skyline[web]'"
        ) from error
    given = Given(store, tuple(dem or ()), tuple(path.absolute() for path in photos or ()), peaks)
    serve_page(given, host, port)


def _matched_here(
    matching: Matcher, queries: Sequence[Query], top: int
) -> Iterator[MatchResult | SkylineError]:
    """Yield what was found for each query, or why it cannot be matched."""
    for one in queries:
        try:
            yield one.match(matching, top)
        except SkylineError as error:
            yield error


def _numbers(name: str, text: str | None, wanted: str, count: int) -> tuple[float, ...] | None:
    said = f"--{name} is `{text}`; expected {count} numbers {wanted}"
    return None if text is None else parse_numbers(text, count, said)


def _check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path]) -> None:
    """Raise `InputError` where a file that is written is one that is read."""
    read = [path for path in inputs if path.exists()]
    for path in outputs:
        if path is not None and path.exists() and any(path.samefile(one) for one in read):
            raise InputError(f"{path} is an input; choose another name for the output")
