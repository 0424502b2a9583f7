"""From a candidate's pose to pixels of the query's picture and back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import BoolArray, Float64Array
from skyline.match.candidate import Candidate
from skyline.match.query_rays import level, project
from skyline.photo.projection import Projection, distorted
from skyline.photo.query import QuerySkyline
from skyline.report.peaks import Sighting
from skyline.skylines import Views


@dataclass(frozen=True, slots=True)
class PosedPicture:
    """A picture of known size, taken as a candidate says."""

    width_px: int
    height_px: int
    candidate: Candidate
    projection: Projection = Projection.PERSPECTIVE

    def pixels(
        self, azimuth_deg: ArrayLike, elevation_tan: ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Return columns and rows at which directions are seen; NaN where not in front.

        Parameters
        ----------
        azimuth_deg : (...) array_like
            Grid azimuth.
        elevation_tan : (...) array_like
            Tangent of the elevation angle: up over horizontal distance.
        """
        pose = self.candidate
        turn = np.radians(np.asarray(azimuth_deg, dtype=np.float64) - pose.grid_heading_deg)
        y = np.asarray(elevation_tan, dtype=np.float64)
        u, v = project(
            turn, y, pose.pitch_deg, pose.roll_deg, is_panorama=self.projection.is_panorama
        )
        across, above = self.projection.places(u, v, pose.fov_deg)
        across, above = distorted(across, above, pose.distortion)
        half_px = self.width_px / 2.0
        return (
            across * half_px + (self.width_px - 1.0) / 2.0,
            (self.height_px - 1.0) / 2.0 - above * half_px,
        )

    def directions(self, query: QuerySkyline) -> tuple[Float64Array, Float64Array]:
        """Return grid azimuths, degrees, and elevation tangents of the trusted columns."""
        u, v = query.image_plane(self.candidate.fov_deg, self.candidate.distortion)
        turn, y = level(
            u,
            v,
            self.candidate.pitch_deg,
            self.candidate.roll_deg,
            is_panorama=self.projection.is_panorama,
        )
        return (np.degrees(turn) + self.candidate.grid_heading_deg) % 360.0, y

    def gap_deg(self, query: QuerySkyline, panorama: "Panorama") -> Float64Array:
        """Return how far the found skyline is above the rendered one in the trusted columns."""
        azimuth_deg, y = self.directions(query)
        return np.asarray(np.degrees(np.arctan(y) - np.arctan(panorama.at(azimuth_deg))))

    def peaks(self, sightings: Sequence[Sighting]) -> list[tuple[Sighting, float, float]]:
        """Return the peaks that are in the picture, each with its column and row."""
        column, row = self.pixels(
            [sighting.azimuth_deg for sighting in sightings],
            [sighting.elevation_tan for sighting in sightings],
        )
        inside = (column >= 0.0) & (column < self.width_px) & (row >= 0.0) & (row < self.height_px)
        return [
            (sighting, float(column[index]), float(row[index]))
            for index, sighting in enumerate(sightings)
            if inside[index]
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Panorama:
    """One eye's skyline by azimuth."""

    azimuth_deg: Float64Array
    """(C,) float64. Grid azimuths, increasing, in [0, 360)."""
    elevation_tan: Float64Array
    """(C,) float64. Tangent of the elevation angle; NaN where there is no data."""
    is_sure: BoolArray
    """(C,) bool. False where the data's border or a hole may hide what is farther."""

    @classmethod
    def of(cls, views: Views) -> "Panorama":
        """Join the views of one eye."""
        azimuth = views.azimuth_deg().ravel()
        order = np.argsort(azimuth)
        elevation = np.tan(np.radians(views.elevation_deg())).ravel()
        return cls(azimuth[order], elevation[order], (views.flags.ravel() == 0)[order])

    def from_azimuth(self, start_deg: float) -> "Panorama":
        """Return the same, starting at another azimuth, so that a view is one unbroken run."""
        first = int(np.searchsorted(self.azimuth_deg, start_deg % 360.0))
        turned = np.roll(np.arange(len(self.azimuth_deg)), -first)
        return Panorama(self.azimuth_deg[turned], self.elevation_tan[turned], self.is_sure[turned])

    def at(self, azimuth_deg: Float64Array) -> Float64Array:
        """Return elevation tangents at azimuths, interpolated between columns."""
        known = np.isfinite(self.elevation_tan)
        if not known.any():
            return np.full_like(azimuth_deg, np.nan)
        return np.interp(
            azimuth_deg, self.azimuth_deg[known], self.elevation_tan[known], period=360.0
        )


def median_gap_deg(picture: PosedPicture, query: QuerySkyline, panorama: Panorama) -> float:
    """Return the median angle between found and rendered skyline, up or down, degrees."""
    return float(np.median(np.abs(picture.gap_deg(query, panorama))))
