"""Points, lines and polygons in files, of a photo or a map.

A photo's vectors are GeoJSON in pixels, the annotations of LabelMe and COCO, or simple SVG; a map's
are GeoJSON in degrees (RFC 7946), the tracks, routes and waypoints of GPX, or a GeoPackage.
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError, library, printable
from skyline.files.disk import is_name_of, read_bytes
from skyline.files.geojson import GEOJSON
from skyline.files.shapes import (
    CORNER_PX,
    EXPECTED,
    EXPECTED_ON_MAP,
    LINE,
    POINT,
    POLYGON,
    Shape,
    Vectors,
    box_ring,
    ring_of,
)
from skyline.files.xml_vectors import read_gpx, read_svg

VECTORS = (*GEOJSON, ".svg", ".gpx", ".gpkg")
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


def read_vectors(path: Path, photo: Path | None = None, in_pixels: bool = False) -> Vectors:
    """Read the shapes of a file.

    Parameters
    ----------
    photo : Path, optional
        The photo, whose annotations are read where a file has the annotations of several. Without
        it, shapes are expected on the map.
    in_pixels : bool
        Whether GeoJSON is in pixels even if it does not say so. Rows that are all below 0 count
        upwards from the photo's upper edge, as QGIS has them.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The file holds no shapes, or unknown kinds of shapes, or their coordinates are neither
        pixels nor degrees, or are pixels although no photo is given.
    """
    suffix = path.suffix.lower()
    if suffix == ".gpkg":
        vectors = _of_geopackage(path)
    elif suffix == ".gpx":
        vectors = read_gpx(path)
    elif suffix == ".svg":
        vectors = read_svg(path)
    else:
        vectors = _of_json(path, photo, in_pixels)
    if vectors.in_pixels and photo is None:
        raise InputError(f"{path} is drawn in a photo; {EXPECTED_ON_MAP}")
    if not vectors.shapes:
        raise InputError(f"{path} holds no shapes; {EXPECTED if photo else EXPECTED_ON_MAP}")
    for shape in vectors.shapes:
        if min(map(len, shape.rings)) < _LEAST_VERTICES[shape.kind]:
            raise InputError(
                f"{path}, {shape.where} is a {shape.kind} of {len(shape.rings[-1])} vertices; "
                f"expected {_LEAST_VERTICES[shape.kind]} or more"
            )
        if not vectors.in_pixels:
            _check_degrees(path, shape, photo)
    return vectors


def _check_degrees(path: Path, shape: Shape, photo: Path | None) -> None:
    lon, lat = shape.vertices.T
    off = ~((np.abs(lon) <= 360.0) & (np.abs(lat) <= 90.0))
    if off.any():
        first = int(off.argmax())
        or_pixels = f"--pixels if they are columns and rows of {photo}, else " if photo else ""
        raise InputError(
            f"{path}, {shape.where} has the coordinates {lon[first]:g},{lat[first]:g}, which are "
            f"not degrees, and the file names no CRS; give {or_pixels}the CRS in the file's member "
            "`crs`"
        )


def _of_json(path: Path, photo: Path | None, in_pixels: bool) -> Vectors:
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
        for kind, rings in _parts_of(path, geometry)
    ]
    if in_pixels:
        rows = np.concatenate([one.vertices[:, 1] for one in shapes]) if shapes else np.zeros(1)
        of_qgis = bool(rows.max() <= 0.0 and rows.min() < 0.0)
        if of_qgis:
            shapes = [_moved(one, lambda xy: xy * (1.0, -1.0) - CORNER_PX) for one in shapes]
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


def _parts_of(path: Path, geometry: Any) -> Iterator[tuple[str, tuple[Float64Array, ...]]]:
    """Yield the kind and the rings of each part of a geometry."""
    if geometry is None:
        return
    if geometry["type"] == "GeometryCollection":
        for one in geometry["geometries"]:
            yield from _parts_of(path, one)
        return
    if geometry["type"] not in _PARTS:
        raise InputError(f"{path} has a geometry {str(geometry['type'])[:40]!r}; {EXPECTED}")
    kind, is_multiple = _PARTS[geometry["type"]]
    given = geometry["coordinates"]
    for part in given if is_multiple else [given]:
        rings = part if kind == POLYGON else [[part] if kind == POINT else part]
        yield kind, tuple(ring_of(ring, kind) for ring in rings)


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
        ring = ring_of(one["points"], POLYGON) - CORNER_PX
        kind = {"line": LINE, "linestrip": LINE, "point": POINT, "points": POINT}.get(form, POLYGON)
        if form == "rectangle":
            ring = box_ring(*ring.min(axis=0), *ring.max(axis=0))
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


def _of_coco(path: Path, read: Mapping[str, Any], photo: Path | None) -> Vectors:
    """Return the shapes of COCO's annotations of a photo; none without one."""
    if photo is None:
        return Vectors(path, (), in_pixels=True)
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
            rings = [box_ring(left, top, left + width, top + height)]
        shapes += [Shape(POLYGON, (ring - CORNER_PX,), where, about) for ring in rings]
        shapes += [
            Shape(POINT, (xy[np.newaxis, :2] - CORNER_PX,), where, about) for xy in points if xy[2]
        ]
    return Vectors(path, tuple(shapes), in_pixels=True, size_px=_size_of(image, "{}"))


def _circle(middle: Float64Array, across: float, up: float) -> Float64Array:
    turn = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    return middle + np.stack([across * np.cos(turn), up * np.sin(turn)], axis=1)


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
