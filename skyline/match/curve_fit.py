r"""The pose that takes a query's rays best to a profile, fitted without rendering.

A stored place tells what its neighbourhood sees to first order: with distance D, tangent y and
slope y' at azimuth a, and the ground rising by g, an eye moved by t (east, north) sees

.. math::

    y(a; t) \approx y(a) + \frac{y' t_\perp + y t_\parallel - g \cdot t}{D}, \quad
    t_\parallel = t_e \sin a + t_n \cos a, \quad t_\perp = t_e \cos a - t_n \sin a

so heading, pitch, roll, field of view and a small move are fitted together: damped Gauss-Newton
with Cauchy weights whose scale shrinks round by round. What the first order leaves out grows
with (t / D)^2, so near terrain is trusted less.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array
from skyline.match.query_rays import REFERENCE_FOV_DEG, QueryRays, level_axes
from skyline.store.places import Places
from skyline.terrain.edge import DataEdge

_HEADING, _PITCH, _ROLL, _ZOOM, _EAST, _NORTH = range(6)
"""Columns of a pose: heading from grid north, pitch and roll, radians; zoom: `QueryRays.log_scale`
of the field of view; metres east and north of the stored place."""
_DAMPING = np.float32(1e-3)
_LONGEST_STEP = np.array([*np.radians([3.0, 4.0, 3.0]), 0.04, 1.25, 1.25], dtype=np.float32)
"""Of a round; moves in deviations of the place."""
_MIN_FORWARD = np.float32(0.05)
"""Rays nearer to a quarter turn from straight ahead are taken to lie there."""


@dataclass(frozen=True, slots=True)
class FitConfig:
    """How poses are fitted to profiles."""

    rays: int = 100
    """Means over runs of the query's columns that are fitted."""
    rounds_deg: tuple[float, ...] = (0.5, 0.35, 0.25, 0.2, 0.2)
    """Scale of the Cauchy weights, beside the expected error, round by round."""
    query_error_deg: float = 0.06
    """Expected error of such a mean, at a field of view of 60 degrees."""
    curvature: float = 0.05
    """A query that deviates by t from its place, past terrain at distance D, leaves an error of
    ``curvature * (t / D)**2`` in the tangent."""
    pitch_deg: float = 5.0
    roll_deg: float = 4.0
    """``pitch_deg``, ``roll_deg``: standard deviations of the camera's attitude."""
    outlier: float = 4.0
    """A ray misses by at most so many expected errors."""
    beyond: float = 2.0
    """So does a ray as far above the profile as terrain past the data's edge may rise."""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """How rays (M, R) of M poses miss their profiles, and what changes that."""

    miss: Float32Array
    change: Float32Array
    """(M, 6, R): derivative of the miss by each parameter of the pose."""
    nearness: Float32Array
    known: NDArray[np.bool_]
    azimuth: Float32Array
    """From grid north, radians."""
    tangent: Float32Array
    """Of the rays' elevation."""


@dataclass(frozen=True, slots=True, eq=False)
class CurveFit:
    """Fits poses of one query to M places, one pose each."""

    places: Places
    """M of them. Queries are taken evenly within a place's tolerance, so their deviation from it is
    the tolerance over the root of 3; no fit moves farther than twice that."""
    ground_slope: Float32Array
    """(M, 2) float32. Rise of the ground to the east and to the north."""
    rays: QueryRays
    """R means of runs of the query's rays; see `in_runs`."""
    config: FitConfig
    edge: DataEdge | None = None
    """Where the terrain's data end; without it nothing is taken to lie beyond."""

    @property
    def _deviation_m(self) -> Float32Array:
        """Of the query's easting, and of its northing, from each place's (M,)."""
        return self.places.tolerance_m / np.float32(np.sqrt(3.0))

    @property
    def _weight(self) -> Float32Array:
        return self.rays.weight.astype(np.float32)

    def fit(self, heading: Float64Array, zoom: Float64Array) -> tuple[Float32Array, Float32Array]:
        """Return poses (M, 6) fitted from headings, radians, and zooms (M,), and their scores (M,).

        A score is the mean over rays of the negative log of their likelihood but for a constant.
        """
        pose = np.zeros((len(heading), 6), dtype=np.float32)
        pose[:, _HEADING], pose[:, _ZOOM] = heading, zoom
        y, nearness = self.places.elevation_tan(), 1.0 / self.places.distance_m()
        nearness = np.where(np.isfinite(nearness), nearness, np.float32(0.0))
        seen = self._seen(pose, y, nearness)
        pose[:, _PITCH] = -np.median(seen.miss, axis=1)
        prior = self._prior()
        for scale_deg in self.config.rounds_deg:
            seen = self._seen(pose, y, nearness)
            variance = self._variance(pose, seen.nearness)
            weight = self._weight * seen.known
            weight = weight / (variance + np.square(seen.miss) + np.radians(scale_deg) ** 2)
            pose = self._bounded(pose, _step(pose, seen, weight.astype(np.float32), prior))
        return pose, self._score(pose, self._seen(pose, y, nearness), prior)

    def _seen(self, pose: Float32Array, y: Float32Array, nearness: Float32Array) -> _Seen:
        azimuth, tangent = self._project(pose)
        bins = y.shape[1]
        toward = azimuth + pose[:, :1]
        position = toward * np.float32(bins / (2.0 * np.pi)) - np.float32(0.5)
        left = np.floor(position)
        share = position - left
        row = (np.arange(len(y)) * bins)[:, np.newaxis]
        begin = row + left.astype(np.intp) % bins
        end = row + (left.astype(np.intp) + 1) % bins
        here = y.ravel()[begin]
        rise = y.ravel()[end] - here
        known = np.isfinite(rise)
        rise = np.where(known, rise, np.float32(0.0))
        here = np.where(known, here, np.float32(0.0)) + share * rise
        slope = rise * np.float32(bins / (2.0 * np.pi))
        coarse = nearness.shape[1]
        run = np.floor((position + np.float32(0.5)) * np.float32(coarse / bins)).astype(np.intp)
        near = nearness.ravel()[(np.arange(len(y)) * coarse)[:, np.newaxis] + run % coarse]
        sine, cosine = np.sin(toward), np.cos(toward)
        ground = self.ground_slope[:, :, np.newaxis]
        east = (slope * cosine + here * sine - ground[:, 0]) * near
        north = (here * cosine - slope * sine - ground[:, 1]) * near
        miss = tangent - here - east * pose[:, _EAST, np.newaxis]
        miss -= north * pose[:, _NORTH, np.newaxis]
        own_sine, own_cosine = np.sin(azimuth), np.cos(azimuth)
        if self.rays.is_panorama:
            pitch, zoom = np.ones_like(tangent), tangent - slope * azimuth
        else:
            pitch = own_cosine
            zoom = tangent * np.square(own_cosine) - slope * own_sine * own_cosine
        change = np.stack([-slope, pitch, -own_sine, zoom, -east, -north], axis=1)
        miss = np.where(known, miss, np.float32(0.0))
        return _Seen(miss, change, near, known, toward, tangent)

    def _project(self, pose: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Return azimuth from straight ahead and tangent of the rays (M, R); as `query.level`."""
        pitch, roll, zoom = (pose[:, k, np.newaxis] for k in (_PITCH, _ROLL, _ZOOM))
        scale = np.exp(zoom)
        u, v = (ray.astype(np.float32) * scale for ray in (self.rays.u, self.rays.v))
        is_panorama = self.rays.is_panorama
        right, up, forward = level_axes(u, v, pitch, roll, is_panorama=is_panorama)
        if is_panorama:
            return np.arctan2(right, forward), up / np.hypot(right, forward)
        forward = np.maximum(forward, _MIN_FORWARD)
        return np.arctan(right / forward), up / np.hypot(right, forward)

    def _variance(self, pose: Float32Array, nearness: Float32Array) -> Float32Array:
        """Return the expected squared error (M, R) of the tangents."""
        query = np.radians(self.config.query_error_deg) * self._scale(pose)
        move = self.config.curvature * np.square(self._deviation_m[:, np.newaxis] * nearness)
        return np.asarray(np.square(query)[:, np.newaxis] + np.square(move), dtype=np.float32)

    def _scale(self, pose: Float32Array) -> Float32Array:
        """Return the size (M,) of a pixel against one of a 60 degree field of view.

        What a camera measures are pixels: without this a small enough field of view would make
        every miss small.
        """
        half_rad = np.radians([self.rays.fov_deg, REFERENCE_FOV_DEG]) / 2.0
        size = 1.0 if self.rays.is_panorama else float(np.divide(*np.tan(half_rad)))
        return np.asarray(np.exp(pose[:, _ZOOM]) * size, dtype=np.float32)

    def _prior(self) -> Float32Array:
        """Return the inverse variances (M, 6) of the parameters."""
        prior = np.zeros((len(self.places), 6), dtype=np.float32)
        prior[:, _PITCH] = np.radians(self.config.pitch_deg) ** -2.0
        prior[:, _ROLL] = np.radians(self.config.roll_deg) ** -2.0
        prior[:, _ZOOM] = self.rays.log_scale_sd**-2.0
        prior[:, _EAST:] = self._deviation_m[:, np.newaxis] ** -2.0
        return prior

    def _bounded(self, pose: Float32Array, step: Float32Array) -> Float32Array:
        deviation_m = self._deviation_m[:, np.newaxis]
        limit = np.tile(_LONGEST_STEP, (len(pose), 1))
        limit[:, _EAST:] *= deviation_m
        pose = pose - np.clip(step, -limit, limit)
        pose[:, _ZOOM] = np.clip(pose[:, _ZOOM], *self.rays.log_scale_bounds)
        farthest = 2.0 * deviation_m
        pose[:, _EAST:] = np.clip(pose[:, _EAST:], -farthest, farthest)
        return pose

    def _score(self, pose: Float32Array, seen: _Seen, prior: Float32Array) -> Float32Array:
        variance = self._variance(pose, seen.nearness)
        outlier = np.float32(self.config.outlier)
        miss = np.abs(seen.miss) / np.sqrt(variance)
        most = np.where(self._may_hide(seen), np.float32(self.config.beyond), outlier)
        cost = np.where(seen.known, np.minimum(miss, most), outlier)
        cost += 0.5 * np.log(variance / np.square(self._scale(pose))[:, np.newaxis])
        unlikely = 0.5 * (np.square(pose) * prior).sum(axis=1) / self.config.rays
        mean = (cost * self._weight).mean(axis=1)
        return np.asarray(mean + unlikely, dtype=np.float32)

    def _may_hide(self, seen: _Seen) -> NDArray[np.bool_]:
        """Return which rays (M, R) terrain past the data's edge may stand in."""
        if self.edge is None:
            return np.zeros(seen.miss.shape, dtype=np.bool_)
        places = self.places
        eyes = np.stack([places.easting_m, places.northing_m, places.eye_elevation_m])
        east_m, north_m, eye_m = eyes.astype(np.float32)[..., np.newaxis]
        most = self.edge.elevation_tan(east_m, north_m, eye_m, seen.azimuth)
        return np.asarray((seen.miss > 0.0) & (seen.tangent < most))


def _step(
    pose: Float32Array, seen: _Seen, weight: Float32Array, prior: Float32Array
) -> Float32Array:
    """Return the Gauss-Newton step (M, 6) to be taken off."""
    weighted = seen.change * weight[:, np.newaxis]
    normal = weighted @ seen.change.transpose(0, 2, 1)
    gradient = (weighted @ seen.miss[:, :, np.newaxis])[:, :, 0] + prior * pose
    diagonal = np.einsum("mkk->mk", normal)
    diagonal += prior
    diagonal += _DAMPING * (diagonal + 1.0)
    return np.asarray(np.linalg.solve(normal, gradient[:, :, np.newaxis])[:, :, 0])
