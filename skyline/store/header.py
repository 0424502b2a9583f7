"""What a store was built from and how, and the layout of its rows."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyline.camera import check_width
from skyline.errors import InputError, StoreMismatchError
from skyline.features import DEFAULT_MAX_KEYPOINTS, NO_KEYPOINT
from skyline.geodesy import Frame
from skyline.places import (
    ALIKE_DEG,
    BINS,
    DISTANCE_BINS,
    DISTANCE_STEP,
    NEAREST_M,
    PHASE_BINS,
    PHASES,
    RISE_GROWTH,
    RISE_SIZE,
)
from skyline.store.coding import RowCoding

SCHEMA = "skyline-store"
SCHEMA_VERSION = 3

RENDERINGS, PLACES = "renderings", "places"
"""What a store may hold."""

_MADE_BY = {RENDERINGS: "`skyline build --planner uniform`", PLACES: "`skyline build`"}

COMMITTED, BUILT = "committed", "built"
"""Datasets of the counts that change while a store is written: complete rows, and `Built`."""

EYE = ("easting_m", "northing_m", "eye_elevation_m")
"""Where the eye of a row is, whatever the rows are."""

_VIEWS_A_CHUNK = 32
"""80 kB of exact skylines at W = 640. Half costs 3 % more bytes, four times saves 1 %, and a
single row is read by unpacking one chunk."""

_PLACES_A_CHUNK = 1024
"""Some 0.7 MB, to be mapped and worked on at a time; more would be rendered again after a kill."""

KeypointColumns = NDArray[np.uint16]


VIEW_SPECS = {
    "easting_m": ("views/easting", "<f8", "one"),
    "northing_m": ("views/northing", "<f8", "one"),
    "eye_elevation_m": ("views/eye_elevation_m", "<f8", "one"),
    "heading": ("views/heading", "u1", "one"),
    "elevation_tan": ("views/elevation_tan", "<f4", "width"),
    "depth_m": ("views/depth_m", "<f4", "width"),
    "flags": ("views/flags", "u1", "width"),
}
"""Field of `Views` -> row-aligned dataset, its type, and which values a row has of it."""

KEYPOINTS = "features/keypoint_column"

CHECKSUM = "views/checksum"
"""CRC-32 of each row's bytes as stored (see `skyline.store.rows`)."""

CODED = ("views/elevation_tan", "views/depth_m")
"""The datasets that compact rows hold as codes."""

PLACE_SPECS = {
    "easting_m": ("places/easting", "<f8", "one"),
    "northing_m": ("places/northing", "<f8", "one"),
    "eye_elevation_m": ("places/eye_elevation_m", "<f4", "one"),
    "tolerance_m": ("places/tolerance_m", "<f4", "one"),
    "first_tan": ("places/first_tan", "<f4", "one"),
    "rise": ("places/rise", "i1", "rises"),
    "distance": ("places/distance", "u1", "distances"),
    "phase": ("places/phase", "u1", "phases"),
}
"""Field of `Places` -> dataset and its layout, as `VIEW_SPECS`."""

PLACE_CHECKSUM = "places/checksum"

PLACE_CODING = {
    "bins": BINS,
    "distance_bins": DISTANCE_BINS,
    "phase_bins": PHASE_BINS,
    "rise_size": RISE_SIZE,
    "rise_growth": RISE_GROWTH,
    "nearest_m": NEAREST_M,
    "distance_log_step": DISTANCE_STEP,
    "phase_steps": PHASES,
    "phase_alike_deg": ALIKE_DEG,
}
"""What the bytes of places mean (see `skyline.places`)."""


def package_version() -> str:
    """Return the release of skyline that is running, or "unknown"."""
    try:
        return metadata.version("skyline")
    except metadata.PackageNotFoundError:
        return "unknown"


@dataclass(frozen=True, slots=True)
class StoreHeader:
    """What a store was built from and how; fixed when it is created.

    Attributes
    ----------
    frame_wkt : str
        Frame of the locations.
    dem_digest : str
        `HeightField.digest` of the terrain.
    dem_files : tuple of str
        Absolute paths where the DEM lay.
    config : mapping
        Settings of the build; anything JSON holds, keys are strings.
    renderer : str
        What rendered the views.
    width : int
        Columns W of a view; 0 in a store of places.
    max_keypoints : int
        Keypoints K a row has room for; 0 in a store of places.
    coding : RowCoding, optional
        To what compact rows are rounded; None for exact rows.
    holds : str
        "renderings" or "places". Places have no width, keypoints or coding to choose.
    package_version : str
        Release that created the store.

    Raises
    ------
    InputError
        The width or the number of keypoints is out of range or given for places, or JSON cannot
        hold the config.
    """

    frame_wkt: str
    dem_digest: str
    dem_files: tuple[str, ...]
    config: Mapping[str, object]
    renderer: str
    width: int = 0
    max_keypoints: int = DEFAULT_MAX_KEYPOINTS
    coding: RowCoding | None = None
    holds: str = RENDERINGS
    package_version: str = field(default_factory=package_version, compare=False)

    def __post_init__(self) -> None:
        if self.holds == PLACES:
            if self.width or self.coding:
                raise InputError("a store of places has no width or coding; leave them out")
            object.__setattr__(self, "max_keypoints", 0)
        elif self.holds != RENDERINGS:
            raise InputError(f"a store holds {RENDERINGS} or {PLACES}, not {self.holds!r}")
        else:
            check_width(self.width)
            if not 2 <= self.max_keypoints < NO_KEYPOINT:
                raise InputError(
                    f"max_keypoints is {self.max_keypoints}; expected 2 to {NO_KEYPOINT - 1} "
                    f"(the default is {DEFAULT_MAX_KEYPOINTS})"
                )
        try:
            plain = json.loads(json.dumps(dict(self.config), allow_nan=False))
        except (TypeError, ValueError) as error:
            raise InputError(
                f"the store's config cannot be written as JSON ({error}); "
                "use numbers, strings, lists and mappings"
            ) from error
        # As it will be read back, so that a stored and a requested config compare equal.
        object.__setattr__(self, "config", plain)

    @property
    def rows(self) -> str:
        """How the rows are held: "exact" or "compact" renderings, or "places"."""
        if self.holds == PLACES:
            return PLACES
        return "compact" if self.coding else "exact"

    @property
    def chunk_rows(self) -> int:
        """Rows a chunk of every dataset; what is committed whole is never written again."""
        return _PLACES_A_CHUNK if self.holds == PLACES else _VIEWS_A_CHUNK

    @property
    def checksum(self) -> str:
        """The dataset of the rows' checksums."""
        return PLACE_CHECKSUM if self.holds == PLACES else CHECKSUM

    @property
    def fields(self) -> dict[str, str]:
        """Field of `Views` or `Places` -> dataset, whichever the rows are."""
        specs = PLACE_SPECS if self.holds == PLACES else VIEW_SPECS
        return {field: name for field, (name, *_) in specs.items()}

    @property
    def sorted_by(self) -> list[str]:
        """The datasets by which merged rows are sorted, and which tell one row from another."""
        return [name for field, name in self.fields.items() if field in (*EYE, "heading")]

    @property
    def specs(self) -> dict[str, np.dtype[Any]]:
        """The row-aligned datasets of this store, by name: a row's type, (W,) of it for example."""
        if self.holds == PLACES:
            held = [*PLACE_SPECS.values(), (PLACE_CHECKSUM, "<u4", "one")]
        else:
            keypoints, checksum = (KEYPOINTS, "<u2", "keypoints"), (CHECKSUM, "<u4", "one")
            held = [*VIEW_SPECS.values(), keypoints, checksum]
        row_shapes: dict[str, tuple[int, ...]] = {
            "one": (),
            "width": (self.width,),
            "keypoints": (self.max_keypoints,),
            "rises": (BINS,),
            "distances": (DISTANCE_BINS,),
            "phases": (PHASE_BINS,),
        }
        return {
            name: np.dtype(("<u4" if self.coding and name in CODED else kind, row_shapes[per_row]))
            for name, kind, per_row in held
        }

    @property
    def attributes(self) -> dict[str, str]:
        """What the file's attributes say of the header, beside its version and digest."""
        coding: dict[str, object] = {"rows": self.rows}
        if self.coding:
            coding |= asdict(self.coding)
        elif self.holds == PLACES:
            coding |= PLACE_CODING
        return {
            "frame": self.frame_wkt,
            "dem_digest": self.dem_digest,
            "dem_files": json.dumps(self.dem_files),
            "config": json.dumps(self.config, sort_keys=True),
            "renderer": self.renderer,
            "package_version": self.package_version,
            "rows": json.dumps(coding),
        }

    @property
    def digest(self) -> str:
        """SHA-256 of all the header says: HDF5 does not guard the text of attributes."""
        # The empty list stood for distance shells: stores that never had any keep their digest.
        facts = [SCHEMA_VERSION, self.width, self.max_keypoints, []]
        text = json.dumps([facts, self.attributes], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def check_holds(path: Path, header: StoreHeader, wanted: str) -> None:
    """Raise `InputError` unless a store holds what is wanted of it."""
    if header.holds != wanted:
        raise InputError(
            f"store {path} holds {header.holds}, not {wanted}; name a store of {wanted}, which "
            f"{_MADE_BY[wanted]} makes"
        )


def refuse_mismatch(
    one: tuple[StoreHeader, str], other: tuple[StoreHeader, str], what: str, advice: str
) -> None:
    """Raise `StoreMismatchError` where rows of two headers do not belong into one store.

    With each header comes where it is, for a message that begins with ``what``.
    """
    said = [
        f"{name} is {was!r} {one[1]}, {now!r} {other[1]}"
        for name, was, now in _compared(one[0], other[0])
        if was != now
    ]
    if said:
        raise StoreMismatchError(f"{what}: {'; '.join(said)}; {advice}")


def _compared(one: StoreHeader, other: StoreHeader) -> Iterator[tuple[str, object, object]]:
    """Yield what may not differ, by name and with both values; the files' places and makers may."""
    if one.holds != other.holds:
        yield "what it holds", one.holds, other.holds
        return
    if one.frame_wkt != other.frame_wkt:
        names = _frame_name(one.frame_wkt), _frame_name(other.frame_wkt)
        yield "frame", *(names if names[0] != names[1] else (one.frame_wkt, other.frame_wkt))
    for name in ("dem_digest", "width", "max_keypoints", "rows"):
        yield name, getattr(one, name), getattr(other, name)
    if one.coding and other.coding:
        yield "coding", one.coding, other.coding
    for key in sorted({*one.config, *other.config}):
        yield f"config {key}", one.config.get(key, "absent"), other.config.get(key, "absent")


def _frame_name(wkt: str) -> str:
    try:
        return Frame(wkt).name
    except RuntimeError:  # pyproj's CRSError: the text may come from anywhere
        return wkt
