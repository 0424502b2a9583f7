"""Narrowing: where a search looks, and which way the camera may have looked."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float64Array
from skyline.errors import InputError, swapped_in_words
from skyline.geodesy import Frame, Rectangle, are_bounds, in_turn
from skyline.match.claim import Claim
from skyline.match.hypotheses import Hypotheses
from skyline.match.screening import turns_within
from skyline.store.places import Places

_CONVERGENCE_DEG = 5.0
"""More than meridians converge within a frame: turns are screened that much more widely."""


@dataclass(frozen=True, slots=True)
class Narrowing:
    """What is known of where a photo was taken; what is None is not known.

    Attributes
    ----------
    near : (float, float, float), optional
        Longitude and latitude, degrees (WGS 84), and a radius, km.
    bounds_deg : (float, float, float, float), optional
        West, south, east, north, degrees.
    heading_deg : (float, float), optional
        Of the optical axis from true north, and how far it may be off, degrees.
    elevation_m : (float, float), optional
        The lowest and the highest the camera may have stood, above the DEM's datum.
    eye_height_m : float, optional
        How high above the ground the camera stood; by default it is found with the pose.
    use_gps : bool
        Whether the place and the direction that the photo's own EXIF notes draw the search. They
        never end it: a place far off wins where its skyline fits well enough.

    Raises
    ------
    InputError
        A value out of its range.
    """

    near: tuple[float, float, float] | None = None
    bounds_deg: tuple[float, float, float, float] | None = None
    heading_deg: tuple[float, float] | None = None
    elevation_m: tuple[float, float] | None = None
    eye_height_m: float | None = None
    use_gps: bool = False

    def __post_init__(self) -> None:
        if self.near is not None:
            lon, lat, radius_km = self.near
            if not (abs(lon) <= 180.0 and abs(lat) <= 90.0 and 0.0 < radius_km < np.inf):
                is_swapped = abs(lon) <= 90.0 < abs(lat) <= 180.0
                raise InputError(
                    f"near is {lon:g},{lat:g},{radius_km:g}; expected longitude and latitude in "
                    "degrees and a radius above 0 km"
                    + (f"; {swapped_in_words(lon, lat)}" if is_swapped else "")
                )
        if self.heading_deg is not None:
            heading, slack = self.heading_deg
            if not (np.isfinite(heading) and 0.0 < slack <= 180.0):
                raise InputError(
                    f"heading is {heading:g} within {slack:g} degrees; expected a slack above 0, "
                    "at most 180"
                )
        if self.elevation_m is not None:
            low, high = self.elevation_m
            if not (np.isfinite(self.elevation_m).all() and low < high):
                raise InputError(
                    f"elevations are {low:g} to {high:g} m; expected two that increase"
                )
        if self.eye_height_m is not None and not 0.0 <= self.eye_height_m < np.inf:
            raise InputError(
                f"the eye is {self.eye_height_m:g} m above the ground; expected 0 or more"
            )

    def within(self, frame: Frame, claim: Claim | None = None) -> "Narrowed | None":
        """Return this as a test of places in a frame; None where nothing is known.

        ``claim`` is what the photo's own EXIF says. Raises as `Frame.rectangle_m`.
        """
        if self == Narrowing() and claim is None:
            return None
        turns, rectangle = None, None
        circles: tuple[tuple[float, float, float], ...] = ()
        if self.near is not None:
            east, north = frame.from_lonlat(self.near[0], self.near[1])
            circles = ((float(east), float(north), 1000.0 * self.near[2]),)
        if self.heading_deg is not None:
            heading, slack = self.heading_deg
            turns = turns_within(heading, slack + _CONVERGENCE_DEG)
        if self.bounds_deg is not None:
            rectangle = frame.rectangle_m(self.bounds_deg)
        return Narrowed(self, frame, circles, rectangle, turns, claim)


@dataclass(frozen=True, slots=True)
class Narrowed:
    """A narrowing as a test of places in a frame: metres instead of degrees."""

    narrowing: Narrowing
    frame: Frame
    circles_m: tuple[tuple[float, float, float], ...]
    """East, north and radius of circles that all hold what is searched."""
    rectangle_m: Rectangle | None
    """Around the bounds."""
    open_turns: BoolArray | None
    """(180,) bool. The turns that are screened; see `turns_within`."""
    claim: Claim | None = None
    """Where the photo says that it was taken."""

    def swapped(self, places: Places) -> str:
        """Return the suspicion that longitudes and latitudes are swapped; empty without one.

        They are if the swapped narrowing is in the rectangle around the places.
        """
        west, east = places.easting_m.min(), places.easting_m.max()
        south, north = places.northing_m.min(), places.northing_m.max()
        near, bounds = self.narrowing.near, self.narrowing.bounds_deg
        if near is not None and max(abs(near[0]), abs(near[1])) <= 90.0:
            easting, northing = self.frame.from_lonlat(near[1], near[0])
            if west <= easting <= east and south <= northing <= north:
                return f"; {swapped_in_words(*near[:2])}"
        if bounds is not None and are_bounds(bounds[1], bounds[0], bounds[3], bounds[2]):
            box = self.frame.rectangle_m((bounds[1], bounds[0], bounds[3], bounds[2]))
            if box[0] <= east and west <= box[2] and box[1] <= north and south <= box[3]:
                return f"; {swapped_in_words(*bounds)}"
        return ""

    def about_the_claim(self) -> "Narrowed | None":
        """Return this, narrowed to where the photo says that it was taken; None without a claim."""
        if self.claim is None:
            return None
        circle = self.claim.easting_m, self.claim.northing_m, self.claim.reach_m
        return replace(self, circles_m=(*self.circles_m, circle))

    def __call__(self, places: Places) -> BoolArray:
        """Return which places (N,) are searched."""
        return self._holds(places.easting_m, places.northing_m, places.eye_elevation_m)

    def holds(self, poses: Hypotheses) -> BoolArray:
        """Return which poses (M,) are within the narrowing, their headings too."""
        held = self._holds(poses.easting_m, poses.northing_m, poses.eye_elevation_m)
        if self.narrowing.heading_deg is not None and len(poses):
            heading, slack = self.narrowing.heading_deg
            turn = self.frame.convergence_deg(
                easting_m=poses.easting_m, northing_m=poses.northing_m
            )
            off = in_turn(poses.heading_deg + turn - heading)
            held &= np.abs(off) <= slack
        return held

    def _holds(
        self, easting_m: Float64Array, northing_m: Float64Array, elevation_m: NDArray[np.floating]
    ) -> BoolArray:
        narrowing = self.narrowing
        held = np.ones(len(easting_m), dtype=bool)
        if narrowing.elevation_m is not None:
            low, high = narrowing.elevation_m
            held &= (elevation_m >= low) & (elevation_m <= high)
        for east, north, radius_m in self.circles_m:
            held &= (easting_m - east) ** 2 + (northing_m - north) ** 2 <= radius_m**2
        if self.rectangle_m is not None:
            west, south, east, north = self.rectangle_m
            held &= (easting_m >= west) & (easting_m <= east)
            held &= (northing_m >= south) & (northing_m <= north)
        return held
