"""What is found in photos: told as it comes, and kept in files."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path

import typer

from skyline.console import complain, patience, remark, told
from skyline.describe import describe_match, describe_together, match_in_words, together_in_words
from skyline.errors import SkylineError
from skyline.matching.match_config import MatchConfig
from skyline.photo import QuerySkyline
from skyline.pipeline import Matcher, MatchResult, Query, matched, report_matches
from skyline.pipeline.opened import terrain_at_hand
from skyline.report.exports import export_matches
from skyline.report.peaks import Peaks
from skyline.report.records import FailureRecord
from skyline.report.results import Results, open_results, row_of


class Answers:
    """Prints what is found, and keeps it in a file where one is asked for.

    Attributes
    ----------
    loading_s : float
        What opening the store took.
    exit_code : int
        0 unless a query failed.
    """

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

    def tell_together(
        self, matching: Matcher, asked: Sequence[tuple[Query, QuerySkyline]]
    ) -> list[tuple[Path, MatchResult]]:
        """Match photos of one place and tell what was found; return it photo by photo."""
        with patience(f"matching {len(asked)} photos together"):
            found = matching.match_together(
                [skyline for _, skyline in asked],
                None,
                self._top,
                [one.narrowing for one, _ in asked],
            )
        names = [one.path for one, _ in asked]
        record = describe_together(names, found, self.loading_s)
        said = together_in_words(names, found)
        typer.echo(json.dumps(record) if self._as_json else "\n".join(said))
        return [(Path(name), result) for name, result in zip(names, found.results, strict=True)]


def write_files(
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


def search_of(store: Path, matcher: str, config: MatchConfig, common: Query, *surfaces: str) -> str:
    """Return what tells this search from others: a store, how it is searched, what is known."""
    written = store.stat().st_mtime_ns if store.exists() else 0
    settings = repr((store.name, written, matcher, config, common, *surfaces))
    return hashlib.sha256(settings.encode()).hexdigest()[:12]


def refused_at_once(queries: Sequence[Query]) -> dict[Query, SkylineError]:
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
