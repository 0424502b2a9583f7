"""What a store was built from and how, and the layout of its rows (DESIGN 8)."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib import metadata

import numpy as np
from numpy.typing import NDArray

from skyline.camera import check_width
from skyline.errors import InputError
from skyline.features import DEFAULT_MAX_KEYPOINTS, NO_KEYPOINT
from skyline.store.coding import RowCoding

SCHEMA = "skyline-store"
SCHEMA_VERSION = 2
"""2 brought checksums and compact rows. Version 1 is read, and lifted to 2 when appended to."""

CHECKED_SINCE = 2
"""The version from which stores hold checksums of their header and rows."""

KeypointColumns = NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Spec:
    """A row-aligned dataset: its type, and whether a row is many values instead of one."""

    dtype: str
    per_row: str = "one"


VIEW_SPECS = {
    "easting_m": ("views/easting", Spec("<f8")),
    "northing_m": ("views/northing", Spec("<f8")),
    "eye_elevation_m": ("views/eye_elevation_m", Spec("<f8")),
    "heading": ("views/heading", Spec("u1")),
    "elevation_tan": ("views/elevation_tan", Spec("<f4", "width")),
    "depth_m": ("views/depth_m", Spec("<f4", "width")),
    "flags": ("views/flags", Spec("u1", "width")),
}
"""Field of `Views` -> dataset and its layout."""

KEYPOINTS = "features/keypoint_column"

CHECKSUM = "views/checksum"
"""CRC-32 of each row's bytes as stored (see `skyline.store.digest`)."""

SHELL_SPECS = {
    "elevation_tan": ("views/shell_tan", Spec("<f4", "shells")),
    "depth_m": ("views/shell_depth_m", Spec("<f4", "shells")),
}
"""Field of `Shells` -> dataset and its layout, in stores that hold shells."""

CODED = {
    name: field
    for specs in (VIEW_SPECS, SHELL_SPECS)
    for field, (name, spec) in specs.items()
    if spec.dtype == "<f4"
}
"""Dataset that compact rows hold as codes -> what the codes stand for."""


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
        Columns W of a view.
    max_keypoints : int
        Keypoints K a row has room for.
    shell_edges_m : tuple of float
        Edges of the distance shells that are held beside each skyline; empty for none.
    coding : RowCoding, optional
        To what compact rows are rounded; None for exact rows.
    package_version : str
        Release that created the store.
    schema_version : int
        Layout of the file; a store that is written has the newest.

    Raises
    ------
    InputError
        The width, the number of keypoints or the shells are out of range, or JSON cannot hold the
        config.
    """

    frame_wkt: str
    dem_digest: str
    dem_files: tuple[str, ...]
    config: Mapping[str, object]
    renderer: str
    width: int
    max_keypoints: int = DEFAULT_MAX_KEYPOINTS
    shell_edges_m: tuple[float, ...] = ()
    coding: RowCoding | None = None
    package_version: str = field(default_factory=package_version, compare=False)
    schema_version: int = field(default=SCHEMA_VERSION, compare=False)

    def __post_init__(self) -> None:
        check_width(self.width)
        if not 2 <= self.max_keypoints < NO_KEYPOINT:
            raise InputError(
                f"max_keypoints is {self.max_keypoints}; expected 2 to {NO_KEYPOINT - 1} "
                f"(the default is {DEFAULT_MAX_KEYPOINTS})"
            )
        edges = np.asarray(self.shell_edges_m, dtype=np.float64)
        if edges.ndim != 1 or len(edges) == 1 or not (np.diff(edges) > 0.0).all():
            raise InputError(
                f"shell_edges_m are {self.shell_edges_m}; expected none, or two or more depths in "
                "metres, increasing"
            )
        object.__setattr__(self, "shell_edges_m", tuple(edges.tolist()))
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
        """How the rows are held: "exact" or "compact"."""
        return "compact" if self.coding else "exact"

    @property
    def specs(self) -> dict[str, Spec]:
        """The row-aligned datasets of this store, by name."""
        held = dict(VIEW_SPECS.values()) | {KEYPOINTS: Spec("<u2", "keypoints")}
        if self.shell_edges_m:
            held |= dict(SHELL_SPECS.values())
        if self.schema_version >= CHECKED_SINCE:
            held |= {CHECKSUM: Spec("<u4")}
        if self.coding:
            held |= {name: Spec("<u4", held[name].per_row) for name in CODED if name in held}
        return held

    @property
    def attributes(self) -> dict[str, str]:
        """What the file's attributes say of the header, beside its version, shells and digest."""
        coding = {"rows": self.rows} | (asdict(self.coding) if self.coding else {})
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
        facts = [self.schema_version, self.width, self.max_keypoints, self.shell_edges_m]
        text = json.dumps([facts, self.attributes], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def row_shape(self, per_row: str) -> tuple[int, ...]:
        """Return the shape of one row of a dataset: (), (W,), (keypoints,) or (shells, W)."""
        return {
            "one": (),
            "width": (self.width,),
            "keypoints": (self.max_keypoints,),
            "shells": (max(len(self.shell_edges_m) - 1, 0), self.width),
        }[per_row]
