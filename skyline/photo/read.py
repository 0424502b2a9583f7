"""Reading photos, sky masks and traces, and drawing a skyline on its photo.

Pillow decodes, not OpenCV: it returns EXIF along with the pixels, refuses a truncated JPEG
(OpenCV fills the rest with grey, which has a skyline), reports through exceptions rather than on
stderr, and shrinks huge JPEGs while decoding them.
"""

import io
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError
from PIL.ExifTags import IFD, Base

from skyline.arrays import UInt8Array
from skyline.camera import Projection
from skyline.errors import InputError, MissingFileError, suffix_of
from skyline.files import (
    STANDARD,
    files_in,
    left_out_in_words,
    names_in_words,
    read_bytes,
    write_whole,
)
from skyline.photo.exif import NOTHING_NOTED, NotedPlace, place_from_exif
from skyline.photo.extract import extract_skyline
from skyline.photo.lens import MAX_PINHOLE_ASPECT, camera_of
from skyline.photo.sky_model import is_sky_mask, model_skyline, skyline_of_mask
from skyline.photo.skyline import Lens, PhotoSkyline, check_of_image
from skyline.photo.trace import read_trace
from skyline.photo.xmp import xmp_of
from skyline.tables import is_table

_log = logging.getLogger(__name__)

MAX_DECODED_PIXELS = 100_000_000
"""Larger JPEGs are decoded at a half to an eighth of their size; other formats are refused."""
MAX_JPEG_PIXELS = 400_000_000
"""Larger JPEGs are refused: a progressive JPEG is decoded whole, at any size."""

Picture = str | Path | Image.Image | UInt8Array
"""A photo, a sky mask or a trace: its file, ``-`` for standard input, or its pixels."""

OVERLAYS = (".png",)
"""The suffix of overlays."""
_EXPECTED = "expected a photo, a sky mask or a trace"
_size_limit = Lock()

_FORMATS = (
    "JPEG", "MPO", "PNG", "TIFF", "WEBP", "BMP", "GIF", "PPM", "JPEG2000", "AVIF", "HEIF",
)  # fmt: skip
"""Formats that Pillow may decode; others run programs, or are no pictures."""
_PHOTOS = (
    ".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".tif", ".tiff", ".webp", ".heic", ".heif",
    ".avif", ".jp2", ".bmp",
)  # fmt: skip
"""Endings of photos: one that cannot be read is damaged, and its error is due."""
_TIFFS = (".tif", ".tiff", "")
_GEO_KEYS = 34735
"""The tag of a GeoTIFF's coordinate reference system."""
_THUMBNAIL = ".thm"
"""The ending of a camera's thumbnail of a video, which is a JPEG."""
_HEIF_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}
_SKYLINE_RGB, _OTHER_RGB = (255, 0, 60), (255, 160, 0)


@dataclass(frozen=True, slots=True, eq=False)
class Photo:
    """An image file's pixels and the file's notes on the camera.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
        Upright; transparent parts are white.
    fov_deg : float or None
        Horizontal field of view, up to 360; None if EXIF and XMP note none.
    projection : Projection
        Perspective, unless EXIF or XMP note a panorama.
    place : NotedPlace
        Place and heading noted in EXIF.
    lens : Lens, optional
        Accuracy of the field of view, if the file notes it.
    """

    rgb: UInt8Array
    fov_deg: float | None
    projection: Projection
    place: NotedPlace
    lens: Lens | None = None

    @property
    def blank(self) -> PhotoSkyline:
        """The photo as a query without a skyline, which is enough to see what a pose shows."""
        height, width = self.rgb.shape[:2]
        unknown = np.full(width, np.nan)
        return self.described(PhotoSkyline(unknown, np.zeros(width), width, height))

    def described(self, query: PhotoSkyline) -> PhotoSkyline:
        """Return a skyline of this photo with the file's notes on the camera."""
        return replace(
            query,
            fov_deg=self.fov_deg,
            projection=self.projection,
            noted=self.place,
            lens=self.lens,
        )


def read_query(
    path: Picture,
    fov_deg: float | None = None,
    *,
    projection: Projection | None = None,
    sky_model: Any = None,
) -> PhotoSkyline:
    """Read a query: a trace (``.csv``), a sky mask (nearly black and white), else a photo.

    Parameters
    ----------
    path : str, Path, PIL image, or (H, W) or (H, W, 3) uint8
    fov_deg : float, optional
        Horizontal field of view, degrees: 1 to 179, or to 360 for a panorama. By default it is read
        from the photo's EXIF or XMP.
    projection : Projection, optional
        Perspective by default, unless the photo's EXIF or XMP note a panorama.
    sky_model : onnxruntime.InferenceSession or path, optional
        Segments the sky in photos; see `skyline.photo.sky_model`.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The file cannot be used, or no skyline is found in it.
    """
    if is_table(path):
        return read_trace(path, fov_deg, projection)
    return extract_photo(path, fov_deg, projection=projection, sky_model=sky_model)[1]


def extract_photo(
    path: Picture,
    fov_deg: float | None = None,
    *,
    projection: Projection | None = None,
    sky_model: Any = None,
) -> tuple[UInt8Array, PhotoSkyline]:
    """Read a photo or a sky mask and find its skyline, as `read_query`.

    The first item is the pixels, (H, W, 3) uint8 RGB, upright.
    """
    photo = read_photo(path, fov_deg, projection=projection)
    height, width = photo.rgb.shape[:2]
    is_noted = photo.fov_deg is not None or photo.projection is not Projection.PERSPECTIVE
    if not is_noted and width > MAX_PINHOLE_ASPECT * height:
        _log.warning(
            "%s has %d x %d px and is matched as a strip of a photo; if it is a panorama, give "
            "--projection cylindrical and --fov-deg",
            name_of(path),
            width,
            height,
        )
    try:
        if is_sky_mask(photo.rgb):
            query = skyline_of_mask(photo.rgb)
        elif sky_model is None:
            query = extract_skyline(photo.rgb)
        else:
            query = model_skyline(photo.rgb, sky_model)
    except InputError as error:
        raise InputError(f"{name_of(path)}: {error}") from error
    return photo.rgb, photo.described(query)


def read_photo(
    path: Picture, fov_deg: float | None = None, *, projection: Projection | None = None
) -> Photo:
    """Read a photo or a sky mask: its pixels, upright, and its file's notes on the camera.

    Parameters
    ----------
    fov_deg, projection
        As in `read_query`.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The file cannot be decoded, or is a sliver.
    """
    projection = None if projection is None else Projection(projection)
    check_fov(fov_deg, projection)
    name = name_of(path)
    with opened_image(path) as image:
        width, height = image.size
        _require_usable(name, image)
        upright = ImageOps.exif_transpose(image)
        # Decoders differ: some have already turned the pixels, some the size as well, and each
        # leaves other tags. The upright picture shows whether the file's size is upright.
        if (upright.width < upright.height) != (width < height):
            width, height = height, width
        exif = image.getexif()
        tags = {**exif, **exif.get_ifd(IFD.Exif)}
        xmp = xmp_of(image)
        noted, lens = camera_of(tags, xmp, (width, height))
        place = place_from_exif(exif.get_ifd(IFD.GPSInfo), xmp)
        rgb = _to_rgb(upright)
    if min(rgb.shape[:2]) < 2:
        raise InputError(f"{name} has {width} x {height} px; expected a photo or a sky mask")
    # Notes on a lens do not apply to a panorama, nor those on a panorama to a lens.
    is_as_noted = projection is None or projection.is_panorama == noted.is_panorama
    if fov_deg is not None or not is_as_noted:
        return Photo(rgb, fov_deg, projection or noted, place)
    return Photo(rgb, lens.fov_deg, projection or noted, place, lens)


def photos_in(folder: Path, is_skipped: Callable[[Path], bool] = lambda _: False) -> list[Path]:
    """Return the pictures in a folder and in the folders in it; a warning names other files.

    Pillow says which files are pictures, whatever they are called. Raw files are left out, and
    folders that ``is_skipped`` names. Raises `InputError` where there is no picture.
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
        raise InputError(f"{folder} has no pictures{found}; expected {', '.join(_PHOTOS)}")
    if others:
        about = left_out_in_words(others, "pictures" if len(others) > 1 else "picture")
        _log.warning("%s: %s", folder, about)
    return photos


def _is_photo(path: Path) -> bool:
    """Return whether a file of a folder is a photo, even if it cannot be decoded."""
    ending = path.suffix.lower()
    is_named_so = ending in _PHOTOS
    if ending == _THUMBNAIL or (is_named_so and ending not in _TIFFS) or not path.exists():
        return is_named_so
    try:
        with opened_image(path) as image:
            # A raw file is a TIFF by another name, and a map is one with a place.
            is_map = _GEO_KEYS in image.getexif()
            return image.format != "TIFF" or (ending in _TIFFS and not is_map)
    except InputError as error:
        is_foreign = isinstance(error.__cause__, UnidentifiedImageError)
        return is_named_so or not is_foreign or _is_heif(path)


def _is_heif(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(12)
    return head[4:8] == b"ftyp" and head[8:] in _HEIF_BRANDS


def read_noted_place(path: Picture) -> NotedPlace:
    """Return the place noted in a query's EXIF, without decoding its pixels.

    A trace notes none. Raises as `read_photo`.
    """
    if is_table(path):
        return NOTHING_NOTED
    with opened_image(path) as image:
        return place_from_exif(image.getexif().get_ifd(IFD.GPSInfo), xmp_of(image))


def check_fov(fov_deg: float | None, projection: Projection | None) -> None:
    """Raise `InputError` for an impossible field of view, before any file is read."""
    if fov_deg is not None:
        Projection(projection or Projection.PERSPECTIVE).check_fov_deg(fov_deg)


def read_picture(path: str | Path) -> UInt8Array | None:
    """Return a query's photo (H, W, 3) uint8 RGB, upright; None for a trace or a sky mask.

    Raises as `read_photo`.
    """
    if is_table(path):
        return None
    image = read_photo(path).rgb
    return None if is_sky_mask(image) else image


def write_overlay(photo: UInt8Array, query: PhotoSkyline, path: str | Path) -> None:
    """Write a photo (H, W, 3) uint8 RGB as PNG with the skyline's trusted columns drawn on it.

    Other crests that may be the skyline are drawn in another colour. Raises `InputError` if the
    skyline belongs to an image of another size, the file is not named .png, or it cannot be
    written.
    """
    suffix_of(path, OVERLAYS)
    check_of_image(query, photo.shape)
    drawn = photo.copy()
    thickness = max(1, round(query.width_px / 1000))
    other_px = query.other_crest_px()
    columns = np.flatnonzero(np.isfinite(other_px))
    rows = np.rint(other_px[columns]).astype(np.intp)
    for down in range(thickness):
        drawn[np.clip(rows + down, 0, len(drawn) - 1), columns] = _OTHER_RGB
    columns = np.flatnonzero(query.trusted)
    for run in np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1):
        points = np.stack([run, np.rint(query.row_px[run])], axis=1).astype(np.int32)
        cv2.polylines(drawn, [points], False, _SKYLINE_RGB, thickness)
    picture = io.BytesIO()
    Image.fromarray(drawn).save(picture, format="PNG", compress_level=1)
    write_whole(Path(path), picture.getvalue())


def name_of(picture: Picture) -> str:
    """Return the file of a picture, for messages; ``the image`` for pixels."""
    return str(picture) if isinstance(picture, str | Path) else "the image"


@contextmanager
def opened_image(picture: Picture) -> Iterator[Image.Image]:
    """Open a picture; errors of decoding in the ``with`` block raise as in `read_photo`."""
    if isinstance(picture, Image.Image):
        with _decoded("the image"):
            yield picture
        return
    if isinstance(picture, np.ndarray):
        is_image = picture.shape[2:] in {(), (3,), (4,)} and picture.size and picture.ndim > 1
        if picture.dtype != np.uint8 or not is_image:
            raise InputError(
                f"the image is an array of {picture.dtype} of shape {picture.shape}; expected (H, "
                "W, 3) uint8"
            )
        yield Image.fromarray(picture)
        return
    path = Path(picture)
    source: Path | io.BytesIO = path
    if str(path) == STANDARD:
        source = io.BytesIO(read_bytes(path, _EXPECTED))
    elif not path.exists():
        raise MissingFileError(f"{path} does not exist; {_EXPECTED}")
    elif not path.is_file():
        raise InputError(f"{path} is not a file; {_EXPECTED}")
    try:
        with _decoded(str(path)), warnings.catch_warnings(), _unlimited_size():
            # Pillow warns about large images, which are bounded here, and about odd EXIF.
            warnings.simplefilter("ignore")
            with suppress(ImportError):
                import_module("pillow_heif").register_heif_opener()
            Image.init()
            formats = [name for name in _FORMATS if name in Image.OPEN]
            with Image.open(source, formats=formats) as image:
                yield image
    except UnidentifiedImageError as error:
        reason = "not an image that can be read; expected JPEG, PNG, TIFF or WebP"
        if not is_table(path):
            reason += ", or a trace named .csv"
        if str(path) != STANDARD and _is_heif(path):
            reason = (
                "a HEIC photo, for which there is no decoder here; convert it to JPEG or PNG, or "
                "pip install pillow-heif"
            )
        raise InputError(f"{path} is {reason}") from error


@contextmanager
def _decoded(name: str) -> Iterator[None]:
    """Turn any error of decoding in the ``with`` block into an `InputError` of one line."""
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
    """Lift Pillow's limit, which refuses pictures that `_require_usable` shrinks."""
    with _size_limit:
        before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            yield
        finally:
            Image.MAX_IMAGE_PIXELS = before


def _require_usable(name: str, image: Image.Image) -> None:
    """Let a large JPEG be decoded smaller; raise `InputError` for other large images and raw files.

    Raw files are TIFFs whose first picture is a preview, of which NewSubfileType is 1.
    """
    width, height = image.size
    if image.format == "TIFF" and image.getexif().get(Base.NewSubfileType) == 1:
        raise InputError(
            f"{name} begins with a preview of {width} x {height} px, as a raw file does; develop "
            "it, and save it as JPEG, PNG or TIFF"
        )
    if width * height <= MAX_JPEG_PIXELS:
        for shrink in (2, 4, 8):
            if image.width * image.height > MAX_DECODED_PIXELS:
                image.draft("RGB", (width // shrink, height // shrink))
    if image.size != (width, height):
        _log.warning(
            "%s, %d x %d px, is read at %d x %d px; rows and columns refer to that size",
            *(name, width, height, *image.size),
        )
    if image.width * image.height > MAX_DECODED_PIXELS:
        raise InputError(
            f"{name} has {width * height / 1e6:.0f} megapixels; expected at most "
            f"{MAX_DECODED_PIXELS / 1e6:.0f} ({MAX_JPEG_PIXELS / 1e6:.0f} in a JPEG): scale it "
            "down, 20 are plenty"
        )


def _to_rgb(image: Image.Image) -> UInt8Array:
    """Return any mode's pixels as (H, W, 3) uint8; deep greys are scaled to their brightest."""
    if image.mode.startswith(("I", "F")):
        deep = np.nan_to_num(np.asarray(image, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        scaled = np.clip(deep * (255.0 / max(float(deep.max()), 1e-6)), 0.0, 255.0)
        return np.repeat(np.rint(scaled).astype(np.uint8)[:, :, np.newaxis], 3, axis=2)
    if image.has_transparency_data:
        image = image.convert("RGBA")
        image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
    rgb: UInt8Array = np.asarray(image.convert("RGB"))
    return rgb
