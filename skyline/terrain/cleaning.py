"""Voids and spikes: what a DEM's samples need before anything is rendered from them.

A skyline is a maximum, so one bad sample makes a phantom ridge. Both functions work in place and
strip by strip: a field of hundreds of millions of samples costs little more than itself.

Markers are used while a DEM is being read: NaN is a void, which may be filled, -inf a void that
the file does not declare, and +inf a sample that no file covers, which is neither a neighbour nor
ever filled. `skyline.terrain.fill` makes voids of the second.
"""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Int64Array

ABSURD_M = 30_000.0
"""No known solid body has a height beyond this above or below its datum (Mars: +21.2, -8.2 km)."""

STEEPEST = 2.5
"""Rise over run that no terrain has on every side of a few samples: 68 degrees all round."""

MAX_SPIKE_SAMPLES = 4
"""A spike is a clump of at most so many samples (2 x 2)."""

STANDS_OUT = 3.0
"""A spike is so many times farther off its surroundings than these are among themselves."""

_LEAST_SURROUNDINGS = 3
_STRIP_SAMPLES = 1 << 22
_AROUND = np.array([(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if (r, c) != (0, 0)])
_BESIDE = np.array([(-1, 0), (0, -1), (0, 1), (1, 0)])


def strips(heights_m: Float32Array) -> Iterator[slice]:
    """Yield slices of rows that together cover the grid, a few million samples each."""
    rows, cols = heights_m.shape
    step = max(_STRIP_SAMPLES // cols, 1)
    for top in range(0, rows, step):
        yield slice(top, min(top + step, rows))


def count_voids(heights_m: Float32Array) -> int:
    """Return the number of NaN samples."""
    return sum(int(np.count_nonzero(np.isnan(heights_m[rows]))) for rows in strips(heights_m))


def remove_spikes(heights_m: Float32Array, spacing_m: float, spike_m: float) -> int:
    """Turn spikes, upward and downward, into voids, in place; return how many samples those are.

    A sample is a spike if its height is absurd (beyond `ABSURD_M`), or if it is part of a clump of
    at most `MAX_SPIKE_SAMPLES` samples that

    - no gentle step joins to the rest: every step to a neighbour outside the clump is higher than
      ``max(spike_m, STEEPEST * spacing_m)``. A summit, the rim of a cliff of any height and the
      crest of an arete each have a neighbour that is nearer than that;
    - stands out: each of its samples is `STANDS_OUT` times farther from the median of its
      neighbours (other such clumps left aside) than their quartiles are apart, so that rugged
      ground keeps its ruggedness.

    Parameters
    ----------
    heights_m : (rows, cols) float32, C-contiguous
        NaN and +inf samples are no neighbours.
    spacing_m : float
        The coarser of the two sample spacings, metres on the ground.
    spike_m : float
        The least height of a spike; infinity leaves only the absurd.
    """
    absurd = _remove_absurd(heights_m)
    threshold = max(spike_m, STEEPEST * spacing_m)
    candidates = _beside_jumps(heights_m, threshold)
    if candidates.size == 0:
        return absurd
    spikes = candidates[_are_spikes(heights_m, candidates, threshold)]
    heights_m.reshape(-1)[spikes] = np.nan
    return absurd + spikes.size


def fill_voids(heights_m: Float32Array, max_void_samples: int) -> int:
    """Fill voids of at most so many connected samples from their rims, in place; return how many.

    The filling solves Laplace's equation with the rim as its boundary (the shape of a soap film):
    smooth, and never higher or lower than the rim, so that no skyline is invented. Samples are
    connected by their sides, not by corners. At the border of the data the film ends level.

    Parameters
    ----------
    heights_m : (rows, cols) float32, C-contiguous
        NaN marks voids, +inf samples that no file covers.
    max_void_samples : int
        Larger voids are left as they are.
    """
    voids = _small_voids(heights_m, max_void_samples)
    if voids.size == 0:
        return 0
    beside = _neighbours(voids, _BESIDE, heights_m.shape)
    rim_m = _heights(heights_m, beside)
    slot, is_void = _find(voids, beside)
    row, side = np.nonzero(is_void)
    count = voids.size
    degree = np.count_nonzero(is_void | np.isfinite(rim_m), axis=1).astype(np.float64)
    diagonal = np.arange(count)
    from scipy.sparse import csr_array  # noqa: PLC0415  (a fifth of a second, seldom needed)
    from scipy.sparse.linalg import spsolve  # noqa: PLC0415

    laplacian = csr_array(
        (
            np.concatenate([degree, np.full(row.size, -1.0)]),
            (np.concatenate([diagonal, row]), np.concatenate([diagonal, slot[row, side]])),
        ),
        shape=(count, count),
    )
    solution = spsolve(laplacian, np.nansum(rim_m, axis=1), permc_spec="MMD_AT_PLUS_A")
    heights_m.reshape(-1)[voids] = solution
    return int(count)


def _remove_absurd(heights_m: Float32Array) -> int:
    removed = 0
    for rows in strips(heights_m):
        strip = heights_m[rows]
        absurd = (np.abs(strip) > ABSURD_M) & ~np.isposinf(strip)
        strip[absurd] = np.nan
        removed += int(np.count_nonzero(absurd))
    return removed


def _beside_jumps(heights_m: Float32Array, threshold_m: float) -> Int64Array:
    """Return flat indices, ascending, of heights a jump away from one beside them."""
    found = []
    for rows in strips(heights_m):
        top = max(rows.start - 1, 0)
        block = heights_m[top : rows.stop + 1]
        beside = np.zeros(block.shape, dtype=np.bool_)
        with np.errstate(invalid="ignore"):
            jump = np.abs(np.diff(block, axis=0)) > threshold_m
            beside[1:] |= jump
            beside[:-1] |= jump
            jump = np.abs(np.diff(block, axis=1)) > threshold_m
            beside[:, 1:] |= jump
            beside[:, :-1] |= jump
        beside &= np.isfinite(block)
        inner = beside[rows.start - top : rows.stop - top]
        found.append(np.flatnonzero(inner) + rows.start * heights_m.shape[1])
    return np.concatenate(found)


def _are_spikes(heights_m: Float32Array, candidates: Int64Array, threshold_m: float) -> BoolArray:
    around = _neighbours(candidates, _AROUND, heights_m.shape)
    around_m = _heights(heights_m, around)
    own_m = heights_m.reshape(-1)[candidates].astype(np.float64)
    joined = np.abs(around_m - own_m[:, np.newaxis]) <= threshold_m
    slot, is_candidate = _find(candidates, around)
    row, side = np.nonzero(joined & is_candidate)
    clump = _connected(row, slot[row, side], candidates.size)
    # A clump every member of which is a candidate has no gentle step to firm ground.
    anchored = np.bincount(clump, weights=(joined & ~is_candidate).any(axis=1)) > 0.0
    suspect = ((np.bincount(clump) <= MAX_SPIKE_SAMPLES) & ~anchored)[clump]
    firm_m = np.where(is_candidate & suspect[slot], np.nan, around_m)[suspect]
    stands_out = np.zeros(candidates.size, dtype=np.bool_)
    stands_out[suspect] = _stand_out(own_m[suspect], firm_m)
    whole_clump_stands_out = np.bincount(clump, weights=~stands_out) == 0.0
    return np.asarray(whole_clump_stands_out[clump], dtype=np.bool_)


def _stand_out(own_m: NDArray[np.float64], firm_m: NDArray[np.float64]) -> BoolArray:
    ranked = np.sort(firm_m, axis=1)  # NaN last
    known = np.count_nonzero(np.isfinite(ranked), axis=1)
    last = np.maximum(known - 1, 0)

    def at(rank: Int64Array) -> NDArray[np.float64]:
        return np.take_along_axis(ranked, rank[:, np.newaxis], axis=1)[:, 0]

    median_m = 0.5 * (at(last // 2) + at((last + 1) // 2))
    quartiles_apart_m = at(last - last // 4) - at(last // 4)
    far_off = np.abs(own_m - median_m) > STANDS_OUT * quartiles_apart_m
    return np.asarray(far_off & (known >= _LEAST_SURROUNDINGS), dtype=np.bool_)


def _small_voids(heights_m: Float32Array, max_void_samples: int) -> Int64Array:
    """Return flat indices, ascending, of the samples of voids that can and may be filled."""
    row, start, stop = runs_of(heights_m, np.isnan)
    void = connected_runs(row, start, stop, heights_m.shape[1])
    size = np.bincount(void, weights=stop - start)
    small = size[void] <= max_void_samples
    first = row[small] * heights_m.shape[1] + start[small]
    samples, run = _expand(first, (stop - start)[small])
    void = void[small][run]
    rim = np.isfinite(_heights(heights_m, _neighbours(samples, _BESIDE, heights_m.shape)))
    has_rim = np.bincount(void, weights=rim.any(axis=1), minlength=size.size) > 0.0
    return np.asarray(samples[has_rim[void]], dtype=np.int64)


def runs_of(
    heights_m: Float32Array, chosen: Callable[[Float32Array], BoolArray]
) -> tuple[Int64Array, Int64Array, Int64Array]:
    """Return row, first column and column past the last of each run of chosen samples in a row.

    Runs, unlike an image of labels, take memory only where there are such samples.
    """
    parts = []
    for rows in strips(heights_m):
        some = chosen(heights_m[rows])
        if not some.any():
            some = some[:0]
        edge = np.diff(some.astype(np.int8), axis=1, prepend=0, append=0)
        row, start = np.nonzero(edge == 1)
        stop = np.nonzero(edge == -1)[1]
        parts.append((row + rows.start, start, stop))
    row, start, stop = (np.concatenate(part) for part in zip(*parts, strict=True))
    return row, start, stop


def connected_runs(row: Int64Array, start: Int64Array, stop: Int64Array, cols: int) -> Int64Array:
    """Return the number of the place, connected by sides, that each run belongs to."""
    # Runs ascend by row and column, so those of the row above that touch one are consecutive.
    width = cols + 2
    above = (row - 1) * width
    first = np.searchsorted(row * width + stop, above + start, side="right")
    past = np.searchsorted(row * width + start, above + stop, side="left")
    upper, lower = _expand(first, np.maximum(past - first, 0))
    return _connected(lower, upper, row.size)


def _expand(first: Int64Array, length: Int64Array) -> tuple[Int64Array, Int64Array]:
    """Return the members of ranges of whole numbers, and the range each one is of."""
    of_range = np.repeat(np.arange(first.size), length)
    begins = np.cumsum(length) - length
    return first[of_range] + np.arange(of_range.size) - begins[of_range], of_range


def _connected(one: Int64Array, other: Int64Array, count: int) -> Int64Array:
    """Return the number of the part of a graph that each of its nodes belongs to."""
    if not count:
        return np.zeros(0, dtype=np.int64)
    from scipy.sparse import coo_array  # noqa: PLC0415  (a fifth of a second, seldom needed)
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    graph = coo_array((np.ones(one.size, dtype=np.int8), (one, other)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _neighbours(samples: Int64Array, steps: Int64Array, shape: tuple[int, ...]) -> Int64Array:
    """Return (n, steps) flat indices of neighbours, -1 off the grid."""
    row = samples[:, np.newaxis] // shape[1] + steps[:, 0]
    col = samples[:, np.newaxis] % shape[1] + steps[:, 1]
    inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    return np.asarray(np.where(inside, row * shape[1] + col, -1), dtype=np.int64)


def _heights(heights_m: Float32Array, samples: Int64Array) -> NDArray[np.float64]:
    """Return heights in float64, NaN for voids, for what no file covers and off the grid."""
    heights = heights_m.reshape(-1)[samples].astype(np.float64)
    return np.where((samples >= 0) & np.isfinite(heights), heights, np.nan)


def _find(samples: Int64Array, wanted: Int64Array) -> tuple[Int64Array, BoolArray]:
    """Return where each wanted index stands among ascending samples, and whether it does."""
    slot = np.minimum(np.searchsorted(samples, wanted), samples.size - 1)
    return slot, samples[slot] == wanted
