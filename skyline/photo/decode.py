"""Image files to upright 8-bit RGB.

Pillow decodes, not OpenCV: it hands out EXIF along with the pixels, refuses a truncated JPEG
(OpenCV fills the rest with grey, which has a skyline), reports through exceptions rather than on
stderr, and shrinks huge JPEGs while decoding them.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError
from PIL.ExifTags import IFD, Base

from skyline.arrays import UInt8Array
from skyline.errors import InputError, MissingFileError
from skyline.photo.exif import NotedPlace, place_from_exif
from skyline.photo.lens import Lens, lens_of, swept_lens_of
from skyline.photo.projection import Projection, panorama_of_xmp
from skyline.photo.query import QuerySkyline

MAX_DECODED_PIXELS = 100_000_000
"""Larger JPEGs are decoded at a half to an eighth of their size; other formats are refused."""
MAX_JPEG_PIXELS = 400_000_000
"""A progressive JPEG is held whole, two or three numbers a pixel, whatever it is decoded at."""

_size_limit = Lock()

_FORMATS = ("JPEG", "MPO", "PNG", "TIFF", "WEBP", "BMP", "GIF", "PPM", "JPEG2000", "AVIF")
"""What Pillow may decode, as far as it can: others run programs, or are no pictures."""
_HEIC_BRANDS = (b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1")
_TURNED_ORIENTATIONS = (5, 6, 7, 8)
_DEEP_MODES = ("I", "F")


@dataclass(frozen=True, slots=True, eq=False)
class Photo:
    """An image file's pixels, and what the file notes of them.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
        Upright; transparent parts are white.
    fov_deg : float or None
        Horizontal field of view, up to 360, where EXIF or XMP has it.
    projection : Projection
        Perspective, unless XMP says that it is a panorama.
    place : NotedPlace
        Where it was taken and which way, as far as EXIF has it.
    lens : Lens, optional
        Whence the field of view is, where EXIF has been asked.
    """

    rgb: UInt8Array
    fov_deg: float | None
    projection: Projection
    place: NotedPlace
    lens: Lens | None = None

    def described(self, query: QuerySkyline) -> QuerySkyline:
        """Return a skyline of this photo with what the file notes of it."""
        return replace(
            query,
            fov_deg=self.fov_deg,
            projection=self.projection,
            noted=self.place,
            lens=self.lens,
        )


def decode_image(path: str | Path) -> Photo:
    """Read an image file; raises `MissingFileError`, `InputError` for what cannot be decoded."""
    path = Path(path)
    if not path.exists():
        raise MissingFileError(f"{path} does not exist; expected a photo, a sky mask or a trace")
    if not path.is_file():
        raise InputError(f"{path} is not a file; expected a photo, a sky mask or a trace")
    try:
        with warnings.catch_warnings():
            # Pillow warns of large images, which are bounded here, and of odd EXIF.
            warnings.simplefilter("ignore")
            _register_heic(path)
            with _unlimited_size():
                return _decode(path)
    except UnidentifiedImageError as error:
        raise InputError(_unknown_format(path)) from error
    except InputError:
        raise
    except Exception as error:  # Decoders raise nearly anything on damaged files.
        raise InputError(
            f"{path} cannot be decoded ({error}); it is damaged or cut short: copy it again, or "
            "open and save it as PNG"
        ) from error


def _decode(path: Path) -> Photo:
    with Image.open(path, formats=_formats()) as image:
        exif = image.getexif()
        projection, fov_deg, lens = _camera(_xmp(image), exif, image.size)
        _require_bounded(path, image)
        place = place_from_exif(exif.get_ifd(IFD.GPSInfo))
        return Photo(_to_rgb(ImageOps.exif_transpose(image)), fov_deg, projection, place, lens)


def _camera(
    xmp: str, exif: Image.Exif, stored_size: tuple[int, int]
) -> tuple[Projection, float | None, Lens | None]:
    """Return what a file notes of its projection and its field of view."""
    panorama = panorama_of_xmp(xmp)
    if panorama is not None:
        return *panorama, None
    turned = exif.get(Base.Orientation) in _TURNED_ORIENTATIONS
    tags = {**exif, **exif.get_ifd(IFD.Exif)}
    swept = swept_lens_of(tags, stored_size[::-1] if turned else stored_size)
    if swept is not None:
        return Projection.CYLINDRICAL, swept.fov_deg, swept
    lens = lens_of(tags, stored_size, turned)
    return Projection.PERSPECTIVE, lens.fov_deg, lens


def _formats() -> list[str]:
    Image.init()
    return [name for name in (*_FORMATS, "HEIF") if name in Image.OPEN]


@contextmanager
def _unlimited_size() -> Iterator[None]:
    """Lift Pillow's own limit, which refuses what `_require_bounded` shrinks."""
    with _size_limit:
        before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            yield
        finally:
            Image.MAX_IMAGE_PIXELS = before


def _require_bounded(path: Path, image: Image.Image) -> None:
    """Have a large JPEG decoded smaller, and refuse what cannot be."""
    megapixels = f"{_pixels(image) / 1e6:.0f}"
    if _pixels(image) > MAX_JPEG_PIXELS:
        raise InputError(_too_large(path, megapixels))
    whole = image.size
    for shrink in (2, 4, 8):
        if _pixels(image) > MAX_DECODED_PIXELS:
            image.draft("RGB", (whole[0] // shrink, whole[1] // shrink))
    if _pixels(image) > MAX_DECODED_PIXELS:
        raise InputError(_too_large(path, megapixels))


def _xmp(image: Image.Image) -> str:
    noted = image.info.get("xmp", image.info.get("XML:com.adobe.xmp", ""))
    return noted.decode("utf-8", "replace") if isinstance(noted, bytes) else str(noted)


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


def _is_heic(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(12)
    return head[4:8] == b"ftyp" and head[8:12] in _HEIC_BRANDS


def _register_heic(path: Path) -> None:
    """Let Pillow read HEIC where its plug-in is installed."""
    if not _is_heic(path):
        return
    try:
        import_module("pillow_heif").register_heif_opener()
    except ImportError:
        return


def _unknown_format(path: Path) -> str:
    if _is_heic(path):
        return (
            f"{path} is a HEIC photo, for which there is no decoder here; convert it to JPEG or "
            "PNG, or pip install pillow-heif"
        )
    return f"{path} is not an image that can be read; expected JPEG, PNG, TIFF, WebP or a CSV trace"


def _too_large(path: Path, megapixels: str) -> str:
    return (
        f"{path} has {megapixels} megapixels; expected at most {MAX_DECODED_PIXELS / 1e6:.0f} "
        f"({MAX_JPEG_PIXELS / 1e6:.0f} in a JPEG): scale it down, 20 are plenty"
    )
