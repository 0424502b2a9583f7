r"""Screening: every heading of every place against a query, by products of matrices.

What is compared are rises of a skyline over 2 degrees as phases (`skyline.store.places`). With
the query's weighted phases w_q and a place's phases p_b, the score of a turn t is

.. math::

    s_t = \mathrm{Re} \sum_q w_q \overline{p_{q + t}} +
    \frac{\left(\mathrm{Im} \sum_q r_q w_q \overline{p_{q + t}}\right)^2}{2 \sum_q r_q^2 |w_q|}

where r_q is how fast a phase changes as the camera rolls: the second term is what the roll that
suits the turn best gains, to second order, as if all rolls were as likely. A roll of 5 degrees
adds to every rise as much as a smooth skyline has.

A photo sees a part of the turn, so each sum at twenty turns at once is the product of a strip of
phases, a little wider than the photo, with a matrix that holds the query twenty times, each a bin
farther.
Places come in blocks that may be mapped from a file, and only the best so far are kept: memory
does not grow with the store.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Float64Array, IntArray, Rows, UInt8Array
from skyline.geodesy import in_turn
from skyline.match.progress import tell
from skyline.match.query_rays import Attitudes, QueryCurves, QueryRays
from skyline.store.places import PHASE_BINS, RISE_TO_TURN, Places, PlaceSource, decode_phases

Within = Callable[[Places], BoolArray]
"""Which of a block's places (N,) are searched."""
Scores = Callable[[UInt8Array], Float32Array]
"""How alike places of phases (N, B) are to what is looked for, (N,): `Screen.scores`, or a sum."""

_TURNS_AT_ONCE = 20
"""Must divide the bins. More waste products, fewer make small ones."""
_SAMPLE = 2048
"""Places that say how the scores of a query are spread by chance."""
_SLACK = 4
"""So many times as many places as are wanted are kept before the worst are dropped."""
_BLOCKS_AT_ONCE = 16
"""That a thread takes. With one at a time, two threads wait for the interpreter half the time."""
_PLACES_AT_ONCE = 1024
"""Scored together: what is held does not grow with how many are asked for."""


@dataclass(frozen=True, slots=True, eq=False)
class Alike(Rows):
    """The K places most like a query, best first.

    Attributes
    ----------
    row : (K,) intp
        In the source.
    score : (K,) float32
        Standard deviations of the best turn above the mean of all turns, less what its field of
        view is unlikely; higher is better.
    """

    row: IntArray
    score: Float32Array

    def best(self, count: int) -> "Alike":
        """Return the best; of equals those that come first in the source."""
        return self[np.lexsort((self.row, -self.score))[:count]]

    @classmethod
    def joined(cls, parts: list["Alike"]) -> "Alike":
        """Return places of several parts of a source as one list, not sorted."""
        none = cls(np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.float32))
        return cls.concatenate([none, *parts])


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """A query, ready to be compared with any number of places."""

    first: int
    """The bin, from half a turn left of straight ahead, where the query begins."""
    span: int
    """Bins it is wide."""
    matrices: Float32Array
    """(2, 2 (span + T - 1), F T) float32. The query at F fields of view and T turns, and how it
    changes as the camera rolls: scaled so that the square of what the second gives is what a roll
    gains."""
    open_turns: BoolArray
    """(B,) bool. The turns that are looked at."""
    mean: Float32Array
    scale: Float32Array
    """``mean``, ``scale``: (F,) float32. What is taken off scores, and what the rest is multiplied
    by: then they are deviations above the mean of all turns, less what a field of view is
    unlikely."""

    @classmethod
    def of(
        cls,
        query: QueryRays,
        fovs_deg: Float64Array,
        sample: Places,
        open_turns: BoolArray | None = None,
        unlikely: Float64Array | None = None,
    ) -> "Screen":
        """Prepare a query at fields of view (F,) to assume.

        Their scores are made comparable by how those of all turns of a sample of places are spread,
        and each loses as many deviations as it is ``unlikely`` (F,). All turns are open by default;
        see `turns_within`.
        """
        level = np.stack([query_waves(query.with_fov(float(fov))) for fov in fovs_deg])
        seen = np.flatnonzero(np.abs(level).any(axis=0))
        first, last = (int(seen[0]), int(seen[-1])) if len(seen) else (0, 0)
        matrices = _at_turns(np.stack([level, _rolled(level)])[:, :, first : last + 1])
        every = np.ones(PHASE_BINS, dtype=bool)
        none = np.zeros(len(fovs_deg), dtype=np.float32)
        opened = every if open_turns is None else open_turns
        raw = cls(first, last - first + 1, matrices, opened, none, none + 1)
        sums = raw._every_turn(sample.phase)
        mean = sums.mean(axis=(0, 2), dtype=np.float64).astype(np.float32)
        deviation = sums.std(axis=(0, 2), dtype=np.float64).astype(np.float32)
        if unlikely is not None:
            mean += (unlikely * deviation).astype(np.float32)
        scale = np.divide(1.0, deviation, out=np.zeros_like(deviation), where=deviation > 0.0)
        return replace(raw, mean=mean, scale=scale)

    def scores(self, phase: UInt8Array) -> Float32Array:
        """Return the score (N,) of the best turn and field of view of places' phases (N, B)."""
        parts = range(0, max(len(phase), 1), _PLACES_AT_ONCE)
        return np.concatenate([self._scores(phase[k : k + _PLACES_AT_ONCE]) for k in parts])

    def _scores(self, phase: UInt8Array) -> Float32Array:
        opened = self.open_turns.reshape(-1, _TURNS_AT_ONCE)
        parts = np.flatnonzero(opened.any(axis=1))
        sums = self._sums(phase, slice(None) if len(parts) == len(opened) else parts)
        if not opened.all():
            sums += np.where(opened[parts], np.float32(0.0), -np.inf)[:, np.newaxis, np.newaxis]
        peak = _peaks(sums.max(axis=0, initial=-np.inf))
        return np.asarray(((peak - self.mean) * self.scale).max(axis=1), dtype=np.float32)

    def best_turns(self, phase: UInt8Array) -> tuple[Float64Array, IntArray]:
        """Return heading_deg (N,) and index of the field of view (N,) of places' best turns.

        The heading is the grid azimuth of the query's optical axis.
        """
        sums = self._every_turn(phase)
        sums[:, :, ~self.open_turns] = -np.inf
        score = (sums - self.mean[:, np.newaxis]) * self.scale[:, np.newaxis]
        flat = score.reshape(len(phase), len(self.mean) * PHASE_BINS)
        fov, turn = np.divmod(flat.argmax(axis=1), PHASE_BINS)
        return turn_heading_deg(turn), fov

    def _every_turn(self, phase: UInt8Array) -> Float32Array:
        """Return the sums (N, F, B) of places at every turn."""
        sums = self._sums(phase, slice(None)).transpose(1, 2, 0, 3)
        return sums.reshape(len(phase), len(self.mean), PHASE_BINS)

    def _sums(self, phase: UInt8Array, parts: slice | IntArray) -> Float32Array:
        """Return the sums (C, N, F, T) of places at some of the B / T runs of T turns."""
        wanted = PHASE_BINS + self.span - 1
        strip = np.concatenate([phase[:, self.first :], phase, phase], axis=1)[:, :wanted]
        waves = decode_phases(strip).view(np.float32)
        met = sliding_window_view(waves, self.matrices.shape[1], axis=1)[:, :: 2 * _TURNS_AT_ONCE]
        # Two products: halves of one would lie apart, and squaring them takes as long again.
        level, rolled = np.matmul(met[:, parts].transpose(1, 0, 2), self.matrices[:, np.newaxis])
        np.square(rolled, out=rolled)
        level += rolled
        return np.reshape(level, (len(level), len(phase), len(self.mean), _TURNS_AT_ONCE))


def _rolled(level: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return how a query's waves (F, B) change as the camera rolls, scaled; see `Screen`."""
    growth = roll_to_turn()
    stiff = np.abs(level) @ np.square(growth)
    scale = np.sqrt(np.divide(0.5, stiff, out=np.zeros_like(stiff), where=stiff > 0.0))
    return np.asarray(1j * scale[:, np.newaxis] * growth * level)


def _at_turns(waves: NDArray[np.complex128]) -> Float32Array:
    """Return matrices (P, 2 (S + T - 1), F T) that hold waves (P, F, S) at T turns."""
    kinds, fovs, span = waves.shape
    held = np.zeros((kinds, span + _TURNS_AT_ONCE - 1, 2, fovs, _TURNS_AT_ONCE), dtype=np.float32)
    for turn in range(_TURNS_AT_ONCE):
        held[:, turn : turn + span, 0, :, turn] = waves.real.swapaxes(1, 2)
        held[:, turn : turn + span, 1, :, turn] = waves.imag.swapaxes(1, 2)
    return held.reshape(kinds, 2 * (span + _TURNS_AT_ONCE - 1), -1)


def _peaks(sums: Float32Array) -> Float32Array:
    """Return the greatest along the last axis (N, F) of sums (N, F, T).

    The copy puts the axis first, where numpy finds the greatest ten times as fast.
    """
    return np.asarray(np.ascontiguousarray(sums.T).max(axis=0).T)


def query_waves(query: QueryRays) -> NDArray[np.complex128]:
    """Return weight * exp(i phase) (B,) of the query's rises, level; 0 where it is not seen.

    Bin B / 2 is straight ahead.
    """
    curve = QueryCurves.of(query, Attitudes((0.0,)), PHASE_BINS)
    y, weight = curve.y[0], curve.weight[0]
    rise = np.roll(y, -1) - y
    # The last bin's neighbour is the first one, behind the camera.
    rise[-1] = np.nan
    known = np.isfinite(rise)
    weight = np.minimum(weight, np.roll(weight, -1)) * known
    return np.asarray(weight * np.exp(1j * RISE_TO_TURN * np.where(known, rise, 0.0)))


def roll_to_turn() -> Float64Array:
    """Return the radians (B,) that the phases of a query's rises grow by, a radian of roll."""
    azimuth = np.radians((np.arange(PHASE_BINS + 1) - PHASE_BINS // 2) * (360.0 / PHASE_BINS))
    return np.asarray(RISE_TO_TURN * np.diff(np.sin(azimuth)))


def turn_heading_deg(turn: IntArray) -> Float64Array:
    """Return the grid azimuth of the optical axis at turns, degrees in [0, 360)."""
    return np.asarray((turn + PHASE_BINS // 2 + 0.5) * (360.0 / PHASE_BINS) % 360.0)


def turns_within(heading_deg: float, slack_deg: float) -> BoolArray:
    """Return which turns (B,) look within a slack of a grid azimuth, a turn's width added."""
    axis_deg = turn_heading_deg(np.arange(PHASE_BINS))
    off_deg = np.abs(in_turn(axis_deg - heading_deg))
    return np.asarray(off_deg <= slack_deg + 360.0 / PHASE_BINS)


def sample_of(source: PlaceSource) -> Places:
    """Return places evenly from all of a source, the same whoever asks."""
    step = max(1, len(source) // _SAMPLE)
    return source.take(np.arange(0, len(source), step, dtype=np.intp))


def screen_places(
    scores: Scores,
    source: PlaceSource,
    count: int,
    within: Within | None = None,
    part: slice = slice(None),
) -> Alike:
    """Return the best of a source's places, at most so many; none where none is ``within``.

    ``part`` is of the source's blocks, so that several workers can share one source. Joining what
    they find gives what one of them finds alone.
    """
    kept = Alike.joined([])

    def scored(blocks: list[tuple[int, Places]]) -> tuple[Alike, int]:
        parts = []
        for start, places in blocks:
            chosen = np.arange(len(places)) if within is None else np.flatnonzero(within(places))
            if len(chosen):
                phase = places.phase if len(chosen) == len(places) else places.phase[chosen]
                parts.append(Alike(start + chosen, scores(phase)))
        return Alike.joined(parts), sum(len(places) for _, places in blocks)

    waiting: list[Alike] = []
    seen, held, last = 0, 0, max(len(source), 1)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for found, places in _a_few_ahead(pool, scored, _batches(source, part)):
            waiting.append(found)
            seen += places
            held += len(found)
            tell("screening", seen / last)
            if held > _SLACK * count:
                kept = Alike.joined([kept, *waiting]).best(count)
                waiting, held = [], 0
    return Alike.joined([kept, *waiting]).best(count)


def _batches(source: PlaceSource, part: slice) -> Iterator[list[tuple[int, Places]]]:
    """Yield the first row of each block of a part, and the block, as many as a thread takes."""
    start, batch = 0, []
    chosen = range(*part.indices(1 << 40))
    for index, places in enumerate(source.blocks()):
        if index in chosen:
            batch.append((start, places))
        start += len(places)
        if len(batch) == _BLOCKS_AT_ONCE:
            yield batch
            batch = []
    if batch:
        yield batch


def _a_few_ahead(
    pool: ThreadPoolExecutor,
    work: Callable[[list[tuple[int, Places]]], tuple[Alike, int]],
    items: Iterator[list[tuple[int, Places]]],
) -> Iterator[tuple[Alike, int]]:
    """Yield results in order, never with more than a few batches on their way."""
    ahead = [pool.submit(work, item) for item in islice(items, 2 * (os.cpu_count() or 1))]
    while ahead:
        yield ahead.pop(0).result()
        ahead.extend(pool.submit(work, item) for item in islice(items, 1))
