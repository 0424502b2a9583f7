"""Files of height fields.

Samples are mapped into memory, and read when they are first needed. A file begins with a line of
JSON: the grid, the frame, the provenance, the warnings of the reading, and checksums. The line ends
with its own checksum. Sections follow, each at a multiple of `_PAGE` bytes: the digest of the
field, if it is known; bounds of the heights by block; checksums of the blocks; the samples; and the
source. The source is the repaired samples on the grid of the DEM's files. A file that has one may
lack blocks, which are made from it when they are first needed, and stay in the file. Nothing in a
file is used before its checksum has been compared.
"""

import json
import logging
import math
import os
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from skyline.arrays import Float32Array
from skyline.errors import InputError, MissingFileError
from skyline.files.disk import appearing
from skyline.geodesy.map_frame import Frame
from skyline.terrain.grid import Grid
from skyline.terrain.heightfield import HeightField, dem_of, field_of
from skyline.terrain.lazy_heights import (
    Blocks,
    LazyHeights,
    MakeBlock,
    Shape,
    block_counts,
    block_slices,
    bounds_of,
    checksum,
)
from skyline.terrain.metric_dem import MetricDem, WarpSource
from skyline.terrain.provenance import Provenance
from skyline.terrain.resampling import Warp

SUFFIX = ".terrain"
"""The suffix of the files."""

FORMAT = 3
"""The number of the files' format, which changes with the format."""

_FORMAT = f"skyline terrain {FORMAT}"
_PAGE = 4096
_LONGEST_LINE = 1 << 26
"""Most bytes of the line of JSON, which has the names of all files."""
_SUM_LENGTH = 8
"""Characters of a checksum in text."""
_DIGEST_LENGTH = 64
"""Characters of the digest of a field."""

LoggedWarning = tuple[str, str]
"""The name of a logger, and a message."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where the sections of a file begin, in bytes."""

    begin: int
    """The end of the line of JSON."""
    shape: Shape
    source_shape: Shape | None

    @classmethod
    def of(cls, about: Mapping[str, Any], begin: int) -> "_Layout":
        grid = about["grid"]
        source = about["source"]
        shape = None if source is None else (source["grid"]["rows"], source["grid"]["cols"])
        return cls(begin, (grid["rows"], grid["cols"]), shape)

    @property
    def counts(self) -> Shape:
        return block_counts(self.shape)

    @property
    def digest(self) -> int:
        return _whole_pages(self.begin)

    @property
    def bounds(self) -> int:
        return _whole_pages(self.digest + _DIGEST_LENGTH + _SUM_LENGTH)

    @property
    def sums(self) -> int:
        return _whole_pages(self.bounds + 8 * math.prod(self.counts))

    @property
    def samples(self) -> int:
        return _whole_pages(self.sums + 4 * math.prod(self.counts))

    @property
    def source(self) -> int:
        return _whole_pages(self.samples + 4 * math.prod(self.shape))

    @property
    def end(self) -> int:
        return self.source + 4 * math.prod(self.source_shape or (0,))


def _whole_pages(length: int) -> int:
    return -(-length // _PAGE) * _PAGE


def save_field(field: HeightField, path: Path) -> None:
    """Write a height field of float32 samples to a file.

    Raises `InputError` where the file cannot be written.
    """
    try:
        save_dem(dem_of(field), path, digest=field.digest)
    except OSError as error:
        raise InputError(
            f"{path} cannot be written ({error.strerror}); make room for it"
        ) from error


def save_dem(
    dem: MetricDem, path: Path, warnings: Sequence[LoggedWarning] = (), digest: str = ""
) -> None:
    """Write a DEM that was read.

    Its source is written if it has one, else its samples. `read_field` logs the warnings again.
    Raises `OSError` where the file cannot be written; it is written whole or not at all.
    """
    source = dem.source
    if source is not None:
        bounds_m = source.bounds_m
    else:
        heights_m = np.asarray(dem.heights_m, dtype=np.float32)
        bounds_m = bounds_of(heights_m)
    about = {
        "format": _FORMAT,
        "grid": asdict(dem.grid),
        "frame": dem.frame.wkt,
        "provenance": asdict(dem.provenance),
        "warnings": list(warnings),
        "bounds_sum": checksum(bounds_m),
        "source": None if source is None else source.warp.to_dict(),
        "source_sum": None if source is None else checksum(source.heights_m),
    }
    head = _summed(json.dumps(about).encode()) + b"\n"
    layout = _Layout.of(about, len(head))
    sections: dict[int, NDArray[Any]] = {layout.bounds: bounds_m}
    if source is not None:
        sections[layout.source] = source.heights_m
    else:
        sections[layout.sums] = np.array(
            [
                checksum(heights_m[block_slices(layout.shape, *at)])
                for at in np.ndindex(layout.counts)
            ],
            dtype=np.uint32,
        )
        sections[layout.samples] = heights_m
    with appearing(path) as begun, begun.open("wb") as file:
        file.write(head)
        if digest:
            file.seek(layout.digest)
            file.write(_summed(digest.encode()))
        for offset, values in sections.items():
            file.seek(offset)
            file.write(np.ascontiguousarray(values).data)
        file.truncate(layout.end)


def read_field(path: Path, fresh: MetricDem | None = None) -> HeightField:
    """Return the height field that `save_field` or `save_dem` wrote, to the bit.

    Samples are read when they are first needed. ``fresh`` is the DEM if it was written just now:
    its source is in memory, and its warnings have been logged. Raises `MissingFileError` where
    there is no file, and `InputError` for any other file.
    """
    try:
        with _opened(path) as file:
            return _field_in(file, path, fresh)
    except FileNotFoundError as error:
        raise MissingFileError(f"{path} does not exist; name the elevation files") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError, CRSError) as error:
        raise _damaged(path) from error


def _opened(path: Path) -> BinaryIO:
    """Open a file to read, and to write if that is possible."""
    try:
        return path.open("r+b", buffering=0)
    except OSError:
        return path.open("rb", buffering=0)


def _field_in(file: BinaryIO, path: Path, fresh: MetricDem | None) -> HeightField:
    """Return the height field in an open file.

    Raises `ValueError` for any other file.
    """
    head = file.readline(_LONGEST_LINE)
    about = json.loads(_checked(head.removesuffix(b"\n")))
    if about["format"] != _FORMAT:
        raise ValueError("another format")
    layout = _Layout.of(about, len(head))
    if os.fstat(file.fileno()).st_size != layout.end:
        raise ValueError("cut short")
    bounds = os.pread(file.fileno(), 8 * math.prod(layout.counts), layout.bounds)
    bounds_m = np.frombuffer(bounds, np.float32).reshape(2, *layout.counts)
    if checksum(bounds_m) != about["bounds_sum"]:
        raise ValueError("damaged bounds")
    with suppress(OSError):
        os.utime(path)  # The least recently used files are removed first.
    for logger, message in () if fresh else about["warnings"]:
        logging.getLogger(logger).warning("%s", message)
    make: MakeBlock
    if layout.source_shape is None:
        make = partial(_no_block, path)
    elif fresh is not None and fresh.source is not None:
        make = fresh.source.block
    else:
        heights_m = np.memmap(file, np.float32, "r", layout.source, layout.source_shape)
        source = cache(partial(_source_of, path, about, heights_m))

        def make(rows: slice, cols: slice) -> Float32Array:
            return source().block(rows, cols)

    blocks = Blocks.in_file(file, layout.shape, layout.samples, layout.sums)
    digest = os.pread(file.fileno(), _DIGEST_LENGTH + _SUM_LENGTH, layout.digest)

    def keep_digest(digest: str) -> None:
        blocks.note(layout.digest, _summed(digest.encode()))

    heights = LazyHeights(blocks, make, bounds_m, _digest_in(digest), keep_digest)
    made = replace(Provenance(**about["provenance"]), files=tuple(about["provenance"]["files"]))
    return field_of(MetricDem(heights, Grid(**about["grid"]), Frame(about["frame"]), made))


def _summed(content: bytes) -> bytes:
    """Return content with its checksum."""
    return content + b"%0*x" % (_SUM_LENGTH, zlib.crc32(content))


def _checked(content: bytes) -> bytes:
    """Return content without its checksum; `ValueError` if that is wrong."""
    checked = content[:-_SUM_LENGTH]
    if _summed(checked) != content:
        raise ValueError("another file, or a damaged one")
    return checked


def _digest_in(content: bytes) -> str:
    """Return the digest in a file; empty if there is none."""
    with suppress(ValueError):
        return _checked(content).decode()
    return ""


def _damaged(path: Path) -> InputError:
    return InputError(
        f"{path} holds no elevation model that skyline saved; remove it, or name the files"
    )


def _removed(path: Path) -> InputError:
    """Remove a file with damaged heights, and return the error for it."""
    try:
        path.unlink(missing_ok=True)
    except OSError:
        return InputError(f"{path} is damaged; remove it, and run the command again")
    return InputError(f"{path} was damaged, and is removed; run the command again")


def _no_block(path: Path, rows: slice, cols: slice) -> Float32Array:
    raise _removed(path)


def _source_of(path: Path, about: Mapping[str, Any], heights_m: Float32Array) -> WarpSource:
    """Return the source in a file.

    A file that is damaged is removed, and `InputError` raised.
    """
    if checksum(heights_m) != about["source_sum"]:
        raise _removed(path)
    source = about["source"]
    warp = Warp(
        Grid(**source["grid"]),
        CRS.from_wkt(source["crs"]),
        Frame(about["frame"]),
        source["spacing_m"],
    )
    return WarpSource(heights_m.view(np.ndarray), warp)
