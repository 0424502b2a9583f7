"""XMP is read by namespace, wherever and however a file keeps it."""

import shutil
import subprocess

import numpy as np
import pytest
from PIL import Image, features
from PIL.ExifTags import IFD, Base
from PIL.PngImagePlugin import PngInfo
from xmp_packets import ATTRIBUTES, ELEMENTS, FORMS, GPANO, WHOLE, xmp_packet

from skyline.camera.projection import Projection
from skyline.photo.photo import read_photo
from skyline.photo.xmp import xmp_of

SPHERE = (Projection.EQUIRECTANGULAR, 360.0)
PHOTO = np.full((100, 200, 3), 128, dtype=np.uint8)
IN_SEGMENT = b"http://ns.adobe.com/xap/1.0/\0"
MIB = 1 << 20
LENS_DEG = 77.8
"""Field of view of 24 mm, of a photo of 2:1."""


def exif_of_lens(equivalent_mm=24):
    exif = Image.Exif()
    exif.get_ifd(IFD.Exif)[Base.FocalLengthIn35mmFilm] = equivalent_mm
    return exif


def written(path, **how):
    """Write a photo of 2:1 through a lens of 24 mm, by EXIF."""
    Image.fromarray(PHOTO).save(path, exif=exif_of_lens(), **how)
    return path


def camera_of(path):
    photo = read_photo(path)
    return photo.projection, photo.fov_deg


def segment(body):
    return b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("prefix", ["GPano", "GPano_1_", "ns1"])
def test_a_sphere_is_known_by_its_namespace_and_not_by_its_prefix(tmp_path, form, prefix):
    packet = xmp_packet(form, prefix, **WHOLE)
    assert camera_of(written(tmp_path / "a.jpg", xmp=packet.encode())) == SPHERE


def test_the_default_namespace_needs_no_prefix(tmp_path):
    packet = xmp_packet(ELEMENTS, "p", **WHOLE).replace("p:P", "P").replace("p:F", "F")
    packet = packet.replace("p:C", "C").replace("xmlns:p=", "xmlns=")
    assert camera_of(written(tmp_path / "a.jpg", xmp=packet.encode())) == SPHERE


def test_the_usual_prefix_of_another_namespace_says_nothing(tmp_path):
    packet = xmp_packet(namespace="http://example.org/other/", **WHOLE)
    projection, fov_deg = camera_of(written(tmp_path / "a.jpg", xmp=packet.encode()))
    assert projection is Projection.PERSPECTIVE
    assert fov_deg == pytest.approx(LENS_DEG, abs=0.1)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be", "utf-32-le"])
@pytest.mark.parametrize("padding", ["", "\n" * 2000, "\0"])
def test_packets_in_any_encoding(tmp_path, encoding, padding):
    packet = (xmp_packet(**WHOLE) + padding).encode(encoding)
    assert camera_of(written(tmp_path / "a.jpg", xmp=packet)) == SPHERE


def test_a_byte_that_is_no_utf_8_does_not_hide_the_rest(tmp_path):
    packet = xmp_packet(**WHOLE, Title="Zürich\x01").encode("latin-1", "replace")
    assert camera_of(written(tmp_path / "a.jpg", xmp=packet)) == SPHERE


def png_text(key, packet, kind):
    """Return a PNG's text that holds a packet as ImageMagick writes profiles."""
    info, profile = PngInfo(), packet.encode()
    if kind == "APP1":
        profile = IN_SEGMENT + profile
    digits = profile.hex()
    lines = "\n".join(digits[at : at + 72] for at in range(0, len(digits), 72))
    info.add_text(key, f"\n{kind}\n{len(profile):8}\n{lines}\n", zip=True)
    return info


@pytest.mark.parametrize("suffix", [".jpg", ".webp", ".tif", ".avif", ".png", ".heic"])
def test_every_format_of_photos(tmp_path, suffix):
    packet, path = xmp_packet(prefix="g", **WHOLE), tmp_path / f"photo{suffix}"
    if suffix == ".avif" and not features.check("avif"):
        pytest.skip("this Pillow has no AVIF")
    if suffix == ".heic":
        pytest.importorskip("pillow_heif").register_heif_opener()
    how = {"xmp": packet.encode()}
    if suffix == ".tif":
        how = {"tiffinfo": {700: packet.encode()}}
    if suffix == ".png":
        info = PngInfo()
        info.add_itxt("XML:com.adobe.xmp", packet, zip=True)
        how = {"pnginfo": info}
    Image.fromarray(PHOTO).save(path, **how)
    assert camera_of(path) == SPHERE


@pytest.mark.parametrize("kind", ["xmp", "APP1"])
def test_a_profile_that_imagemagick_keeps_in_a_png(tmp_path, kind):
    info = png_text(f"Raw profile type {kind}", xmp_packet(**WHOLE), kind)
    assert camera_of(written(tmp_path / "a.png", pnginfo=info)) == SPHERE


def test_xmp_in_the_exif_of_a_jpeg(tmp_path):
    exif = exif_of_lens()
    exif[700] = xmp_packet(**WHOLE).encode()
    Image.fromarray(PHOTO).save(tmp_path / "a.jpg", exif=exif)
    assert camera_of(tmp_path / "a.jpg") == SPHERE


def test_a_packet_longer_than_a_segment_is_joined_from_its_parts(tmp_path):
    long = xmp_packet(ELEMENTS, "g", **WHOLE, Depth="x" * 150_000).encode()
    digest, parts = b"0123456789ABCDEF0123456789ABCDEF", []
    for at in range(0, len(long), 60_000):
        head = digest + len(long).to_bytes(4, "big") + at.to_bytes(4, "big")
        part = b"http://ns.adobe.com/xmp/extension/\0" + head + long[at : at + 60_000]
        parts.append(segment(part))
    note = xmp_packet(
        namespace="http://ns.adobe.com/xmp/note/", HasExtendedXMP=digest.decode()
    ).encode()
    jpeg = written(tmp_path / "a.jpg", xmp=note).read_bytes()
    # Parts need not be in order.
    (tmp_path / "a.jpg").write_bytes(jpeg[:2] + b"".join(parts[::-1]) + jpeg[2:])
    assert camera_of(tmp_path / "a.jpg") == SPHERE


def test_numbers_may_be_written_with_decimals(tmp_path):
    noted = {name: f"{value:.1f}" for name, value in WHOLE.items() if isinstance(value, int)}
    packet = xmp_packet(ELEMENTS, ProjectionType=" Equirectangular", **noted)
    assert camera_of(written(tmp_path / "a.jpg", xmp=packet.encode())) == SPHERE


@pytest.mark.parametrize("name", ["rectilinear", "Perspective"])
def test_a_projection_of_lenses_leaves_the_lens_as_it_is(tmp_path, name):
    packet = xmp_packet(ProjectionType=name, FullPanoWidthPixels=9000)
    photo = read_photo(written(tmp_path / "a.jpg", xmp=packet.encode()))
    assert photo.projection is Projection.PERSPECTIVE
    assert photo.lens == read_photo(written(tmp_path / "b.jpg")).lens
    assert photo.fov_deg == pytest.approx(LENS_DEG, abs=0.1)


BOMB = (
    '<!DOCTYPE a [<!ENTITY x "{}">'.format("ha" * 1000)
    + "".join(
        f'<!ENTITY {n} "{9 * f"&{p};"}">' for p, n in zip("xbcdefgh", "bcdefghi", strict=True)
    )
    + "]>"
)


@pytest.mark.parametrize(
    "damage",
    [
        lambda packet: packet.replace("</rdf:RDF>", ""),
        lambda packet: packet.replace("<x:", BOMB + "<x:", 1).replace("sphere", "&i;"),
        lambda packet: packet.replace('xmlns:GPano="', 'title="'),
        lambda packet: packet[: len(packet) - 90],
    ],
)
def test_a_panorama_in_a_damaged_packet_is_not_taken_for_a_lens(tmp_path, damage):
    packet = damage(xmp_packet(**WHOLE, Title="sphere")).encode()
    photo = read_photo(written(tmp_path / "a.jpg", xmp=packet))
    assert photo.fov_deg is None
    assert "XMP mentions a panorama, but is damaged" in photo.lens.reason


def test_a_damaged_packet_of_other_things_leaves_the_lens(tmp_path):
    packet = xmp_packet(prefix="dc", namespace="http://purl.org/dc/elements/1.1/", title="a")[:-40]
    photo = read_photo(written(tmp_path / "a.jpg", xmp=packet.encode()))
    assert photo.fov_deg == pytest.approx(LENS_DEG, abs=0.1)


def test_a_huge_packet_is_not_parsed(tmp_path):
    image = Image.fromarray(PHOTO)
    image.info["xmp"] = xmp_packet(**WHOLE, Depth="x" * (32 * MIB)).encode()
    found = xmp_of(image)
    assert found.values == {}
    assert len(found.broken) <= 32 * MIB


def test_nested_properties_are_not_those_of_the_photo(tmp_path):
    """A photo's history may tell of the panorama that it was cut from."""
    inner = (
        '<rdf:Description xmlns:m="http://ns.adobe.com/xap/1.0/mm/"><m:DerivedFrom>'
        '<rdf:Description xmlns:{0}="{1}" {2}/></m:DerivedFrom></rdf:Description>'
    )
    packet = xmp_packet((inner, ATTRIBUTES[1]), **WHOLE)
    assert camera_of(written(tmp_path / "a.jpg", xmp=packet.encode()))[1] < 100.0


def test_what_exiftool_writes_is_read(tmp_path):
    if shutil.which("exiftool") is None:
        pytest.skip("libimage-exiftool-perl is not installed (.ci/system_packages.py)")
    noted = [f"-XMP-GPano:{name}={value}" for name, value in WHOLE.items()]
    for suffix in (".jpg", ".png", ".tif", ".webp"):
        path = tmp_path / f"a{suffix}"
        Image.fromarray(PHOTO).save(path)
        subprocess.run(["exiftool", "-q", *noted, path], check=True)
        assert camera_of(path) == SPHERE, suffix


def test_the_made_sphere_of_another_prefix(shared_data):
    photo = read_photo(shared_data / "cases" / "sphere_renamed_xmp_prefix.jpg")
    assert (photo.projection, photo.fov_deg) == SPHERE


def test_names_keep_their_namespaces():
    image = Image.fromarray(PHOTO)
    image.info["xmp"] = xmp_packet(prefix="q", **WHOLE).encode()
    found = xmp_of(image)
    assert found.of(GPANO.rstrip("/"))["FullPanoWidthPixels"] == "200"
    assert found.first("NoSuchName", "ProjectionType") == "equirectangular"
