"""Files for other programs, read back by other programs: GDAL, and the parsers of Python."""

import io
import json
import math
import os
import shutil
import struct
import subprocess
import xml.etree.ElementTree as Xml
import zipfile
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote_to_bytes, urljoin, urlsplit

import geopandas
import numpy as np
import pytest
from PIL import Image, features
from PIL.ExifTags import GPS, IFD, Base
from pyproj import CRS
from scenes import FRAME, at_m, candidate_at
from shapely import Polygon
from xmp_packets import FORMS, xmp_packet

from skyline import (
    Frame,
    InputError,
    MatchResult,
    PhotoSkyline,
    export_matches,
    read_photo,
    write_located,
)
from skyline.photo.xmp import Xmp, xmp_of
from skyline.report.exports import VIEW_REACH_M

BEST = candidate_at(
    100.0, 200.0, 30.0, 4.0, -3.0, 50.0, eye_elevation_m=1234.5, confidence=0.93
)  # fmt: skip
OTHER = candidate_at(900.0, -300.0, 300.0, rank=2)
NAME = "photos/Horn & <Tal>\x07.jpg"
PHOTO = np.full((30, 40, 3), 99, np.uint8)


def matches():
    skyline = PhotoSkyline(np.full(40, 10.0), np.ones(40), 40, 30)
    return [MatchResult(skyline, (BEST, OTHER), 1.0, name=NAME)]


def test_kml_has_places_views_and_the_photo_in_the_landscape(tmp_path):
    path = tmp_path / "new" / "answer.kml"
    export_matches(path, matches(), FRAME)
    kml = Xml.parse(path)
    names = [mark.findtext("{*}name") for mark in kml.iterfind(".//{*}Placemark")]
    assert names == [r"Horn & <Tal>\x07.jpg: candidate 1", r"Horn & <Tal>\x07.jpg: candidate 2"]
    (overlay,) = kml.findall(".//{*}PhotoOverlay")
    camera = {one.tag.split("}")[1]: one.text for one in overlay.find("{*}Camera")}
    assert float(camera["longitude"]) == pytest.approx(BEST.lon, abs=1e-6)
    assert float(camera["latitude"]) == pytest.approx(BEST.lat, abs=1e-6)
    assert float(camera["altitude"]) == 1234.5
    assert float(camera["heading"]) == pytest.approx(BEST.heading_deg, abs=1e-3)
    assert (float(camera["tilt"]), float(camera["roll"])) == (94.0, 3.0)
    assert camera["altitudeMode"] == "absolute"
    volume = {one.tag.split("}")[1]: float(one.text) for one in overlay.find("{*}ViewVolume")}
    assert (volume["leftFov"], volume["rightFov"]) == (-25.0, 25.0)
    half = math.degrees(math.atan(math.tan(math.radians(25.0)) * 30 / 40))
    assert volume["topFov"] == pytest.approx(half, abs=1e-3)
    assert volume["bottomFov"] == -volume["topFov"]
    ring = kml.findtext(".//{*}LinearRing/{*}coordinates").split()
    assert ring[0] == ring[-1]


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("", b"photo.jpg"),
        ("out/deeper", b"photos/100%#?&<a>;+.jpg"),
        ("", b"photos/b\xe4r.jpg"),
        ("out/deeper", b"absolute/photo.jpg"),
    ],
)
def test_kml_leads_to_the_photo_s_file(tmp_path, monkeypatch, folder, name):
    monkeypatch.chdir(tmp_path)
    photo = Path(os.fsdecode(name))
    photo.parent.mkdir(exist_ok=True)
    photo.touch()
    called = photo.absolute() if photo.parts[0] == "absolute" else photo
    path = Path(folder, "answer.kml")
    export_matches(path, [replace(matches()[0], name=str(called))], FRAME)
    href = Xml.parse(path).findtext(".//{*}PhotoOverlay/{*}Icon/{*}href")
    address = urlsplit(urljoin(path.absolute().as_uri(), href))
    assert (address.scheme, address.query, address.fragment) == ("file", "", "")
    assert photo.samefile(os.fsdecode(unquote_to_bytes(address.path)))
    assert not href.startswith(("/", "file:"))


@pytest.mark.parametrize("photos", [[PHOTO], None], ids=["given", "read"])
def test_kmz_holds_the_photo(tmp_path, photos):
    path, name = tmp_path / "answer.kmz", str(tmp_path / "photo.png")
    Image.fromarray(PHOTO).save(name)
    export_matches(path, [replace(matches()[0], name=name)], FRAME, photos)
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == ["doc.kml", "files/01.jpg"]
        kml = Xml.fromstring(archive.read("doc.kml"))
        with Image.open(io.BytesIO(archive.read("files/01.jpg"))) as picture:
            assert picture.size == (40, 30)
    assert kml.findtext(".//{*}PhotoOverlay/{*}Icon/{*}href") == "files/01.jpg"


def test_places_of_another_world_are_put_into_no_map_of_the_earth(tmp_path):
    moon = Frame.local(lon=9.8, lat=46.8, world=CRS.from_user_input("+proj=longlat +R=1737400"))
    with pytest.raises(InputError, match="another world"):
        export_matches(tmp_path / "answer.kml", matches(), moon)


def test_gdal_reads_the_gpx(tmp_path):
    with pytest.raises(InputError):
        export_matches(tmp_path / "answer.doc", matches(), FRAME)
    path = tmp_path / "answer.gpx"
    export_matches(path, matches(), FRAME)
    points = geopandas.read_file(path, layer="waypoints")
    assert points.geometry.x.tolist() == pytest.approx([BEST.lon, OTHER.lon], abs=1e-6)
    assert points.geometry.y.tolist() == pytest.approx([BEST.lat, OTHER.lat], abs=1e-6)
    assert points.ele.tolist() == [1234.5, 1000.0]
    assert points.name.tolist()[1].endswith("candidate 2")
    assert "confidence 0.93" in points.desc[0]


UTM = Frame.from_crs("EPSG:32632")
PLACE_DEG = 10.78277, 46.79586


@pytest.fixture
def drawn(tmp_path):
    """Features of GeoJSON of a photo with two candidates, the first refined, and one with none."""
    place_m = UTM.from_lonlat(*PLACE_DEG)
    best = candidate_at(
        *place_m, 275.0, -8.5, 1.0, 78.7, confidence=0.9, frame=UTM,
        covariance_m2=((400.0, 100.0), (100.0, 900.0)),
    )  # fmt: skip
    other = candidate_at(best.easting_m + 500.0, best.northing_m, 350.0, frame=UTM, rank=2)
    found = {"<b>.jpg": [best, other], "none.csv": []}
    results = [MatchResult(None, some, 0.0, name=name) for name, some in found.items()]
    export_matches(tmp_path / "new" / "matches.geojson", results, UTM)
    collection = json.loads((tmp_path / "new" / "matches.geojson").read_text())
    assert collection["type"] == "FeatureCollection"
    return collection["features"]


def test_geojson_holds_points_views_and_ellipses_of_candidates(drawn):
    noted = [feature["properties"] for feature in drawn]
    assert {one["photo"] for one in noted} == {"<b>.jpg"}
    assert [(one["rank"], one["shape"]) for one in noted] == [
        (1, "candidate"), (1, "view"), (1, "ellipse95"), (2, "candidate"), (2, "view"),
    ]  # fmt: skip


def test_geojson_holds_points_in_degrees_and_headings_from_true_north(drawn):
    point = drawn[0]
    np.testing.assert_allclose(point["geometry"]["coordinates"], PLACE_DEG, atol=1e-7)
    convergence_deg = float(UTM.convergence_deg(**at_m(UTM.from_lonlat(*PLACE_DEG))))
    assert point["properties"]["heading_deg"] == pytest.approx(275.0 + convergence_deg)
    names = "lon lat easting_m northing_m pitch_deg roll_deg fov_deg cost confidence refined"
    assert set(names.split()) <= point["properties"].keys()


def test_geojson_holds_closed_rings_that_turn_left(drawn):
    _, view, ellipse, *_ = drawn
    assert ellipse["properties"]["semi_major_m"] > ellipse["properties"]["semi_minor_m"] > 0.0
    for polygon in (view, ellipse):
        (ring,) = polygon["geometry"]["coordinates"]
        assert polygon["geometry"]["type"] == "Polygon"
        assert ring[0] == ring[-1]
        assert Polygon(ring).exterior.is_ccw


def test_a_view_reaches_as_far_to_all_sides(drawn):
    place_m = UTM.from_lonlat(*PLACE_DEG)
    ring = np.array(drawn[1]["geometry"]["coordinates"][0][1:-1])
    east_m, north_m = UTM.from_lonlat(*ring.T)
    away_m = np.hypot(east_m - place_m[0], north_m - place_m[1])
    np.testing.assert_allclose(away_m, VIEW_REACH_M, atol=0.05)


def test_geojson_and_kml_cut_what_crosses_the_antimeridian(tmp_path):
    fiji = Frame.local(lon=180.0, lat=-17.0)
    covariance_m2 = ((400.0, 100.0), (100.0, 900.0))
    held = candidate_at(-5.0, 0.0, 90.0, covariance_m2=covariance_m2, frame=fiji)
    skyline = PhotoSkyline(np.full(9, 4.0), np.ones(9), 9, 6)
    matches = [MatchResult(skyline, (held,), 0.0, name="q.jpg")]
    export_matches(tmp_path / "a.geojson", matches, fiji)
    point, *shapes = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert point["geometry"]["coordinates"][0] == pytest.approx(179.99995, abs=1e-5)
    for one in shapes:
        assert one["geometry"]["type"] == "MultiPolygon"
        sides = [np.array(ring)[:, 0] for (ring,) in one["geometry"]["coordinates"]]
        west, east = sorted((side.min(), side.max()) for side in sides)
        assert west == (-180.0, pytest.approx(-179.99, abs=0.02))
        assert east == (pytest.approx(179.9999, abs=1e-3), 180.0)
    export_matches(tmp_path / "a.kml", matches, fiji)
    assert len(Xml.parse(tmp_path / "a.kml").findall(".//{*}Polygon")) == 2


GPS_OF_ANOTHER_POSE = {
    GPS.GPSLatitudeRef: "S", GPS.GPSLatitude: (10.0, 0.0, 0.0), GPS.GPSLongitudeRef: "W",
    GPS.GPSLongitude: (20.0, 0.0, 0.0), GPS.GPSAltitudeRef: b"\1", GPS.GPSAltitude: 5.0,
    GPS.GPSDOP: 5.0, GPS.GPSImgDirectionRef: "M", GPS.GPSImgDirection: 77.0,
    GPS.GPSDestBearingRef: "M", GPS.GPSDestBearing: 77.0,
    GPS.GPSProcessingMethod: b"ASCII\0\0\0GPS", GPS.GPSHPositioningError: 3.0,
    0xC000: "unknown tag",
}  # fmt: skip
XMP_OF_ANOTHER_POSE = b"""<x:xmpmeta xmlns:x="adobe:ns:meta/">
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:exif="http://ns.adobe.com/exif/1.0/"
 xmlns:xmp="http://ns.adobe.com/xap/1.0/" xmlns:dji="http://www.dji.com/drone-dji/1.0/"
 xmlns:GPano="http://ns.google.com/photos/1.0/panorama/"
 exif:GPSLatitude="10,30.5S" exif:GPSLongitude='20,0.0W' xmp:Rating="5" exif:GPSDOP = "5/1"
 dji:GpsLongtitude="20.0" dji:AbsoluteAltitude="+5.0" dji:GimbalYawDegree="77.0"
 GPano:FullPanoWidthPixels="300" GPano:PoseHeadingDegrees="77">
<exif:GPSImgDirection>77/1</exif:GPSImgDirection><exif:GPSAltitude/>
<xmp:CreatorTool>A "GPSLatitude" logger</xmp:CreatorTool>
<exif:GPSTimeStamp xml:lang="x-default">2024-01-02T10:11:12Z</exif:GPSTimeStamp>
<xmp:Label>Kept</xmp:Label></rdf:Description></rdf:RDF></x:xmpmeta>"""
OWNER = b"Ada of the Alps\0"


def canon_note(at):
    """Return a maker's note at an offset of EXIF: its owner's name, by an offset into EXIF."""
    return struct.pack(">HHHIII", 1, 9, 2, len(OWNER), at + 18, 0) + OWNER


def exif_of_another_pose(orientation=1):
    """Return EXIF with a maker's note that must stay where it is, and its preview."""
    exif = Image.Exif()
    exif[Base.Make], exif[Base.Model] = "Canon", "Canon EOS 6D"
    exif[Base.Orientation] = orientation
    exif.get_ifd(IFD.GPSInfo).update(GPS_OF_ANOTHER_POSE)
    exif.get_ifd(IFD.Exif)[Base.MakerNote] = canon_note(0)
    tiff = exif.tobytes().removeprefix(b"Exif\0\0")
    assert tiff.startswith(b"MM")
    tiff = tiff.replace(canon_note(0), canon_note(tiff.index(canon_note(0))))
    # Pillow takes bytes for numbers; a maker's note is of no type.
    tiff = tiff.replace(*(struct.pack(">HH", Base.MakerNote, kind) for kind in (1, 7)))
    # The second directory is the preview's.
    held = io.BytesIO()
    Image.new("RGB", (16, 12), "red").save(held, "JPEG")
    preview = held.getvalue()
    (first,) = struct.unpack_from(">I", tiff, 4)
    (count,) = struct.unpack_from(">H", tiff, first)
    link = first + 2 + 12 * count
    second = struct.pack(">HHHIHxx", 3, 259, 3, 1, 6)
    second += struct.pack(">HHII", 513, 4, 1, len(tiff) + 42)
    second += struct.pack(">HHII", 514, 4, 1, len(preview)) + bytes(4)
    tiff = tiff[:link] + struct.pack(">I", len(tiff)) + tiff[link + 4 :] + second + preview
    return b"Exif\0\0" + tiff, preview


def read_by_exiftool(path, *options):
    """Return what exiftool reads of a file, numbers as such, by the group of its tags."""
    if shutil.which("exiftool") is None:
        pytest.skip("libimage-exiftool-perl is not installed (.ci/system_packages.py)")
    command = ["exiftool", "-j", "-a", "-n", "-G1", *options, path]
    found = subprocess.run(command, capture_output=True, check=True, text=True)
    assert "Warning" not in found.stdout
    return json.loads(found.stdout)[0]


NEW_POSE = replace(BEST, covariance_m2=np.diag([100.0, 100.0]))


@pytest.fixture
def relocated(tmp_path):
    """A photo that noted another pose, and noted the new one twice."""
    exif, _ = exif_of_another_pose()
    Image.fromarray(PHOTO).save(tmp_path / "photo.jpg", exif=exif, xmp=XMP_OF_ANOTHER_POSE)
    write_located(tmp_path / "photo.jpg", tmp_path / "copy.jpg", NEW_POSE)
    write_located(tmp_path / "copy.jpg", tmp_path / "copy.jpg", NEW_POSE)
    return tmp_path / "copy.jpg"


def test_nothing_of_another_pose_is_left_in_exif_beside_the_new_one(relocated):
    heading_deg = read_photo(relocated).noted.heading_deg
    assert heading_deg == pytest.approx(NEW_POSE.heading_deg, abs=1e-3)
    tags = read_by_exiftool(relocated)
    gps = {name[4:]: value for name, value in tags.items() if name.startswith("GPS:")}
    assert gps.pop("GPSLatitude") == pytest.approx(NEW_POSE.lat, abs=1e-7)
    assert gps.pop("GPSLongitude") == pytest.approx(NEW_POSE.lon, abs=1e-7)
    assert gps.pop("GPSImgDirection") == pytest.approx(NEW_POSE.heading_deg, abs=1e-3)
    assert gps.pop("GPSHPositioningError") == pytest.approx(NEW_POSE.radius_m, abs=0.01)
    assert gps == {
        "GPSVersionID": "2 3 0 0", "GPSLatitudeRef": "N", "GPSLongitudeRef": "E",
        "GPSAltitudeRef": 0, "GPSAltitude": 1234.5, "GPSImgDirectionRef": "T",
        "GPSMapDatum": "WGS-84", "GPSProcessingMethod": "SKYLINE: found, rank 1",
    }  # fmt: skip


def test_nothing_of_another_pose_is_left_in_xmp(relocated):
    tags = read_by_exiftool(relocated)
    xmp = {name: value for name, value in tags.items() if name.startswith("XMP")}
    assert xmp == {
        "XMP-xmp:Rating": 5, "XMP-xmp:Label": "Kept", "XMP-GPano:FullPanoWidthPixels": 300,
        "XMP-xmp:CreatorTool": 'A "GPSLatitude" logger',
    }  # fmt: skip
    assert not any("Pose" in name or "Gps" in name for name in tags)


def test_a_maker_s_note_a_preview_and_the_pixels_stay(relocated):
    source = relocated.with_name("photo.jpg")
    for path in (source, relocated):
        assert read_by_exiftool(path)["Canon:OwnerName"] == "Ada of the Alps"
    kept = subprocess.run(["exiftool", "-b", "-ThumbnailImage", relocated], stdout=-1, check=True)
    assert kept.stdout == exif_of_another_pose()[1]
    pixels = source.read_bytes()
    assert relocated.read_bytes().endswith(pixels[pixels.rindex(b"\xff\xdb") :])


POSE_OF_DRONES = (
    ("http://www.dji.com/drone-dji/1.0/", "RelativeAltitude", "+80.1"),
    ("https://www.skydio.com/drone-skydio/1.0/", "AbsoluteAltitude", "900"),
    ("http://pix4d.com/camera/1.0", "AboveGroundAltitude", "79/1"),
    ("http://pix4d.com/camera/1.0", "Yaw", "12"),
    ("http://www.parrot.com/drone-parrot/1.0/", "CameraYawDegree", "12"),
    ("http://ns.google.com/photos/1.0/panorama/", "InitialViewHeadingDegrees", "12"),
)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("namespace", "name", "value"), POSE_OF_DRONES)
def test_poses_in_xmp_are_removed_whatever_their_prefix(tmp_path, form, namespace, name, value):
    noted = {name: value, "Serial": "A1"}
    packet = xmp_packet(form, "odd", namespace, **noted).encode()
    Image.fromarray(PHOTO).save(tmp_path / "photo.jpg", xmp=packet)
    write_located(tmp_path / "photo.jpg", tmp_path / "copy.jpg", BEST)
    with Image.open(tmp_path / "copy.jpg") as image:
        kept = xmp_of(image)
        # Programs that look for the prefix find it.
        assert b"odd:Serial" in image.info["xmp"]
    assert kept.of(namespace.rstrip("/")) == {"Serial": "A1"}


def test_xmp_that_cannot_be_parsed_is_not_copied(tmp_path):
    packet = xmp_packet(FORMS[0], "g", **{"GPSLatitude": "10"}).replace("</rdf:RDF>", "")
    exif = Image.Exif()
    exif[700] = xmp_packet(FORMS[0], "g", **{"GPSLatitude": "10"}).encode()
    Image.fromarray(PHOTO).save(tmp_path / "photo.jpg", xmp=packet.encode(), exif=exif)
    write_located(tmp_path / "photo.jpg", tmp_path / "copy.jpg", BEST)
    with Image.open(tmp_path / "copy.jpg") as image:
        assert xmp_of(image) == Xmp()


@pytest.mark.parametrize("noted", [{"GPSLatitude": "10"}, {"Depth": "10"}])
def test_a_long_packet_is_copied_unless_it_notes_a_pose(tmp_path, noted):
    long = xmp_packet(FORMS[1], "g", **noted).encode()
    head = b"http://ns.adobe.com/xmp/extension/\0" + bytes(32) + len(long).to_bytes(4, "big")
    part = head + bytes(4) + long
    refers = {"HasExtendedXMP": "0" * 32, "Kept": "yes"}
    note = xmp_packet(FORMS[0], "n", "http://ns.adobe.com/xmp/note/", **refers).encode()
    Image.fromarray(PHOTO).save(tmp_path / "photo.jpg", xmp=note)
    jpeg = (tmp_path / "photo.jpg").read_bytes()
    segment = b"\xff\xe1" + (len(part) + 2).to_bytes(2, "big") + part
    (tmp_path / "photo.jpg").write_bytes(jpeg[:2] + segment + jpeg[2:])
    write_located(tmp_path / "photo.jpg", tmp_path / "copy.jpg", BEST)
    with Image.open(tmp_path / "copy.jpg") as image:
        kept = {name for _, name in xmp_of(image).values}
    assert {"HasExtendedXMP", "Depth"} & kept == (
        {"HasExtendedXMP", "Depth"} if "Depth" in noted else set()
    )
    assert "Kept" in kept


@pytest.mark.parametrize(("suffix", "orientation"), [(".png", 6), (".tif", 1), (".avif", 6)])
def test_other_photos_become_jpegs_that_say_their_place(tmp_path, suffix, orientation):
    if suffix == ".avif" and not features.check("avif"):
        pytest.skip("this Pillow has no AVIF")
    source, path = tmp_path / f"photo{suffix}", tmp_path / "copy.jpg"
    exif, _ = exif_of_another_pose(orientation)
    picture = np.repeat(PHOTO, 2, axis=0)
    Image.fromarray(picture).save(source, exif=exif, xmp=XMP_OF_ANOTHER_POSE)
    below = candidate_at(0.0, 0.0, eye_elevation_m=-12.0)
    write_located(source, path, below)
    write_located(path, path, below)
    noted = read_photo(path).noted
    assert noted.lonlat_deg == pytest.approx((below.lon, below.lat), abs=1e-7)
    assert noted.elevation_m == -12.0
    with Image.open(path) as image:
        assert (image.format, image.size) == ("JPEG", (40, 60) if orientation == 1 else (60, 40))
        tags = image.getexif()
        assert (tags[Base.Model], tags[Base.Orientation]) == ("Canon EOS 6D", 1)
        gone = {GPS.GPSDestBearing, GPS.GPSHPositioningError}
        assert not tags.get_ifd(IFD.GPSInfo).keys() & gone
        assert not tags.keys() & {Base.StripOffsets, Base.Compression}
    # Pillow moves notes in the other two as it writes or reads them.
    if suffix == ".png":
        assert read_by_exiftool(path)["Canon:OwnerName"] == "Ada of the Alps"


@pytest.mark.parametrize("exif", [b"", b"Exif\0\0II*\0\xff\xff\0\0", b"Exif\0\0#"])
def test_a_photo_without_exif_that_can_be_read_says_its_place(tmp_path, exif):
    source, path = tmp_path / "photo.jpg", tmp_path / "copy.jpg"
    Image.fromarray(PHOTO).save(source, **({"exif": exif} if exif else {}))
    write_located(source, path, BEST)
    assert read_photo(path).noted.lonlat_deg == pytest.approx((BEST.lon, BEST.lat), abs=1e-7)
    read_by_exiftool(path, "-validate")
