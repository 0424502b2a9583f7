"""Fill that a DEM does not declare: a constant in place of what was never measured.

A footprint that was turned or cut is often padded with zeros, and the file does not say so. Left
in, they are a plain at sea level below walls of 2,000 m, over which an eye seems to see far. They
are told from a lake or the sea by their rim: terrain does not rise over water by
`skyline.terrain.cleaning.STEEPEST` along half of a shore.
"""

from collections.abc import Iterator

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Int64Array
from skyline.terrain.cleaning import connected_runs, runs_of, strips

MIN_SAMPLES = 100
"""Samples of the smallest fill."""

WALLED = 0.5
"""Share of the rim that is walls, from which on a constant is fill."""

_MIN_RIM = 20
_REACH = 3
"""Samples from the rim within which the wall stands: a cubic resampling smears it over them."""


def void_undeclared(heights_m: Float32Array, threshold_m: float) -> tuple[int, list[float]]:
    """Turn what a file does not declare to be void, and is, into voids, in place.

    This is every sample marked -inf (a customary void value that the file does not name), and
    every connected place of one value, `MIN_SAMPLES` or more of them, with walls on `WALLED` of
    its rim. A wall is a rise of more than the threshold between neighbouring samples, at most
    three samples from the rim. Samples between the rim and the highest wall
    are voids as well.

    Parameters
    ----------
    heights_m : (rows, cols) float32, C-contiguous
        NaN marks voids, +inf samples that no file covers.
    threshold_m : float
        Of a wall; infinity finds none.

    Returns
    -------
    count : int
        Samples that became voids.
    values_m : list of float
        The constants found.
    """
    count = 0
    for rows in strips(heights_m):
        named = np.isneginf(heights_m[rows])
        heights_m[rows][named] = np.nan
        count += int(np.count_nonzero(named))
    found = []
    for value in _walled_values(heights_m, threshold_m):
        voids = _Fill(heights_m, value, threshold_m).remove()
        if voids:
            count += voids
            found.append(value)
    return count, found


def _walled_values(heights_m: Float32Array, threshold_m: float) -> list[float]:
    """Return the values that stand twice in a row before many a wall."""
    counts: dict[float, int] = {}
    for view in (heights_m, heights_m.T):
        for rows in strips(view):
            with np.errstate(invalid="ignore"):
                steep = (np.abs(np.diff(view[rows], axis=1)) > threshold_m).any(axis=1)
            walled = view[rows][steep]
            for line in (walled, walled[:, ::-1]):
                before = _before_walls(line, threshold_m)
                values, each = np.unique(
                    line[:, 1 : 1 + before.shape[1]][before], return_counts=True
                )
                for value, number in zip(values.tolist(), each.tolist(), strict=True):
                    counts[value] = counts.get(value, 0) + number
    return sorted(value for value, number in counts.items() if number >= _MIN_RIM)


def _before_walls(line: Float32Array, threshold_m: float) -> BoolArray:
    """Return where the second of two equal samples ends their run before a wall."""
    inner = max(line.shape[1] - 1 - _REACH, 0)
    if inner == 0:
        return np.zeros((line.shape[0], 0), dtype=np.bool_)
    with np.errstate(invalid="ignore"):
        rise = (np.diff(line[:, 1:], axis=1) > threshold_m) & np.isfinite(line[:, 2:])
        wall = rise[:, :inner].copy()
        for step in range(1, _REACH):
            wall |= rise[:, step : step + inner]
    wall &= line[:, 1 : 1 + inner] == line[:, :inner]
    wall &= line[:, 1 : 1 + inner] != line[:, 2 : 2 + inner]
    return np.asarray(wall, dtype=np.bool_)


class _Fill:
    """One value of a field: the places of it that have walls about them."""

    def __init__(self, heights_m: Float32Array, value: float, threshold_m: float) -> None:
        self.heights_m, self.value, self.threshold_m = heights_m, value, threshold_m

    def remove(self) -> int:
        """Turn the fill of this value into voids; return how many samples that were."""
        # Along both axes before any is removed, since what is removed hides the rim.
        spans = [(view, list(self._spans(view))) for view in (self.heights_m, self.heights_m.T)]
        count = 0
        for view, found in spans:
            for row, start, stop in found:
                fresh = np.isfinite(view[row, start:stop])
                view[row, start:stop] = np.nan
                count += int(np.count_nonzero(fresh))
        return count

    def _spans(self, view: Float32Array) -> Iterator[tuple[int, int, int]]:
        """Yield row, first column and column past the last of what is fill along the rows."""
        row, start, stop = runs_of(view, lambda strip: strip == np.float32(self.value))
        if row.size == 0:
            return
        place = connected_runs(row, start, stop, view.shape[1])
        west, east = self._walls(view, row, start - 1, -1), self._walls(view, row, stop, 1)
        rim = np.bincount(place, weights=(start > 0).astype(float) + (stop < view.shape[1]))
        walls = np.bincount(place, weights=(west > 0).astype(float) + (east > 0))
        samples = np.bincount(place, weights=stop - start)
        fill = (samples >= MIN_SAMPLES) & (rim >= _MIN_RIM) & (walls >= WALLED * rim)
        for index in np.flatnonzero(fill[place]):
            yield (
                int(row[index]),
                int(start[index] - max(west[index] - 1, 0)),
                int(stop[index] + max(east[index] - 1, 0)),
            )

    def _walls(
        self, view: Float32Array, row: Int64Array, first: Int64Array, way: int
    ) -> Int64Array:
        """Return how many samples from a run its highest wall ends, 0 where there is none."""
        wall = np.zeros(row.size, dtype=np.int64)
        highest = np.full(row.size, self.threshold_m)
        before = np.full(row.size, self.value, dtype=np.float64)
        for step in range(_REACH):
            col = first + way * step
            inside = (col >= 0) & (col < view.shape[1])
            here = view[row, np.where(inside, col, 0)].astype(np.float64)
            here = np.where(inside & np.isfinite(here), here, np.nan)
            with np.errstate(invalid="ignore"):
                higher = here - before > highest
            wall = np.where(higher, step + 1, wall)
            highest = np.where(higher, here - before, highest)
            before = here
        return wall
