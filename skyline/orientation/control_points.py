"""A pose from control points: pixels of a photo with known places.

No skyline is needed. The pose is fitted by damped Gauss-Newton to the pixels of the points, from
what is known of the place and the lens, or from a pose that is refined. The unknowns are those of
`Pose.covariance`. A point is wrong if leaving it out lowers the cost by more than the
cost of a point that lies anywhere in the photo.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from skyline.angles import wrapped_deg
from skyline.arrays import BoolArray, Float64Array
from skyline.camera.camera import Camera
from skyline.camera.projection import MIN_FOV_DEG
from skyline.camera.warps import MOST_DISTORTION
from skyline.errors import InputError, OffMapError, printable
from skyline.ground.ground_view import GroundErrors
from skyline.match.rays import Rays
from skyline.orientation.point_files import ControlPoints
from skyline.orientation.result import RIGHT_DEG
from skyline.photo.photo import Photo
from skyline.photo.skyline import PhotoSkyline, form_of
from skyline.pose.pose import Pose
from skyline.pose.pose_errors import (
    ANGLES,
    ASSUMED,
    EAST,
    HEADING,
    LOG_SCALE,
    NORTH,
    PITCH,
    ROLL,
    UP,
    WARP,
    Bearings,
)
from skyline.terrain.heightfield import ground_of, ground_slope
from skyline.view.viewer import Viewer

LEAST_POINTS = 3
"""A place and a direction follow from three points, if the lens is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointErrors(GroundErrors):
    """Errors of control points, and of the ground that some lie on."""

    place_sd_m: float = 5.0
    """Standard deviation of a point's easting, northing and elevation from a map or a phone."""
    wrong_share: float = 0.05
    """Share of points that are expected to be wrong."""


_OFF_GROUND_M = (-200.0, 1000.0)
"""Least and greatest height of a point above the DEM's ground: beside cliffs models err by 200 m,
and no building is higher than a kilometre."""


@dataclass(frozen=True, slots=True)
class _Steps:
    """How a fit proceeds, and which points and poses it trusts."""

    first: int = 4
    """Steps from each start."""
    followed: int = 2
    """Number of the best starts that are fitted further."""
    most: int = 30
    """Most steps of these fits."""
    damping: float = 1e-3
    """Damping of the first step, as a share of the matrix's diagonal; it grows tenfold after a step
    that raises the cost, and falls to a fifth after any other."""
    enough: float = 1e-9
    """A fit ends when its cost falls by no more than this share."""
    most_misfit: float = 3.0
    """A pose whose points miss by more is not trusted; at most a percent of right ones do."""
    most_heading_sd_deg: float = RIGHT_DEG
    """A heading that is known less well is not trusted."""
    spare: int = 1
    """A point can be called wrong only among more than this many beyond `LEAST_POINTS`."""


_STEPS = _Steps()
_MOST_PITCH_RAD = 1.5
"""Greatest pitch. Straight up or down, heading and roll are one turn, which no fit can divide."""


@dataclass(frozen=True, slots=True, eq=False)
class PointsFit:
    """A pose fitted to control points."""

    photo: Photo | PhotoSkyline
    pose: Pose
    points: ControlPoints
    residual_px: Float64Array
    """(N, 2) float64. Where each point appears, less where it was marked: to the right, down."""
    is_used: BoolArray
    """(N,) bool. False for points that are taken for wrong."""
    misfit: float
    """Root mean square of the misses of used points, in their standard deviations."""
    refusal: str | None = None
    """Why the pose cannot be trusted; None if it can."""
    name: str = ""

    @property
    def sds_deg(self) -> dict[str, float]:
        """Standard errors of heading, pitch, roll and field of view, degrees."""
        assert self.pose.covariance is not None
        sd = np.sqrt(np.diagonal(np.array(self.pose.covariance)))
        half = self.photo.projection.half_width(self.pose.fov_deg)
        fov_deg = self.photo.projection.fov_deg(half * np.exp([-sd[LOG_SCALE], sd[LOG_SCALE]]))
        sds_deg = *np.degrees(sd[HEADING:LOG_SCALE]).tolist(), float(np.ptp(fov_deg)) / 2.0
        return dict(zip(ANGLES, sds_deg, strict=True))

    @property
    def wrong(self) -> tuple[str, ...]:
        """Names of points that are taken for wrong."""
        return tuple(np.array(self.points.names)[~self.is_used].tolist())

    def to_dict(self) -> dict[str, Any]:
        """Return the fit as ``skyline orient --points --json`` prints it."""
        record: dict[str, Any] = {"photo": printable(self.name), "trusted": int(not self.refusal)}
        record |= form_of(self.photo) | self.pose.to_dict()
        record |= {f"{name}_sd_deg": sd for name, sd in self.sds_deg.items()}
        points = [
            {"name": name, "across_px": across, "down_px": down, "used": used}
            for name, (across, down), used in zip(
                self.points.names,
                np.round(self.residual_px, 3).tolist(),
                self.is_used.tolist(),
                strict=True,
            )
        ]
        return record | {"misfit": self.misfit, "points": points, "refusal": self.refusal}

    def to_text(self) -> str:
        """Return the lines that ``skyline orient --points`` prints."""
        pose = self.pose
        lines = [printable(self.name) or "photo"]
        if self.refusal:
            lines.append(f"not trusted: {self.refusal}")
        lines.append(pose.angles_in_words(self.sds_deg))
        lines.append(f"lat {pose.lat:.6f} lon {pose.lon:.6f}, {pose.eye_elevation_m:.1f} m high")
        for name, (across, down), used in zip(
            self.points.names, self.residual_px.tolist(), self.is_used, strict=True
        ):
            wrong = "" if used else "  wrong: left out; check its pixel and its place"
            lines.append(f"point {name}: {across:+.1f} px across, {down:+.1f} px down{wrong}")
        return "\n  ".join(lines)


@dataclass(frozen=True, slots=True, eq=False)
class KnownCamera:
    """What is known of a camera before its control points are seen."""

    pose: Pose
    precision: Float64Array
    """(P, P) float64. Inverse covariance about the pose, in the columns of `Pose.covariance`."""
    eye_height_m: float | None = None
    """Usual height above the ground; None where the eye's elevation is part of ``precision``."""
    has_heading: bool = False

    @classmethod
    def at(
        cls,
        viewer: Viewer,
        photo: Photo | PhotoSkyline,
        *,
        lon: float,
        lat: float,
        position_sd_m: float,
        elevation_m: float | None = None,
        heading_deg: tuple[float, float] | None = None,
    ) -> "KnownCamera":
        """Return a camera at a place.

        ``heading_deg`` has an approximate heading from true north, and its greatest error.

        Raises `OffMapError` for a place off the map, and `InputError` for a panorama or a fisheye
        of unknown field of view.
        """
        rays = _rays_of(photo)
        about_deg, slack_deg = heading_deg or (0.0, math.inf)
        pose = viewer.pose(lon=lon, lat=lat, heading_deg=about_deg, fov_deg=rays.fov_deg)
        sds = np.concatenate([np.full(WARP, np.inf), rays.warp_sd])
        sds[[EAST, NORTH]] = position_sd_m
        # An even distribution up to the greatest error has this deviation.
        sds[HEADING] = math.radians(slack_deg) / math.sqrt(3.0)
        sds[PITCH] = math.radians(ASSUMED.level_pitch_sd_deg)
        sds[ROLL] = math.radians(ASSUMED.level_roll_sd_deg)
        # A field of view that is known exactly has no range.
        sds[LOG_SCALE] = rays.lens.rms if rays.fov_range_deg else 1e-6
        if elevation_m is not None:
            sds[UP] = PointErrors().place_sd_m
            return cls(replace(pose, eye_elevation_m=elevation_m), np.diag(sds**-2.0))
        ground_m = viewer.terrain.height_at(easting_m=pose.easting_m, northing_m=pose.northing_m)
        return cls(pose, np.diag(sds**-2.0), pose.eye_elevation_m - float(ground_m))

    @classmethod
    def of_pose(cls, pose: Pose) -> "KnownCamera":
        """Return a camera in a pose with a covariance."""
        return cls(pose, np.linalg.inv(np.array(pose.covariance)), has_heading=True)


def _rays_of(photo: Photo | PhotoSkyline) -> Rays:
    """Return rays along a photo's middle, with what is known of its lens."""
    middle = PhotoSkyline(
        np.full(photo.width_px, photo.height_px / 2.0),
        np.ones(photo.width_px),
        photo.width_px,
        photo.height_px,
        photo.fov_deg,
        projection=photo.projection,
        lens=photo.lens,
    )
    return Rays.of(middle, ASSUMED.fov_sd_share, finds_fov=True)


def fit_points(
    viewer: Viewer,
    photo: Photo | PhotoSkyline,
    points: ControlPoints,
    known: KnownCamera,
    errors: PointErrors | None = None,
    name: str = "",
) -> PointsFit:
    """Fit a camera's pose to control points.

    Raises `InputError` for too few points, and `OffMapError` for a point on the ground that is off
    the map or on a hole.
    """
    if len(points) < LEAST_POINTS:
        raise InputError(
            f"{points.path}: points given: {len(points)}; expected {LEAST_POINTS} or more, and 5 "
            "or more for a wrong one to be named"
        )
    fit = _Fit(viewer, photo, points, known, errors or PointErrors())
    used = np.ones(len(points), dtype=bool)
    cost, state = fit.best(used)
    while used.sum() > LEAST_POINTS + _STEPS.spare:
        tries = []
        for index in np.flatnonzero(used):
            without = used.copy()
            without[index] = False
            tries.append((*fit.best(without), without))
        least_cost, its_state, without = min(tries, key=lambda one: one[0])
        if least_cost + fit.wrong_cost >= cost:
            break
        cost, state, used = least_cost, its_state, without
    return fit.result(state, used, name)


@dataclass(eq=False)
class _Fit:
    """Fits of one camera to one set of points."""

    viewer: Viewer
    photo: Photo | PhotoSkyline
    points: ControlPoints
    known: KnownCamera
    errors: PointErrors
    place_m: Float64Array = field(init=False)
    """(N, 3) float64. Easting, northing and elevation of the points."""
    place_sd_m: Float64Array = field(init=False)
    """(N, 2) float64. Standard deviations, level and upwards."""

    def __post_init__(self) -> None:
        terrain, points = self.viewer.terrain, self.points
        self.height_sd_m = self.errors.height_sd_on(terrain)
        east_m, north_m = terrain.frame.from_lonlat(points.lon, points.lat)
        ground_m = terrain.height_at(easting_m=east_m, northing_m=north_m)
        on_ground = np.isnan(points.elevation_m)
        off = np.flatnonzero(on_ground & np.isnan(ground_m))
        if len(off):
            raise OffMapError(
                f"{points.path}: point {points.names[off[0]]} is off the DEM or on a hole; give "
                "its elevation_m, or a DEM that holds it"
            )
        self._check_elevations(ground_m)
        up_m = np.where(on_ground, ground_m, points.elevation_m)
        self.place_m = np.stack([east_m, north_m, up_m], axis=1)
        level = np.full(len(points), self.errors.place_sd_m)
        self.place_sd_m = np.stack(
            [level, np.where(on_ground, self.height_sd_m, self.errors.place_sd_m)], axis=1
        )
        pose = self.known.pose
        warp = pose.camera(self.photo).warp
        self.first = np.array(
            [pose.easting_m, pose.northing_m, pose.eye_elevation_m,
             *np.radians([pose.grid_heading_deg, pose.pitch_deg, pose.roll_deg]), 0.0, *warp]
        )[: len(self.known.precision)]  # fmt: skip

    def _check_elevations(self, ground_m: Float64Array) -> None:
        """Raise `InputError` for a point far from the ground.

        A point whose elevation is in feet is far from it.
        """
        points = self.points
        above_m = points.elevation_m - ground_m
        lowest_m, highest_m = _OFF_GROUND_M
        off = np.flatnonzero((above_m < lowest_m) | (above_m > highest_m))
        if len(off):
            first = off[0]
            raise InputError(
                f"{points.path}: point {points.names[first]} has the elevation "
                f"{points.elevation_m[first]:g} m, and the ground of the DEM lies at "
                f"{ground_m[first]:.0f} m there; expected metres above its datum: correct it, "
                "or leave it out"
            )

    @property
    def wrong_cost(self) -> float:
        """Cost of a point that lies anywhere in the photo.

        It is minus twice the log of its density over the peak density of a right point, weighted by
        their shares.
        """
        pixels = self.photo.width_px * self.photo.height_px
        right = 2.0 * math.pi * self.errors.pixel_sd_px**2
        odds = self.errors.wrong_share / (1.0 - self.errors.wrong_share)
        return 2.0 * (math.log(pixels / right) - math.log(odds))

    def camera(self, state: Float64Array) -> Camera:
        """Return the camera of a state."""
        base = self.known.pose.camera(self.photo)
        half = base.projection.half_width(base.fov_deg) * math.exp(state[LOG_SCALE])
        warp = state[WARP:]
        changes: dict[str, Any] = {}
        if base.projection.is_panorama and len(warp):
            # The rows of an image wander with its scale.
            changes["wander"] = tuple((warp * math.exp(state[LOG_SCALE])).tolist())
        elif len(warp):
            changes["distortion"] = float(warp[0])
        heading_deg, pitch_deg, roll_deg = np.degrees(state[HEADING:LOG_SCALE]).tolist()
        return replace(
            base,
            fov_deg=float(base.projection.fov_deg(half)),
            grid_heading_deg=heading_deg % 360.0,
            pitch_deg=pitch_deg,
            roll_deg=roll_deg,
            **changes,
        )

    def toward(self, state: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return azimuths, tangents and distances of the points from a state's eye."""
        return self.viewer.curvature.seen(*(self.place_m - state[: UP + 1]).T)

    def linear(self, state: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return misses in pixels, their derivatives and their covariances.

        They are (N, 2), (N, 2, P) and (N, 2, 2). A miss is the marked pixel less the pixel that
        shows the point, to first order: the opposite of `PointsFit.residual_px`.
        """
        column, row = self.points.column_px, self.points.row_px
        seen = Bearings.of(self.camera(state), column, row, len(state))
        azimuth, tan, _ = toward = self.toward(state)
        turn_deg = wrapped_deg(seen.grid_azimuth_deg - np.degrees(azimuth))
        off = np.stack([np.radians(turn_deg), seen.elevation_tan - tan], axis=1)
        by_place = self.viewer.curvature.seen_changes(*toward)
        # The point's own direction changes as the eye moves the other way.
        changes = seen.by_pose.copy()
        changes[:, :, : UP + 1] += by_place
        to_px = np.linalg.inv(seen.by_pixel)
        level_m2, up_m2 = (self.place_sd_m**2).T
        place = np.concatenate(
            [by_place[..., :2] * level_m2[:, None, None], by_place[..., 2:] * up_m2[:, None, None]],
            axis=2,
        )
        spread = to_px @ (place @ by_place.swapaxes(1, 2)) @ to_px.swapaxes(1, 2)
        spread += self.errors.pixel_sd_px**2 * np.eye(2)
        return (to_px @ off[..., np.newaxis])[..., 0], to_px @ changes, spread

    def normal_equations(
        self, state: Float64Array, used: BoolArray
    ) -> tuple[float, Float64Array, Float64Array]:
        """Return the cost of a state, its gradient and the normal matrix."""
        miss_px, changes, spread = (one[used] for one in self.linear(state))
        weight = np.linalg.inv(spread)
        off = self._off(state)
        normal = np.einsum("nip,nij,njq->pq", changes, weight, changes) + self.known.precision
        gradient = np.einsum("nip,nij,nj->p", changes, weight, miss_px)
        gradient += self.known.precision @ off
        cost = np.einsum("ni,nij,nj->", miss_px, weight, miss_px) + off @ self.known.precision @ off
        if self.known.eye_height_m is not None:
            over_m, by_move = self._over_ground(state)
            precision = self.height_sd_m**-2.0 if self.height_sd_m else 1e6
            normal += precision * by_move[:, np.newaxis] * by_move
            gradient += precision * over_m * by_move
            cost += precision * over_m**2
        return float(cost), gradient, normal

    def _off(self, state: Float64Array) -> Float64Array:
        """Return how far a state is off the known camera."""
        off: Float64Array = state - self.first
        off[HEADING] = math.remainder(off[HEADING], 2.0 * math.pi)
        return off

    def _over_ground(self, state: Float64Array) -> tuple[float, Float64Array]:
        """Return an eye's height above the usual one, and derivatives (P,)."""
        terrain = self.viewer.terrain
        at = state[EAST : EAST + 1], state[NORTH : NORTH + 1]
        ground_m = float(terrain.height_at(easting_m=at[0], northing_m=at[1])[0])
        if math.isnan(ground_m):
            return 0.0, np.zeros(len(state))
        by_move = np.zeros(len(state))
        by_move[:UP] = -ground_slope(ground_of(terrain), *at)[0]
        by_move[UP] = 1.0
        return float(state[UP] - ground_m - (self.known.eye_height_m or 0.0)), by_move

    def best(self, used: BoolArray) -> tuple[float, Float64Array]:
        """Return the least cost, and its state."""
        tries = [self.fitted(start, used, _STEPS.first) for start in self._starts(used)]
        tries.sort(key=lambda one: one[0])
        rest = (self.fitted(state, used, _STEPS.most) for _, state in tries[: _STEPS.followed])
        return min(rest, key=lambda one: one[0])

    def _starts(self, used: BoolArray) -> Iterator[Float64Array]:
        """Yield starts of a fit, each with one point in its pixel."""
        if self.known.has_heading:
            yield self.first
            return
        level = self.first.copy()
        level[HEADING] = 0.0
        ray_deg, ray_tan = self.camera(level).directions(self.points.column_px, self.points.row_px)
        azimuth, tan, _ = self.toward(level)
        for index in np.flatnonzero(used):
            start = level.copy()
            start[HEADING] = azimuth[index] - math.radians(ray_deg[index])
            start[PITCH] = math.atan(tan[index]) - math.atan(ray_tan[index])
            yield start

    def fitted(
        self, state: Float64Array, used: BoolArray, steps: int
    ) -> tuple[float, Float64Array]:
        """Return the least cost from a start, and its state."""
        cost, gradient, normal = self.normal_equations(state, used)
        damping = _STEPS.damping
        for _ in range(steps):
            scale = np.diag(np.maximum(np.diagonal(normal), 1e-12))
            step = np.linalg.solve(normal + damping * scale, gradient)
            new = self._bounded(state - step)
            found = self.normal_equations(new, used)
            if not found[0] < cost:
                damping *= 10.0
                if damping > 1e6:
                    break
                continue
            is_enough = cost - found[0] <= _STEPS.enough * cost
            state, (cost, gradient, normal) = new, found
            damping = max(0.2 * damping, 1e-9)
            if is_enough:
                break
        return cost, state

    def _bounded(self, state: Float64Array) -> Float64Array:
        """Return a state within what a camera can do."""
        projection = self.photo.projection
        first_half = projection.half_width(self.known.pose.fov_deg)
        widest = projection.half_width(projection.most_fov_deg)
        bounded = state.copy()
        bounded[PITCH] = np.clip(state[PITCH], -_MOST_PITCH_RAD, _MOST_PITCH_RAD)
        bounded[LOG_SCALE] = np.clip(
            state[LOG_SCALE],
            math.log(projection.half_width(MIN_FOV_DEG) / first_half),
            math.log(widest / first_half),
        )
        if not projection.is_panorama:
            bounded[WARP:] = np.clip(state[WARP:], -MOST_DISTORTION, MOST_DISTORTION)
        return bounded

    def result(self, state: Float64Array, used: BoolArray, name: str) -> PointsFit:
        """Return a state as a fit."""
        miss_px, _, spread = self.linear(state)
        _, _, normal = self.normal_equations(state, used)
        chi2 = np.einsum("ni,nij,nj->n", miss_px, np.linalg.inv(spread), miss_px)[used]
        misfit = math.sqrt(float(chi2.mean()) / 2.0)
        covariance = np.linalg.inv(normal)
        camera = self.camera(state)
        frame = self.viewer.frame
        easting_m, northing_m, eye_m = state[: UP + 1].tolist()
        lon, lat = map(float, frame.to_lonlat(easting_m, northing_m))
        turn_deg = float(frame.convergence_deg(easting_m=easting_m, northing_m=northing_m))
        (east_m2, both_m2), (_, north_m2) = covariance[:UP, :UP].tolist()
        pose = Pose(
            lon=lon,
            lat=lat,
            heading_deg=(camera.grid_heading_deg + turn_deg) % 360.0,
            pitch_deg=camera.pitch_deg,
            roll_deg=camera.roll_deg,
            fov_deg=camera.fov_deg,
            easting_m=easting_m,
            northing_m=northing_m,
            eye_elevation_m=eye_m,
            convergence_deg=turn_deg,
            cost=math.nan,
            distortion=camera.distortion,
            wander=camera.wander,
            refined=True,
            covariance_m2=((east_m2, both_m2), (both_m2, north_m2)),
            covariance=tuple(map(tuple, covariance.tolist())),
        )
        azimuth, tan, _ = self.toward(state)
        marked_px = np.stack([self.points.column_px, self.points.row_px], axis=1)
        shown_px = np.stack(camera.pixels(np.degrees(azimuth), tan), axis=1)
        # Ground behind the camera is in no pixel.
        residual_px = np.where(np.isfinite(shown_px), shown_px - marked_px, -miss_px)
        found = PointsFit(self.photo, pose, self.points, residual_px, used, misfit, name=name)
        return replace(found, refusal=_refusal_of(found))


def _refusal_of(found: PointsFit) -> str | None:
    """Return why a fit cannot be trusted, or None."""
    if found.misfit > _STEPS.most_misfit:
        return (
            f"the points miss the pose by {found.misfit:.1f} of their standard errors (rms); check "
            "their pixels and places, the position and the field of view"
        )
    sd_deg = found.sds_deg["heading"]
    if sd_deg > _STEPS.most_heading_sd_deg:
        return (
            f"the heading is known only to {sd_deg:.1f} degrees; give more points, far apart in "
            "the photo"
        )
    return None
