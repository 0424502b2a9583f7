"""How pictures are bent: the distortion of lenses, and the wander of panoramas."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre

from skyline.arrays import Float64Array
from skyline.camera.projection import Projection

MOST_DISTORTION = 0.3
"""Greatest distortion of a lens, see `undistorted`; a lens with more is a fisheye."""
WANDER_DEGREES = range(2, 6)
"""Degrees of the Legendre polynomials that describe how a panorama's rows wander."""
_NEWTON_STEPS = 30
"""Most steps by which `distorted` inverts a distortion. Five are enough, except near the radius at
which a negative distortion folds the image."""
_NEWTON_ERROR = 1e-9
"""Greatest error of such an inverse, in half widths."""


def wander_ways(across: Float64Array) -> Float64Array:
    """Return the ways in which a panorama's rows may wander.

    A panorama is joined from many exposures, and its horizon is seldom straight. Each of the four
    ways (..., 4) is a Legendre polynomial of ``across``, which is -1 and 1 at the sides. The
    degrees 0 and 1 are left out: they shift and turn the whole image.
    """
    return np.asarray(legendre.legvander(across, WANDER_DEGREES[-1])[..., WANDER_DEGREES])


def wandered(across: Float64Array, wander: Sequence[float]) -> Float64Array:
    """Return how far a panorama's rows have wandered up, as tangents.

    ``wander`` has a factor for each of `wander_ways`.
    """
    return np.asarray(legendre.legval(across, (0.0,) * WANDER_DEGREES[0] + tuple(wander)))


def undistorted(
    across: Float64Array,
    above: Float64Array,
    distortion: float,
    projection: Projection = Projection.PERSPECTIVE,
) -> tuple[Float64Array, Float64Array]:
    """Return where a lens without distortion would show the same points.

    The distortion k multiplies the distance r from the middle, in halves of the width, by
    1 + k r^2; it is positive for barrel distortion. A fisheye's distortion is how it differs from
    an equidistant one of the same field of view: it multiplies r by 1 + k (r^2 - 1).
    """
    stretch = 1.0 + distortion * (across**2 + above**2 - fixed_at(projection))
    return across * stretch, above * stretch


def fixed_at(projection: Projection) -> float:
    """Return the squared distance from the middle that no distortion changes.

    It is in halves of the width: a lens's field of view is defined in its middle, a fisheye's at
    its sides.
    """
    return float(projection is Projection.FISHEYE)


def distorted(
    across: Float64Array,
    above: Float64Array,
    distortion: float,
    projection: Projection = Projection.PERSPECTIVE,
) -> tuple[Float64Array, Float64Array]:
    """Return where a distorting lens shows points: the inverse of `undistorted`.

    NaN for points that the lens does not show.
    """
    if distortion == 0.0:
        return across, above
    # A fisheye's r (1 + k (r^2 - 1)) is the formula of a lens with another scale and distortion:
    # (1 - k) r (1 + k / (1 - k) r^2).
    middle = 1.0 - distortion * fixed_at(projection)
    across, above, distortion = across / middle, above / middle, distortion / middle
    aim = np.hypot(across, above)
    # Beyond this radius a negative distortion would show things twice.
    farthest = np.inf if distortion > 0.0 else 1.0 / np.sqrt(-3.0 * distortion)
    r = np.minimum(aim, 0.9 * min(farthest, 1.0))
    for _ in range(_NEWTON_STEPS):
        r = r - (r + distortion * r**3 - aim) / (1.0 + 3.0 * distortion * r**2)
        r = np.minimum(r, (1.0 - _NEWTON_ERROR) * farthest)
    met = np.abs(r + distortion * r**3 - aim) < _NEWTON_ERROR
    shrink = np.where(met, 1.0 / (1.0 + distortion * r**2), np.nan)
    return across * shrink, above * shrink
