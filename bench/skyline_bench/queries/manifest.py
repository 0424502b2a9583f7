"""Manifests of real photographs to measure with.

A manifest is a CSV file with all that is known of each photograph.
"""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from skyline.arrays import Float64Array, UInt8Array
from skyline.errors import InputError, MissingFileError
from skyline.files.tables import Row, read_table
from skyline.photo.photo import read_photo
from skyline.photo.sky_mask import topmost_border
from skyline.photo.trace import read_trace

LOCATE = "locate"
"""A photograph whose place is to be found."""
REFUSE = "refuse"
"""A photograph for which no answer is right."""
EXTRACT = "extract"
"""A photograph of which only the skyline is measured."""
KINDS = (LOCATE, REFUSE, EXTRACT)


@dataclass(frozen=True, slots=True)
class Photograph:
    """One line of a manifest; None stands for an unknown value."""

    photo: Path  # A photo, or a trace that is matched as if it were one
    kind: str  # One of `KINDS`
    # Where it was taken; for a photograph to refuse, where the store is.
    lon: float | None = None
    lat: float | None = None
    # How the camera truly stood.
    heading_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    fov_deg: float | None = None
    elevation_m: float | None = None
    # Given to the matcher.
    given_fov_deg: float | None = None
    given_eye_height_m: float | None = None
    # The true skyline: a picture of two colours of the photo's proportions, or a trace of it.
    mask: Path | None = None
    trace: Path | None = None

    @property
    def name(self) -> str:
        """Its name in tables."""
        return self.photo.stem

    @property
    def files(self) -> list[Path]:
        """Its photo, and its mask and trace where it has them."""
        named = (getattr(self, name) for name in _FILES)
        return [file for file in named if file is not None]

    @property
    def lonlat(self) -> tuple[float, float]:
        """Where a photograph was taken that is to be located."""
        return self.lon or 0.0, self.lat or 0.0

    def true_row_px(self, width_px: int, height_px: int) -> Float64Array | None:
        """Return the true row (W,) of a photo's skyline in each column.

        Returns None if unknown. The row is NaN in columns without a skyline.
        """
        if self.trace is not None:
            true = read_trace(self.trace)
            row_px = true.row_px
            height = true.height_px
        elif self.mask is not None:
            mask = read_photo(self.mask).rgb
            row_px = _upper_edge(mask)
            height = len(mask)
        else:
            return None
        at = (np.arange(width_px) + 0.5) * len(row_px) / width_px - 0.5
        nearest = np.clip(np.rint(at), 0, len(row_px) - 1).astype(np.intp)
        return np.asarray((row_px[nearest] + 0.5) * height_px / height - 0.5)


_NUMBERS = tuple(field.name for field in fields(Photograph) if "float" in str(field.type))
_FILES = ("photo", "mask", "trace")


def read_manifest(path: Path) -> list[Photograph]:
    """Read a manifest; paths in it count from its folder."""
    expected = "expected a manifest of photographs: CSV with the columns photo and kind"
    table = read_table(path, expected)
    table.first_in(("photo", "kind"), expected=expected)
    table.refuse_other(*(field.name for field in fields(Photograph)))
    photographs = [_photograph(path, row) for row in table.rows]
    absent = [file for one in photographs for file in one.files if not file.is_file()]
    if absent:
        raise MissingFileError(
            f"{path} names {len(absent)} files that do not exist, the first of them {absent[0]}"
        )
    if not photographs:
        raise InputError(f"{path} names no photograph; expected at least one line")
    return photographs


def _photograph(path: Path, row: Row) -> Photograph:
    if row["kind"] not in KINDS or not row["photo"]:
        raise InputError(
            f"{row.where} has the photo {row['photo']!r} of the kind {row['kind']!r}; expected a "
            f"file and one of {', '.join(KINDS)}"
        )
    given = {name: row.number(name) for name in _NUMBERS if row[name]}
    if row["kind"] != EXTRACT and not {"lon", "lat"} <= given.keys():
        raise InputError(f"{row.where} has no lon and lat, which {row['kind']} needs")
    files = {name: path.parent / row[name] for name in _FILES if row[name]}
    return Photograph(kind=row["kind"], **files, **given)  # type: ignore[arg-type]


def _upper_edge(mask: UInt8Array) -> Float64Array:
    """Return the row (W,) of the border under the top colour.

    Most of the top row has this colour. NaN where there is no border.
    """
    light = mask.mean(axis=2) >= 128
    is_sky = light == (light[0].mean() >= 0.5)
    return topmost_border(is_sky.astype(np.float64), 0.5)[0]
