"""From eyes on the map to displacements in a view's axes, and which views share an eye."""

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


def reach_m(displacements_m: NDArray[np.floating]) -> float:
    """Return the greatest horizontal length of displacements (C, 3), NaN left out; 0 for none."""
    length = np.hypot(displacements_m[:, 0], displacements_m[:, 2])
    return float(np.fmax.reduce(length, initial=0.0))


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
    table = np.full((len(views), len(HEADINGS)), NO_VIEW, dtype=np.intp)
    backwards = np.arange(len(views))[::-1]
    table[eye[::-1], views.heading[::-1]] = backwards
    heading = views.heading.astype(np.intp)
    return np.stack([table[eye, (heading - 1) % 4], table[eye, (heading + 1) % 4]], axis=1)
