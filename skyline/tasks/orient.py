"""Orienting photos: finding how cameras were held at known positions."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from skyline.errors import InputError, SkylineError
from skyline.match.photo_lists import Entry
from skyline.orientation.orienter import KnownPosition, known_position, orienters
from skyline.orientation.result import Orientation
from skyline.photo.noted_place import NotedPlace
from skyline.terrain.heightfield import HeightField


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraAt:
    """The known position and heading of cameras."""

    lonlat_deg: tuple[float, float] | None = None
    """By default each photo's own GPS position."""
    elevation_m: float | None = None
    """Elevation of the eye above the DEM's datum; only with a position."""
    position_sd_m: float | None = None
    """Standard deviation of the position; by default 50 m, or `noted_position_scale_m` for a
    photo's own position."""
    heading_deg: tuple[float, float] | None = None
    """Heading from true north, and its greatest error; by default any heading is possible."""

    def __post_init__(self) -> None:
        if self.elevation_m is not None and self.lonlat_deg is None:
            raise InputError(f"--elevation {self.elevation_m:g} needs a position; give --at too")

    def position_of(self, noted: NotedPlace, name: str) -> KnownPosition:
        """Return where a photo was taken that notes a place.

        Raises `InputError` if neither the photo nor the user gives a position.
        """
        return known_position(noted, name, self.lonlat_deg, self.elevation_m, self.position_sd_m)


def orient_photos(
    terrain: HeightField, entries: Iterable[Entry], at: CameraAt
) -> Iterator[Orientation | SkylineError]:
    """Yield how each photo's camera was held, or the photo's error."""
    with orienters(terrain) as orienter_at:
        for entry in entries:
            try:
                skyline = entry.read()
                orienter = orienter_at(at.position_of(skyline.noted, entry.path))
                found: Orientation | SkylineError = orienter.orient(
                    skyline,
                    name=entry.path,
                    heading_deg=entry.narrowing.heading_deg or at.heading_deg,
                )
            except SkylineError as error:
                found = error
            yield found
