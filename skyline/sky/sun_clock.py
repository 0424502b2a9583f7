"""A photo's time or its camera's heading, by sun or shadow.

A pixel of the sun's or the moon's disc gives a direction. A shadow's tip and foot give an azimuth:
whatever stands upright casts its shadow away from the sun, however tall it is and whatever the
ground's slope. The top of what casts the shadow gives the elevation, too. The errors of the
direction follow from the pose, the pixels and the ground's heights, and the sun's path on that day
turns them into the error of a time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, timedelta

import numpy as np
from scipy.linalg import block_diag

from skyline.angles import wrapped_deg
from skyline.arrays import Float64Array
from skyline.camera.pixels import Pixel
from skyline.errors import InputError
from skyline.ground.ground_view import GroundErrors, GroundPoints, GroundView
from skyline.photo.skyline import PhotoForm
from skyline.pose.pose import Pose
from skyline.pose.pose_errors import EAST, HEADING, NORTH, PIXEL_SD_PX, UP, Bearings
from skyline.sky.sun import Body, InSky, Sky, minutes_of
from skyline.terrain.height_errors import height_correlation

_FARTHEST_SDS = 4.0
"""A body that passes a direction at more than this many standard errors does not stand there."""
_LEAST_ELEVATION_DEG = -0.3
"""The middle of a disc whose edge is on a flat horizon."""
_WIDEST_SD_DEG = 30.0
"""A direction known less well than this says nothing about the time."""
_LEAST_SD_DEG = 0.01
"""The ephemeris and the frame are no more exact than this."""
_PENUMBRA_SD_DEG = 0.15
"""A shadow fades over the width of the sun's disc, 0.5 degrees; its end is seen within that."""
_NEWTON_STEPS = 4
_MINUTE_S = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class Pointing:
    """The direction in which a body stands, as a photo shows it.

    Attributes
    ----------
    azimuth_deg : float
        From true north.
    elevation_deg : float
        NaN where it is not known: for a shadow without a top.
    covariance : (2, 2) float64
        Covariance of azimuth and elevation, square degrees; infinite for an unknown elevation.
    from_axis_sd_deg : float
        Standard error of the azimuth relative to the camera's heading, so without the heading's
        error.
    """

    azimuth_deg: float
    elevation_deg: float
    covariance: Float64Array
    from_axis_sd_deg: float

    @property
    def azimuth_sd_deg(self) -> float:
        """Standard error of the azimuth."""
        return math.sqrt(self.covariance[0, 0])

    @property
    def information(self) -> Float64Array:
        """Inverse (2, 2) of the covariance."""
        if math.isnan(self.elevation_deg):
            return np.diag([1.0 / self.covariance[0, 0], 0.0])
        return np.asarray(np.linalg.inv(self.covariance), dtype=np.float64)

    def off_deg(self, *seen: InSky) -> Float64Array:
        """Return a body's offsets in azimuth and elevation, (N, 2).

        An unknown elevation counts as right.
        """
        direction_deg = np.array([(one.azimuth_deg, one.elevation_deg) for one in seen])
        off_deg = np.nan_to_num(direction_deg - [self.azimuth_deg, self.elevation_deg])
        off_deg[:, 0] = wrapped_deg(off_deg[:, 0])
        return np.asarray(off_deg)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockTime:
    """A time at which a body stands where a photo shows it.

    Attributes
    ----------
    time : datetime
        UTC.
    sd_s : float
        Standard error, seconds.
    off_sds : float
        By how many standard errors the body passes aside.
    azimuth_deg, elevation_deg : float
        The body at that time.
    """

    time: datetime
    sd_s: float
    off_sds: float
    azimuth_deg: float
    elevation_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SunHeading:
    """A camera's heading by the sun or moon at a known time.

    Attributes
    ----------
    heading_deg : float
        From true north.
    sd_deg : float
        Standard error, degrees.
    off_sds : float
        By how many standard errors the pose's heading is off.
    above_deg : float
        By how much the body stands higher than its pixel; NaN for a shadow.
    """

    heading_deg: float
    sd_deg: float
    off_sds: float
    above_deg: float


def body_pointing(
    pose: Pose, photo: PhotoForm, pixel: Pixel, pixel_sd_px: float = PIXEL_SD_PX
) -> Pointing:
    """Return the direction of a pixel in a body's disc.

    Raises `InputError` for a pixel outside the photo.
    """
    camera = pose.camera(photo)
    camera.check_inside(pixel)
    of_pose = pose.covariance_or_assumed(photo)
    seen = Bearings.of(camera, [pixel[0]], [pixel[1]], len(of_pose))
    changes = np.concatenate([seen.by_pose[0], seen.by_pixel[0]], axis=1)
    sine, cosine = np.sin(seen.grid_azimuth_rad[0]), np.cos(seen.grid_azimuth_rad[0])
    return _pointing(
        np.array([sine, cosine, seen.elevation_tan[0]]),
        np.array([[cosine, 0.0], [-sine, 0.0], [0.0, 1.0]]) @ changes,
        block_diag(of_pose, pixel_sd_px**2 * np.eye(2)),
        pose.convergence_deg,
        np.array([_LEAST_SD_DEG, _LEAST_SD_DEG]),
    )


def shadow_pointing(
    view: GroundView, pose: Pose, shadow: Sequence[Pixel], errors: GroundErrors | None = None
) -> Pointing:
    """Return the direction of the sun by the shadow of something upright.

    Parameters
    ----------
    view : GroundView
        The ground as the camera of ``pose`` sees it.
    shadow : sequence of (float, float)
        Two or three pixels: the end of the shadow; the foot of what casts it, where it stands on
        the ground; and its top. Without a top the elevation is not known. For a mountain's shadow,
        foot and top are the summit.

    Raises
    ------
    InputError
        A pixel is outside the photo, one of the first two shows sky, or the shadow's direction is
        too uncertain.
    """
    errors = errors or GroundErrors()
    tip, foot, top = (*shadow, shadow[1])[:3]
    for pixel in shadow:
        view.camera.check_inside(pixel)
    column_px, row_px = np.array([tip, foot]).T
    ground = view.points(column_px, row_px, errors)
    if ground.is_sky.any():
        raise InputError(
            f"one of the pixels {_named(tip)} and {_named(foot)} shows sky at this pose; give "
            "pixels of the ground, the tip of the shadow first and then the foot of what casts it"
        )
    way_m, by = _toward_sun(view, ground, top)
    apart_m = float(np.hypot(*way_m[:UP]))
    alike = height_correlation(apart_m * (1.0 - np.eye(2)))
    found = _pointing(
        way_m,
        by,
        block_diag(
            view.covariance,
            errors.pixel_sd_px**2 * np.eye(6),
            errors.height_sd_on(view.terrain) ** 2 * alike,
        ),
        pose.convergence_deg,
        np.array([_LEAST_SD_DEG, _PENUMBRA_SD_DEG]),
    )
    if len(shadow) == 2:
        azimuth_only = np.diag([found.covariance[0, 0], np.inf])
        found = replace(found, elevation_deg=math.nan, covariance=azimuth_only)
    if found.azimuth_sd_deg > _WIDEST_SD_DEG:
        raise InputError(
            f"the shadow is {math.dist(tip, foot):.0f} pixels long, and too flat to the view for "
            "its direction to be known; give a longer shadow, or one that is seen from higher up"
        )
    return found


def _toward_sun(
    view: GroundView, ground: GroundPoints, top: Pixel
) -> tuple[Float64Array, Float64Array]:
    """Return the way (3,) from a shadow's tip to its caster's top.

    ``ground`` has tip and foot; the top stands over the foot. The second result (3, P + 8) has the
    derivatives by the pose, by the pixels of tip, foot and top, and by the errors of the ground's
    heights at tip and foot.
    """
    tip, foot = ((ground.easting_m[k], ground.northing_m[k], ground.elevation_m[k]) for k in (0, 1))
    known = len(view.covariance)
    by = np.zeros((2, 3, known + 8))
    by[:, :, :known] = ground.by_pose
    for k in (0, 1):
        by[k, :, known + 2 * k : known + 2 * k + 2] = ground.by_pixel[k]
        by[k, :, known + 6 + k] = ground.by_height[k]
    # The top's ray ends over the foot.
    ray = Bearings.of(view.camera, [top[0]], [top[1]], known)
    tangent, away_m = float(ray.elevation_tan[0]), float(ground.distance_m[1])
    up_m = view.eye.eye_elevation_m[0] + tangent * away_m + view.curvature.drop_m(away_m)
    way = np.array([foot[EAST] - tip[EAST], foot[NORTH] - tip[NORTH], up_m - tip[UP]])
    outward = np.array([foot[EAST] - view.eye.easting_m[0], foot[NORTH] - view.eye.northing_m[0]])
    outward *= (tangent + 2.0 * view.curvature.drop_per_m2 * away_m) / away_m
    by[1, UP] = outward @ by[1, :UP]
    by[1, UP, EAST:UP] -= outward
    by[1, UP, UP] += 1.0
    by[1, UP, :known] += away_m * ray.by_pose[0, 1]
    by[1, UP, known + 4 : known + 6] += away_m * ray.by_pixel[0, 1]
    return way, by[1] - by[0]


def _pointing(
    way: Float64Array,
    by: Float64Array,
    covariance: Float64Array,
    convergence_deg: float,
    least_sd_deg: Float64Array,
) -> Pointing:
    """Return the direction of a way, with its errors.

    The way (3,) leads east, north and up. ``by`` (3, K) are its derivatives by the unknowns of a
    pose and others, whose covariance is ``covariance`` (K, K). The errors ``least_sd_deg`` (2,) of
    the direction are added.
    """
    azimuth_deg, elevation_deg = np.degrees(_angles(way)).tolist()
    no_heading = np.where(np.arange(by.shape[1]) == HEADING, 0.0, by)
    least_deg2 = np.diag(np.square(least_sd_deg))
    spread_deg2, from_axis_deg2 = (
        _spread_deg2(way, one @ covariance @ one.T) + least_deg2 for one in (by, no_heading)
    )
    return Pointing(
        azimuth_deg=(azimuth_deg + convergence_deg) % 360.0,
        elevation_deg=elevation_deg,
        covariance=spread_deg2,
        from_axis_sd_deg=math.sqrt(from_axis_deg2[0, 0]),
    )


def _angles(way: Float64Array) -> Float64Array:
    """Return the azimuths and elevations (..., 2), radians, of ways (..., 3)."""
    east, north, up = np.moveaxis(way, -1, 0)
    return np.stack([np.arctan2(east, north), np.arctan2(up, np.hypot(east, north))], axis=-1)


def _spread_deg2(way: Float64Array, covariance: Float64Array) -> Float64Array:
    """Return the covariance (2, 2) of a way's azimuth and elevation.

    A shadow may be no longer than a few of its errors, which come from the ground's heights, so
    its angles do not grow evenly with them. Six ways beside it stand for all: they have the way's
    covariance, and the fourth moments of a normal distribution, at the root of 3 standard errors.
    """
    variance, axes = np.linalg.eigh(covariance)
    aside = np.sqrt(3.0 * np.maximum(variance, 0.0)) * axes
    beside = _angles(way + np.concatenate([aside.T, -aside.T]))
    off_deg = wrapped_deg(np.degrees(beside - _angles(way)))
    return np.asarray(off_deg.T @ off_deg / len(off_deg))


def times_at(pointing: Pointing, sky: Sky, body: Body, day: date, lon: float) -> list[ClockTime]:
    """Return when a body stands in a direction, likeliest time first.

    The day is the 24 hours around noon of the mean sun at ``lon``. Raises `InputError` if the body
    stays below the horizon that day, or passes too far aside.
    """
    times = minutes_of(day, lon)
    seen = [sky.look(body, at) for at in times]
    is_up = np.array([one.elevation_deg >= _LEAST_ELEVATION_DEG for one in seen])
    if not is_up.any():
        raise InputError(f"the {body} stays below the horizon on {day}; give another date")
    off_deg = pointing.off_deg(*seen)
    cost = np.einsum("ti,ij,tj->t", off_deg, pointing.information, off_deg)
    cost[~is_up] = np.inf
    around = np.concatenate([[np.inf], cost, [np.inf]])
    is_least = is_up & (cost <= around[:-2]) & (cost < around[2:])
    found = [_refined(pointing, sky, body, times[index]) for index in np.flatnonzero(is_least)]
    near = sorted(
        (one for one in found if one.off_sds <= _FARTHEST_SDS), key=lambda one: one.off_sds
    )
    if not near:
        best = int(np.argmin(cost))
        aside_deg = float(np.hypot(*off_deg[best]))
        raise InputError(
            f"the {body} does not stand there on {day}: it is nearest at {times[best]:%H:%M} UTC, "
            f"{aside_deg:.1f} degrees away, {cost[best] ** 0.5:.0f} standard errors; check the "
            "date, the pixels and the pose"
        )
    return near


def heading_at(pose: Pose, pointing: Pointing, sky: Sky, body: Body, at: datetime) -> SunHeading:
    """Return a pose's heading, given a body's direction and the time.

    Raises `InputError` if the body is below the horizon, or stood far above or below the direction,
    whatever the heading.
    """
    seen = sky.look(body, at)
    if seen.elevation_deg < _LEAST_ELEVATION_DEG:
        raise InputError(
            f"the {body} is {-seen.elevation_deg:.1f} degrees below the horizon at "
            f"{at:%Y-%m-%d %H:%M} UTC; give the time when it is seen, with its zone, as in "
            "2026-12-21T16:04+01:00"
        )
    aside_deg, above_deg = pointing.off_deg(seen)[0].tolist()
    known = np.isfinite(pointing.elevation_deg)
    above_sds = abs(above_deg) / math.sqrt(pointing.covariance[1, 1])
    if known and above_sds > _FARTHEST_SDS:
        raise InputError(
            f"the {body} stood at {seen.elevation_deg:.1f} degrees at {at:%Y-%m-%d %H:%M} UTC, and "
            f"the photo has it at {pointing.elevation_deg:.1f}, {above_sds:.0f} standard errors "
            "off, whatever the heading; check the time and its zone, the pixel and the pitch"
        )
    return SunHeading(
        heading_deg=(pose.heading_deg + aside_deg) % 360.0,
        sd_deg=pointing.from_axis_sd_deg,
        off_sds=abs(aside_deg) / pointing.azimuth_sd_deg,
        above_deg=above_deg if known else np.nan,
    )


def _refined(pointing: Pointing, sky: Sky, body: Body, at: datetime) -> ClockTime:
    """Return when, near a minute, a body is nearest a direction."""
    weight = pointing.information
    minute = timedelta(seconds=_MINUTE_S)
    for _ in range(_NEWTON_STEPS):
        before, middle, after = pointing.off_deg(
            *(sky.look(body, at + part * minute) for part in (-0.5, 0.0, 0.5))
        )
        moved = wrapped_deg(after - before)
        speed = float(moved @ weight @ moved)
        shift = float(np.clip(-(moved @ weight @ middle) / speed, -2.0, 2.0)) * minute
        if sky.look(body, at + shift).elevation_deg < _LEAST_ELEVATION_DEG:
            break  # It rises or sets there.
        at += shift
    seen = sky.look(body, at)
    off_deg = pointing.off_deg(seen)[0]
    return ClockTime(
        time=at,
        sd_s=_MINUTE_S / speed**0.5,
        off_sds=float(off_deg @ weight @ off_deg) ** 0.5,
        azimuth_deg=seen.azimuth_deg,
        elevation_deg=seen.elevation_deg,
    )


def _named(pixel: Pixel) -> str:
    return f"{pixel[0]:g},{pixel[1]:g}"
