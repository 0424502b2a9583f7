"""The answer to one photo, as sentences, JSON, rows and tables."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from html import escape
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from pyproj import CRS

from skyline.angles import wrapped_deg
from skyline.errors import InputError, library, printable
from skyline.geodesy.bounds import distance_in_words
from skyline.geodesy.crs import WGS84
from skyline.geodesy.map_frame import geodesic_m
from skyline.match.narrowing import Narrowing
from skyline.photo.noted_place import NOTHING_NOTED
from skyline.photo.skyline import PhotoSkyline
from skyline.pose.pose import COLUMNS, ROUGHLY_WITHIN_M, WRITTEN, Pose

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from pandas import DataFrame

    from skyline.match.joint_result import JointResult

TOP = 5
"""Candidates that a search returns by default."""
NORTHS = {True: ", from magnetic north", False: "", None: ", from a north that it does not name"}
"""The north from which a photo's direction counts, in words, by `NotedPlace.is_magnetic`."""
_NO_COLUMNS = {"covariance_m2", "covariance", "rank"}
"""Fields of a pose of which `to_geodataframe` makes other columns, or none."""
_COVARIANCE = ("easting_variance_m2", "northing_variance_m2", "easting_northing_covariance_m2")


@dataclass(frozen=True, slots=True)
class Disagreement:
    """Errors above which a photo's notes disagree with an answer.

    Phones are seldom this wrong.
    """

    position_m: float = 500.0
    """Distance of the answer from the noted position."""
    accuracies: float = 5.0
    """The same distance, as a multiple of the noted accuracy; it must exceed both."""
    compass_deg: float = 45.0
    """Turn of the answer from the noted heading."""


_DISAGREEMENT = Disagreement()


@dataclass(frozen=True, slots=True)
class MatchResult:
    """The candidates found for one photo, and its answer.

    The best candidate is the answer if it is sure enough.

    Attributes
    ----------
    skyline : PhotoSkyline
        The skyline that was matched.
    candidates : tuple of Pose
        Best first.
    seconds : float
        From the photo to the candidates.
    refusal : str or None
        Why there is no answer, where there is none.
    within_m : float or None
        Distance within which the answer is sure to be right: 200 m, or 1 km where only that is
        sure. None without an answer.
    name : str
        The photo's file, as it was given to the matcher; empty for a `PhotoSkyline`.
    id : str
        The ``id`` or ``name`` that a list of photos gives it; else empty.
    narrowing : Narrowing or None
        What was known about the pose in a search for this photo alone; None for any other result.
    crs : pyproj.CRS
        The CRS of longitudes and latitudes: WGS 84, or degrees on another world.
    """

    skyline: PhotoSkyline
    candidates: tuple[Pose, ...]
    seconds: float
    refusal: str | None = None
    within_m: float | None = None
    name: str = ""
    id: str = ""
    narrowing: Narrowing | None = None
    crs: CRS = field(default_factory=lambda: WGS84)

    @property
    def best(self) -> Pose | None:
        """The best candidate, answer or not; None without candidates."""
        return self.candidates[0] if self.candidates else None

    @property
    def answer(self) -> Pose | None:
        """The best candidate, if it is sure enough to be the answer."""
        return None if self.refusal else self.best

    @property
    def confidence(self) -> float | None:
        """The estimated probability that the answer is right within `within_m`."""
        return None if self.answer is None else confidence_within(self.answer, self.within_m)

    def chosen(self, rank: int) -> "MatchResult":
        """Return the result with a chosen candidate first.

        A person chose it by its rank. It is the answer only if it was the answer of the search.
        """
        if rank == 1:
            return self
        first = self.candidates[rank - 1]
        others = (one for one in self.candidates if one is not first)
        refusal = self.refusal or "chosen by a person"
        return replace(self, candidates=(first, *others), refusal=refusal, within_m=None)

    @property
    def summary(self) -> str:
        """Where the photo was taken, or why unknown, in one sentence."""
        refusal = self.refusal or "no place fits"
        best = self.best
        if best is None:
            return f"Not answered: {refusal}."
        place = (
            f"latitude {best.lat:.5f}°, longitude {best.lon:.5f}°, looking "
            f"{best.heading_deg:.1f}° from true north"
        )
        confidence = confidence_within(best, self.within_m)
        if confidence is not None:
            place += f", confidence {100.0 * confidence:.0f}\N{NO-BREAK SPACE}%"
        if self.answer is not None and self.within_m is not None:
            place += f", right within {self.within_m:g} m"
        if best.rank is None:
            if best.refined and self.refusal:
                return f"Fitted, and the fit has failed: {place}; {self.refusal}."
            residual = best.residual_in_words
            return f"{best.origin.capitalize()}: {place}{residual and f'; {residual}'}."
        if best.rank > 1:
            return f"Pose {best.rank}, chosen by a person: {place}."
        if self.refusal:
            return f"Not answered: {refusal} ({place})."
        return f"Taken at {place}{'' if best.refined else ' (not refined by rendering)'}."

    @property
    def beyond(self) -> str | None:
        """A warning that the skyline may lie beyond the elevation model.

        It is given if a tenth of the skyline or more may.
        """
        share = None if self.best is None else self.best.beyond_share
        if share is None or share < 0.1:
            return None
        return (
            f"{100.0 * share:.0f} % of the skyline may be terrain beyond the edge of the elevation "
            "model. A model that reaches farther may give another answer."
        )

    @property
    def exif(self) -> dict[str, Any] | None:
        """The pose noted in EXIF, and the best candidate's distance from it.

        The keys are as in ``exif`` of ``skyline match --json``. ``heading_off_deg`` is how far the
        best candidate's heading is clockwise of the photo's; ``heading_is_magnetic`` is None if the
        photo does not say which north its direction counts from; ``left_aside`` names the GPS tags
        that cannot be used, with the reasons. None where the photo notes nothing.
        """
        noted = self.skyline.noted
        best = self.best
        if noted == NOTHING_NOTED:
            return None
        lon, lat = noted.lonlat_deg or (None, None)
        distance_m = off_deg = None
        if best is not None and noted.lonlat_deg is not None:
            distance_m = geodesic_m(*noted.lonlat_deg, best.lon, best.lat)
        if best is not None and noted.heading_deg is not None:
            off_deg = float(wrapped_deg(best.heading_deg - noted.heading_deg))
        return {
            "lon": lon,
            "lat": lat,
            "elevation_m": noted.elevation_m,
            "accuracy_m": noted.accuracy_m,
            "heading_deg": noted.heading_deg,
            "heading_is_magnetic": noted.is_magnetic,
            "distance_m": distance_m,
            "heading_off_deg": off_deg,
            "left_aside": noted.left_aside,
        }

    def exif_in_words(self, with_place: bool = True) -> str:
        """Return `exif` in sentences, with or without the noted position."""
        exif = self.exif
        best = self.best
        if exif is None:
            return ""
        sentences: list[str] = []
        it = "the answer" if self.answer is not None or best is None else best.name
        if exif["lat"] is not None:
            where = f"lat {exif['lat']:.5f} lon {exif['lon']:.5f}" if with_place else "a place"
            distance = distance_in_words(exif["distance_m"] or 0.0)
            off = "" if best is None else f", {distance} from {it}"
            accuracy = (
                "" if exif["accuracy_m"] is None else f" (good to {exif['accuracy_m']:.0f} m)"
            )
            sentences.append(f"The photo says {where}{off}{accuracy}.")
        if exif["heading_deg"] is not None:
            north = NORTHS[exif["heading_is_magnetic"]]
            own = "" if best is None else f", {it} {best.heading_deg:.0f}"
            sentences.append(f"Its compass says {exif['heading_deg']:.0f} degrees{north}{own}.")
        wrong = _disagreeing(exif)
        if wrong:
            notes = " and ".join(wrong)
            then = "one of them is wrong"
            if self.answer is None and "position" in wrong:
                then = "if the photo is right, search round its position"
            sentences.append(f"The photo's {notes} and {it} disagree: {then}.")
        return " ".join(filter(None, [*sentences, exif["left_aside"]]))

    def to_dict(self) -> dict[str, Any]:
        """Return the result as ``skyline match --json`` prints it.

        The key ``refusal`` is present if there is no answer, ``exif`` if the photo notes a place or
        a direction, ``lens`` if it notes a lens and no field of view was given.
        """
        candidates = [one.to_dict() for one in self.candidates]
        lens = self.skyline.lens
        exif = self.exif
        return {
            "photo": printable(self.name),
            **({"id": printable(self.id)} if self.id else {}),
            **self.skyline.form,
            "answer": candidates[0] if self.answer is not None else None,
            "answer_within_m": self.within_m,
            "answer_confidence": self.confidence,
            "candidates": candidates,
            "seconds": self.seconds,
            **({} if self.refusal is None else {"refusal": self.refusal}),
            **({} if lens is None or not lens.reason else {"lens": asdict(lens)}),
            **({} if exif is None else {"exif": exif}),
        }

    def to_row(self) -> dict[str, Any]:
        """Return the best candidate and its verdict, as for ``--results``."""
        best = self.best
        exif = self.exif
        row = dict.fromkeys(WRITTEN) if best is None else best.to_dict()
        return row | {
            "photo": printable(self.name),
            "id": printable(self.id) or None,
            "answered": int(self.answer is not None),
            "within_m": self.within_m,
            "exif_distance_m": None if exif is None else exif["distance_m"],
            "seconds": self.seconds,
            "reason": self.refusal and printable(self.refusal),
        }

    def to_text(self) -> str:
        """Return the lines that ``skyline match`` prints."""
        lens = self.skyline.lens
        lines = [f"{printable(self.name) or 'photo'} ({self.seconds:.2f} s)"]
        lines += verdict_lines(self, "candidate 1")
        if self.candidates:
            lines.append("candidates, best first:")
        for number, one in enumerate(self.candidates, start=1):
            unrefined = "" if one.refined else "  (unrefined)"
            words = place_in_words(one), view_in_words(one), quality_in_words(one)
            lines.append(f"{number}. {'  '.join(words)}{unrefined}")
        if 0 < len(self.candidates) < TOP:
            lines.append("no other place fits well enough to be a candidate")
        if self.beyond:
            lines.append(self.beyond)
        if lens is not None:
            lines.append(lens.in_words)
        return "\n  ".join(filter(None, [*lines, self.exif_in_words()]))

    def to_dataframe(self) -> "DataFrame":
        """Return the candidates as a pandas DataFrame, one row each, best first."""
        pandas = library("pandas", "a DataFrame")
        # Also a result without candidates has the columns.
        return pandas.DataFrame([one.to_dict() for one in self.candidates], columns=[*WRITTEN])

    def to_geodataframe(self) -> "GeoDataFrame":
        """Return the candidates as points of a GeoDataFrame; see `skyline.to_geodataframe`."""
        return to_geodataframe([self])

    def __repr__(self) -> str:
        return f"MatchResult({self.summary} Candidates: {len(self.candidates)})"

    def _repr_html_(self) -> str:
        header = "".join(f"<th>{escape(name)}</th>" for name in ("#", *COLUMNS))
        rows = "".join(
            f"<tr><td>{one.rank}</td>{''.join(f'<td>{text}</td>' for text in one.cells())}</tr>"
            for one in self.candidates
        )
        table = f"<table><tr>{header}</tr>{rows}</table>" if rows else ""
        return f"<div><p>{escape(self.summary)}</p>{_skyline_svg(self.skyline)}{table}</div>"


class Tabled(Protocol):
    """A match or an orientation, as a row of a table."""

    def to_row(self) -> dict[str, Any]:
        """Return the row's values by column."""


def listed(results: Any) -> list[Any]:
    """Return results as a list, a single one too.

    Raises `InputError` for anything else.
    """
    if hasattr(results, "to_row"):
        return [results]
    if not isinstance(results, Iterable):
        raise InputError(f"results are {results!r}; expected a list of results")
    return list(results)


def to_dataframe(results: Iterable[Tabled]) -> "DataFrame":
    """Return results as a table, one row each.

    Returns
    -------
    pandas.DataFrame
        The columns of ``skyline match --results`` or of ``skyline orient -o``: the photo, the
        best pose, its confidence, and the reason where there is no answer.

    Raises
    ------
    InputError
        Pandas is not installed.
    """
    return library("pandas", "a DataFrame").DataFrame([one.to_row() for one in listed(results)])


def to_geodataframe(results: Iterable[MatchResult]) -> "GeoDataFrame":
    """Return the candidates of results as points, one row each.

    Returns
    -------
    geopandas.GeoDataFrame
        Points in the results' `crs`, WGS 84 on the Earth, with ``photo`` (the result's number, from
        0), ``rank`` (1 is the best), ``is_answer`` (whether it is the answer) and the fields of
        `Pose`; the place's covariance becomes three columns, which files can hold. Unknown values
        are missing.

    Raises
    ------
    InputError
        GeoPandas is not installed.
    """
    geopandas = library("geopandas", "a GeoDataFrame")
    names = [n for n in Pose.__dataclass_fields__ if n not in _NO_COLUMNS]
    columns: dict[str, list[Any]] = {
        name: [] for name in ("photo", "rank", "is_answer", *names, *_COVARIANCE)
    }
    given = listed(results)
    for number, result in enumerate(given):
        for one in result.candidates:
            (east, both), (_, north) = one.covariance_m2 or ((None, None), (None, None))
            row = asdict(one) | dict(zip(_COVARIANCE, (east, north, both), strict=True))
            row |= {"photo": number, "is_answer": one is result.answer}
            for name, values in columns.items():
                values.append(math.nan if row[name] is None else row[name])
    places = geopandas.points_from_xy(columns["lon"], columns["lat"])
    return geopandas.GeoDataFrame(columns, geometry=places, crs=given[0].crs if given else WGS84)


def confidence_within(one: Pose, within_m: float | None) -> float | None:
    """Return a pose's confidence within a distance, 200 m or 1 km.

    Without a distance it is the confidence within 200 m.
    """
    return one.confidence_1km if within_m == ROUGHLY_WITHIN_M else one.confidence


def verdict_lines(result: "MatchResult | JointResult", best: str) -> Iterator[str]:
    """Yield lines on the answer, or on why there is none."""
    if result.answer is not None:
        sure = ""
        if result.confidence is not None and result.within_m is not None:
            sure = f", right within {result.within_m:g} m with confidence {result.confidence:.2f}"
        yield f"the answer is {best}{sure}"
    if result.refusal:
        yield f"no answer: {result.refusal}"


def place_in_words(one: Pose) -> str:
    """Return latitude, longitude and radius of a pose in words."""
    radius = "" if one.radius_m is None else f" +- {one.radius_m:.0f} m"
    return f"lat {one.lat:.5f} lon {one.lon:.5f}{radius}"


def view_in_words(one: Pose) -> str:
    """Return heading, pitch and field of view of a pose in words."""
    return (
        f"heading {one.heading_deg:.1f} from true north  pitch {one.pitch_deg:.1f}  fov "
        f"{one.fov_deg:.1f}"
    )


def quality_in_words(one: Pose) -> str:
    """Return a pose's confidences in words, or else its cost."""
    if one.confidence is None:
        return f"cost {one.cost:.3g} (the lower, the better it fits)"
    return f"confidence {one.confidence:.2f} within 200 m, {one.confidence_1km:.2f} within 1 km"


def _disagreeing(exif: Mapping[str, Any]) -> list[str]:
    """Return which of the notes in `MatchResult.exif` disagree with the pose."""
    far_m = max(_DISAGREEMENT.position_m, _DISAGREEMENT.accuracies * (exif["accuracy_m"] or 0.0))
    is_off = {
        "position": (exif["distance_m"] or 0.0) > far_m,
        "compass": abs(exif["heading_off_deg"] or 0.0) > _DISAGREEMENT.compass_deg,
    }
    return [note for note, off in is_off.items() if off]


def _skyline_svg(skyline: PhotoSkyline) -> str:
    runs = np.flatnonzero(np.diff(skyline.trusted, prepend=False, append=False)).reshape(-1, 2)
    lines = "".join(
        "M" + " ".join(f"{col},{skyline.row_px[col]:.1f}" for col in range(start, stop))
        for start, stop in runs.tolist()
    )
    size = f"{skyline.width_px} {skyline.height_px}"
    return (
        f'<svg viewBox="0 0 {size}" width="360" style="border: 1px solid; margin: 0.5em 0">'
        f'<path d="{lines}" fill="none" stroke="crimson" vector-effect="non-scaling-stroke"/></svg>'
    )
