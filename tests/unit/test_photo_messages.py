"""What is said of photos, traces, masks and what is known of them, each in one line."""

import io
import re
from dataclasses import dataclass

import numpy as np
import pytest
from photo_scenes import HEIC, BlueSky, make_scene, photo_folder
from PIL import Image
from PIL.ExifTags import Base
from refusals import assert_says
from scenes import field_of

from skyline import Correction, NotedPlace, NotedPose, Photo, Viewer
from skyline.camera.projection import Projection
from skyline.errors import InputError, MissingFileError, OffMapError
from skyline.match.areas import paths_of
from skyline.match.narrowing import Narrowing
from skyline.photo.extract import extract_skyline
from skyline.photo.image import SizeLimits, opened_image, photos_in, shrink_if_large
from skyline.photo.photo import read_photo
from skyline.photo.read import named_skyline, read_skyline
from skyline.photo.skyline import PhotoSkyline
from skyline.photo.trace import write_trace
from skyline.photo.user_sky_model import load_sky_model, model_skyline
from skyline.report.skyline_overlay import write_overlay

PERSPECTIVE = Projection.PERSPECTIVE
PLAIN = PhotoSkyline(np.ones(2), np.ones(2), 2, 100)
BELOW = PhotoSkyline(np.array([3.0, 40.0]), np.ones(2), 2, 9)


class TestSkylines:
    @pytest.mark.parametrize(
        ("trust", "projection", "said"),
        [
            (255.0, PERSPECTIVE, "not a number from 0 to 1"),
            (-0.1, PERSPECTIVE, "not a number from 0 to 1"),
            (np.nan, PERSPECTIVE, "not a number from 0 to 1"),
            (1.0, "cubemap", "projection is 'cubemap'; expected perspective, cyl"),
        ],
    )
    def test_of_a_trust_or_projection_that_is_none(self, trust, projection, said):
        one = np.array([3.0]), np.array([trust]), 1, 9
        assert_says(said, lambda: PhotoSkyline(*one, projection=projection))

    @pytest.mark.parametrize(
        ("projection", "fov_deg", "said"),
        [
            (Projection.CYLINDRICAL, 361.0, "361 degrees; expected 1 to 360: a full turn"),
            (Projection.FISHEYE, 181.0, "181 degrees; expected 1 to 180: .* crop a wider fisheye"),
            (PERSPECTIVE, 180.0, "180 degrees; expected 1 to 179.* cylindrical"),
            (PERSPECTIVE, 0.99, "expected 1 to 179"),
            (PERSPECTIVE, np.nan, "expected 1 to 179"),
        ],
    )
    def test_of_an_impossible_field_of_view(self, projection, fov_deg, said):
        skyline = np.zeros(3), np.ones(3), 3, 3
        assert_says(said, lambda: PhotoSkyline(*skyline, fov_deg, projection))
        # It is refused before a file is looked for.
        assert_says(said, lambda: read_skyline("absent.jpg", fov_deg, projection=projection))

    def test_that_cannot_be_written(self, tmp_path):
        picture, file = np.zeros((100, 2, 3), np.uint8), tmp_path / "file"
        file.touch()
        for write in (
            lambda: write_trace(PLAIN, file / "trace.csv"),
            lambda: write_trace(PLAIN, tmp_path),
            lambda: write_overlay(picture, PLAIN, file / "overlay.png"),
        ):
            assert_says("cannot be written", write)
        said = "is '.jpg'; expected one of .png"
        assert_says(said, lambda: write_overlay(picture, PLAIN, tmp_path / "overlay.jpg"))

    def test_that_a_correction_begins_with_and_that_are_of_another_image(self):
        photo = Photo(make_scene("clear", 3, 64, 64).image, 60.0, PERSPECTIVE, NotedPlace())
        said = "expected the same image"
        assert_says(said, lambda: Correction(photo).solve(start=PLAIN))


HEAD = "# width=100 height=80{}\ncolumn_px,row_px\n"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "trace.csv"),
        ("# width=4 height=4\nx,y\n1,2\n", "trace.csv"),
        (HEAD.format("") + "3,10\n3,11\n", "two rows for column 3"),
        (HEAD.format("") + "3,ten\n", "line 3: row_px is `ten`; expected a number from"),
        (HEAD.format("") + "100,1\n", "column_px is `100`; expected a number from -0.5 to 99.5"),
        (HEAD.format("") + "3,80\n", "row_px is `80`; expected a number from -0.5 to 79.5"),
        (HEAD.format("") + "3,nan\n", "draws no column"),
        (HEAD.replace("=80", "=80.7").format("") + "3,10\n", "is 100 x 80.7 px; expected whole"),
        (HEAD.format(" fov=60"), "line 1 notes 'fov'; expected some of width, height, fov_deg"),
        (HEAD.format(" fov_deg=60 fov_slack=0.1"), "notes 'fov_slack'; expected some of"),
        (HEAD.format(" fov_deg=60 fov_slack=0.1"), "fov_deg, fov_sd_share, eye_height_m"),
        (HEAD.format(" fov_deg=60 fov_sd_share=5") + "0,30\n9,31\n", "fov_sd_share is `5`"),
        (HEAD.format(" fov_deg=600") + "0,30\n9,31\n", "horizontal field of view is 600"),
        (HEAD.format(" projection=round") + "0,10\n", "projection is round; expected perspective"),
    ],
)
def test_a_trace_that_cannot_be_read(tmp_path, content, said):
    (tmp_path / "trace.csv").write_text(content)
    assert_says(re.escape(said), lambda: read_skyline(tmp_path / "trace.csv"))


def test_a_mask_of_white_ground_in_a_white_frame(tmp_path):
    mask = np.zeros((200, 300), np.uint8)
    mask[80:] = mask[:4] = mask[-4:] = mask[:, :4] = mask[:, -4:] = 255
    mask[60:80, 100:200] = 255  # a hill
    path = tmp_path / "mask.png"
    Image.fromarray(mask).save(path)
    said = "row 4 and white below it, as one with white ground"
    assert_says(said, lambda: read_skyline(path))
    Image.fromarray(mask[4:-4, 4:-4]).save(path)  # The frame is cut off.
    assert_says("black above white, as one with white ground", lambda: read_skyline(path))


class TestFiles:
    @pytest.mark.parametrize(
        ("name", "content", "said"),
        [
            ("text.jpg", b"not a photo", "not an image that .* read; expected JPEG.* or a trace"),
            ("empty.png", b"", "not an image that can be read"),
            ("phone.heic", HEIC, "HEIC photo.*to JPEG or PNG, or pip install pillow-heif"),
            ("d.HIF", HEIC.replace(b"heic", b"heix"), "HEIC photo.*pip install pillow-heif"),
        ],
    )
    def test_that_are_no_photos(self, tmp_path, name, content, said):
        (tmp_path / name).write_bytes(content)
        assert_says(f"{name}.*{said}", lambda: read_skyline(tmp_path / name))

    def test_that_begin_with_a_preview_as_raw_files_do(self, tmp_path):
        path = tmp_path / "raw.tif"
        Image.new("L", (160, 120)).save(path, tiffinfo={Base.NewSubfileType: 1})
        said = r"raw\.tif.* begins with a preview of 160 x 120 px"
        assert_says(said, lambda: read_skyline(path))

    def test_of_too_many_pixels(self, tmp_path):
        Image.new("1", (20_000, 10_000)).save(tmp_path / "huge.png")
        said = r"huge\.png.* megapixels; expected at most 100"
        assert_says(said, lambda: read_skyline(tmp_path / "huge.png"))

    def test_of_several_pages(self, tmp_path):
        """As a scanner writes an album; smaller copies are no pages of their own."""
        pages = [Image.fromarray(np.full((60, 90), value, np.uint8)) for value in (90, 120)]
        path = tmp_path / "album.tif"
        pages[0].save(path, save_all=True, append_images=pages[1:])
        said = r"album\.tif has 2 pages or layers; expected one photo: flatten it"
        assert_says(said, lambda: read_photo(path))
        pages[0].save(path, save_all=True, append_images=[pages[1].resize((45, 30))])
        assert read_photo(path).rgb[0, 0].tolist() == [90, 90, 90]

    def test_that_are_open_and_cut_short(self):
        whole = io.BytesIO()
        Image.fromarray(make_scene("clear", 3, 320, 240).image).save(whole, "JPEG")
        said = r"the image cannot be decoded \([^(]*\); it is damaged"
        with Image.open(io.BytesIO(whole.getvalue()[: whole.tell() // 2])) as picture:
            assert_says(said, lambda: read_skyline(picture))

    def test_of_a_folder_without_photos(self, tmp_path):
        (tmp_path / "e.xmp").write_text("")
        assert_says(r"has no pictures among e\.xmp; expected", lambda: photos_in(tmp_path))

    @pytest.mark.parametrize(
        "array",
        [np.zeros((4, 4)), np.zeros((4, 4, 1), np.uint8), np.zeros((4, 4, 5), np.uint8)],
        ids=["floats", "1 band", "5 bands"],
    )
    def test_that_are_arrays_of_another_kind(self, array):
        assert_says(r"array of .* of shape \(4, 4.*\); expected", lambda: read_skyline(array))

    def test_without_a_skyline(self):
        said = "no skyline found.*draw it as a trace .* or a mask"
        assert_says(said, lambda: extract_skyline(np.full((320, 480, 3), 128, np.uint8)))


class TestWarnings:
    def test_files_of_a_folder_that_are_no_photos(self, tmp_path, caplog):
        photo_folder(tmp_path)
        photos_in(tmp_path)
        assert caplog.messages == [
            f"{tmp_path}: 9 files are left out, which are not pictures: Thumbs.db, a.json, a.xmp "
            "and 1 more .xmp, map.tif, raw.cr2, trace.csv, video.THM, video.mp4"
        ]

    def test_a_large_photo(self, tmp_path, caplog):
        Image.new("L", (1_100, 1_000), 255).save(tmp_path / "large.jpg")
        with opened_image(tmp_path / "large.jpg") as image:
            shrink_if_large("large.jpg", image, SizeLimits(decoded=1_000_000))
        assert "large.jpg, 1100 x 1000 px, is read at 550 x 500 px" in caplog.text

    def test_a_wide_photo_without_a_projection(self, caplog):
        read_skyline(make_scene("clear", 3, 640, 200).image)
        assert "give --projection cylindrical" in caplog.text


@dataclass
class Constant(BlueSky):
    """A sky model whose output, or failure, is the same for every photo."""

    output: object = None

    def run(self, names, feed):
        if isinstance(self.output, Exception):
            raise self.output
        return [self.output]


RAMP = np.linspace(1.0, 0.0, 64)[np.newaxis, np.newaxis, :, np.newaxis] * np.ones((1, 1, 64, 64))


class TestSkyModels:
    @pytest.mark.parametrize(
        ("output", "said"),
        [
            (np.ones((1, 3, 8, 8)), r"shape \(1, 3, 8, 8\); expected one input"),
            (np.ones(4), "expected one input"),
            (np.full((1, 1, 8, 8), np.nan), "not finite"),
            (np.ones((1, 1, 64, 64)), "sees no sky above ground"),
            (RAMP, "sees no sky above ground"),  # sure of no row
            (RuntimeError("bad shape\nmore"), r"failed \(bad shape\)"),
        ],
    )
    def test_whose_output_breaks_the_contract(self, output, said):
        image = make_scene("clear", 3, 64, 64).image
        assert_says(said, lambda: model_skyline(image, Constant(output=output)))

    def test_without_their_runtime_or_file(self, tmp_path, monkeypatch):
        monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
        (tmp_path / "sky.onnx").write_bytes(b"model")
        image = make_scene("clear", 3, 320, 240).image
        given = {"sky_model": tmp_path / "sky.onnx"}
        assert_says("pip install onnxruntime", lambda: read_skyline(image, **given))
        said = r"absent\.onnx does not exist"
        assert_says(said, lambda: load_sky_model(tmp_path / "absent.onnx"), MissingFileError)


@pytest.mark.parametrize(
    ("field", "given", "said"),
    [
        ("near", (9.8, 46.8), "expected the numbers longitude, latitude, km"),
        ("near", "123", "near is '123'; expected the numbers"),
        ("near", (None, 46.8, 2.0), "expected the numbers"),
        ("bounds_deg", (9.8, 46.9, 9.9, 46.7), "expected W,S,E,N in degrees"),
        ("bounds_deg", "9,46,10,47", "expected the numbers west, south, east, north"),
        ("heading_deg", 140.0, "expected the numbers heading, greatest error"),
        ("heading_deg", ("N", "10"), "expected the numbers heading, greatest error"),
        ("elevation_m", 900.0, "expected the numbers lowest, highest"),
        ("eye_height_m", "low", "the eye is low m above the ground; expected 0 to"),
        ("eye_height_m", -1.0, "the eye is -1.0 m above the ground; expected 0 to"),
    ],
)
def test_a_narrowing_of_other_than_its_numbers(field, given, said):
    assert_says(said, lambda: Narrowing(**{field: given}))


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: named_skyline(["photo.jpg"]), "of type list; expected one path"),
        (lambda: named_skyline("photo.jpg", "wide"), "expected a number of degrees"),
        (lambda: named_skyline(BELOW), "row_px is 40 in column 1 of a picture of 9 rows"),
        (lambda: paths_of(b"store.h5"), "expected the path of a store"),
    ],
)
def test_arguments_of_another_type(call, said):
    assert_says(said, call)


LEAST = {"lon": 9, "lat": 46, "heading_deg": 1, "fov_deg": 60}


class TestPoses:
    @pytest.mark.parametrize(
        ("record", "said"),
        [
            (None, "the request has no pose; expected JSON"),
            ([LEAST], "the request has no pose"),
            (LEAST | {"lat": None}, "the request has no lat; expected JSON"),
            (LEAST | {"lat": True}, "the request: lat is True; expected a number"),
            (LEAST | {"lat": float("nan")}, "lat is nan; expected a number"),
            (LEAST | {"lat": 10**400}, "expected a number"),
            (LEAST | {"lat": 91}, r"the place is 9,91; expected degrees \(WGS 84\)"),
            (LEAST | {"pitch_deg": 91}, "pitch_deg is 91; expected -90 to 90"),
            (LEAST | {"roll_deg": -181}, "roll_deg is -181; expected -180 to 180"),
            (LEAST | {"eye_height_m": 2, "eye_elevation_m": 9}, "both eye_elevation_m and eye_he"),
            (LEAST | {"pitch": 4}, "has pitch, which is not read; give it as pitch_deg"),
            (LEAST | {"elevation_m": 24}, "elevation_m, which is not read; give it as eye_elevati"),
            (LEAST | {"altitude_ft": 7874}, "has altitude_ft, which is not read; give it as eye_e"),
            (LEAST | {"alt": 2400}, "has alt, which is not read; give it as eye_elevation_m"),
            (LEAST | {"agl_m": 80}, "has agl_m, which is not read; give it as eye_height_m"),
        ],
    )
    def test_that_are_none(self, record, said):
        assert_says(said, lambda: NotedPose.from_dict(record, PERSPECTIVE, "the request"))

    @pytest.mark.parametrize(
        ("eye_height_m", "said", "error"),
        [
            (-1.0, r"the eye at the place is 1\.00 m below the ground", OffMapError),
            (1e6, "-500 to 20000", InputError),
        ],
    )
    def test_whose_eye_is_nowhere(self, eye_height_m, said, error):
        viewer = Viewer(field_of(np.zeros((90, 90)), west_m=-1200.0, north_m=1200.0))
        pose = NotedPose(
            lon=9.8, lat=46.8, heading_deg=1.0, fov_deg=60.0, eye_height_m=eye_height_m
        )
        assert_says(said, lambda: viewer.pose_of(pose), error)
