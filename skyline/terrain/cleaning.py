"""Voids, fill and spikes: repair of a DEM's samples before anything is rendered from them.

A skyline is a maximum, so one bad sample makes a phantom ridge. All functions work in place on
heights (rows, cols), float32 and C-contiguous, and strip by strip, so that a field of hundreds of
millions of samples costs little more than itself. ``spacing_m`` is the coarser of the two sample
spacings, metres on the ground.

While a DEM is being read, NaN marks a void, which may be filled, -inf a void that the file does not
declare, and +inf a sample that no file covers, which is never a neighbour and never filled.

Fill is an undeclared constant in place of heights that were never measured, such as the zeros round
a footprint that was turned. It would be a plain over which an eye sees far. It differs from water
by its rim: terrain does not rise by `STEEPEST` along half of a shore.
"""

import logging
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.errors import InputError
from skyline.geodesy import GROUND_M

ABSURD_M = 30_000.0
"""No known solid body has a height beyond this above or below its datum (Mars: +21.2, -8.2 km)."""

STEEPEST = 2.5
"""Rise over run that no terrain has on every side of a few samples: 68 degrees all round."""

LEAST_SPIKE_M = 100.0
"""The least height of a spike, and of a wall around fill, however fine the DEM."""

MAX_SPIKE_SAMPLES = 4
"""The largest spike: a clump of 2 x 2 samples."""

STANDS_OUT = 3.0
"""Least distance of a spike from the median of its neighbours, in distances between their
quartiles."""

MAX_VOID_SAMPLES = 100
"""The largest void that is filled. Voids of the Everest tile, cut into the High Sierra at 90 m and
filled again, were off by 14 m rms up to 10 samples, 31 m at 50 to 100, 51 m at 200 to 500 and 295 m
above 10,000."""

MIN_FILL_SAMPLES = 100
"""The smallest fill."""

WALLED = 0.5
"""The least share of the rim of fill that is walls."""

_MIN_RIM = 20
"""Least length of the rim of fill, and least number of walls of a value that is examined, in
samples."""
_REACH = 3
"""Greatest distance of a wall from the rim, in samples: a cubic resampling spreads a wall over
them."""

_LEAST_SURROUNDINGS = 3
_STRIP_SAMPLES = 1 << 22
_AROUND = np.array([(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if (r, c) != (0, 0)])
_BESIDE = np.array([(-1, 0), (0, -1), (0, 1), (1, 0)])

_log = logging.getLogger(__name__)


def strips(grid: Any) -> Iterator[slice]:
    """Yield slices of rows, a few million samples each, that cover an array or open dataset."""
    rows, cols = grid.shape
    step = max(_STRIP_SAMPLES // cols, 1)
    for top in range(0, rows, step):
        yield slice(top, min(top + step, rows))


def clean(heights_m: Float32Array, source: str, spacing_m: float) -> tuple[int, int, int, int]:
    """Turn fill into voids, remove spikes, and close small voids; afterwards NaN marks every hole.

    ``source`` is the name of the DEM in errors and warnings. Returns the numbers of filled, hollow,
    despiked and undeclared samples, as `skyline.Provenance` has them. Raises `InputError` where
    there is no height at all.
    """
    undeclared, values_m = void_undeclared(heights_m, spacing_m)
    if values_m:
        _log.warning(
            "%s: samples of exactly %s m with walls round them are taken as voids, since no shore "
            "is so steep; declare them to be nodata (gdal_edit.py -a_nodata)",
            source,
            " and ".join(f"{value:g}" for value in values_m),
        )
    despiked = remove_spikes(heights_m, spacing_m)
    lowest_m, highest_m = np.inf, -np.inf
    for rows in strips(heights_m):
        known_m = heights_m[rows][np.isfinite(heights_m[rows])]
        lowest_m = min(lowest_m, float(known_m.min(initial=np.inf)))
        highest_m = max(highest_m, float(known_m.max(initial=-np.inf)))
    if np.isinf(highest_m):
        raise InputError(
            f"{source} holds no height: all samples are nodata or beyond {ABSURD_M:.0f} m; check "
            "the file and its nodata value"
        )
    if highest_m > GROUND_M[1]:
        _log.warning(
            "%s has heights of up to %.0f m, more than any ground on Earth; name the unit of its "
            "heights, or its nodata value (rio edit-info)",
            source,
            highest_m,
        )
    if lowest_m < GROUND_M[0]:
        _log.warning(
            "%s has heights down to %.0f m, the bed of a sea, which is taken for ground; set what "
            "lies under water to the height of its surface (gdal_calc.py)",
            source,
            lowest_m,
        )
    filled = fill_voids(heights_m)
    hollow = 0
    for rows in strips(heights_m):
        strip = heights_m[rows]
        hollow += int(np.count_nonzero(np.isnan(strip)))
        strip[np.isinf(strip)] = np.nan
    return filled, hollow, despiked, undeclared


def void_undeclared(heights_m: Float32Array, spacing_m: float) -> tuple[int, list[float]]:
    """Turn voids that a file does not declare into declared ones.

    These are all samples marked -inf (a customary void value that the file does not name), and
    every connected place of one value, `MIN_FILL_SAMPLES` or more of them, with walls on `WALLED`
    of its rim. A wall is a step up between neighbouring samples that is as high as a spike
    (`remove_spikes`), at most three samples from the rim. Samples between the rim and the highest
    wall are voids as well.

    Returns the number of samples that became voids, and the constants found.
    """
    count = 0
    for rows in strips(heights_m):
        named = np.isneginf(heights_m[rows])
        heights_m[rows][named] = np.nan
        count += int(np.count_nonzero(named))
    found = []
    threshold_m = _least_step_m(spacing_m)
    for value in _walled_values(heights_m, threshold_m):
        voids = _remove_fill(heights_m, value, threshold_m)
        if voids:
            count += voids
            found.append(value)
    return count, found


def remove_spikes(heights_m: Float32Array, spacing_m: float) -> int:
    """Turn spikes, upward and downward, into voids; return their number of samples.

    A sample is a spike if its height is absurd (beyond `ABSURD_M`), or if it is part of a clump of
    at most `MAX_SPIKE_SAMPLES` samples that

    - no gentle step joins to the rest: every step to a neighbour outside the clump is higher than
      ``max(LEAST_SPIKE_M, STEEPEST * spacing_m)``. A summit, the rim of a cliff of any height and
      the crest of an arete each have a neighbour that is nearer than that;
    - stands out: each of its samples is `STANDS_OUT` times farther from the median of its
      neighbours (other such clumps left aside) than their quartiles are apart, so that rugged
      ground keeps its ruggedness.

    NaN and +inf samples are no neighbours.
    """
    count = 0
    for rows in strips(heights_m):
        strip = heights_m[rows]
        absurd = (np.abs(strip) > ABSURD_M) & ~np.isposinf(strip)
        strip[absurd] = np.nan
        count += int(np.count_nonzero(absurd))
    threshold_m = _least_step_m(spacing_m)
    candidates = _beside_jumps(heights_m, threshold_m)
    if candidates.size == 0:
        return count
    spikes = candidates[_are_spikes(heights_m, candidates, threshold_m)]
    heights_m.reshape(-1)[spikes] = np.nan
    return count + spikes.size


def fill_voids(heights_m: Float32Array) -> int:
    """Fill voids of up to `MAX_VOID_SAMPLES` connected samples; return the count.

    The filling solves Laplace's equation with the rim as its boundary (the shape of a soap film):
    smooth, and never higher or lower than the rim, so that no skyline is invented. Samples are
    connected by their sides, not by corners. At the border of the data the film ends level.
    """
    voids = _small_voids(heights_m)
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


def _least_step_m(spacing_m: float) -> float:
    """Return the least step, up or down, at a spike or a wall."""
    return max(LEAST_SPIKE_M, STEEPEST * spacing_m)


def _beside_jumps(heights_m: Float32Array, threshold_m: float) -> Int64Array:
    """Return flat indices, ascending, of heights that differ by a jump from one beside them."""
    found = []
    for rows in strips(heights_m):
        top = max(rows.start - 1, 0)
        block = heights_m[top : rows.stop + 1]
        beside = np.zeros(block.shape, dtype=np.bool_)
        for lines_m, marks in ((block, beside), (block.T, beside.T)):
            with np.errstate(invalid="ignore"):
                jump = np.abs(np.diff(lines_m, axis=0)) > threshold_m
            marks[1:] |= jump
            marks[:-1] |= jump
        beside &= np.isfinite(block)
        inner = beside[rows.start - top : rows.stop - top]
        found.append(np.flatnonzero(inner) + rows.start * heights_m.shape[1])
    return np.concatenate(found)


def _are_spikes(heights_m: Float32Array, candidates: Int64Array, threshold_m: float) -> BoolArray:
    """Return which candidates are spikes; see `remove_spikes`."""
    around = _neighbours(candidates, _AROUND, heights_m.shape)
    around_m = _heights(heights_m, around)
    own_m = heights_m.reshape(-1)[candidates].astype(np.float64)
    joined = np.abs(around_m - own_m[:, np.newaxis]) <= threshold_m
    slot, is_candidate = _find(candidates, around)
    row, side = np.nonzero(joined & is_candidate)
    from scipy.sparse import coo_array  # noqa: PLC0415  (a fifth of a second, seldom needed)
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    shape = candidates.size, candidates.size
    graph = coo_array((np.ones(row.size, dtype=np.int8), (row, slot[row, side])), shape=shape)
    clump = connected_components(graph, directed=False)[1]
    # A gentle step to a sample that is no candidate anchors the whole clump.
    anchored = np.bincount(clump, weights=(joined & ~is_candidate).any(axis=1)) > 0.0
    suspect = ((np.bincount(clump) <= MAX_SPIKE_SAMPLES) & ~anchored)[clump]
    firm_m = np.where(is_candidate & suspect[slot], np.nan, around_m)[suspect]
    stands_out = np.zeros(candidates.size, dtype=np.bool_)
    stands_out[suspect] = _stand_out(own_m[suspect], firm_m)
    whole_clump_stands_out = np.bincount(clump, weights=~stands_out) == 0.0
    return np.asarray(whole_clump_stands_out[clump], dtype=np.bool_)


def _stand_out(own_m: Float64Array, firm_m: Float64Array) -> BoolArray:
    ranked = np.sort(firm_m, axis=1)  # NaN last
    known = np.count_nonzero(np.isfinite(ranked), axis=1)
    last = np.maximum(known - 1, 0)

    def at(rank: Int64Array) -> Float64Array:
        return np.take_along_axis(ranked, rank[:, np.newaxis], axis=1)[:, 0]

    median_m = 0.5 * (at(last // 2) + at((last + 1) // 2))
    quartiles_apart_m = at(last - last // 4) - at(last // 4)
    far_off = np.abs(own_m - median_m) > STANDS_OUT * quartiles_apart_m
    return np.asarray(far_off & (known >= _LEAST_SURROUNDINGS), dtype=np.bool_)


def _small_voids(heights_m: Float32Array) -> Int64Array:
    """Return flat indices, ascending, of the samples of small voids that have a rim."""
    from scipy.ndimage import binary_dilation, label  # noqa: PLC0415  (slow to load, seldom needed)

    found = [np.zeros(0, dtype=np.int64)]
    for rows in strips(heights_m):
        # A void that reaches past these rows from the strip has too many samples to be filled.
        top = max(rows.start - MAX_VOID_SAMPLES, 0)
        block = heights_m[top : rows.stop + MAX_VOID_SAMPLES]
        inner = slice(rows.start - top, rows.stop - top)
        voids = np.isnan(block)
        if not voids[inner].any():
            continue
        void, count = label(voids)
        wanted = np.zeros(count + 1, dtype=np.bool_)
        wanted[void[binary_dilation(np.isfinite(block))]] = True
        wanted &= np.bincount(void.ravel()) <= MAX_VOID_SAMPLES
        wanted[0] = False
        found.append(np.flatnonzero(wanted[void[inner]]) + rows.start * heights_m.shape[1])
    return np.concatenate(found)


def _neighbours(samples: Int64Array, steps: Int64Array, shape: tuple[int, ...]) -> Int64Array:
    """Return (n, steps) flat indices of neighbours, -1 off the grid."""
    row = samples[:, np.newaxis] // shape[1] + steps[:, 0]
    col = samples[:, np.newaxis] % shape[1] + steps[:, 1]
    inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    return np.asarray(np.where(inside, row * shape[1] + col, -1), dtype=np.int64)


def _heights(heights_m: Float32Array, samples: Int64Array) -> Float64Array:
    """Return heights in float64; NaN on voids, off the grid, and where no file covers it."""
    on_grid = samples >= 0
    heights = np.full(samples.shape, np.nan)
    heights[on_grid] = heights_m.reshape(-1)[samples[on_grid]]
    return np.where(np.isfinite(heights), heights, np.nan)


def _find(samples: Int64Array, wanted: Int64Array) -> tuple[Int64Array, BoolArray]:
    """Return the position of each wanted index among ascending samples, and if it is there."""
    slot = np.minimum(np.searchsorted(samples, wanted), samples.size - 1)
    return slot, samples[slot] == wanted


def _walled_values(heights_m: Float32Array, threshold_m: float) -> list[float]:
    """Return values that often stand twice in a row beside a jump: they may be fill."""
    counts: Counter[float] = Counter()
    around = np.arange(-_REACH, _REACH + 2)
    for view_m in (heights_m, heights_m.T):
        for rows in strips(view_m):
            with np.errstate(invalid="ignore"):
                steep = (np.abs(np.diff(view_m[rows], axis=1)) > threshold_m).any(axis=1)
            strip = view_m[rows][steep]
            strip = np.pad(strip, ((0, 0), (_REACH, _REACH)), constant_values=np.nan)
            strip[np.isinf(strip)] = np.nan
            row, col = np.nonzero(np.abs(np.diff(strip, axis=1)) > threshold_m)
            near = strip[row[:, np.newaxis], col[:, np.newaxis] + around]
            repeated = near[:, 1:][near[:, 1:] == near[:, :-1]]
            values, each = np.unique(repeated, return_counts=True)
            counts.update(dict(zip(values.tolist(), each.tolist(), strict=True)))
    return sorted(value for value, number in counts.items() if number >= _MIN_RIM)


def _remove_fill(heights_m: Float32Array, value: float, threshold_m: float) -> int:
    """Turn the fill of one value into voids; return the number of its samples."""
    from scipy.ndimage import label  # noqa: PLC0415  (slow to load, seldom needed)

    has_value = heights_m == np.float32(value)
    place, count = label(has_value)
    # Turned and flipped are views of one array, so that the four sides of places are treated alike.
    is_large = np.bincount(place.ravel()) >= MIN_FILL_SAMPLES
    removed = np.zeros(heights_m.shape, dtype=np.bool_)
    for turned in (np.asarray, np.transpose):
        sides = []
        for flipped in (np.asarray, np.fliplr):
            field_m, inside, places, view = (
                flipped(turned(grid)) for grid in (heights_m, has_value, place, removed)
            )
            row, col = np.nonzero(inside[:, :-1] & ~inside[:, 1:])
            wall = _walls(field_m, row, col, value, threshold_m)
            sides.append((view, places[row, col], row, col, wall))
        of_rim = np.concatenate([of for _, of, *_ in sides])
        has_wall = np.concatenate([wall > 0 for *_, wall in sides])
        rim = np.bincount(of_rim, minlength=count + 1)
        walls = np.bincount(of_rim[has_wall], minlength=count + 1)
        is_fill = is_large & (rim >= _MIN_RIM) & (walls >= WALLED * rim)
        removed |= is_fill[place]
        for view, of, row, col, wall in sides:
            for step in range(1, _REACH):
                ramp = is_fill[of] & (wall > step)
                view[row[ramp], col[ramp] + step] = True
    removed &= np.isfinite(heights_m)
    heights_m[removed] = np.nan
    return int(np.count_nonzero(removed))


def _walls(
    heights_m: Float32Array, row: Int64Array, col: Int64Array, value: float, threshold_m: float
) -> Int64Array:
    """Return how many samples east of each sample of the rim its highest wall is; 0 for none."""
    wall = np.zeros(row.size, dtype=np.int64)
    before, highest = np.full(row.size, value), np.full(row.size, threshold_m)
    cols = heights_m.shape[1]
    for step in range(1, _REACH + 1):
        here = heights_m[row, np.minimum(col + step, cols - 1)].astype(np.float64)
        here[(col + step >= cols) | np.isinf(here)] = np.nan
        higher = here - before > highest
        wall = np.where(higher, step, wall)
        highest = np.where(higher, here - before, highest)
        before = here
    return wall
