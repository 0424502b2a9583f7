"""The paper's reprojection error (section 4.2), Equations 1 to 4, and tolerance areas.

The points of a stored skyline are projected from a displaced eye, and a warp of the stored
skyline is held to their images. A displacement t is (right, up, forward) in the view's own axes,
metres, and up holds the change of the ground's height; the T of Equation 4 is -t. A warp is
(2, 3): it takes (u, v, 1) to the abscissa and ordinate in the other image.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import BoolArray, Float32Array, Float64Array, FloatArray
from skyline.camera import HEADINGS, columns_u, rotation
from skyline.errors import InputError
from skyline.skylines import Views
from skyline.terrain.heightfield import Ground
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M

IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

_SAFE_DEPTH_SHARE = 0.05
"""z + k3T must stay above this share of z: nearer, a skyline has no warp to speak of."""

_RIDGE = 1e-9

_AT_ONCE = 1 << 18
"""Projected points evaluated together, to stay in the processor's cache."""

_COLUMNS = 80
"""At most so many points a view, evenly spread. On Davos, 80 decide as 640 do."""

_FEWEST_POINTS = 3
"""Fewer in frame are no answer."""

_ROTATIONS = np.stack([rotation(heading) for heading in HEADINGS])


def displacements_m(
    views: Views, easting_m: ArrayLike, northing_m: ArrayLike, eye_elevation_m: ArrayLike
) -> Float64Array:
    """Return where C other eyes (N, C) are, seen from each of N views, in the view's own axes.

    These are right, up and forward, (N, C, 3), metres.
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


def equation_4(depth_m: FloatArray, displacements_m: FloatArray) -> Float64Array:
    """Return the paper's warp A = [[s, 0, k1T / (z + k3T)], [0, s, k2T / (z + k3T)]].

    Parameters
    ----------
    depth_m : (N,) floating
        The representative depth z.
    displacements_m : (N, C, 3) floating
        Right, up, forward of the other eye; T is its negative.

    Returns
    -------
    (N, C, 2, 3) float64
        s = z / (z + k3T); NaN where z + k3T is not safely positive.
    """
    translation = -np.asarray(displacements_m, dtype=np.float64)
    z = np.asarray(depth_m, dtype=np.float64)[:, np.newaxis]
    moved = z + translation[..., 2]
    moved = np.where(moved > _SAFE_DEPTH_SHARE * z, moved, np.nan)
    affine = np.zeros((*moved.shape, 2, 3))
    affine[..., 0, 0] = affine[..., 1, 1] = z / moved
    affine[..., 0, 2] = translation[..., 0] / moved
    affine[..., 1, 2] = translation[..., 1] / moved
    # A zero would hide that there is no warp.
    affine[np.isnan(moved)] = np.nan
    return affine


def mean_depth_m(depth_m: FloatArray) -> Float64Array:
    """Return the mean depth of each view (N, P), NaN where it has none."""
    known = np.isfinite(depth_m)
    count = known.sum(axis=1)
    total = np.where(known, depth_m, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def median_depth_m(depth_m: FloatArray) -> Float64Array:
    """Return the median depth of each view (N, P), NaN where it has none."""
    ordered = np.sort(depth_m, axis=1).astype(np.float64)  # NaN come last
    count = np.isfinite(ordered).sum(axis=1)
    row = np.arange(len(ordered))
    return np.asarray(
        0.5 * (ordered[row, np.maximum(count - 1, 0) // 2] + ordered[row, count // 2 * (count > 0)])
    )


def least_squares(
    points_uv: Float64Array, there_uv: Float64Array, usable: BoolArray
) -> Float64Array:
    """Return the warps (N, C, 2, 3) that take points nearest to their images elsewhere.

    Where the points lie on a line, or are fewer than three, the one of the many that is nearest
    to the identity.

    Parameters
    ----------
    points_uv : (N, P, 2) float64
    there_uv : (N, C, P, 2) float64
        Finite where usable.
    usable : (N, C, P) bool
    """
    design = np.concatenate([points_uv, np.ones((*points_uv.shape[:2], 1))], axis=2)
    design = np.nan_to_num(design)
    products = design[:, :, :, np.newaxis] * design[:, :, np.newaxis, :]
    weight = usable.astype(np.float64)
    normal = np.einsum("ncp,npij->ncij", weight, products, optimize=True)
    trace = np.trace(normal, axis1=2, axis2=3)[..., np.newaxis, np.newaxis]
    normal += _RIDGE * (trace + 1.0) * np.eye(3)
    moved = np.where(usable[..., np.newaxis], there_uv - points_uv[:, np.newaxis], 0.0)
    right_side = np.einsum("npi,ncpk->ncik", design, moved, optimize=True)
    change = np.linalg.solve(normal, right_side)
    return np.asarray(IDENTITY + np.swapaxes(change, 2, 3), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """P skyline points of N views and their images at C displaced eyes."""

    points_uv: Float64Array
    """(N, P, 2) float64. Abscissa and ordinate in the view, NaN where it has no skyline."""
    there_uv: Float64Array
    """(N, C, P, 2) float64. The same from the displaced eyes; finite where usable."""
    usable: BoolArray
    """(N, C, P) bool. Whether a point is safely in front of the displaced eye and in its frame. A
    frame has sides, but neither top nor bottom."""
    depth_m: Float64Array
    """(N, P) float64."""
    displacements_m: Float64Array
    """(N, C, 3) float64."""

    @classmethod
    def of(cls, views: Views, displacements_m: FloatArray, columns: int) -> "Projected":
        """Project at most so many evenly spread points of each view."""
        # Points of the skyline itself, not means: a mean of two ridges is on neither.
        stride = slice(0, None, -(-views.width // columns))
        u = columns_u(views.width)[stride]
        v = views.elevation_tan[:, stride].astype(np.float64)
        depth = views.depth_m[:, stride].astype(np.float64)
        moved = np.asarray(displacements_m, dtype=np.float64)
        right, up, forward = np.moveaxis(moved, 2, 0)[..., np.newaxis]
        z = depth[:, np.newaxis]
        ahead = z - forward
        usable = (ahead > _SAFE_DEPTH_SHARE * z) & np.isfinite(v[:, np.newaxis] - up - right)
        ahead = np.where(usable, ahead, 1.0)
        abscissa = (u * z - right) / ahead
        ordinate = (v[:, np.newaxis] * z - up) / ahead
        usable &= np.abs(abscissa) <= 1.0
        points = np.stack([np.broadcast_to(u, v.shape), v], axis=-1)
        return cls(points, np.stack([abscissa, ordinate], axis=-1), usable, depth, moved)


@dataclass(frozen=True, slots=True)
class Reprojection:
    """Mean distance of warped points from their true images, over those in front and in frame."""

    warp: Callable[[Projected], Float64Array]
    """Returns the warps (N, C, 2, 3), NaN where there is none."""

    def errors_px(self, views: Views, displacements_m: FloatArray) -> Float32Array:
        """Return reprojection errors of candidates.

        Raises `InputError` for displacements of another shape.

        Parameters
        ----------
        views : Views
            N views.
        displacements_m : (N, C, 3) floating
            Right, up, forward of C candidate eyes in each view's own axes; NaN is no eye.

        Returns
        -------
        (N, C) float32
            Mean distance in px (2 / W in v); inf where the view predicts nothing: no warp, too
            little of the skyline in frame, no eye.
        """
        shape = displacements_m.shape
        if len(shape) != 3 or shape[0] != len(views) or shape[2] != 3:
            raise InputError(
                f"displacements have shape {shape}; expected ({len(views)}, C, 3): right, up and "
                "forward of C eyes for each view"
            )
        errors = np.empty(shape[:2], dtype=np.float32)
        some = max(1, _AT_ONCE // max(1, shape[1] * min(_COLUMNS, views.width)))
        for begin in range(0, len(views), some):
            part = slice(begin, begin + some)
            errors[part] = self._errors_px(views[part], displacements_m[part])
        return errors

    def _errors_px(self, views: Views, displacements_m: FloatArray) -> FloatArray:
        projected = Projected.of(views, displacements_m, _COLUMNS)
        affine = self.warp(projected)
        warped = projected.points_uv[:, np.newaxis] @ np.swapaxes(affine[..., :2], 2, 3)
        warped += affine[..., np.newaxis, :, 2]
        usable = projected.usable
        missed = np.where(usable[..., np.newaxis], warped - projected.there_uv, 0.0)
        count = usable.sum(axis=2)
        mean = np.hypot(missed[..., 0], missed[..., 1]).sum(axis=2) / np.maximum(count, 1)
        answered = (count >= _FEWEST_POINTS) & np.isfinite(mean)
        return np.where(answered, mean * (views.width / 2.0), np.inf)


PREDICTORS: Mapping[str, Reprojection] = MappingProxyType(
    {
        "non-affine": Reprojection(
            lambda seen: np.broadcast_to(IDENTITY, (*seen.usable.shape[:2], 2, 3))
        ),
        "affine-mean": Reprojection(
            lambda seen: equation_4(mean_depth_m(seen.depth_m), seen.displacements_m)
        ),
        "affine-median": Reprojection(
            lambda seen: equation_4(median_depth_m(seen.depth_m), seen.displacements_m)
        ),
        "affine-least-squares": Reprojection(
            lambda seen: least_squares(seen.points_uv, seen.there_uv, seen.usable)
        ),
    }
)
"""By name: ``affine-mean`` is the paper's and the planners', the others are compared with it."""


@dataclass(frozen=True, slots=True)
class ToleranceMeter:
    """Measures how far around views their skylines serve: a call returns reprojection errors."""

    ground: Ground
    """Heights at map coordinates: `skyline.terrain.heightfield.ground_of`."""
    size: int = 10
    """K: rows and columns of the locations around a view, which is at [K // 2, K // 2]; 10 in the
    paper."""
    spacing_m: float = 30.0
    """Distance between neighbouring locations."""
    predictor: Reprojection = PREDICTORS["affine-mean"]

    def __post_init__(self) -> None:
        if not 1 <= self.size <= 1001:
            raise InputError(
                f"neighbourhood is {self.size} locations wide; expected 1 to 1001 (the paper "
                "takes 10)"
            )
        if not (np.isfinite(self.spacing_m) and self.spacing_m > 0.0):
            raise InputError(
                f"neighbourhood has a spacing of {self.spacing_m} m; expected a positive number"
            )

    def __call__(self, views: Views) -> Float32Array:
        """Return the reprojection errors of the neighbourhoods of N views.

        Returns
        -------
        (N, K, K) float32
            In px; row 0 is the northernmost, column 0 the westernmost, whatever the heading. inf
            off the map, on holes and where the predictor has no answer; 0 at the view itself.
        """
        size, centre = self.size, self.size // 2
        steps = (np.arange(size) - centre) * self.spacing_m
        easting = views.easting_m[:, np.newaxis] + np.tile(steps, size)
        northing = views.northing_m[:, np.newaxis] - np.repeat(steps, size)
        eye_elevation = self.ground(easting, northing) + DEFAULT_EYE_HEIGHT_M
        moved = displacements_m(views, easting, northing, eye_elevation)
        errors = self.predictor.errors_px(views, moved).reshape(len(views), size, size)
        errors[:, centre, centre] = 0.0
        return errors
