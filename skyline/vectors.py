"""Points, lines and polygons in files, of a photo or a map.

A photo's vectors are GeoJSON in pixels, the annotations of LabelMe and COCO, or simple SVG; a map's
are GeoJSON in degrees (RFC 7946), the tracks, routes and waypoints of GPX, or a GeoPackage.
"""

import json
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from skyline.arrays import Float64Array
from skyline.camera import in_picture
from skyline.errors import InputError, library, printable
from skyline.files import GEOJSON, is_name_of, read_bytes

POINT, LINE, POLYGON = "Point", "LineString", "Polygon"
"""Kinds of shapes, by their GeoJSON names."""
VECTORS = (*GEOJSON, ".svg", ".gpx", ".gpkg")
EXPECTED = (
    "expected points, lines or polygons: GeoJSON, LabelMe, COCO or SVG of the photo, or GeoJSON, "
    "GPX or a GeoPackage of the map"
)
"""What a file of vectors is, for errors."""
PHOTO_MEMBER = "photo"
"""Member of a FeatureCollection in pixels: the photo's name, width and height."""
VERTICES_LAYER = "vertices"
"""The layer of GeoPackages in which `draw` writes the errors of drawn vertices."""
_PARTS = {
    POINT: (POINT, 0), "MultiPoint": (POINT, 1), LINE: (LINE, 0), "MultiLineString": (LINE, 1),
    POLYGON: (POLYGON, 0), "MultiPolygon": (POLYGON, 1),
}  # fmt: skip
"""Kind of the parts of a GeoJSON geometry, and whether it has several."""
_LEAST_VERTICES = {POINT: 1, LINE: 2, POLYGON: 3}
_SVG_SHAPES = ("polygon", "polyline", "line", "rect", "circle", "ellipse", "path")
_SVG_UNSEEN = ("defs", "clipPath", "mask", "symbol", "marker", "pattern")
"""Elements of SVG whose shapes are not drawn where they stand."""
_SVG_HIDES = re.compile(r"\b(display\s*:\s*none|visibility\s*:\s*(hidden|collapse))")
_SVG_RULE = re.compile(r"([^{}]*)\{([^{}]*)\}")
_SVG_NAME = re.compile(r"(?:[\w-]*[.#])?[\w-]+")
"""A selector of one element's class, id or name, the only ones that programs write."""
_SVG_MOVES = re.compile(r"\b(transform|translate|rotate|scale)\s*:\s*(?!none)\S")
_SVG_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_SVG_STEP = re.compile(rf"([a-zA-Z])|({_SVG_NUMBER})")
_CORNER = 0.5
"""LabelMe, COCO, SVG and QGIS count pixels from the photo's corner; here pixel centres are at whole
numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A point, a line or a polygon."""

    kind: str
    """`POINT`, `LINE` or `POLYGON`."""
    rings: tuple[Float64Array, ...]
    """Vertices (V, 2): columns and rows, or longitudes and latitudes. A polygon's first ring is its
    outline, and the others are holes; they are not closed."""
    where: str
    """The feature, for messages."""
    properties: Mapping[str, Any] = field(default_factory=dict)

    @property
    def vertices(self) -> Float64Array:
        """All vertices (V, 2)."""
        return np.concatenate(self.rings)


@dataclass(frozen=True, slots=True, eq=False)
class Vectors:
    """The shapes of a file."""

    path: Path
    shapes: tuple[Shape, ...]
    in_pixels: bool
    """Whether they were drawn in a photo rather than on a map."""
    size_px: tuple[int, int] | None = None
    """Width and height of their photo, if the file says so."""
    photo: str = ""
    """Name of their photo, if the file says so."""
    of_qgis: bool = False
    """Whether they were drawn in QGIS, in a photo."""

    def check_photo(self, photo: Path, width_px: int, height_px: int) -> None:
        """Raise `InputError` if the vectors' photo has another name or size.

        Vertices that all lie within one pixel are refused as well: they are shares of the width and
        height.
        """
        if self.photo and not is_name_of(self.photo, photo):
            raise InputError(
                f"{self.path} is drawn in {printable(self.photo)}, not in {photo}; give the photo "
                "in which it was drawn, or correct the name in the file if it is the same photo"
            )
        if self.size_px is not None and self.size_px != (width_px, height_px):
            width, height = self.size_px
            raise InputError(
                f"{self.path} is drawn in a photo of {width} x {height} px, and {photo} has "
                f"{width_px} x {height_px}; give the photo in which it was drawn"
            )
        vertices = np.concatenate([shape.vertices for shape in self.shapes])
        if len(vertices) > 1 and np.abs(vertices).max() <= 1.0 < min(width_px, height_px):
            raise InputError(
                f"{self.path} has coordinates from 0 to 1 only; expected columns and rows of "
                f"{photo}, which has {width_px} x {height_px} px: multiply them by its width and "
                "height"
            )
        for shape in self.shapes:
            column, row = shape.vertices.T
            off = ~in_picture(column, row, width_px, height_px, margin_px=1.0)
            if off.any():
                first = int(off.argmax())
                raise InputError(
                    f"{self.path}, {shape.where}: column {column[first]:g}, row {row[first]:g} is "
                    f"outside {photo}, which has {width_px} x {height_px} px; give the photo in "
                    "which it was drawn"
                )


def read_vectors(path: Path, photo: Path, in_pixels: bool = False) -> Vectors:
    """Read the shapes of a file.

    Parameters
    ----------
    photo : Path
        The photo, whose annotations are read where a file has the annotations of several.
    in_pixels : bool
        Whether GeoJSON is in pixels even if it does not say so. Rows that are all below 0 count
        upwards from the photo's upper edge, as QGIS has them.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The file holds no shapes, or unknown kinds of shapes, or their coordinates are neither
        pixels nor degrees.
    """
    suffix = path.suffix.lower()
    if suffix == ".gpkg":
        vectors = _of_geopackage(path)
    elif suffix == ".gpx":
        vectors = Vectors(path, tuple(_of_gpx(_root_of(path))), in_pixels=False)
    elif suffix == ".svg":
        vectors = _of_svg(path, _root_of(path))
    else:
        vectors = _of_json(path, photo, in_pixels)
    if not vectors.shapes:
        raise InputError(f"{path} holds no shapes; {EXPECTED}")
    for shape in vectors.shapes:
        if min(map(len, shape.rings)) < _LEAST_VERTICES[shape.kind]:
            raise InputError(
                f"{path}, {shape.where} is a {shape.kind} of {len(shape.rings[-1])} vertices; "
                f"expected {_LEAST_VERTICES[shape.kind]} or more"
            )
        if not vectors.in_pixels:
            _check_degrees(path, shape)
    return vectors


def _check_degrees(path: Path, shape: Shape) -> None:
    lon, lat = shape.vertices.T
    off = ~((np.abs(lon) <= 360.0) & (np.abs(lat) <= 90.0))
    if off.any():
        first = int(off.argmax())
        raise InputError(
            f"{path}, {shape.where} has the coordinates {lon[first]:g},{lat[first]:g}, which are "
            "not degrees, and the file names no CRS; give --pixels if they are columns and rows of "
            "the photo, else the CRS in the file's member `crs`"
        )


def _of_json(path: Path, photo: Path, in_pixels: bool) -> Vectors:
    """Return the shapes of GeoJSON, LabelMe or COCO."""
    content = read_bytes(path, EXPECTED)
    try:
        read = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read as JSON ({error}); {EXPECTED}") from None
    try:
        if isinstance(read, dict) and isinstance(read.get("shapes"), list):
            return _of_labelme(path, read)
        if isinstance(read, dict) and isinstance(read.get("annotations"), list):
            return _of_coco(path, read, photo)
        if isinstance(read, dict) and "type" in read:
            return _of_geojson(path, read, in_pixels)
    except (TypeError, ValueError, AttributeError, LookupError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path} has a part that cannot be read ({printable(str(error))[:60]}); {EXPECTED}"
        ) from None
    raise InputError(f"{path} is not a file of vectors; {EXPECTED}")


def _of_geojson(path: Path, read: Mapping[str, Any], in_pixels: bool) -> Vectors:
    about = read.get(PHOTO_MEMBER)
    size_px = None
    name = ""
    of_qgis = False
    if isinstance(about, Mapping):
        size_px, in_pixels = (int(about["width_px"]), int(about["height_px"])), True
        name = str(about.get("name") or "")
    shapes = [
        Shape(kind, rings, f"feature {number}", properties)
        for number, (geometry, properties) in enumerate(_geometries(read), start=1)
        for kind, rings in _parts_of(geometry)
    ]
    if in_pixels:
        rows = np.concatenate([one.vertices[:, 1] for one in shapes]) if shapes else np.zeros(1)
        of_qgis = bool(rows.max() <= 0.0 and rows.min() < 0.0)
        if of_qgis:
            shapes = [_moved(one, lambda xy: xy * (1.0, -1.0) - _CORNER) for one in shapes]
    else:
        shapes = _in_degrees(path, shapes, read.get("crs"))
    return Vectors(path, tuple(shapes), in_pixels, size_px, name, of_qgis)


def _geometries(read: Mapping[str, Any]) -> Iterator[tuple[Any, Mapping[str, Any]]]:
    """Yield geometries and properties of GeoJSON."""
    if read["type"] == "FeatureCollection":
        for one in read["features"]:
            yield one["geometry"], one.get("properties") or {}
    elif read["type"] == "Feature":
        yield read["geometry"], read.get("properties") or {}
    else:
        yield read, {}


def _parts_of(geometry: Any) -> Iterator[tuple[str, tuple[Float64Array, ...]]]:
    """Yield the kind and the rings of each part of a geometry."""
    if geometry is None:
        return
    if geometry["type"] == "GeometryCollection":
        for one in geometry["geometries"]:
            yield from _parts_of(one)
        return
    if geometry["type"] not in _PARTS:
        raise InputError(f"a geometry is {str(geometry['type'])[:40]!r}; {EXPECTED}")
    kind, is_multiple = _PARTS[geometry["type"]]
    given = geometry["coordinates"]
    for part in given if is_multiple else [given]:
        rings = part if kind == POLYGON else [[part] if kind == POINT else part]
        yield kind, tuple(_ring(ring, kind) for ring in rings)


def _ring(given: Sequence[Sequence[float]], kind: str = LINE) -> Float64Array:
    """Return vertices (V, 2), without the last if it closes a polygon."""
    ring = np.array([one[:2] for one in given], dtype=np.float64).reshape(-1, 2)
    if not np.isfinite(ring).all():
        raise ValueError("a coordinate is not a number")
    is_closed = kind == POLYGON and len(ring) > 1 and np.array_equal(ring[0], ring[-1])
    return ring[:-1] if is_closed else ring


def _moved(shape: Shape, move: Callable[[Float64Array], Float64Array]) -> Shape:
    return Shape(shape.kind, tuple(map(move, shape.rings)), shape.where, shape.properties)


def _in_degrees(path: Path, shapes: list[Shape], crs: Any) -> list[Shape]:
    """Convert shapes to WGS 84 from the CRS that older GeoJSON names."""
    if crs is None:
        return shapes
    from skyline.geodesy.crs import (  # noqa: PLC0415  (slow to load)
        WGS84,
        crs_of_positions,
        transformer,
    )

    to_wgs84 = transformer(crs_of_positions(path, crs), WGS84)
    return [_moved(one, lambda xy: np.stack(to_wgs84.transform(*xy.T), axis=1)) for one in shapes]


def _of_labelme(path: Path, read: Mapping[str, Any]) -> Vectors:
    """Return the shapes of LabelMe's annotations."""
    shapes = []
    for number, one in enumerate(read["shapes"], start=1):
        form = one.get("shape_type") or "polygon"
        ring = _ring(one["points"], POLYGON) - _CORNER
        kind = {"line": LINE, "linestrip": LINE, "point": POINT, "points": POINT}.get(form, POLYGON)
        if form == "rectangle":
            ring = _box(*ring.min(axis=0), *ring.max(axis=0))
        elif form == "circle":
            ring = _circle(ring[0], *([math.dist(*ring)] * 2))
        elif kind == POLYGON and form != "polygon":
            raise InputError(
                f"{path}, shape {number} is a {str(form)[:40]}; expected a polygon, a rectangle, a "
                "circle, a line, a linestrip or a point"
            )
        rings = tuple(ring[:, np.newaxis]) if kind == POINT else (ring,)
        about = {"label": one.get("label")}
        shapes += [Shape(kind, (part,), f"shape {number}", about) for part in rings]
    size_px = _size_of(read, "image{}")
    return Vectors(path, tuple(shapes), True, size_px, str(read.get("imagePath") or ""))


def _size_of(read: Mapping[str, Any], name: str) -> tuple[int, int] | None:
    """Return a width and a height; None unless both are given."""
    width, height = (
        read.get(name.format(side)) or read.get(name.format(side).lower())
        for side in ("Width", "Height")
    )
    return (int(width), int(height)) if width and height else None


def _of_coco(path: Path, read: Mapping[str, Any], photo: Path) -> Vectors:
    """Return the shapes of COCO's annotations of a photo."""
    images = read.get("images") or []
    of_photo = [one for one in images if is_name_of(str(one.get("file_name")), photo)]
    if len(of_photo) != 1:
        raise InputError(
            f"{path} has {len(of_photo)} images of the name {photo.name}; expected one: give the "
            "photo as the file names it"
        )
    (image,) = of_photo
    names = {one["id"]: one.get("name") for one in read.get("categories") or []}
    shapes = []
    for one in read["annotations"]:
        if one.get("image_id") != image["id"]:
            continue
        where = f"annotation {one.get('id')}"
        about = {"category": names.get(one.get("category_id")), "id": one.get("id")}
        outlines = one.get("segmentation") or []
        if isinstance(outlines, Mapping):
            raise InputError(
                f"{path}, {where} is a mask (RLE); expected polygons: export the annotations as "
                "polygons"
            )
        points = np.reshape(one.get("keypoints") or [], (-1, 3)).astype(np.float64)
        rings = [np.reshape(ring, (-1, 2)).astype(np.float64) for ring in outlines]
        if not rings and not len(points) and one.get("bbox"):
            left, top, width, height = map(float, one["bbox"])
            rings = [_box(left, top, left + width, top + height)]
        shapes += [Shape(POLYGON, (ring - _CORNER,), where, about) for ring in rings]
        shapes += [
            Shape(POINT, (xy[np.newaxis, :2] - _CORNER,), where, about) for xy in points if xy[2]
        ]
    return Vectors(path, tuple(shapes), in_pixels=True, size_px=_size_of(image, "{}"))


def _box(left: float, top: float, right: float, bottom: float) -> Float64Array:
    return np.array([(left, top), (right, top), (right, bottom), (left, bottom)])


def _circle(middle: Float64Array, across: float, up: float) -> Float64Array:
    turn = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    return middle + np.stack([across * np.cos(turn), up * np.sin(turn)], axis=1)


def _root_of(path: Path) -> Element:
    """Return the root of an XML file."""
    try:
        root: Element = fromstring(read_bytes(path, EXPECTED))
    except (ParseError, DefusedXmlException, ValueError) as error:
        raise InputError(f"{path} cannot be read as XML ({error}); {EXPECTED}") from None
    return root


def _tag(one: Element) -> str:
    """Return an element's name without its namespace."""
    return one.tag.rpartition("}")[2] if isinstance(one.tag, str) else ""


def _of_gpx(root: Element) -> Iterator[Shape]:
    """Yield the waypoints, routes and segments of tracks of GPX."""

    def named(one: Element) -> dict[str, str]:
        names = [child.text or "" for child in one if _tag(child) == "name"]
        return {"name": names[0]} if names else {}

    def ring(points: Sequence[Element]) -> tuple[Float64Array, ...]:
        return (_ring([(float(one.get("lon", "")), float(one.get("lat", ""))) for one in points]),)

    try:
        for number, one in enumerate(root, start=1):
            where = f"element {number}"
            if _tag(one) == "wpt":
                yield Shape(POINT, ring([one]), where, named(one))
            elif _tag(one) == "rte":
                points = [point for point in one if _tag(point) == "rtept"]
                yield Shape(LINE, ring(points), where, named(one))
            elif _tag(one) == "trk":
                for part in (part for part in one if _tag(part) == "trkseg"):
                    points = [point for point in part if _tag(point) == "trkpt"]
                    if len(points) > 1:
                        yield Shape(LINE, ring(points), where, named(one))
    except ValueError:
        raise InputError(
            f"element {number} of the GPX has a place without lon and lat; {EXPECTED}"
        ) from None


def _of_svg(path: Path, root: Element) -> Vectors:
    """Return the polygons, lines and points of simple SVG; circles are points."""
    box = [float(one) for one in re.findall(_SVG_NUMBER, root.get("viewBox", ""))]
    sides = [re.match(_SVG_NUMBER, root.get(side, "")) for side in ("width", "height")]
    size = box[2:] if len(box) == 4 else [float(one[0]) for one in sides if one is not None]
    corner = box[:2] if len(box) == 4 else [0.0, 0.0]
    hiding = set(_hiding_selectors(path, root))
    hidden = [one for one in root.iter() if _tag(one) in _SVG_UNSEEN or _is_hidden(one, hiding)]
    unseen = {part for one in hidden for part in one.iter()}
    shapes = []
    for number, one in enumerate(root.iter(), start=1):
        where = f"element {number} ({_tag(one)})"
        if one in unseen and _tag(one) != "style":
            continue
        is_moved = one.get("transform") or _SVG_MOVES.search(_style_of(one))
        if is_moved or (_tag(one) in ("svg", "use") and one is not root):
            raise InputError(
                f"{path}, {where} moves shapes; expected shapes in the photo's pixels: apply the "
                "transforms and unlink clones, or export GeoJSON"
            )
        if _tag(one) in _SVG_SHAPES:
            about = {"id": one.get("id")} if one.get("id") else {}
            shapes += [
                Shape(kind, (ring - corner - _CORNER,), where, about)
                for kind, ring in _svg_rings(path, where, one)
            ]
    if not np.isfinite([*size, *corner]).all():
        raise InputError(f"{path} has a viewBox that is not finite; expected the photo's pixels")
    size_px = (round(size[0]), round(size[1])) if len(size) == 2 else None
    return Vectors(path, tuple(shapes), in_pixels=True, size_px=size_px)


def _style_of(one: Element) -> str:
    """Return the style of an element of SVG, or the rules of its element ``style``."""
    return (one.text or "") if _tag(one) == "style" else one.get("style", "")


def _hiding_selectors(path: Path, root: Element) -> Iterator[str]:
    """Yield the selectors of an SVG's rules that hide elements: ``.st0``, ``#sketch``, ``g``.

    Illustrator hides layers so. Raises `InputError` for other selectors.
    """
    sheets = [one.text or "" for one in root.iter() if _tag(one) == "style"]
    for selectors, rules in _SVG_RULE.findall(
        re.sub(r"/\*.*?\*/", "", " ".join(sheets), flags=re.S)
    ):
        if not _SVG_HIDES.search(rules):
            continue
        for one in map(str.strip, selectors.split(",")):
            if not _SVG_NAME.fullmatch(one):
                raise InputError(
                    f"{path} hides shapes by the rule {printable(one)[:40]}; expected one class or "
                    "id: delete what is hidden, or export GeoJSON"
                )
            yield one


def _is_hidden(one: Element, hiding: Collection[str]) -> bool:
    """Return whether an element of SVG is not shown, as a hidden layer.

    ``hiding`` has the selectors of rules that hide elements.
    """
    own = f"display:{one.get('display')};visibility:{one.get('visibility')};{one.get('style')}"
    tag = _tag(one)
    marks = [f".{name}" for name in one.get("class", "").split()] + [f"#{one.get('id')}"]
    names = {tag, *marks, *(f"{tag}{mark}" for mark in marks)}
    return bool(_SVG_HIDES.search(own)) or not names.isdisjoint(hiding)


def _svg_rings(path: Path, where: str, one: Element) -> Iterator[tuple[str, Float64Array]]:
    """Yield the kind and the vertices of an SVG shape's parts."""

    def numbers(*names: str) -> list[float]:
        texts = [one.get(name, "0") for name in names]
        for text in texts:
            if not re.fullmatch(rf"{_SVG_NUMBER}(px)?", text):
                raise InputError(
                    f"{path}, {where} has the coordinate {printable(text)[:40]}; expected pixels: "
                    "export it without other units, or GeoJSON"
                )
        return [float(text.removesuffix("px")) for text in texts]

    tag = _tag(one)
    if tag in ("polygon", "polyline"):
        given = [float(number) for number in re.findall(_SVG_NUMBER, one.get("points", ""))]
        if len(given) % 2:
            raise InputError(f"{path}, {where} has {len(given)} numbers; expected columns and rows")
        yield POLYGON if tag == "polygon" else LINE, np.reshape(given, (-1, 2))
    elif tag == "line":
        yield LINE, np.reshape(numbers("x1", "y1", "x2", "y2"), (2, 2))
    elif tag == "rect":
        left, top, width, height = numbers("x", "y", "width", "height")
        yield POLYGON, _box(left, top, left + width, top + height)
    elif tag in ("circle", "ellipse"):
        yield POINT, np.array([numbers("cx", "cy")])
    else:
        yield from _svg_path(path, one.get("d", ""))


def _svg_path(path: Path, steps: str) -> Iterator[tuple[str, Float64Array]]:
    """Yield the straight parts of an SVG path."""
    at = start = 0j
    ring: list[complex] = []
    letter = "M"
    given: list[float] = []

    def vertices() -> Float64Array:
        return np.array([(one.real, one.imag) for one in ring])

    for name, number in _SVG_STEP.findall(steps):
        if name:
            letter, given = name, []
            if name in "Zz":
                yield POLYGON, vertices()
                ring, at = [], start
            continue
        given.append(float(number))
        base = at if letter.islower() else 0j
        if letter in "Hh":
            at = complex(base.real + given.pop(), at.imag)
        elif letter in "Vv":
            at = complex(at.real, base.imag + given.pop())
        elif letter not in "MmLl":
            raise InputError(
                f"{path} has a path with the step {letter}; expected straight lines (M, L, H, V, "
                "Z): flatten the curves, or export GeoJSON"
            )
        elif len(given) < 2:
            continue
        else:
            at = base + complex(*given)
            if letter in "Mm":
                if len(ring) > 1:
                    yield LINE, vertices()
                ring, start, letter = [], at, "l" if letter == "m" else "L"
            given = []
        if not ring and at != start:
            ring.append(start)
        ring.append(at)
    if len(ring) > 1:
        yield LINE, vertices()


def _of_geopackage(path: Path) -> Vectors:
    """Return the shapes of all layers of a GeoPackage, in degrees.

    `draw`'s own layer of vertices, which lie on its other shapes, is left out.
    """
    geopandas = library("geopandas", f"reading {path}")
    if not path.exists():
        read_bytes(path, EXPECTED)
    try:
        named = geopandas.list_layers(path)
        layers = {
            layer: geopandas.read_file(path, layer=layer)
            for layer in named["name"][named["geometry_type"].notna()]
        }
    except Exception as error:
        raise InputError(f"{path} cannot be read ({printable(str(error))[:80]})") from None
    features = list[Any]()
    for layer, table in layers.items():
        if layer == VERTICES_LAYER and "semi_major_m" in table.columns:
            continue
        if table.crs is None:
            raise InputError(
                f"{path}: the layer {printable(layer)} names no CRS; set it, or give GeoJSON in "
                "degrees"
            )
        features += json.loads(table.to_crs(4326).to_json(drop_id=True))["features"]
    return _of_geojson(path, {"type": "FeatureCollection", "features": features}, in_pixels=False)
