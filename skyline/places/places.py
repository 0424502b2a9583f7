"""Places in memory, or mapped from a store: the same arrays either way."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array, IntArray
from skyline.horizons import Horizons
from skyline.places.coding import decode_distance, decode_rises, encode_distance, encode_rises
from skyline.places.phases import encode_phases
from skyline.rows import Rows


@dataclass(frozen=True, slots=True, eq=False)
class Places(Rows):
    """N places; 692 bytes each.

    Attributes
    ----------
    easting_m, northing_m : (N,) float64
        Of the eye, in the DEM's frame.
    eye_elevation_m : (N,) float32
        Above the DEM's datum.
    tolerance_m : (N,) float32
        How far from the eye, east and north, the place stands for: half the spacing of a grid.
    first_tan : (N,) float32
        Tangent of the skyline's elevation angle in the first bin.
    rise : (N, 360) int8
        Rises from bin to bin; see `skyline.places.coding`.
    distance : (N, 120) uint8
        Codes of the skyline's horizontal distance.
    phase : (N, 180) uint8
        Codes that a search compares first; see `skyline.places.phases`.
    """

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float32Array
    tolerance_m: Float32Array
    first_tan: Float32Array
    rise: NDArray[np.int8]
    distance: NDArray[np.uint8]
    phase: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.easting_m)

    @classmethod
    def of(cls, horizons: Horizons, tolerance_m: float | Float32Array) -> "Places":
        """Return the places of rendered skylines in 360 bins, each with its tolerance."""
        first, rise = encode_rises(horizons.elevation_tan)
        return cls(
            horizons.easting_m,
            horizons.northing_m,
            horizons.eye_elevation_m.astype(np.float32),
            np.broadcast_to(np.float32(tolerance_m), first.shape).copy(),
            first,
            rise,
            encode_distance(horizons.distance_m),
            # Of what the bytes say, so that phases can be made again from a store.
            encode_phases(decode_rises(first, rise)),
        )

    def elevation_tan(self) -> Float32Array:
        """Return the tangents of the skylines' elevation angles (N, 360); NaN where unknown."""
        return decode_rises(self.first_tan, self.rise)

    def distance_m(self) -> Float32Array:
        """Return the skylines' horizontal distances (N, 120); NaN where unknown."""
        return decode_distance(self.distance)

    def blocks(self) -> Iterator["Places"]:
        """Yield these places; see `PlaceSource`."""
        yield self

    def take(self, rows: IntArray) -> "Places":
        """Return some places, in order; see `PlaceSource`."""
        return self[rows]


class PlaceSource(Protocol):
    """Places that need not be in memory: those of a store, or `Places`."""

    def __len__(self) -> int:
        """Return the number of places."""
        ...

    def blocks(self) -> Iterator[Places]:
        """Yield all places in order, in blocks whose arrays may be mapped from a file."""
        ...

    def take(self, rows: IntArray) -> Places:
        """Return copies of the places ``rows``, in order."""
        ...
