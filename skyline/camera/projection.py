"""Projections of photos, and which fields of view they have."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError

MIN_FOV_DEG = 1.0
MAX_FOV_DEG = 179.0
MAX_FISHEYE_DEG = 180.0
"""Greatest angle across a fisheye's picture; its corners look farther aside, and behind the
camera."""
MAX_PANORAMA_DEG = 360.0


class Projection(StrEnum):
    """Projections of a photo.

    Each is described by the quantities that grow evenly across and up the photo, or outwards.

    Attributes
    ----------
    PERSPECTIVE
        Tangents of the angle, across and upwards: a photo through a lens.
    CYLINDRICAL
        Azimuth across, tangent of elevation upwards: swept and most stitched panoramas.
    EQUIRECTANGULAR
        Azimuth across, elevation upwards: photo spheres.
    FISHEYE
        Angle off the optical axis, outwards from the middle: an equidistant fisheye.
    """

    PERSPECTIVE = "perspective"
    CYLINDRICAL = "cylindrical"
    EQUIRECTANGULAR = "equirectangular"
    FISHEYE = "fisheye"

    @classmethod
    def _missing_(cls, value: object) -> Projection:
        raise InputError(f"projection is {value!r}; expected {', '.join(cls)}")

    @property
    def is_panorama(self) -> bool:
        """True if the photo was swept or stitched from several exposures."""
        return self in (Projection.CYLINDRICAL, Projection.EQUIRECTANGULAR)

    @property
    def spreads_angles(self) -> bool:
        """True if angles, rather than their tangents, grow evenly across the photo."""
        return self is not Projection.PERSPECTIVE

    @property
    def most_fov_deg(self) -> float:
        """The largest horizontal field of view."""
        if self.is_panorama:
            return MAX_PANORAMA_DEG
        return MAX_FISHEYE_DEG if self is Projection.FISHEYE else MAX_FOV_DEG

    def check_fov_deg(self, fov_deg: float) -> float:
        """Return a field of view, or raise `InputError` if impossible."""
        if not MIN_FOV_DEG <= fov_deg <= self.most_fov_deg:
            raise InputError(
                f"horizontal field of view is {fov_deg:g} degrees; expected {MIN_FOV_DEG:g} to "
                f"{self.most_fov_deg:g}: {self._fov_hint}"
            )
        return float(fov_deg)

    @property
    def _fov_hint(self) -> str:
        """A hint for errors: which fields of view this projection has."""
        if self.is_panorama:
            return "a full turn is the most"
        if self is Projection.FISHEYE:
            return "it is the angle across the picture's width; crop a wider fisheye to half a turn"
        return (
            "a phone's main camera has about 65; a panorama needs its projection, too, usually "
            "cylindrical, and so does a fisheye"
        )

    def rays(
        self, across: Float64Array, above: Float64Array, fov_deg: float
    ) -> tuple[Float64Array, Float64Array]:
        """Return u and v of points of a photo.

        They are positions on an image of unit focal length. Through a lens, u and v are right and
        up divided by forward: the ray is (u, v, 1). A panorama's image is a cylinder: u is the
        azimuth from its middle in radians, v the tangent of the elevation, and the ray is
        (sin u, v, cos u). A fisheye's u and v lie at the distance a from the middle, where a is the
        angle off the axis in radians: the ray is (u sin a / a, v sin a / a, cos a).

        Parameters
        ----------
        across, above : (N,) float64
            From the photo's middle to the right and upwards, in halves of its width.
        fov_deg : float
            Horizontal field of view.
        """
        half_width = self.half_width(fov_deg)
        v = above * half_width
        return across * half_width, np.tan(v) if self is Projection.EQUIRECTANGULAR else v

    def places(
        self, u: Float64Array, v: Float64Array, fov_deg: float
    ) -> tuple[Float64Array, Float64Array]:
        """Return across and above of an image's points; the inverse of `rays`."""
        half_width = self.half_width(fov_deg)
        even = np.arctan(v) if self is Projection.EQUIRECTANGULAR else v
        return u / half_width, even / half_width

    def half_width(self, fov_deg: Any) -> Any:
        """Return half the width of an image of unit focal length."""
        half_rad = np.radians(fov_deg) / 2.0
        return half_rad if self.spreads_angles else np.tan(half_rad)

    def fov_deg(self, half_width: Any) -> Any:
        """Return a half width's field of view; the inverse of `half_width`."""
        half_rad = half_width if self.spreads_angles else np.arctan(half_width)
        return np.degrees(2.0 * half_rad)

    def column_deg(self, width: int, fov_deg: float) -> Float64Array:
        """Return the degrees of azimuth (width,) that each of ``width`` columns spans."""
        edges = np.linspace(-1.0, 1.0, width + 1)
        azimuth_rad = self.azimuth_rad(edges * self.half_width(fov_deg))
        return np.asarray(np.degrees(np.diff(azimuth_rad)), dtype=np.float64)

    def azimuth_rad(self, u: Float64Array) -> Float64Array:
        """Return the azimuths at which a level camera sees points of its horizon."""
        return u if self.spreads_angles else np.arctan(u)
