"""What can befall a store: kills and readers while it is built, flipped bits and mutations."""

import mmap
import os
import signal
import struct
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from skyline.errors import SkylineError
from skyline.features import NO_KEYPOINT
from skyline.geodesy import Frame
from skyline.places import BINS, DISTANCE_BINS, PHASE_BINS, Places
from skyline.store import (
    KeypointColumns,
    RowCoding,
    Store,
    StoreHeader,
    StoreWriter,
    as_stored,
    compact_store,
    create_store,
    open_for_append,
    open_store,
)
from skyline.store.header import PLACES
from skyline.store.integrity import examine
from skyline.views import Views
from skyline_bench.measuring.workers import ended, fork, outcome_of

Say = Callable[[int], object]
"""Called with the number of rows that are committed."""

_LONGER = 1.5
"""A build is killed at some time within so many times what it has left."""

Build = Callable[[Path, Say], None]
"""Builds a store at a path, or goes on with the one that is there."""


def numbered_header(width: int = 64, rows: str = "compact") -> StoreHeader:
    """Return the header of a store of numbered rows: "compact", "exact" or "places"."""
    header = StoreHeader(
        frame_wkt=Frame.from_crs("EPSG:32632").wkt,
        dem_digest="0" * 64,
        dem_files=("/dem.tif",),
        config={"planner": "none"},
        renderer="none",
        width=width,
        max_keypoints=8,
        coding=RowCoding.within(width) if rows == "compact" else None,
    )
    return replace(header, holds=PLACES, width=0) if rows == "places" else header


def append_numbered(writer: StoreWriter, stop: int) -> None:
    """Append numbered rows after those that a store holds."""
    start = len(writer)
    if writer.header.holds == PLACES:
        writer.append_places(numbered_places(start, stop))
    else:
        writer.append(*numbered_views(writer.header, start, stop))


def reads_as_numbered(store: Store, rows: slice) -> bool:
    """Whether rows of a store of either kind are the numbered ones."""
    span = np.arange(len(store))[rows]
    if not span.size:
        return True
    start, stop = int(span[0]), int(span[-1]) + 1
    got: Any
    wanted: Any
    if store.header.holds == PLACES:
        got, wanted = store.places().take(span), numbered_places(start, stop)
    else:
        got, wanted = store.views(rows), numbered_views(store.header, start, stop)[0]
    return all(
        np.array_equal(getattr(got, f.name), getattr(wanted, f.name), equal_nan=True)
        for f in fields(wanted)
    )


def numbered_places(start: int, stop: int) -> Places:
    """Return places that say which they are."""
    number = np.arange(start, stop)
    place, row = number.astype(np.float64), number[:, np.newaxis]
    return Places(
        easting_m=7.5e5 + place,
        northing_m=5.2e6 - place / 3.0,
        eye_elevation_m=(1500.0 + place / 7.0).astype(np.float32),
        tolerance_m=np.full(len(number), 25.0, dtype=np.float32),
        first_tan=np.sin(place).astype(np.float32),
        rise=((row * 7 + np.arange(BINS) * 3) % 256).astype(np.uint8).view(np.int8),
        distance=((row + np.arange(DISTANCE_BINS)) % 256).astype(np.uint8),
        phase=((row * 5 + np.arange(PHASE_BINS)) % 256).astype(np.uint8),
    )


def numbered_views(header: StoreHeader, start: int, stop: int) -> tuple[Views, KeypointColumns]:
    """Return views that say which they are, as `header` holds them, and their keypoints."""
    number = np.arange(start, stop)
    place = number.astype(np.float64)
    phase = 0.1 * np.arange(header.width) + number[:, np.newaxis]
    skyline = np.sin(phase).astype(np.float32)
    skyline[number % 5 == 0, 3:7] = np.nan
    keypoints = np.full((len(number), header.max_keypoints), NO_KEYPOINT, dtype=np.uint16)
    keypoints[:, 0] = number % header.width
    views = Views(
        easting_m=7.5e5 + place,
        northing_m=5.2e6 - place / 3.0,
        eye_elevation_m=1500.0 + place / 7.0,
        heading=(number % 4).astype(np.uint8),
        elevation_tan=skyline,
        depth_m=(1000.0 + 900.0 * np.cos(phase)).astype(np.float32),
        flags=((number[:, np.newaxis] + np.arange(header.width)) % 8).astype(np.uint8),
    )
    return as_stored(header, views), keypoints


def numbered_build(rows: int, header: StoreHeader) -> Build:
    """Return a build of numbered rows, committed chunk by chunk as fast as it goes."""

    def build(path: Path, say: Say) -> None:
        there = path.exists()
        with open_for_append(path, header) if there else create_store(path, header) as writer:
            while len(writer) < rows:
                append_numbered(writer, min(len(writer) + header.chunk_rows + 5, rows))
                say(writer.committed)

    return build


def same_rows(path: Path, whole: Path) -> bool:
    """Whether the rows of a store are the first rows of another, to the bit."""
    with open_store(path) as store, open_store(whole) as reference:
        rows = slice(0, len(store))
        if len(store) > len(reference) or store.header != reference.header:
            return False
        wanted = reference.stored(rows)
        return all(wanted[name].tobytes() == got.tobytes() for name, got in store.stored().items())


def kill_test(build: Build, folder: Path, kills: int) -> dict[str, object]:
    """Kill a build at random instants, resume it, kill it again, until enough are dead.

    Return ``kills``; ``opened``, stores that opened afterwards, those killed before there was one
    among them; ``lost``, kills after which rows were missing or changed; ``builds`` that were
    finished between kills, and ``equal`` of them to the unbroken one, to the byte once compacted.
    """
    generator = np.random.default_rng(0)
    whole = folder / "whole.h5"
    lasts_s = np.inf
    for _ in range(3):
        whole.unlink(missing_ok=True)
        started = time.perf_counter()
        _finish(_start(build, whole))
        lasts_s = min(lasts_s, time.perf_counter() - started)
    started = time.perf_counter()
    _finish(_start(build, whole))  # Nothing is left to do.
    starts_s = time.perf_counter() - started
    total = _committed(whole)
    compacted = _compacted(whole)
    tally = Counter(kills=0, opened=0, lost=0, builds=0, equal=0)
    path, said = folder / "killed.h5", 0
    while tally["kills"] < kills:
        child = _start(build, path)
        # Some runs end before they are killed, so that resumed builds are seen to end as well.
        left_s = starts_s + lasts_s * (1.0 - said / total)
        time.sleep(generator.uniform(0.0, _LONGER * left_s))
        os.kill(child[0], signal.SIGKILL)
        code, committed = _finish(child)
        said = max(said, committed)
        if code == 0:
            tally["builds"] += 1
            tally["equal"] += _compacted(path) == compacted
            path.unlink()
            said = 0
            continue
        tally["kills"] += 1
        try:
            rows = _committed(path)
            tally["opened"] += 1
            tally["lost"] += rows < said or (path.exists() and not same_rows(path, whole))
        except SkylineError:
            pass
    _finish(_start(build, path))
    tally["builds"] += 1
    tally["equal"] += _compacted(path) == compacted
    return {**tally, "unbroken_s": lasts_s}


def _committed(path: Path) -> int:
    if not path.exists():
        return 0
    with open_store(path) as store:
        return len(store)


def _compacted(path: Path) -> bytes:
    out = path.with_suffix(".compact")
    compact_store(path, out)
    data = out.read_bytes()
    out.unlink()
    return data


def _start(build: Build, path: Path) -> tuple[int, int]:
    return fork(lambda say: build(path, lambda committed: say(struct.pack("<q", committed))))


def _finish(child: tuple[int, int]) -> tuple[int, int]:
    """Wait for a build; return its exit code and the last number of rows it said."""
    code, said = ended(*child)
    return code, struct.unpack("<q", said[-8:])[0] if said else 0


def readers_test(
    folder: Path, readers: int, seconds: float, rows: str = "compact"
) -> dict[str, object]:
    """Let readers check every row that they see while a writer appends and resumes."""
    header = numbered_header(rows=rows)
    path = folder / "read.h5"
    create_store(path, header).close()
    # What is appended before it is, and what is committed after it is.
    shared = mmap.mmap(-1, 16)
    until = time.monotonic() + seconds

    def write() -> None:
        while time.monotonic() < until:
            with open_for_append(path, header) as writer:
                for _ in range(50):
                    stop = len(writer) + header.chunk_rows + 11
                    shared[:8] = struct.pack("<q", stop)
                    append_numbered(writer, stop)
                    shared[8:] = struct.pack("<q", writer.committed)
                    time.sleep(0.002)

    def read(seed: int) -> str:
        generator, opened, errors = np.random.default_rng(seed), 0, 0
        while time.monotonic() < until:
            (committed,) = struct.unpack("<q", shared[8:])
            with open_store(path) as store:
                (appended,) = struct.unpack("<q", shared[:8])
                errors += not committed <= len(store) <= appended
                first = int(generator.integers(0, max(len(store) - 200, 1)))
                rows = slice(first, first + 200) if opened % 2 else slice(-200, None)
                errors += not reads_as_numbered(store, rows)
            opened += 1
        return f"{opened} {errors}"

    writer = fork(lambda _: write())
    with ThreadPoolExecutor(readers) as pool:
        patience_s = int(seconds) + 60
        said = list(pool.map(lambda n: outcome_of(partial(read, n), patience_s), range(readers)))
    code, _ = ended(*writer)
    counts = [tuple(map(int, answer.split())) for answer in said if answer[:1].isdigit()]
    return {
        "readers": readers,
        "seconds": seconds,
        "opened": sum(opened for opened, _ in counts),
        "rows": _committed(path),
        "failed_readers": len(said) - len(counts),
        "wrong": sum(errors for _, errors in counts),
        "writer_failed": code != 0,
    }


def flip_test(whole: Path, folder: Path, flips: int) -> dict[str, object]:
    """Flip one random bit of a store at a time; look whether it changes data and is found.

    Of the ``flips``, ``harmless`` ones change nothing that a reader gets; ``harmful`` ones do, or
    keep it from reading. ``found`` of these are by `skyline store check`; ``silent`` of these get
    past readers; ``crashes`` are those and hangs of readers and of the check.
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

    Of the ``cases`` are told: ``read``, ``refused``, ``raised`` (a traceback), ``hang``, ``crash``.
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
