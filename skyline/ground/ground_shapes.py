"""A photo's shapes on the ground, and the map's in it.

Between their vertices, lines follow the ground: lines of a photo are cut into pieces of a few
pixels, lines of the map into pieces as long as the spacing of the terrain model.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, Float64Array
from skyline.camera.pixels import in_picture
from skyline.errors import InputError
from skyline.files.shapes import POINT, POLYGON, Shape
from skyline.geodesy.map_frame import Frame
from skyline.ground.ground_view import GroundErrors, GroundPixels, GroundPoints, GroundView
from skyline.terrain.height_errors import height_correlation

_STEP_PX = 4.0
"""Longest piece of a photo's line."""
_MOST_PIECES = 5000
"""Most pieces of a ring of the map; a longer one is cut more coarsely."""
_CORRELATED = 1000
"""Most places with height errors of their own; among more, neighbours share one."""
_JUMP = 1.5
"""Ratio of the distances of two neighbouring points from which on no slope joins them. On level
ground, 4 pixels change the distance this much only within about a degree of the horizon."""


@dataclass(frozen=True, slots=True)
class Measure:
    """A length or an area on the ground, with its standard error."""

    value: float
    sd: float


@dataclass(frozen=True, slots=True)
class Jump:
    """Where a photo's line passes from near ground to ground behind it."""

    near_m: float
    """Horizontal distance from the camera to the near ground."""
    far_m: float
    """Horizontal distance from the camera to the ground behind it."""
    column_px: float
    row_px: float


@dataclass(frozen=True, slots=True, eq=False)
class GroundShape:
    """A photo's shape on the ground."""

    shape: Shape
    rings: tuple[GroundPoints, ...]
    """Points of each ring, which follow the ground; a polygon's are not closed."""
    is_vertex: tuple[BoolArray, ...]
    """Which points are drawn vertices."""
    length: Measure | None = None
    """Level length in metres of a line, or around a polygon. None for a point."""
    slope_length_m: float | None = None
    """Length in metres along the slope."""
    area: Measure | None = None
    """Level area in square metres; None for a point and a line."""
    jump: Jump | None = None
    """The widest jump, which counts in lengths and areas; None if the ground is continuous."""

    @property
    def vertices(self) -> GroundPoints:
        """The drawn vertices."""
        each = zip(self.rings, self.is_vertex, strict=True)
        return GroundPoints.concatenate([ring[drawn] for ring, drawn in each])


@dataclass(frozen=True, slots=True, eq=False)
class PhotoShape:
    """A shape of the map in a photo."""

    shape: Shape
    rings: tuple[GroundPixels, ...]
    """Points of each ring, which follow the ground; a polygon's are closed."""

    def parts(self, width_px: int, height_px: int) -> list[tuple[Float64Array, bool]]:
        """Return the parts (V, 2) within a picture, and which are hidden.

        A point is a part of one vertex.
        """
        found = list[tuple[Float64Array, bool]]()
        for ring in self.rings:
            place = np.stack([ring.column_px, ring.row_px], axis=1)
            inside = in_picture(ring.column_px, ring.row_px, width_px, height_px)
            # Each piece is hidden if one of its ends is.
            least = 1 if self.shape.kind == POINT else 2
            hidden = ring.is_hidden if least == 1 else ring.is_hidden[:-1] | ring.is_hidden[1:]
            shown = inside if least == 1 else inside[:-1] & inside[1:]
            kind = np.where(shown, hidden.astype(int), -1)
            edges = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
            for begin, end in itertools.pairwise(edges):
                if begin < end and kind[begin] >= 0:
                    found.append((place[begin : end + least - 1], bool(kind[begin])))
        return found


def on_ground(view: GroundView, shape: Shape, frame: Frame, errors: GroundErrors) -> GroundShape:
    """Return a photo's shape on the ground.

    Raises `InputError` if a vertex shows sky.
    """
    is_closed = shape.kind == POLYGON
    positions = [_positions(ring, _STEP_PX, is_closed) for ring in shape.rings]
    pixels = [_between(ring, at) for ring, at in zip(shape.rings, positions, strict=True)]
    column_px, row_px = np.concatenate(pixels).T
    points = view.points(column_px, row_px, errors)
    is_vertex = np.concatenate([at == np.rint(at) for at in positions])
    _refuse_sky(shape, points, is_vertex)
    bounds = np.cumsum([0, *map(len, positions)])
    rings, drawn, kept = [], [], []
    for (begin, end), at in zip(itertools.pairwise(bounds), positions, strict=True):
        is_ground = ~points.is_sky[begin:end]
        rings.append(points[begin:end][is_ground])
        drawn.append(is_vertex[begin:end][is_ground])
        kept.append(at[is_ground])
    found = GroundShape(shape, tuple(rings), tuple(drawn))
    if shape.kind == POINT:
        return found
    measured = _Measured(found, kept, view, errors, frame)
    return GroundShape(
        shape,
        found.rings,
        found.is_vertex,
        measured.length(),
        sum(_lengths_m(ring, is_closed, level=False)[0].sum() for ring in rings) / measured.scale,
        measured.area() if is_closed else None,
        _widest_jump(found, kept),
    )


def in_photo(view: GroundView, shape: Shape, frame: Frame) -> PhotoShape:
    """Return a shape of the map, in degrees, in a photo."""
    rings = []
    for ring in shape.rings:
        corners = np.stack(frame.from_lonlat(*ring.T), axis=1)
        if shape.kind == POLYGON:
            corners = np.concatenate([corners, corners[:1]])
        pieces_m = np.hypot(*np.diff(corners, axis=0).T)
        step_m = max(view.terrain.spacing_m, float(pieces_m.sum()) / _MOST_PIECES)
        place = _between(corners, _positions(corners, step_m, is_closed=False))
        rings.append(view.pixels(*place.T))
    return PhotoShape(shape, tuple(rings))


def _refuse_sky(shape: Shape, points: GroundPoints, is_vertex: BoolArray) -> None:
    sky = np.flatnonzero(points.is_sky[is_vertex])
    if len(sky):
        column, row = shape.vertices[sky[0]]
        more = f", and so do {len(sky) - 1} more vertices" if len(sky) > 1 else ""
        raise InputError(
            f"{shape.where}: column {column:g}, row {row:g} shows sky{more}; move it down onto the "
            "ground of the DEM, or give a DEM that reaches farther"
        )


def _positions(ring: Float64Array, step: float, is_closed: bool) -> Float64Array:
    """Return positions along a ring; whole numbers are vertices."""
    ends = np.concatenate([ring, ring[:1]]) if is_closed else ring
    length = np.hypot(*np.diff(ends, axis=0).T)
    pieces = np.maximum(np.ceil(length / step), 1.0).astype(int)
    between = [k + np.arange(count) / count for k, count in enumerate(pieces)]
    last = [] if is_closed else [np.array([len(ring) - 1.0])]
    return np.concatenate([*between, *last])


def _widest_jump(found: GroundShape, positions: Sequence[Float64Array]) -> Jump | None:
    """Return the jump with the greatest ratio of distances; None without one."""
    widest, most = None, _JUMP
    for ring, drawn, at in zip(found.rings, found.shape.rings, positions, strict=True):
        before_m, after_m = ring.distance_m, np.roll(ring.distance_m, -1)
        if found.shape.kind != POLYGON:
            before_m, after_m = before_m[:-1], after_m[:-1]
        near_m, far_m = np.minimum(before_m, after_m), np.maximum(before_m, after_m)
        if not len(near_m):
            continue
        k = int(np.argmax(far_m / near_m))
        if far_m[k] / near_m[k] > most:
            column_px, row_px = _between(drawn, at[k : k + 1])[0]
            widest = Jump(float(near_m[k]), float(far_m[k]), float(column_px), float(row_px))
            most = widest.far_m / widest.near_m
    return widest


def _between(ring: Float64Array, position: Float64Array) -> Float64Array:
    before = np.floor(position).astype(int)
    share = (position - before)[:, np.newaxis]
    return np.asarray(
        (1.0 - share) * ring[before % len(ring)] + share * ring[(before + 1) % len(ring)]
    )


def _lengths_m(
    ring: GroundPoints, is_closed: bool, level: bool = True
) -> tuple[Float64Array, Float64Array]:
    """Return lengths and vectors (N, 2 or 3) of a ring's pieces."""
    axes = [ring.easting_m, ring.northing_m] + [ring.elevation_m] * (not level)
    place = np.stack(axes, axis=1)
    pieces = np.diff(np.concatenate([place, place[:1]]) if is_closed else place, axis=0)
    return np.linalg.norm(pieces, axis=1), pieces


class _Measured:
    """Lengths and areas of a shape, with their errors.

    The pose's errors are common to all points, the model's are alike within some hundred metres,
    and each drawn vertex has its own, which the points beside it share.
    """

    def __init__(
        self,
        found: GroundShape,
        positions: Sequence[Float64Array],
        view: GroundView,
        errors: GroundErrors,
        frame: Frame,
    ) -> None:
        self._rings = found.rings
        self._is_closed = found.shape.kind == POLYGON
        self._positions = positions
        self._vertices = [len(ring) for ring in found.shape.rings]
        self._covariance = view.covariance
        self._height_sd_m = errors.height_sd_on(view.terrain)
        self._pixel_sd_px = errors.pixel_sd_px
        middle = (np.mean(found.rings[0].easting_m), np.mean(found.rings[0].northing_m))
        self.scale = float(frame.scale(easting_m=middle[0], northing_m=middle[1]))
        """Metres on the map for a metre of ground."""

    def length(self) -> Measure:
        """Return the level length."""
        changes = []
        total_m = 0.0
        for ring in self._rings:
            length_m, pieces = _lengths_m(ring, self._is_closed)
            total_m += float(length_m.sum())
            along = pieces / np.maximum(length_m, 1e-9)[:, np.newaxis]
            change = np.zeros((len(ring), 2))
            change[: len(along)] -= along
            after = (np.arange(len(along)) + 1) % len(ring)
            np.add.at(change, after, along)
            changes.append(change)
        return Measure(total_m / self.scale, self._sd(changes) / self.scale)

    def area(self) -> Measure:
        """Return the level area, less the holes."""
        changes = []
        total_m2 = 0.0
        for number, ring in enumerate(self._rings):
            east = ring.easting_m - ring.easting_m[0]
            north = ring.northing_m - ring.northing_m[0]
            change = 0.5 * np.stack(
                [np.roll(north, -1) - np.roll(north, 1), np.roll(east, 1) - np.roll(east, -1)],
                axis=1,
            )
            area_m2 = 0.5 * float(change[:, 0] @ east + change[:, 1] @ north)
            sign = math.copysign(1.0, area_m2) * (1.0 if number == 0 else -1.0)
            total_m2 += sign * area_m2
            changes.append(sign * change)
        return Measure(total_m2 / self.scale**2, self._sd(changes) / self.scale**2)

    def _sd(self, changes: Sequence[Float64Array]) -> float:
        """Return a figure's standard error from derivatives (N, 2) by rings' places."""
        by_pose = np.zeros(self._rings[0].by_pose.shape[2])
        variance = 0.0
        for ring, change, at, count in zip(
            self._rings, changes, self._positions, self._vertices, strict=True
        ):
            by_pose += np.einsum("nk,nkp->p", change, ring.by_pose[:, :2])
            by_point = np.einsum("nk,nkp->np", change, ring.by_pixel[:, :2])
            before = np.floor(at).astype(int)
            share = (at - before)[:, np.newaxis]
            by_vertex = np.zeros((count, 2))
            np.add.at(by_vertex, before % count, (1.0 - share) * by_point)
            np.add.at(by_vertex, (before + 1) % count, share * by_point)
            variance += self._pixel_sd_px**2 * float((by_vertex**2).sum())
        variance += float(by_pose @ self._covariance @ by_pose)
        points = GroundPoints.concatenate(list(self._rings))
        by_height = (np.concatenate(changes) * points.by_height[:, :2]).sum(axis=1)
        place = points.easting_m + 1j * points.northing_m
        run = -(-len(place) // _CORRELATED)
        begins = np.arange(0, len(place), run)
        by_height = np.add.reduceat(by_height, begins)
        apart_m = np.abs(place[begins][:, np.newaxis] - place[begins])
        variance += self._height_sd_m**2 * float(
            by_height @ height_correlation(apart_m) @ by_height
        )
        return math.sqrt(max(variance, 0.0))
