"""Stores made of stores: merged, compacted, and what can be saved of a damaged one.

The result depends on the set of rows and on what the stores were built from alone: rows are
sorted by easting, northing, eye elevation and heading, and the same one is kept once. So the
order of shards and how they were cut change no byte.
"""

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError, StoreError
from skyline.store.built import Built, joined
from skyline.store.coding import RowCoding
from skyline.store.header import KEYPOINTS, RENDERINGS, StoreHeader, check_holds, refuse_mismatch
from skyline.store.integrity import Damage, whole_rows
from skyline.store.lock import complete_or_absent, explained, new_store
from skyline.store.reader import Store, open_store
from skyline.store.rows import Columns, row_checksums, stored_rows, views_of
from skyline.store.writer import block_rows, new_rows


@dataclass(frozen=True, slots=True)
class CopyReport:
    """What a new store was made of."""

    rows: int
    """In the new store."""
    holds: str
    """What they are: "renderings" or "places"."""
    duplicates: int
    """Rows left out because the same view or place is there already."""
    built: Built
    """How much of its build the new store holds."""
    damage: tuple[Damage, ...] = ()
    """Rows left out because they are damaged (`repair_store` alone)."""


def merge_stores(
    paths: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]
) -> CopyReport:
    """Write the rows of stores into one new store.

    Parameters
    ----------
    paths : sequence of path-like
        At least one, of the same frame, DEM, configuration and coding.
    out : path-like
        Must not exist.

    Raises
    ------
    StoreMismatchError
        Two of the stores were built otherwise; both values are named.
    StoreError
        A store is damaged, or the new one cannot be written or exists.
    """
    if not paths:
        raise InputError("no stores to merge; name one or more")
    stores = []
    for path in paths:
        # Closed again: there may be more of them than files can be open.
        with open_store(path) as store:
            stores.append(store)
    for store in stores[1:]:
        one, other = stores[0].path, store.path
        refuse_mismatch(
            (stores[0].header, f"in {one.name}"),
            (store.header, f"in {other.name}"),
            f"stores {one} and {other} were built otherwise",
            "merge stores of one DEM and configuration",
        )
    headers = [store.header for store in stores]
    # Whatever the stores' order.
    joint = replace(
        headers[0],
        dem_files=min(header.dem_files for header in headers),
        renderer="; ".join(sorted({header.renderer for header in headers})),
        package_version=max(header.package_version for header in headers),
    )
    return _copy(stores, joint, Path(out))


def compact_store(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    coding: RowCoding | None = None,
) -> CopyReport:
    """Write a store anew: without dead bytes, rows sorted and once each.

    Parameters
    ----------
    path, out : path-like
        ``out`` must not exist.
    coding : RowCoding, optional
        Round exact rows to this; by default rows are kept to the bit.

    Raises
    ------
    InputError
        Rows that are rounded already cannot be rounded otherwise, and places not at all.
    StoreError
        The store is damaged, or the new one cannot be written or exists.
    """
    with open_store(path) as store:
        header = store.header
        if coding:
            check_holds(store.path, header, RENDERINGS)
            if header.coding:
                raise InputError(f"the rows of store {path} are rounded already; compact it as is")
            header = replace(header, coding=coding)
        return _copy([store], header, Path(out))


def repair_store(path: str | os.PathLike[str], out: str | os.PathLike[str]) -> CopyReport:
    """Write the undamaged rows of a store into a new one, in their order.

    Raises `StoreError` where nothing can be saved, or the new store cannot be written or exists.
    """
    damage: list[Damage] = []
    with (
        open_store(path) as store,
        _new_file(Path(out)) as partial,
        new_rows(partial, store.header) as writer,
    ):
        for columns, rows, found in whole_rows(store):
            damage.extend([found] if found else [])
            if len(rows):
                writer.append_stored({name: values[rows] for name, values in columns.items()})
        # Which parts of the build the damaged rows are of is not known.
        writer.note_built(Built() if damage else store.built)
    return CopyReport(len(writer), store.header.holds, 0, writer.built, tuple(damage))


def _copy(stores: Sequence[Store], header: StoreHeader, out: Path) -> CopyReport:
    """Write the rows of stores, sorted and once each, as ``header`` holds them."""
    total = sum(len(store) for store in stores)
    with (
        _new_file(out) as partial,
        explained(out, "it cannot be written", "make room"),
        # Rows wait in a file without a name, of which a kill leaves nothing: to read them from
        # the stores in order of place would unpack each chunk many times.
        tempfile.TemporaryFile(dir=partial.parent) as waiting,
    ):
        rows = _spread(stores, header, waiting, total)
        chosen = _chosen(rows, header)
        again = total - len(chosen)
        step = block_rows(header)
        with new_rows(partial, header) as writer:
            for first in range(0, len(chosen), step):
                at = chosen[first : first + step]
                writer.append_stored({name: rows[name][at] for name in header.specs})
            writer.note_built(joined([store.built for store in stores], overlap=again > 0))
    return CopyReport(len(chosen), header.holds, again, writer.built)


def _spread(
    stores: Sequence[Store], header: StoreHeader, file: IO[bytes], total: int
) -> NDArray[np.void]:
    """Return all rows of stores, unpacked in a file, as one structured array."""
    record = np.dtype(list(header.specs.items()))
    if total == 0:
        return np.zeros(0, dtype=record)
    # Taken now: a full disk under a memory map ends the process.
    os.posix_fallocate(file.fileno(), 0, total * record.itemsize)
    rows = np.memmap(file, dtype=record, mode="r+", shape=total)
    start = 0
    for looked_at in stores:
        with open_store(looked_at.path) as store:
            if len(store) != len(looked_at):
                raise StoreError(
                    f"store {store.path} has {len(store)} rows and had {len(looked_at)} a moment "
                    "ago; copy it when nobody writes it"
                )
            for columns in _undamaged(store, header):
                stop = start + len(columns[header.checksum])
                for name, values in columns.items():
                    rows[name][start:stop] = values
                start = stop
    return rows


def _undamaged(store: Store, header: StoreHeader) -> Iterator[Columns]:
    """Yield rows of a store as ``header`` holds them; raises `StoreError` where one is damaged."""
    for columns, _, damage in whole_rows(store):
        if damage:
            raise StoreError(
                f"store {store.path} is damaged: {damage.what}; `skyline store repair` saves "
                "what is whole"
            )
        held = columns
        if header.coding != store.header.coding:
            held = stored_rows(header, views_of(store.header, columns), columns[KEYPOINTS])
        yield {**held, header.checksum: row_checksums(held)}


def _chosen(rows: NDArray[np.void], header: StoreHeader) -> NDArray[np.intp]:
    """Return which rows to write, in order: sorted by place and heading, each one once."""
    keys = [np.asarray(rows[name]) for name in (*header.sorted_by, header.checksum)]
    order = np.lexsort(keys[::-1])
    again = np.ones(len(order), dtype=bool)
    again[:1] = False
    for key in keys[:-1]:
        again[1:] &= key[order[1:]] == key[order[:-1]]
    return order[~again]


@contextmanager
def _new_file(out: Path) -> Iterator[Path]:
    """Yield a name for a new store, which takes the name ``out`` when it is complete."""
    out = out.resolve()
    with new_store(out, "remove it, or choose another name"), complete_or_absent(out) as partial:
        yield partial
