"""A camera in any attitude, and the skyline on its image.

The camera is a pin-hole camera, unless it maps directions to its image as a fisheye or a panorama
does.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.angles import wrapped_deg
from skyline.arrays import Float64Array, IntArray

PIN_HOLE = "pin-hole"
"""The mapping of a photo without distortion."""
CYLINDER = "cylinder"
"""The mapping of a panorama."""
FISHEYES = ("equidistant", "equisolid", "stereographic")
"""Mappings of fisheyes."""
_MIN_FORWARD = 0.05
"""Rays that point further aside of the optical axis are not drawn."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera with square pixels; angles as in `skyline.camera.levelling`."""

    grid_heading_deg: float  # Azimuth of the optical axis from grid north
    pitch_deg: float = 0.0  # Optical axis above the horizon; how far a cylinder's rows are raised
    roll_deg: float = 0.0  # Camera turned clockwise as seen from behind it
    fov_deg: float = 60.0  # Horizontal field of view
    width_px: int = 960
    height_px: int = 640
    mapping: str = PIN_HOLE  # Or `CYLINDER`, or one of `FISHEYES`

    @property
    def focal_px(self) -> float:
        """Focal length in pixels.

        It is the radius in the image of a small angle off the axis, over that angle.
        """
        half_rad = np.radians(self.fov_deg) / 2.0
        return self.width_px / 2.0 / float(self._radius(half_rad))

    @property
    def pin_hole_fov_deg(self) -> float:
        """Field of view of the pin-hole camera of the same focal length."""
        if self.mapping == PIN_HOLE:
            return self.fov_deg
        return float(np.degrees(2.0 * np.arctan(self.width_px / 2.0 / self.focal_px)))

    def _radius(self, off_axis_rad: Float64Array | float) -> Float64Array:
        """Return the radius at an angle off the axis.

        The image has unit focal length.
        """
        off_axis: Float64Array = np.asarray(off_axis_rad)
        if self.mapping == PIN_HOLE:
            return np.asarray(np.tan(off_axis))
        if self.mapping == "equisolid":
            return np.asarray(2.0 * np.sin(off_axis / 2.0))
        if self.mapping == "stereographic":
            return np.asarray(2.0 * np.tan(off_axis / 2.0))
        return off_axis

    def rays(self) -> Float64Array:
        """Return the directions (H, W, 3) of a pin-hole's pixels.

        They point east, up and north, with a length of 1 along the optical axis.
        """
        columns = np.arange(self.width_px)
        rows = np.arange(self.height_px)
        u = ((columns - (self.width_px - 1) / 2.0) / self.focal_px)[np.newaxis, :]
        v = (((self.height_px - 1) / 2.0 - rows) / self.focal_px)[:, np.newaxis]
        roll, pitch, heading = np.radians([self.roll_deg, self.pitch_deg, self.grid_heading_deg])
        right = u * np.cos(roll) + v * np.sin(roll)
        above = v * np.cos(roll) - u * np.sin(roll)
        forward = np.cos(pitch) - above * np.sin(pitch)
        up = np.sin(pitch) + above * np.cos(pitch)
        east = right * np.cos(heading) + forward * np.sin(heading)
        north = forward * np.cos(heading) - right * np.sin(heading)
        return np.stack([east, up, north], axis=-1)

    def skyline(
        self, azimuth_deg: Float64Array, elevation_tan: Float64Array
    ) -> tuple[Float64Array, IntArray]:
        """Project a skyline all the way round into the image.

        Grid azimuths (N,) ascend over one turn. Tangents (N,) of the elevation angle are up over
        *horizontal* distance; NaN where unknown.

        Return the topmost row (W,) of the curve at each column's centre, straight between the
        curve's samples: it may lie outside the image, and is NaN where nothing is known. And the
        curve's sample (W,) just left of that point, -1 where the row is NaN.
        """
        turned = wrapped_deg(azimuth_deg - self.grid_heading_deg)
        first = int(np.argmin(turned))
        rolled = np.radians(np.roll(turned, -first)), np.roll(elevation_tan, -first)
        row_px, segment = _topmost(*self.project(*rolled), self.width_px)
        sample = np.where(segment >= 0, (segment + first) % len(azimuth_deg), -1)
        return row_px, sample

    def project(
        self, azimuth_rad: Float64Array, elevation_tan: Float64Array
    ) -> tuple[Float64Array, Float64Array, NDArray[np.bool_]]:
        """Return column, row and visibility of directions.

        Directions are relative to the heading.
        """
        if self.mapping == CYLINDER:
            return self._on_cylinder(azimuth_rad, elevation_tan)
        roll, pitch = np.radians([self.roll_deg, self.pitch_deg])
        right = np.sin(azimuth_rad)
        level = np.cos(azimuth_rad)
        forward = level * np.cos(pitch) + elevation_tan * np.sin(pitch)
        above = elevation_tan * np.cos(pitch) - level * np.sin(pitch)
        ahead = forward > _MIN_FORWARD
        scale = self.focal_px / np.where(ahead, forward, 1.0)
        if self.mapping != PIN_HOLE:
            aside = np.hypot(right, above)
            scale = self.focal_px * self._radius(np.arctan2(aside, forward)) / np.fmax(aside, 1e-9)
        column = (right * np.cos(roll) - above * np.sin(roll)) * scale + (self.width_px - 1) / 2.0
        row = (self.height_px - 1) / 2.0 - (right * np.sin(roll) + above * np.cos(roll)) * scale
        return column, row, ahead

    def _on_cylinder(
        self, azimuth_rad: Float64Array, elevation_tan: Float64Array
    ) -> tuple[Float64Array, Float64Array, NDArray[np.bool_]]:
        roll, pitch = np.radians([self.roll_deg, self.pitch_deg])
        right = np.sin(azimuth_rad)
        ahead = np.cos(azimuth_rad)
        across = right * np.cos(roll) - elevation_tan * np.sin(roll)
        up = (right * np.sin(roll) + elevation_tan * np.cos(roll)) / np.hypot(across, ahead)
        column = np.arctan2(across, ahead) * self.focal_px + (self.width_px - 1) / 2.0
        row = (self.height_px - 1) / 2.0 - (up - np.tan(pitch)) * self.focal_px
        return column, row, np.isfinite(row)


def _topmost(
    column: Float64Array, row: Float64Array, drawn: NDArray[np.bool_], width: int
) -> tuple[Float64Array, IntArray]:
    """Return a polyline's topmost row (W,) at each whole column.

    The second array (W,) is the segment with that row. A rolled camera sees cliffs lean over, so
    several segments may cross one column.
    """
    usable = drawn[:-1] & drawn[1:]
    left = np.where(usable, np.minimum(column[:-1], column[1:]), 0.0)
    right = np.where(usable, np.maximum(column[:-1], column[1:]), -1.0)
    first = np.clip(np.ceil(left), 0, width).astype(np.intp)
    crossed = np.clip(np.floor(right), -1, width - 1).astype(np.intp) - first + 1
    segment = np.repeat(np.arange(len(first)), np.maximum(crossed, 0))
    start = np.searchsorted(segment, segment)
    at = first[segment] + np.arange(len(segment)) - start
    run = column[segment + 1] - column[segment]
    share = np.where(run == 0.0, 0.0, (at - column[segment]) / np.where(run == 0.0, 1.0, run))
    crossing = row[segment] + share * (row[segment + 1] - row[segment])
    known = np.flatnonzero(np.isfinite(crossing))
    # Lowest rows first, so that the last one written to a column is the topmost.
    known = known[np.argsort(-crossing[known], kind="stable")]
    row_px = np.full(width, np.nan)
    which = np.full(width, -1, dtype=np.intp)
    row_px[at[known]] = crossing[known]
    which[at[known]] = segment[known]
    return row_px, which
