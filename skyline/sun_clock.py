"""The time of a photo by its sun or by a shadow, or its heading by the time.

A pixel of the sun's or the moon's disc gives a direction. A shadow's tip and foot give an azimuth:
whatever stands upright casts its shadow away from the sun, however tall it is and whatever the
ground's slope. The top of what casts the shadow gives the elevation, too. The errors of the pose,
of the pixels and of the ground give the direction's error, and the sun's path of the day turns it
into a time's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, timedelta

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.geodesy.bounds import in_turn
from skyline.geodesy.earth import Curvature
from skyline.photo.skyline import PhotoSkyline
from skyline.pose import Pose
from skyline.sun import Body, InSky, Sky, minutes_of
from skyline.terrain.heightfield import HeightField
from skyline.terrain.ray_casting import first_hits_m
from skyline.terrain.viewpoints import at_elevation

Pixel = tuple[float, float]
"""Column and row; pixel centres are at whole numbers."""

_DRAWS = 200
"""Poses drawn for a standard error, which is then good to 5 %."""
_SEED = 0
_SLOPE_SD = 0.03
"""Standard deviation of the error of the ground's slope, as a tangent. In Copernicus's 30 m model
90 % of the differences between heights are good to 2 m on gentle slopes (product handbook): 1.2 m
rms over some 40 m."""
_FARTHEST_SDS = 4.0
"""A body that passes a direction farther aside, in standard errors, does not stand there."""
_LEAST_ELEVATION_DEG = -0.3
"""The middle of a disc whose edge is on a flat horizon."""
_WIDEST_SD_DEG = 30.0
"""A direction that is less well known says nothing of the time."""
_LEAST_SD_DEG = 0.01
"""The ephemeris and the frame are not better."""
_PENUMBRA_SD_DEG = 0.15
"""A shadow fades over the width of the sun's disc, 0.5 degrees; its end is seen within that."""
_NEWTON_STEPS = 4
_MINUTE_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PointingErrors:
    """Standard errors of a pose's angles, and of pixels that a person marks.

    Attributes
    ----------
    heading_sd_deg, pitch_sd_deg, roll_sd_deg, fov_sd_deg : float
        By default about twice what `skyline orient` has for a photo with a long skyline.
    pixel_sd_px : float
        Of a column and of a row.
    """

    heading_sd_deg: float = 0.3
    pitch_sd_deg: float = 0.06
    roll_sd_deg: float = 0.1
    fov_sd_deg: float = 0.7
    pixel_sd_px: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Pointing:
    """The direction in which a body stands, as a photo shows it.

    Attributes
    ----------
    azimuth_deg : float
        From true north.
    elevation_deg : float
        NaN where it is not known: of a shadow without a top.
    information : (2, 2) float64
        Inverse of the covariance of azimuth and elevation, in degrees.
    """

    azimuth_deg: float
    elevation_deg: float
    information: Float64Array

    @property
    def azimuth_sd_deg(self) -> float:
        """Standard error of the azimuth."""
        if self.information[1, 1] == 0.0:
            return float(self.information[0, 0] ** -0.5)
        return float(np.sqrt(np.linalg.inv(self.information)[0, 0]))

    def off_deg(self, seen: InSky) -> Float64Array:
        """Return how far azimuth and elevation (2,) of a body are off."""
        aside_deg = float(in_turn(seen.azimuth_deg - self.azimuth_deg))
        above_deg = seen.elevation_deg - self.elevation_deg
        return np.array([aside_deg, 0.0 if np.isnan(above_deg) else above_deg])


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
    """The heading of a camera by the sun or the moon at a known time.

    Attributes
    ----------
    heading_deg : float
        From true north.
    sd_deg : float
        Standard error, degrees.
    above_deg : float
        By how much the body stands higher than its pixel; NaN for a shadow.
    """

    heading_deg: float
    sd_deg: float
    above_deg: float


def body_pointing(
    pose: Pose, photo: PhotoSkyline, pixel: Pixel, errors: PointingErrors
) -> Pointing:
    """Return the direction of a pixel of a body's disc.

    Raises `InputError` for a pixel outside the photo.
    """
    _check_inside(photo, pixel)
    azimuth_deg, tangent = _directions([pose], photo, np.array([pixel]))
    poses, pixels = _drawn(pose, photo, np.array([pixel]), errors)
    drawn_deg, drawn_tan = _directions(poses, photo, pixels)
    off = np.stack([in_turn(drawn_deg - azimuth_deg), np.degrees(np.arctan(drawn_tan))])[..., 0]
    return Pointing(
        float(azimuth_deg[0, 0] + pose.convergence_deg) % 360.0,
        float(np.degrees(np.arctan(tangent[0, 0]))),
        np.linalg.inv(np.cov(off)),
    )


def shadow_pointing(
    terrain: HeightField,
    curvature: Curvature,
    pose: Pose,
    photo: PhotoSkyline,
    shadow: Sequence[Pixel],
    errors: PointingErrors,
) -> Pointing:
    """Return the direction of the sun by the shadow of something upright.

    Parameters
    ----------
    shadow : sequence of (float, float)
        Two or three pixels: the end of the shadow; the foot of what casts it, where it stands on
        the ground; and its top. Without a top the elevation is not known. Of a mountain's shadow,
        foot and top are the summit.

    Raises
    ------
    InputError
        A pixel is outside the photo, one of the first two shows sky, or the shadow's direction
        cannot be told.
    """
    has_top = len(shadow) > 2
    tip, foot = shadow[:2]
    marked = np.array([tip, foot, shadow[2] if has_top else foot])
    for pixel in marked.tolist():
        _check_inside(photo, pixel)
    known = _shadow(terrain, curvature, pose, photo, [pose], marked, 0.0)[0]
    if np.isnan(known).any():
        raise InputError(
            f"one of the pixels {_named(tip)} and {_named(foot)} shows sky at this pose; give "
            "pixels of the ground, the tip of the shadow first and then the foot of what casts it"
        )
    poses, pixels = _drawn(pose, photo, marked, errors)
    drawn = _shadow(terrain, curvature, pose, photo, poses, pixels, _SLOPE_SD)
    off_deg = in_turn(drawn - known)
    off_deg = off_deg[np.isfinite(off_deg).all(axis=1)]
    # Half of the middle 68 %: a ray that just misses a ridge lands far away.
    low_deg, high_deg = np.percentile(off_deg, [16.0, 84.0], axis=0) if len(off_deg) else (-90, 90)
    sd_deg = np.maximum(0.5 * (high_deg - low_deg), _LEAST_SD_DEG)
    if len(off_deg) < _DRAWS // 2 or sd_deg[0] > _WIDEST_SD_DEG:
        length_px = float(np.hypot(*(marked[0] - marked[1])))
        raise InputError(
            f"the shadow is {length_px:.0f} pixels long, and too flat to the view for its "
            "direction to be known; give a longer shadow, or one that is seen from higher up"
        )
    azimuth_deg, elevation_deg = known.tolist()
    azimuth_deg = (azimuth_deg + pose.convergence_deg) % 360.0
    if not has_top:
        return Pointing(azimuth_deg, np.nan, np.diag([sd_deg[0] ** -2, 0.0]))
    near = (np.abs(off_deg) < _FARTHEST_SDS * sd_deg).all(axis=1)
    covariance = np.cov(off_deg[near].T) + np.diag([_LEAST_SD_DEG**2, _PENUMBRA_SD_DEG**2])
    return Pointing(azimuth_deg, elevation_deg, np.linalg.inv(covariance))


def times_at(pointing: Pointing, sky: Sky, body: Body, day: date, lon: float) -> list[ClockTime]:
    """Return the times of a day at which a body stands in a direction, the likeliest first.

    The day is the 24 hours around noon of the mean sun at ``lon``. Raises `InputError` if the body
    stays below the horizon that day, or passes too far aside.
    """
    times = minutes_of(day, lon)
    seen = [sky.look(body, at) for at in times]
    is_up = np.array([one.elevation_deg >= _LEAST_ELEVATION_DEG for one in seen])
    if not is_up.any():
        raise InputError(f"the {body} stays below the horizon on {day}; give another date")
    off_deg = np.array([pointing.off_deg(one) for one in seen])
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
    """Return the heading of a pose if a body stood in a direction at a time.

    ``pointing`` has no error of the heading. Raises `InputError` if the body is below the horizon.
    """
    seen = sky.look(body, at)
    if seen.elevation_deg < _LEAST_ELEVATION_DEG:
        raise InputError(
            f"the {body} is {-seen.elevation_deg:.1f} degrees below the horizon at "
            f"{at:%Y-%m-%d %H:%M} UTC; give the time when it is seen, with its zone, as in "
            "2026-12-21T16:04+01:00"
        )
    aside_deg, above_deg = pointing.off_deg(seen)
    known = np.isfinite(pointing.elevation_deg)
    return SunHeading(
        heading_deg=(pose.heading_deg + float(aside_deg)) % 360.0,
        sd_deg=pointing.azimuth_sd_deg,
        above_deg=float(above_deg) if known else np.nan,
    )


def _refined(pointing: Pointing, sky: Sky, body: Body, at: datetime) -> ClockTime:
    """Return the time near a minute at which a body is nearest to a direction."""
    weight = pointing.information
    minute = timedelta(seconds=_MINUTE_S)
    for _ in range(_NEWTON_STEPS):
        before, middle, after = (
            pointing.off_deg(sky.look(body, at + part * minute)) for part in (-0.5, 0.0, 0.5)
        )
        moved = in_turn(after - before)
        speed = float(moved @ weight @ moved)
        shift = float(np.clip(-(moved @ weight @ middle) / speed, -2.0, 2.0)) * minute
        if sky.look(body, at + shift).elevation_deg < _LEAST_ELEVATION_DEG:
            break  # It rises or sets there.
        at += shift
    seen = sky.look(body, at)
    off_deg = pointing.off_deg(seen)
    return ClockTime(
        time=at,
        sd_s=_MINUTE_S / speed**0.5,
        off_sds=float(off_deg @ weight @ off_deg) ** 0.5,
        azimuth_deg=seen.azimuth_deg,
        elevation_deg=seen.elevation_deg,
    )


def _check_inside(photo: PhotoSkyline, pixel: Pixel) -> None:
    """Raise `InputError` for a pixel outside a photo."""
    column, row = pixel
    if not (-0.5 <= column <= photo.width_px - 0.5 and -0.5 <= row <= photo.height_px - 0.5):
        raise InputError(
            f"pixel {_named(pixel)} is outside the photo of {photo.width_px} x {photo.height_px} "
            "pixels; expected COLUMN,ROW from the upper left corner"
        )


def _named(pixel: Pixel) -> str:
    return f"{pixel[0]:g},{pixel[1]:g}"


def _drawn(
    pose: Pose, photo: PhotoSkyline, marked: Float64Array, errors: PointingErrors
) -> tuple[list[Pose], Float64Array]:
    """Return poses and pixels (D, P, 2) with drawn errors."""
    draw = np.random.default_rng(_SEED)
    most_deg = photo.projection.most_fov_deg
    poses = [
        replace(
            pose,
            heading_deg=pose.heading_deg + errors.heading_sd_deg * off[0],
            pitch_deg=pose.pitch_deg + errors.pitch_sd_deg * off[1],
            roll_deg=pose.roll_deg + errors.roll_sd_deg * off[2],
            fov_deg=min(max(pose.fov_deg + errors.fov_sd_deg * off[3], 1.0), most_deg),
        )
        for off in draw.standard_normal((_DRAWS, 4))
    ]
    return poses, marked + errors.pixel_sd_px * draw.standard_normal((_DRAWS, *marked.shape))


def _directions(
    poses: Sequence[Pose], photo: PhotoSkyline, pixels: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return grid azimuths and elevation tangents (D, P) of pixels (P, 2) or (D, P, 2)."""
    pixels = np.broadcast_to(pixels, (len(poses), *pixels.shape[-2:]))
    found = [one.camera(photo).directions(*at.T) for one, at in zip(poses, pixels, strict=True)]
    azimuth_deg, tangent = np.stack(found, axis=1)
    return azimuth_deg, tangent


def _shadow(
    terrain: HeightField,
    curvature: Curvature,
    pose: Pose,
    photo: PhotoSkyline,
    poses: Sequence[Pose],
    pixels: Float64Array,
    slope_sd: float,
) -> Float64Array:
    """Return grid azimuth and elevation (D, 2) from shadows' tips to the tops that cast them.

    The cameras have the place of ``pose``. Pixels (P, 2) or (D, P, 2) are tip, foot and top. The
    foot's ground has an error in its height, of ``slope_sd`` of the distance from the tip. NaN for
    sky.
    """
    azimuth_deg, tangent = _directions(poses, photo, pixels)
    grid_rad = np.radians(azimuth_deg[:, :2])
    eye = at_elevation(terrain, pose.easting_m, pose.northing_m, pose.eye_elevation_m)
    # The profiles' azimuths are as near to each other as half a column.
    step_rad = np.radians(photo.projection.column_deg(photo.width_px, pose.fov_deg).min()) / 2.0
    away_m = first_hits_m(
        terrain, eye, curvature, grid_rad.ravel(), tangent[:, :2].ravel(), step_rad, None
    ).reshape(grid_rad.shape)
    toward = np.exp(1j * (np.pi / 2.0 - grid_rad))
    apart_m = np.abs(away_m[:, 1] * toward[:, 1] - away_m[:, 0] * toward[:, 0])
    if slope_sd:
        draw = np.random.default_rng(_SEED + 1)
        higher_m = slope_sd * apart_m * draw.standard_normal(len(poses))
        place_m = pose.easting_m + 1j * pose.northing_m + away_m[:, 1] * toward[:, 1]
        step_m = toward[:, 1] * terrain.spacing_m / 2.0
        rise_m = [
            terrain.height_at(easting_m=at.real, northing_m=at.imag)
            for at in (place_m - step_m, place_m + step_m)
        ]
        # A ray sinks faster than the ground that it meets.
        sinks = np.minimum(tangent[:, 1] - (rise_m[1] - rise_m[0]) / terrain.spacing_m, -1e-3)
        away_m[:, 1] += higher_m / sinks
    tip, foot = (away_m * toward).T
    tip_m = tangent[:, 0] * away_m[:, 0] + curvature.drop_m(away_m[:, 0])
    top_m = tangent[:, 2] * away_m[:, 1] + curvature.drop_m(away_m[:, 1])
    aim = foot - tip
    elevation_deg = np.degrees(np.arctan2(top_m - tip_m, np.abs(aim)))
    return np.column_stack([90.0 - np.degrees(np.angle(aim)), elevation_deg])
