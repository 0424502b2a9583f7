"""``skyline match``: photos in, places out."""

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from typer import Argument, Option

from skyline.batch import Query, listed, match_here, match_many
from skyline.cli.console import (
    AsJson,
    StoreDem,
    StoreFile,
    Surfaces,
    Workers,
    check_outputs,
    note_if_slow,
    on_interrupt,
    panel,
    print_error,
    print_line,
    print_note,
)
from skyline.cli.photo import FieldOfView, PhotoProjection, split_stores
from skyline.errors import (
    InputError,
    SkylineError,
    StoreMismatchError,
    entry_named,
    numbers_of,
    printable,
    suffix_of,
)
from skyline.files import STANDARD, read_bytes, version_of
from skyline.match.confidence import MatchConfig
from skyline.match.matcher import FULL, Matcher
from skyline.match.method import MATCHERS
from skyline.match.prior import Narrowing
from skyline.match.result import JointResult, MatchResult
from skyline.peaks import read_peaks
from skyline.photo.skyline import PhotoSkyline
from skyline.plugins import names_of
from skyline.report.files import EXPORTS, RESULTS, ResultsFile, export_matches
from skyline.report.folder import check_report_folder
from skyline.survey.cluster import runner_of
from skyline.terrain.dem_files import dem_names

_UNREFINED = "unrefined"
"""The full matcher without its last step."""

# Groups of options in the help, after the options that are needed most.
_known, _search, _files = panel("The photos"), panel("The search"), panel("More files to write")

T = TypeVar("T")


def match(
    store: StoreFile,
    query: Annotated[
        list[Path],
        Argument(
            metavar="QUERY...",
            help="Photos, folders of them, sky masks (white = sky), CSV traces or lists. A trace "
            "begins with '# width=W height=H' and has the columns column_px,row_px. Before all may "
            "come more stores of the same DEM, which are searched as one.",
        ),
    ],
    fov_deg: FieldOfView = None,
    near: Annotated[
        str | None,
        Option(
            metavar="LON,LAT,KM|W,S,E,N",
            help="Search only within KM of a point, or in a box in degrees.",
        ),
    ] = None,
    dem: StoreDem = None,
    report: Annotated[
        Path | None, Option(metavar="DIR", help="Write a page with pictures and maps.")
    ] = None,
    as_json: AsJson = False,
    heading: Annotated[
        str | None,
        _known(metavar="DEG,SLACK", help="Camera heading from true north, within SLACK degrees."),
    ] = None,
    projection: PhotoProjection = None,
    same_place: Annotated[
        bool, _known("--same-place", help="All photos were taken at one place; find that place.")
    ] = False,
    use_gps: Annotated[
        bool, _known("--use-gps", help="Prefer places near each photo's own GPS position.")
    ] = False,
    matcher: Annotated[
        str,
        _search(
            metavar="NAME",
            help=f"{FULL}, {_UNREFINED}, paper, correlation, or another package's; {_UNREFINED} is "
            "faster and less exact.",
        ),
    ] = FULL,
    surface: Surfaces = None,
    export: Annotated[
        list[Path] | None,
        _files(
            metavar="FILE", help=f"Write the candidates ({', '.join(EXPORTS)}); may be repeated."
        ),
    ] = None,
    peaks: Annotated[
        Path | None,
        _files(
            metavar="FILE",
            help="Peaks to name in the report: GeoJSON, or CSV: name,lon,lat[,height_m].",
        ),
    ] = None,
    results: Annotated[
        Path | None,
        _files(
            metavar="FILE",
            help=f"Write a row for each photo when it is done ({', '.join(RESULTS)}). Photos that "
            "are in the file are not matched again.",
        ),
    ] = None,
    workers: Workers = None,
) -> None:
    """Find where photos were taken and in which direction the camera looked."""
    exports = export or []
    stores, photos = split_stores(store, query)
    entry_named("matcher", matcher, dict.fromkeys([*names_of(MATCHERS), _UNREFINED]))
    for is_wrong, error in (
        (not photos, f"{', '.join(map(str, stores))} are stores; name photos to find in them"),
        (peaks and not report, f"--peaks {peaks} names peaks in a report; give --report DIR too"),
        (
            use_gps and matcher == _UNREFINED,
            f"--use-gps acts in refinement; leave --matcher {_UNREFINED} out",
        ),
        (
            same_place and matcher != FULL,
            "--same-place compares renderings of the terrain; leave --matcher out",
        ),
        (
            same_place and results,
            "--same-place gives one answer, not one row per photo; leave --results out",
        ),
        (same_place and workers, "--same-place matches in this process; leave --workers out"),
        (
            workers and Path(STANDARD) in photos,
            "standard input is read in this process; name a file, or leave --workers out",
        ),
    ):
        if is_wrong:
            raise InputError(error)
    common = Query("", fov_deg, None, projection, narrowing_of(near, heading, use_gps))
    queries = list(listed(photos, common))
    _check_files(queries, [*stores, *photos, *filter(None, [peaks])], exports, results, report)
    surfaces = dem_names(surface or ())
    others = [*exports, *filter(None, [report])]
    search = _search_of(stores, matcher, common, surfaces)
    with nullcontext() if results is None else ResultsFile(results, search) as file:
        output = _Output(as_json, file, goes_on=bool(others or results))
        known = {} if file is None else _matched_before(queries, file, others)
        # These checks come before the store is opened, which may take a minute.
        checked, refused = _attempted([one for one in queries if one not in known], Query.check)
        usable = [one for one, _ in checked]
        skylines, unread = _read_together(usable) if same_place else ([], {})
        if not usable:
            _match_each(output, queries, known, refused, iter(()))
            raise typer.Exit(output.exit_code)
        # Workers may have another working directory.
        tiles = dem_names(dem or ()) or None
        name = FULL if matcher == _UNREFINED else matcher
        config = MatchConfig(refine=matcher != _UNREFINED)
        asked = stores, tiles, name, config, None, surfaces or None
        started = time.perf_counter()
        with note_if_slow(f"opening {', '.join(map(str, stores))} and its elevation model"):
            matching = Matcher(*asked)
        output.loading_s = time.perf_counter() - started
        _check_refined(file, matching, matcher)
        gazetteer = None if peaks is None else read_peaks(peaks, matching.frame)
        done = f"{matching.rows} {matching.holds} were searched."
        if same_place:
            done += f" {len(skylines)} photos of one place were matched together."
            found = _match_together(output, matching, skylines)
            output.exit_code = InputError.exit_code if refused or unread else 0
        else:
            with runner_of(workers) as runner:
                each = match_here(matching, usable)
                if runner is not None:
                    each = match_many(runner, asked, usable)
                found = _match_each(output, queries, known, refused, each)
    for path in exports if found else ():
        export_matches(path, found, matching.frame)
    if report is not None and found:
        from skyline.report.match_page import report_matches  # noqa: PLC0415  (slow to load)

        page = report_matches(report, matching, found, gazetteer, done=done)
        (print_note if as_json else output.line)(f"report: {page}")
    if output.exit_code:
        raise typer.Exit(output.exit_code)


def _check_files(
    queries: Sequence[Query],
    inputs: Sequence[Path],
    exports: Sequence[Path],
    results: Path | None,
    report: Path | None,
) -> None:
    """Raise `InputError` for outputs that would replace inputs, or whose kind is not known."""
    named = [Path(one.path) for one in queries]
    check_outputs([*exports, results, report], [*inputs, *named])
    folders = {one.parent.resolve() for one in named if one != Path(STANDARD)}
    if report is not None and report.resolve() in folders:
        raise InputError(
            f"--report {report} is a folder of photos to match; name another one for the report"
        )
    if report is not None:
        check_report_folder(report)
    for path in exports:
        suffix_of(path, EXPORTS)


def _read_together(
    queries: Sequence[Query],
) -> tuple[list[tuple[Query, PhotoSkyline]], dict[Query, SkylineError]]:
    """Read photos of one place, as `_attempted`; raises `InputError` for fewer than two."""
    skylines, unread = _attempted(queries, Query.read)
    if len(skylines) < 2:
        raise InputError(
            f"--same-place needs two photos or more that can be read, and has {len(skylines)}; "
            "name more, or leave --same-place out"
        )
    return skylines, unread


def _check_refined(file: ResultsFile | None, matching: Matcher, matcher: str) -> None:
    """Raise `InputError` if a file of results would keep answers that lack refinement."""
    if file is not None and matcher == FULL and matching.terrain is None:
        raise InputError(
            "--results keeps answers for good, and these would be unrefined; name the store's DEM "
            f"with --dem, or accept that with --matcher {_UNREFINED}"
        )


def _matched_before(
    queries: Sequence[Query], file: ResultsFile, others: Sequence[Path]
) -> dict[Query, str | None]:
    """Return the queries that need not be matched, with their errors; print how many there are.

    These are the queries of which a file of results has rows. There are none if ``others`` are
    written, an export or a report, which need more than the rows have.
    """
    named = " and ".join(map(str, others))
    on_interrupt(
        f"{file.path} has the answers so far, and the same command "
        f"{f'without {named} ' if others else ''}continues with the others",
        lambda: bool(file.photos),
    )
    photos = {one: _photo_of(one) for one in queries}
    known = {one: file.photos[photo] for one, photo in photos.items() if photo in file.photos}
    if known:
        again = f", and are matched again for {named}" if others else ""
        print_note(f"{file.path}: {len(known)} of {len(photos)} are there already{again}")
    return {} if others else known


class _Output:
    """Prints results, and adds them to the file of results if there is one.

    ``goes_on``: other files are written too, so matching goes on when standard output has no
    reader any more. ``exit_code`` is that of the last error.
    """

    def __init__(self, as_json: bool, file: ResultsFile | None, goes_on: bool) -> None:
        self._as_json, self._file, self._goes_on = as_json, file, goes_on
        self.loading_s, self.exit_code = 0.0, 0

    def result(self, query: Query, result: MatchResult) -> None:
        """Print the result of a query, and write its row."""
        if self._file is not None:
            self._file.add(result.to_row(), _photo_of(query))
        self.show(result)

    def show(self, result: MatchResult | JointResult) -> None:
        """Print a result."""
        self._print(result.to_dict() | {"loading_seconds": self.loading_s}, result.to_text())

    def known(self, query: Query, error: str | None) -> None:
        """Print the error, if it had one, of a query whose row an earlier command has written."""
        if error is not None:
            self.exit_code = InputError.exit_code
            print_error(_of_photo(query, InputError(error)))

    def error(self, query: Query, error: SkylineError, is_tried: bool) -> None:
        """Print that a query failed.

        A photo that was tried and cannot be used gets a row; others are tried again next time.
        """
        self.exit_code = error.exit_code
        names = {"query": printable(query.path)}
        if query.label:
            names["id"] = printable(query.label)
        if is_tried:
            print_error(_of_photo(query, error))
            is_final = isinstance(error, InputError) and not isinstance(error, StoreMismatchError)
            if self._file is not None and is_final:
                row = names | {"answered": 0, "reason": str(error)}
                self._file.add(row, _photo_of(query))
        self._print(names | {"error": str(error)}, "")

    def line(self, text: str) -> None:
        """Print a line."""
        try:
            print_line(text)
        except BrokenPipeError:
            if not self._goes_on:
                raise typer.Exit(self.exit_code) from None

    def _print(self, record: dict[str, Any], text: str) -> None:
        for line in [json.dumps(record)] if self._as_json else text.splitlines():
            self.line(line)


def _attempted(
    queries: Sequence[Query], attempt: Callable[[Query], T]
) -> tuple[list[tuple[Query, T]], dict[Query, SkylineError]]:
    """Return queries with the results of an attempt; print and return the errors of the others."""
    usable: list[tuple[Query, T]] = []
    refused: dict[Query, SkylineError] = {}
    for one in queries:
        try:
            usable.append((one, attempt(one)))
        except SkylineError as error:
            refused[one] = error
            print_error(_of_photo(one, error))
    return usable, refused


def _of_photo(query: Query, error: SkylineError) -> str:
    """Return an error with the name of its photo."""
    text, name = str(error), printable(query.path)
    return text if name in text else f"{name}: {text}"


def _match_each(
    output: _Output,
    queries: Sequence[Query],
    known: Mapping[Query, str | None],
    refused: Mapping[Query, SkylineError],
    results: Iterator[MatchResult | SkylineError],
) -> list[MatchResult]:
    """Print the results of all queries in order, as they come; return those without an error."""
    found: list[MatchResult] = []
    for one in queries:
        if one in known:
            output.known(one, known[one])
            continue
        with nullcontext() if found else note_if_slow(f"matching {one.path}"):
            result = refused.get(one) or next(results)
        if isinstance(result, SkylineError):
            output.error(one, result, is_tried=one not in refused)
        else:
            found.append(result)
            output.result(one, result)
    return found


def _match_together(
    output: _Output, matching: Matcher, photos: Sequence[tuple[Query, PhotoSkyline]]
) -> list[MatchResult]:
    """Match photos of one place and print the result; return it photo by photo."""
    with note_if_slow(f"matching {len(photos)} photos together"):
        narrowings = [query.narrowing for query, _ in photos]
        joint = matching.match_together([one for _, one in photos], narrowings=narrowings)
    results = [
        replace(result, name=query.path, id=query.label)
        for (query, _), result in zip(photos, joint.results, strict=True)
    ]
    output.show(replace(joint, results=tuple(results)))
    return results


def _search_of(stores: Sequence[Path], matcher: str, common: Query, surfaces: Iterable[str]) -> str:
    """Return a digest of the stores and the options, which differs between searches."""
    files = [(Path(one).name, *_written(one)) for one in (*map(str, stores), *surfaces)]
    return _digest(files, matcher, MatchConfig(), common)


def _photo_of(query: Query) -> str:
    """Return a digest of a photo and its own settings, which a list may change."""
    return _digest(query, _written(query.path))


def _written(path: str | Path) -> tuple[object, ...]:
    """Return a file's size and modification time, since files may move; of ``-`` a digest."""
    if str(path) == STANDARD:
        return (_digest(read_bytes(path, "expected a photo, a mask or a trace")),)
    return (version_of(path) or ())[:2]


def _digest(*parts: object) -> str:
    return hashlib.sha256(repr(parts).encode("utf-8", "surrogateescape")).hexdigest()[:12]


def narrowing_of(near: str | None, heading: str | None, use_gps: bool) -> Narrowing:
    """Return the narrowing of ``--near`` and ``--heading``; raises `InputError` for bad text."""
    circle = box = sector = None
    if near is not None:
        is_box = near.count(",") == 3
        count, form = (4, "W,S,E,N") if is_box else (3, "LON,LAT,KM, or 4 numbers W,S,E,N")
        numbers = numbers_of(
            near.split(","), count, f"--near is `{near}`; expected {count} numbers {form}"
        )
        circle, box = (None, numbers) if is_box else (numbers, None)
    if heading is not None:
        error = f"--heading is `{heading}`; expected 2 numbers DEG,SLACK"
        sector = numbers_of(heading.split(","), 2, error)
    return Narrowing(circle, box, sector, use_gps=use_gps)  # type: ignore[arg-type]
