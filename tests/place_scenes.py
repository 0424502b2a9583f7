"""Places with made skylines, and photos of them."""

from collections.abc import Iterator

import numpy as np
from ray_scenes import equally_trusted, seen

from skyline.skylines import Horizons, bin_azimuths_rad
from skyline.store.places import BINS, Places

AZIMUTH_DEG = np.degrees(bin_azimuths_rad(BINS))
FAR_M = 20_000.0


def curve(seed, azimuth_deg):
    """Return a rugged skyline at azimuths."""
    generator = np.random.default_rng(seed)
    order = np.arange(2, 40)
    amplitude = generator.normal(size=(2, len(order))) * 0.06 / order
    angle = np.multiply.outer(np.radians(azimuth_deg), order)
    return 0.2 + np.cos(angle) @ amplitude[0] + np.sin(angle) @ amplitude[1]


def places_of(y, distance_m=FAR_M, spacing_m=100.0, tolerance_m=20.0):
    """Make places of skylines (N, B) in a row from west to east."""
    distance = np.where(np.isfinite(y), np.broadcast_to(distance_m, y.shape), np.nan)
    place = np.arange(len(y)) * spacing_m, np.zeros(len(y)), np.full(len(y), 1000.0)
    flags = np.zeros(y.shape, dtype=np.uint8)
    return Places.of(Horizons(*place, np.float32(y), np.float32(distance), flags), tolerance_m)


def photo(skyline, heading_deg, fov_deg=60.0, **pose):
    """Return rays (u, v) of a camera that sees the skyline tangent(azimuth_deg)."""
    u, v = seen(lambda azimuth: skyline(np.degrees(azimuth)), heading_deg, fov_deg=fov_deg, **pose)
    columns = np.tan(np.radians(fov_deg / 2.0)) * ((2 * np.arange(320) + 1) / 320 - 1)
    return columns, np.interp(columns, u, v)


def rays(seed, heading_deg, fov_deg=60.0, **pose):
    u, v = photo(lambda azimuth: curve(seed, azimuth), heading_deg, fov_deg, **pose)
    return equally_trusted(u, v, fov_deg)


class Blocks:
    """Places in blocks of a size, as a store has them."""

    def __init__(self, places: Places, size: int) -> None:
        self._places, self._size = places, size

    def __len__(self) -> int:
        return len(self._places)

    def blocks(self) -> Iterator[Places]:
        for start in range(0, len(self._places), self._size):
            yield self._places[start : start + self._size]

    def phases(self, rows):
        return self._places.phase[rows]

    def take(self, rows):
        return self._places[rows]
