"""Making a store from others: merging, joining and repairing.

Rows of a merged store are sorted by easting, northing, eye elevation and heading, and equal rows
are kept once. So its bytes depend only on the set of rows, not on the order of the parts or on how
they were cut. Stores of several boxes of one DEM may overlap. Places are planned on nested
lattices, so the denser of two plans has all places of the other. Where both plans have a place, the
row of the denser plan is kept, which has the smaller tolerance.
"""

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import IntArray
from skyline.errors import InputError, StoreError
from skyline.geodesy.bounds import Bounds
from skyline.store.check import Damage, StoreReport, whole_rows
from skyline.store.layout import EYE, PLACES, Columns, StoreHeader, explained, refuse_mismatch
from skyline.store.mapped_places import JoinedPlaces
from skyline.store.read import Store, open_store
from skyline.store.write import check_store_path, write_store


def merge_stores(
    paths: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]
) -> StoreReport:
    """Write the rows of stores into one new store, sorted by location.

    Parameters
    ----------
    paths : sequence of path-like
        At least one, of the same DEM and configuration, each of any box.
    out : path-like
        Must not exist.

    Raises
    ------
    StoreMismatchError
        Two of the stores were built with different settings; both values are named.
    StoreError
        A store is damaged, or the new one cannot be written or exists.
    """
    if not paths:
        raise InputError("no stores to merge; name one or more")
    out = _new_store(out)
    with merged_rows(paths, out.parent) as (header, columns, order):
        rows = write_store(out, header, columns, order)
        return StoreReport(rows, header.holds, duplicates=len(columns[header.checksum]) - rows)


def repair_store(path: str | os.PathLike[str], out: str | os.PathLike[str]) -> StoreReport:
    """Write a store's undamaged rows into a new one, in order.

    A chunk that HDF5 cannot read, of 1,024 places or 32 renderings, is left out as a whole. Raises
    `StoreError` where nothing can be saved, or the new store cannot be written or exists.
    """
    out = _new_store(out)
    damage: list[Damage] = []
    with open_store(path) as store:
        header, count = store.header, len(store)
    with _gathered([(path, count)], header, out.parent, damage) as columns:
        if count and not len(columns[header.checksum]):
            raise StoreError(f"none of the {count} rows of store {path} is whole; build it again")
        return StoreReport(write_store(out, header, columns), header.holds, tuple(damage))


@contextmanager
def merged_rows(
    paths: Sequence[str | os.PathLike[str]], folder: Path
) -> Iterator[tuple[StoreHeader, Columns, IntArray]]:
    """Yield the header of a merged store, its rows and their order.

    The rows wait in a nameless file in ``folder``, unpacked. Raises as `merge_stores`.
    """
    counted, merged = _counted(paths)
    with _gathered(counted, merged, folder) as columns:
        yield merged, columns, sorted_once(merged, columns)


def _counted(
    paths: Sequence[str | os.PathLike[str]],
) -> tuple[list[tuple[Path, int]], StoreHeader]:
    """Return stores' paths, lengths and joint header; raises as `merge_stores`."""
    counted: list[tuple[Path, int]] = []
    headers: list[StoreHeader] = []
    for path in paths:
        # Each store is closed at once, and not kept: there may be more stores than files can be
        # open, and h5py looks through all of its objects, closed ones too, whenever it closes one.
        with open_store(path) as store:
            counted.append((store.path, len(store)))
            headers.append(store.header)
    one = counted[0][0]
    for (other, _), header in zip(counted[1:], headers[1:], strict=True):
        refuse_mismatch(
            headers[0].anywhere,
            header.anywhere,
            f"stores {one} and {other} cannot be joined",
            "build both with the same settings from one DEM of both areas: skylines show terrain "
            "far around them",
            (f"in {one.name}", f"in {other.name}"),
        )
    return counted, _merged_header(headers)


def _merged_header(headers: Sequence[StoreHeader]) -> StoreHeader:
    """Return the joint header of stores, whatever their order."""
    config = dict(headers[0].config)
    if "bounds_deg" in config:
        config["bounds_deg"] = _joint_boxes([header.boxes_deg for header in headers])
    renderers = {name for header in headers for name in header.renderer.split("; ")}
    return replace(
        headers[0],
        config=config,
        dem_files=min(header.dem_files for header in headers),
        renderer="; ".join(sorted(renderers)),
        package_version=max(header.package_version for header in headers),
    )


def _joint_boxes(boxes_deg: Sequence[list[Bounds] | None]) -> Bounds | list[Bounds] | None:
    """Return stores' boxes; None where a store covers all of the DEM."""
    joint: set[Bounds] = set()
    for boxes in boxes_deg:
        if boxes is None:
            return None
        joint.update(boxes)
    return sorted(joint) if len(joint) > 1 else joint.pop()


class JoinedStore(Store):
    """Several stores of places, read as the store that `merge_stores` would write.

    No row is copied to a file. The rows' eyes and tolerances are read to sort them.
    """

    def __init__(self, paths: Sequence[str | os.PathLike[str]]) -> None:
        """Open and check the stores; raises as `merge_stores`."""
        counted, self.header = _counted(paths)
        self.path = counted[0][0]
        self._resources = ExitStack()
        with ExitStack() as opened:
            self._stores = [opened.enter_context(open_store(path)) for path, _ in counted]
            self.expect(PLACES)
            named = self.header.fields
            keys = {named[field]: self._columns(named[field]) for field in (*EYE, "tolerance_m")}
            self._order = sorted_once(self.header, keys)
            self._rows = len(self._order)
            self._resources = opened.pop_all()

    def places(self) -> JoinedPlaces:
        """Map the places of all stores; see `Store.places`."""
        return JoinedPlaces([store.places() for store in self._stores], self._order)

    def _read(self, name: str, rows: IntArray) -> NDArray[Any]:
        return self._columns(name)[self._order[rows]]

    def _columns(self, name: str) -> NDArray[Any]:
        """Return a dataset of all stores, one after another; raises `StoreError`."""
        return np.concatenate([store.stored_as(name) for store in self._stores])


@contextmanager
def open_joined(paths: Sequence[str | os.PathLike[str]]) -> Iterator[Store]:
    """Open a store, or several as the store that `merge_stores` writes.

    Stores of renderings are merged into a temporary file, which disappears once its reader is
    closed: their rows are packed, and reading them in another order would unpack each chunk many
    times. Raises as `open_store` and `merge_stores`.
    """
    with open_store(paths[0]) as first:
        holds = first.header.holds
        if len(paths) == 1:
            yield first
            return
    if holds == PLACES:
        with JoinedStore(paths) as store:
            yield store
        return
    with tempfile.TemporaryDirectory(prefix="skyline-") as folder:
        joined = Path(folder) / "joined.h5"
        merge_stores(paths, joined)
        with open_store(joined) as store:
            yield store


def by_model(paths: Sequence[str | Path]) -> list[list[str | Path]]:
    """Return stores' paths, grouped by elevation model and frame, in order."""
    groups: dict[tuple[str, str], list[str | Path]] = {}
    for path in paths:
        with open_store(path) as store:
            header = store.header
        groups.setdefault((header.frame_wkt, header.dem_digest), []).append(path)
    return list(groups.values())


def sorted_once(header: StoreHeader, columns: Columns) -> IntArray:
    """Return the rows, each once, in order of location and heading."""
    keys = [np.asarray(columns[name]) for name in header.sorted_by]
    # Of places with equal keys the one with the smallest tolerance is kept.
    ties = [columns[name] for field, name in header.fields.items() if field == "tolerance_m"]
    order = np.lexsort([*ties, *keys[::-1]])
    again = np.ones(len(order), dtype=bool)
    again[:1] = False
    for key in keys:
        again[1:] &= key[order[1:]] == key[order[:-1]]
    return order[~again]


@contextmanager
def _gathered(
    stores: Sequence[tuple[str | os.PathLike[str], int]],
    header: StoreHeader,
    folder: Path,
    damage: list[Damage] | None = None,
) -> Iterator[Columns]:
    """Yield all rows of stores (path, length), unpacked in a file.

    Damaged rows are left out and appended to ``damage``; without such a list they raise
    `StoreError`. Reading rows from the stores in order of location would unpack each chunk many
    times.
    """
    record = np.dtype(list(header.specs.items()))
    total = sum(count for _, count in stores)
    with (
        explained(folder, "rows cannot be gathered in it", "check the folder's rights and space"),
        tempfile.TemporaryFile(dir=folder) as file,
    ):
        rows = np.zeros(0, dtype=record)
        if total:
            # The space is taken now: a disk that fills up under a memory map ends the process.
            os.posix_fallocate(file.fileno(), 0, total * record.itemsize)
            rows = np.memmap(file, dtype=record, mode="r+", shape=total)
        stop = 0
        for path, _ in stores:
            with open_store(path) as store:
                for columns, found in whole_rows(store):
                    if found is not None:
                        if damage is None:
                            raise StoreError(
                                f"store {store.path} is damaged: {found.what}; `skyline store "
                                "repair` saves the whole rows"
                            )
                        damage.append(found)
                    start = stop
                    stop += len(next(iter(columns.values()), ()))
                    for name, values in columns.items():
                        rows[name][start:stop] = values
        yield {name: rows[name][:stop] for name in header.specs}


def _new_store(out: str | os.PathLike[str]) -> Path:
    """Return the path of a new store; refuses one that exists."""
    out = Path(out).resolve()
    check_store_path(out)
    if out.exists():
        raise StoreError(
            f"store {out} cannot be created: it exists already; remove it, or choose another name"
        )
    return out
