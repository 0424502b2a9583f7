"""The geometry of a camera, from its pixels to azimuths and elevations.

No other module of Skyline projects, levels or distorts, or takes derivatives of these steps. Four
kinds of coordinates follow one another:

* *pixels*: columns and rows; pixel centres are at whole numbers;
* *across, above*: right of and above a picture's middle, in halves of its width;
* *u, v*: the same on an image of unit focal length; see `Projection.rays`;
* *azimuth, elevation*: directions in a level frame, see `level`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from skyline.arrays import BoolArray, Float32Array, Float64Array, refuse_text
from skyline.errors import InputError

Pixel = tuple[float, float]
"""Column and row; pixel centres are at whole numbers."""

MIN_FOV_DEG = 1.0
MAX_FOV_DEG = 179.0
MAX_FISHEYE_DEG = 180.0
"""Greatest angle across a fisheye's picture; its corners look farther aside, and behind the
camera."""
MAX_PANORAMA_DEG = 360.0
MOST_DISTORTION = 0.3
"""Greatest distortion of a lens, see `undistorted`; a lens with more is a fisheye."""
WANDER_DEGREES = range(2, 6)
"""Degrees of the Legendre polynomials that describe how a panorama's rows wander."""
_NEWTON_STEPS = 30
"""Most steps by which `distorted` inverts a distortion. Five are enough, except near the radius at
which a negative distortion folds the image."""
_NEWTON_ERROR = 1e-9
"""Greatest error of such an inverse, in half widths."""
_NO_ANGLE = 1e-12
"""Replaces the angle 0 off a fisheye's axis, by which nothing can be divided."""
_LEAST_FORWARD = np.float32(0.05)
"""`ImagePoints.levelled` moves rays of a lens that point less far forward to this value."""
_BACKMOST_RAD = np.radians(170.0)
"""Largest angle off a fisheye's axis that `project` follows: no lens shows what is behind it, and a
line that passes there would cross the whole picture."""


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


def from_middle(
    column_px: ArrayLike, row_px: ArrayLike, width_px: int, height_px: int
) -> tuple[Float64Array, Float64Array]:
    """Return across and above of a picture's pixels."""
    across = (2.0 * np.asarray(column_px, dtype=np.float64) + 1.0) / width_px - 1.0
    above = (height_px - 1.0 - 2.0 * np.asarray(row_px, dtype=np.float64)) / width_px
    return across, above


def in_picture(
    column_px: ArrayLike,
    row_px: ArrayLike,
    width_px: int,
    height_px: int,
    margin_px: float = 0.0,
) -> BoolArray:
    """Return which pixels lie in a picture or a margin around it.

    NaN is outside.
    """
    column, row = np.asarray(column_px), np.asarray(row_px)
    edge_px = 0.5 + margin_px
    with np.errstate(invalid="ignore"):
        inside = (column >= -edge_px) & (column <= width_px - 1.0 + edge_px)
        return np.asarray(inside & (row >= -edge_px) & (row <= height_px - 1.0 + edge_px))


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
    stretch = 1.0 + distortion * (across**2 + above**2 - _fixed_at(projection))
    return across * stretch, above * stretch


def _fixed_at(projection: Projection) -> float:
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
    middle = 1.0 - distortion * _fixed_at(projection)
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


def level(
    u: Float64Array,
    v: Float64Array,
    pitch_deg: float,
    roll_deg: float,
    projection: Projection = Projection.PERSPECTIVE,
) -> tuple[Float64Array, Float64Array]:
    """Return azimuths and elevation tangents of a camera's rays.

    Azimuths are radians clockwise from the vertical plane of the optical axis, in (-pi, pi]. The
    elevation tangent is up over horizontal distance. The pitch is the axis's angle above the
    horizon; the roll turns the camera clockwise as seen from behind it. u and v are as in
    `Projection.rays`.
    """
    attitude = np.radians(pitch_deg), np.radians(roll_deg)
    right, up, forward = level_axes(u, v, *attitude, projection)
    return np.arctan2(right, forward), up / np.hypot(right, forward)


def level_axes(
    u: Any, v: Any, pitch: Any, roll: Any, projection: Projection = Projection.PERSPECTIVE
) -> tuple[Any, Any, Any]:
    """Return rays as components of a level camera.

    The components are right, up and forward; angles are in radians. A panorama's camera turns about
    an upright axis, so its pitch raises the rows equally all the way round: tangents of a
    cylindrical photo, elevations of an equirectangular one.
    """
    if not projection.is_panorama:
        return _held(*_ray(u, v, projection), pitch, roll)
    raised, side = _raised(v, np.tan(pitch), projection)
    return _held(side * np.sin(u), side * raised, side * np.cos(u), 0.0, roll)


def _held(right: Any, up: Any, forward: Any, pitch: Any, roll: Any) -> tuple[Any, Any, Any]:
    """Return a pitched and rolled camera's ray in a level frame.

    Both the ray given, in the camera's own frame, and the result are right, up and forward.
    """
    unrolled = up * np.cos(roll) - right * np.sin(roll)
    return (
        right * np.cos(roll) + up * np.sin(roll),
        unrolled * np.cos(pitch) + forward * np.sin(pitch),
        forward * np.cos(pitch) - unrolled * np.sin(pitch),
    )


def _ray(u: Any, v: Any, projection: Projection) -> tuple[Any, Any, Any]:
    """Return the ray of a lens in its frame: right, up and forward."""
    if projection is Projection.PERSPECTIVE:
        return u, v, 1.0
    off_axis = np.hypot(u, v)
    share = np.sinc(off_axis / np.pi)
    return u * share, v * share, np.cos(off_axis)


def _ray_by_log_scale(u: Any, v: Any, projection: Projection) -> tuple[Any, Any, Any]:
    """Return the derivative of `_ray` by the logarithm of the scale."""
    if projection is Projection.PERSPECTIVE:
        return u, v, 0.0
    off_axis = np.hypot(u, v)
    return u * np.cos(off_axis), v * np.cos(off_axis), -off_axis * np.sin(off_axis)


def _raised(v: Any, tangent: Any, projection: Projection) -> tuple[Any, Any]:
    """Return v raised by a pitch, and the side it is on.

    ``tangent`` is the tangent of the pitch. The side is 1, or -1 where v is raised past the zenith.
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

    NaN for directions that are not in front of a lens, that are right behind a fisheye, or that a
    pitch moves past the zenith.
    """
    pitch, roll = np.radians(pitch_deg), np.radians(roll_deg)
    level_right, level_forward = np.sin(azimuth_rad), np.cos(azimuth_rad)
    if projection.is_panorama:
        right = level_right * np.cos(roll) - y * np.sin(roll)
        up = level_right * np.sin(roll) + y * np.cos(roll)
        v, side = _raised(up / np.hypot(right, level_forward), -np.tan(pitch), projection)
        return np.arctan2(right, level_forward), np.where(side > 0.0, v, np.nan)
    forward = level_forward * np.cos(pitch) + y * np.sin(pitch)
    unpitched = y * np.cos(pitch) - level_forward * np.sin(pitch)
    right = level_right * np.cos(roll) - unpitched * np.sin(roll)
    up = level_right * np.sin(roll) + unpitched * np.cos(roll)
    if projection is Projection.FISHEYE:
        aside = np.hypot(right, up)
        off_axis = np.arctan2(aside, forward)
        stretch = np.where(off_axis < _BACKMOST_RAD, off_axis, np.nan) / np.fmax(aside, _NO_ANGLE)
        return right * stretch, up * stretch
    forward = np.where(forward > 0.0, forward, np.nan)
    return right / forward, up / forward


def _axes_with_changes(
    u: Float64Array,
    v: Float64Array,
    pitch: Float64Array,
    roll: Float64Array,
    projection: Projection,
) -> tuple[tuple[Any, Any, Any], list[Float64Array]]:
    """Return `level_axes` of a lens or a fisheye, with derivatives.

    The derivatives of each axis are (M, R, 3): by pitch, roll and log scale.
    """
    right, up, forward = axes = level_axes(u, v, pitch, roll, projection)
    own_right, own_up, _ = _ray(u, v, projection)
    unrolled = own_up * np.cos(roll) - own_right * np.sin(roll)
    scaled = _held(*_ray_by_log_scale(u, v, projection), pitch, roll)
    changes = [
        [np.zeros_like(up), unrolled, scaled[0]],
        [forward, -right * np.cos(pitch), scaled[1]],
        [-up, right * np.sin(pitch), scaled[2]],
    ]
    return axes, [np.stack(change, axis=-1) for change in changes]


def _panorama_with_changes(
    u: Float64Array,
    v: Float64Array,
    v_change: Float64Array,
    ways: Float64Array,
    pitch: Float64Array,
    roll: Float64Array,
    projection: Projection,
) -> tuple[tuple[Any, Any, Any], list[Float64Array]]:
    """Return `level_axes` of a panorama, with derivatives.

    The derivatives of each axis are (M, R, 3 + K): by pitch, roll, log scale and warps.
    ``v_change`` (M, R) and ``ways`` (M, R, K) are the derivatives of v by log scale and warps.
    """
    raised, _ = _raised(v, np.tan(pitch), projection)
    if projection is Projection.EQUIRECTANGULAR:
        by_pitch = 1.0 + np.square(raised)
        by_v = by_pitch / (1.0 + np.square(v))
    else:
        by_pitch = np.ones_like(v) / np.square(np.cos(pitch))
        by_v = np.ones_like(v)
    # Pitch, scale and warps move a ray up the image; scale moves it across, too.
    lifts = [by_pitch, np.zeros_like(v), by_v * v_change]
    lifted = np.concatenate([np.stack(lifts, axis=-1), by_v[..., np.newaxis] * ways], axis=-1)
    right, up, forward = axes = level_axes(u, raised, 0.0, roll, projection)
    right_change, up_change = (
        lifted * turned[..., np.newaxis] for turned in (np.sin(roll), np.cos(roll))
    )
    forward_change = np.zeros_like(lifted)
    right_change[..., 1] = up
    up_change[..., 1] = -right
    right_change[..., 2] += u * forward * np.cos(roll)
    up_change[..., 2] -= u * forward * np.sin(roll)
    forward_change[..., 2] = -u * np.sin(u)
    return axes, [right_change, up_change, forward_change]


def near_level_changes(
    azimuth: Float32Array, elevation_tan: Float32Array, slope: Float32Array, projection: Projection
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Return how fast a nearly level camera's rays rise above a curve.

    The camera turns about its middle, so these are exact for a level camera that sees the horizon,
    and neglect products of the pitch, the roll and the elevations otherwise.

    Parameters
    ----------
    azimuth, elevation_tan : (M, R) float32
        Directions of the rays, the azimuths from the optical axis, radians.
    slope : (M, R) float32
        Slope of the curve, a tangent of elevation over a radian of azimuth.

    Returns
    -------
    by_pitch, by_roll, by_log_scale : (M, R) float32
        Tangents by a radian of pitch and of roll, and by the logarithm of the image's scale.
    """
    sine, cosine = np.sin(azimuth), np.cos(azimuth)
    if projection.is_panorama:
        return np.ones_like(elevation_tan), -sine, elevation_tan - slope * azimuth
    if projection is Projection.FISHEYE:
        by_log_scale = elevation_tan * cosine / np.sinc(azimuth / np.float32(np.pi))
        return cosine, -sine, by_log_scale - slope * azimuth
    by_log_scale = elevation_tan * np.square(cosine) - slope * sine * cosine
    return cosine, -sine, by_log_scale


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ImagePoints:
    """R points on an image of unit focal length, and its projection."""

    u: Float64Array
    """(R,) float64. Position to the right of the image's middle; see `Projection.rays`."""
    v: Float64Array
    """(R,) float64. Position above the image's middle."""
    fov_deg: float
    """Horizontal field of view with which u and v were computed."""
    projection: Projection = Projection.PERSPECTIVE

    @property
    def is_panorama(self) -> bool:
        """True if the photo was swept or stitched."""
        return self.projection.is_panorama

    @property
    def half_width(self) -> float:
        """Half the width of the image."""
        return float(self.projection.half_width(self.fov_deg))

    @property
    def reach(self) -> Float64Array:
        """Share (R,) by which a distortion of 1 moves points outwards; see `undistorted`."""
        square = (self.u**2 + self.v**2) / self.half_width**2
        return np.asarray(square - _fixed_at(self.projection))

    @property
    def wander_ways(self) -> Float64Array:
        """`wander_ways` (R, 4) at the points of a panorama; none (R, 0) for a lens."""
        if not self.is_panorama:
            return np.zeros((len(self.u), 0))
        return wander_ways(self.u / self.half_width)

    def log_scale(self, fov_deg: Float64Array | float) -> Float64Array:
        """Return the logarithm of the scale that gives a field of view.

        The scale is the factor on u and v.
        """
        half_width = self.projection.half_width(fov_deg)
        return np.asarray(np.log(half_width) - np.log(self.half_width))

    def fov_at(self, log_scale: Float64Array) -> Float64Array:
        """Return fields of view, degrees, from logarithms of scales.

        The inverse of `log_scale`.
        """
        half_width = self.half_width * np.exp(log_scale)
        return np.asarray(self.projection.fov_deg(half_width))

    def scaled(self, scale: Any) -> tuple[Any, Any]:
        """Return u and v for half widths ``scale`` times as large.

        Their dtype is the dtype of ``scale``.
        """
        u, v = (ray.astype(scale.dtype) for ray in (self.u, self.v))
        if self.projection is Projection.EQUIRECTANGULAR:
            return u * scale, np.tan(np.arctan(v) * scale)
        return u * scale, v * scale

    def levelled(
        self, pitch: Float32Array, roll: Float32Array, log_scale: Float32Array, lift: Any
    ) -> tuple[Float32Array, Float32Array]:
        """Return azimuths and elevation tangents (M, R) at M attitudes.

        Each attitude has its own scale. ``pitch``, ``roll`` and ``log_scale`` are (M, 1), angles in
        radians; ``lift`` (M, R) is added to v. Azimuths of a lens are within a quarter turn of the
        axis, even for rays that look back.
        """
        u, v = self.scaled(np.exp(log_scale))
        right, up, forward = level_axes(u, v + lift, pitch, roll, self.projection)
        if self.projection.spreads_angles:
            return np.arctan2(right, forward), up / np.hypot(right, forward)
        forward = np.maximum(forward, _LEAST_FORWARD)
        return np.arctan(right / forward), up / np.hypot(right, forward)

    def levelled_with_changes(
        self,
        pitch_rad: Float64Array,
        roll_rad: Float64Array,
        log_scale: Float64Array,
        warp: Float64Array,
    ) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
        """Return directions at M attitudes, scales and warps (M, K), with derivatives.

        The warp is the distortion of a lens, K = 1, or none, K = 0; for a panorama, the factors of
        `wander_ways`, K = 4.

        Returns
        -------
        azimuth, elevation_tan : (M, R) float64
            As in `level`.
        azimuth_change, elevation_change : (M, R, 3 + K) float64
            Their derivatives by pitch and roll, radians, the logarithm of the scale, and warps.
        """
        scale = np.exp(log_scale)[:, np.newaxis]
        attitude = pitch_rad[:, np.newaxis], roll_rad[:, np.newaxis]
        warped = self._wandered_axes if self.is_panorama else self._distorted_axes
        (right, up, forward), changes = warped(scale, *attitude, warp)
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

    def _wandered_axes(
        self, scale: Float64Array, pitch: Float64Array, roll: Float64Array, warp: Float64Array
    ) -> tuple[tuple[Any, Any, Any], list[Float64Array]]:
        """Return `_panorama_with_changes` of these points, whose rows wander."""
        u, v = self.scaled(scale)
        ways = scale[..., np.newaxis] * self.wander_ways
        grown = v
        if self.projection is Projection.EQUIRECTANGULAR:
            grown = np.arctan(self.v) * scale * (1.0 + np.square(v))
        lift = (ways @ warp[..., np.newaxis])[..., 0]
        return _panorama_with_changes(u, v + lift, grown + lift, ways, pitch, roll, self.projection)

    def _distorted_axes(
        self, scale: Float64Array, pitch: Float64Array, roll: Float64Array, warp: Float64Array
    ) -> tuple[tuple[Any, Any, Any], list[Float64Array]]:
        """Return `_axes_with_changes` of these points, distorted by a lens."""
        u, v = self.scaled(scale)
        stretch: Any = 1.0
        share = np.zeros((*u.shape, 0))
        if warp.shape[1]:
            stretch = 1.0 + warp * self.reach
            share = (self.reach / stretch)[..., np.newaxis]
        axes, changes = _axes_with_changes(u * stretch, v * stretch, pitch, roll, self.projection)
        # Distortion moves rays outwards like the scale, but the more the farther out they are.
        return axes, [np.concatenate([one, one[..., 2:] * share], axis=-1) for one in changes]


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A camera with the size of its picture, held in an attitude.

    Attributes
    ----------
    projection : Projection
    width_px, height_px : int
        Size of the picture.
    fov_deg : float
        Horizontal field of view.
    grid_heading_deg : float
        Grid azimuth of the optical axis.
    pitch_deg, roll_deg : float
        See `level`.
    distortion : float
        See `undistorted`.
    wander : tuple of float
        See `wandered`; empty for none.
    """

    projection: Projection
    width_px: int
    height_px: int
    fov_deg: float
    grid_heading_deg: float
    pitch_deg: float
    roll_deg: float
    distortion: float = 0.0
    wander: tuple[float, ...] = ()

    def check_inside(self, pixel: Pixel) -> None:
        """Raise `InputError` for a pixel outside the picture."""
        if not in_picture(*pixel, self.width_px, self.height_px):
            raise InputError(
                f"pixel {pixel[0]:g},{pixel[1]:g} is outside the photo of {self.width_px} x "
                f"{self.height_px} pixels; expected COLUMN,ROW from the upper left corner"
            )

    @property
    def warp(self) -> tuple[float, ...]:
        """The distortion of a lens, or all factors of a panorama's wander."""
        if self.projection.is_panorama:
            return self.wander or (0.0,) * len(WANDER_DEGREES)
        return (self.distortion,)

    def pixels(
        self, grid_azimuth_deg: ArrayLike, elevation_tan: ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Return the columns and rows at which directions appear.

        NaN for directions that are not in front of the camera.
        """
        refuse_text(grid_azimuth_deg=grid_azimuth_deg, elevation_tan=elevation_tan)
        turn = np.radians(np.asarray(grid_azimuth_deg, dtype=np.float64) - self.grid_heading_deg)
        tangent = np.asarray(elevation_tan, dtype=np.float64)
        u, v = project(turn, tangent, self.pitch_deg, self.roll_deg, self.projection)
        if self.wander:
            v = v - wandered(u / self.projection.half_width(self.fov_deg), self.wander)
        across, above = self.projection.places(u, v, self.fov_deg)
        across, above = distorted(across, above, self.distortion, self.projection)
        half_px = self.width_px / 2.0
        return (
            across * half_px + (self.width_px - 1.0) / 2.0,
            (self.height_px - 1.0) / 2.0 - above * half_px,
        )

    def directions(
        self, column_px: ArrayLike, row_px: ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Return the grid azimuths, degrees, and elevation tangents of pixels.

        The inverse of `pixels`.
        """
        refuse_text(column_px=column_px, row_px=row_px)
        across, above = from_middle(column_px, row_px, self.width_px, self.height_px)
        straight = undistorted(across, above, self.distortion, self.projection)
        u, v = self.projection.rays(*straight, self.fov_deg)
        if self.wander:
            v = v + wandered(across, self.wander)
        turn, tangent = level(u, v, self.pitch_deg, self.roll_deg, self.projection)
        return np.degrees(turn) + self.grid_heading_deg, tangent

    def changes(self, column_px: ArrayLike, row_px: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Return how the directions of N pixels change with the camera.

        Returns
        -------
        azimuth_change, tangent_change : (N, 4 + K) float64
            Derivatives of the azimuth, radians, and of the tangent of elevation, by heading, pitch
            and roll, radians, by the logarithm of the image's scale, and by K warps: the distortion
            of a lens, K = 1, or the ways in which a panorama's rows wander, K = 4.
        """
        across, above = from_middle(column_px, row_px, self.width_px, self.height_px)
        u, v = self.projection.rays(across, above, self.fov_deg)
        points = ImagePoints(u=u, v=v, fov_deg=self.fov_deg, projection=self.projection)
        pitch_rad, roll_rad = np.radians([[self.pitch_deg], [self.roll_deg]])
        _, _, by_azimuth, by_tangent = (
            one[0]
            for one in points.levelled_with_changes(
                pitch_rad, roll_rad, np.zeros(1), np.array([self.warp])
            )
        )
        by_heading = np.ones((len(by_azimuth), 1))
        return (
            np.concatenate([by_heading, by_azimuth], axis=1),
            np.concatenate([0.0 * by_heading, by_tangent], axis=1),
        )

    def spans(self, column_px: ArrayLike, row_px: ArrayLike) -> Float64Array:
        """Return how directions change from each of N pixels to the next.

        The derivatives (N, 2, 2) are of the azimuth, radians, and the tangent of elevation, by a
        column to the right and by a row down.
        """
        column, row = np.broadcast_arrays(
            np.asarray(column_px, dtype=np.float64), np.asarray(row_px, dtype=np.float64)
        )
        before, after = (
            self.directions(np.stack([column + side, column]), np.stack([row, row + side]))
            for side in (-0.5, 0.5)
        )
        return np.stack([np.radians(after[0] - before[0]).T, (after[1] - before[1]).T], axis=1)
