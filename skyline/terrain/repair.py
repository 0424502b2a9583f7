"""Repair of a DEM's samples before it is rendered.

Voids are filled, and spikes and fill are removed. A skyline is a maximum, so one bad sample makes a
phantom ridge. All functions work in place on heights (rows, cols), float32 and C-contiguous, and
strip by strip, so that a field of hundreds of millions of samples costs little more than itself.
``spacing_m`` is the coarser of the two sample spacings, metres on the ground.

While a DEM is being read, NaN marks a void, and -inf a void that the file does not declare. +inf
marks a sample that no file covers: it is never filled, and does not count as a neighbour.

Fill is an undeclared constant in place of heights that were never measured, such as zeros in the
corners of a raster around a scene that lies turned on the map. It would look like a plain over
which an eye sees far. It differs from water by its rim: no terrain rises as steeply as a spike
along half of a shore.
"""

import logging
import math
from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.errors import InputError
from skyline.geodesy.earth import GROUND_M
from skyline.terrain.grid import STRIP_SAMPLES, row_strips

ABSURD_M = 30_000.0
"""No known solid body has a height beyond this above or below its datum (Mars: +21.2, -8.2 km)."""

_WRAPPED = 65_536.0
"""Numbers of 16 bits without a sign wrap below 0 to this: -236 m is kept as 65,300."""

TALLEST_CANOPY_M = 120.0
"""Greatest height in a canopy model."""

_AROUND = np.array([(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if (r, c) != (0, 0)])
_BESIDE = np.array([(-1, 0), (0, -1), (0, 1), (1, 0)])

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RepairRules:
    """Which samples are spikes and fill, and which voids are filled."""

    steepest: float = 2.5
    """Rise over run that no terrain has on every side of a few samples: 68 degrees all round."""
    least_spike_m: float = 100.0
    """The least height of a spike, and of a wall around fill, however fine the DEM."""
    max_spike_samples: int = 4
    """The largest spike: a clump of 2 x 2 samples."""
    stands_out: float = 3.0
    """Least distance of a spike from the median of its neighbours, in distances between their
    quartiles."""
    least_neighbours: int = 3
    """Least number of known neighbours that have a median and quartiles."""
    max_void_samples: int = 100
    """The largest void that is filled. Voids of the Everest tile were cut into the High Sierra at
    90 m and filled: heights were off by 14 m rms in voids of up to 10 samples, 31 m at 50 to 100,
    51 m at 200 to 500 and 295 m above 10,000."""
    min_fill_samples: int = 100
    """The smallest fill whose rim is not all walls. Fill behind walls on all sides is larger than a
    spike."""
    walled_share: float = 0.5
    """The least share of the rim of fill that is walls."""
    min_rim_samples: int = 20
    """Least number of samples on the rim of fill, and of walls beside a value that may be fill."""
    wall_reach_samples: int = 3
    """Greatest distance of a wall from the rim, in samples: cubic resampling spreads a wall."""
    ground_m: tuple[float, float] = GROUND_M
    """Lowest and highest ground of the world. A model with higher samples is refused, and a warning
    names lower ones."""
    deepest_m: float = 11_000.0
    """Depth of the deepest sea bed."""
    steep_share: float = 0.2
    """Least share of steps above 45 degrees that no ground has. Of the steps of eight models of
    mountains, at 5 to 100 m, at most 3 % are so steep, and in feet taken for metres 16 to 49 %."""
    least_spacing_m: float = 10.0
    """Least spacing at which steps are slopes, not trees and houses."""
    slope_spacing_m: float = 30.0
    """Least spacing of the samples that are compared in a finer model."""
    least_area_m2: float = 25e6
    """Least area whose steps are counted: a smaller model may show little but one wall."""
    strips_for_slopes: int = 64
    """Number of strips whose steps are counted, about."""
    strip_samples: int = STRIP_SAMPLES
    """Samples of a strip of rows; more cost memory, and change nothing else."""

    @property
    def cached_samples(self) -> int:
        """Samples of a strip that fits into the processor's cache."""
        return self.strip_samples // 16

    def least_step_m(self, spacing_m: float) -> float:
        """Return the least step, up or down, at spikes and walls."""
        return max(self.least_spike_m, self.steepest * spacing_m)


class RepairCounts(NamedTuple):
    """The numbers of samples that were changed, as `skyline.Provenance` has them."""

    filled: int
    hollow: int
    despiked: int
    undeclared: int


def repair(
    heights_m: Float32Array,
    source: str,
    spacing_m: float,
    rules: RepairRules = RepairRules(),
    *,
    is_unit_named: bool = False,
) -> RepairCounts:
    """Turn fill into voids, remove spikes, and close small voids.

    Afterwards NaN marks every hole. ``source`` is the name of the DEM in errors and warnings, and
    ``is_unit_named`` says whether it names the unit of its heights. Raises `InputError` if there
    are no heights at all, or some above all ground, if heights below 0 have wrapped, if voids were
    resampled with heights, or if the ground is steeper than any and nothing names a unit.
    """
    _check_wrapped(heights_m, source, spacing_m, rules)
    undeclared, values_m = void_undeclared(heights_m, spacing_m, rules)
    if values_m:
        _log.warning(
            "%s: samples of exactly %s m with walls round them are taken as voids, since no shore "
            "is so steep; declare them to be nodata (gdal_edit.py -a_nodata)",
            source,
            " and ".join(f"{value:g}" for value in values_m),
        )
    despiked = remove_spikes(heights_m, spacing_m, rules)
    _check_range(heights_m, source, spacing_m, rules)
    _check_slopes(heights_m, source, spacing_m, rules, is_unit_named)
    filled = fill_voids(heights_m, rules)
    hollow = 0
    for rows in row_strips(heights_m, rules.cached_samples):
        strip = heights_m[rows]
        hollow += int(np.count_nonzero(np.isnan(strip)))
        strip[np.isinf(strip)] = np.nan
    return RepairCounts(filled, hollow, despiked, undeclared)


def _check_wrapped(
    heights_m: Float32Array, source: str, spacing_m: float, rules: RepairRules
) -> None:
    """Raise `InputError` if heights below 0 were kept without a sign.

    Several values just below 65,536 m are such heights if most steps between them and other heights
    are gentle once they are unwrapped. One value alone, or values with walls round them, mark
    voids.
    """
    step_m = rules.least_step_m(spacing_m)
    lowest = np.inf
    highest = -np.inf
    steps = gentle = 0
    for rows in row_strips(heights_m, rules.cached_samples):
        strip = heights_m[rows]
        wrapped = (strip > _WRAPPED - rules.deepest_m) & (strip < _WRAPPED)
        if not wrapped.any():
            continue
        lowest = min(lowest, float(strip[wrapped].min()))
        highest = max(highest, float(strip[wrapped].max()))
        for lines, marks in ((strip, wrapped), (strip.T, wrapped.T)):
            with np.errstate(invalid="ignore"):  # Samples without a height are infinite.
                rise = np.abs(np.diff(lines, axis=0))
            border = (marks[1:] != marks[:-1]) & np.isfinite(rise)
            steps += int(np.count_nonzero(border))
            gentle += int(np.count_nonzero(border & (np.abs(rise - _WRAPPED) <= step_m)))
    if lowest < highest and 2 * gentle > steps:
        raise InputError(
            f"{source} has values of {lowest:g} to {highest:g} that join its other heights as "
            f"{lowest - _WRAPPED:g} to {highest - _WRAPPED:g} m: heights below 0 kept in 16 bits "
            "without a sign; expected signed numbers: convert it (gdal_calc.py --type Int16 --calc "
            "'A.astype(numpy.int16)')"
        )


def _check_range(
    heights_m: Float32Array, source: str, spacing_m: float, rules: RepairRules
) -> None:
    """Raise `InputError` without heights, above all ground, or below it beside walls.

    Warns of sea beds.
    """
    lowest_m = np.inf
    highest_m = -np.inf
    for rows in row_strips(heights_m, rules.cached_samples):
        known_m = heights_m[rows][np.isfinite(heights_m[rows])]
        lowest_m = min(lowest_m, float(known_m.min(initial=np.inf)))
        highest_m = max(highest_m, float(known_m.max(initial=-np.inf)))
    if np.isinf(highest_m):
        raise InputError(
            f"{source} holds no height: all samples are nodata or beyond {ABSURD_M:.0f} m; check "
            "the file and its nodata value"
        )
    if highest_m > rules.ground_m[1]:
        raise InputError(
            f"{source} has heights of up to {highest_m:.0f} m, more than any ground on Earth; if "
            "they are in feet, name the unit (rio edit-info --bidx 1 --units ft), and if the "
            f"greatest mark voids, the nodata value (rio edit-info --nodata {highest_m:g})"
        )
    if lowest_m < rules.ground_m[0]:
        if _has_smeared_voids(heights_m, spacing_m, rules):
            raise InputError(
                f"{source} has heights down to {lowest_m:.0f} m with walls round them, as a void "
                "value leaves that was resampled with the heights beside it, which become ridges; "
                "declare the value in the original (gdal_edit.py -a_nodata), and resample it again"
            )
        _log.warning(
            "%s has heights down to %.0f m, the bed of a sea, which is taken for ground; set what "
            "lies under water to the height of its surface (gdal_calc.py)",
            source,
            lowest_m,
        )


def _has_smeared_voids(heights_m: Float32Array, spacing_m: float, rules: RepairRules) -> bool:
    """Return whether most samples below all ground stand beside walls.

    The bed of a sea has gentle slopes. Resampling leaves values between that of voids and heights,
    and overshoots beyond both.
    """
    low = sum(
        int(np.count_nonzero(heights_m[rows] < rules.ground_m[0]))
        for rows in row_strips(heights_m, rules.cached_samples)
    )
    beside = _beside_jumps(heights_m, rules.least_step_m(spacing_m), rules)
    walled = int(np.count_nonzero(heights_m.reshape(-1)[beside] < rules.ground_m[0]))
    return walled >= max(rules.min_rim_samples, rules.walled_share * low)


def _check_slopes(
    heights_m: Float32Array,
    source: str,
    spacing_m: float,
    rules: RepairRules,
    is_unit_named: bool,
) -> None:
    """Raise `InputError` for ground that is steeper than any.

    Heights in feet that are taken for metres make such ground. Where the unit is named, there is a
    warning in place of the error.
    """
    if heights_m.size * spacing_m**2 < rules.least_area_m2:
        return
    if spacing_m < rules.least_spacing_m:
        every = math.ceil(rules.slope_spacing_m / spacing_m)
        heights_m = heights_m[::every, ::every]
        spacing_m *= every
    strips = list(row_strips(heights_m, rules.cached_samples))
    steep = known = 0
    for rows in strips[:: max(1, len(strips) // rules.strips_for_slopes)]:
        for axis in (0, 1):
            with np.errstate(invalid="ignore"):  # Samples without a height are infinite.
                step_m = np.abs(np.diff(heights_m[rows], axis=axis))
            known += int(np.count_nonzero(np.isfinite(step_m)))
            steep += int(np.count_nonzero((step_m > spacing_m) & np.isfinite(step_m)))
    if steep <= rules.steep_share * known:
        return
    said = (
        f"{source}: {100.0 * steep / known:.0f} % of the steps between its samples are steeper "
        "than 45 degrees, more than in any mountains"
    )
    if not is_unit_named:
        raise InputError(
            f"{said}, and nothing names the unit of its heights; name it (rio edit-info --bidx 1 "
            "--units ft, or m if they are metres), or correct the CRS of its map"
        )
    _log.warning("%s; check the unit that it names, and the CRS of its map", said)


def void_undeclared(
    heights_m: Float32Array, spacing_m: float, rules: RepairRules = RepairRules()
) -> tuple[int, list[float]]:
    """Turn voids that a file does not declare into declared ones.

    These are all samples marked -inf (a customary void value that the file does not name), and all
    fill: connected samples of one value, more than a spike's with walls on all of their rim, or at
    least ``rules.min_fill_samples`` with walls on ``rules.walled_share`` of it. A wall is a step up
    between neighbouring samples that is as high as a spike (`remove_spikes`), at most
    ``rules.wall_reach_samples`` from the rim. Samples between the rim and the highest wall are
    voids as well.

    Returns the number of samples that became voids, and the constants found.
    """
    count = 0
    for rows in row_strips(heights_m, rules.cached_samples):
        named = np.isneginf(heights_m[rows])
        heights_m[rows][named] = np.nan
        count += int(np.count_nonzero(named))
    found = []
    step_m = rules.least_step_m(spacing_m)
    for value in _walled_values(heights_m, step_m, rules):
        voids = _remove_fill(heights_m, value, step_m, rules)
        if voids:
            count += voids
            found.append(value)
    return count, found


def remove_spikes(
    heights_m: Float32Array, spacing_m: float, rules: RepairRules = RepairRules()
) -> int:
    """Turn spikes into voids; return the number of their samples.

    Spikes point upward or downward. A sample is a spike if its height is absurd (beyond
    `ABSURD_M`), or if it is part of a clump of at most ``rules.max_spike_samples`` samples of which
    both are true:

    - No gentle step joins the clump to the rest: every step to a neighbour outside it is higher
      than ``rules.least_step_m(spacing_m)``. A summit, the rim of a cliff of any height and the
      crest of an arete each have a neighbour that is nearer in height.
    - The clump stands out: each of its samples is ``rules.stands_out`` times farther from the
      median of its neighbours (other such clumps left aside) than their quartiles are apart, so
      that rugged ground keeps its ruggedness.

    NaN and +inf samples do not count as neighbours.
    """
    count = 0
    for rows in row_strips(heights_m, rules.cached_samples):
        strip = heights_m[rows]
        absurd = (np.abs(strip) > ABSURD_M) & ~np.isposinf(strip)
        strip[absurd] = np.nan
        count += int(np.count_nonzero(absurd))
    step_m = rules.least_step_m(spacing_m)
    suspects = _beside_jumps(heights_m, step_m, rules)
    if suspects.size == 0:
        return count
    spikes = suspects[_are_spikes(heights_m, suspects, step_m, rules)]
    heights_m.reshape(-1)[spikes] = np.nan
    return count + spikes.size


def fill_voids(heights_m: Float32Array, rules: RepairRules = RepairRules()) -> int:
    """Fill small voids; return the number of their samples.

    A void is small if it has at most ``rules.max_void_samples`` samples, connected by their sides,
    not by corners. The filling solves Laplace's equation with the rim as its boundary (the shape of
    a soap film): smooth, and never higher or lower than the rim, so that no skyline is invented. At
    the border of the data the film ends level.
    """
    voids = _small_voids(heights_m, rules)
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


def _beside_jumps(heights_m: Float32Array, step_m: float, rules: RepairRules) -> Int64Array:
    """Return ascending flat indices of heights beside a jump above ``step_m``."""
    found = []
    for rows in row_strips(heights_m, rules.cached_samples):
        top = max(rows.start - 1, 0)
        block = heights_m[top : rows.stop + 1]
        beside = np.zeros(block.shape, dtype=np.bool_)
        for lines_m, marks in ((block, beside), (block.T, beside.T)):
            with np.errstate(invalid="ignore"):
                jump = np.abs(np.diff(lines_m, axis=0)) > step_m
            marks[1:] |= jump
            marks[:-1] |= jump
        beside &= np.isfinite(block)
        inner = beside[rows.start - top : rows.stop - top]
        found.append(np.flatnonzero(inner) + rows.start * heights_m.shape[1])
    return np.concatenate(found)


def _are_spikes(
    heights_m: Float32Array, suspects: Int64Array, step_m: float, rules: RepairRules
) -> BoolArray:
    """Return which of the suspected samples are spikes; see `remove_spikes`."""
    around = _neighbours(suspects, _AROUND, heights_m.shape)
    around_m = _heights(heights_m, around)
    own_m = heights_m.reshape(-1)[suspects].astype(np.float64)
    joined = np.abs(around_m - own_m[:, np.newaxis]) <= step_m
    slot, is_suspect = _find(suspects, around)
    row, side = np.nonzero(joined & is_suspect)
    clump = _joined(suspects.size, row, slot[row, side])
    # A gentle step to a sample that is not suspected anchors the whole clump.
    anchored = np.bincount(clump, weights=(joined & ~is_suspect).any(axis=1)) > 0.0
    is_loose = ((np.bincount(clump) <= rules.max_spike_samples) & ~anchored)[clump]
    firm_m = np.where(is_suspect & is_loose[slot], np.nan, around_m)[is_loose]
    stands_out = np.zeros(suspects.size, dtype=np.bool_)
    stands_out[is_loose] = _stand_out(own_m[is_loose], firm_m, rules)
    whole_clump_stands_out = np.bincount(clump, weights=~stands_out) == 0.0
    return np.asarray(whole_clump_stands_out[clump], dtype=np.bool_)


def _joined(count: int, one: Int64Array, other: Int64Array) -> Int64Array:
    """Return a number (count,) that the members of each group share.

    The pairs ``one`` and ``other`` join groups; each pair is given both ways round.
    """
    group = np.arange(count)
    while True:
        least = group.copy()
        np.minimum.at(least, one, group[other])
        least = least[least]
        if np.array_equal(least, group):
            return group
        group = least


def _stand_out(own_m: Float64Array, firm_m: Float64Array, rules: RepairRules) -> BoolArray:
    """Return which heights (N,) lie far from their neighbours' (N, 8) median."""
    ranked = np.sort(firm_m, axis=1)  # NaN last
    known = np.count_nonzero(np.isfinite(ranked), axis=1)
    last = np.maximum(known - 1, 0)

    def at(rank: Int64Array) -> Float64Array:
        return np.take_along_axis(ranked, rank[:, np.newaxis], axis=1)[:, 0]

    median_m = 0.5 * (at(last // 2) + at((last + 1) // 2))
    quartiles_apart_m = at(last - last // 4) - at(last // 4)
    far_off = np.abs(own_m - median_m) > rules.stands_out * quartiles_apart_m
    return np.asarray(far_off & (known >= rules.least_neighbours), dtype=np.bool_)


def _small_voids(heights_m: Float32Array, rules: RepairRules) -> Int64Array:
    """Return ascending flat indices of small voids that have a rim."""
    most = rules.max_void_samples
    found = [np.zeros(0, dtype=np.int64)]
    for rows in row_strips(heights_m, rules.strip_samples):
        # A void that reaches past these rows from the strip has too many samples to be filled.
        top = max(rows.start - most, 0)
        block = heights_m[top : rows.stop + most]
        inner = slice(rows.start - top, rows.stop - top)
        voids = np.isnan(block)
        if not voids[inner].any():
            continue
        from scipy.ndimage import binary_dilation, label  # noqa: PLC0415  (slow to load)

        void, count = label(voids)
        wanted = np.zeros(count + 1, dtype=np.bool_)
        wanted[void[binary_dilation(np.isfinite(block))]] = True
        wanted &= np.bincount(void.ravel()) <= most
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
    """Return float64 heights; NaN in voids, off the grid, without a file."""
    on_grid = samples >= 0
    heights = np.full(samples.shape, np.nan)
    heights[on_grid] = heights_m.reshape(-1)[samples[on_grid]]
    return np.where(np.isfinite(heights), heights, np.nan)


def _find(samples: Int64Array, wanted: Int64Array) -> tuple[Int64Array, BoolArray]:
    """Return the slots of ``wanted`` in ascending ``samples``, and which exist."""
    slot = np.minimum(np.searchsorted(samples, wanted), samples.size - 1)
    return slot, samples[slot] == wanted


def _walled_values(heights_m: Float32Array, step_m: float, rules: RepairRules) -> list[float]:
    """Return values that two neighbours beside a jump often have."""
    counts: Counter[float] = Counter()
    reach = rules.wall_reach_samples
    around = np.arange(-reach, reach + 2)
    for view_m in (heights_m, heights_m.T):
        for rows in row_strips(view_m, rules.cached_samples):
            with np.errstate(invalid="ignore"):
                steep = (np.abs(np.diff(view_m[rows], axis=1)) > step_m).any(axis=1)
            strip = view_m[rows][steep]
            strip = np.pad(strip, ((0, 0), (reach, reach)), constant_values=np.nan)
            strip[np.isinf(strip)] = np.nan
            row, col = np.nonzero(np.abs(np.diff(strip, axis=1)) > step_m)
            near = strip[row[:, np.newaxis], col[:, np.newaxis] + around]
            repeated = near[:, 1:][near[:, 1:] == near[:, :-1]]
            values, each = np.unique(repeated, return_counts=True)
            counts.update(dict(zip(values.tolist(), each.tolist(), strict=True)))
    return sorted(value for value, number in counts.items() if number >= rules.min_rim_samples)


def _remove_fill(heights_m: Float32Array, value: float, step_m: float, rules: RepairRules) -> int:
    """Turn the fill of one value into voids; count its samples."""
    from scipy.ndimage import label  # noqa: PLC0415  (slow to load, seldom needed)

    has_value = heights_m == np.float32(value)
    patch, count = label(has_value)
    size = np.bincount(patch.ravel())
    removed = np.zeros(heights_m.shape, dtype=np.bool_)
    sides_by_turn = []
    # Turned and flipped views of one array let the four sides of a patch be treated alike.
    for turned in (np.asarray, np.transpose):
        sides = []
        for flipped in (np.asarray, np.fliplr):
            field_m, inside, patches, view = (
                flipped(turned(grid)) for grid in (heights_m, has_value, patch, removed)
            )
            row, col = np.nonzero(inside[:, :-1] & ~inside[:, 1:])
            wall = _walls(field_m, row, col, value, step_m, rules.wall_reach_samples)
            sides.append((view, patches[row, col], row, col, wall))
        of_rim = np.concatenate([of for _, of, *_ in sides])
        has_wall = np.concatenate([wall > 0 for *_, wall in sides])
        rim = np.bincount(of_rim, minlength=count + 1)
        walls = np.bincount(of_rim[has_wall], minlength=count + 1)
        sides_by_turn.append((sides, rim, walls))
    is_open = np.array([walls < rim for _, rim, walls in sides_by_turn]).any(axis=0)
    is_enclosed = (size > rules.max_spike_samples) & ~is_open
    for sides, rim, walls in sides_by_turn:
        is_large = (size >= rules.min_fill_samples) & (rim >= rules.min_rim_samples)
        is_fill = is_enclosed | (is_large & (walls >= rules.walled_share * rim))
        is_fill[0] = False  # All other samples
        removed |= is_fill[patch]
        for view, of, row, col, wall in sides:
            for step in range(1, rules.wall_reach_samples):
                ramp = is_fill[of] & (wall > step)
                view[row[ramp], col[ramp] + step] = True
    removed &= np.isfinite(heights_m)
    heights_m[removed] = np.nan
    return int(np.count_nonzero(removed))


def _walls(
    heights_m: Float32Array,
    row: Int64Array,
    col: Int64Array,
    value: float,
    step_m: float,
    reach: int,
) -> Int64Array:
    """Return the samples from rims east to the highest wall, or 0."""
    wall = np.zeros(row.size, dtype=np.int64)
    before = np.full(row.size, value)
    highest = np.full(row.size, step_m)
    cols = heights_m.shape[1]
    for step in range(1, reach + 1):
        here = heights_m[row, np.minimum(col + step, cols - 1)].astype(np.float64)
        here[(col + step >= cols) | np.isinf(here)] = np.nan
        higher = here - before > highest
        wall = np.where(higher, step, wall)
        highest = np.where(higher, here - before, highest)
        before = here
    return wall
