"""The prior of places that people photograph from: summits, viewpoints and trails.

A photo was taken about one of these *spots*, or anywhere. All spots are equally likely, so each
stands for its share of their area, and the true place has a `PlaceDensity` about the nearest one.
The others add little, since spots next to each other count as one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skyline.arrays import BoolArray, Complex128Array, Float64Array
from skyline.errors import InputError, check_suffix
from skyline.files.geojson import GEOJSON
from skyline.files.shapes import LINE, POLYGON
from skyline.files.tables import read_table
from skyline.files.vectors import read_vectors
from skyline.geodesy.earth import EARTH_RADIUS_M
from skyline.geodesy.map_frame import Frame
from skyline.match.place_density import ANYWHERE_KM2, OFF_MAP_M, PlaceDensity, PlacePrior

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

SPOT_FILES = (".csv", *GEOJSON, ".gpx", ".gpkg")
"""Suffixes of files of spots."""
_SCALE_M = 50.0
"""Scale of the distance from a spot: a summit is a plateau, a viewpoint has a car park."""
_ELSEWHERE_SHARE = 0.5
"""Share of photos that are taken anywhere: an assumption."""
NEAR_SPOT_M = 500.0
"""A search looks at all places within this distance of a spot."""
_EXPECTED = (
    "expected points, or lines such as trails, in degrees: a table with columns lon,lat, GeoJSON, "
    "GPX or a GeoPackage"
)


@dataclass(frozen=True, slots=True, eq=False)
class PhotoSpots(PlacePrior):
    """Prior density of a camera's place, in the metres of a frame."""

    spot_m: Complex128Array
    """Easting, and northing as the imaginary part, of each spot (K,)."""
    tree: cKDTree
    """Finds the nearest spot."""
    density: PlaceDensity

    @classmethod
    def of(cls, lonlat_deg: tuple[tuple[float, float], ...], frame: Frame) -> PhotoSpots:
        """Return the prior of spots in a frame."""
        from scipy.spatial import cKDTree  # noqa: PLC0415  (slow to load)

        east_m, north_m = frame.from_lonlat(*np.transpose(lonlat_deg))
        position_m = np.stack([east_m, north_m], axis=1)
        position_m = position_m[np.isfinite(position_m).all(axis=1)]
        # Spots in one cell count as one, or a trail's would count more, the more often it bends.
        _, first = np.unique(np.round(position_m / _SCALE_M), axis=0, return_index=True)
        spot_m = position_m[first] if len(first) else np.full((1, 2), OFF_MAP_M)
        anywhere_m2 = 1e6 * ANYWHERE_KM2
        area_m2 = max(anywhere_m2, float(np.prod(np.ptp(spot_m, axis=0))))
        of_each_m2 = min(anywhere_m2, area_m2 / len(spot_m))
        density = PlaceDensity(_SCALE_M, _ELSEWHERE_SHARE, of_each_m2)
        return cls(np.asarray(spot_m @ (1.0, 1j)), cKDTree(spot_m), density)

    def are_near(self, position_m: Complex128Array) -> BoolArray:
        """Return which positions (M,) lie near a spot."""
        at = np.column_stack([position_m.real, position_m.imag])
        return np.isfinite(self.tree.query(at, distance_upper_bound=NEAR_SPOT_M)[0])

    def cost(
        self, position_m: Complex128Array, eye_m: Float64Array, heading_rad: Float64Array
    ) -> Float64Array:
        """Return the cost (M,) of poses, from their places alone; see `PlacePrior`."""
        return self.density.cost(self._off_m(position_m))

    def pull(
        self, position_m: Complex128Array, eye_m: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return the pull (M, 3) to the nearest spots, and offsets (M, 3); see `PlacePrior`."""
        return self.density.pull(self._off_m(position_m))

    def _off_m(self, position_m: Complex128Array) -> Complex128Array:
        """Return the offsets (M,) of positions from their nearest spots."""
        _, nearest = self.tree.query(np.column_stack([position_m.real, position_m.imag]))
        return position_m - self.spot_m[nearest]


def read_spots(path: Path) -> tuple[tuple[float, float], ...]:
    """Return the longitudes and latitudes of spots in a file.

    A line, such as a trail, is a row of spots.

    Parameters
    ----------
    path : Path
        A table with the columns ``lon`` and ``lat``, or points and lines on a map: see
        `skyline.files.vectors.read_vectors`.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The file is of another kind, holds no spots, or holds other shapes.
    """
    check_suffix(path, SPOT_FILES)
    if path.suffix.lower() == ".csv":
        table = read_table(path, _EXPECTED)
        table.first_in(("lon", "lat"), expected=_EXPECTED)
        spots = [(row.number("lon"), row.number("lat")) for row in table.rows]
        if not spots:
            raise InputError(f"{path} holds no spots; {_EXPECTED}")
        return tuple(spots)
    rows = []
    for shape in read_vectors(path).shapes:
        if shape.kind == POLYGON:
            raise InputError(f"{path}, {shape.where} is a polygon; {_EXPECTED}")
        rows.append(_along(shape.vertices) if shape.kind == LINE else shape.vertices)
    return tuple((float(lon), float(lat)) for lon, lat in np.concatenate(rows))


def _along(line: Float64Array) -> Float64Array:
    """Return longitudes and latitudes (N, 2) along a line, one scale apart at most."""
    lon, lat = np.radians(line).T
    lengths_m = EARTH_RADIUS_M * np.hypot(
        np.diff(lon) * np.cos(0.5 * (lat[1:] + lat[:-1])), np.diff(lat)
    )
    steps = np.maximum(1, np.ceil(lengths_m / _SCALE_M)).astype(int)
    parts = [
        np.linspace(start, end, count, endpoint=False)
        for start, end, count in zip(line[:-1], line[1:], steps, strict=True)
    ]
    return np.concatenate([*parts, line[-1:]])
