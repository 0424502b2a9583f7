"""A query's skyline as rays of a camera, and its directions for a pitch and a roll."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skyline.arrays import Float64Array, IntArray
from skyline.errors import InputError
from skyline.photo.skyline import (
    MAX_PANORAMA_DEG,
    WANDER_DEGREES,
    Lens,
    PhotoSkyline,
    Projection,
    wander_of,
)

REFERENCE_FOV_DEG = 60.0
"""Field of view to which sizes of pixels are compared."""
FOV_RANGE_DEG = (25.0, 100.0)
"""Fields of view that are searched where none is known."""
USUAL_FOV_DEG = (55.0, 14.0)
"""Mean and standard deviation of those fields of view: most photos are taken with a phone or a
usual zoom lens."""
_DISTORTION_SD, _WIDE_DISTORTION_SD = 0.01, 0.05
"""Standard deviations of a lens's distortion. Those of 3,500 lenses in lensfun's database are 2 to
6 % of half the width, rms; phones and many cameras correct their photos. With a larger deviation,
near slopes bend to fit."""
_WIDE_DEG = 75.0
"""Lenses of a greater field of view are wide."""
_WANDER_SD_DEG = 1.0 / (np.array(WANDER_DEGREES) - 1.0)
_WANDER_FOV_DEG = 240.0
"""Standard deviations of a panorama's row shifts, one for each polynomial degree, at this field of
view. As in a random walk, they fall with the inverse of the degree. They grow with the square root
of the field of view."""
_FOV_DEVIATIONS = 4.0
"""Standard deviations to either side of a given field of view that are searched."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """The trusted columns of a query skyline in the camera's frame.

    Raises `InputError` where all weights are 0.
    """

    u: Float64Array
    v: Float64Array
    """``u``, ``v``: (W,) float64. Positions on an image of unit focal length, to the right of its
    middle and up. The rays (right, up, forward) are (u, v, 1) for a lens, and (sin u, v, cos u) for
    a panorama, whose image is a cylinder."""
    weight: Float64Array
    """(W,) float64. Trust in each ray, at least 0; only ratios matter."""
    fov_deg: float
    """Horizontal field of view that u and v were computed with."""
    fov_range_deg: tuple[float, float] | None = None
    """Range of the true field of view; by default it is `fov_deg` exactly."""
    fov_sd_deg: float = math.inf
    """Standard deviation of the true field of view about `fov_deg`; infinite for a uniform
    distribution over the range."""
    projection: Projection = Projection.PERSPECTIVE
    distortion_sd: float = 0.0
    """Standard deviation of the lens's distortion about 0; 0 for a panorama, and for a lens without
    distortion. A distortion k moves a ray outwards by k times its `reach`; see
    `skyline.photo.skyline.undistorted`."""

    @classmethod
    def of(cls, query: PhotoSkyline, fov_slack: float, *, finds_fov: bool) -> "Rays":
        """Return a query's rays, with the fields of view that the query may have.

        ``fov_slack`` is the deviation of a field of view, as a share of it, where its lens has none
        of its own. Raises `InputError` for a query of unknown field of view, unless the matcher
        finds it, and for a panorama of unknown field of view.
        """
        is_panorama = query.projection.is_panorama
        weight = query.confidence[query.trusted]
        if query.fov_deg is not None:
            fov_deg, lens = query.fov_deg, query.lens or Lens(query.fov_deg)
            distortion_sd = _WIDE_DISTORTION_SD if fov_deg > _WIDE_DEG else _DISTORTION_SD
            rays = cls(
                *query.image_plane(),
                weight,
                fov_deg,
                projection=query.projection,
                distortion_sd=0.0 if is_panorama else distortion_sd,
            )
            slack = 0.0 if fov_deg == MAX_PANORAMA_DEG else fov_slack
            sd_deg = slack * fov_deg if lens.sd_deg is None else lens.sd_deg
            return rays.about(sd_deg, lens.most_deg or math.inf)
        if finds_fov and not is_panorama:
            fov_deg, sd_deg = USUAL_FOV_DEG
            u, v = query.with_fov(fov_deg).image_plane()
            return cls(u, v, weight, fov_deg, FOV_RANGE_DEG, sd_deg, distortion_sd=_DISTORTION_SD)
        raise InputError(
            "the query's field of view is not known: it is not in the image; give --fov-deg"
        )

    def __post_init__(self) -> None:
        if not self.weight.any():
            raise InputError("all weights of the query are 0, so there is nothing to match")

    @property
    def is_panorama(self) -> bool:
        """True if the photo was swept or stitched."""
        return self.projection.is_panorama

    @property
    def fov_bounds_deg(self) -> tuple[float, float]:
        """The smallest and the largest field of view that are searched."""
        return self.fov_range_deg or (self.fov_deg, self.fov_deg)

    @property
    def log_scale_bounds(self) -> tuple[float, float]:
        """The smallest and the largest `log_scale`."""
        low, high = self.log_scale(np.array(self.fov_bounds_deg))
        return float(low), float(high)

    @property
    def log_scale_sd(self) -> float:
        """Standard deviation of `log_scale`."""
        sd_rad, fov_rad = math.radians(self.fov_sd_deg), math.radians(self.fov_deg)
        return sd_rad / (fov_rad if self.is_panorama else math.sin(fov_rad))

    def log_scale(self, fov_deg: Float64Array | float) -> Float64Array:
        """Return the logarithm of the factor on u and v that gives each field of view."""
        return np.asarray(
            np.log(self._half_width(fov_deg)) - np.log(self._half_width(self.fov_deg))
        )

    def fov_at(self, log_scale: Float64Array) -> Float64Array:
        """Return the fields of view, degrees, of factors on u and v; the inverse of `log_scale`."""
        half_width = self._half_width(self.fov_deg) * np.exp(log_scale)
        half_rad = half_width if self.is_panorama else np.arctan(half_width)
        return np.asarray(np.degrees(2.0 * half_rad))

    def searched_fov_deg(self, log_scale: Float64Array) -> Float64Array:
        """Return the fields of view of factors, as `fov_at`, within `fov_bounds_deg`."""
        return np.asarray(np.clip(self.fov_at(log_scale), *self.fov_bounds_deg))

    @property
    def warp_sd(self) -> Float64Array:
        """Standard deviations (K,) of how an image may be warped.

        One of the distortion of a lens that may distort, and one for each column of a panorama's
        `wander`.
        """
        if self.is_panorama:
            grown = math.sqrt(self.fov_deg / _WANDER_FOV_DEG)
            return np.radians(_WANDER_SD_DEG) * grown
        return np.array([self.distortion_sd] if self.distortion_sd > 0.0 else [])

    @property
    def wander(self) -> Float64Array:
        """Ways (W, 4) in which the rows of a panorama wander; (W, 0) for a lens."""
        if not self.is_panorama:
            return np.zeros((len(self.u), 0))
        return wander_of(self.u / self._half_width(self.fov_deg))

    @property
    def reach(self) -> Float64Array:
        """Squared distance (W,) from the image's middle, in half widths."""
        return np.asarray((self.u**2 + self.v**2) / self._half_width(self.fov_deg) ** 2)

    @property
    def half_width(self) -> float:
        """Half the width of an image of unit focal length."""
        return float(self._half_width(self.fov_deg))

    def _half_width(self, fov_deg: Float64Array | float) -> Float64Array:
        """Return half the width of an image of unit focal length."""
        half_rad = np.radians(fov_deg) / 2.0
        return np.asarray(half_rad if self.is_panorama else np.tan(half_rad))

    def with_fov(self, fov_deg: float) -> "Rays":
        """Return the same photo's rays for another field of view, degrees, within the range."""
        u, v = self.scaled(self._half_width(fov_deg) / self._half_width(self.fov_deg))
        return replace(self, u=u, v=v, fov_deg=fov_deg)

    def scaled(self, scale: Any) -> tuple[Any, Any]:
        """Return u and v for half widths ``scale`` times as large, in the dtype of ``scale``."""
        u, v = (ray.astype(scale.dtype) for ray in (self.u, self.v))
        if self.projection is Projection.EQUIRECTANGULAR:
            return u * scale, np.tan(np.arctan(v) * scale)
        return u * scale, v * scale

    def about(self, sd_deg: float, most_deg: float = math.inf) -> "Rays":
        """Return the rays with a normally distributed field of view.

        Four standard deviations about the current one are searched, as far as a camera allows and
        up to ``most_deg``. With a deviation of 0 the field of view is known exactly.
        """
        if sd_deg == 0.0:
            return self
        fov_deg = self.fov_deg
        possible_deg = MAX_PANORAMA_DEG if self.is_panorama else 0.5 * (fov_deg + 180.0)
        widest_deg = min(fov_deg + _FOV_DEVIATIONS * sd_deg, possible_deg, most_deg)
        narrowest_deg = max(fov_deg - _FOV_DEVIATIONS * sd_deg, 0.5 * fov_deg)
        return replace(self, fov_range_deg=(narrowest_deg, widest_deg), fov_sd_deg=sd_deg)


def level(
    u: Float64Array,
    v: Float64Array,
    pitch_deg: float,
    roll_deg: float,
    projection: Projection = Projection.PERSPECTIVE,
) -> tuple[Float64Array, Float64Array]:
    """Return azimuths and elevation tangents of rays of a pitched and rolled camera.

    Azimuths are radians clockwise from the vertical plane of the optical axis, in (-pi, pi]. The
    elevation tangent is up over horizontal distance. The pitch is the axis's angle above the
    horizon; the roll turns the camera clockwise as seen from behind it. u and v are as in
    `Rays`.
    """
    attitude = np.radians(pitch_deg), np.radians(roll_deg)
    right, up, forward = level_axes(u, v, *attitude, projection)
    return np.arctan2(right, forward), up / np.hypot(right, forward)


def level_axes(
    u: Any, v: Any, pitch: Any, roll: Any, projection: Projection = Projection.PERSPECTIVE
) -> tuple[Any, Any, Any]:
    """Return rays as right, up and forward components of a level camera; angles in radians.

    A panorama's camera turns about an upright axis, so its pitch raises the rows equally all the
    way round: tangents of a cylindrical photo, elevations of an equirectangular one.
    """
    if projection.is_panorama:
        above, side = _raised(v, np.tan(pitch), projection)
        across, above = side * np.sin(u), side * above
    else:
        across, above = u, v
    right = across * np.cos(roll) + above * np.sin(roll)
    up = above * np.cos(roll) - across * np.sin(roll)
    if projection.is_panorama:
        return right, up, side * np.cos(u)
    return right, up * np.cos(pitch) + np.sin(pitch), np.cos(pitch) - up * np.sin(pitch)


def _raised(v: Any, tangent: Any, projection: Projection) -> tuple[Any, Any]:
    """Return v raised by a pitch of a tangent, and 1, or -1 where it is raised past the zenith.

    An equirectangular photo is raised by the angle.
    """
    if projection is not Projection.EQUIRECTANGULAR:
        return v + tangent, 1.0
    cosine = 1.0 - v * tangent
    return (v + tangent) / cosine, np.sign(cosine)


def project(
    azimuth_rad: Float64Array,
    y: Float64Array,
    pitch_deg: float,
    roll_deg: float,
    projection: Projection = Projection.PERSPECTIVE,
) -> tuple[Float64Array, Float64Array]:
    """Return u and v of directions; the inverse of `level`.

    NaN for directions that are not in front of a lens, or that a pitch moves past the zenith.
    """
    pitch, roll = np.radians(pitch_deg), np.radians(roll_deg)
    right, ahead = np.sin(azimuth_rad), np.cos(azimuth_rad)
    if projection.is_panorama:
        across = right * np.cos(roll) - y * np.sin(roll)
        above = (right * np.sin(roll) + y * np.cos(roll)) / np.hypot(across, ahead)
        v, side = _raised(above, -np.tan(pitch), projection)
        return np.arctan2(across, ahead), np.where(side > 0.0, v, np.nan)
    forward = ahead * np.cos(pitch) + y * np.sin(pitch)
    forward = np.where(forward > 0.0, forward, np.nan)
    up = y * np.cos(pitch) - ahead * np.sin(pitch)
    return (
        (right * np.cos(roll) - up * np.sin(roll)) / forward,
        (right * np.sin(roll) + up * np.cos(roll)) / forward,
    )


def level_with_changes(
    query: Rays,
    pitch_rad: Float64Array,
    roll_rad: Float64Array,
    log_scale: Float64Array,
    warp: Float64Array,
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """Level a query's R rays at M attitudes, scales and warps (M, K), with derivatives.

    Returns azimuths and elevation tangents (M, R), as `level`, and the derivatives (M, R, 3 + K) of
    both by pitch and roll, in radians, by the logarithm of the scale, and by the warps; see
    `Rays.warp_sd`.
    """
    scale = np.exp(log_scale)[:, np.newaxis]
    u, v = query.scaled(scale)
    attitude = pitch_rad[:, np.newaxis], roll_rad[:, np.newaxis]
    if query.is_panorama:
        wander = scale[..., np.newaxis] * query.wander
        grown = v
        if query.projection is Projection.EQUIRECTANGULAR:
            grown = np.arctan(query.v) * scale * (1.0 + np.square(v))
        wandered = (wander @ warp[..., np.newaxis])[..., 0]
        (right, up, forward), changes = _panorama_with_changes(
            u, v + wandered, grown + wandered, wander, *attitude, query.projection
        )
    else:
        stretch: Any = 1.0
        share = np.zeros((*u.shape, 0))
        if warp.shape[1]:
            stretch = 1.0 + warp * query.reach
            share = (query.reach / stretch)[..., np.newaxis]
        (right, up, forward), changes = _axes_with_changes(u * stretch, v * stretch, *attitude)
        # Distortion moves rays outwards like the scale, but the more the farther out they are.
        changes = [np.concatenate([one, one[..., 2:] * share], axis=-1) for one in changes]
    right_change, up_change, forward_change = changes
    flat = np.hypot(right, forward)
    right_, forward_, up_, flat_ = (a[..., np.newaxis] for a in (right, forward, up, flat))
    flat_change = (right_ * right_change + forward_ * forward_change) / flat_
    return (
        np.arctan2(right, forward),
        up / flat,
        (forward_ * right_change - right_ * forward_change) / flat_**2,
        (up_change - up_ * flat_change / flat_) / flat_,
    )


def _axes_with_changes(
    u: Float64Array, v: Float64Array, pitch: Float64Array, roll: Float64Array
) -> tuple[tuple[Any, Any, Any], list[Float64Array]]:
    """Return `level_axes` of a lens, and its derivatives (M, R, 3) by pitch, roll and log scale."""
    right, up, forward = axes = level_axes(u, v, pitch, roll)
    cos_pitch, sin_pitch = np.cos(pitch), np.sin(pitch)
    above = v * np.cos(roll) - u * np.sin(roll)
    changes = [
        [np.zeros_like(up), above, right],
        [forward, -right * cos_pitch, above * cos_pitch],
        [-up, right * sin_pitch, -above * sin_pitch],
    ]
    return axes, [np.stack(change, axis=-1) for change in changes]


def _panorama_with_changes(
    u: Float64Array,
    v: Float64Array,
    v_change: Float64Array,
    wander: Float64Array,
    pitch: Float64Array,
    roll: Float64Array,
    projection: Projection,
) -> tuple[tuple[Any, Any, Any], list[Float64Array]]:
    """Return `level_axes` of a panorama, and its derivatives (M, R, 3 + K).

    They are by pitch, roll, log scale and warps. ``v_change`` (M, R) and ``wander`` (M, R, K) are
    the derivatives of v by the last two.
    """
    above, _ = _raised(v, np.tan(pitch), projection)
    if projection is Projection.EQUIRECTANGULAR:
        by_pitch = 1.0 + np.square(above)
        by_v = by_pitch / (1.0 + np.square(v))
    else:
        by_pitch, by_v = np.ones_like(v) / np.square(np.cos(pitch)), np.ones_like(v)
    # Pitch, scale and warps move a ray up the image; scale moves it across, too.
    lifts = [by_pitch, np.zeros_like(v), by_v * v_change]
    lifted = np.concatenate([np.stack(lifts, axis=-1), by_v[..., np.newaxis] * wander], axis=-1)
    right, up, forward = axes = level_axes(u, above, 0.0, roll, projection)
    right_change, up_change = (
        lifted * turned[..., np.newaxis] for turned in (np.sin(roll), np.cos(roll))
    )
    forward_change = np.zeros_like(lifted)
    right_change[..., 1], up_change[..., 1] = up, -right
    right_change[..., 2] += u * forward * np.cos(roll)
    up_change[..., 2] -= u * forward * np.sin(roll)
    forward_change[..., 2] = -u * np.sin(u)
    return axes, [right_change, up_change, forward_change]


def thinned(query: Rays, bins: int) -> Rays:
    """Average the rays within each of ``bins`` steps of a level camera's azimuth.

    The terrain's curve is no finer than its bins, so averages hold nearly all the information of
    many columns at the cost of few. They are returned from left to right. The weight of an average
    is the mean weight of its rays, so weights refer to the noise of averages.
    """
    azimuth = query.u if query.is_panorama else np.arctan(query.u)
    step = np.floor(azimuth * (bins / (2.0 * np.pi))).astype(np.intp)
    step -= step.min()
    total = np.bincount(step, query.weight)
    kept = np.flatnonzero(total)
    return _averaged(query, step, kept, total[kept] / np.bincount(step)[kept])


def in_runs(query: Rays, count: int) -> Rays:
    """Average rays over ``count`` equal steps of u; steps with few trusted rays are left out.

    The mean weight is 1. A panorama is joined from photos, so it has ``count`` steps in each 60
    degrees.
    """
    if query.is_panorama:
        count = max(1, round(count * query.fov_deg / REFERENCE_FOV_DEG))
    left, right = query.u.min(), query.u.max()
    width = max((right - left) / count, 1e-9)
    step = np.minimum((query.u - left) / width, count - 1).astype(np.intp)
    total = np.bincount(step, query.weight, count)
    kept = np.flatnonzero(total > 0.3 * np.median(total[total > 0.0]))
    return _averaged(query, step, kept, total[kept] / total[kept].mean())


def _averaged(query: Rays, step: IntArray, kept: IntArray, weight: Float64Array) -> Rays:
    """Return the weighted means of the rays in each kept step, with new weights."""
    total = np.bincount(step, query.weight)[kept]
    u, v = (np.bincount(step, query.weight * ray)[kept] / total for ray in (query.u, query.v))
    return replace(query, u=u, v=v, weight=weight)


def on_bins(query: Rays, pitch_deg: float, bins: int) -> tuple[Float64Array, Float64Array]:
    """Return a query, levelled at one pitch, on B equal steps of azimuth.

    These are the tangents y (B,) of its elevation angle, NaN outside the photo, and the trust (B,)
    in each, 0 outside. Bin B / 2 is straight ahead.

    Rays in one bin are averaged both in azimuth and in y, which removes noise without shifting a
    slope. Values at bin centres are interpolated linearly between these averages.
    """
    azimuth, y = level(query.u, query.v, pitch_deg, 0.0, query.projection)
    position = azimuth * bins / (2.0 * np.pi) + bins / 2.0
    nearest = np.clip(np.rint(position), 0, bins - 1).astype(np.intp)
    weight = np.bincount(nearest, query.weight, bins)
    filled = np.flatnonzero(weight)
    total = weight[filled]
    at = np.bincount(nearest, query.weight * position, bins)[filled] / total
    mean_y = np.bincount(nearest, query.weight * y, bins)[filled] / total
    mean_weight = total / np.bincount(nearest, minlength=bins)[filled]
    centres = np.arange(bins, dtype=np.float64)
    after = np.searchsorted(at, centres)
    spacing = np.diff(at, prepend=-np.inf, append=np.inf)
    step = float(np.median(np.diff(np.sort(position)))) if len(position) > 1 else 0.0
    # A centre within half a bin of a lone or outermost average still belongs to it.
    seen = (spacing[after] <= 3.0 * max(step, 1.0)) | (weight > 0.0)
    return (
        np.where(seen, np.interp(centres, at, mean_y), np.nan),
        np.where(seen, np.interp(centres, at, mean_weight), 0.0),
    )
