"""Shapes in files of each kind, against the numbers that are written in them."""

import json
from pathlib import Path

import numpy as np
import pytest

from skyline.errors import InputError, MissingFileError
from skyline.files.shapes import LINE, POINT, POLYGON
from skyline.files.vectors import read_vectors

SQUARE = [[10.0, 20.0], [30.0, 20.0], [30.0, 40.0], [10.0, 40.0]]
PIXELS = np.array(SQUARE) - 0.5
"""The same from corners of pixels."""


@pytest.fixture
def read(tmp_path):
    """Return a function that writes a file and reads its shapes."""

    def read_as(name, content, **options):
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return read_vectors(path, tmp_path / "a.jpg", **options)

    return read_as


def feature(kind, coordinates, **properties):
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def collection(*features, **more):
    return {"type": "FeatureCollection", "features": features, **more}


def test_geojson_is_of_the_map_unless_it_says_otherwise(read):
    found = read("a.geojson", collection(feature("Polygon", [[*SQUARE, SQUARE[0]]], name="A")))
    (shape,) = found.shapes
    assert (found.in_pixels, shape.kind, shape.properties) == (False, POLYGON, {"name": "A"})
    np.testing.assert_array_equal(shape.rings[0], SQUARE)
    assert read("a.geojson", feature("Point", [1.0, 2.0, 3.0]), in_pixels=True).in_pixels
    photo = {"name": "a.jpg", "width_px": 640, "height_px": 480}
    said = read("a.json", collection(feature("LineString", SQUARE), photo=photo))
    assert (said.in_pixels, said.size_px) == (True, (640, 480))


def test_parts_of_geojson_are_shapes_of_their_own(read):
    both = feature("MultiLineString", [SQUARE[:2], SQUARE[2:]])
    many = feature("MultiPoint", SQUARE)
    group = {"type": "GeometryCollection", "geometries": [both["geometry"], many["geometry"]]}
    found = read("a.geojson", collection({**both, "geometry": group}))
    assert [one.kind for one in found.shapes] == [LINE] * 2 + [POINT] * 4


def test_pixels_as_qgis_has_them_count_from_the_corner_upwards(read):
    upwards = [[x, -y] for x, y in SQUARE]
    found = read("a.geojson", feature("LineString", upwards), in_pixels=True)
    np.testing.assert_array_equal(found.shapes[0].rings[0], PIXELS)
    assert found.of_qgis
    found.check_photo(Path("a.jpg"), 640, 480)


def test_an_older_crs_is_carried_to_degrees(read):
    named = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32632"}}
    metres = feature("Point", [500_000.0, 5_094_000.0])
    coded = {"type": "EPSG", "properties": {"code": 32632}}
    for crs in (named, coded):
        found = read("a.geojson", collection(metres, crs=crs))
        np.testing.assert_allclose(found.shapes[0].rings[0], [[9.0, 46.0]], atol=0.01)


@pytest.mark.parametrize(
    ("crs", "kind"), [("EPSG:4978", "Geocentric CRS"), ("EPSG:5773", "Vertical CRS")]
)
def test_a_crs_without_a_map_is_refused(read, crs, kind):
    named = {"type": "name", "properties": {"name": crs}}
    with pytest.raises(InputError, match=f"a {kind}; expected a geographic or projected CRS"):
        read("a.geojson", collection(feature("Point", [9.0, 46.0]), crs=named))


def test_annotations_of_labelme(read):
    shapes = [
        {"label": "lake", "points": SQUARE, "shape_type": "polygon"},
        {"label": "box", "points": [SQUARE[2], SQUARE[0]], "shape_type": "rectangle"},
        {"label": "path", "points": SQUARE, "shape_type": "linestrip"},
        {"label": "hut", "points": SQUARE[:1], "shape_type": "point"},
        {"label": "ring", "points": [[50.0, 50.0], [50.0, 60.0]], "shape_type": "circle"},
    ]
    found = read("a.json", {"shapes": shapes, "imageWidth": 640, "imageHeight": 480})
    assert [one.kind for one in found.shapes] == [POLYGON, POLYGON, LINE, POINT, POLYGON]
    assert (found.in_pixels, found.size_px) == (True, (640, 480))
    assert found.shapes[0].properties == {"label": "lake"}
    for index in (0, 1, 2):
        np.testing.assert_array_equal(found.shapes[index].rings[0], PIXELS)
    radius = np.linalg.norm(found.shapes[4].rings[0] - 49.5, axis=1)
    np.testing.assert_allclose(radius, 10.0)


def test_annotations_of_coco_are_the_photo_s_own(read):
    flat = [number for vertex in SQUARE for number in vertex]
    annotations = [
        {"id": 1, "image_id": 7, "category_id": 3, "segmentation": [flat]},
        {"id": 2, "image_id": 7, "category_id": 3, "bbox": [10, 20, 20, 20]},
        {"id": 3, "image_id": 8, "category_id": 3, "segmentation": [flat]},
    ]
    images = [
        {"id": 7, "file_name": "some/a.jpg", "width": 640, "height": 480},
        {"id": 8, "file_name": "b.jpg", "width": 10, "height": 10},
    ]
    about = {"images": images, "categories": [{"id": 3, "name": "ice"}]}
    found = read("a.json", {"annotations": annotations, **about})
    assert [one.properties["id"] for one in found.shapes] == [1, 2]
    assert found.shapes[0].properties["category"] == "ice"
    assert found.size_px == (640, 480)
    for one in found.shapes:
        np.testing.assert_array_equal(one.rings[0], PIXELS)


SVG = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 640 480"><g>
<polygon id="p" points="10,20 30,20 30,40 10,40"/><rect x="10" y="20" width="20" height="20"/>
<path d="M 10 20 h20 v20 H10 z"/><path d="M10,20L30,20 30,40 10,40"/>
<polyline points="10,20 30,20 30,40 10,40"/><circle cx="5" cy="6" r="2"/></g></svg>"""


def test_shapes_of_simple_svg(read):
    found = read("a.svg", SVG)
    assert [one.kind for one in found.shapes] == [POLYGON] * 3 + [LINE] * 2 + [POINT]
    assert (found.in_pixels, found.size_px) == (True, (640, 480))
    for one in found.shapes[:-1]:
        np.testing.assert_array_equal(one.rings[0], PIXELS)
    np.testing.assert_array_equal(found.shapes[-1].rings[0], [[4.5, 5.5]])


def test_an_svg_s_own_corner_and_what_it_does_not_draw_are_left_out(read):
    found = read(
        "a.svg",
        """<svg viewBox="100 50 640 480"><defs><clipPath><rect width="9" height="9"/></clipPath>
        </defs><g style="opacity:1; display: none"><rect width="9" height="9"/></g>
        <polygon points="110,70 130,70 130,90 110,90"/></svg>""",
    )
    (only,) = found.shapes
    np.testing.assert_array_equal(only.rings[0], PIXELS)


@pytest.mark.parametrize(
    "hidden",
    [
        '<g class="a st0">{}</g>',
        '<g id="sketch">{}</g>',
        '<g style="visibility: hidden">{}</g>',
        '<g visibility="hidden">{}</g>',
    ],
)
def test_what_an_svg_hides_by_a_rule_is_left_out(read, hidden):
    rules = (
        "<style>.st0{display:none;} /* .b */ #sketch, .st1 { display : none } .b{fill:red}</style>"
    )
    shown = '<polygon class="b" points="10,20 30,20 30,40 10,40"/>'
    found = read(
        "a.svg",
        f"""<svg viewBox="0 0 640 480">{rules}{hidden.format('<rect width="9" height="9"/>')}
        {shown}</svg>""",
    )
    (only,) = found.shapes
    np.testing.assert_array_equal(only.rings[0], PIXELS)


def test_a_rule_that_hides_part_of_a_layer_is_refused(read):
    with pytest.raises(InputError, match=r"hides shapes by the rule g > \.b"):
        read("a.svg", "<svg><style>g > .b{display:none}</style><rect width='9' height='9'/></svg>")


GPX = """<gpx xmlns="http://www.topografix.com/GPX/1/1"><wpt lat="46" lon="9"><name>A</name></wpt>
<trk><name>B</name><trkseg><trkpt lat="46" lon="9"/><trkpt lat="46.1" lon="9.1"/></trkseg>
<trkseg><trkpt lat="47" lon="9"/><trkpt lat="47.1" lon="9.1"/></trkseg></trk></gpx>"""


def test_waypoints_and_segments_of_gpx(read):
    found = read("a.gpx", GPX)
    assert not found.in_pixels
    assert [(one.kind, one.properties["name"]) for one in found.shapes] == [
        (POINT, "A"), (LINE, "B"), (LINE, "B"),
    ]  # fmt: skip
    np.testing.assert_array_equal(found.shapes[1].rings[0], [[9.0, 46.0], [9.1, 46.1]])


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.json", "{"),
        ("a.json", "[1]"),
        ("a.json", {"type": "FeatureCollection", "features": []}),
        ("a.json", feature("LineString", [[1, 2]])),
        ("a.json", feature("Point", [500_000, 5_000_000])),
        ("a.json", feature("Point", ["a", 2])),
        ("a.json", feature("Circle", [1, 2])),
        ("a.json", feature("Point", [10**400, 2])),
        ("a.json", {"shapes": [{"points": SQUARE}], "imageWidth": 1e999, "imageHeight": 480}),
        ("a.json", {"annotations": [], "images": []}),
        ("a.json", {"annotations": [], "images": [{"id": 1, "file_name": "a.jpg"}]}),
        ("a.json", {"shapes": [{"points": SQUARE, "shape_type": "mask"}]}),
        ("a.svg", "<svg><path d='M0 0C1 1 2 2 3 3'/></svg>"),
        ("a.svg", "<svg><g transform='scale(2)'><rect width='3' height='3'/></g></svg>"),
        ("a.svg", "<svg><g style='transform:scale(2)'><rect width='3' height='3'/></g></svg>"),
        ("a.svg", "<svg><style>rect {scale: 2}</style><rect width='3' height='3'/></svg>"),
        ("a.svg", "<svg><svg x='5'><rect width='3' height='3'/></svg></svg>"),
        ("a.svg", "<svg><use x='5' href='#a'/><rect id='a' width='3' height='3'/></svg>"),
        ("a.svg", "<svg><rect x='10%' width='3' height='3'/></svg>"),
        ("a.svg", "<svg><rect x='1mm' width='3' height='3'/></svg>"),
        ("a.svg", "<svg><polyline points='1,2 3'/></svg>"),
        ("a.svg", "<svg viewBox='0 0 1e999 480'><rect width='3' height='3'/></svg>"),
        ("a.svg", "<svg"),
        ("a.gpx", "<gpx><wpt lat='46'/></gpx>"),
    ],
)
def test_files_that_hold_no_shapes_are_refused(read, name, content):
    with pytest.raises(InputError, match=rf"{name}\W.* (expected|give) "):
        read(name, content)


@pytest.mark.parametrize(
    "content",
    [
        {"shapes": [{"points": SQUARE}], "imagePath": "..\\b\\a.jpg"},
        collection(photo={"name": "a.jpg", "width_px": 640, "height_px": 480}),
    ],
    ids=["labelme", "geojson"],
)
def test_vectors_of_another_photo_are_refused(read, tmp_path, content):
    if "features" in content:
        content["features"] = [feature("Point", [1.0, 2.0])]
    found = read("a.json", content)
    found.check_photo(tmp_path / "a.jpg", 640, 480)
    with pytest.raises(InputError, match=r"is drawn in .*a.jpg, not in other.jpg; give the photo"):
        found.check_photo(Path("other.jpg"), 640, 480)


def test_annotations_of_coco_are_of_no_photo_of_another_name(read):
    images = [{"id": 7, "file_name": "b.jpg"}]
    with pytest.raises(InputError, match=r"has 0 images of the name a.jpg"):
        read("a.json", {"annotations": [{"image_id": 7, "bbox": [1, 2, 3, 4]}], "images": images})


def test_shares_of_width_and_height_are_no_pixels(read):
    found = read("a.json", {"shapes": [{"points": [[0.1, 0.2], [0.9, 0.2], [0.5, 0.8]]}]})
    with pytest.raises(InputError, match=r"has coordinates from 0 to 1 only; expected columns"):
        found.check_photo(Path("a.jpg"), 640, 480)


@pytest.mark.parametrize("name", ["none.gpx", "none.json"])
def test_a_missing_file_is_told(tmp_path, name):
    with pytest.raises(MissingFileError):
        read_vectors(tmp_path / name, tmp_path / "a.jpg")


@pytest.mark.parametrize("size", [(640, 481), None])
def test_vectors_of_another_photo_s_size_are_refused(read, tmp_path, size):
    photo = {"photo": {"width_px": size[0], "height_px": size[1]}} if size else {}
    found = read("a.json", collection(feature("Point", [650, 10]), **photo), in_pixels=True)
    with pytest.raises(InputError):
        found.check_photo(tmp_path / "a.jpg", 640, 480)
