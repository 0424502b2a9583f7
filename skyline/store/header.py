"""What a store was built from and how, and the layout of its rows (DESIGN 8)."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata

import numpy as np
from numpy.typing import NDArray

from skyline.camera import check_width
from skyline.errors import InputError
from skyline.features import DEFAULT_MAX_KEYPOINTS, NO_KEYPOINT

SCHEMA = "skyline-store"
SCHEMA_VERSION = 1

KeypointColumns = NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Spec:
    """A row-aligned dataset: its type, and whether a row is W or K values instead of one."""

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

SPECS = dict(VIEW_SPECS.values()) | {KEYPOINTS: Spec("<u2", "keypoints")}


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
    package_version : str
        Release that created the store.

    Raises
    ------
    InputError
        The width or the number of keypoints is out of range, or JSON cannot hold the config.
    """

    frame_wkt: str
    dem_digest: str
    dem_files: tuple[str, ...]
    config: Mapping[str, object]
    renderer: str
    width: int
    max_keypoints: int = DEFAULT_MAX_KEYPOINTS
    package_version: str = field(default_factory=package_version, compare=False)

    def __post_init__(self) -> None:
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

    def row_shape(self, per_row: str) -> tuple[int, ...]:
        """Return the shape of one row of a dataset: (), (W,) or (K,)."""
        return {"one": (), "width": (self.width,), "keypoints": (self.max_keypoints,)}[per_row]
