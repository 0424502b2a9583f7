"""Reading an HDF5 file that a writer has open, or had open when it was killed.

A writer in HDF5's single-writer, multiple-reader mode (SWMR) keeps its file whole at every
instant, but marks it as in use, and a mark that a killed writer left is never taken away. HDF5
reads marked files only in SWMR mode, and in that mode it reads a damaged part again up to 100
times with pauses that double, which is for ever. `WholeFile` presents the file with the mark
taken off, so that it is read in the ordinary way and damage is an error at once.

Source: HDF5 File Format Specification version 3.0, section II.A, superblock version 3, and III.E,
global heap.
"""

import io
import os
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from skyline.errors import StoreError
from skyline.store.lock import missing_store

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

_SIGNATURE = b"\x89HDF\r\n\x1a\n"

_LAYOUT = struct.Struct("<8s4B4Q")
"""Signature; version, size of offsets, size of lengths, consistency flags; base address,
extension, end of file, root group."""

_HEAP_SIGNATURE = b"GCOL"
_HEAP = struct.Struct("<4sB3xQ")
"""Signature; version, bytes of the heap, this included."""

_HEAP_OBJECT = struct.Struct("<HH4xQ")
"""Index, references, bytes of data that follow, padded to 8. Index 0 is the free rest."""

_CHECKSUM = struct.Struct("<I")
_SIZE = _LAYOUT.size + _CHECKSUM.size
_MASK = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class Superblock:
    """What HDF5 keeps at the start of a file about the file as a whole."""

    flags: int
    """Not 0 while a writer has the file open, and after it was killed."""
    end: int
    """Where the file ends, bytes. Lags behind while a writer is at work."""
    extension: int
    root: int
    """``extension``, ``root``: addresses in the file."""

    @property
    def in_use(self) -> bool:
        """Whether a writer has the file open, or was killed while it had."""
        return self.flags != 0

    @classmethod
    def parse(cls, path: Path, head: bytes) -> Self:
        """Read the first bytes of a file; raises `StoreError` unless they are a superblock."""
        if not head.startswith(_SIGNATURE):
            raise StoreError(f"{path} is not an HDF5 file; name a store that skyline built")
        if len(head) < _SIZE:
            raise StoreError(f"store {path} is truncated to {len(head)} bytes; build it again")
        _, version, offsets, lengths, flags, base, extension, end, root = _LAYOUT.unpack_from(head)
        if (version, offsets, lengths, base) != (3, 8, 8, 0):
            raise StoreError(
                f"{path} is an HDF5 file but not a skyline store; name a store that skyline built"
            )
        if _CHECKSUM.unpack_from(head, _LAYOUT.size)[0] != lookup3(head[: _LAYOUT.size]):
            raise StoreError(f"store {path} is damaged in its first bytes; build it again")
        return cls(flags, end, extension, root)

    def pack(self) -> bytes:
        """Return the bytes of the superblock, checksum included."""
        head = _LAYOUT.pack(_SIGNATURE, 3, 8, 8, self.flags, 0, self.extension, self.end, self.root)
        return head + _CHECKSUM.pack(lookup3(head))


class WholeFile(io.FileIO):
    """An HDF5 file, read as if its writer had closed it just now.

    Raises
    ------
    MissingFileError
        No such file.
    StoreError
        Not readable, not HDF5 of the version that stores use, or truncated.
    """

    def __init__(self, path: Path) -> None:
        try:
            super().__init__(path, "rb")
        except FileNotFoundError as error:
            raise missing_store(path) from error
        except OSError as error:
            raise StoreError(
                f"store {path} cannot be read: {error.strerror}; name a file that you may read"
            ) from error
        self._path = path
        try:
            self._look()
        except BaseException:
            self.close()
            raise

    @property
    def superblock(self) -> Superblock:
        """The superblock as it is in the file."""
        return self._superblock

    @property
    def size(self) -> int:
        """Bytes in the file now."""
        return os.fstat(self.fileno()).st_size

    def refresh(self) -> bool:
        """Look at the file again; return whether a writer has or may have changed it."""
        before = self._superblock
        self._look()
        return self._superblock.in_use or self._superblock != before

    def readinto(self, buffer: "WriteableBuffer", /) -> int:
        """Read from the current position, the superblock without its mark."""
        position = self.tell()
        count = super().readinto(buffer)
        if position < _SIZE:
            stop = min(position + count, _SIZE)
            memoryview(buffer).cast("B")[: stop - position] = self._presented[position:stop]
        elif bytes(memoryview(buffer).cast("B")[:4]) == _HEAP_SIGNATURE:
            self._check_heap(position)
        return count

    def _check_heap(self, position: int) -> None:
        """Raise `OSError` where HDF5 would walk a heap of text for ever or past its end.

        HDF5 guards no global heap with a checksum, and one zeroed by damage is an endless loop.
        """
        descriptor = self.fileno()
        _, version, size = _HEAP.unpack(os.pread(descriptor, _HEAP.size, position).ljust(16))
        whole = version == 1 and _HEAP.size <= size <= self.size - position
        heap = os.pread(descriptor, size, position) if whole else b""
        place = _HEAP.size
        while whole and place + _HEAP_OBJECT.size <= size:
            index, _, length = _HEAP_OBJECT.unpack_from(heap, place)
            step = _HEAP_OBJECT.size + (length + 7) // 8 * 8 if index else length
            whole = _HEAP_OBJECT.size <= step <= size - place
            place += step
        if not whole:
            raise OSError(f"the heap of texts at byte {position} is damaged")

    def _look(self) -> None:
        self._superblock = Superblock.parse(self._path, os.pread(self.fileno(), _SIZE, 0))
        size, end = self.size, self._superblock.end
        closed = self._superblock
        if closed.in_use:
            closed = replace(closed, flags=0, end=size)
        elif size < end:
            raise StoreError(
                f"store {self._path} is truncated: {size} of {end} bytes; copy or build it again"
            )
        self._presented = closed.pack()


def lookup3(data: bytes) -> int:
    """Return Jenkins' lookup3 hash of 4 n bytes, n > 0: the checksum of HDF5's metadata.

    Source: hashlittle of https://burtleburtle.net/bob/c/lookup3.c, initial value 0.
    """
    words = struct.unpack(f"<{len(data) // 4}I", data)
    a = b = c = (0xDEADBEEF + len(data)) & _MASK
    while len(words) > 3:
        a, b, c = _mixed(a + words[0], b + words[1], c + words[2])
        words = words[3:]
    last = (*words, 0, 0)
    return _finished(a + last[0], b + last[1], c + last[2])


def _mixed(a: int, b: int, c: int) -> tuple[int, int, int]:
    for bits in (4, 6, 8, 16, 19, 4):
        a, b, c = b, c + b, (a - c) ^ _rotated(c, bits)
    return a & _MASK, b & _MASK, c & _MASK


def _finished(a: int, b: int, c: int) -> int:
    for bits in (14, 11, 25, 16, 4, 14, 24):
        a, b, c = b, (c ^ b) - _rotated(b, bits), a
    return b & _MASK


def _rotated(value: int, bits: int) -> int:
    value &= _MASK
    return value << bits | value >> (32 - bits)
