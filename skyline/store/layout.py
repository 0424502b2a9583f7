"""The HDF5 file of a store: laid out empty, and opened to write."""

import io
import os
from pathlib import Path

import h5py
import numpy as np

from skyline.store.explain import explained
from skyline.store.header import PLACES, SCHEMA, SCHEMA_VERSION, StoreHeader

_LIBVER = ("v110", "v110")
"""SWMR needs the file format of HDF5 1.10; pinned, so that every release since reads it."""

_PACKING = {
    "exact": {"shuffle": True, "compression": "gzip", "compression_opts": 1},
    "compact": {"shuffle": True, "compression": "gzip", "compression_opts": 4},
    "places": {},
}
"""Davos at W = 640, bytes of a skyline and its depths: exact 2.7 kB instead of 5.1 (level 4: 2 %
less, half as fast to read); compact 0.55 kB (level 1: 7 % more, level 9: 4 % less at five times
the cost). Packing takes 0.1 ms a row and unpacking 0.03 ms, less than rendering the row.
Places are bytes already that would hardly pack, and plain chunks can be mapped."""

_ALIGNED_BYTES, _ALIGNED_FROM = 64, 1024
"""Chunks of places begin at whole cache lines, for half a byte a place."""


def write_empty(path: Path, header: StoreHeader) -> None:
    """Write a new file that holds a store without rows."""
    # HDF5 makes the file in memory, since it crashes the process at exit if it cannot write it.
    image = io.BytesIO()
    with h5py.File(image, "w", libver=_LIBVER) as file:
        _lay_out(file, header)
    with path.open("xb") as target:
        target.write(image.getbuffer())
        target.flush()
        os.fsync(target.fileno())


def _lay_out(file: h5py.File, header: StoreHeader) -> None:
    file.attrs["schema"] = SCHEMA
    file.attrs["schema_version"] = SCHEMA_VERSION
    for name, text in header.attributes.items():
        file.attrs[name] = text
    file.attrs["header_digest"] = header.digest
    for name, spec in header.specs.items():
        shape = header.row_shape(spec.per_row)
        file.create_dataset(
            name,
            shape=(0, *shape),
            maxshape=(None, *shape),
            chunks=(header.chunk_rows, *shape),
            dtype=spec.dtype,
            fletcher32=True,
            **(_PACKING[header.rows] if shape else {}),
        )
    # A dataset, since SWMR writes no attributes.
    file.create_dataset("committed", data=np.uint64(0))


def open_to_write(path: Path, header: StoreHeader) -> h5py.File:
    """Open in SWMR mode from the first byte.

    To open for writing and then switch, as h5py does, leaves an instant at which a kill marks
    the file as no reader's at all. The lock is ours, since HDF5 takes none in this mode.
    """
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)
    access.set_file_locking(False, True)
    if header.holds == PLACES:
        access.set_alignment(_ALIGNED_FROM, _ALIGNED_BYTES)
    flags = h5py.h5f.ACC_RDWR | h5py.h5f.ACC_SWMR_WRITE
    with explained(path, "it cannot be opened for writing", "check that you may write it"):
        return h5py.File(h5py.h5f.open(os.fsencode(path), flags, access))
