"""What is found in photos: told as it comes, and kept in files."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path

import typer

from skyline.console import complain, patience, remark, told
from skyline.errors import SkylineError
from skyline.matching.match_config import MatchConfig
from skyline.photo.query import QuerySkyline
from skyline.pipeline.match import Matcher
from skyline.pipeline.opened import terrain_at_hand
from skyline.pipeline.queries import Query
from skyline.pipeline.reports import matched, report_matches
from skyline.pipeline.results import JointResult, MatchResult
from skyline.report.exports import export_matches
from skyline.report.peaks import Peaks
from skyline.report.records import (
    CandidateRecord,
    FailureRecord,
    LensRecord,
    MatchRecord,
    beyond_in_words,
    claim_in_words,
    describe_candidates,
    describe_claim,
)
from skyline.report.results import Results, open_results, row_of

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


def describe_match(query: str, result: MatchResult, loading_seconds: float) -> MatchRecord:
    """Return what was found for a query, in the public JSON's terms."""
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
        record["lens"] = LensRecord(
            fov_deg=lens.fov_deg, sd_deg=lens.sd_deg, most_deg=lens.most_deg, said=lens.said
        )
    claim = describe_claim(result.query.noted, next(iter(result.candidates), None))
    if claim is not None:
        record["exif"] = claim
    return record


def match_in_words(record: MatchRecord, asked_for: int) -> list[str]:
    """Return what was found for a query as lines for a person who asked for so many candidates."""
    places = record["candidates"]
    said = [f"{record['query']} ({record['seconds']:.2f} s)"]
    if record["answer"] is not None:
        within_m = record["answer_within_m"]
        near = "" if within_m is None else f", right within {within_m:g} m"
        said.append(f"  the answer is candidate 1{near}; all candidates, best first:")
    if "refusal" in record:
        said.append(f"  no answer: {record['refusal']}")
    said += [
        f"  {rank}. lat {place['lat']:.5f} lon {place['lon']:.5f}  easting "
        f"{place['easting_m']:.0f} northing {place['northing_m']:.0f}  heading "
        f"{place['heading_deg']:.1f} from true north  pitch {place['pitch_deg']:.1f}  fov "
        f"{place['fov_deg']:.1f}  "
        f"{_how_sure(place)}{'' if place['refined'] else '  (unrefined)'}"
        for rank, place in enumerate(places, start=1)
    ]
    if 0 < len(places) < asked_for:
        count = f"{len(places)} of {asked_for} candidates"
        said.append(f"  {count}: no other place was worth refining to the end")
    beyond = beyond_in_words(places[0]["beyond_share"]) if places else None
    said += [f"  {beyond}"] if beyond else []
    if "lens" in record:
        said.append(f"  field of view: {_lens_in_words(record['lens'])}")
    if "exif" in record:
        heading_deg = places[0]["heading_deg"] if places else None
        is_answer = record["answer"] is not None
        said.append(f"  {claim_in_words(record['exif'], heading_deg, is_answer)}")
    return said


def describe_together(
    queries: Sequence[str], result: JointResult, loading_seconds: float
) -> dict[str, object]:
    """Return what was found for photos of one place, in the public JSON's terms.

    Places are candidates without their cameras; each photo that agrees has its own at the best.
    """
    places = [
        {name: value for name, value in record.items() if name not in _OF_CAMERA}
        for record in describe_candidates(result.places)
    ]
    photos = []
    for query, one, agrees in zip(queries, result.results, result.agrees, strict=True):
        camera = dict(describe_candidates(one.candidates[:1])[0]) if agrees else {}
        about = {name: camera[name] for name in _OF_CAMERA if agrees} or {"refusal": one.refusal}
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


def together_in_words(queries: Sequence[str], result: JointResult) -> list[str]:
    """Return what was found for photos of one place as lines for a person."""
    said = [f"{len(queries)} photos of one place ({result.seconds:.2f} s)"]
    if result.answer is not None:
        near = f"right within {result.within_m:g} m"
        said.append(f"  the answer is place 1, {near}; all places, best first:")
    if result.refusal:
        said.append(f"  no answer: {result.refusal}")
    said += [
        f"  {rank}. lat {place.lat:.5f} lon {place.lon:.5f}  easting {place.easting_m:.0f} "
        f"northing {place.northing_m:.0f}  within {place.radius_m:.0f} m (68 %)  confidence "
        f"{place.confidence:.2f} (1 km: {place.confidence_1km:.2f})"
        for rank, place in enumerate(result.places, start=1)
    ]
    for query, one in zip(queries, result.results, strict=True):
        for camera in one.candidates[:1]:
            look = f"heading {camera.heading_deg:.1f} from true north  pitch {camera.pitch_deg:.1f}"
            said.append(f"  {query}: {look}  fov {camera.fov_deg:.1f}")
        if not one.candidates:
            said.append(f"  {query}: does not agree: {one.refusal}")
    return said


def _lens_in_words(lens: LensRecord) -> str:
    if lens["fov_deg"] is None:
        return f"not known; {lens['said']}"
    sure = "" if lens["sd_deg"] is None else f", give or take {lens['sd_deg']:.0f}"
    return f"{lens['fov_deg']:.1f} degrees{sure}; {lens['said']}"


def _how_sure(place: CandidateRecord) -> str:
    if place["confidence"] is None:
        return f"score {place['score']:.3f}"
    return f"confidence {place['confidence']:.2f} (1 km: {place['confidence_1km']:.2f})"
