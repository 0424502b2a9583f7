"""`skyline match`: lens, place and direction that photos note in their EXIF."""

import json
import math

import pytest
from commands import assert_refused, lonlat_of, off_m
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from PIL.TiffImagePlugin import IFDRational


def lensed(photo, path, focal_mm, size=None, tag=Base.FocalLengthIn35mmFilm, **more):
    """Write a copy of a photo, 960 x 640, that notes a 35 mm equivalent and a frame's size."""
    exif = Image.Exif()
    noted = exif.get_ifd(IFD.Exif)
    noted[tag] = focal_mm
    noted.update({Base[name]: value for name, value in more.items()})
    if size is not None:
        noted[Base.ExifImageWidth], noted[Base.ExifImageHeight] = size
    with Image.open(photo) as image:
        image.save(path, quality=95, exif=exif)
    return path


def test_the_lens_in_the_exif_is_weighed(run, store, photo, tmp_path):
    """The photo spans 60 degrees: 36 mm of film at 31 mm."""
    plain = lensed(photo, tmp_path / "plain.jpg", 31, (3000, 2000))
    cropped = lensed(photo, tmp_path / "cropped.jpg", 24, (4000, 3000))
    lie = lensed(photo, tmp_path / "lie.jpg", 9999)
    # 125 pixels a millimetre of 24 mm, where the sensor has 36.
    fine = {"FocalPlaneXResolution": 125, "FocalPlaneResolutionUnit": 4}
    plane = lensed(photo, tmp_path / "plane.jpg", 31, (3000, 2000), Base.FocalLength, **fine)
    found = run("match", store, plain, cropped, lie, plane, "--json")
    assert found.code == 0, found.err
    records = [json.loads(line) for line in found.out.splitlines()]
    assert all(off_m(one["answer"]) < 60.0 for one in records)
    assert all(abs(one["answer"]["fov_deg"] - 60.0) < 1.5 for one in records)
    lenses = [one["lens"] for one in records]
    assert lenses[0]["fov_deg"] == pytest.approx(60.3, abs=0.1)
    assert lenses[1]["most_deg"] > 60.0 > lenses[1]["fov_deg"]
    assert "cropped" in lenses[1]["reason"]
    assert lenses[2]["fov_deg"] is None
    assert lenses[3]["fov_deg"] == pytest.approx(42.3, abs=0.1)
    said = run("match", store, plain, cropped, lie, "--matcher", "unrefined").out
    assert "field of view: 60.3 degrees, give or take 5; EXIF's 35 mm equivalent alone" in said
    assert "field of view: 53.7 degrees, give or take 12; EXIF's 35 mm equivalent alone," in said
    assert "field of view: not known; EXIF's 35 mm equivalent alone left aside: 0.21" in said


def claiming(photo, path, lonlat, heading_deg=None, reference="T"):
    """Write a copy of a photo with a position, and perhaps a direction, in its EXIF; return it."""
    exif = Image.Exif()
    gps = exif.get_ifd(IFD.GPSInfo)
    for angle, name, side in zip(lonlat, ("Longitude", "Latitude"), ("EW", "NS"), strict=True):
        gps[GPS[f"GPS{name}"]] = (IFDRational(round(abs(angle) * 1e6), 1_000_000), 0.0, 0.0)
        gps[GPS[f"GPS{name}Ref"]] = side[angle < 0.0]
    if heading_deg is not None:
        gps[GPS.GPSImgDirection] = IFDRational(round(heading_deg * 100), 100)
        gps[GPS.GPSImgDirectionRef] = reference
    with Image.open(photo) as image:
        image.save(path, quality=95, exif=exif)
    return path


def test_a_photo_s_own_claim_is_shown(run, store, dem, photo, tmp_path):
    claim = claiming(photo, tmp_path / "claim.jpg", lonlat_of(dem, 601_800.0, 5_178_240.0), 112.0)
    found = run("match", store, claim, "--fov-deg", "60", "--json")
    exif = json.loads(found.out)["exif"]
    assert exif["distance_m"] == pytest.approx(240.0, abs=40.0)
    assert exif["heading_off_deg"] == pytest.approx(29.0, abs=2.0)
    assert exif["heading_is_magnetic"] is False
    said = run("match", store, claim, "--fov-deg", "60", "--report", tmp_path / "report").out
    assert "m from the answer. Its compass says 112 degrees, the answer 141." in said
    page = (tmp_path / "report" / "index.html").read_text()
    assert "m from the answer. Its compass says 112 degrees" in page
    assert f"{exif['lat']:.5f}" not in page
    assert "exif" not in json.loads(run("match", store, photo, "--fov-deg", "60", "--json").out)


def test_a_position_without_n_or_e_is_left_aside_with_the_reason(run, store, photo, tmp_path):
    """The photo's latitude and longitude would be half a world away without N and E."""
    claim = claiming(photo, tmp_path / "claim.jpg", (-10.3, -46.7), 112.0, reference="")
    with Image.open(claim) as image:
        exif = image.getexif()
        del exif.get_ifd(IFD.GPSInfo)[GPS.GPSLatitudeRef]
        image.save(claim, quality=95, exif=exif)
    found = run("match", store, claim, "--fov-deg", "60", "--use-gps")
    assert found.code == 0, found.err
    assert "position is left aside: the latitude does not say whether it is N or S." in found.out
    assert "from a north that it does not name" in found.out
    assert "disagree" not in found.out
    assert " km " not in found.out


@pytest.mark.parametrize("workers", [(), pytest.param(("--workers", "1"), marks=pytest.mark.slow)])
def test_a_wrong_claim_does_not_hide_the_right_place(run, store, dem, photo, tmp_path, workers):
    right, beside = (601_800.0, 5_178_000.0), (601_000.0, 5_179_000.0)
    claims = [
        claiming(photo, tmp_path / "right.jpg", lonlat_of(dem, *right), 141.0),
        claiming(photo, tmp_path / "beside.jpg", lonlat_of(dem, *beside), 300.0, "M"),
        claiming(photo, tmp_path / "far.jpg", (-70.0, -33.0)),
    ]
    found = run("match", store, *claims, "--fov-deg", "60", "--use-gps", "--json", *workers)
    assert found.code == 0, found.err
    records = [json.loads(line) for line in found.out.splitlines()]
    assert all(off_m(one["answer"]) < 30.0 for one in records)
    assert off_m(records[0]["answer"]) < 10.0
    assert records[1]["exif"]["distance_m"] == pytest.approx(math.hypot(800.0, 1000.0), abs=40.0)
    assert records[2]["exif"]["distance_m"] > 1e7


def test_the_gps_acts_in_refinement(run, store, photo):
    done = run("match", store, photo, "--use-gps", "--matcher", "unrefined")
    assert_refused(done, "--use-gps acts in refinement")
