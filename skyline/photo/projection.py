"""Projections of photos: from columns and rows to rays, through a lens or along a panorama."""

from enum import StrEnum

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError

MIN_FOV_DEG = 1.0
MAX_FOV_DEG = 179.0
MAX_PANORAMA_DEG = 360.0
_NEWTON_STEPS = 30
_MET = 1e-9


class Projection(StrEnum):
    """Projections, each with the quantities that grow in equal steps across and up a photo.

    Attributes
    ----------
    PERSPECTIVE
        Tangents of the angle, across and upwards: a photo through a lens.
    CYLINDRICAL
        Azimuth across, tangent of elevation upwards: swept and most stitched panoramas.
    EQUIRECTANGULAR
        Azimuth across, elevation upwards: photo spheres.
    """

    PERSPECTIVE = "perspective"
    CYLINDRICAL = "cylindrical"
    EQUIRECTANGULAR = "equirectangular"

    @property
    def is_panorama(self) -> bool:
        """True if the photo was swept or stitched, rather than taken in one exposure."""
        return self is not Projection.PERSPECTIVE

    def check_fov_deg(self, fov_deg: float) -> float:
        """Return a horizontal field of view, or raise `InputError` if it is impossible."""
        greatest = MAX_PANORAMA_DEG if self.is_panorama else MAX_FOV_DEG
        if not MIN_FOV_DEG <= fov_deg <= greatest:
            hint = (
                "a full turn is the most"
                if self.is_panorama
                else "a phone's main camera has about 65; a panorama needs its projection, too, "
                "usually cylindrical"
            )
            raise InputError(
                f"horizontal field of view is {fov_deg:g} degrees; expected {MIN_FOV_DEG:g} to "
                f"{greatest:g}: {hint}"
            )
        return float(fov_deg)

    def rays(
        self, across: Float64Array, above: Float64Array, fov_deg: float
    ) -> tuple[Float64Array, Float64Array]:
        """Return places u, v on an image of unit focal length for places in a photo.

        Through a lens u and v are right and up over forward: the ray is (u, v, 1). A panorama's
        image is a cylinder: u is the azimuth from its middle, radians, v the tangent of the
        elevation, and the ray is (sin u, v, cos u).

        Parameters
        ----------
        across, above : (N,) float64
            From the photo's middle to the right and upwards, in halves of its width.
        fov_deg : float
            Horizontal field of view.
        """
        half = np.radians(fov_deg) / 2.0
        if self is Projection.PERSPECTIVE:
            return across * np.tan(half), above * np.tan(half)
        up = above * half if self is Projection.CYLINDRICAL else np.tan(above * half)
        return across * half, up

    def places(
        self, u: Float64Array, v: Float64Array, fov_deg: float
    ) -> tuple[Float64Array, Float64Array]:
        """Return the places across and above in a photo of rays u, v: the inverse of `rays`."""
        half = np.radians(fov_deg) / 2.0
        if self is Projection.PERSPECTIVE:
            return u / np.tan(half), v / np.tan(half)
        above = v if self is Projection.CYLINDRICAL else np.arctan(v)
        return u / half, above / half

    def column_deg(self, width: int, fov_deg: float) -> Float64Array:
        """Return the degrees of azimuth that each of ``width`` columns spans, (width,)."""
        edges = np.linspace(-1.0, 1.0, width + 1)
        u, _ = self.rays(edges, np.zeros_like(edges), fov_deg)
        azimuth = u if self.is_panorama else np.arctan(u)
        return np.asarray(np.degrees(np.diff(azimuth)), dtype=np.float64)


def undistorted(
    across: Float64Array, above: Float64Array, distortion: float
) -> tuple[Float64Array, Float64Array]:
    """Return the places at which a lens without distortion would show what this lens shows.

    The distortion k multiplies the distance r from the middle, in halves of the width, by
    1 + k r^2; it is positive for barrel distortion.
    """
    stretch = 1.0 + distortion * (across**2 + above**2)
    return across * stretch, above * stretch


def distorted(
    across: Float64Array, above: Float64Array, distortion: float
) -> tuple[Float64Array, Float64Array]:
    """Return the inverse of `undistorted`; NaN for places that the lens does not show."""
    if distortion == 0.0:
        return across, above
    aim = np.hypot(across, above)
    # Beyond this radius a negative distortion would show things twice.
    farthest = np.inf if distortion > 0.0 else 1.0 / np.sqrt(-3.0 * distortion)
    r = np.minimum(aim, 0.9 * min(farthest, 1.0))
    for _ in range(_NEWTON_STEPS):
        r = r - (r + distortion * r**3 - aim) / (1.0 + 3.0 * distortion * r**2)
        r = np.minimum(r, (1.0 - _MET) * farthest)
    met = np.abs(r + distortion * r**3 - aim) < _MET
    shrink = np.where(met, 1.0 / (1.0 + distortion * r**2), np.nan)
    return across * shrink, above * shrink
