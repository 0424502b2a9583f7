"""Skylines of photos in pixels, and the lenses that their files note."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from skyline.arrays import BoolArray, Float64Array, UInt8Array, refuse_text
from skyline.camera.pixels import from_middle
from skyline.camera.projection import MIN_FOV_DEG, Projection
from skyline.errors import InputError
from skyline.photo.noted_place import NOTHING_NOTED, NotedPlace

_SAME_ROWS = 0.02
"""A crest nearer to the skyline than this share of all rows is the skyline itself."""


class PhotoForm(Protocol):
    """A photo's projection and size, by which a pose has pixels."""

    @property
    def projection(self) -> Projection:
        """Maps columns and rows to rays."""

    @property
    def width_px(self) -> int:
        """Number of columns."""

    @property
    def height_px(self) -> int:
        """Number of rows."""


def form_of(photo: PhotoForm) -> dict[str, str | int]:
    """Return a photo's projection and size, by the keys of a pose's record."""
    return {
        "projection": str(photo.projection),
        "width_px": photo.width_px,
        "height_px": photo.height_px,
    }


@dataclass(frozen=True, slots=True)
class Lens:
    """The horizontal field of view that a file notes for its photo.

    Attributes
    ----------
    fov_deg : float or None
        The likeliest horizontal field of view; None if nothing is known.
    fov_sd_deg : float or None
        Standard deviation of ``fov_deg``; None if it is as accurate as a value that a user gives.
    most_fov_deg : float or None
        The greatest possible field of view, if the photo was cropped or digitally zoomed.
    crop_share : float
        Probability that the photo shows less than ``fov_deg`` give or take ``fov_sd_deg``, since a
        program may have cropped it.
    reason : str
        The source of the values in words, or the reason that there are none; empty if the file
        notes no lens.
    """

    fov_deg: float | None = None
    fov_sd_deg: float | None = None
    most_fov_deg: float | None = None
    reason: str = ""
    crop_share: float = 0.0

    def beside_border(self, share: float) -> Lens:
        """Return the lens of a file whose border goes around this photo.

        The file is ``share`` times as wide as the photo.
        """
        if self.fov_deg is None:
            return self

        def widened_deg(fov_deg: float) -> float:
            pin_hole = Projection.PERSPECTIVE
            return float(pin_hole.fov_deg(share * pin_hole.half_width(fov_deg)))

        fov_deg = widened_deg(self.fov_deg)
        # The border does not change the error of the half width's logarithm.
        grown = math.sin(math.radians(fov_deg)) / math.sin(math.radians(self.fov_deg))
        return replace(
            self,
            fov_deg=fov_deg,
            fov_sd_deg=None if self.fov_sd_deg is None else grown * self.fov_sd_deg,
            most_fov_deg=None if self.most_fov_deg is None else widened_deg(self.most_fov_deg),
            reason=f"{self.reason}; the photo stands in a border",
        )

    @property
    def in_words(self) -> str:
        """The field of view and its source in one line, or ""."""
        if not self.reason:
            return ""
        fov = "not known" if self.fov_deg is None else f"{self.fov_deg:.1f} degrees"
        sd = self.fov_sd_deg
        give_or_take = "" if sd is None else f", give or take {sd:.{int(sd < 1.0)}f}"
        return f"field of view: {fov}{give_or_take}; {self.reason}"


@dataclass(frozen=True, slots=True, eq=False)
class PhotoSkyline:
    """The skyline of one photo, one row per column.

    Pixel centres are at whole numbers.

    Attributes
    ----------
    row_px : (W,) float64
        Row of the border between sky and ground; NaN where it is absent or not trusted. A border
        known only to the pixel is the row of the last sky pixel plus 0.5.
    trust : (W,) float64
        0 to 1; 0 where ``row_px`` is NaN.
    width_px, height_px : int
        Size of the photo the rows refer to.
    fov_deg : float or None
        Horizontal field of view, None if unknown.
    projection : Projection
        Maps columns and rows to rays.
    noted : NotedPlace
        Place and heading that the photo notes.
    lens : Lens, optional
        Accuracy of `fov_deg`, if it comes from the photo's EXIF or XMP.
    eye_height_m : float, optional
        Height of the camera above the ground, None if unknown.
    crests : (3, W) float64, optional
        Rows of up to three crests a column, the likeliest first, NaN where there are fewer. None if
        the skyline was not extracted.
    picture : (h, w, 3) uint8, optional
        The whole photo, made smaller. None for a trace and a mask, and in the result of a search,
        since a run may keep thousands.
    is_drawn : bool
        Whether a person has corrected it; see `skyline.photo.extract.Correction`.
    """

    row_px: Float64Array
    trust: Float64Array
    width_px: int
    height_px: int
    fov_deg: float | None = None
    projection: Projection = Projection.PERSPECTIVE
    noted: NotedPlace = NOTHING_NOTED
    lens: Lens | None = None
    eye_height_m: float | None = None
    crests: Float64Array | None = None
    picture: UInt8Array | None = None
    is_drawn: bool = False

    def __post_init__(self) -> None:
        refuse_text(width_px=self.width_px, height_px=self.height_px, fov_deg=self.fov_deg)
        shapes: dict[str, tuple[int, ...]] = {
            "row_px": (self.width_px,),
            "trust": (self.width_px,),
        }
        if self.crests is not None:
            shapes["crests"] = (3, self.width_px)
        for name, shape in shapes.items():
            refuse_text(**{name: getattr(self, name)})
            values = np.ma.array(getattr(self, name), dtype=np.float64).filled(np.nan)
            if values.shape != shape:
                raise InputError(
                    f"{name} has shape {values.shape}; expected {shape}, one value per image column"
                )
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if self.height_px < 1 or self.width_px < 1:
            raise InputError(
                f"image size is {self.width_px} x {self.height_px} px; expected at least 1 x 1"
            )
        object.__setattr__(self, "projection", Projection(self.projection))
        if self.fov_deg is not None:
            object.__setattr__(self, "fov_deg", self.projection.check_fov_deg(self.fov_deg))
        # Averages of trust pass 0 and 1 by rounding.
        if not np.all(np.abs(self.trust - 0.5) <= 0.5 + 1e-6):
            raise InputError("trust is not a number from 0 to 1 in some column; scale it")
        if np.any((self.trust > 0.0) & ~self.trusted):
            raise InputError("trust is above 0 where row_px is NaN; expected 0 there")

    def __repr__(self) -> str:
        lens = "unknown" if self.fov_deg is None else f"{self.fov_deg:.1f} degrees"
        return (
            f"PhotoSkyline({self.width_px} x {self.height_px} px; columns trusted: "
            f"{100.0 * self.trusted.mean():.0f} %; field of view: {lens})"
        )

    @property
    def form(self) -> dict[str, str | int]:
        """The photo's projection and size, by the keys of a pose's record."""
        return form_of(self)

    @property
    def trusted(self) -> BoolArray:
        """(W,) bool: True for columns with a skyline."""
        return np.isfinite(self.row_px)

    def other_crest_px(self) -> Float64Array:
        """Return the row (W,) of the likeliest crest other than the skyline.

        NaN where there is none. A crest within 2 % of the height is the skyline itself.
        """
        if self.crests is None:
            return np.full(self.width_px, np.nan)
        rows = self.crests
        other = np.isfinite(rows) & ~(np.abs(rows - self.row_px) < _SAME_ROWS * self.height_px)
        likeliest = rows[other.argmax(axis=0), np.arange(self.width_px)]
        return np.where(other.any(axis=0), likeliest, np.nan)

    def with_fov(self, fov_deg: float) -> PhotoSkyline:
        """Return the same skyline with another horizontal field of view, degrees."""
        return replace(self, fov_deg=fov_deg, lens=None)

    def image_plane(self) -> tuple[Float64Array, Float64Array]:
        """Return the trusted columns on an image of unit focal length.

        Returns
        -------
        u, v : (N,) float64
            To the right of and above the image's middle; square pixels. A perspective photo has
            rays (u, v, 1), u = ((2q + 1)/W - 1) tan(fov/2) and v = (H - 1 - 2r)/W tan(fov/2); for
            panoramas see `Projection.rays`.

        Raises
        ------
        InputError
            No field of view is known.
        """
        columns = np.flatnonzero(self.trusted)
        row_px = self.row_px[columns]
        across, above = from_middle(columns, row_px, self.width_px, self.height_px)
        return self.projection.rays(across, above, self._known_fov_deg())

    def visible_deg(self) -> float:
        """Return the azimuths that the trusted columns span, degrees.

        The camera is taken to be level. Raises as `image_plane`.
        """
        spans = self.projection.column_deg(self.width_px, self._known_fov_deg())
        return float(spans[self.trusted].sum())

    def _known_fov_deg(self) -> float:
        if self.fov_deg is None:
            raise InputError(
                "the photo's field of view is not known; give its horizontal field of view, "
                f"from {MIN_FOV_DEG:g} degrees on (--fov-deg)"
            )
        return self.fov_deg


def check_in_picture(skyline: PhotoSkyline) -> None:
    """Raise `InputError` for a skyline with a row outside its picture.

    The levelled picture of a tilted camera may have such rows; a photo has none.
    """
    row_px = skyline.row_px
    outside = np.flatnonzero((row_px < -1.0) | (row_px > skyline.height_px))
    if outside.size:
        raise InputError(
            f"row_px is {row_px[outside[0]]:g} in column {outside[0]} of a picture of "
            f"{skyline.height_px} rows; give rows of the picture, and NaN where it has no skyline"
        )


def check_of_image(skyline: PhotoSkyline, shape: tuple[int, ...]) -> None:
    """Check that a skyline belongs to an image.

    Raises `InputError` unless it fits the image's shape (H, W, ...).
    """
    height, width = shape[:2]
    if (width, height) != (skyline.width_px, skyline.height_px):
        raise InputError(
            f"the skyline is of an image of {skyline.width_px} x {skyline.height_px} px, the photo "
            f"has {width} x {height}; expected the same image"
        )
