"""Matching photos, showing their results and writing them to files.

Results are shown as they come; the files have all of them. A search that was stopped continues if
it has a file of results.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import takewhile
from pathlib import Path
from typing import TypeVar

from skyline.cache import store_of
from skyline.errors import (
    InputError,
    SkylineError,
    StoreMismatchError,
    entry_named,
    printable,
    suffix_of,
)
from skyline.files.disk import (
    STANDARD,
    STORE_SUFFIXES,
    check_outputs,
    digest_of,
    read_bytes,
    version_of,
)
from skyline.files.geojson import GEOJSON
from skyline.match.batch import MatcherFiles, match_here, match_many
from skyline.match.config import MatchConfig
from skyline.match.distant_shards import distant_shards, opening_of
from skyline.match.joint_result import JointResult
from skyline.match.matcher import FULL, Matcher
from skyline.match.method import MATCHERS
from skyline.match.photo_lists import Entry
from skyline.match.posterior import Posterior
from skyline.match.result import MatchResult
from skyline.match.walk import check_times
from skyline.photo.image import EXPECTED
from skyline.photo.skyline import PhotoSkyline
from skyline.plugins import names_of
from skyline.progress import Progress
from skyline.report.exports import EXPORTS, export_matches
from skyline.report.folder import check_report_folder
from skyline.report.geotiff import GEOTIFFS
from skyline.report.posterior_files import POSTERIOR_FILES, write_posteriors
from skyline.report.results_file import ResultsFile
from skyline.store.read import is_store
from skyline.survey.cluster import Runner, runner_of
from skyline.tasks.listener import Listener
from skyline.terrain.dem_files import dem_names
from skyline.terrain.viewpoints import IN_FLIGHT_M
from skyline.view.peaks import Peaks, read_peaks

PAGE_PORT = 8765
"""The default port of `skyline serve`."""
UNREFINED = "unrefined"
"""The full matcher without its last step."""

T = TypeVar("T")


def matcher_names() -> list[str]:
    """Return the names of all matchers, including those of other packages."""
    return [*names_of(MATCHERS), UNREFINED]


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchTask:
    """Photos to find, stores to search, and files to write."""

    stores: tuple[Path, ...]
    """Stores that are searched as one."""
    entries: Sequence[Entry]
    """The photos."""
    common: Entry = Entry("")  # noqa: RUF009  (it is frozen)
    """What is known of every photo."""
    inputs: Sequence[Path] = ()
    """Files that the user has named as photos or spots: no output replaces them."""
    matcher: str = FULL
    """``unrefined``, or as for `Matcher`."""
    dem: Sequence[str] = ()
    """Elevation files of the stores, or folders of them; by default the files that the stores
    name."""
    surface: Sequence[str] = ()
    """Files of a surface or canopy model, or folders of them."""
    same_place: bool = False
    """Whether all photos were taken at one place."""
    workers: str | None = None
    """As for `runner_of`. A photo is a job; where the full matcher has fewer photos than workers,
    all workers search for each photo, each in a part of the places."""
    report: Path | None = None
    """Folder of a page with pictures and maps."""
    peaks: Path | None = None
    """Gazetteer of the page."""
    exports: Sequence[Path] = ()
    """Files of the candidates, of the kinds of `EXPORTS`."""
    probability: Sequence[Path] = ()
    """Files of the posteriors, of the kinds of `POSTERIOR_FILES`."""
    walked_km_h: float | None = None
    """Greatest speed of the person who took all photos, whose posteriors are then joined."""
    serve: str = ""
    """Command that serves the page with the photos; the report names it."""
    results: Path | None = None
    """File with a row for each photo, of the kinds of `RESULTS`."""

    @property
    def others(self) -> list[Path]:
        """Files that need whole results, not only rows."""
        return [*self.exports, *self.probability, *filter(None, [self.report])]

    @property
    def files(self) -> MatcherFiles:
        """The files and the settings of the matcher."""
        # Workers may have another working directory.
        name = FULL if self.matcher == UNREFINED else self.matcher
        config = MatchConfig(refine=self.matcher != UNREFINED)
        return MatcherFiles(self.stores, dem_names(self.dem), dem_names(self.surface), name, config)

    def search_digest(self) -> str:
        """Return a digest of the stores and the options.

        It differs between searches that may give different answers.
        """
        surfaces = dem_names(self.surface)
        files = [(Path(one).name, *_written(one)) for one in (*map(str, self.stores), *surfaces)]
        return digest_of(files, self.matcher, MatchConfig(), self.common)

    def check(self) -> None:
        """Check the options and the outputs.

        Raises `InputError` for options that contradict each other, and for wrong outputs.
        """
        entry_named("matcher", self.matcher, dict.fromkeys(matcher_names()))
        names_stores = ", ".join(map(str, self.stores))
        no_refinement = f"leave --matcher {UNREFINED} out"
        for is_wrong, error in (
            (not self.entries, f"{names_stores} are stores; name photos to find in them"),
            (
                self.common.narrowing.use_gps and self.matcher == UNREFINED,
                f"--use-gps works in refinement; {no_refinement}",
            ),
            (
                self.common.narrowing.photo_spots and self.matcher == UNREFINED,
                f"--photo-spots works in refinement; {no_refinement}",
            ),
            (
                self.same_place and self.matcher != FULL,
                "--same-place compares renderings of the terrain; leave --matcher out",
            ),
            (
                self.same_place and self.results,
                "--same-place gives one answer, not one row per photo; leave --results out",
            ),
            (
                self.same_place and self.workers,
                "--same-place matches in this process; leave --workers out",
            ),
            (
                self.probability and self.matcher not in (FULL, UNREFINED),
                f"--probability needs the full matcher; leave --matcher {self.matcher} out",
            ),
        ):
            if is_wrong:
                raise InputError(error)
        self.check_files()

    def check_files(self) -> None:
        """Check the outputs.

        Raises `InputError` for outputs that would replace inputs, or whose kind is unknown.
        """
        named = [Path(one.path) for one in self.entries]
        inputs = [*self.stores, *self.inputs, *named, *filter(None, [self.peaks])]
        check_outputs([*self.exports, *self.probability, self.results], inputs, self.report)
        if self.report is not None:
            folders = {one.parent.resolve() for one in named if one != Path(STANDARD)}
            if self.report.resolve() in folders:
                raise InputError(
                    f"--report {self.report} is a folder of photos to match; name another one for "
                    "the report"
                )
            check_report_folder(self.report)
        for path in self.exports:
            suffix_of(path, EXPORTS)
        if self.walked_km_h is not None:
            self._check_walk(self.walked_km_h)
        for path in self.probability:
            kind = suffix_of(path, POSTERIOR_FILES)
            if kind in GEOTIFFS and len(self.entries) > 1 and not self.same_place:
                raise InputError(
                    f"--probability {path} holds one photo, and {len(self.entries)} are named; "
                    f"give {path.with_suffix(GEOJSON[0])} or {path.with_suffix('.kml')}, which "
                    "hold all, or --same-place if they were taken at one place"
                )

    def _check_walk(self, walked_km_h: float) -> None:
        if not self.probability or self.same_place or len(self.entries) < 2:
            raise InputError(
                "--walked joins the maps of --probability FILE of two photos or more that were "
                "taken on one walk; name them, and leave --same-place out"
            )
        if not 0.0 < walked_km_h < math.inf:
            raise InputError(f"--walked is {walked_km_h} km/h; expected a speed above 0")


def split_stores(first: Path, others: Sequence[Path]) -> tuple[tuple[Path, ...], Sequence[Path]]:
    """Return the stores and the photos of a command's arguments.

    The stores are the first argument and the stores that follow it; all that is named after them is
    a photo. The folder of a cached area is a store, too. Raises `InputError` where a store is named
    after a photo.
    """
    first, *others = map(store_of, (first, *others))
    stores = (first, *takewhile(is_store, others))
    photos = others[len(stores) - 1 :]
    photo = next(iter(photos), None)
    if first.is_file() and not is_store(first):
        photo, photos = first, others
    late = next(
        (one for one in photos if one.suffix in {*STORE_SUFFIXES, ""} and is_store(one)), None
    )
    if late is not None:
        raise InputError(f"{late} is a store and is named after {photo}; name stores before photos")
    return stores, photos


def match_photos(task: MatchTask, listener: Listener) -> int:
    """Match photos, show each result as it comes, and write the files.

    Returns the exit code of the last error, or 0. Raises `InputError` as `MatchTask.check`, and for
    a gazetteer or a DEM that cannot be read, and `StoreError` for a store that cannot be read; the
    error of a photo is shown, and does not stop the others.
    """
    task.check()
    results: AbstractContextManager[ResultsFile | None] = nullcontext()
    if task.results is not None:
        results = ResultsFile(task.results, task.search_digest())
    with results as file:
        run = _Run(task, listener, file)
        with suppress(BrokenPipeError):
            run.match()
    return run.exit_code


class _Run:
    """One run of a task.

    ``exit_code`` belongs to the last error; it is 0 if there was none.
    """

    def __init__(self, task: MatchTask, listener: Listener, file: ResultsFile | None) -> None:
        self._task = task
        self._listener = listener
        self._file = file
        self._loading_s = 0.0
        self._joint: JointResult | None = None
        self._times: dict[str, datetime] = {}
        self.exit_code = 0

    def match(self) -> None:
        """Match the photos without results, and write the files."""
        task = self._task
        self._ask_about_heights()
        known = self._matched_before()
        # These checks come before the store is opened, which may take a minute.
        checked, refused = self._attempted(
            "checking photos", [one for one in task.entries if one not in known], Entry.check
        )
        usable = [one for one, _ in checked]
        skylines: list[tuple[Entry, PhotoSkyline]] = []
        if task.same_place:
            skylines, unread = self._read_together(usable)
            refused = refused | unread
        if not usable:
            self._show_each(known, refused, iter(()), lambda *_: None)
            return
        if task.walked_km_h is not None:
            self._times = {one.path: one.taken() for one in usable}
            check_times(list(self._times.values()))
        matcher = self._opened()
        gazetteer = None if task.peaks is None else read_peaks(task.peaks, matcher.frame)
        done = f"{matcher.rows} {matcher.holds} were searched."
        if task.same_place:
            done += f" {len(skylines)} photos of one place were matched together."
            found = self._match_together(matcher, skylines)
            self.exit_code = InputError.exit_code if refused else 0
        else:
            doing = f"matching {usable[0].path}" if len(usable) == 1 else "matching photos"
            with (
                runner_of(task.workers) as runner,
                self._listener.progress(doing) as progress,
            ):
                progress(0, len(usable))
                each = match_here(matcher, usable)
                if runner is not None and self._is_split(len(usable), runner):
                    opening = opening_of(task.stores, dem_names(task.dem) or None)
                    rows = [area.rows for area in matcher.areas]
                    shards = distant_shards(runner, opening, rows)
                    # A worker has its next part at hand when it is done with one.
                    matcher.search_by(shards, 2 * runner.workers)
                elif runner is not None:
                    each = match_many(runner, task.files, usable)
                found = self._show_each(known, refused, each, progress)
        if found:
            self._write(found, matcher, gazetteer, done)

    def _ask_about_heights(self) -> None:
        """Note a camera that is said to be very high above the ground."""
        given = (one.narrowing.eye_height_m or 0.0 for one in self._task.entries)
        highest_m = max(given, default=0.0)
        if highest_m > IN_FLIGHT_M:
            self._listener.note(
                f"the camera is taken to be {highest_m:g} m above the ground, as in an aircraft; "
                "if that is its elevation, leave --eye-height out, or give lowest_m and highest_m "
                "in a list of photos"
            )

    def _is_split(self, photos: int, runner: Runner) -> bool:
        """Return whether all workers search for each photo.

        With as many photos as workers, whole photos are done sooner: refinement is shared as well.
        """
        return photos < runner.workers and self._task.matcher in (FULL, UNREFINED)

    def _matched_before(self) -> dict[Entry, str | None]:
        """Return the photos that need not be matched, with their errors.

        A note gives their number. The file of results has rows of these photos. Where other files
        are written too, no photo counts as known, since those files need more than the rows have.
        """
        file = self._file
        if file is None:
            return {}
        others = self._task.others
        named = " and ".join(map(str, others))
        self._listener.keeps(
            f"{file.path} has the answers so far, and the same command "
            f"{f'without {named} ' if others else ''}continues with the others",
            lambda: bool(file.photos),
        )
        photos = {one: _photo_of(one) for one in self._task.entries}
        known = {one: file.photos[photo] for one, photo in photos.items() if photo in file.photos}
        if known:
            again = f", and are matched again for {named}" if others else ""
            self._listener.note(
                f"{file.path}: {len(known)} of {len(photos)} are there already{again}"
            )
        return {} if others else known

    def _attempted(
        self, doing: str, entries: Sequence[Entry], attempt: Callable[[Entry], T]
    ) -> tuple[list[tuple[Entry, T]], dict[Entry, SkylineError]]:
        """Try something with photos; return the results and the errors.

        Errors are also shown at once.
        """
        usable: list[tuple[Entry, T]] = []
        refused: dict[Entry, SkylineError] = {}
        with self._listener.progress(doing) as progress:
            for number, one in enumerate(entries):
                progress(number, len(entries))
                try:
                    usable.append((one, attempt(one)))
                except SkylineError as error:
                    refused[one] = error
                    self._listener.error(_of_photo(one, error))
        return usable, refused

    def _read_together(
        self, entries: Sequence[Entry]
    ) -> tuple[list[tuple[Entry, PhotoSkyline]], dict[Entry, SkylineError]]:
        """Read photos of one place; otherwise as `_attempted`.

        Raises `InputError` for fewer than two photos that can be read.
        """
        skylines, unread = self._attempted("reading photos", entries, Entry.read)
        if len(skylines) < 2:
            raise InputError(
                "--same-place needs two photos or more that can be read, and has "
                f"{len(skylines)}; name more, or leave --same-place out"
            )
        return skylines, unread

    def _opened(self) -> Matcher:
        """Open the matcher.

        Raises `InputError` if a file of results would keep unrefined answers, and for a report on
        stores of several DEMs.
        """
        task = self._task
        started = time.perf_counter()
        with self._listener.slow(
            f"opening {', '.join(map(str, task.stores))} and its elevation model"
        ):
            matcher = task.files.open()
        self._loading_s = time.perf_counter() - started
        if task.report is not None:
            matcher.only_area()
        is_unrefined = any(area.terrain is None for area in matcher.areas)
        if self._file is not None and task.matcher == FULL and is_unrefined:
            raise InputError(
                "--results keeps answers for good, and these would be unrefined; name the store's "
                f"DEM with --dem, or accept that with --matcher {UNREFINED}"
            )
        return matcher

    def _show_each(
        self,
        known: Mapping[Entry, str | None],
        refused: Mapping[Entry, SkylineError],
        results: Iterator[MatchResult | SkylineError],
        progress: Progress,
    ) -> list[MatchResult]:
        """Show the results of all photos in order, as they come.

        Returns the results that are not errors.
        """
        found: list[MatchResult] = []
        tried = 0
        left = sum(one not in known and one not in refused for one in self._task.entries)
        for one in self._task.entries:
            if one in known:
                self._show_known(one, known[one])
                continue
            result = refused.get(one) or next(results)
            tried += one not in refused
            if isinstance(result, SkylineError):
                self._show_error(one, result, is_tried=one not in refused)
            else:
                found.append(result)
                if self._file is not None:
                    self._file.add(result.to_row(), _photo_of(one))
                self._show_result(result)
            progress(tried, left)
        return found

    def _match_together(
        self, matcher: Matcher, photos: Sequence[tuple[Entry, PhotoSkyline]]
    ) -> list[MatchResult]:
        """Match photos of one place and show the joint result.

        Returns the result of each photo.
        """
        with self._listener.slow(f"matching {len(photos)} photos together"):
            narrowings = [entry.narrowing for entry, _ in photos]
            joint = matcher.match_together([one for _, one in photos], narrowings=narrowings)
        results = [
            replace(result, name=entry.path, id=entry.label)
            for (entry, _), result in zip(photos, joint.results, strict=True)
        ]
        self._joint = replace(joint, results=tuple(results))
        self._show_result(self._joint)
        return results

    def _show_result(self, result: MatchResult | JointResult) -> None:
        self._show(result.to_dict() | {"loading_seconds": self._loading_s}, result.to_text())

    def _show_known(self, entry: Entry, error: str | None) -> None:
        """Show the error, if any, of a photo matched earlier.

        An earlier run has written the photo's row.
        """
        if error is not None:
            self.exit_code = InputError.exit_code
            self._listener.error(_of_photo(entry, InputError(error)))

    def _show_error(self, entry: Entry, error: SkylineError, is_tried: bool) -> None:
        """Show that a photo failed.

        A photo that was tried and cannot be used gets a row; others are tried again next time.
        """
        self.exit_code = error.exit_code
        names = {"photo": printable(entry.path)}
        if entry.label:
            names["id"] = printable(entry.label)
        if is_tried:
            self._listener.error(_of_photo(entry, error))
            is_final = isinstance(error, InputError) and not isinstance(error, StoreMismatchError)
            if self._file is not None and is_final:
                row = names | {"answered": 0, "reason": str(error)}
                self._file.add(row, _photo_of(entry))
        self._show(names | {"error": str(error)}, "")

    def _show(self, record: Mapping[str, object], text: str) -> None:
        """Show a result.

        If nobody reads it, the task goes on only if files are written.
        """
        try:
            self._listener.result(record, text)
        except BrokenPipeError:
            if self._file is None and not self._task.others:
                raise

    def _write(
        self,
        found: list[MatchResult],
        matcher: Matcher,
        gazetteer: Peaks | None,
        done: str,
    ) -> None:
        """Write the exports, the report and the posteriors."""
        for path in self._task.exports:
            export_matches(path, found, [area.frame for area in matcher.areas])
        if self._task.report is not None:
            self._write_report(self._task.report, found, matcher, gazetteer, done)
        if self._task.probability:
            # Written last: photos that no single walk joins have no posteriors, which is an error.
            self._write_posteriors(found if self._joint is None else [self._joint], matcher)

    def _write_report(
        self,
        folder: Path,
        found: list[MatchResult],
        matcher: Matcher,
        gazetteer: Peaks | None,
        done: str,
    ) -> None:
        """Write the report's page and tell where it is."""
        from skyline.report.match_page import report_matches  # noqa: PLC0415  (slow to load)

        address = f"http://127.0.0.1:{PAGE_PORT}/"
        served = (self._task.serve, address) if self._task.serve else None
        page = report_matches(folder, matcher, found, gazetteer, done=done, served=served)
        with suppress(BrokenPipeError):
            self._listener.remark(f"report: {page}")

    def _write_posteriors(
        self, found: Sequence[MatchResult | JointResult], matcher: Matcher
    ) -> None:
        """Write the posterior of each photo, or of one place."""
        named = [one.results[0] if isinstance(one, JointResult) else one for one in found]
        names = [one.name for one in named]
        with self._listener.progress("mapping probabilities") as progress:

            def posteriors() -> Iterator[Posterior]:
                if self._task.walked_km_h is not None:
                    times = [self._times[name] for name in names]
                    yield from matcher.joined_posteriors(
                        found, times, self._task.walked_km_h, progress
                    )
                    return
                for number, result in enumerate(found):
                    progress(number, len(found))
                    yield matcher.posterior(result)

            write_posteriors(self._task.probability, zip(names, posteriors(), strict=True))


def _of_photo(entry: Entry, error: SkylineError) -> str:
    """Return an error with the name of its photo."""
    text, name = str(error), printable(entry.path)
    return text if name in text else f"{name}: {text}"


def _photo_of(entry: Entry) -> str:
    """Return a digest of a photo and its own settings.

    A list may change these settings.
    """
    return digest_of(entry, _written(entry.path))


def _written(path: str | Path) -> tuple[object, ...]:
    """Return a file's size and time of modification.

    For standard input it is a digest. The path is left out, since files may move.
    """
    if str(path) == STANDARD:
        return (digest_of(read_bytes(path, EXPECTED)),)
    return (version_of(path) or ())[:2]
