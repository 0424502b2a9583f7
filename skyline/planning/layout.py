"""Whole layouts of viewpoints: as few as cover what is asked, were the predicted areas true.

A rendering cannot be taken back, so the layout is planned before the first of them. Choosing the
fewest of given areas that cover a share of the ground is submodular covering: greedy choice is
within a logarithm of the best, and in practice a quarter above it, because early choices leave
gaps that fit nothing well. So greedy is where a layout starts. It is then annealed: viewpoints
step to neighbouring candidates, many that do not touch each other at a time; one that has become
superfluous is dropped, and one that earns least is moved to where most is uncovered.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Int64Array
from skyline.coverage import CandidateGrid

Int32Array = NDArray[np.int32]

_SLACK = 1
"""How far apart two areas are to be, in candidates, for their viewpoints to move together."""

_OVERLAP_COST = 0.05
"""What covering a candidate once more costs: between equals, the layout that overlaps less."""

_SWEEPS_A_GROUPING = 8
_SWEEPS_A_RELOCATION = 4
_LOOKED_AT_AGAIN = 16
_STEPS = np.array([(0, 0), (-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)])


@dataclass(frozen=True, slots=True)
class Annealing:
    """How long and how hot layouts are annealed.

    Attributes
    ----------
    sweeps : int
        How often each viewpoint may move.
    hot, cold : float
        First and last temperature, in units of the square root of an area's size: what counts is
        an area's rim, and that is how it grows.
    """

    sweeps: int = 120
    hot: float = 0.3
    cold: float = 0.02


class Areas:
    """Tolerance areas of all candidates, as lists of the candidates inside.

    Parameters
    ----------
    grid : CandidateGrid
    masks : (rows * cols, K, K) bool
        Areas; those of candidates that may not be chosen are empty.
    weight : (rows * cols) int32
        What covering a candidate is worth; 0 leaves it out.
    """

    def __init__(self, grid: CandidateGrid, masks: BoolArray, weight: Int32Array) -> None:
        rows, cols = grid.shape
        reach = grid.reach
        self.shape = (rows, cols)
        kept = np.pad((weight > 0).reshape(rows, cols), reach)
        windows = np.lib.stride_tricks.sliding_window_view(kept, (grid.window, grid.window))
        inside = (masks.reshape(rows, cols, grid.window, grid.window) & windows).reshape(
            rows * cols, -1
        )
        step = np.arange(-reach, reach + 1)
        offset = (step[:, None] * cols + step).ravel().astype(np.int32)
        flat = np.flatnonzero(inside)
        candidate, place = np.divmod(flat, inside.shape[1])
        self.cells: Int32Array = (candidate + offset[place]).astype(np.int32)
        self.length = np.count_nonzero(inside, axis=1)
        self.start = np.cumsum(self.length) - self.length
        self.weight = weight
        self.size = np.maximum(np.count_nonzero(masks, axis=(1, 2)), 1)
        self.extent = np.stack(
            [_extent(np.any(masks, axis=2)), _extent(np.any(masks, axis=1))], axis=2
        )
        self.worth = self.sums(weight, np.arange(len(self.size)))
        self.scouts = self._scouts()
        self._scout_cells = self.of(self.scouts)

    def _scouts(self) -> Int64Array:
        """Return candidates close enough together for a good place not to be missed.

        Where areas are large it makes no difference whether a viewpoint stands on one candidate or
        the next: a stride of a quarter of an area's radius is kept to.
        """
        row, col = np.divmod(np.arange(len(self.size)), self.shape[1])
        stride = 1 << np.clip(np.log2(self.size / 25.0) / 2.0, 0, 3).astype(np.int64)
        chosen = (row % stride == 0) & (col % stride == 0) & (self.length > 0)
        return np.flatnonzero(chosen)

    def scout_sums(self, values: Int32Array) -> Int64Array:
        """Return the sums of values (rows * cols) over the areas of the scouts."""
        return _sums(values[self._scout_cells], self.length[self.scouts])

    def of(self, candidates: Int64Array) -> Int32Array:
        """Return the cells of the areas of candidates (N), one area after the other."""
        return self.cells[_ranges(self.start[candidates], self.length[candidates])]

    def sums(self, values: Int32Array, candidates: Int64Array) -> Int64Array:
        """Return the sums of values (rows * cols) over the areas of candidates (N)."""
        return _sums(values[self.of(candidates)], self.length[candidates])


def _extent(profile: BoolArray) -> Int64Array:
    """Return how far profiles (N, K) reach before and after their middle, (N, 2)."""
    reach = profile.shape[1] // 2
    first, last = profile.argmax(axis=1), profile[:, ::-1].argmax(axis=1)
    return np.stack([reach - first, reach - last], axis=1)


def _ranges(start: Int64Array, length: Int64Array) -> Int64Array:
    """Return start[0] .. start[0] + length[0] - 1, then the next, in one array."""
    before = np.cumsum(length) - length
    return np.repeat(start - before, length) + np.arange(int(length.sum()))


def _sums(values: Int32Array, length: Int64Array) -> Int64Array:
    """Return the sums of consecutive stretches of values; empty ones are 0."""
    start = np.cumsum(length) - length
    # reduceat would give an empty stretch the value that follows it, which there need not be.
    sums = np.add.reduceat(np.append(values, np.int32(0)), start, dtype=np.int64)
    return np.where(length > 0, sums, 0)


class Layout:
    """Viewpoints to be rendered, on top of what is covered already.

    Parameters
    ----------
    areas : Areas
    covered : (rows * cols) bool
        What needs no more covering.
    barred : (rows * cols) bool
        Candidates that may not be chosen, for instance because they have been rendered.
    target : int
        The weight to cover, of what is not covered.
    generator : numpy.random.Generator

    Attributes
    ----------
    sites : (N,) int64
        The viewpoints, as candidates.
    """

    def __init__(
        self,
        areas: Areas,
        covered: BoolArray,
        barred: BoolArray,
        target: int,
        generator: np.random.Generator,
    ) -> None:
        self._areas = areas
        self._generator = generator
        self._barred = barred | (areas.length == 0)
        self._count = covered.astype(np.int64)
        self._open = np.where(covered, 0, areas.weight).astype(np.int32)
        self._enough = int(self._open.sum()) - target
        self.sites = np.zeros(0, dtype=np.int64)

    @property
    def reaches_target(self) -> bool:
        """Whether no more is left open than may be."""
        return int(self._open.sum()) <= self._enough

    def place(self, sites: Int64Array) -> None:
        """Add given viewpoints (N)."""
        if len(sites):
            self._add(sites)
            self.sites = np.concatenate([self.sites, sites])

    def start_greedily(self) -> None:
        """Add viewpoints, always the one that covers most, until the target is reached.

        Gains only ever fall, so a gain found earlier is an upper bound: a candidate whose bound
        is stale is looked at again, and taken if it is still the best.
        """
        areas, scouts = self._areas, self._areas.scouts
        bound = self._scout_gains()
        few = min(_LOOKED_AT_AGAIN, len(bound))
        while not self.reaches_target:
            top = np.argpartition(bound, -few)[-few:]
            bound[top] = np.where(self._barred[scouts[top]], 0, areas.sums(self._open, scouts[top]))
            best = top[np.argmax(bound[top])]
            if bound[best] < bound.max():
                continue
            if bound[best] > 0:
                self.place(scouts[[best]])
            else:
                # What is left lies between the scouts: it is covered from where it is.
                self.place(np.flatnonzero(self._open)[:1])

    def apart(self) -> Int64Array:
        """Return the places in `sites` of the largest group of viewpoints that do not touch."""
        return np.sort(max(self._groups(), key=len)) if len(self.sites) else self.sites

    def anneal(self, annealing: Annealing) -> None:
        """Move and drop viewpoints; the fewest that reached the target are kept."""
        fewest, grouped = self.sites, -1
        self._drop()
        for sweep in range(annealing.sweeps):
            if not len(self.sites):
                break
            cooling = sweep / annealing.sweeps
            heat = annealing.hot * (annealing.cold / annealing.hot) ** cooling
            if sweep % _SWEEPS_A_GROUPING == 0 or len(self.sites) != grouped:
                groups, grouped = self._groups(), len(self.sites)
            for group in groups:
                self._move(group, heat)
            if self.reaches_target:
                fewest = self.sites.copy()
                self._drop()
            if sweep % _SWEEPS_A_RELOCATION == 0 and len(self.sites):
                self._relocate()
        self._remove(self.sites)
        self.sites = fewest
        self._add(fewest)

    def _add(self, sites: Int64Array) -> None:
        cells = self._areas.of(sites)
        self._count += np.bincount(cells, minlength=self._count.size)
        self._open[cells] = 0

    def _remove(self, sites: Int64Array) -> None:
        cells = self._areas.of(sites)
        self._count -= np.bincount(cells, minlength=self._count.size)
        self._open[cells] = self._areas.weight[cells] * (self._count[cells] == 0)

    def _scout_gains(self) -> Int64Array:
        gain = self._areas.scout_sums(self._open)
        return np.where(self._barred[self._areas.scouts], 0, gain)

    def _earned(self) -> Int64Array:
        """Return what each viewpoint alone covers."""
        alone = np.where(self._count == 1, self._areas.weight, 0).astype(np.int32)
        return self._areas.sums(alone, self.sites)

    def _drop(self) -> None:
        """Drop viewpoints, those that earn least first, until the target is missed."""
        while self.reaches_target and len(self.sites):
            least = int(np.argmin(self._earned()))
            self._remove(self.sites[[least]])
            self.sites = np.delete(self.sites, least)

    def _relocate(self) -> None:
        """Move the viewpoint that earns least to where most is uncovered, if that is more."""
        least = int(np.argmin(self._earned()))
        self._remove(self.sites[[least]])
        gain = self._scout_gains()
        best = int(np.argmax(gain))
        if gain[best] > self._areas.sums(self._open, self.sites[[least]])[0]:
            self.sites[least] = self._areas.scouts[best]
        self._add(self.sites[[least]])

    def _groups(self) -> list[Int64Array]:
        """Split the viewpoints into groups whose areas do not touch now, in random order."""
        order = self._generator.permutation(len(self.sites))
        sites = self.sites[order]
        place = np.stack(np.divmod(sites, self._areas.shape[1]), axis=1)
        first = place - self._areas.extent[sites, 0] - _SLACK
        last = place + self._areas.extent[sites, 1] + _SLACK
        touches = ((first[:, None] <= last) & (first <= last[:, None])).all(axis=2)
        group = np.full(len(sites), -1)
        for one, neighbours in enumerate(touches):
            taken = set(group[neighbours].tolist())
            group[one] = next(number for number in range(len(sites)) if number not in taken)
        return [order[group == number] for number in range(group.max() + 1)]

    def _move(self, group: Int64Array, heat: float) -> None:
        """Let viewpoints step to one of eight neighbours or stay, by the heat-bath rule."""
        areas, generator = self._areas, self._generator
        rows, cols = areas.shape
        sites = self.sites[group]
        self._remove(sites)
        root = np.sqrt(areas.size[sites])
        stride = 1 + (generator.random(len(sites)) ** 2 * root / 4.0).astype(np.int64)
        row, col = np.divmod(sites, cols)
        to_row = row[:, None] + stride[:, None] * _STEPS[:, 0]
        to_col = col[:, None] + stride[:, None] * _STEPS[:, 1]
        inside = (to_row >= 0) & (to_row < rows) & (to_col >= 0) & (to_col < cols)
        to = np.where(inside, to_row * cols + to_col, sites[:, None])
        gain = areas.sums(self._open, to.ravel()).reshape(to.shape)
        overlap = areas.worth[to] - gain
        score = gain - _OVERLAP_COST * overlap
        score += generator.gumbel(size=to.shape) * (heat * root)[:, None]
        chosen = np.argmax(np.where(self._barred[to], -np.inf, score), axis=1)
        self.sites[group] = to[np.arange(len(to)), chosen]
        self._add(self.sites[group])
