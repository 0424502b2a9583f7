"""From eyes on the map to displacements in a view's axes, and which views share an eye."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.camera import HEADINGS, rotation
from skyline.errors import InputError
from skyline.views import Views

Float64Array = NDArray[np.float64]
IntArray = NDArray[np.intp]

NO_VIEW = -1

_ROTATIONS = np.stack([rotation(heading) for heading in HEADINGS])


def displacements_m(
    views: Views, easting_m: ArrayLike, northing_m: ArrayLike, eye_elevation_m: ArrayLike
) -> Float64Array:
    """Return where other eyes are, seen from each view, in the view's own axes.

    Parameters
    ----------
    views : Views
        N views.
    easting_m, northing_m, eye_elevation_m : (N, C) array_like
        C other eyes a view, in the views' frame.

    Returns
    -------
    (N, C, 3) float64
        Right, up, forward, metres.
    """
    own = (views.easting_m, views.eye_elevation_m, views.northing_m)
    other = (easting_m, eye_elevation_m, northing_m)
    east_up_north = np.stack(
        [
            np.asarray(there, dtype=np.float64) - here[:, np.newaxis]
            for here, there in zip(own, other, strict=True)
        ],
        axis=-1,
    )
    # Quarter turns hold zeros, and 0 * NaN is NaN: an unknown height must spoil `up` alone.
    turned = np.einsum(
        "nij,ncj->nci", _ROTATIONS[views.heading][:, ::2, ::2], east_up_north[..., ::2]
    )
    return np.stack([turned[..., 0], east_up_north[..., 1], turned[..., 1]], axis=-1)


def check_displacements(views: Views, displacements_m: NDArray[np.floating]) -> None:
    """Raise `InputError` unless displacements have one row of (C, 3) a view."""
    shape = displacements_m.shape
    if len(shape) != 3 or shape[0] != len(views) or shape[2] != 3:
        raise InputError(
            f"displacements have shape {shape}; expected ({len(views)}, C, 3): right, up and "
            "forward of C eyes for each view"
        )


@dataclass(frozen=True, slots=True)
class Reach:
    """How far some eyes are from a view's own, at most."""

    horizontal_m: float
    vertical_m: float

    @classmethod
    def of(cls, displacements_m: NDArray[np.floating]) -> "Reach":
        """Return the reach of displacements (C, 3), NaN left out; 0 for none."""
        right, up, forward = np.asarray(displacements_m, dtype=np.float64).T
        horizontal = np.fmax.reduce(np.hypot(right, forward), initial=0.0)
        return cls(float(horizontal), float(np.fmax.reduce(np.abs(up), initial=0.0)))


def flanks(views: Views) -> IntArray:
    """Return the views that look left and right from the same eye.

    Returns
    -------
    (N, 2) intp
        Index of the view with heading - 1 and of that with heading + 1, `NO_VIEW` where there is
        none. Of several, the first.
    """
    eyes = np.stack([views.easting_m, views.northing_m, views.eye_elevation_m], axis=1)
    eye = np.unique(eyes, axis=0, return_inverse=True)[1].reshape(-1)
    heading = views.heading.astype(np.intp)
    seen, first = np.unique(eye * len(HEADINGS) + heading, return_index=True)
    table = np.full((len(views), len(HEADINGS)), NO_VIEW, dtype=np.intp)
    table.ravel()[seen] = first
    return np.stack([table[eye, (heading - 1) % 4], table[eye, (heading + 1) % 4]], axis=1)
