"""Section 4.2, Equations 1 to 4: reprojection errors and tolerance areas.

The skyline points X of a view are moved to another eye (Equation 1) and projected there. These
images are compared with a warp of the view's own skyline; the paper's warp is Equation 4.

Axes are the view's own: right, up, forward, metres. A displacement t leads to the other eye,
and up holds the change of the ground's height; the paper's T is -t. Images are on a plane at unit
distance (K = I), so that a pixel measures 2 / W. A warp is (2, 3): it takes (u, v, 1) to the
abscissa and ordinate in the other image.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.arrays import Float32Array, Float64Array, FloatArray
from skyline.skylines import HEADINGS, Views, columns_u, pixel_size, rotation
from skyline.terrain.heightfield import Ground
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints

IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

"""The warp that changes nothing."""

Warp = Callable[[Float64Array, Float64Array], Float64Array]
"""Takes skyline points (N, P, 3) and displacements (N, C, 3); returns warps (N, C, 2, 3), NaN where
there is none."""

_SAFE_DEPTH_SHARE = 0.05
"""A point or a skyline at depth z must keep more than this share of z: any nearer, a warp is
unstable."""

_ROTATIONS = np.stack([rotation(heading) for heading in HEADINGS])


def skyline_points_m(views: Views, columns: int = 80) -> Float64Array:
    """Return skyline points X (N, P, 3) of views; NaN is unknown.

    A view has at most ``columns`` points, evenly spread. On the terrain of Davos, 80 give the same
    decisions as 640.
    """
    # Points of the skyline itself, not means: a mean of two ridges is on neither.
    stride = slice(0, None, -(-views.width // columns))
    depth = views.depth_m[:, stride].astype(np.float64)
    right = columns_u(views.width)[stride] * depth
    return np.stack([right, views.v[:, stride] * depth, depth], axis=-1)


def displacements_m(
    eyes: Views | Viewpoints,
    heading: NDArray[np.integer],
    easting_m: ArrayLike,
    northing_m: ArrayLike,
    eye_elevation_m: ArrayLike,
) -> Float64Array:
    """Return the displacements t (N, C, 3) of other eyes.

    They lead from each of N eyes to C others, along the axes right, up and forward of the eye's
    view. An unknown height, NaN, leaves right and forward known.
    """
    own = (eyes.easting_m, eyes.eye_elevation_m, eyes.northing_m)
    other = (easting_m, eye_elevation_m, northing_m)
    east_up_north = np.stack(
        [
            np.asarray(there, dtype=np.float64) - here[:, np.newaxis]
            for here, there in zip(own, other, strict=True)
        ],
        axis=-1,
    )
    # Heights do not go through the product: 0 * NaN is NaN, and an unknown one must affect `up`
    # alone.
    turned = np.einsum("nij,ncj->nci", _ROTATIONS[heading][:, ::2, ::2], east_up_north[..., ::2])
    return np.stack([turned[..., 0], east_up_north[..., 1], turned[..., 1]], axis=-1)


def moved(points_m: Float64Array, displacements_m: Float64Array) -> Float64Array:
    """Return points (N, P, 3), seen from displaced eyes.

    They move by Equation 1, U2 = U1 + K T. Displacements are (N, C, 3); NaN is no eye. The result
    (N, C, P, 3) is right, up, forward of the other eye. Forward is NaN for a point that is not
    safely in front of it or not in its frame; a frame has sides, but neither top nor bottom.
    """
    here = np.moveaxis(points_m[:, np.newaxis], -1, 0)
    right, up, forward = here - np.moveaxis(displacements_m[:, :, np.newaxis], -1, 0)
    seen = forward > _SAFE_DEPTH_SHARE * here[2]
    seen &= np.abs(right) <= forward
    seen &= np.isfinite(up)
    return np.moveaxis(np.stack([right, up, np.where(seen, forward, np.nan)]), 0, -1)


def projected(points_m: Float64Array) -> Float64Array:
    """Return the images (..., 2) of points (..., 3): abscissas and ordinates."""
    return np.asarray(points_m[..., :2] / points_m[..., 2:])


def equation_4(depth_m: Float64Array, displacements_m: Float64Array) -> Float64Array:
    """Return the paper's warp, Equation 4.

    It is A = [[s, 0, k1T / (z + k3T)], [0, s, k2T / (z + k3T)]]. s is z / (z + k3T), and z (N,) the
    representative depth. Displacements are (N, C, 3). The warps (N, C, 2, 3) are NaN where z + k3T
    is not safely positive.
    """
    translation = -displacements_m
    z = depth_m[:, np.newaxis]
    left = z + translation[..., 2]
    left = np.where(left > _SAFE_DEPTH_SHARE * z, left, np.nan)
    affine = np.zeros((*left.shape, 2, 3))
    affine[..., 0, 0] = affine[..., 1, 1] = z / left
    affine[..., :, 2] = translation[..., :2] / left[..., np.newaxis]
    # A zero would hide that there is no warp.
    affine[np.isnan(left)] = np.nan
    return affine


def non_affine(points_m: Float64Array, displacements_m: Float64Array) -> Float64Array:
    """Return the identity, the paper's comparison without Equation 4."""
    return np.broadcast_to(IDENTITY, (*displacements_m.shape[:2], 2, 3))


def affine_mean(points_m: Float64Array, displacements_m: Float64Array) -> Float64Array:
    """Return Equation 4 at the points' mean depth, as planners do."""
    depth = np.ma.masked_invalid(points_m[..., 2]).mean(axis=1)
    return equation_4(np.ma.filled(depth, np.nan), displacements_m)


def affine_median(points_m: Float64Array, displacements_m: Float64Array) -> Float64Array:
    """Return Equation 4 at the median depth of the points."""
    depth = np.ma.median(np.ma.masked_invalid(points_m[..., 2]), axis=1)  # type: ignore[no-untyped-call]
    return equation_4(np.ma.filled(depth, np.nan), displacements_m)


def affine_least_squares(points_m: Float64Array, displacements_m: Float64Array) -> Float64Array:
    """Return the warps that take points nearest to their images.

    They are compared with Equation 4. Where the points lie on a line, or are fewer than three, many
    warps are equally near; the result is the one nearest to the identity.
    """
    images = projected(moved(points_m, displacements_m))
    usable = np.isfinite(images[..., 0])
    here = projected(points_m)
    design = np.nan_to_num(np.concatenate([here, np.ones((*here.shape[:2], 1))], axis=2))
    products = design[:, :, :, np.newaxis] * design[:, :, np.newaxis, :]
    weight = usable.astype(np.float64)
    normal = np.einsum("ncp,npij->ncij", weight, products, optimize=True)
    trace = np.trace(normal, axis1=2, axis2=3)[..., np.newaxis, np.newaxis]
    normal += 1e-9 * (trace + 1.0) * np.eye(3)
    change_uv = np.where(usable[..., np.newaxis], images - here[:, np.newaxis], 0.0)
    right_side = np.einsum("npi,ncpk->ncik", design, change_uv, optimize=True)
    change = np.linalg.solve(normal, right_side)
    return np.asarray(IDENTITY + np.swapaxes(change, 2, 3), dtype=np.float64)


WARPS: dict[str, Warp] = {
    "non-affine": non_affine,
    "affine-mean": affine_mean,
    "affine-median": affine_median,
    "affine-least-squares": affine_least_squares,
}
"""By name: ``affine-mean`` is the paper's and the planners', the others are compared with it."""


def errors_px(
    points_m: Float64Array, displacements_m: Float64Array, width: int, warp: Warp = affine_mean
) -> Float32Array:
    """Return reprojection errors (N, C) of views from other eyes.

    Each of N views is seen from C other eyes. An error is the mean distance of warped points from
    their images.

    Skyline points of the views are (N, P, 3), NaN where unknown; displacements to the other eyes
    (N, C, 3), NaN for no eye. Views have ``width`` columns W, and an error is in px
    (2 / W in v). It is infinite where the view predicts nothing: no warp, fewer than three points
    in frame, no eye.
    """
    errors = np.empty(displacements_m.shape[:2], dtype=np.float32)
    # So many points projected together stay in the processor's cache.
    some = max(1, (1 << 18) // max(1, displacements_m.shape[1] * points_m.shape[1]))
    for begin in range(0, len(points_m), some):
        part = slice(begin, begin + some)
        errors[part] = _errors(points_m[part], displacements_m[part], warp) / pixel_size(width)
    return errors


def _errors(points_m: Float64Array, displacements_m: Float64Array, warp: Warp) -> FloatArray:
    """Return `errors_px` in units of v."""
    affine = warp(points_m, displacements_m)[:, :, np.newaxis]
    u, v = np.moveaxis(projected(points_m)[:, np.newaxis], -1, 0)
    images = np.moveaxis(projected(moved(points_m, displacements_m)), -1, 0)
    missed_u, missed_v = (
        affine[..., k, 0] * u + affine[..., k, 1] * v + (affine[..., k, 2] - images[k])
        for k in (0, 1)
    )
    distance = np.hypot(missed_u, missed_v)
    usable = np.isfinite(distance)
    count = usable.sum(axis=2)
    mean = np.where(usable, distance, 0.0).sum(axis=2) / np.maximum(count, 1)
    return np.where(count >= 3, mean, np.inf)


def tolerance_errors_px(
    points_m: Float64Array,
    eyes: Views | Viewpoints,
    heading: NDArray[np.integer],
    ground: Ground,
    *,
    size: int,
    spacing_m: float,
    width: int,
) -> Float32Array:
    """Return the reprojection errors (N, K, K) in px around N views.

    The views are warped by Equation 4 at the mean depth.

    The tolerance area is where the errors are within a threshold. Row 0 is the northernmost and
    column 0 the westernmost, whatever the heading; the view is at [K // 2, K // 2], where the error
    is 0. It is infinite off the map, on holes and where `errors_px` is. Locations are ``spacing_m``
    apart, and K, ``size``, is 10 in the paper.
    """
    steps = (np.arange(size) - size // 2) * spacing_m
    easting = eyes.easting_m[:, np.newaxis] + np.tile(steps, size)
    northing = eyes.northing_m[:, np.newaxis] - np.repeat(steps, size)
    elevation = ground(easting, northing) + DEFAULT_EYE_HEIGHT_M
    there = displacements_m(eyes, heading, easting, northing, elevation)
    errors = errors_px(points_m, there, width).reshape(len(points_m), size, size)
    errors[:, size // 2, size // 2] = 0.0
    return errors
