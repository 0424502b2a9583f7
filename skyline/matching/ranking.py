"""What every matcher answers with, and how a list of answers is drawn from all scores."""

from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError
from skyline.matching.profiles import Profiles
from skyline.matching.query import QueryRays

Float64Array = NDArray[np.float64]
IntArray = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A place the query may have been taken at, and how the camera stood there.

    Attributes
    ----------
    easting_m, northing_m : float
    heading_deg : float
        Grid azimuth of the optical axis, in [0, 360).
    pitch_deg, roll_deg : float
        Optical axis above the horizon; camera turned clockwise as seen from behind.
    fov_deg : float
        Horizontal field of view.
    score : float
        Lower is better; its unit is the matcher's.
    confidence : float or None
        Probability that the answer is right, where something has estimated it.
    refined : bool
        Whether the pose was fitted by rendering again.
    covariance_m2 : ((float, float), (float, float)) or None
        Covariance of easting and northing, square metres, where something has estimated it.
    eye_elevation_m : float or None
        Of the camera, above the DEM's datum, where it is known.
    """

    easting_m: float
    northing_m: float
    heading_deg: float
    pitch_deg: float
    roll_deg: float
    fov_deg: float
    score: float
    confidence: float | None = None
    refined: bool = False
    covariance_m2: tuple[tuple[float, float], tuple[float, float]] | None = None
    eye_elevation_m: float | None = None


class Ranker(Protocol):
    """Anything that ranks the places of the store it was made for."""

    def rank(self, query: QueryRays, top: int) -> list[Candidate]:
        """Return up to ``top`` candidates, best first, at most one a location.

        Locations nothing fits at are left out, so the list may be empty.
        """
        ...


class Matcher(Protocol):
    """Anything that can rank the places of any store."""

    def prepare(self, profiles: Profiles) -> Ranker:
        """Return what ranks the places of a store; what queries share is done here, once."""
        ...

    def rank(self, profiles: Profiles, query: QueryRays, top: int) -> list[Candidate]:
        """Return what a prepared matcher does, for a single query; see `Ranker.rank`."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Fits:
    """The best pose of a query at each of L locations.

    Attributes
    ----------
    score : (L,) float64
        Lower is better; infinite where there is no fit.
    heading_deg, pitch_deg, roll_deg : (L,) float64
    """

    score: Float64Array
    heading_deg: Float64Array
    pitch_deg: Float64Array
    roll_deg: Float64Array

    @classmethod
    def none(cls, locations: int) -> "Fits":
        """Return no fit at any location."""
        return cls(np.full(locations, np.inf), *np.zeros((3, locations)))

    def spread(self, rows: IntArray, locations: int) -> "Fits":
        """Return these as the fits of ``rows`` among ``locations``, with none elsewhere."""
        wide = Fits.none(locations)
        for f in fields(self):
            getattr(wide, f.name)[rows] = getattr(self, f.name)
        return wide

    def split(self, parts: int) -> list["Fits"]:
        """Return so many parts of equal length, in order."""
        columns = [np.split(getattr(self, f.name), parts) for f in fields(self)]
        return [Fits(*part) for part in zip(*columns, strict=True)]

    def best_with(self, other: "Fits") -> "Fits":
        """Return the better of two at each location; this one where they are equal."""
        better = other.score < self.score
        return Fits(
            np.where(better, other.score, self.score),
            np.where(better, other.heading_deg, self.heading_deg),
            np.where(better, other.pitch_deg, self.pitch_deg),
            np.where(better, other.roll_deg, self.roll_deg),
        )


def select(
    profiles: Profiles, fits: Fits, fov_deg: float, top: int, separation_m: float = 0.0
) -> list[Candidate]:
    """Return the best candidates, none within ``separation_m`` of a better one.

    Equal scores keep the order of the locations. Locations without a fit are left out.

    Raises
    ------
    InputError
        ``top`` is below 1.
    """
    if top < 1:
        raise InputError(f"top is {top}; expected at least 1 candidate")
    place = np.stack([profiles.easting_m, profiles.northing_m], axis=1)
    left = np.isfinite(fits.score)
    chosen: list[Candidate] = []
    for location in np.argsort(fits.score, kind="stable"):
        if len(chosen) == top:
            break
        if not left[location]:
            continue
        chosen.append(
            Candidate(
                float(profiles.easting_m[location]),
                float(profiles.northing_m[location]),
                float(fits.heading_deg[location] % 360.0),
                float(fits.pitch_deg[location]),
                float(fits.roll_deg[location]),
                fov_deg,
                float(fits.score[location]),
            )
        )
        if separation_m > 0.0:
            left &= np.hypot(*(place - place[location]).T) >= separation_m
    return chosen
