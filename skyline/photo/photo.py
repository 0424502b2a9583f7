"""A photo as read: its pixels, and what its file notes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from PIL import Image, ImageOps
from PIL.ExifTags import IFD, Base

from skyline.arrays import ShortRepr, UInt8Array, refuse_text
from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.files.tables import is_table
from skyline.photo.borders import content_of
from skyline.photo.image import (
    Picture,
    check_one_picture,
    made_smaller,
    name_of,
    opened_image,
    rgb_of,
    shrink_if_large,
)
from skyline.photo.noted_fov import camera_of
from skyline.photo.noted_place import NOTHING_NOTED, NotedPlace, place_from_exif
from skyline.photo.skyline import Lens, PhotoSkyline
from skyline.photo.tags import noted_time
from skyline.photo.xmp import xmp_of

_PICTURE_PX = 1600
"""Longer side of the picture that a skyline keeps of its photo."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Photo(ShortRepr):
    """An image file's pixels and the file's notes on the camera.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
        Upright; transparent parts are white.
    fov_deg : float or None
        Horizontal field of view, up to 360; None if EXIF and XMP note none.
    projection : Projection
        Perspective, unless EXIF or XMP note a panorama.
    noted : NotedPlace
        Place and heading noted in EXIF.
    lens : Lens, optional
        Accuracy of the field of view, if the file notes it.
    name : str
        The file, for messages.
    is_turned : bool
        Whether EXIF turns or mirrors the pixels of the file.
    """

    rgb: UInt8Array
    fov_deg: float | None
    projection: Projection
    noted: NotedPlace = NOTHING_NOTED
    lens: Lens | None = None
    name: str = "the image"
    is_turned: bool = False

    @property
    def width_px(self) -> int:
        """Number of columns."""
        return int(self.rgb.shape[1])

    @property
    def height_px(self) -> int:
        """Number of rows."""
        return int(self.rgb.shape[0])

    def check_upright(self, file: Path) -> None:
        """Raise `InputError` if EXIF turns the photo of a QGIS file.

        QGIS shows a photo as its file stores it, since GDAL's APPLY_ORIENTATION is off by default.
        """
        if self.is_turned:
            raise InputError(
                f"{file} is of QGIS, which shows {self.name} as its file stores it, and EXIF turns "
                "that photo; save the photo upright (ImageMagick's mogrify -auto-orient), and mark "
                "again what was marked in QGIS"
            )

    def described(self, skyline: PhotoSkyline) -> PhotoSkyline:
        """Return a skyline of this photo with its notes and its picture."""
        return replace(
            skyline,
            fov_deg=self.fov_deg,
            projection=self.projection,
            noted=self.noted,
            lens=self.lens,
            picture=made_smaller(self.rgb, _PICTURE_PX),
        )


def read_photo(
    path: Picture, fov_deg: float | None = None, *, projection: Projection | None = None
) -> Photo:
    """Read a photo or a sky mask, with its file's notes.

    Parameters
    ----------
    path : str, Path, PIL image, or (H, W) or (H, W, 3) uint8
    fov_deg : float, optional
        Horizontal field of view, degrees: 1 to 179, to 180 for a fisheye, or to 360 for a panorama.
        By default it is read from the photo's EXIF or XMP.
    projection : Projection, optional
        Perspective by default, unless the photo's EXIF or XMP note a panorama.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The file cannot be decoded, or the picture is a sliver.
    """
    projection = None if projection is None else Projection(projection)
    refuse_text(fov_deg=fov_deg)
    check_fov(fov_deg, projection)
    name = name_of(path)
    with opened_image(path) as image:
        full_px = image.size
        check_one_picture(name, image)
        shrink_if_large(name, image)
        is_turned = _is_turned(image)
        upright = ImageOps.exif_transpose(image) if is_turned else image
        width, height = _upright_size(full_px, upright)
        exif = image.getexif()
        xmp = xmp_of(image)
        tags = {**exif, **exif.get_ifd(IFD.Exif)}
        noted = place_from_exif(exif.get_ifd(IFD.GPSInfo), xmp)
        rgb = rgb_of(upright)
    noted_projection, lens = camera_of(tags, xmp, (width, height), _within_borders(rgb, width))
    if min(rgb.shape[:2]) < 2:
        raise InputError(f"{name} has {width} x {height} px; expected a photo or a sky mask")
    # Notes on a lens do not apply to a panorama or a fisheye, nor those on a panorama to a lens.
    is_as_noted = projection in (None, noted_projection) or (
        projection is not None and projection.is_panorama and noted_projection.is_panorama
    )
    known = lens if fov_deg is None and is_as_noted else None
    return Photo(
        rgb,
        fov_deg if known is None else known.fov_deg,
        projection or noted_projection,
        noted,
        known,
        name,
        is_turned,
    )


def _is_turned(image: Image.Image) -> bool:
    """Return whether EXIF turns or mirrors an image."""
    return image.getexif().get(Base.Orientation) in range(2, 9)


def _within_borders(rgb: UInt8Array, width: int) -> tuple[int, int] | None:
    """Return the size of the photo within the borders of a file.

    ``width`` is the file's, whose pixels may have been read smaller. None for a picture that is no
    photo.
    """
    try:
        content = content_of(rgb)
    except InputError:
        return None
    scale = width / content.width_px
    return (
        round(scale * (content.right - content.left)),
        round(scale * (content.bottom - content.top)),
    )


def _upright_size(full_px: tuple[int, int], upright: Image.Image) -> tuple[int, int]:
    """Return the upright width and height of a file's pixels.

    They are the size before the picture was shrunk. Decoders differ: some have already turned the
    pixels, some the size as well, and each leaves different tags. The upright picture shows whether
    the file's size is upright.
    """
    width, height = full_px
    is_turned = (upright.width < upright.height) != (width < height)
    return (height, width) if is_turned else (width, height)


def read_noted_place(path: Picture) -> NotedPlace:
    """Return the place noted in a photo's EXIF, without decoding its pixels.

    A trace notes none. Raises as `read_photo`.
    """
    if is_table(path):
        return NOTHING_NOTED
    with opened_image(path) as image:
        return place_from_exif(image.getexif().get_ifd(IFD.GPSInfo), xmp_of(image))


def read_noted_time(path: Picture) -> datetime | None:
    """Return the time in a photo's EXIF, by the camera's clock.

    It has a zone if EXIF notes one. None for a trace, and where EXIF notes no time. Raises as
    `read_photo`.
    """
    if is_table(path):
        return None
    with opened_image(path) as image:
        exif = image.getexif().get_ifd(IFD.Exif)
        return noted_time(exif, Base.DateTimeOriginal, Base.OffsetTimeOriginal)


def check_fov(fov_deg: float | None, projection: Projection | None) -> None:
    """Raise `InputError` for an impossible field of view."""
    if fov_deg is not None:
        Projection(projection or Projection.PERSPECTIVE).check_fov_deg(fov_deg)
