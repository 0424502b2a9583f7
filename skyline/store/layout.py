"""The format of a store: its header, rows and checksums.

A row is a rendering (a view with its skyline and keypoints) or a place (`skyline.store.places`).

HDF5 guards its own structures (object headers, chunk indexes, the superblock) with checksums, and
each chunk of rows here with another (Fletcher-32), which readers verify as they read. These
checksums find a chunk that changed, but not one that was never written: a hole in a file reads as
zeros, and the Fletcher-32 of zeros is zero. So each row also has a CRC-32, which finds such holes,
shows which rows are whole when others are not, and is copied with the row from store to store.
"""

from __future__ import annotations

import hashlib
import json
import re
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import ShortRepr, UInt8Array
from skyline.errors import SkylineError, StoreError, StoreMismatchError, one_line, some_of
from skyline.files.disk import STORE_SCHEMA
from skyline.geodesy.bounds import Bounds
from skyline.geodesy.earth import Curvature
from skyline.geodesy.map_frame import Frame
from skyline.skylines import DEFAULT_MAX_KEYPOINTS, Views, check_width
from skyline.store.places import BINS, DISTANCE_BINS, PHASE_BINS, PLACE_CODING, Places
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions

SCHEMA_VERSION = 4
PACKAGE_VERSION = version("skyline")

RENDERINGS = "renderings"
"""Kind of rows: views, each with its skyline and keypoints."""

PLACES = "places"
"""Kind of rows: places."""

BEGUN = "begun"
"""Kind of rows: places of an unfinished plan. Each also has the shares of views that are lost
around it at each spacing, so that the plan can continue."""

MADE_BY = {RENDERINGS: "`skyline render`", PLACES: "`skyline build`"}
"""The command that makes a store, by kind."""

EYE = ("easting_m", "northing_m", "eye_elevation_m")
"""The fields that locate the eye of a row of either kind."""

PLACES_A_CHUNK = 1024
"""Number of places in a chunk, some 0.7 MB: a search works on one chunk at a time."""

_VIEWS_A_CHUNK = 32
"""Number of views in a chunk, 80 kB of skylines at W = 640. Half as many make a store 3 % larger.
Four times as many make it 1 % smaller, but HDF5 unpacks a whole chunk to read one row."""

ROWS_AT_ONCE = 1024
"""Number of rows that are read or written at once. They fill whole chunks: a packed chunk that is
written twice leaves dead bytes in the file."""

_PACKING = {"shuffle": True, "compression": "gzip", "compression_opts": 1}
"""Packing of renderings. On Davos it shrinks a skyline of W = 640 with its depths from 5.1 kB to
2.7 kB; level 4 saves 2 % more, but takes twice as long to read. Places hardly shrink, so their
chunks stay plain and can be mapped."""

KEYPOINTS = "features/keypoint_column"
"""The dataset of keypoints in a store of renderings."""

LOST = "places/lost"
"""The dataset of lost shares in a store of `BEGUN` rows."""

KeypointColumns = NDArray[np.uint16]

Columns = Mapping[str, NDArray[Any]]
"""N rows of several datasets by name, in the types in which they are stored."""

_TOLERANCES = ("tolerance_px", "tolerance_deg")
"""Settings of earlier releases: the tolerance to which they rendered skylines."""

_SPECS: dict[str, dict[str, tuple[str, str, tuple[int, ...] | None]]] = {
    RENDERINGS: {
        "easting_m": ("views/easting", "<f8", ()),
        "northing_m": ("views/northing", "<f8", ()),
        "eye_elevation_m": ("views/eye_elevation_m", "<f8", ()),
        "heading": ("views/heading", "u1", ()),
        # Files call the ordinate v by this name since the first of them, so it stays.
        "v": ("views/elevation_tan", "<f4", None),
        "depth_m": ("views/depth_m", "<f4", None),
        "flags": ("views/flags", "u1", None),
        "keypoints": (KEYPOINTS, "<u2", (DEFAULT_MAX_KEYPOINTS,)),
        "checksum": ("views/checksum", "<u4", ()),
    },
    PLACES: {
        "easting_m": ("places/easting", "<f8", ()),
        "northing_m": ("places/northing", "<f8", ()),
        "eye_elevation_m": ("places/eye_elevation_m", "<f4", ()),
        "tolerance_m": ("places/tolerance_m", "<f4", ()),
        "first_tan": ("places/first_tan", "<f4", ()),
        "rise": ("places/rise", "i1", (BINS,)),
        "distance": ("places/distance", "u1", (DISTANCE_BINS,)),
        "phase": ("places/phase", "u1", (PHASE_BINS,)),
        "checksum": ("places/checksum", "<u4", ()),
    },
}
_SPECS[BEGUN] = {"lost": (LOST, "<f8", None), **_SPECS[PLACES]}
"""By kind of rows: field of `Views` or `Places` -> dataset, type and shape of a row; None stands
for the width (W,). Keypoints, lost shares and checksums are not fields of either."""

REBUILD = "copy or build it again"

UNREADABLE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)
"""The exceptions of h5py on files that are damaged or made by another program."""


@dataclass(frozen=True, slots=True, repr=False)
class StoreHeader(ShortRepr):
    """The DEM and the settings that a store was built from.

    Attributes
    ----------
    frame_wkt : str
        Frame of the locations.
    dem_digest : str
        `HeightField.digest` of the terrain.
    dem_files : tuple of str
        Absolute paths of the DEM at the time of the build.
    config : mapping
        Settings of the build, by name; values that JSON can hold.
    renderer : str
        Name of the renderer and of the OpenGL under it; empty before anything is rendered.
    width : int
        Number W of columns of a view, or of spacings in a `BEGUN` row; 0 in a store of places.
    holds : str
        "renderings", "places" or "begun".
    package_version : str
        Release that built the store.

    Raises
    ------
    InputError
        The width of renderings is out of range.
    """

    frame_wkt: str
    dem_digest: str
    dem_files: tuple[str, ...]
    config: Mapping[str, object]
    renderer: str = ""
    width: int = 0
    holds: str = RENDERINGS
    package_version: str = field(default=PACKAGE_VERSION, compare=False)

    def __post_init__(self) -> None:
        if self.holds == RENDERINGS:
            check_width(self.width)
        # JSON turns tuples into lists. The config is kept as JSON returns it, so that a requested
        # config equals a stored one.
        plain = json.loads(json.dumps(dict(self.config), allow_nan=False))
        if "dem_options" in plain:
            # Stores do not differ by options that only earlier releases have.
            plain["dem_options"] = asdict(DemOptions.from_json(plain["dem_options"]))
        for name in _TOLERANCES:
            # At 0 earlier releases rendered as this one does.
            if plain.get(name) == 0.0:
                del plain[name]
        object.__setattr__(self, "config", plain)

    @property
    def checksum(self) -> str:
        """The dataset of the rows' checksums."""
        return _SPECS[self.holds]["checksum"][0]

    @property
    def fields(self) -> dict[str, str]:
        """Datasets of the store's rows, by the field of `Views` or `Places`."""
        return {
            field: name
            for field, (name, *_) in _SPECS[self.holds].items()
            if field not in ("keypoints", "lost", "checksum")
        }

    @property
    def sorted_by(self) -> list[str]:
        """Datasets that sort rows, and distinguish one from another."""
        return [self.fields[field] for field in (*EYE, "heading") if field in self.fields]

    @property
    def specs(self) -> dict[str, np.dtype[Any]]:
        """The type of a row by dataset, such as (W,) float32."""
        return {
            name: np.dtype((kind, (self.width,) if shape is None else shape))
            for name, kind, shape in _SPECS[self.holds].values()
        }

    def chunk_rows(self, rows: int) -> int:
        """Return the number of rows in a chunk, for ``rows`` in all."""
        return max(1, min(rows, _VIEWS_A_CHUNK if self.holds == RENDERINGS else PLACES_A_CHUNK))

    def layout(self, name: str, rows: int) -> dict[str, Any]:
        """Return h5py's settings for a dataset of ``rows`` rows."""
        row = self.specs[name]
        return {
            "shape": (rows, *row.shape),
            "dtype": row.base,
            "chunks": (self.chunk_rows(rows), *row.shape),
            "fletcher32": True,
            **(_PACKING if row.shape and self.holds == RENDERINGS else {}),
        }

    @property
    def boxes_deg(self) -> list[Bounds] | None:
        """The built boxes in degrees; None for the whole DEM."""
        bounds: Any = self.config.get("bounds_deg")
        if not bounds:
            return None
        return [tuple(box) for box in (bounds if isinstance(bounds[0], list) else [bounds])]

    @property
    def anywhere(self) -> StoreHeader:
        """The header without its boxes: joinable stores agree in it."""
        config = {key: value for key, value in self.config.items() if key != "bounds_deg"}
        return replace(self, config=config)

    def covers(self, other: StoreHeader) -> bool:
        """Return whether this store has all boxes of another."""
        held = self.boxes_deg
        wanted = other.boxes_deg
        return held is None or (wanted is not None and set(wanted) <= set(held))

    @property
    def attributes(self) -> dict[str, str]:
        """The file's attributes, except its schema, version and digest."""
        layout = PLACE_CODING if self.holds == PLACES else {"width": self.width}
        return {
            "frame": self.frame_wkt,
            "dem_digest": self.dem_digest,
            "dem_files": json.dumps(self.dem_files),
            "config": json.dumps(self.config, sort_keys=True),
            "renderer": self.renderer,
            "package_version": self.package_version,
            "rows": json.dumps({"rows": self.holds, **layout}),
        }

    def read_dem(self, dem: Dem | None = None) -> HeightField:
        """Read the store's DEM, with the options of its build.

        ``dem`` is the DEM or its files, if they are no longer at `dem_files`.

        Raises
        ------
        StoreMismatchError
            The files hold another DEM.
        MissingFileError
            The files do not exist.
        """
        options = DemOptions.from_json(self.config.get("dem_options"))
        terrain = read_dem(list(self.dem_files) if dem is None else dem, options)
        if terrain.frame.wkt != self.frame_wkt:
            raise StoreMismatchError(
                f"the DEM is read in the frame {terrain.frame.name}, and the store was built in "
                f"{Frame(self.frame_wkt).name} by skyline {self.package_version}; give the store's "
                "DEM, or build the store again"
            )
        if terrain.digest != self.dem_digest:
            raise StoreMismatchError(
                f"the DEM's digest is {terrain.digest[:12]}, the store was built from "
                f"{self.dem_digest[:12]} ({', '.join(self.dem_files) or 'no file'}); give that DEM"
            )
        return terrain

    @property
    def curvature(self) -> Curvature:
        """The curvature of the renderings; the default where the config has none."""
        stored: Any = self.config.get("curvature", {})
        return Curvature(**stored)


def refuse_mismatch(
    a: StoreHeader,
    b: StoreHeader,
    subject: str,
    advice: str,
    words: tuple[str, str] = ("there", "here"),
) -> None:
    """Raise `StoreMismatchError` unless rows of two headers may be in one store.

    Paths and releases may differ. The message begins with ``subject`` and ends with ``advice``, or
    with what to do about rows that can no longer be made; ``words`` describe the two headers in it.
    """
    compared: dict[str, tuple[object, object]] = {"kind of rows": (a.holds, b.holds)}
    if a.holds != b.holds:
        advice = "a store holds rows of one kind; name another store"
    else:
        if (a.frame_wkt, a.dem_digest) != (b.frame_wkt, b.dem_digest):
            compared["elevation model"] = _model(a), _model(b)
        compared["width"] = a.width, b.width
        for key in sorted({*a.config, *b.config} - {"width"}):
            one = a.config.get(key, "absent")
            other = b.config.get(key, "absent")
            if isinstance(one, dict) and isinstance(other, dict):
                pairs = one.items(), other.items()
                one = {name: value for name, value in pairs[0] if (name, value) not in pairs[1]}
                other = {name: value for name, value in pairs[1] if (name, value) not in pairs[0]}
            compared[f"config {key}"] = one, other
            if key in _TOLERANCES and one != other:
                advice = (
                    "skylines are no longer rendered with a tolerance; build a new store of that "
                    "area (the old one is still read and searched)"
                )
    differences = [
        f"{name} is {was!r} {words[0]}, {now!r} {words[1]}"
        for name, (was, now) in compared.items()
        if was != now
    ]
    if differences:
        raise StoreMismatchError(f"{subject}: {'; '.join(differences)}; {advice}")


def _model(header: StoreHeader) -> str:
    names = [Path(file).name for file in header.dem_files] or ["no file"]
    frame = Frame(header.frame_wkt).name
    return f"{some_of(names, 1)} ({frame}, digest {header.dem_digest[:12]})"


def columns_of(
    header: StoreHeader, rows: Views | Places, keypoint_columns: KeypointColumns | None = None
) -> Columns:
    """Return rows as a store with ``header`` holds them.

    Checksums are made when the rows are written. Renderings have keypoints too: the columns (N, K)
    of their skylines' polyline vertices, padded with `NO_KEYPOINT`.
    """
    specs = header.specs
    given = {name: getattr(rows, field) for field, name in header.fields.items()}
    if keypoint_columns is not None:
        given[KEYPOINTS] = keypoint_columns
    return {name: np.asarray(given[name], dtype=specs[name].base) for name in given}


def row_checksums(columns: Columns) -> NDArray[np.uint32]:
    """Return the CRC-32 (N,) of each row's little-endian bytes.

    Columns are (N, ...) stored rows by dataset, N at least 1. Datasets are taken in order of name;
    a column of checksums is skipped.
    """
    names = [name for name in sorted(columns) if not name.endswith("/checksum")]
    plain = [np.ascontiguousarray(columns[name]) for name in names]
    held = [values.reshape(len(values), -1).view(np.uint8) for values in plain]
    return checksums_of_bytes(np.concatenate(held, axis=1))


def checksums_of_bytes(rows: UInt8Array) -> NDArray[np.uint32]:
    """Return the CRC-32 of each row (N, B) of bytes."""
    width = rows.shape[1]
    flat = rows.tobytes()
    sums = (zlib.crc32(flat[start : start + width]) for start in range(0, len(flat), width))
    return np.fromiter(sums, dtype=np.uint32, count=len(rows))


@contextmanager
def explained(path: Path, problem: str, advice: str = REBUILD) -> Iterator[None]:
    """Turn an exception of h5py into a `StoreError` of one line."""
    try:
        yield
    except SkylineError:
        raise
    except UNREADABLE as error:
        reason = one_line(error) or type(error).__name__
        cause = re.search(r"error message = '([^']+)'", reason)
        reason = cause[1] if cause else reason
        raise StoreError(f"store {path}: {problem} ({reason}); {advice}") from error


def attributes_digest(attributes: Mapping[str, str]) -> str:
    """Return the SHA-256 of the schema's version and `StoreHeader.attributes`."""
    text = json.dumps([SCHEMA_VERSION, attributes], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def write_header(file: h5py.File, header: StoreHeader) -> None:
    """Write a header, with its digest, as the attributes of a file."""
    texts = {
        "schema": STORE_SCHEMA,
        **header.attributes,
        "header_digest": attributes_digest(header.attributes),
    }
    file.attrs["schema_version"] = SCHEMA_VERSION
    for name, text in texts.items():
        # HDF5 protects only texts of a fixed length with a checksum.
        data = text.encode() or b" "
        file.attrs.create(name, np.bytes_(data), dtype=h5py.string_dtype("utf-8", len(data)))


def read_header(path: Path, file: h5py.File) -> StoreHeader:
    """Return a store's header; raises `StoreError` where damaged or foreign."""
    foreign = StoreError(
        f"{path} is an HDF5 file but not a skyline store; "
        "name one made by `skyline build` or `skyline render`"
    )
    if file.userblock_size or not {"schema", "schema_version"} <= set(file.attrs):
        raise foreign
    version = _attribute(path, file, "schema_version")
    if version != SCHEMA_VERSION:
        is_newer = isinstance(version, np.integer) and version > SCHEMA_VERSION
        advice = "upgrade skyline" if is_newer else "build the store again"
        raise StoreError(
            f"store {path} has schema version {version}; this skyline ({PACKAGE_VERSION}) reads "
            f"version {SCHEMA_VERSION}: {advice}"
        )
    texts = {name: _text(path, file, name) for name in file.attrs if name != "schema_version"}
    if texts.pop("schema") != STORE_SCHEMA:
        raise foreign
    if texts.pop("header_digest", None) != attributes_digest(texts):
        raise StoreError(
            f"store {path} is damaged: its header (frame, DEM, config, renderer, rows) does not "
            f"have the digest that was written with it; {REBUILD}"
        )
    rows = json.loads(texts["rows"])
    if rows["rows"] == PLACES and rows != {"rows": PLACES, **PLACE_CODING}:
        raise StoreError(
            f"store {path} has places that another release of skyline built, whose bytes mean "
            "something else; build it again"
        )
    return StoreHeader(
        frame_wkt=texts["frame"],
        dem_digest=texts["dem_digest"],
        dem_files=tuple(json.loads(texts["dem_files"])),
        config=json.loads(texts["config"]),
        renderer=texts["renderer"],
        width=rows.get("width", 0),
        holds=rows["rows"],
        package_version=texts["package_version"],
    )


def _attribute(path: Path, file: h5py.File, name: str) -> object:
    """Return an attribute's value; None if its length is variable.

    HDF5 keeps values of variable length in a heap without a checksum. If the heap is damaged, HDF5
    may loop.
    """
    if file.attrs.get_id(name).shape != ():
        raise StoreError(f"store {path} has several values in attribute {name!r}; {REBUILD}")
    kind = file.attrs.get_id(name).get_type()
    plain = isinstance(kind, h5py.h5t.TypeIntegerID) or (
        isinstance(kind, h5py.h5t.TypeStringID) and not kind.is_variable_str()
    )
    value: object = file.attrs[name] if plain else None
    return value


def _text(path: Path, file: h5py.File, name: str) -> str:
    value = _attribute(path, file, name)
    if not isinstance(value, bytes):
        raise StoreError(f"store {path} has an attribute {name!r} that is not text; {REBUILD}")
    return value.decode().removesuffix(" " if value == b" " else "")
