"""The topographic prominence of all summits of a grid of heights."""

import numpy as np

from skyline.arrays import Float64Array, Int64Array


def prominences(heights_m: Float64Array) -> tuple[Int64Array, Int64Array, Float64Array]:
    """Return row, column and prominence (S,) of all local maxima, the most prominent first.

    Each sample belongs to the maximum to which the steepest way up leads. Where the samples of two
    maxima touch there is a pass between them, and over the highest passes first the lower of two
    maxima, of all that are joined already, has the prominence that its height above the pass is.
    A maximum from which no way leads to a higher one is as prominent as it is high above the lowest
    sample. Holes (NaN) are no way.
    """
    known = np.nan_to_num(np.asarray(heights_m, np.float64), nan=-np.inf)
    rows, cols = known.shape
    ranked = np.empty(known.size, np.int64)
    ranked[np.argsort(known, axis=None, kind="stable")] = np.arange(known.size)
    rank = ranked.reshape(rows, cols)
    place = np.arange(known.size).reshape(rows, cols)
    best, up = rank.copy(), place.copy()
    for here, there in [
        pair for step in ((0, 1), (1, 0), (1, 1), (1, -1)) for pair in _both_ways(step)
    ]:
        higher = rank[there] > best[here]
        best[here] = np.where(higher, rank[there], best[here])
        up[here] = np.where(higher, place[there], up[here])
    top = up.ravel()
    while (top != (further := top[top])).any():
        top = further
    tops, number = np.unique(top, return_inverse=True)
    number = number.reshape(rows, cols)
    passes, joined = [], []
    for step in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here, there = _both_ways(step)[0]
        apart = number[here] != number[there]
        passes.append(np.minimum(known[here], known[there])[apart])
        joined.append(np.stack([number[here][apart], number[there][apart]], axis=1))
    pass_m, pairs = np.concatenate(passes), np.concatenate(joined)
    order = np.argsort(-pass_m, kind="stable")
    order = order[np.isfinite(pass_m[order])]
    top_m, top_rank = known.ravel()[tops], ranked[tops]
    prominence_m = top_m - np.nanmin(heights_m)
    of = np.arange(len(tops)).tolist()

    def root(one: int) -> int:
        while of[one] != one:
            of[one] = one = of[of[one]]
        return one

    for (one, other), height_m in zip(pairs[order].tolist(), pass_m[order].tolist(), strict=True):
        low, high = sorted((root(one), root(other)), key=top_rank.__getitem__)
        if low != high:
            of[low] = high
            prominence_m[low] = top_m[low] - height_m
    first = np.argsort(-prominence_m, kind="stable")
    # Of equally high samples side by side, all but one have none.
    first = first[np.isfinite(prominence_m[first]) & (prominence_m[first] > 0.0)]
    row, col = np.divmod(tops[first], cols)
    return row, col, prominence_m[first]


_Slices = tuple[slice, slice]


def _both_ways(step: tuple[int, int]) -> list[tuple[_Slices, _Slices]]:
    """Return the samples that have a neighbour a step on, and these neighbours; and the reverse."""
    down, right = step
    here = slice(None, -down or None), slice(max(-right, 0), -right if right > 0 else None)
    there = slice(down, None), slice(max(right, 0), right if right < 0 else None)
    return [(here, there), (there, here)]
