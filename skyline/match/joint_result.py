"""The answer to several photos of one place, as sentences and JSON."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from skyline.errors import printable
from skyline.match.narrowing import Narrowing
from skyline.match.result import (
    MatchResult,
    confidence_within,
    place_in_words,
    quality_in_words,
    to_dataframe,
    to_geodataframe,
    verdict_lines,
    view_in_words,
)
from skyline.pose.pose import Pose

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from pandas import DataFrame

_OF_CAMERA = (
    "heading_deg", "pitch_deg", "roll_deg", "fov_deg", "distortion", "beyond_share",
    "residual_deg", "terrain_share", "skyline_m", "covariance",
)  # fmt: skip
"""Keys of a candidate that differ between photos of one place."""


@dataclass(frozen=True, slots=True)
class JointResult:
    """The places found for several photos that were taken at one place.

    Attributes
    ----------
    results : tuple of MatchResult
        One for each photo. The candidates of those that agree are the same places with the same
        confidences; each has its own camera there. A photo that does not agree has no candidates,
        and its refusal says why.
    seconds : float
        From the photos to the places.
    refusal : str or None
        Why there is no answer, where there is none.
    narrowings : tuple of Narrowing
        What was known about the pose of each photo.
    """

    results: tuple[MatchResult, ...]
    seconds: float
    refusal: str | None = None
    narrowings: tuple[Narrowing, ...] = ()

    @property
    def agrees(self) -> tuple[bool, ...]:
        """Whether each photo was likely taken at the best place."""
        return tuple(bool(one.candidates) for one in self.results)

    @property
    def first(self) -> MatchResult | None:
        """The result of the first photo that agrees, or None."""
        return next((one for one in self.results if one.candidates), None)

    @property
    def candidates(self) -> tuple[Pose, ...]:
        """The common candidates, best first.

        They have the camera of the first photo that agrees.
        """
        return () if self.first is None else self.first.candidates

    @property
    def answer(self) -> Pose | None:
        """The best place, if it is sure enough to be the answer.

        The camera is as in `candidates`.
        """
        return self.candidates[0] if self.candidates and not self.refusal else None

    @property
    def within_m(self) -> float | None:
        """Distance within which the answer is surely right; None without one."""
        return None if self.first is None else self.first.within_m

    @property
    def confidence(self) -> float | None:
        """The estimated probability that the answer is right within `within_m`."""
        return None if self.answer is None else confidence_within(self.answer, self.within_m)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as ``skyline match --same-place --json`` prints it.

        Places are candidates without a camera; each photo that agrees has its own.
        """
        places = [
            {name: value for name, value in one.to_dict().items() if name not in _OF_CAMERA}
            for one in self.candidates
        ]
        photos = []
        for one, agrees in zip(self.results, self.agrees, strict=True):
            about: dict[str, Any] = {"refusal": one.refusal}
            if one.best is not None:
                of_best = one.best.to_dict()
                about = {name: of_best[name] for name in _OF_CAMERA}
            names = {"photo": printable(one.name), **({"id": printable(one.id)} if one.id else {})}
            photos.append({**names, "agrees": agrees, **about})
        return {
            "answer": places[0] if self.answer is not None else None,
            "answer_within_m": self.within_m,
            "answer_confidence": self.confidence,
            "candidates": places,
            **({} if self.refusal is None else {"refusal": self.refusal}),
            "photos": photos,
            "seconds": self.seconds,
        }

    def to_text(self) -> str:
        """Return the lines that ``skyline match --same-place`` prints."""
        lines = [f"{len(self.results)} photos of one place ({self.seconds:.2f} s)"]
        lines += verdict_lines(self, "place 1")
        if self.candidates:
            lines.append("places, best first:")
        for number, one in enumerate(self.candidates, start=1):
            lines.append(f"{number}. {place_in_words(one)}  {quality_in_words(one)}")
        for result in self.results:
            refused = f"does not agree: {result.refusal}"
            view = refused if result.best is None else view_in_words(result.best)
            lines.append(f"{printable(result.name)}: {view}")
        return "\n  ".join(lines)

    def to_dataframe(self) -> "DataFrame":
        """Return the cameras as a pandas DataFrame, one row a photo.

        See `skyline.to_dataframe`.
        """
        return to_dataframe(self.results)

    def to_geodataframe(self) -> "GeoDataFrame":
        """Return the cameras as points of a GeoDataFrame; see `skyline.to_geodataframe`."""
        return to_geodataframe(self.results)

    def __repr__(self) -> str:
        first = self.first
        summary = f"Not answered: {self.refusal}." if first is None else first.summary
        return f"JointResult({summary} {sum(self.agrees)} of {len(self.results)} photos agree)"
