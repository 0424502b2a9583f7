"""Outlines on the map as rings of degrees, cut at the antimeridian."""

import numpy as np

from skyline.arrays import Float64Array
from skyline.geodesy.map_frame import Frame


def lonlat_rings(outline_m: Float64Array, frame: Frame) -> list[Float64Array]:
    """Return an outline in degrees as rings cut at the antimeridian.

    RFC 7946 (3.1.9) requires the cut; without it, a map draws the shape around the world. The
    outline (P, 2) is closed, without a pole inside. The rings (Q, 2) are closed and have the
    outline's orientation; longitudes are from -180 to 180.
    """
    lon, lat = frame.to_lonlat(*outline_m.T)
    lon = np.unwrap(lon, period=360.0)
    lon[-1] = lon[0]  # to the bit
    # A corner on the antimeridian, up to rounding, is moved to one side of it.
    rounding_deg = 1e-9
    on_edge = np.abs((lon % 360.0) - 180.0) < rounding_deg
    ring = np.stack([lon + 2.0 * rounding_deg * on_edge, lat], axis=1)
    rings = _cut_at(ring, float(np.copysign(180.0, lon[0])))
    for ring in rings:
        middle = 0.5 * (ring[:, 0].min() + ring[:, 0].max())
        ring[:, 0] -= 360.0 * round(middle / 360.0)
    return rings


def _cut_at(ring: Float64Array, edge: float) -> list[Float64Array]:
    """Return the parts of a ring on both sides of a longitude."""
    count = len(ring) - 1
    is_east = ring[:-1, 0] > edge
    crossed = np.flatnonzero(is_east != np.roll(is_east, -1))
    if not len(crossed):
        return [ring]
    start = ring[crossed]
    step = ring[crossed + 1] - start
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
    goes_on[order[::2]] = order[1::2]
    goes_on[order[1::2]] = order[::2]
    parts = []
    left = set(range(len(chains)))
    while left:
        chain = first = min(left)
        joined = []
        while chain in left:
            left.remove(chain)
            joined.append(chains[chain])
            chain = int(goes_on[after[chain]])
        parts.append(np.concatenate([*joined, chains[first][:1]]))
    # A part narrower than 2 cm is dropped.
    return [part for part in parts if np.ptp(part[:, 0]) > 2e-7]
