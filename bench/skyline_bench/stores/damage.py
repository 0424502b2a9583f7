"""What can befall a finished store: flipped bits, and files mutated at random."""

from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np

from skyline.errors import SkylineError
from skyline.store import open_store
from skyline.store.header import PLACES
from skyline.store.integrity import examine
from skyline_bench.measuring.workers import outcome_of
from skyline_bench.stores.durability import same_rows


def flip_test(whole: Path, folder: Path, flips: int) -> dict[str, object]:
    """Flip one random bit of a store at a time; look whether it changes data and is found.

    Returns
    -------
    dict
        ``flips``; ``harmless`` ones change nothing that a reader gets; ``harmful`` ones do, or
        keep it from reading; ``found`` of these by `skyline store check`; ``silent`` of these get
        past readers; ``crashes`` and hangs of readers and of the check.
    """
    generator = np.random.default_rng(0)
    data, tally = bytearray(whole.read_bytes()), Counter[str]()
    path = folder / "flipped.h5"
    for _ in range(flips):
        place, bit = int(generator.integers(len(data))), 1 << int(generator.integers(8))
        data[place] ^= bit
        path.write_bytes(data)
        data[place] ^= bit
        read = outcome_of(partial(_read_as, path, whole))
        checked = outcome_of(lambda: "whole" if examine(path).whole else "damaged")
        harmful = read != "same"
        tally["harmful"] += harmful
        tally["found"] += harmful and checked == "damaged"
        tally["silent"] += read == "changed"
        tally["crashes"] += not (read in _ANSWERS and checked in ("whole", "damaged"))
    counts = {name: tally[name] for name in ("harmful", "found", "silent", "crashes")}
    return {"flips": flips, "harmless": flips - tally["harmful"], **counts}


_ANSWERS = ("same", "changed", "refused")


def _read_as(path: Path, whole: Path) -> str:
    """Read a store and return whether it gives what another does."""
    try:
        with open_store(path) as store, open_store(whole) as reference:
            if store.header.holds == PLACES:
                store.places().take(np.arange(len(store)))
            else:
                store.views()
                store.keypoint_columns()
            same = len(store) == len(reference)
        return "same" if same and same_rows(path, whole) else "changed"
    except SkylineError as error:
        return "refused" if "\n" not in str(error) else "more than one line"


def fuzz_test(whole: Path, folder: Path, cases: int) -> dict[str, object]:
    """Read mutated copies of a store; each must be read or be refused in one line.

    Returns
    -------
    dict
        ``cases``; of them ``read``, ``refused``, ``raised`` (a traceback), ``hang`` and ``crash``.
    """
    generator = np.random.default_rng(0)
    data, tally = whole.read_bytes(), Counter[str]()
    path = folder / "mutated.h5"
    for _ in range(cases):
        path.write_bytes(mutated(data, generator))
        answer = outcome_of(partial(_read_as, path, whole), patience_s=30)
        tally["read" if answer in ("same", "changed") else answer] += 1
    names = ("read", "refused", "raised", "hang", "crash")
    return {"cases": cases, **{name: tally[name] for name in names}}


def mutated(data: bytes, generator: np.random.Generator) -> bytes:
    """Return bytes with one kind of random damage, more often than not near their beginning."""
    changed = bytearray(data)

    def place() -> int:
        near = min(len(changed), 16_384) if generator.random() < 0.6 else len(changed)
        return int(generator.integers(near))

    first, length = place(), int(2.0 ** generator.uniform(0.0, 12.0))
    last = min(first + length, len(changed))
    match int(generator.integers(8)):
        case 0:
            for _ in range(int(generator.integers(1, 30))):
                changed[place()] ^= 1 << int(generator.integers(8))
        case 1:
            changed[first:last] = bytes(last - first)
        case 2:
            changed[first:last] = b"\xff" * (last - first)
        case 3:
            changed[first:last] = generator.bytes(last - first)
        case 4:
            other = int(generator.integers(len(changed) - (last - first) + 1))
            changed[first:last] = changed[other : other + last - first]
        case 5:
            changed[first:first] = generator.bytes(length)
        case 6:
            del changed[first:last]
        case _:
            del changed[place() :]
    return bytes(changed)
