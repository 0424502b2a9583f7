"""Image files: finding photos, and decoding them.

Pillow decodes them, not OpenCV: it returns EXIF along with the pixels, refuses a truncated JPEG
(OpenCV fills the rest with grey, which has a skyline), reports through exceptions rather than on
stderr, and shrinks huge JPEGs while decoding them.
"""

import io
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from threading import Lock

import cv2
import numpy as np
from PIL import Image, UnidentifiedImageError
from PIL.ExifTags import Base

from skyline.arrays import UInt8Array
from skyline.errors import InputError, MissingFileError
from skyline.files.disk import STANDARD, read_bytes
from skyline.files.folders import files_in, left_out_in_words, names_in_words
from skyline.files.tables import is_table
from skyline.store.read import is_store

_log = logging.getLogger(__name__)

Picture = str | Path | Image.Image | UInt8Array
"""A photo, a sky mask or a trace: its file, ``-`` for standard input, or its pixels."""


@dataclass(frozen=True, slots=True)
class SizeLimits:
    """The largest pictures that are decoded, in pixels."""

    decoded: int = 100_000_000
    """A larger JPEG is decoded at a half to an eighth of its size; other formats are refused."""
    jpeg: int = 400_000_000
    """A larger JPEG is refused: a progressive JPEG is decoded whole, at any size."""


LIMITS = SizeLimits()

EXPECTED = "expected a photo, a sky mask or a trace"
_FORMATS = (
    "JPEG", "MPO", "PNG", "TIFF", "WEBP", "BMP", "GIF", "PPM", "JPEG2000", "AVIF", "HEIF",
)  # fmt: skip
"""Formats that Pillow may decode; others run programs, or are not pictures."""
_PLUGINS = ("Jpeg", "Mpo", "Png", "Tiff", "WebP", "Bmp", "Gif", "Ppm", "Jpeg2K", "Avif")
"""Pillow's modules for these formats; to load its forty others takes a twentieth of a second."""
_PHOTO_SUFFIXES = (
    ".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".tif", ".tiff", ".webp", ".heic", ".heif",
    ".avif", ".jp2", ".bmp",
)  # fmt: skip
"""Suffixes of photos: a file with one of them that cannot be read is a damaged photo."""
_TIFF_SUFFIXES = (".tif", ".tiff", "")
_GEO_KEYS = 34735
"""The tag of a GeoTIFF's coordinate reference system."""
_COPY_OR_MASK = 0b101
"""Bits of NewSubfileType: a page is a smaller copy, or a mask of transparency."""
_HEIF_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}

_pillow_limit = Lock()
"""Held while Pillow's own size limit, which all threads share, is lifted."""


def name_of(picture: Picture) -> str:
    """Return the file of a picture, for messages; ``the image`` for pixels."""
    return str(picture) if isinstance(picture, str | Path) else "the image"


def photos_in(folder: Path, is_skipped: Callable[[Path], bool] = lambda _: False) -> list[Path]:
    """Return the pictures in a folder and in the folders in it.

    Pillow says which files are pictures, whatever they are called. A warning names the other files.
    Raw files are left out, and so are folders for which ``is_skipped`` returns True. Raises
    `InputError` if there is no picture.
    """
    photos: list[Path] = []
    others: list[str] = []
    for path in files_in(folder, is_skipped):
        if _is_photo(path):
            photos.append(path)
        else:
            others.append(str(path.relative_to(folder)))
    if not photos:
        found = f" among {names_in_words(others)}" if others else ""
        raise InputError(f"{folder} has no pictures{found}; expected {', '.join(_PHOTO_SUFFIXES)}")
    if others:
        about = left_out_in_words(others, "pictures" if len(others) > 1 else "picture")
        _log.warning("%s: %s", folder, about)
    return photos


def _is_photo(path: Path) -> bool:
    """Return whether a file is a photo, even a damaged one."""
    suffix = path.suffix.lower()
    is_named_so = suffix in _PHOTO_SUFFIXES
    is_thumbnail = suffix == ".thm"  # Of a video; cameras write a JPEG.
    name_decides = is_thumbnail or (is_named_so and suffix not in _TIFF_SUFFIXES)
    if name_decides or not path.exists():
        return is_named_so
    try:
        with opened_image(path) as image:
            # A raw file is a TIFF by another name, and a map is one with a place.
            is_map = _GEO_KEYS in image.getexif()
            return image.format != "TIFF" or (suffix in _TIFF_SUFFIXES and not is_map)
    except InputError as error:
        is_foreign = isinstance(error.__cause__, UnidentifiedImageError)
        return is_named_so or not is_foreign or _is_heif(path)


def _is_heif(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(12)
    return head[4:8] == b"ftyp" and head[8:] in _HEIF_BRANDS


@contextmanager
def opened_image(picture: Picture) -> Iterator[Image.Image]:
    """Open a picture for the ``with`` block.

    An error of decoding in the block becomes an `InputError`.

    Raises `MissingFileError` if there is no such file, and `InputError` if it is not an image, or
    if an array is not (H, W), (H, W, 3) or (H, W, 4) uint8.
    """
    if isinstance(picture, Image.Image):
        with _decoded("the image"):
            yield picture
    elif isinstance(picture, np.ndarray):
        yield _image_of(picture)
    else:
        with _opened_file(Path(picture)) as image:
            yield image


def _image_of(pixels: UInt8Array) -> Image.Image:
    is_image = pixels.shape[2:] in {(), (3,), (4,)} and pixels.size and pixels.ndim > 1
    if pixels.dtype != np.uint8 or not is_image:
        raise InputError(
            f"the image is an array of {pixels.dtype} of shape {pixels.shape}; expected (H, W, 3) "
            "uint8"
        )
    return Image.fromarray(pixels)


@contextmanager
def _opened_file(path: Path) -> Iterator[Image.Image]:
    source: Path | io.BytesIO = path
    if str(path) == STANDARD:
        source = io.BytesIO(read_bytes(path, EXPECTED))
    elif not path.exists():
        raise MissingFileError(f"{path} does not exist; {EXPECTED}")
    elif not path.is_file():
        raise InputError(f"{path} is not a file; {EXPECTED}")
    try:
        with _decoded(str(path)), warnings.catch_warnings(), _unlimited_size():
            # Pillow warns about large images, which are bounded here, and about odd EXIF.
            warnings.simplefilter("ignore")
            with suppress(ImportError):
                import_module("pillow_heif").register_heif_opener()
            for plugin in _PLUGINS:
                with suppress(ImportError):  # A Pillow may lack one.
                    import_module(f"PIL.{plugin}ImagePlugin")
            formats = [name for name in _FORMATS if name in Image.OPEN]
            with Image.open(source, formats=formats) as image:
                yield image
    except UnidentifiedImageError as error:
        raise InputError(f"{path} is {_why_unidentified(path)}") from error


def _why_unidentified(path: Path) -> str:
    """Return why a file is not an image, and what to do."""
    if is_store(path):
        return f"a store; {EXPECTED}"
    if str(path) != STANDARD and _is_heif(path):
        return (
            "a HEIC photo, for which there is no decoder here; convert it to JPEG or PNG, or "
            "pip install pillow-heif"
        )
    reason = "not an image that can be read; expected JPEG, PNG, TIFF or WebP"
    return reason if is_table(path) else f"{reason}, or a trace named .csv"


@contextmanager
def _decoded(name: str) -> Iterator[None]:
    """Turn errors of decoding in the ``with`` block into `InputError`."""
    try:
        yield
    except (InputError, UnidentifiedImageError):
        raise
    except Exception as error:  # Decoders raise nearly anything on damaged files.
        raise InputError(
            f"{name} cannot be decoded ({str(error).partition(' (')[0]}); it is damaged or cut "
            "short: copy it again, or open and save it as PNG"
        ) from error


@contextmanager
def _unlimited_size() -> Iterator[None]:
    """Lift Pillow's size limit, so that `shrink_if_large` can shrink pictures."""
    with _pillow_limit:
        before = Image.MAX_IMAGE_PIXELS
        Image.MAX_IMAGE_PIXELS = None
        try:
            yield
        finally:
            Image.MAX_IMAGE_PIXELS = before


def check_one_picture(name: str, image: Image.Image) -> None:
    """Raise `InputError` for a raw file or several pictures.

    The first picture of a raw file is a preview, with 1 as its NewSubfileType. A TIFF may have
    several pictures or layers.
    """
    if image.format != "TIFF":
        return
    if image.getexif().get(Base.NewSubfileType) == 1:
        raise InputError(
            f"{name} begins with a preview of {image.width} x {image.height} px, as a raw file "
            "does; develop it, and save it as JPEG, PNG or TIFF"
        )
    # A page that a caller has chosen is read.
    if not image.tell() and (others := _other_pages(image)):
        raise InputError(
            f"{name} has {others + 1} pages or layers; expected one photo: flatten it, or save the "
            "page as a file of its own"
        )


def shrink_if_large(name: str, image: Image.Image, limits: SizeLimits = LIMITS) -> None:
    """Decode a large JPEG smaller; raises `InputError` for other large images."""
    width, height = image.size
    if width * height <= limits.jpeg:
        for shrink in (2, 4, 8):
            if image.width * image.height > limits.decoded:
                image.draft("RGB", (width // shrink, height // shrink))
    if image.size != (width, height):
        _log.warning(
            "%s, %d x %d px, is read at %d x %d px; rows and columns refer to that size",
            *(name, width, height, *image.size),
        )
    if image.width * image.height > limits.decoded:
        raise InputError(
            f"{name} has {width * height / 1e6:.0f} megapixels; expected at most "
            f"{limits.decoded / 1e6:.0f} ({limits.jpeg / 1e6:.0f} in a JPEG): scale it down, 20 "
            "are plenty"
        )


def _other_pages(image: Image.Image) -> int:
    """Return how many pages of a TIFF are further pictures.

    Smaller copies and masks of the first page are none.
    """
    width, height = image.size
    count = 0
    for page in range(1, getattr(image, "n_frames", 1)):
        image.seek(page)
        kind = image.getexif().get(Base.NewSubfileType, 0)
        is_copy = image.width < width and image.height < height
        count += not (kind & _COPY_OR_MASK or (is_copy and not kind))
    image.seek(0)
    return count


def made_smaller(rgb: UInt8Array, longer_px: int) -> UInt8Array:
    """Return a picture (h, w, 3) of at most ``longer_px`` a side."""
    height, width = rgb.shape[:2]
    scale = min(1.0, longer_px / max(height, width))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def rgb_of(image: Image.Image) -> UInt8Array:
    """Return the pixels of any mode as (H, W, 3) uint8.

    Deep greys are scaled to their brightest value; transparent parts become white.
    """
    if image.mode.startswith(("I", "F")):
        deep = np.nan_to_num(np.asarray(image, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        scaled = np.clip(deep * (255.0 / max(float(deep.max()), 1e-6)), 0.0, 255.0)
        return np.repeat(np.rint(scaled).astype(np.uint8)[:, :, np.newaxis], 3, axis=2)
    if image.has_transparency_data:
        image = image.convert("RGBA")
        image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
    rgb: UInt8Array = np.asarray(image if image.mode == "RGB" else image.convert("RGB"))
    return rgb
