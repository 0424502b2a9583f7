r"""Prior knowledge of a pose, from the user and from EXIF.

A compass is little more than a hint. A position from EXIF has a long-tailed error: it is usually
near the truth, with an error like a two-dimensional Cauchy distribution, and now and then it is the
position of another photo or an old fix of the phone. The density of the true place at distance d
from a noted position is therefore

.. math::

    p(d) = \frac{1 - w}{2 \pi s^2} \left(1 + \frac{d^2}{s^2}\right)^{-3/2} + \frac{w}{A}

and a distant place is never less likely than in a search of area A without a noted position.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import BoolArray, Complex128Array, Float64Array
from skyline.errors import InputError, numbers_of, swapped_in_words
from skyline.geodesy.bounds import Circle, check_bounds, in_turn
from skyline.geodesy.map_frame import Frame, Rectangle, in_rectangle
from skyline.match.screen import turns_within
from skyline.photo.noted_place import NotedPlace
from skyline.pose import Poses
from skyline.store.places import Places
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, LEAST_EYE_HEIGHT_M

GPS_SD_M = 30.0
"""Scale of the error of a position without a noted accuracy."""


NOTED_KM = 10.0
"""Radius of a search around a position that a photo notes, or around a named place."""


@dataclass(frozen=True, slots=True)
class _ExifErrors:
    """Assumed errors of EXIF's positions, altitudes and compasses."""

    wrong_share: float = 0.05
    """w, the share of wrong positions. Of 20 photos examined, one had a position 6 km off."""
    least_position_sd_m: float = 15.0
    """Least scale of a position's error, since the terrain model is off too."""
    anywhere_m2: float = 1e9
    """A, a circle of 18 km: the area of a search without a noted position."""
    reach_m: float = 1000.0
    """A search looks within this distance of the noted place, plus `reach_sds` of its scales."""
    reach_sds: float = 3.0
    least_altitude_sd_m: float = 15.0
    """Least scale of an altitude's error, as the datum may differ from the terrain model's."""
    altitude_accuracies: float = 3.0
    """Heights are two to three times as uncertain as places."""
    height_tail: float = 1.5
    """Exponent of the density of an altitude's error e of scale s, (1 + (e / s)^2)^-1.5 / (2 s)."""
    altitude_sd_m: float = math.hypot(30.0 / math.sqrt(2.0), 15.0)
    """Scale of an altitude without an accuracy. The geoid's height above the ellipsoid has a root
    mean square of 30 m over the Earth (EGM96). Half of the devices are taken to note heights above
    the ellipsoid as heights above the sea: Android's `Location.getAltitude` gives these, and so do
    some drones (OpenAthena's issues 24 and 65)."""
    barometer_sd_m: float = 90.0
    """Scale of a drone's altitude, which its barometer gives for the standard atmosphere. The
    pressure at sea level varies by 10 hPa, of 8.4 m each, and the temperature by 10 K, 3.5 % of the
    height. One hill's altitude varied by 150 m in two weeks (DroneDeploy's forum 7617), another's
    by 200 m in some months (mavicpilots.com, thread 147682)."""
    takeoff_sd_m: float = 5.0
    """Drift of a drone's height above its take-off."""
    takeoff_share: float = 0.035
    """Error of that height due to temperature, as a share of it."""
    compass_wrong_share: float = 0.2
    """Share of photos whose compass was disturbed, as by a car, a railing or a case."""
    compass_sd_deg: float = 20.0
    """Standard deviation of a compass from true north. The declination is not modelled, and reaches
    20 degrees where people live."""
    magnetic_sd_deg: float = 30.0
    """A compass that does not name its north may refer to the magnetic one."""


_EXIF = _ExifErrors()


@dataclass(frozen=True, slots=True)
class _Aloft:
    """Assumptions about eyes in flight."""

    share: float = 0.05
    """Share of photos from drones, towers, cable cars and balloons: a guess."""
    drone_share: float = 0.99
    """Share of the photos of drones that are taken in flight: a guess."""
    median_m: float = 100.0
    """Median height. Drones may fly up to 120 m; cable cars and balloons are higher."""
    least_sds: float = 3.0
    """An eye at most this many standard deviations of the terrain model above the usual height may
    stand on the ground."""


_ALOFT = _Aloft()
_LEAST_SD_M = 1e-6
"""Replaces the scale 0 of a known height, by which nothing can be divided."""
_FAR_M = 1e9
"""Stands for a place that is not on a map."""
_GREATEST_SD = 20.0
"""Greatest height of an eye that is tried, in scales of its prior above the usual height."""
_CONVERGENCE_DEG = 5.0
"""Bound on the convergence of meridians within a frame; screening searches turns this much farther
to either side of a given heading."""
_NUMBERS = {
    "near": ("longitude", "latitude", "km"), "bounds_deg": ("west", "south", "east", "north"),
    "heading_deg": ("heading", "greatest error"), "elevation_m": ("lowest", "highest"),
}  # fmt: skip
"""Names of the numbers in each field of a narrowing, for its errors."""


@dataclass(frozen=True, slots=True)
class PlacePrior:
    """Prior density of a camera's position and heading, from a photo's EXIF."""

    easting_m: float
    northing_m: float
    sd_m: float
    """Scale s of the position's error."""
    grid_heading_deg: float | None = None
    """Grid azimuth of the optical axis."""
    heading_sd_deg: float = _EXIF.compass_sd_deg
    """Standard deviation of the heading, where the compass is not disturbed."""
    elevation_m: float | None = None
    """Elevation of the eye; its error is distributed like a position's error along one axis."""
    elevation_sd_m: float = _EXIF.least_altitude_sd_m
    """Scale of that distribution."""

    @classmethod
    def of_noted(cls, noted: NotedPlace, frame: Frame) -> "PlacePrior | None":
        """Return the prior from a photo's EXIF in a frame.

        None if EXIF notes no position.
        """
        if noted.lonlat_deg is None:
            return None
        east, north = (float(value) for value in frame.from_lonlat(*noted.lonlat_deg))
        if not (np.isfinite(east) and np.isfinite(north)):
            return None  # Too far from the frame to have a place in it.
        prior = cls(east, north, noted_position_sd_m(noted))
        if noted.accuracy_m is not None:
            # Other altitudes would pull an eye of unknown place to ground that is too high.
            prior = replace(
                prior, elevation_m=noted.elevation_m, elevation_sd_m=_altitude_sd_m(noted)
            )
        return prior.looking_as(noted, frame)

    def looking_as(self, noted: NotedPlace, frame: Frame) -> "PlacePrior":
        """Return the prior with the compass direction that a photo notes, if any."""
        if noted.heading_deg is None:
            return self
        turn_deg = frame.convergence_deg(easting_m=self.easting_m, northing_m=self.northing_m)
        return replace(
            self,
            grid_heading_deg=noted.heading_deg - float(turn_deg),
            heading_sd_deg=noted_heading_sd_deg(noted),
        )

    def cost(
        self, place_m: Complex128Array, eye_m: Float64Array, heading_rad: Float64Array
    ) -> Float64Array:
        """Return the negative log density (M,) of poses over a uniform one.

        ``place_m`` holds eastings, and northings as the imaginary part; headings are grid
        azimuths of the optical axis.
        """
        cost = -np.log(_EXIF.wrong_share + self._peak * self._tail(place_m) ** -1.5)
        if self.grid_heading_deg is not None:
            turn = np.degrees(heading_rad) - self.grid_heading_deg
            off = in_turn(turn) / self.heading_sd_deg
            right = 360.0 / (np.sqrt(2.0 * np.pi) * self.heading_sd_deg)
            right *= 1.0 - _EXIF.compass_wrong_share
            cost = cost - np.log(_EXIF.compass_wrong_share + right * np.exp(-0.5 * off**2))
        if self.elevation_m is not None:
            off = (eye_m - self.elevation_m) / self.elevation_sd_m
            cost = cost + _EXIF.height_tail * np.log1p(off**2)
        return np.asarray(cost)

    def pull(
        self, place_m: Complex128Array, eye_m: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return the normal distribution that pulls eyes like this density.

        The results are its precisions (M, 3) along easting, northing and elevation, and the offsets
        (M, 3) of the eyes from the noted place, metres; precision times offset is the gradient of
        `cost`.
        """
        tail = self._tail(place_m)
        pull = 3.0 * self._peak * tail**-2.5 / self.sd_m**2
        across = pull / (_EXIF.wrong_share + self._peak * tail**-1.5)
        off = place_m - complex(self.easting_m, self.northing_m)
        offset_m = np.column_stack([off.real, off.imag, np.zeros_like(eye_m)])
        precision = np.stack([across, across, np.zeros_like(across)], axis=1)
        if self.elevation_m is not None:
            offset_m[:, 2] = eye_m - self.elevation_m
            spread = self.elevation_sd_m**2 + offset_m[:, 2] ** 2
            precision[:, 2] = 2.0 * _EXIF.height_tail / spread
        return precision, offset_m

    @property
    def _peak(self) -> float:
        return (1.0 - _EXIF.wrong_share) * _EXIF.anywhere_m2 / (2.0 * np.pi * self.sd_m**2)

    def _tail(self, place_m: Complex128Array) -> Float64Array:
        off = place_m - complex(self.easting_m, self.northing_m)
        return np.asarray(1.0 + (off.real**2 + off.imag**2) / self.sd_m**2)


@dataclass(frozen=True, slots=True)
class EyeHeightPrior:
    r"""Prior of the height of an eye above the terrain model's ground.

    Most eyes are about as high as a person. Where the model cuts off a summit or a cliff, eyes are
    far above its ground, so the height has a Cauchy distribution about the usual one:
    :math:`-\log p(h) = \log(1 + ((h - usual) / sd)^2)`.
    """

    usual_m: float
    sd_m: float
    """Scale of the distribution; 0 for a known height."""

    @property
    def range_m(self) -> tuple[float, float]:
        """The smallest and the greatest height that are tried."""
        least_m = self.usual_m if self.sd_m == 0.0 else LEAST_EYE_HEIGHT_M
        return least_m, self.usual_m + _GREATEST_SD * self.sd_m

    def cost(self, height_m: Float64Array) -> Float64Array:
        """Return the negative log density of heights (M,), up to a constant."""
        return np.asarray(np.log1p(self._deviations(height_m) ** 2))

    def precision(self, height_m: Float64Array) -> Float64Array:
        """Return the precision (M,) of a normal distribution with the same pull."""
        sd_m = max(self.sd_m, _LEAST_SD_M)
        return np.asarray(2.0 / (sd_m**2 * (1.0 + self._deviations(height_m) ** 2)))

    def _deviations(self, height_m: Float64Array) -> Float64Array:
        return (height_m - self.usual_m) / max(self.sd_m, _LEAST_SD_M)


@dataclass(frozen=True, slots=True)
class KnownGround:
    """The ground at a known place."""

    elevation_m: float
    relief_m: float
    """Standard deviation of the ground's height within the error of the place."""
    takeoff_relief_m: float
    """Standard deviation of the ground's height where a drone that is there may have taken off."""
    height_sd_m: float
    """Standard deviation of the terrain model's heights."""


@dataclass(frozen=True, slots=True)
class Standing:
    """How an eye stands at a known place: grounded or aloft."""

    eye: EyeHeightPrior
    elevation_m: float | None = None
    """Elevation of an eye aloft, as the photo notes it."""
    elevation_sd_m: float = _EXIF.least_altitude_sd_m
    """Scale of its error."""
    cost: float = 0.0
    """Negative log of the density of the usual height, given all heights that the photo notes."""

    @classmethod
    def of_noted(cls, noted: NotedPlace, ground: KnownGround) -> "list[Standing]":
        """Return the ways that a photo's noted heights leave open.

        The ground comes first. A noted height may be far off, so many photos that note one were
        taken on the ground below it.
        """
        on_ground = cls(EyeHeightPrior(DEFAULT_EYE_HEIGHT_M, ground.height_sd_m))
        heights = _noted_heights(noted, ground)
        if not heights:
            return [on_ground]
        flying = _ALOFT.share if noted.takeoff_height_m is None else _ALOFT.drone_share
        peak = (1.0 - flying) / (math.pi * ground.height_sd_m)
        cost = sum(one.cost(DEFAULT_EYE_HEIGHT_M) for one in heights) - math.log(peak)
        found = [replace(on_ground, cost=cost)]
        for height in sorted(heights, key=lambda one: one.sd_m):
            above_m = height.above_m
            if above_m - DEFAULT_EYE_HEIGHT_M <= _ALOFT.least_sds * ground.height_sd_m:
                continue
            if any(abs(above_m - other.eye.usual_m) <= height.sd_m for other in found[1:]):
                continue
            density = (
                flying
                * 2.0
                / (math.pi * _ALOFT.median_m)
                / (1.0 + (above_m / _ALOFT.median_m) ** 2)
            )
            cost = sum(one.cost(above_m) for one in heights) - math.log(density)
            eye = EyeHeightPrior(above_m, max(height.sd_m, ground.height_sd_m))
            elevation_m = ground.elevation_m + above_m
            found.append(cls(eye, elevation_m, height.elevation_sd_m, cost))
        return found


@dataclass(frozen=True, slots=True)
class _NotedHeight:
    """A height above the known ground that a photo notes.

    Its error is distributed as in `PlacePrior`.
    """

    above_m: float
    sd_m: float
    """Scale of the error above the ground, whose elevation is not quite known."""
    elevation_sd_m: float
    """Scale of the error of the elevation."""

    def cost(self, above_m: float) -> float:
        """Return the negative log density of noting this height at others."""
        off = (above_m - self.above_m) / self.sd_m
        return _EXIF.height_tail * math.log1p(off**2) + math.log(2.0 * self.sd_m)


def _noted_heights(noted: NotedPlace, ground: KnownGround) -> list[_NotedHeight]:
    found = []
    if noted.takeoff_height_m is not None:
        drift_m = _EXIF.takeoff_share * abs(noted.takeoff_height_m)
        sd_m = math.hypot(ground.takeoff_relief_m, _EXIF.takeoff_sd_m, drift_m)
        found.append(_NotedHeight(noted.takeoff_height_m, sd_m, sd_m))
    if noted.elevation_m is not None:
        above_m = noted.elevation_m - ground.elevation_m
        sd_m = _altitude_sd_m(noted)
        found.append(_NotedHeight(above_m, math.hypot(sd_m, ground.relief_m), sd_m))
    return found


def noted_position_sd_m(noted: NotedPlace) -> float:
    """Return the scale of the error of a photo's position."""
    return max(_EXIF.least_position_sd_m, noted.accuracy_m or GPS_SD_M)


def noted_heading_sd_deg(noted: NotedPlace) -> float:
    """Return the standard deviation of a photo's undisturbed compass."""
    return _EXIF.compass_sd_deg if noted.is_magnetic is False else _EXIF.magnetic_sd_deg


def _altitude_sd_m(noted: NotedPlace) -> float:
    """Return the scale of the error of a photo's altitude."""
    if noted.takeoff_height_m is not None:
        return _EXIF.barometer_sd_m
    if noted.accuracy_m is None:
        return _EXIF.altitude_sd_m
    # A device that notes its accuracy has satellites in view, and corrects for the geoid.
    return max(_EXIF.least_altitude_sd_m, _EXIF.altitude_accuracies * noted.accuracy_m)


@dataclass(frozen=True, slots=True)
class Narrowing:
    """Knowledge of a photo's pose that narrows its search; None where unknown.

    Attributes
    ----------
    near : (float, float, float), optional
        Longitude and latitude, degrees (WGS 84), and a radius, km.
    bounds_deg : (float, float, float, float), optional
        West, south, east, north, degrees.
    heading_deg : (float, float), optional
        Heading of the optical axis from true north, and its greatest error, degrees.
    elevation_m : (float, float), optional
        The lowest and the highest elevation of the camera, metres above the DEM's datum.
    eye_height_m : float, optional
        Height of the camera above the ground; by default it is found with the pose.
    use_gps : bool
        Whether the place and the direction in the photo's own EXIF pull the search. They never
        bound it: a distant place wins where its skyline fits well enough.

    Raises
    ------
    InputError
        A value is out of its range, or does not have the numbers of its field.
    """

    near: Circle | None = None
    bounds_deg: tuple[float, float, float, float] | None = None
    heading_deg: tuple[float, float] | None = None
    elevation_m: tuple[float, float] | None = None
    eye_height_m: float | None = None
    use_gps: bool = False

    def __post_init__(self) -> None:
        for name, expected in _NUMBERS.items():
            if (given := getattr(self, name)) is not None:
                error = f"{name} is {given!r:.60}; expected the numbers {', '.join(expected)}"
                object.__setattr__(self, name, numbers_of(given, len(expected), error))
        if self.bounds_deg is not None:
            check_bounds(self.bounds_deg)
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
            if not (abs(heading) <= 360.0 and 0.0 < slack <= 180.0):
                raise InputError(
                    f"heading is {heading:g} within {slack:g} degrees; expected a slack above 0, "
                    "at most 180, and a heading from -360 to 360"
                )
        if self.elevation_m is not None:
            low, high = self.elevation_m
            if not (np.isfinite(self.elevation_m).all() and low < high):
                raise InputError(
                    f"elevations are {low:g} to {high:g} m; expected two that increase"
                )
        if self.eye_height_m is not None:
            error = f"the eye is {self.eye_height_m!s:.40} m above the ground; expected 0 to 100000"
            (height_m,) = numbers_of([self.eye_height_m], 1, error)
            if not 0.0 <= height_m <= 1e5:
                raise InputError(error)
            object.__setattr__(self, "eye_height_m", height_m)


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior knowledge of one photo's pose, in the metres of a frame."""

    narrowing: Narrowing = Narrowing()
    frame: Frame | None = None
    """None only for a prior without a narrowing."""
    circles_m: tuple[tuple[float, float, float], ...] = ()
    """Circles around the narrowing's place and of the surroundings: easting, northing, radius."""
    rectangle_m: Rectangle | None = None
    """Rectangle that contains the narrowing's bounds."""
    noted: PlacePrior | None = None
    """Prior from the photo's EXIF."""
    exif: NotedPlace | None = None
    """The EXIF that ``noted`` is from."""
    surroundings: Circle | None = None
    """Where a part of the search looks."""

    @classmethod
    def of(
        cls,
        narrowing: Narrowing,
        frame: Frame,
        exif: NotedPlace | None = None,
        surroundings: Circle | None = None,
    ) -> "Prior":
        """Return a narrowing in a frame, with the prior from EXIF.

        Raises as `Frame.rectangle_m`.
        """
        noted = None if exif is None else PlacePrior.of_noted(exif, frame)
        rectangle = None
        circles = (frame.circle_m(one) for one in (narrowing.near, surroundings) if one)
        if narrowing.bounds_deg is not None:
            rectangle = frame.rectangle_m(narrowing.bounds_deg)
        return cls(narrowing, frame, tuple(circles), rectangle, noted, exif, surroundings)

    def in_frames(self, frames: Sequence[Frame]) -> "list[Prior]":
        """Return this prior in each of several frames, its own first.

        With one frame, or none, the prior is returned unchanged.
        """
        if len(frames) < 2:
            return [self]
        others = (
            Prior.of(self.narrowing, frame, self.exif, self.surroundings) for frame in frames[1:]
        )
        priors = [self, *others]
        noted = next((prior.noted for prior in priors if prior.noted is not None), None)
        if noted is None:
            return priors
        # A frame that does not reach the noted place is far from it, and so costs as much.
        far = replace(noted, easting_m=_FAR_M, northing_m=_FAR_M, grid_heading_deg=None)
        return [replace(prior, noted=prior.noted or far) for prior in priors]

    @property
    def open_turns(self) -> BoolArray | None:
        """The turns (180,) that screening compares; see `turns_within`. None for all."""
        if self.narrowing.heading_deg is None:
            return None
        heading, slack = self.narrowing.heading_deg
        return turns_within(heading, slack + _CONVERGENCE_DEG)

    def contains(self, positions: Places | Poses) -> BoolArray:
        """Return which positions (N,) lie within the circles, bounds and elevations."""
        inside = np.ones(len(positions), dtype=bool)
        easting_m, northing_m = positions.easting_m, positions.northing_m
        if self.narrowing.elevation_m is not None:
            low, high = self.narrowing.elevation_m
            inside &= (positions.eye_elevation_m >= low) & (positions.eye_elevation_m <= high)
        for east, north, radius_m in self.circles_m:
            inside &= (easting_m - east) ** 2 + (northing_m - north) ** 2 <= radius_m**2
        if self.rectangle_m is not None:
            inside &= in_rectangle(self.rectangle_m, easting_m, northing_m)
        return inside

    def allows(self, poses: Poses) -> BoolArray:
        """Return which poses (M,) the narrowing allows, their headings included."""
        allowed = self.contains(poses)
        if self.narrowing.heading_deg is not None and self.frame is not None:
            heading, slack = self.narrowing.heading_deg
            turn = self.frame.convergence_deg(
                easting_m=poses.easting_m, northing_m=poses.northing_m
            )
            off = in_turn(poses.grid_heading_deg + turn - heading)
            allowed &= np.abs(off) <= slack
        return allowed

    def around(self, frame: Frame, *, lon: float, lat: float, radius_km: float) -> "Prior":
        """Return this prior, narrowed to the surroundings of a place as well.

        ``frame`` is the prior's own, which a prior without a narrowing may lack.
        """
        circle = lon, lat, radius_km
        return replace(
            self, circles_m=(*self.circles_m, frame.circle_m(circle)), surroundings=circle
        )

    def near_noted(self) -> "Prior | None":
        """Return this prior narrowed to the noted place's surroundings, or None."""
        if self.noted is None or self.frame is None:
            return None
        lon, lat = self.frame.to_lonlat(self.noted.easting_m, self.noted.northing_m)
        reach_m = _EXIF.reach_m + _EXIF.reach_sds * self.noted.sd_m
        return self.around(self.frame, lon=float(lon), lat=float(lat), radius_km=1e-3 * reach_m)

    def swap_hint(self, places: Places) -> str:
        """Return a hint that longitudes and latitudes are swapped, or "".

        The hint is given if the swapped narrowing would meet the rectangle around the places.
        """
        near = self.narrowing.near
        bounds = self.narrowing.bounds_deg
        for given in (near and near[:2], bounds):
            if given is None or self.frame is None:
                continue
            lat, lon = np.reshape(given, (-1, 2)).T
            east_m, north_m = self.frame.from_lonlat(lon, lat)
            pairs = (east_m, places.easting_m), (north_m, places.northing_m)
            if all(a.min() <= b.max() and b.min() <= a.max() for a, b in pairs):
                return f"; {swapped_in_words(*given)}"
        return ""


NOTHING_KNOWN = Prior()
