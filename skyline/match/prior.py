"""Prior knowledge of a photo's pose, from the user and from EXIF."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skyline.angles import angle_between_deg
from skyline.arrays import BoolArray, Float64Array
from skyline.errors import swapped_in_words
from skyline.geodesy.bounds import Circle
from skyline.geodesy.map_frame import Frame, Rectangle, in_rectangle
from skyline.match.narrowing import Narrowing
from skyline.match.photo_spots import NEAR_SPOT_M, PhotoSpots
from skyline.match.place_density import OFF_MAP_M, PlacePrior
from skyline.match.position_prior import PositionPrior
from skyline.match.screen import AlikePlaces
from skyline.photo.noted_place import NotedPlace
from skyline.pose.poses import Poses
from skyline.store.places import Places

_REACH_M = 1000.0
"""A search looks within this distance of the noted place, plus `_REACH_SCALES` of its scales."""
_REACH_SCALES = 3.0


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior knowledge of one photo's pose, in the metres of a frame."""

    narrowing: Narrowing = field(default_factory=Narrowing)
    frame: Frame | None = None
    """None only for a prior without a narrowing."""
    circles_m: tuple[tuple[float, float, float], ...] = ()
    """Circles around the narrowing's place and of the surroundings: easting, northing, radius."""
    rectangle_m: Rectangle | None = None
    """Rectangle that contains the narrowing's bounds."""
    position: PositionPrior | None = None
    """Prior of the position, from the photo's EXIF."""
    noted: NotedPlace | None = None
    """The position and heading that the photo's EXIF notes."""
    spots: PhotoSpots | None = None
    """Prior of the position, from the narrowing's photo spots."""
    surroundings: Circle | None = None
    """The circle of the surroundings in degrees, if only these are searched."""
    only_near_spots: bool = False
    """Whether only places near the photo spots are searched."""

    @classmethod
    def of(
        cls,
        narrowing: Narrowing,
        frame: Frame,
        noted: NotedPlace | None = None,
        surroundings: Circle | None = None,
        only_near_spots: bool = False,
    ) -> "Prior":
        """Return a narrowing in a frame, with the prior from EXIF.

        Raises as `Frame.rectangle_m`.
        """
        position = None if noted is None else PositionPrior.of_noted(noted, frame)
        rectangle = None
        circles = (frame.circle_m(one) for one in (narrowing.near, surroundings) if one)
        if narrowing.bounds_deg is not None:
            rectangle = frame.rectangle_m(narrowing.bounds_deg)
        spots = PhotoSpots.of(narrowing.photo_spots, frame) if narrowing.photo_spots else None
        return cls(
            narrowing,
            frame,
            circles_m=tuple(circles),
            rectangle_m=rectangle,
            position=position,
            noted=noted,
            spots=spots,
            surroundings=surroundings,
            only_near_spots=only_near_spots,
        )

    def in_frames(self, frames: Sequence[Frame]) -> "list[Prior]":
        """Return this prior in each of several frames, its own first.

        With one frame, or none, the prior is returned unchanged.
        """
        if len(frames) < 2:
            return [self]
        others = (
            Prior.of(self.narrowing, frame, self.noted, self.surroundings, self.only_near_spots)
            for frame in frames[1:]
        )
        priors = [self, *others]
        position = next((prior.position for prior in priors if prior.position is not None), None)
        if position is None:
            return priors
        # In a frame that does not reach the noted place, all places are far from it.
        far = replace(position, easting_m=OFF_MAP_M, northing_m=OFF_MAP_M, grid_heading_deg=None)
        return [replace(prior, position=prior.position or far) for prior in priors]

    @property
    def place_priors(self) -> tuple[PlacePrior, ...]:
        """The prior of the noted place, and the one of the photo spots, where there are any."""
        return tuple(one for one in (self.position, self.spots) if one is not None)

    def log_density(self, positions: Places | Poses | AlikePlaces) -> Float64Array:
        """Return the log density (N,) of positions, unnormalized."""
        position_m = positions.easting_m + 1j * positions.northing_m
        none = np.zeros(len(positions))
        position = self.position and replace(self.position, grid_heading_deg=None, elevation_m=None)
        place_only = replace(self, position=position)
        return -sum((one.cost(position_m, none, none) for one in place_only.place_priors), none)

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
        if self.only_near_spots and self.spots is not None:
            inside &= self.spots.are_near(easting_m + 1j * northing_m)
        return inside

    def allows(self, poses: Poses, frames: Sequence[Frame] = ()) -> BoolArray:
        """Return which poses (M,) the narrowing allows, their headings included.

        Poses with `Poses.in_areas` need the ``frames`` of the areas.
        """
        if poses.in_areas is None:
            return self._allows_in_frame(poses)
        allowed = np.zeros(len(poses), dtype=bool)
        for area, its_prior in enumerate(self.in_frames(frames)):
            mine = np.flatnonzero(poses.in_areas.area == area)
            allowed[mine] = its_prior._allows_in_frame(poses[mine])
        return allowed

    def _allows_in_frame(self, poses: Poses) -> BoolArray:
        """Return which poses (M,), in the prior's own frame, are allowed."""
        allowed = self.contains(poses)
        if self.narrowing.heading_deg is not None and self.frame is not None:
            heading, slack = self.narrowing.heading_deg
            turn = self.frame.convergence_deg(
                easting_m=poses.easting_m, northing_m=poses.northing_m
            )
            allowed &= angle_between_deg(poses.grid_heading_deg + turn, heading) <= slack
        return allowed

    def around(self, frame: Frame, *, lon: float, lat: float, radius_km: float) -> "Prior":
        """Return this prior, narrowed to the surroundings of a place as well.

        ``frame`` is the prior's own, which a prior without a narrowing may lack.
        """
        circle = lon, lat, radius_km
        return replace(
            self, circles_m=(*self.circles_m, frame.circle_m(circle)), surroundings=circle
        )

    def near_spots(self) -> "Prior | None":
        """Return this prior narrowed to places near the photo spots, or None."""
        return None if self.spots is None else replace(self, only_near_spots=True)

    def near_noted(self) -> "Prior | None":
        """Return this prior narrowed to the noted place's surroundings, or None."""
        if self.position is None or self.frame is None:
            return None
        lon, lat = self.frame.to_lonlat(self.position.easting_m, self.position.northing_m)
        reach_m = _REACH_M + _REACH_SCALES * self.position.scale_m
        return self.around(self.frame, lon=float(lon), lat=float(lat), radius_km=1e-3 * reach_m)

    def swap_hint(self, places: Places) -> str:
        """Return a hint that longitudes and latitudes are swapped, or "".

        The hint is given if the swapped narrowing would meet the rectangle around the places.
        """
        given: list[tuple[Sequence[float], float]] = []
        if self.narrowing.near is not None:
            *place, radius_km = self.narrowing.near
            given.append((place, 1000.0 * radius_km))
        if self.narrowing.bounds_deg is not None:
            given.append((self.narrowing.bounds_deg, 0.0))
        if self.only_near_spots:
            given.append((self.narrowing.photo_spots[0], NEAR_SPOT_M))
        for degrees, reach_m in given:
            if self.frame is None:
                continue
            lat, lon = np.reshape(degrees, (-1, 2)).T
            east_m, north_m = self.frame.from_lonlat(lon, lat)
            pairs = (east_m, places.easting_m), (north_m, places.northing_m)
            if all(a.min() - reach_m <= b.max() and b.min() <= a.max() + reach_m for a, b in pairs):
                return f"; {swapped_in_words(*degrees)}"
        return ""


NOTHING_KNOWN = Prior()
