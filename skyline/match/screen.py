r"""Screening: a photo against every heading of every place, by matrix products.

Skylines are compared by their rises over 2 degrees, coded as phases (`skyline.store.places`). With
the photo's weighted phases w_q and a place's phases p_b, the score of a turn t is

.. math::

    s_t = \mathrm{Re} \sum_q w_q \overline{p_{q + t}} +
    \frac{\left(\mathrm{Im} \sum_q r_q w_q \overline{p_{q + t}}\right)^2}{2 \sum_q r_q^2 |w_q|}

where r_q is the rate at which a phase changes as the camera rolls. The second term is the gain of
the roll that suits the turn best, to second order, with all rolls equally likely. A roll of 5
degrees adds as much to every rise as a smooth skyline has.

Screening is coarse to fine. A coarse `Screen` compares all places (`screen_places`), and a fine one
compares the best of them again (`rescored`).

A photo sees part of the full turn. The sums of twenty neighbouring turns are therefore one product
of a strip of phases, a little wider than the photo, with a matrix that holds the photo twenty
times, each time one bin farther.

Places come in blocks that may be mapped from a file, and only the best so far are kept, so memory
does not grow with the store.
"""

import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from skyline.angles import angle_between_deg
from skyline.arrays import (
    BoolArray,
    Complex128Array,
    Float32Array,
    Float64Array,
    IntArray,
    Rows,
    UInt8Array,
)
from skyline.match.rays import Rays, on_bins
from skyline.progress import Step, StepProgress, silent
from skyline.store.mapped_places import PlaceSource
from skyline.store.places import PHASE_BINS, RISE_TO_TURN, Places, decode_phases

_TURNS_AT_ONCE = 20
"""Neighbouring turns that one product spans; must divide the number of bins. With more turns, more
of each product is wasted; with fewer, the products are too small to be fast."""
_COARSE_TURNS = 2
"""Bins from one compared turn of a coarse screen to the next; must divide `_TURNS_AT_ONCE`."""
_APART_TURNS = 6
"""Least difference of the best turns of a place: 12 degrees."""
_FLAT_DEG = 0.35
"""A skyline is flat if its rises over 2 degrees deviate by less than this."""
_FLAT_GAIN = 2
"""Gain at which the rises of flat skylines are compared. A greater gain, or one for less flat
skylines, does harm, since a camera's roll grows with it."""
_SLACK = 4
"""Multiple of the wanted number of places that is kept before the worst are dropped."""
_BLOCKS_AT_ONCE = 16
"""Blocks that a thread takes. With one, two threads spend half their time waiting for the GIL."""
_PLACES_AT_ONCE = 1024
"""Places that a coarse screen compares together, so that memory does not grow with their number.
Fewer are padded to this number: a product of matrices of another shape may round differently, and
a score must not depend on the places that are scored with it."""
CHOSEN_AT_ONCE = 128
"""Places that a fine screen compares together, padded likewise. They are the best ones, which may
be few in each shard."""


Scores = Callable[[UInt8Array], Float32Array]
"""Returns the scores (N,) of phases (N, B): `Screen.scores`, or a sum of several."""


@dataclass(frozen=True, slots=True, eq=False)
class Alike(Rows):
    """K places, and how like a photo's their skylines are.

    Attributes
    ----------
    row : (K,) intp
        Row of the place in its source.
    score : (K,) float32
        Score of the best turn, in standard deviations above the mean of all turns, less the
        penalty of its field of view; higher is better.
    """

    row: IntArray
    score: Float32Array

    def best(self, count: int | None = None) -> "Alike":
        """Return the best ``count`` places, by default all, best first.

        Places of equal score keep the source's order.
        """
        kept = self if count is None else self.cut(count)
        return kept[np.lexsort((kept.row, -kept.score))]

    def cut(self, count: int) -> "Alike":
        """Return the best ``count`` places, in no order.

        To sort all places would take much longer.
        """
        if not 0 < count < len(self):
            return self if count else self[:0]
        least = np.partition(self.score, -count)[-count]
        chosen = self.score > least
        tied = np.flatnonzero(self.score == least)
        first = np.argsort(self.row[tied], kind="stable")[: count - chosen.sum()]
        chosen[tied[first]] = True
        return self[chosen]

    @classmethod
    def joined(cls, parts: list["Alike"]) -> "Alike":
        """Return the places of several parts of a source, unsorted."""
        none = cls(np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.float32))
        return cls.concatenate([none, *parts])


@dataclass(frozen=True, slots=True, eq=False)
class AlikePlaces(Rows):
    """N places that a search compares, and their likeness to a photo.

    Attributes
    ----------
    easting_m, northing_m : (N,) float64
        In the frame of the area.
    tolerance_m : (N,) float64
        Half the side of the square that a place represents.
    score : (N,) float64
        Scores of screening; more is better.
    """

    easting_m: Float64Array
    northing_m: Float64Array
    tolerance_m: Float64Array
    score: Float64Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Turns(Rows):
    """The best C turns of each of N places, best first."""

    grid_heading_deg: Float64Array
    """(N, C) float64. Of the optical axis, from grid north."""
    fov_index: IntArray
    """(N, C) intp. Index into the screen's fields of view."""
    score: Float32Array
    """(N, C) float32. Score of the turn; -inf where no open turn is left."""


class Screen:
    """A photo at F assumed fields of view, ready to be compared.

    It can be compared with any number of places. Scores of fields of view are made comparable by
    their mean and deviation over all turns of a sample of places.

    Parameters
    ----------
    rays : Rays
    fovs_deg : (F,) float64
    sample : Places
    open_turns : (B,) bool, optional
        The turns that are searched; by default all.
    penalty : (F,) float64, optional
        Loss of the scores at each field of view, in deviations; by default none.
    coarse : bool
        Whether only every other turn is compared, with a level camera: a quarter of the work. These
        are the even turns at half of the places and the odd ones at the others, so that some of the
        places near the right one are compared at the right turn, whichever it is. A coarse screen
        gives scores, and no best turns.
    """

    def __init__(
        self,
        rays: Rays,
        fovs_deg: Float64Array,
        sample: Places,
        open_turns: BoolArray | None = None,
        penalty: Float64Array | None = None,
        *,
        coarse: bool = False,
    ) -> None:
        self._turn_step = _COARSE_TURNS if coarse else 1
        self._at_once = _PLACES_AT_ONCE if coarse else CHOSEN_AT_ONCE
        every = np.ones(PHASE_BINS, dtype=bool)
        opened = every if open_turns is None else open_turns
        if coarse:
            # A compared turn, an odd one at half of the places, stands for the ones beside it.
            opened = np.any([np.roll(opened, bins) for bins in (1, 0, -1, -2)], axis=0)
        self.open_turns = opened[:: self._turn_step]
        self._gain = gain_of(rays)
        level = np.stack([waves_of(rays.with_fov(float(fov)), self._gain) for fov in fovs_deg])
        seen = np.flatnonzero(np.abs(level).any(axis=0))
        # Bins from half a turn left of straight ahead.
        first = int(seen[0]) if len(seen) else 0
        last = int(seen[-1]) if len(seen) else 0
        self._first = first
        self._span = last - first + 1
        self._fovs = len(fovs_deg)
        # (1 or 2, 2 (span + 19), F T) float32. The photo at F fields of view and at T turns,
        # the compared ones of 20; then, unless the screen is coarse, its derivative by roll, scaled
        # so that the square of its product is the gain of a roll.
        waves = np.stack([level] if coarse else [level, _rolled(level, self._gain)])
        self._matrices = _at_turns(waves[:, :, first : last + 1], self._turn_step)
        self.mean, self.scale = self._standard(sample.phase, penalty)

    def _standard(
        self, phase: UInt8Array, penalty: Float64Array | None
    ) -> tuple[Float32Array, Float32Array]:
        """Return the mean and the scale (F,) that make scores of sums.

        A sum less the mean, times the scale, is a score.
        """
        sums = self._every_turn(phase)
        mean = sums.mean(axis=(0, 2), dtype=np.float64).astype(np.float32)
        deviation = sums.std(axis=(0, 2), dtype=np.float64).astype(np.float32)
        if penalty is not None:
            mean += (penalty * deviation).astype(np.float32)
        return mean, np.divide(1.0, deviation, out=np.zeros_like(deviation), where=deviation > 0.0)

    def scores(self, phase: UInt8Array) -> Float32Array:
        """Return the score (N,) of the best turn and field of view.

        The phases are (N, B).
        """
        parts = range(0, len(phase), self._at_once)
        found = (self._scores(phase[k : k + self._at_once]) for k in parts)
        return np.concatenate([np.zeros(0, dtype=np.float32), *found])

    def _scores(self, phase: UInt8Array) -> Float32Array:
        """Return `scores` of places that are compared together."""
        opened = self.open_turns.reshape(PHASE_BINS // _TURNS_AT_ONCE, -1)
        parts = np.flatnonzero(opened.any(axis=1))
        if self._turn_step > 1:
            phase = _at_odd_turns(phase)
        filled = _filled(phase, self._at_once)
        sums = self._sums(filled, slice(None) if len(parts) == len(opened) else parts)
        if not opened.all():
            sums += np.where(opened[parts], np.float32(0.0), -np.inf)[:, np.newaxis, np.newaxis]
        # The copy puts the turns first, along which numpy then finds maxima ten times as fast.
        best = np.ascontiguousarray(sums.max(axis=0, initial=-np.inf).T)
        peak = best.max(axis=0).T[: len(phase)]
        return np.asarray(((peak - self.mean) * self.scale).max(axis=1), dtype=np.float32)

    def best_turns(self, phase: UInt8Array, count: int) -> Turns:
        """Return the best turns of places with phases (N, B).

        They are at least `_APART_TURNS` from better ones. Where no open turn is left, the best one
        is returned again.
        """
        sums = self._every_turn(_filled(phase, CHOSEN_AT_ONCE))[: len(phase)]
        score = (sums - self.mean[:, np.newaxis]) * self.scale[:, np.newaxis]
        left = score.max(axis=1)
        left[:, ~self.open_turns] = -np.inf
        row = np.arange(len(phase))
        turn = np.zeros((len(phase), count), dtype=np.intp)
        peak = np.zeros(turn.shape, dtype=np.float32)
        near = np.arange(1 - _APART_TURNS, _APART_TURNS)
        for k in range(count):
            best = left.argmax(axis=1)
            peak[:, k] = left[row, best]
            turn[:, k] = np.where(peak[:, k] > -np.inf, best, turn[:, 0])
            left[row[:, np.newaxis], (turn[:, [k]] + near) % PHASE_BINS] = -np.inf
        # Only at these turns: an argmax of all takes as long as the product of matrices.
        fov_index = np.take_along_axis(score, turn[:, np.newaxis], axis=2).argmax(axis=1)
        return Turns(grid_heading_deg=turn_grid_heading_deg(turn), fov_index=fov_index, score=peak)

    def _every_turn(self, phase: UInt8Array) -> Float32Array:
        """Return the sums (N, F, B) at every turn."""
        sums = self._sums(phase, slice(None)).transpose(1, 2, 0, 3)
        return sums.reshape(len(phase), self._fovs, len(self.open_turns))

    def _sums(self, phase: UInt8Array, parts: slice | IntArray) -> Float32Array:
        """Return the sums (C, N, F, T) at runs of T turns."""
        wanted = PHASE_BINS + self._span - 1
        strip = np.concatenate([phase[:, self._first :], phase, phase], axis=1)[:, :wanted]
        waves = decode_phases(strip, self._gain).view(np.float32)
        runs = sliding_window_view(waves, self._matrices.shape[1], axis=1)[:, :: 2 * _TURNS_AT_ONCE]
        # The derivative has a product of its own. In a joint product its sums would lie apart, and
        # squaring them would take as long again.
        level, *rolled = np.matmul(runs[:, parts].transpose(1, 0, 2), self._matrices[:, np.newaxis])
        for change in rolled:
            np.square(change, out=change)
            level += change
        turns = _TURNS_AT_ONCE // self._turn_step
        return np.reshape(level, (len(level), len(phase), self._fovs, turns))


def _at_odd_turns(phase: UInt8Array) -> UInt8Array:
    """Return phases (N, B), turned by a bin at half the places.

    The places are as if drawn by lot: the parity of a place's own phases decides.
    """
    is_odd = np.add.reduce(phase, axis=1, dtype=np.uint8) % 2 == 1
    return np.where(is_odd[:, np.newaxis], np.roll(phase, -1, axis=1), phase)


def _filled(phase: UInt8Array, count: int) -> UInt8Array:
    """Return phases (N, B), followed by unknown ones up to ``count`` rows."""
    return np.pad(phase, ((0, max(0, count - len(phase))), (0, 0)))


def _rolled(level: Complex128Array, gain: int) -> Complex128Array:
    """Return the scaled derivative of waves (F, B) by roll; see `Screen`."""
    azimuth = np.radians((np.arange(PHASE_BINS + 1) - PHASE_BINS // 2) * (360.0 / PHASE_BINS))
    # Derivatives (B,) of the phases of level rays' rises by roll, radians per radian.
    growth = gain * RISE_TO_TURN * np.diff(np.sin(azimuth))
    stiff = np.abs(level) @ np.square(growth)
    scale = np.sqrt(np.divide(0.5, stiff, out=np.zeros_like(stiff), where=stiff > 0.0))
    return np.asarray(1j * scale[:, np.newaxis] * growth * level)


def _at_turns(waves: Complex128Array, step: int) -> Float32Array:
    """Return matrices that hold waves at some of 20 turns.

    The waves are (P, F, S), and the matrices (P, 2 (S + 19), F T), for every ``step``-th turn.
    """
    kinds, fovs, span = waves.shape
    turns = range(0, _TURNS_AT_ONCE, step)
    bins = span + _TURNS_AT_ONCE - 1
    matrices = np.zeros((kinds, bins, 2, fovs, len(turns)), dtype=np.float32)
    for column, turn in enumerate(turns):
        matrices[:, turn : turn + span, 0, :, column] = waves.real.swapaxes(1, 2)
        matrices[:, turn : turn + span, 1, :, column] = waves.imag.swapaxes(1, 2)
    return matrices.reshape(kinds, 2 * bins, -1)


def gain_of(rays: Rays) -> int:
    """Return the gain at which a photo's rises are compared; see `decode_phases`.

    The rises of a flat skyline differ so little that nearly all places seem alike, unless omega is
    larger.
    """
    rise, _ = _rises(rays)
    known = rise[np.isfinite(rise)]
    is_flat = len(known) and known.std() < math.radians(_FLAT_DEG)
    return _FLAT_GAIN if is_flat else 1


def waves_of(rays: Rays, gain: int = 1) -> Complex128Array:
    """Return weight * exp(i gain phase) (B,) of level rays' rises.

    It is 0 where the photo sees nothing. Bin B / 2 is straight ahead.
    """
    rise, weight = _rises(rays)
    known = np.isfinite(rise)
    weight = np.minimum(weight, np.roll(weight, -1)) * known
    return np.asarray(weight * np.exp(1j * gain * RISE_TO_TURN * np.where(known, rise, 0.0)))


def _rises(rays: Rays) -> tuple[Float64Array, Float64Array]:
    """Return the rises (B,) of level rays by bin, and the trust.

    Unknown rises are NaN.
    """
    y, trust = on_bins(rays, 0.0, PHASE_BINS)
    rise = np.roll(y, -1) - y
    # The neighbour of the last bin is the first one, behind the camera.
    rise[-1] = np.nan
    return rise, trust


def turn_grid_heading_deg(turn: IntArray) -> Float64Array:
    """Return the grid headings of turns, degrees in [0, 360)."""
    return np.asarray((turn + PHASE_BINS // 2 + 0.5) * (360.0 / PHASE_BINS) % 360.0)


def turns_within(grid_heading_deg: float, slack_deg: float) -> BoolArray:
    """Mark the turns (B,) that lie near a grid heading.

    They lie within ``slack_deg`` plus a turn's width of it.
    """
    axis_deg = turn_grid_heading_deg(np.arange(PHASE_BINS))
    off_deg = angle_between_deg(axis_deg, grid_heading_deg)
    return np.asarray(off_deg <= slack_deg + 360.0 / PHASE_BINS)


def screen_places(
    scores: Scores,
    source: PlaceSource,
    count: int,
    contains: Callable[[Places], BoolArray],
    report: StepProgress = silent,
) -> Alike:
    """Return the best ``count`` places of a source, best first.

    ``contains`` marks the places (N,) of a block that are searched. If they are fewer, all are
    returned.
    """

    def scored(blocks: list[tuple[int, Places]]) -> tuple[Alike, int]:
        rows = []
        phases = []
        for start, places in blocks:
            chosen = np.flatnonzero(contains(places))
            rows.append(start + chosen)
            phases.append(places.phase if len(chosen) == len(places) else places.phase[chosen])
        row = np.concatenate([np.zeros(0, dtype=np.intp), *rows])
        found = Alike(row, scores(np.concatenate(phases))) if len(row) else Alike.joined([])
        return found, sum(len(places) for _, places in blocks)

    batches = _batches(source)
    kept = []
    least = -np.inf
    seen = 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # A few batches are in work at a time, so that memory does not grow with the store.
        ahead = [pool.submit(scored, batch) for batch in islice(batches, 2 * (os.cpu_count() or 1))]
        while ahead:
            found, places = ahead.pop(0).result()
            ahead.extend(pool.submit(scored, batch) for batch in islice(batches, 1))
            seen += places
            report(Step.SCREENING, seen / max(len(source), 1))
            kept.append(found[found.score >= least])
            if sum(map(len, kept)) > _SLACK * count:
                kept = [Alike.joined(kept).cut(count)]
                least = float(kept[0].score.min())
    return Alike.joined(kept).best(count)


def rescored(scores: Scores, source: PlaceSource, rows: IntArray) -> Float32Array:
    """Return the scores (M,) of places, in the order of their rows.

    The rows are read in the order of the source, which may be a file.
    """
    order = np.argsort(rows, kind="stable")
    read = rows[order]
    parts = range(0, len(read), _PLACES_AT_ONCE)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = pool.map(lambda k: scores(source.phases(read[k : k + _PLACES_AT_ONCE])), parts)
        score = np.zeros(len(rows), dtype=np.float32)
        score[order] = np.concatenate([score[:0], *found])
    return score


def _batches(source: PlaceSource) -> Iterator[list[tuple[int, Places]]]:
    """Yield lists of blocks with their first rows, each for a thread."""
    batch = []
    first = 0
    for places in source.blocks():
        batch.append((first, places))
        first += len(places)
        if len(batch) == _BLOCKS_AT_ONCE:
            yield batch
            batch = []
    yield batch
