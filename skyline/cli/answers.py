"""What is found in photos: told as it comes, and kept in files."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar, cast

import typer

from skyline.cli.console import complain, keeps, patience, remark, say, told
from skyline.errors import SkylineError, printable
from skyline.match.matcher import Matcher
from skyline.match.matchers import MatchConfig
from skyline.match.queries import Query
from skyline.match.ranking import Candidate
from skyline.match.records import (
    FailureRecord,
    LensRecord,
    MatchRecord,
    describe_candidates,
    describe_claim,
)
from skyline.match.results import JointResult, MatchResult
from skyline.match.results_file import Results, open_results, row_of
from skyline.match.scene import terrain_at_hand
from skyline.photo.query import QuerySkyline
from skyline.report.exports import export_matches
from skyline.report.peaks import Peaks
from skyline.report.reports import matched, report_matches

T = TypeVar("T")

_OF_CAMERA = ("heading_deg", "pitch_deg", "roll_deg", "fov_deg", "distortion", "beyond_share")


class Answers:
    """Prints what is found, and keeps it in a file where one is asked for.

    Attributes
    ----------
    loading_s : float
        What opening the store took.
    exit_code : int
        0 unless a query failed.
    """

    def __init__(
        self, results: Path | None, search: str, as_json: bool, top: int, is_written: bool
    ) -> None:
        """Take what to print and where; ``is_written`` where answers go to files as well."""
        self.loading_s, self.exit_code = 0.0, 0
        self._is_written = is_written or results is not None
        self._path, self._search, self._as_json, self._top = results, search, as_json, top
        self._file: Results | None = None
        self._had: set[str] = set()
        if results is not None:
            self._file, self._had = open_results(results, search)
            keeps(
                f"{results} has the answers so far, and the same command continues with the others"
            )

    def left(self, queries: list[Query]) -> list[Query]:
        """Return the queries that the file does not have, and say how many those are not."""
        left = [one for one in queries if printable(one.path) not in self._had]
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
            name = printable(one.path)
            with nullcontext() if matches else patience(f"matching {name}"):
                result = refused.get(one) or next(found)
            record: MatchRecord | FailureRecord
            if isinstance(result, SkylineError):
                self.exit_code = result.exit_code
                record = FailureRecord(query=name, error=str(result))
                said: list[str] = []
                if one not in refused:
                    complain(str(result))
            else:
                matches.append((Path(one.path), result))
                record = _describe_match(name, result, self.loading_s)
                said = _match_in_words(name, result, self._top)
            # A query that was not tried is tried again.
            if self._file is not None and one not in refused:
                self._file.add(row_of(record, self._search))
            self._print([json.dumps(record)] if self._as_json else said)
        progress(len(queries), len(queries))
        return matches

    def tell_together(
        self, matching: Matcher, asked: Sequence[tuple[Query, QuerySkyline]]
    ) -> list[tuple[Path, MatchResult]]:
        """Match photos of one place and tell what was found; return it photo by photo."""
        with patience(f"matching {len(asked)} photos together"):
            skylines, known = [one for _, one in asked], [one.narrowing for one, _ in asked]
            found = matching.match_together(skylines, None, self._top, known)
        paths = [one.path for one, _ in asked]
        names = [printable(path) for path in paths]
        said = _together_in_words(names, found)
        if self._as_json:
            said = [json.dumps(_describe_together(names, found, self.loading_s))]
        self._print(said)
        return [(Path(path), result) for path, result in zip(paths, found.results, strict=True)]

    def _print(self, lines: Sequence[str]) -> None:
        """Print lines; where nobody reads them any more, go on if answers are written to files."""
        try:
            for line in lines:
                say(line)
        except BrokenPipeError:
            if not self._is_written:
                raise typer.Exit(self.exit_code) from None


def write_files(
    matching: Matcher,
    matches: Sequence[tuple[Path, MatchResult]],
    together: int,
    exports: Sequence[Path],
    report: Path | None,
    gazetteer: Peaks | None,
) -> None:
    """Write what was found, where anything was, to the files asked for.

    ``together`` is how many photos were matched as of one place; 0 where each was by itself.
    """
    done = [f"{matching.rows} {matching.holds} of the store were searched."]
    if together:
        done.append(f"{together} photos of one place were matched together.")
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


def tried(
    queries: Sequence[Query], attempt: Callable[[Query], T]
) -> tuple[list[tuple[Query, T]], dict[Query, SkylineError]]:
    """Return the queries an attempt succeeds for, with what it gives, and why others fail.

    That is said at once: a store is opened for minutes, and nobody should wait for a wrong name.
    """
    done: list[tuple[Query, T]] = []
    refused: dict[Query, SkylineError] = {}
    for one in queries:
        try:
            done.append((one, attempt(one)))
        except SkylineError as error:
            refused[one] = error
            complain(str(error))
    return done, refused


def _describe_match(query: str, result: MatchResult, loading_seconds: float) -> MatchRecord:
    candidates = describe_candidates(result.candidates)
    record = MatchRecord(
        query=query,
        answer=candidates[0] if result.answer else None,
        answer_within_m=result.within_m,
        candidates=candidates,
        seconds=result.seconds,
        loading_seconds=loading_seconds,
    )
    if result.refusal:
        record["refusal"] = result.refusal
    lens = result.query.lens
    if lens is not None and lens.said:
        record["lens"] = cast(LensRecord, asdict(lens))
    claim = describe_claim(result.query.noted, next(iter(result.candidates), None))
    if claim is not None:
        record["exif"] = claim
    return record


def _match_in_words(query: str, result: MatchResult, asked_for: int) -> list[str]:
    """Return lines for a person who asked for so many candidates."""
    places, lens = result.candidates, result.query.lens
    said = [f"{query} ({result.seconds:.2f} s)"]
    if result.answer is not None:
        near = "" if result.within_m is None else f", right within {result.within_m:g} m"
        said.append(f"  the answer is candidate 1{near}; all candidates, best first:")
    if result.refusal:
        said.append(f"  no answer: {result.refusal}")
    for rank, place in enumerate(places, start=1):
        sure = f"score {place.score:.3f}"
        if place.confidence is not None:
            sure = f"confidence {place.confidence:.2f} (1 km: {place.confidence_1km:.2f})"
        said.append(
            f"  {rank}. {_where(place)}  {_look(place)}  {sure}"
            f"{'' if place.refined else '  (unrefined)'}"
        )
    if 0 < len(places) < asked_for:
        count = f"{len(places)} of {asked_for} candidates"
        said.append(f"  {count}: no other place was worth refining to the end")
    if result.beyond:
        said.append(f"  {result.beyond}")
    if lens is not None and lens.said:
        known = "not known" if lens.fov_deg is None else f"{lens.fov_deg:.1f} degrees"
        sure = "" if lens.sd_deg is None else f", give or take {lens.sd_deg:.0f}"
        said.append(f"  field of view: {known}{sure}; {lens.said}")
    if result.claim:
        said.append(f"  {result.claim}")
    return said


def _describe_together(
    queries: Sequence[str], result: JointResult, loading_seconds: float
) -> dict[str, object]:
    # Places are candidates without their cameras; each photo that agrees has its own at the best.
    places = [
        {name: value for name, value in record.items() if name not in _OF_CAMERA}
        for record in describe_candidates(result.places)
    ]
    photos = []
    for query, one, agrees in zip(queries, result.results, result.agrees, strict=True):
        about: dict[str, object] = {"refusal": one.refusal}
        if agrees:
            about = {name: getattr(one.candidates[0], name) for name in _OF_CAMERA}
        photos.append({"query": query, "agrees": agrees, **about})
    return {
        "answer": places[0] if result.answer else None,
        "answer_within_m": result.within_m,
        "candidates": places,
        **({"refusal": result.refusal} if result.refusal else {}),
        "photos": photos,
        "seconds": result.seconds,
        "loading_seconds": loading_seconds,
    }


def _together_in_words(queries: Sequence[str], result: JointResult) -> list[str]:
    said = [f"{len(queries)} photos of one place ({result.seconds:.2f} s)"]
    if result.answer is not None:
        near = f"place 1, right within {result.within_m:g} m"
        said.append(f"  the answer is {near}; all places, best first:")
    if result.refusal:
        said.append(f"  no answer: {result.refusal}")
    said += [
        f"  {rank}. {_where(place)}  within {place.radius_m:.0f} m (68 %)  confidence "
        f"{place.confidence:.2f} (1 km: {place.confidence_1km:.2f})"
        for rank, place in enumerate(result.places, start=1)
    ]
    for query, one in zip(queries, result.results, strict=True):
        about = f"does not agree: {one.refusal}"
        if one.candidates:
            about = _look(one.candidates[0])
        said.append(f"  {query}: {about}")
    return said


def _where(place: Candidate) -> str:
    return (
        f"lat {place.lat:.5f} lon {place.lon:.5f}  easting {place.easting_m:.0f} northing "
        f"{place.northing_m:.0f}"
    )


def _look(place: Candidate) -> str:
    return (
        f"heading {place.heading_deg:.1f} from true north  pitch {place.pitch_deg:.1f}  fov "
        f"{place.fov_deg:.1f}"
    )
