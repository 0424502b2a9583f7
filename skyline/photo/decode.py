"""Image files to upright 8-bit RGB.

Pillow decodes, not OpenCV: it hands out EXIF along with the pixels, refuses a truncated JPEG
(OpenCV fills the rest with grey, which has a skyline), reports through exceptions rather than on
stderr, and shrinks huge JPEGs while decoding them.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError
from PIL.ExifTags import IFD, Base

from skyline.errors import InputError, MissingFileError
from skyline.photo.exif import fov_from_exif
from skyline.photo.frame import UInt8Array

MAX_DECODED_PIXELS = 100_000_000
"""Larger JPEGs are decoded at half or a quarter of their size; other formats are refused."""

_HEIC_BRANDS = (b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1")
_TURNED_ORIENTATIONS = (5, 6, 7, 8)
_DEEP_MODES = ("I", "F")


@dataclass(frozen=True, slots=True, eq=False)
class DecodedImage:
    """An image file's pixels.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
        Upright; transparent parts are white.
    fov_deg : float or None
        Horizontal field of view, where EXIF has it.
    """

    rgb: UInt8Array
    fov_deg: float | None


def decode_image(path: str | Path) -> DecodedImage:
    """Read an image file.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        It is not an image, damaged, too large, or in a format without a decoder.
    """
    path = Path(path)
    if not path.exists():
        raise MissingFileError(f"{path} does not exist; expected a photo, a sky mask or a trace")
    if not path.is_file():
        raise InputError(f"{path} is not a file; expected a photo, a sky mask or a trace")
    try:
        with warnings.catch_warnings():
            # Pillow warns of large images, which are bounded here, and of odd EXIF.
            warnings.simplefilter("ignore")
            return _decode(path)
    except UnidentifiedImageError as error:
        raise InputError(_unknown_format(path)) from error
    except Image.DecompressionBombError as error:
        raise InputError(_too_large(path, "more than 178")) from error
    except InputError:
        raise
    except Exception as error:  # Decoders raise nearly anything on damaged files.
        raise InputError(
            f"{path} cannot be decoded ({error}); it is damaged or cut short: copy it again, or "
            "open and save it as PNG"
        ) from error


def _decode(path: Path) -> DecodedImage:
    with Image.open(path) as image:
        exif = image.getexif()
        turned = exif.get(Base.Orientation) in _TURNED_ORIENTATIONS
        fov_deg = fov_from_exif({**exif, **exif.get_ifd(IFD.Exif)}, image.size, turned)
        while _pixels(image) > MAX_DECODED_PIXELS:
            before = image.size
            image.draft("RGB", (before[0] // 2, before[1] // 2))
            if image.size == before:
                raise InputError(_too_large(path, f"{_pixels(image) / 1e6:.0f}"))
        return DecodedImage(_to_rgb(ImageOps.exif_transpose(image)), fov_deg)


def _pixels(image: Image.Image) -> int:
    return image.size[0] * image.size[1]


def _to_rgb(image: Image.Image) -> UInt8Array:
    """Return any mode's pixels as (H, W, 3) uint8; deep greys are scaled to their brightest."""
    if image.mode.startswith(_DEEP_MODES):
        deep = np.nan_to_num(np.asarray(image, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        scaled = np.clip(deep * (255.0 / max(float(deep.max()), 1e-6)), 0.0, 255.0)
        return np.repeat(np.rint(scaled).astype(np.uint8)[:, :, np.newaxis], 3, axis=2)
    if image.has_transparency_data:
        image = image.convert("RGBA")
        image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
    rgb: NDArray[np.uint8] = np.asarray(image.convert("RGB"))
    return rgb


def _unknown_format(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(12)
    if head[4:8] == b"ftyp" and head[8:12] in _HEIC_BRANDS:
        return (
            f"{path} is a HEIC photo, for which there is no decoder here; convert it to JPEG or PNG"
        )
    return f"{path} is not an image that can be read; expected JPEG, PNG, TIFF, WebP or a CSV trace"


def _too_large(path: Path, megapixels: str) -> str:
    return (
        f"{path} has {megapixels} megapixels; expected at most {MAX_DECODED_PIXELS / 1e6:.0f} (178 "
        "in a JPEG): scale it down, 20 are plenty"
    )
