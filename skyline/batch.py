"""Queries: photos, masks and traces, each with its camera and narrowing; lists; matching many.

A query is one job of a worker, which opens the store once. The answers are those of one process, to
the bit.
"""

import re
import time
from collections.abc import Hashable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from skyline.camera import Projection
from skyline.errors import InputError, MissingFileError, SkylineError
from skyline.files import REPORT_PAGE, STANDARD, is_own_page, version_of
from skyline.match.matcher import Matcher, paths_of
from skyline.match.prior import Narrowing
from skyline.match.result import MatchResult
from skyline.photo.image import photos_in
from skyline.photo.photo import check_fov
from skyline.photo.read import read_skyline
from skyline.photo.skyline import Lens, PhotoSkyline
from skyline.survey.cluster import Opening, Runner, Tell
from skyline.tables import Row, Table, is_table, read_table

_NUMBERS = (
    "fov_deg", "fov_sd_share", "eye_height_m", "lon", "lat", "radius_km",
    "heading_deg", "heading_slack_deg", "lowest_m", "highest_m",
)  # fmt: skip
_TOGETHER = {
    "near": ("lon", "lat", "radius_km"),
    "heading_deg": ("heading_deg", "heading_slack_deg"),
    "elevation_m": ("lowest_m", "highest_m"),
}
"""Columns of each field of a narrowing; a row fills either all columns of a field or none."""
_EXPECTED = "expected a list with a column `path`, or a trace of a skyline"


@dataclass(frozen=True, slots=True)
class Query:
    """One photo, mask or trace, its camera as far as it is known, and where to search for it."""

    path: str
    fov_deg: float | None = None
    """By default from the file."""
    fov_sd_share: float | None = None
    """Standard deviation of the field of view, as a share of it; by default the file's or the
    matcher's."""
    projection: Projection | None = None
    """By default from the file."""
    narrowing: Narrowing = Narrowing()  # noqa: RUF009  (it is frozen)
    label: str = ""
    """The ``id`` or ``name`` that a list gives it."""

    def check(self) -> None:
        """Refuse errors that can be found without decoding a picture; raises as `read`."""
        if self.path != STANDARD and not Path(self.path).exists():
            raise MissingFileError(
                f"{self.path} does not exist; expected a photo, a mask or a trace"
            )
        check_fov(self.fov_deg, self.projection)
        if self.fov_sd_share is not None and not 0.0 <= self.fov_sd_share < 1.0:
            raise InputError(
                f"{self.path}: fov_sd_share is {self.fov_sd_share:g}; expected a share from 0 to 1"
            )
        if is_table(self.path):
            self.read()

    def read(self) -> PhotoSkyline:
        """Return the skyline; raises as `skyline.photo.read.read_skyline`."""
        query = read_skyline(self.path, self.fov_deg, projection=self.projection)
        if query.fov_deg is None or self.fov_sd_share is None:
            return query
        lens = query.lens if self.fov_deg is None and query.lens else Lens(query.fov_deg)
        return replace(query, lens=replace(lens, fov_sd_deg=self.fov_sd_share * query.fov_deg))


def listed(paths: Iterable[Path], common: Query) -> Iterator[Query]:
    """Yield the queries that paths name: photos, all pictures of folders, all rows of lists.

    ``-`` is standard input. A list is a CSV file with a column ``path``. Paths count from the
    list's folder; fields that a row leaves empty are those of ``common``, whose own path is not
    used.

    Raises `InputError` for a list with an unknown column or a bad value, for a list without rows,
    and as `without_folders`.
    """
    for path in without_folders(paths):
        table = None
        if is_table(path):
            with suppress(SkylineError):  # Reading the query itself raises it.
                table = read_table(path, _EXPECTED)
        if table is None or "path" not in table.header:
            yield replace(common, path=str(path))
            continue
        table.refuse_other("path", *_NUMBERS, "id", "name")
        if not table.rows:
            raise InputError(f"{path} is a list without photos; add a row for each")
        for row in table.rows:
            yield _query(table, row, common)


def without_folders(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield paths, with the pictures of a folder in place of the folder, in natural order.

    A path that does not exist and has a wildcard stands for the files that it matches. Reports in
    a folder are passed over. Raises `InputError` as `skyline.photo.read.photos_in`, and where a
    wildcard matches nothing.
    """
    for path in paths:
        if path.is_dir():
            yield from sorted(photos_in(path, _is_report), key=_in_order)
        elif not path.exists() and any(mark in path.name for mark in "*?["):
            some = sorted(path.parent.glob(path.name), key=_in_order)
            if not some:
                raise InputError(f"there is no file {path}; check the path of the photos")
            yield from without_folders(some)
        else:
            yield path


def _is_report(folder: Path) -> bool:
    return is_own_page(folder / REPORT_PAGE)


def _in_order(path: Path) -> tuple[list[str | int], str]:
    """Return a key that sorts frame-2 before frame-10."""
    parts = re.split("([0-9]+)", str(path))
    return [int(part) if number % 2 else part for number, part in enumerate(parts)], str(path)


def _query(table: Table, row: Row, common: Query) -> Query:
    """Return the query of a row of a list; raises `InputError` for a bad value."""
    if not row["path"]:
        raise InputError(f"{row.where} has no path; {_EXPECTED}")
    given = {column: row.number(column) for column in _NUMBERS if row[column]}
    known: dict[str, Any] = {}
    for name, group in _TOGETHER.items():
        if all(column in given for column in group):
            known[name] = tuple(given[column] for column in group)
        elif any(column in given for column in group):
            raise InputError(f"{row.where} has some of {', '.join(group)}; expected all or none")
    if "eye_height_m" in given:
        known["eye_height_m"] = given["eye_height_m"]
    try:
        narrowing = replace(common.narrowing, **known)
    except InputError as error:
        raise InputError(f"{row.where}: {error}") from error
    return replace(
        common,
        path=str(Path(table.path).parent / row["path"]),
        fov_deg=given.get("fov_deg", common.fov_deg),
        fov_sd_share=given.get("fov_sd_share", common.fov_sd_share),
        narrowing=narrowing,
        label=row.label,
    )


def match_here(matcher: Matcher, queries: Iterable[Query]) -> Iterator[MatchResult | SkylineError]:
    """Match queries in this process; yields the result of each, or the error that refuses it."""
    for query in queries:
        try:
            yield _match(matcher, query)
        except SkylineError as error:
            yield error


def match_many(
    runner: Runner, matcher: tuple[Hashable, ...], queries: Sequence[Query]
) -> Iterator[MatchResult | SkylineError]:
    """Match queries on workers; yields results in the queries' order, each as soon as it is there.

    In place of a query's result stands the error that refuses it; the others are still matched.
    ``matcher`` are the arguments of `Matcher`, in order: the store's path first, or the paths of
    several. Workers need the store, the DEM and the queries under the same paths.
    """
    stores = tuple(Path(one).absolute() for one in paths_of(cast(Any, matcher[0])))
    # A worker that outlives this command must not take a file for the one it has replaced.
    models = (Path(name) for some in matcher[1:] if isinstance(some, tuple) for name in some)
    versions = tuple(map(version_of, [*stores, *models]))
    given: Any = (stores, *matcher[1:])
    opening = Opening((versions, *given), partial(Matcher, *given))
    jobs = [replace(one, path=str(Path(one.path).absolute())) for one in queries]
    names = [f"query-{index}" for index in range(len(jobs))]
    matched = runner(_match, opening, jobs, names)
    for query, result in zip(queries, matched, strict=True):
        yield _named_as(query.path, result)


def _named_as(path: str, result: MatchResult | SkylineError) -> MatchResult | SkylineError:
    """Return the result of a worker, which knows a photo by its absolute path, with a path."""
    if isinstance(result, MatchResult):
        return replace(result, name=path)
    return type(result)(str(result).replace(str(Path(path).absolute()), path))


def _match(matcher: Matcher, query: Query, _: Tell | None = None) -> MatchResult:
    """Match one query; the result's seconds include reading it."""
    started = time.perf_counter()
    found = matcher.match(query.read(), narrowing=query.narrowing)
    seconds = time.perf_counter() - started
    return replace(found, seconds=seconds, name=query.path, id=query.label)
