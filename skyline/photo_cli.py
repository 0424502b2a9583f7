"""``skyline match extract``: photos in, places and skylines out."""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from skyline.console import Scheduler, Workers, complain, parse_bounds, runner_of
from skyline.describe import describe_match
from skyline.errors import InputError, MissingFileError, SkylineError
from skyline.matching import Narrowing
from skyline.matching.match_config import MatchConfig
from skyline.photo import Projection, extract_photo, write_overlay, write_trace
from skyline.pipeline import (
    FULL,
    MATCHERS,
    Matcher,
    MatchResult,
    QueryReading,
    match_many,
    matched,
    report_matches,
)
from skyline.pipeline.match import terrain_at_hand
from skyline.report.claims import claim_in_words
from skyline.report.exports import EXPORTS, check_export, export_matches
from skyline.report.peaks import read_peaks
from skyline.report.records import CandidateRecord, MatchRecord

_DEFAULTS = MatchConfig()

FieldOfView = Annotated[
    float | None,
    typer.Option(help="Horizontal field of view; by default from the photo's EXIF or XMP."),
]
PhotoProjection = Annotated[
    Projection | None,
    typer.Option("--projection", help="Projection of a panorama, usually cylindrical."),
]
SkyModel = Annotated[
    Path | None, typer.Option(metavar="ONNX", help="Your own sky segmentation model.")
]


def match(
    store: Annotated[Path, typer.Argument(metavar="STORE.h5")],
    query: Annotated[
        list[Path],
        typer.Argument(metavar="QUERY...", help="Photos, sky masks (white = sky) or CSV traces."),
    ],
    fov_deg: FieldOfView = None,
    projection: PhotoProjection = None,
    sky_model: SkyModel = None,
    dem: Annotated[
        list[str] | None,
        typer.Option(metavar="DEM", help="The store's DEM, if it has moved; repeat for each tile."),
    ] = None,
    matcher: Annotated[str, typer.Option(help=f"One of {', '.join(MATCHERS)}.")] = FULL,
    no_refine: Annotated[
        bool, typer.Option("--no-refine", help="Skip refinement: faster, less exact.")
    ] = False,
    near: Annotated[
        str | None,
        typer.Option(metavar="LON,LAT,KM", help="Search only within so many km of a point."),
    ] = None,
    bounds: Annotated[
        str | None, typer.Option(metavar="W,S,E,N", help="Search only in this box, in degrees.")
    ] = None,
    heading: Annotated[
        str | None,
        typer.Option(
            metavar="DEG,SLACK",
            help="Camera heading from true north, within SLACK degrees.",
        ),
    ] = None,
    elevation: Annotated[
        str | None,
        typer.Option(
            metavar="LOW,HIGH", help="The camera stood between these elevations, in metres."
        ),
    ] = None,
    fov_slack: Annotated[
        float,
        typer.Option(help="Standard deviation of the field of view, as a share of it."),
    ] = _DEFAULTS.fov_slack,
    use_gps: Annotated[
        bool,
        typer.Option(
            "--use-gps", help="Let each photo's own GPS position draw its search, never bind it."
        ),
    ] = False,
    eye_height: Annotated[
        float | None,
        typer.Option(metavar="M", help="Camera above the ground; by default it is found."),
    ] = None,
    min_confidence: Annotated[
        float, typer.Option(help="Least confidence for an answer.")
    ] = _DEFAULTS.min_confidence,
    top: Annotated[int, typer.Option(help="Number of candidates to print.")] = 5,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    report: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write a page with pictures and maps.")
    ] = None,
    peaks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv", help="Peaks to name in the report: name,lon,lat[,height_m]."
        ),
    ] = None,
    export: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help=f"Write the candidates, by the suffix: {', '.join(EXPORTS)}; may be repeated.",
        ),
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
) -> None:
    """Find where photos were taken and in which direction the camera looked."""
    exports = export or []
    _check_queries(query)
    _check_outputs(exports, [store, *query])
    for path in exports:
        check_export(path)
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
    # Workers may have another working directory.
    tiles = tuple(str(Path(one).absolute()) if Path(one).is_file() else one for one in dem or ())
    asked = (str(store), tiles or None, matcher, config)
    matching = Matcher(*asked)
    gazetteer = None if peaks is None else read_peaks(peaks, matching.frame)
    reading = QueryReading(fov_deg, projection, sky_model)
    results, failed = [], 0
    with runner_of(workers, scheduler) as runner:
        if runner is None:
            found = _matched_here(matching, query, reading, top, narrowing)
        else:
            found = match_many(runner, asked, query, reading, top, narrowing)
        for path, result in zip(query, found, strict=True):
            if isinstance(result, SkylineError):
                _say_failed(path, result, as_json)
                failed = result.exit_code
                continue
            results.append((path, result))
            record = describe_match(str(path), result)
            if as_json:
                typer.echo(json.dumps(record))
            else:
                _say_match(record)
    for path in exports if results else ():
        packed = path.suffix.lower() == ".kmz"
        told_of = [matched(one, result, with_photo=packed) for one, result in results]
        export_matches(path, told_of, matching.frame)
    if report is not None and results:
        done = [f"The matcher `{matcher}` searched a store of {matching.rows} {matching.holds}."]
        told = (matched(path, result, done) for path, result in results)
        terrain = matching.terrain or terrain_at_hand(matching.header, "no relief")
        report_matches(report, matching, told, terrain, gazetteer)
    if failed:
        raise typer.Exit(failed)


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
    matching: Matcher,
    queries: Sequence[Path],
    reading: QueryReading,
    top: int,
    narrowing: Narrowing,
) -> Iterator[MatchResult | SkylineError]:
    """Yield what was found for each query, or why it cannot be matched."""
    for path in queries:
        try:
            yield matching.match(reading.read(path), top=top, narrowing=narrowing)
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


def _check_queries(queries: Sequence[Path]) -> None:
    """Raise `MissingFileError` where there is nothing to match, before a store is opened for it."""
    if not any(path.exists() for path in queries):
        raise MissingFileError(f"{queries[0]} does not exist; expected a photo, a mask or a trace")


def _say_failed(path: Path, error: SkylineError, as_json: bool) -> None:
    complain(str(error))
    if as_json:
        typer.echo(json.dumps({"query": str(path), "error": str(error)}))


def _check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path]) -> None:
    """Raise `InputError` where a file that is written is one that is read."""
    read = [path for path in inputs if path.exists()]
    for path in outputs:
        if path is not None and path.exists() and any(path.samefile(one) for one in read):
            raise InputError(f"{path} is an input; choose another name for the output")


def _how_sure(place: CandidateRecord) -> str:
    if place["confidence"] is None:
        return f"score {place['score']:.3f}"
    return f"confidence {place['confidence']:.2f}"


def _say_match(record: MatchRecord) -> None:
    typer.echo(f"{record['query']} ({record['seconds']:.2f} s)")
    if record["answer"] is not None:
        typer.echo("  the answer is candidate 1; all candidates, best first:")
    if "refusal" in record:
        typer.echo(f"  no answer: {record['refusal']}")
    for rank, place in enumerate(record["candidates"], start=1):
        typer.echo(
            f"  {rank}. lat {place['lat']:.5f} lon {place['lon']:.5f}  easting "
            f"{place['easting']:.0f} northing {place['northing']:.0f}  heading "
            f"{place['heading_deg']:.1f} from true north  pitch {place['pitch_deg']:.1f}  fov "
            f"{place['fov_deg']:.1f}  "
            f"{_how_sure(place)}{'' if place['refined'] else '  (unrefined)'}"
        )
    if "exif" in record:
        best = next(iter(record["candidates"]), None)
        called = "candidate 1" if record["answer"] is None else "the answer"
        heading_deg = None if best is None else best["heading_deg"]
        typer.echo(f"  {claim_in_words(record['exif'], heading_deg, called)}")
