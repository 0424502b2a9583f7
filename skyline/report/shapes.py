"""Shapes of a candidate on the map: the wedge of its view and its ellipse of uncertainty."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array
from skyline.geodesy import Frame
from skyline.match.candidate import Candidate

_CHI_SQUARE_95 = 5.991464547107979
"""95 % quantile of chi square with two degrees of freedom: -2 ln 0.05."""
_ARC_STEP_DEG = 2.0
_ELLIPSE_POINTS = 72
_ON_EDGE_DEG, _SLIVER_DEG = 1e-9, 2e-7
"""A corner this near to the antimeridian lies on it; a part narrower than 2 cm is dropped."""


@dataclass(frozen=True, slots=True, eq=False)
class Ellipse:
    """The ellipse that contains the true position with 95 % probability if errors are normal."""

    semi_major_m: float
    semi_minor_m: float
    outline_m: Float64Array
    """(P, 2) float64. Easting and northing, counter-clockwise and closed, from one end of the major
    axis on."""

    @classmethod
    def of(cls, candidate: Candidate) -> "Ellipse | None":
        """Return a candidate's ellipse, None if its covariance is unknown."""
        if candidate.covariance_m2 is None:
            return None
        variance, axes = np.linalg.eigh(np.array(candidate.covariance_m2))
        minor_m, major_m = np.sqrt(_CHI_SQUARE_95 * np.maximum(variance, 0.0)).tolist()
        azimuth = np.arctan2(axes[0, 1], axes[1, 1]) % np.pi
        sine, cosine = np.sin(azimuth), np.cos(azimuth)
        turn = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE_POINTS + 1)
        along, across = major_m * np.cos(turn), minor_m * np.sin(turn)
        east, north = along * sine - across * cosine, along * cosine + across * sine
        outline = np.stack([candidate.easting_m + east, candidate.northing_m + north], axis=1)
        outline[-1] = outline[0]
        return cls(major_m, minor_m, outline)


def view_wedge_m(candidate: Candidate, reach_m: float) -> Float64Array:
    """Return a candidate's field of view on the map, out to ``reach_m``.

    The outline (P, 2), easting and northing, is counter-clockwise and closed. It begins at the
    camera, unless the view is a full turn.
    """
    steps = max(2, int(np.ceil(candidate.fov_deg / _ARC_STEP_DEG)) + 1)
    half = candidate.fov_deg / 2.0
    # Azimuths fall along the arc, since they count clockwise.
    azimuth = np.radians(candidate.grid_heading_deg + np.linspace(half, -half, steps))
    camera = np.array([[candidate.easting_m, candidate.northing_m]])
    arc = camera + reach_m * np.stack([np.sin(azimuth), np.cos(azimuth)], axis=1)
    if candidate.fov_deg >= 360.0:
        return np.concatenate([arc[:-1], arc[:1]])
    return np.concatenate([camera, arc, camera])


def lonlat_rings(outline_m: Float64Array, frame: Frame) -> list[Float64Array]:
    """Return an outline as rings of longitude and latitude, cut at the antimeridian.

    RFC 7946 (3.1.9) requires the cut; without it a map draws the shape around the world. The
    outline (P, 2) is closed, without a pole inside. The rings (Q, 2) are closed and oriented alike;
    longitudes are from -180 to 180.
    """
    lon, lat = frame.to_lonlat(*outline_m.T)
    lon = np.unwrap(lon, period=360.0)
    lon[-1] = lon[0]  # to the bit
    # A corner on the antimeridian, up to rounding, is moved to one side of it.
    on_edge = np.abs((lon % 360.0) - 180.0) < _ON_EDGE_DEG
    ring = np.stack([lon + 2.0 * _ON_EDGE_DEG * on_edge, lat], axis=1)
    rings = _cut(ring, float(np.copysign(180.0, lon[0])))
    for ring in rings:
        middle = 0.5 * (ring[:, 0].min() + ring[:, 0].max())
        ring[:, 0] -= 360.0 * round(middle / 360.0)
    return rings


def _cut(ring: Float64Array, edge: float) -> list[Float64Array]:
    """Return the parts of a ring on either side of a longitude; the ring if it lies on one."""
    count = len(ring) - 1
    is_east = ring[:-1, 0] > edge
    crossed = np.flatnonzero(is_east != np.roll(is_east, -1))
    if not len(crossed):
        return [ring]
    start, step = ring[crossed], ring[crossed + 1] - ring[crossed]
    on_edge = start + step * ((edge - start[:, :1]) / step[:, :1])
    on_edge[:, 0] = edge
    # Crossings split the ring into chains. From south to north, the edge lies inside between each
    # pair of crossings, so a chain continues along it to the chain that begins at the other one.
    after = np.roll(np.arange(len(crossed)), -1)
    chains = []
    for at, to in enumerate(after):
        inner = np.arange(crossed[at] + 1, crossed[to] + 1 + (count if to <= at else 0)) % count
        chains.append(np.concatenate([on_edge[[at]], ring[inner], on_edge[[to]]]))
    order = np.argsort(on_edge[:, 1])
    goes_on = np.empty_like(order)
    goes_on[order[::2]], goes_on[order[1::2]] = order[1::2], order[::2]
    parts, left = [], set(range(len(chains)))
    while left:
        chain = first = min(left)
        joined = []
        while chain in left:
            left.remove(chain)
            joined.append(chains[chain])
            chain = int(goes_on[after[chain]])
        parts.append(np.concatenate([*joined, chains[first][:1]]))
    return [part for part in parts if np.ptp(part[:, 0]) > _SLIVER_DEG]
