"""Image files: formats, damage, size, orientation and field of view."""

import io

import numpy as np
import pytest
from numpy.testing import assert_allclose
from photo_scenes import make_scene, photo_folder
from PIL import Image, features
from PIL.ExifTags import IFD, Base

from skyline.errors import InputError
from skyline.photo.extract import extract_skyline
from skyline.photo.image import SizeLimits, opened_image, photos_in, rgb_of, shrink_if_large
from skyline.photo.photo import read_photo
from skyline.photo.read import find_skyline, read_skyline
from skyline.photo.sky_mask import skyline_of_mask


@pytest.fixture(scope="module")
def scene():
    return make_scene("clear", 3, 320, 240)


def close_to(skyline, scene):
    on = skyline.trusted
    return on.mean() > 0.9 and np.median(np.abs(skyline.row_px - scene.row_px)[on]) < 1.0


def as_grey(scene):
    return np.asarray(Image.fromarray(scene.image).convert("L"))


@pytest.mark.parametrize(("beside_px", "fov_deg"), [(0, 63.44), (40, 67.6)])
def test_the_field_of_view_of_a_photo_in_a_border_is_of_the_whole_file(
    tmp_path, beside_px, fov_deg
):
    """28 mm on a frame of 4:3 see 63.44 degrees in 960 columns, and 67.6 in 1040."""
    photo = make_scene("clear", 3, 960, 720).image
    framed = Image.new("RGB", (960 + 2 * beside_px, 760), "white")
    framed.paste(Image.fromarray(photo), (beside_px, 0))
    exif = Image.Exif()
    exif.get_ifd(IFD.Exif)[Base.FocalLengthIn35mmFilm] = 28
    framed.save(tmp_path / "framed.jpg", quality=95, exif=exif)
    found = read_photo(tmp_path / "framed.jpg")
    # The border has blurred 3 columns on either side.
    assert found.fov_deg == pytest.approx(fov_deg, abs=0.5)
    assert "in a border" in found.lens.reason


VARIANTS = {
    "no_suffix": lambda scene: Image.fromarray(scene.image),
    "grey.jpg": lambda scene: Image.fromarray(as_grey(scene)),
    "twelve_bits.tif": lambda scene: Image.fromarray(as_grey(scene).astype(np.uint16) * 16),
    "float.tif": lambda scene: Image.fromarray(as_grey(scene).astype(np.float32) / 255),
    "cmyk.jpg": lambda scene: Image.fromarray(scene.image).convert("CMYK"),
    "palette.gif": lambda scene: Image.fromarray(scene.image).quantize(256),
    "alpha.png": lambda scene: Image.fromarray(scene.image).convert("RGBA"),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_any_format_gives_the_skyline(tmp_path, scene, name):
    path = tmp_path / name
    VARIANTS[name](scene).save(path, format="PNG" if path.suffix == "" else None)
    assert close_to(read_skyline(path), scene)


def test_pixels_and_standard_input_give_the_skyline_of_the_file(tmp_path, scene, monkeypatch):
    path = tmp_path / "photo.png"
    Image.fromarray(scene.image).save(path)
    of_file = read_skyline(path, 60.0)
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(path.read_bytes())))
    for other in (scene.image, Image.open(path), "-"):
        skyline = read_skyline(other, 60.0)
        np.testing.assert_array_equal(skyline.row_px, of_file.row_px)
        assert skyline.fov_deg == 60.0


def test_a_dithered_photo_is_no_mask(tmp_path, scene):
    Image.fromarray(scene.image).convert("1").save(tmp_path / "dithered.png")
    skyline = read_skyline(tmp_path / "dithered.png")
    assert np.median(np.abs(skyline.row_px - scene.row_px)[skyline.trusted]) < 3.0


def test_sky_cut_away_to_transparent_is_white(tmp_path):
    scene = make_scene("clear", 3, 720, 480)
    ground = np.arange(480)[:, np.newaxis] > scene.row_px
    rgba = np.dstack([scene.image, 255 * ground.astype(np.uint8)])
    Image.fromarray(rgba).save(tmp_path / "cut.png")
    photo = read_photo(tmp_path / "cut.png")
    assert (photo.rgb[0] == 255).all()
    assert close_to(find_skyline(photo), scene)


TURNED_BACK = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}
CONTAINERS = {
    "jpg": {"quality": 95},
    "png": {},
    "webp": {"lossless": True},
    "avif": {"quality": 100, "subsampling": "4:4:4"},
    "tif": {},
    "heic": {"quality": 100, "chroma": 444},
}


def turned(path, picture, orientation):
    """Write a picture as a camera does that was held another way up; return its path."""
    container = path.suffix[1:]
    if container == "heic":
        heif = pytest.importorskip("pillow_heif", reason="pillow-heif (extra heic) is absent")
        heif.register_heif_opener()
    if container == "avif" and not features.check("avif"):
        pytest.skip("this Pillow has no AVIF")
    stored = picture.transpose(TURNED_BACK[orientation]) if orientation > 1 else picture
    exif = Image.Exif()
    exif[Base.Orientation] = orientation
    noted = exif.get_ifd(IFD.Exif)
    noted[Base.FocalLengthIn35mmFilm] = 36
    # The frame that the sensor had is four times as large.
    noted[Base.ExifImageWidth], noted[Base.ExifImageHeight] = (4 * side for side in stored.size)
    stored.save(path, exif=exif.tobytes(), **CONTAINERS[container])
    return path


@pytest.mark.parametrize(
    ("container", "orientation", "upright"),
    [("jpg", turn, (320, 240)) for turn in range(1, 9)]
    + [(container, 6, (240, 320)) for container in CONTAINERS],
)
def test_a_turned_photo_is_the_same_in_every_container(
    tmp_path, scene, container, orientation, upright
):
    picture = Image.fromarray(scene.image).resize(upright)
    photo = read_photo(turned(tmp_path / f"turned.{container}", picture, orientation))
    skyline = find_skyline(photo)
    assert photo.rgb.shape[1::-1] == upright
    off = np.abs(photo.rgb.astype(int) - np.asarray(picture))
    assert off.mean() < (3.0 if container in ("jpg", "avif", "heic") else 1e-9)
    # 4:3 with a diagonal of 43.27 mm: 34.61 mm by 25.96 mm, before 36 mm.
    side_mm = 34.613 if upright == (320, 240) else 25.960
    assert skyline.fov_deg == pytest.approx(2 * np.degrees(np.arctan(side_mm / 72)), abs=0.01)
    plain = extract_skyline(np.asarray(picture))
    both = skyline.trusted & plain.trusted
    assert both.mean() > 0.9
    assert np.median(np.abs(skyline.row_px - plain.row_px)[both]) < 0.5


def test_the_photos_of_a_folder_are_known_by_their_content(tmp_path):
    photos = photo_folder(tmp_path)
    assert [str(path.relative_to(tmp_path)) for path in photos_in(tmp_path)] == sorted(photos)


@pytest.mark.parametrize("suffix", ["jpg", "png", "webp", "tif", "gif"])
def test_mutated_files_are_read_or_refused_in_one_line(tmp_path, suffix, capfd):
    rng = np.random.default_rng(7)
    messages: list[str] = []
    path = tmp_path / f"photo.{suffix}"
    Image.fromarray(make_scene("clear", 3, 48, 36).image).save(path)
    whole = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    for _ in range(60):
        damaged = whole.copy()
        at = rng.integers(0, len(whole), rng.integers(1, 9))
        # Headers are hit as often as pixels, though they are short.
        at = np.where(rng.random(len(at)) < 0.5, at % 64, at)
        damaged[at] ^= (1 << rng.integers(0, 8, len(at))).astype(np.uint8)
        cut = rng.integers(0, len(whole)) if rng.random() < 0.3 else len(whole)
        path.write_bytes(damaged[:cut].tobytes())
        try:
            assert read_skyline(path).trusted.any()
        except InputError as error:
            messages.append(str(error))
    assert messages
    assert all("\n" not in line and str(path) in line for line in messages)
    assert capfd.readouterr().err == ""


def test_large_jpeg_is_reduced_while_decoding(tmp_path, caplog):
    mask = Image.new("L", (1_100, 1_000), 255)
    mask.paste(0, (0, 400, 1_100, 1_000))
    mask.save(tmp_path / "large.jpg")
    with opened_image(tmp_path / "large.jpg") as image:
        shrink_if_large("large.jpg", image, SizeLimits(decoded=1_000_000))
        rgb = rgb_of(image)
    assert rgb.shape == (500, 550, 3)
    assert len(caplog.records) == 1
    assert_allclose(skyline_of_mask(rgb).row_px, 199.5, atol=0.1)


@pytest.mark.parametrize(("given", "warned"), [({}, True), ({"fov_deg": 90.0}, False)])
def test_a_wide_photo_without_a_projection_is_warned_of(tmp_path, caplog, given, warned):
    wide = make_scene("clear", 3, 640, 200)
    Image.fromarray(wide.image).save(tmp_path / "wide.png")
    read_skyline(tmp_path / "wide.png", **given)
    assert len(caplog.records) == warned
