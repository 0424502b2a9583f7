"""Occluders: trees, people and buildings, before the mountains, as runs of image columns."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array

Run = tuple[int, int]
"""First column and the one after the last."""

_KINDS = ("tree", "tree", "building", "person")
"""Trees are the most frequent."""
_WIDTH_SHARE = {"tree": (0.02, 0.10), "building": (0.06, 0.20), "person": (0.015, 0.04)}
_RISE_SHARE = {"tree": (0.05, 0.25), "building": (0.03, 0.15), "person": (0.03, 0.12)}
"""How wide they are, and how far above the skyline they reach, as shares of the image's width."""
_NARROWEST_SHARE = 0.015
_ROUGHNESS = {"tree": 0.25, "building": 0.0, "person": 0.03}


@dataclass(frozen=True, slots=True, eq=False)
class Occluder:
    """Something near in a run of columns."""

    kind: str  # tree, building or person
    columns: Run  # First column and the one after the last
    row_px: Float64Array  # (n,); its top in these columns, above the skyline behind it


def random_runs(
    generator: np.random.Generator, width: int, share: float, count: int
) -> tuple[Run, ...]:
    """Return ``count`` runs that do not overlap and hold ``share`` of ``width`` columns."""
    hidden = round(share * width)
    count = min(count, hidden)
    if count == 0:
        return ()
    lengths = 1 + _split(generator, hidden - count, count)
    return _placed(generator, width, lengths)


def random_occluders(
    generator: np.random.Generator, skyline_px: Float64Array, share: float
) -> tuple[Occluder, ...]:
    """Return occluders over ``share`` of the columns of a skyline (W,).

    Where the skyline is not in the picture (NaN), they rise from where it is last seen.
    """
    width = len(skyline_px)
    left = round(share * width)
    kinds: list[str] = []
    lengths: list[int] = []
    while left > 0:
        kind = _KINDS[generator.integers(len(_KINDS))]
        length = round(generator.uniform(*_WIDTH_SHARE[kind]) * width)
        # No sliver is left for a last one.
        if left - length < _NARROWEST_SHARE * width:
            length = left
        kinds.append(kind)
        lengths.append(length)
        left -= length
    runs = _placed(generator, width, np.array(lengths, dtype=np.intp)) if lengths else ()
    behind = _filled(skyline_px)
    return tuple(
        _stand(generator, kind, run, behind) for kind, run in zip(kinds, runs, strict=True)
    )


def _stand(
    generator: np.random.Generator, kind: str, run: Run, behind_px: Float64Array
) -> Occluder:
    """Return an occluder of one kind whose top is above what is behind it."""
    start, stop = run
    across = (2.0 * np.arange(stop - start) + 1.0) / (stop - start) - 1.0
    shape = {"tree": 1.0 - np.abs(across), "person": np.sqrt(1.0 - across**2)}.get(
        kind, np.ones_like(across)
    )
    rise_px = generator.uniform(*_RISE_SHARE[kind]) * len(behind_px)
    rough = 1.0 + _ROUGHNESS[kind] * generator.standard_normal(len(across))
    behind = behind_px[start:stop]
    level = behind.min() if kind == "building" else behind
    return Occluder(kind, run, level - np.maximum(rise_px * shape * rough, 1.0))


def _filled(row_px: Float64Array) -> Float64Array:
    """Return rows (W,) with the unknown ones interpolated; all 0 where none is known."""
    known = np.flatnonzero(np.isfinite(row_px))
    if not known.size:
        return np.zeros_like(row_px)
    return np.interp(np.arange(len(row_px)), known, row_px[known])


def _split(generator: np.random.Generator, total: int, parts: int) -> NDArray[np.intp]:
    """Return whole numbers (parts,) of at least 0 with a given sum, drawn evenly."""
    cuts = np.sort(generator.integers(0, total + 1, parts - 1))
    return np.diff(cuts, prepend=0, append=total).astype(np.intp)


def _placed(
    generator: np.random.Generator, width: int, lengths: NDArray[np.intp] | Sequence[int]
) -> tuple[Run, ...]:
    """Return runs of given lengths in order, with gaps drawn between them."""
    gaps = _split(generator, width - int(np.sum(lengths)), len(lengths) + 1)
    starts = np.cumsum(gaps[:-1]) + np.cumsum(lengths) - lengths
    return tuple(
        (int(start), int(start + length)) for start, length in zip(starts, lengths, strict=True)
    )
