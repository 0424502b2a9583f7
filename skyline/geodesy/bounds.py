"""Boxes and circles in degrees, and distances in words.

People read degrees of WGS 84 and azimuths from true north; the program works in metres of a frame,
with azimuths from grid north.
"""

from skyline.angles import wrapped_deg
from skyline.errors import InputError, numbers_of, swapped_in_words

Bounds = tuple[float, float, float, float]
"""West, south, east, north in degrees; west above east means a box across the antimeridian."""
Circle = tuple[float, float, float]
"""Longitude and latitude in degrees, and a radius in kilometres."""


def check_bounds(bounds_deg: Bounds) -> Bounds:
    """Return bounds as floats; raises `InputError` unless W,S,E,N with S < N."""
    error = f"bounds are {bounds_deg!r}; expected four numbers W,S,E,N in degrees"
    west, south, east, north = bounds_deg = numbers_of(bounds_deg, 4, error)  # type: ignore[assignment]
    if not are_bounds(*bounds_deg):
        is_swapped = are_bounds(south, west, north, east)
        hint = f"; {swapped_in_words(*bounds_deg)}" if is_swapped else ""
        raise InputError(
            f"bounds are {west},{south},{east},{north}; expected W,S,E,N in degrees, longitudes "
            f"from -180 to 180, S < N, and W > E only across the antimeridian{hint}"
        )
    return bounds_deg


def are_bounds(west: float, south: float, east: float, north: float) -> bool:
    """Return whether numbers can be the bounds of a box in degrees.

    A box with W > E crosses the antimeridian. It is at most half a turn wide: in a wider one, W and
    E were swapped.
    """
    return (
        -90.0 <= south < north <= 90.0
        and -180.0 <= west <= 180.0
        and -180.0 <= east <= 180.0
        and 0.0 < width_deg((west, south, east, north)) <= (360.0 if west < east else 180.0)
    )


def are_degrees(lon: float, lat: float) -> bool:
    """Return whether two numbers can be a longitude and a latitude."""
    return -180.0 <= lon <= 360.0 and -90.0 <= lat <= 90.0


def width_deg(bounds_deg: Bounds) -> float:
    """Return a box's width in degrees of longitude, up to 360."""
    west, _, east, _ = bounds_deg
    return east - west if west <= east else east - west + 360.0


def box_around(one: Bounds, other: Bounds) -> Bounds:
    """Return the box around two boxes less than half a turn apart."""

    def start_deg(box: Bounds) -> float:
        return float(wrapped_deg(box[0], one[0]))

    west = min(one, other, key=start_deg)[0]
    east = max(one, other, key=lambda box: start_deg(box) + width_deg(box))[2]
    return west, min(one[1], other[1]), east, max(one[3], other[3])


def contains_box(outer: Bounds, inner: Bounds) -> bool:
    """Return whether a box holds all of another."""
    off_deg = (inner[0] - outer[0]) % 360.0
    return (
        off_deg + width_deg(inner) <= width_deg(outer)
        and outer[1] <= inner[1]
        and inner[3] <= outer[3]
    )


def degrees_in_words(value: float, names: str, decimals: int = 5) -> str:
    """Return a longitude (``names`` EW) or latitude (NS) in words."""
    value = float(wrapped_deg(value))
    return f"{abs(value):.{decimals}f}° {names[0] if value >= 0.0 else names[1]}"


def distance_in_words(distance_m: float) -> str:
    """Return a distance in metres, or in kilometres from 10 km on."""
    if distance_m < 10_000.0:
        return f"{distance_m:.0f} m"
    return f"{distance_m / 1000.0:,.0f} km"
