"""How a photo's columns and rows become rays: through a lens, or along a stitched panorama."""

import re
from enum import StrEnum

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError

MIN_FOV_DEG = 1.0
MAX_FOV_DEG = 179.0
MAX_PANORAMA_DEG = 160.0
"""Rays are (u, v, 1): none lie 90 degrees from the middle, just short of it they are endless."""

_GPANO = re.compile(r"GPano:(\w+)\s*(?:=\s*[\"']|>)\s*([\w.]+)")


class Projection(StrEnum):
    """What equal steps across a photo are equal steps of.

    Attributes
    ----------
    PERSPECTIVE
        Tangents, both ways: a lens.
    CYLINDRICAL
        Azimuth across, tangent of elevation upwards: swept and most stitched panoramas.
    EQUIRECTANGULAR
        Azimuth across, elevation upwards: photo spheres.
    """

    PERSPECTIVE = "perspective"
    CYLINDRICAL = "cylindrical"
    EQUIRECTANGULAR = "equirectangular"

    def check_fov_deg(self, fov_deg: float) -> float:
        """Return a horizontal field of view that has rays, else raise `InputError`."""
        greatest = MAX_FOV_DEG if self is Projection.PERSPECTIVE else MAX_PANORAMA_DEG
        if not MIN_FOV_DEG <= fov_deg <= greatest:
            hint = (
                "a phone's main camera has about 65, a wide panorama is cylindrical"
                if self is Projection.PERSPECTIVE
                else "cut the panorama to its middle"
            )
            raise InputError(
                f"horizontal field of view is {fov_deg:g} degrees; expected {MIN_FOV_DEG:g} to "
                f"{greatest:g}: {hint}"
            )
        return float(fov_deg)

    def rays(
        self, across: Float64Array, above: Float64Array, fov_deg: float
    ) -> tuple[Float64Array, Float64Array]:
        """Turn places in a photo to rays (u, v, 1).

        Parameters
        ----------
        across, above : (N,) float64
            From the photo's middle to the right and upwards, in halves of its width. A
            panorama's horizon is taken to be its middle row.
        fov_deg : float
            Horizontal field of view.
        """
        half = np.radians(fov_deg) / 2.0
        if self is Projection.PERSPECTIVE:
            return across * np.tan(half), above * np.tan(half)
        azimuth = across * half
        up = above * half if self is Projection.CYLINDRICAL else np.tan(above * half)
        return np.tan(azimuth), up / np.cos(azimuth)

    def places(
        self, u: Float64Array, v: Float64Array, fov_deg: float
    ) -> tuple[Float64Array, Float64Array]:
        """Return where rays (u, v, 1) lie in a photo, across and above: the inverse of `rays`."""
        half = np.radians(fov_deg) / 2.0
        if self is Projection.PERSPECTIVE:
            return u / np.tan(half), v / np.tan(half)
        azimuth = np.arctan(u)
        up = v * np.cos(azimuth)
        above = up if self is Projection.CYLINDRICAL else np.arctan(up)
        return azimuth / half, above / half

    def column_deg(self, width: int, fov_deg: float) -> Float64Array:
        """Return the degrees of azimuth that each of ``width`` columns spans, (width,)."""
        edges = np.linspace(-1.0, 1.0, width + 1)
        tangent, _ = self.rays(edges, np.zeros_like(edges), fov_deg)
        return np.asarray(np.degrees(np.diff(np.arctan(tangent))), dtype=np.float64)


def panorama_of_xmp(xmp: str) -> tuple[Projection, float] | None:
    """Return the projection and the width in degrees, up to 360, that a file's XMP notes.

    From the tags ProjectionType, CroppedAreaImageWidthPixels and FullPanoWidthPixels of the
    namespace http://ns.google.com/photos/1.0/panorama/; None where they are not there.
    """
    tags = dict(_GPANO.findall(xmp))
    try:
        share = float(tags["CroppedAreaImageWidthPixels"]) / float(tags["FullPanoWidthPixels"])
        projection = Projection(tags.get("ProjectionType", Projection.EQUIRECTANGULAR))
    except (KeyError, ValueError, ZeroDivisionError):
        return None
    return (projection, 360.0 * share) if 0.0 < share <= 1.0 else None
